//! How far the models of neighbours are apart where their regions meet.

use super::held_out::{Rmse, ao};
use glam::DVec3;
use kiln_core::{Level, RegionEdge};
use kiln_runtime::TemporalBlend;

/// Frames of a second.
const FRAMES_PER_SEC: f32 = 60.0;

/// Jumps, root mean squares.
pub(super) struct Jumps {
    pub(super) boundaries: usize,
    pub(super) fitted: Rmse,
    pub(super) smoothed: Rmse,
    /// The greatest change in a frame when an object passes, with blending over time.
    pub(super) blended: Rmse,
}

impl Jumps {
    /// By two kinds of models, which give all coefficients at a point of a region.
    pub(super) fn measure(
        level: &Level,
        fitted: impl Fn(usize, DVec3) -> Vec<f64>,
        smoothed: impl Fn(usize, DVec3) -> Vec<f64>,
    ) -> Self {
        let edges = &level.regions.edges;
        let channels = level.sampling.kernel.channel_count();
        let rms = |change: &dyn Fn(&RegionEdge, usize, DVec3) -> f64| {
            let area: f64 = edges.iter().map(|edge| edge.area_m2).sum();
            let of_channel = |channel: usize| {
                let squares = edges.iter().map(|edge| {
                    let of_normals = normals().map(|normal| change(edge, channel, normal).powi(2)).sum::<f64>() / 6.0;
                    edge.area_m2 * of_normals
                });
                (squares.sum::<f64>() / area.max(f64::MIN_POSITIVE)).sqrt()
            };
            Rmse((0..channels).map(of_channel).collect())
        };
        let both = |model: &dyn Fn(usize, DVec3) -> Vec<f64>, edge: &RegionEdge, channel: usize, normal: DVec3| {
            edge.regions.map(|region| ao(&model(region as usize, edge.center), channel, normal))
        };
        let jump = |[a, b]: [f64; 2]| a - b;
        Self {
            boundaries: edges.len(),
            fitted: rms(&|edge, channel, normal| jump(both(&fitted, edge, channel, normal))),
            smoothed: rms(&|edge, channel, normal| jump(both(&smoothed, edge, channel, normal))),
            blended: rms(&|edge, channel, normal| greatest_step(both(&smoothed, edge, channel, normal))),
        }
    }
}

/// The greatest change from frame to frame when what is seen jumps from one value to another.
fn greatest_step([before, after]: [f64; 2]) -> f64 {
    let (blend, mut shown, mut greatest) = (TemporalBlend::default(), [before as f32], 0.0f32);
    for _ in 0..FRAMES_PER_SEC as usize {
        let next = blend.blend(shown, [after as f32], 1.0 / FRAMES_PER_SEC);
        greatest = greatest.max((next[0] - shown[0]).abs());
        shown = next;
    }
    f64::from(greatest)
}

fn normals() -> impl Iterator<Item = DVec3> {
    DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis])
}
