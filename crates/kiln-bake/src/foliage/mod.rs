//! Fog that stands for shrubs: where it is, and how dense.
//!
//! A shrub is the box around its faces, filled with fog ([`kiln_trace::Foliage`]). An author gives the density, or it is what
//! makes the box as transparent, on average over all lines through it, as the shrub itself is ([`density`]). Where boxes
//! overlap each gives way to the others, so that a thicket is not darker for being made of many ([`overlap`]).

mod density;
mod overlap;

pub use density::{ModelDensity, ModelFog, model_fog};
pub use overlap::{OrientedBox, thinned};

use kiln_core::{Fog, Level, Mesh};
use rayon::prelude::*;

/// Gives every instance of a level that has shrub faces its fog. `mesh` gives the mesh of an index into
/// [`Level::meshes`]; each is asked for at most once.
pub fn place_fog<'m>(level: &mut Level, mesh: impl Fn(usize) -> Option<&'m Mesh> + Sync) {
    let models: Vec<Option<ModelFog>> = (0..level.meshes.len())
        .into_par_iter()
        .map(|index| mesh(index).and_then(|mesh| model_fog(mesh, level.meshes[index].digest)))
        .collect();
    // Lower levels of detail are not there for rays.
    let shrubs = level.instances.iter_mut().filter(|instance| !instance.is_lod()).filter_map(|instance| {
        let model = models.get(instance.mesh as usize)?.as_ref()?;
        Some((instance, model))
    });
    let mut shrubs: Vec<_> = shrubs.collect();
    let boxes: Vec<OrientedBox> =
        shrubs.iter().map(|(instance, model)| OrientedBox::new(&model.bounds, &instance.world_from_object)).collect();
    let thinned = thinned(&boxes);
    for ((instance, model), part) in shrubs.iter_mut().zip(thinned) {
        let scale = instance.world_from_object.matrix3.determinant().abs().cbrt();
        let density_per_m = part * model.density.per_m(scale);
        let is_there = density_per_m > 0.0 && density_per_m.is_finite();
        instance.fog = is_there.then_some(Fog { bounds: model.bounds, density_per_m });
    }
}
