//! The part of the report that tells where meshes are too coarse for their shadows.

use kiln_core::{BakeSummary, CoarseFaces, MeshSummary};
use serde_json::{Value, json};

/// Faces of the level that are too coarse, and the part of the visible area that they are.
pub(crate) fn coarse_total(summary: &BakeSummary) -> (CoarseFaces, f64) {
    let mut total = CoarseFaces::default();
    summary.meshes.iter().for_each(|mesh| total.add(&mesh.solve.too_coarse));
    let area_m2 = summary.meshes.iter().map(|mesh| mesh.solve.visible_area_m2).sum();
    let share = share(&total, area_m2);
    (total, share)
}

fn share(coarse: &CoarseFaces, visible_area_m2: f64) -> f64 {
    if visible_area_m2 > 0.0 { coarse.visible_area_m2 / visible_area_m2 } else { 0.0 }
}

fn entry(faces: &CoarseFaces, visible_area_m2: f64, worst: &[Value]) -> Value {
    let share = share(faces, visible_area_m2);
    json!({ "faces": faces.count, "area_m2": faces.visible_area_m2, "share": share, "worst": worst })
}

/// Faces of an instance that are too coarse.
pub(super) fn of_instance(mesh: &MeshSummary) -> Value {
    entry(&mesh.solve.too_coarse, mesh.solve.visible_area_m2, &worst_faces(mesh).map(worst_entry).collect::<Vec<_>>())
}

/// A face that is too coarse: its deviation, its centre, and the instance that has it.
type Worst<'a> = (f64, &'a [f64; 3], &'a MeshSummary);

/// The worst faces of an instance, the worst first.
fn worst_faces(mesh: &MeshSummary) -> impl Iterator<Item = Worst<'_>> {
    let faces = mesh.solve.too_coarse.worst.iter().zip(&mesh.coarse_centers_m);
    faces.map(move |(face, center)| (face.deviation, center, mesh))
}

fn worst_entry((deviation, center, mesh): Worst<'_>) -> Value {
    json!({ "node": mesh.node, "center_m": center, "deviation": deviation })
}

/// Faces of all instances that are too coarse, with the worst of the level.
pub(super) fn of_level(summary: &BakeSummary) -> Value {
    /// Faces listed for a level.
    const LISTED: usize = 16;
    let (total, _) = coarse_total(summary);
    let mut worst: Vec<Worst<'_>> = summary.meshes.iter().flat_map(worst_faces).collect();
    worst.sort_by(|a, b| b.0.total_cmp(&a.0));
    worst.truncate(LISTED);
    let worst: Vec<Value> = worst.into_iter().map(worst_entry).collect();
    let area_m2 = summary.meshes.iter().map(|mesh| mesh.solve.visible_area_m2).sum();
    let mut level = entry(&total, area_m2, &worst);
    level["least_deviation"] = json!(CoarseFaces::LEAST_DEVIATION);
    level
}
