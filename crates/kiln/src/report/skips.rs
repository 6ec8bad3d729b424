//! The part of the report that tells what was left out, and by which rule. The rules are in docs/skips.md.

use kiln_core::{BakeSummary, Class};
use serde_json::{Value, json};

/// Rays of this bake, and those that it was spared, by the rule that did.
pub(super) fn rays(summary: &BakeSummary, traced: u64) -> Value {
    let trace = &summary.trace;
    json!({
        "traced": traced,
        "cut_by": { "reach": summary.beyond_reach.rays_cut },
        "saved_by": {
            "empty_hemisphere": trace.rays_skipped_empty,
            "buried_faces": trace.rays_skipped_buried,
            "duplicate_faces": trace.rays_skipped_duplicate,
            "adaptive_sampling": trace.rays_saved_adaptive,
            "unchanged_work": trace.rays.saturating_sub(traced),
        },
    })
}

/// What was never work: geometry that no ray comes to, and classes of geometry that the level lacks.
pub(super) fn left_out(summary: &BakeSummary) -> Value {
    let has = |class: &Class| summary.counts.classes.get(class).is_some_and(|faces| *faces > 0);
    let absent: Vec<Class> = Class::ALL.into_iter().filter(|class| !has(class)).collect();
    json!({
        "instances_out_of_reach": summary.beyond_reach.instances,
        "faces_out_of_reach": summary.beyond_reach.faces,
        "absent_classes": absent,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::{BeyondReach, Digest, Kernel, LevelCounts, Sampling, TraceSummary};
    use std::collections::{BTreeMap, BTreeSet};

    fn summary() -> BakeSummary {
        let classes = BTreeMap::from([(Class::Opaque, 12), (Class::Tree, 5), (Class::Shrub, 0)]);
        BakeSummary {
            level: Digest::default(),
            counts: LevelCounts { classes, ..LevelCounts::default() },
            sampling: Sampling {
                kernel: Kernel::Obscurance { half_distances_m: vec![2.0] },
                rays_per_sample: 16,
                target: None,
                mean_samples_per_face: 4.0,
                density_per_m2: None,
                min_samples_per_face: 2,
                max_samples_per_face: 64,
                back_face_limit: 0.25,
                seed: 0,
                foliage: kiln_core::FoliageMode::default(),
                ground_plane_y_m: None,
                no_skip: BTreeSet::new(),
            },
            trace: TraceSummary { rays: 1000, rays_skipped_empty: 64, ..TraceSummary::default() },
            trace_lanes: BTreeSet::new(),
            beyond_reach: BeyondReach { instances: 3, faces: 30, rays_cut: 400 },
            error: Vec::new(),
            meshes: Vec::new(),
            foliage: kiln_core::FoliageSummary::default(),
            lods: kiln_core::LodSummary::default(),
            regions: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn rays_of_the_result_are_traced_or_known() {
        let report = rays(&summary(), 300);
        assert_eq!((&report["traced"], &report["saved_by"]["unchanged_work"]), (&json!(300), &json!(700)));
        assert_eq!((&report["saved_by"]["empty_hemisphere"], &report["cut_by"]["reach"]), (&json!(64), &json!(400)));
    }

    #[test]
    fn classes_without_a_face_are_absent() {
        let left_out = left_out(&summary());
        assert_eq!(left_out["absent_classes"], json!(["distant", "ignored", "shrub", "decorator", "instanced"]));
        assert_eq!(left_out["faces_out_of_reach"], 30);
    }
}
