//! Masks of faces with holes: those of a level's meshes are stored with each mesh, and held once.

use kiln_core::{Mask, Mesh};
use std::{
    collections::HashSet,
    sync::{Arc, Mutex, PoisonError},
};

/// Masks that meshes have in common: each is in memory once.
#[derive(Default)]
pub(super) struct SharedMasks(Mutex<HashSet<Arc<Mask>>>);

impl SharedMasks {
    /// Gives a mesh the masks that others have, where they are the same.
    pub(super) fn share(&self, mesh: &mut Mesh) {
        if mesh.cutouts.masks.is_empty() {
            return;
        }
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for mask in &mut mesh.cutouts.masks {
            match known.get(mask) {
                Some(same) => *mask = Arc::clone(same),
                None => {
                    known.insert(Arc::clone(mask));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_masks_are_in_memory_once() {
        let shared = SharedMasks::default();
        let mesh = |is_opaque| {
            let mut mesh = Mesh::default();
            mesh.cutouts.masks = vec![Arc::new(Mask::uniform(is_opaque)), Arc::new(Mask::uniform(true))];
            shared.share(&mut mesh);
            mesh.cutouts.masks
        };
        let (one, other) = (mesh(true), mesh(false));
        assert!(Arc::ptr_eq(&one[0], &one[1]) && Arc::ptr_eq(&one[0], &other[1]) && !Arc::ptr_eq(&one[0], &other[0]));
    }
}
