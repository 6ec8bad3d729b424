//! The matrices of a real level: its geometry, with a made-up signal on it.

use super::{gather::Gathered, signal};
use crate::{BenchError, imported};
use kiln_core::SolveSettings;
use kiln_solve::ComponentSystem;
use std::path::Path;

/// Imports a level with the sidecar beside it and assembles all its instances.
pub(super) fn system(
    path: &Path,
    settings: &SolveSettings,
    columns: usize,
) -> Result<ComponentSystem<'static>, BenchError> {
    let imported = imported::import(path)?;
    let wave_m = imported.level.bounds.diagonal() / 60.0;
    let mut gathered = Gathered::new(columns);
    for instance in imported.level.instances.iter().filter(|instance| instance.receives) {
        let (mesh, world) = (&imported.meshes[instance.mesh as usize], &instance.world_from_object);
        let moments = signal::moments(mesh, world, columns.div_ceil(2), wave_m, |_| true);
        gathered.add(mesh, world, &moments, settings);
    }
    Ok(gathered.finish())
}
