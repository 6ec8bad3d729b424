//! The BVHs of a level's meshes: read from the local cache, or built and kept there.

use crate::LocalCache;
use kiln_core::{Digest, DigestBuilder, Mesh, TaskKey};
use kiln_trace::{BVH_REV, MeshBvh};
use rayon::prelude::*;
use std::{
    mem,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
};

/// Trees of fewer faces are not kept: what one of them takes to build is no more than finding it in the store.
const LEAST_FACES: usize = 256;

/// Bytes of trees that are written as one file.
const BATCH_BYTES: usize = 16 << 20;

/// Where the trees of meshes came from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BvhCounts {
    /// Read from the local cache.
    pub read: u64,
    /// Built, and kept from then on.
    pub built: u64,
    /// Built because they are too small to be kept, or there is no cache.
    pub not_kept: u64,
}

/// Reads, builds and keeps the trees of meshes.
#[derive(Default)]
pub(super) struct BvhKeeper {
    read: AtomicU64,
    built: AtomicU64,
    not_kept: AtomicU64,
    beside: Mutex<Vec<JoinHandle<()>>>,
}

/// A mesh and its digest.
pub(super) type NamedMesh<'a> = (Digest, &'a Mesh);

impl BvhKeeper {
    /// The trees of meshes, in order. Those that are built are written to the cache on a thread beside.
    pub(super) fn all(&self, meshes: &[NamedMesh<'_>], cache: Option<&LocalCache>) -> Vec<Arc<MeshBvh>> {
        let one = |&(digest, mesh): &NamedMesh<'_>| {
            let Some(cache) = cache.filter(|_| mesh.faces.len() >= LEAST_FACES) else {
                self.not_kept.fetch_add(1, Ordering::Relaxed);
                return (Arc::new(MeshBvh::build(mesh)), None);
            };
            let key = key(digest);
            if let Some(found) = find(cache, key, mesh) {
                self.read.fetch_add(1, Ordering::Relaxed);
                return (Arc::new(found), None);
            }
            self.built.fetch_add(1, Ordering::Relaxed);
            (Arc::new(MeshBvh::build(mesh)), Some(key))
        };
        let (all, keys): (Vec<_>, Vec<_>) = meshes.par_iter().map(one).unzip();
        let new = |(bvh, key): (&Arc<MeshBvh>, Option<TaskKey>)| Some((key?, Arc::clone(bvh)));
        let new: Vec<_> = all.iter().zip(keys).filter_map(new).collect();
        tracing::debug!(meshes = all.len(), built_and_kept = new.len(), "BVHs are ready");
        if let Some(cache) = cache.filter(|_| !new.is_empty()) {
            let cache = cache.clone();
            self.beside(move || write(&new, &cache));
        }
        all
    }

    /// Runs something on a thread that [`Self::finish`] waits for; not at all if there is none to be had.
    fn beside(&self, work: impl FnOnce() + Send + 'static) {
        match thread::Builder::new().name("kiln-keep-bvhs".to_owned()).spawn(work) {
            Ok(thread) => {
                let mut beside = self.beside.lock().unwrap_or_else(PoisonError::into_inner);
                beside.retain(|thread| !thread.is_finished());
                beside.push(thread);
            }
            Err(error) => tracing::warn!(%error, "BVHs are not kept"),
        }
    }

    /// Where all trees so far came from.
    pub(super) fn counts(&self) -> BvhCounts {
        let [read, built, not_kept] =
            [&self.read, &self.built, &self.not_kept].map(|count| count.load(Ordering::Relaxed));
        BvhCounts { read, built, not_kept }
    }

    /// Waits for the threads beside.
    pub(super) fn finish(&self) {
        let beside = mem::take(&mut *self.beside.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in beside {
            if thread.join().is_err() {
                tracing::error!("a thread beside the tasks has died");
            }
        }
    }
}

/// Of the mesh's digest, which covers what of it occludes, and the builder's revision.
fn key(mesh: Digest) -> TaskKey {
    TaskKey(DigestBuilder::new("kiln mesh bvh").integer(u64::from(BVH_REV)).digest(&mesh).finish())
}

fn find(cache: &LocalCache, key: TaskKey, mesh: &Mesh) -> Option<MeshBvh> {
    let read = MeshBvh::from_bytes(&cache.get(key)?, mesh);
    read.inspect_err(|error| tracing::warn!(%error, "a BVH of the local cache is passed over")).ok()
}

fn write(new: &[(TaskKey, Arc<MeshBvh>)], cache: &LocalCache) {
    let (mut batch, mut bytes) = (Vec::new(), 0);
    for (key, bvh) in new {
        let tree = bvh.to_bytes();
        bytes += tree.len();
        batch.push((*key, tree));
        if bytes >= BATCH_BYTES {
            cache.put(&mem::take(&mut batch));
            bytes = 0;
        }
    }
    if !batch.is_empty() {
        cache.put(&batch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_store::{OpenOptions, Store};

    /// A wall of squares, with `LEAST_FACES` faces or fewer.
    fn wall(columns: u32, height: f32) -> Mesh {
        let position = |i: u32| [(i / 2) as f32, (i % 2) as f32 * height, 0.0];
        let square = |i: u32| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 1, 2 * i + 2, 2 * i + 3]];
        let group = kiln_core::FaceGroup::PLAIN;
        Mesh {
            positions: (0..2 * columns + 2).map(position).collect(),
            normals: vec![[0.0, 0.0, 1.0]; 2 * columns as usize + 2],
            faces: (0..columns).flat_map(square).collect(),
            face_group: vec![0; 2 * columns as usize],
            groups: vec![group],
            ..Mesh::default()
        }
    }

    #[test]
    fn each_mesh_is_built_once_and_read_from_then_on() {
        let folder = tempfile::tempdir().unwrap();
        let store = || Arc::new(Store::open(folder.path(), OpenOptions::default()).unwrap());
        let meshes = [wall(10, 1.0), wall(600, 1.0), wall(600, 2.0), wall(700, 1.0)];
        let named = |mesh| (Digest::of(&kiln_core::codec::encode(mesh)), mesh);
        let named: Vec<NamedMesh<'_>> = meshes.iter().map(named).collect();
        let run = |named: &[NamedMesh<'_>]| {
            let keeper = BvhKeeper::default();
            let all = keeper.all(named, Some(&LocalCache::new(store(), None)));
            let beside = mem::take(&mut *keeper.beside.lock().unwrap());
            beside.into_iter().for_each(|thread| thread.join().unwrap());
            let expected: Vec<MeshBvh> = named.iter().map(|(_, mesh)| MeshBvh::build(mesh)).collect();
            assert!(all.iter().map(|bvh| &**bvh).eq(&expected));
            let BvhCounts { read, built, not_kept } = keeper.counts();
            [read, built, not_kept]
        };
        assert_eq!(run(&named[..3]), [0, 2, 1]);
        assert_eq!(run(&named[1..]), [2, 1, 0]);
        // A tree of another mesh under the key is noticed, and nothing but time is lost.
        let swapped = [(named[1].0, named[3].1), named[2]];
        assert_eq!(run(&swapped), [1, 1, 0]);
        assert_eq!(run(&named), [3, 0, 1]);
    }
}
