//! Small things that example levels place many times, and terrain.

use super::round::turned;
use super::surface::{Surface, lines};
use glam::{DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Height of a pillar above its foot.
pub(super) const PILLAR_HEIGHT: f64 = 3.0;

/// A pillar about the y axis: a plinth sunk into the floor, a turned shaft, and a slab on top. Three closed pieces.
pub(super) fn pillar() -> Surface {
    let side = |half: f64| lines(-half, half, half);
    let mut pillar = Surface::block(&side(0.35), &[-0.03, 0.0, 0.2], &side(0.35));
    pillar.append(&Surface::block(&side(0.38), &[2.8, PILLAR_HEIGHT], &side(0.38)));
    let arc = |points: u32, at: &dyn Fn(f64) -> DVec2| -> Vec<DVec2> {
        (0..=points).map(|i| at(f64::from(i) / f64::from(points))).collect()
    };
    // A round moulding, a shaft that narrows, and a neck that widens; both ends reach into the blocks.
    let foot = arc(5, &|s| DVec2::new(0.27 + 0.06 * (PI * s).sin(), 0.19 + 0.15 * s));
    let shaft = arc(7, &|s| DVec2::new(0.26 - 0.05 * s * s, 0.34 + 2.21 * s));
    let neck = arc(4, &|s| DVec2::new(0.21 + 0.13 * (1.0 - (FRAC_PI_2 * s).cos()), 2.55 + 0.26 * s));
    let ledge = |from: &[DVec2], to: &[DVec2]| vec![from[from.len() - 1], to[0]];
    let runs = [foot.clone(), ledge(&foot, &shaft), shaft, neck];
    pillar.append(&turned(&runs, 20));
    pillar
}

/// A crate of one metre about the y axis, standing on y = 0, with a frame and sunk panels. Closed.
pub(super) fn wooden_crate() -> Surface {
    let across = [-0.5, -0.46, -0.4, 0.0, 0.4, 0.46, 0.5];
    let up = across.map(|v| v + 0.5);
    Surface::solid([&across, &up, &across], |p| {
        let p = (p - DVec3::Y * 0.5).abs();
        let within_frame = p.to_array().map(|c| c < 0.4);
        let outer_layer = p.max_element() > 0.46;
        // A panel is where two coordinates lie within the frame and the third in the outer layer.
        !(outer_layer && within_frame.iter().filter(|&&within| within).count() == 2)
    })
}

/// A beam along x from the origin, with its lower side at y = 0 and centred on z = 0.
pub(super) fn beam(length: f64, height: f64, width: f64) -> Surface {
    Surface::block(&lines(0.0, length, 0.5), &[0.0, height], &lines(-0.5 * width, 0.5 * width, 0.5))
}

/// Ground around a rectangle that is built on: level at its foot, then an edge that rises steeply to rolling land.
pub(super) struct Terrain {
    /// Least x and z of the rectangle, metres.
    pub(super) min: DVec2,
    /// Greatest x and z of the rectangle, metres.
    pub(super) max: DVec2,
    /// Least and greatest x and z of a paved rectangle within it, under which there is no ground, metres.
    pub(super) paved: [DVec2; 2],
}

/// Depth of the ground below the pavement.
const GROUND: f64 = -0.12;

impl Terrain {
    /// The ground's height at a point.
    fn height(&self, p: DVec2) -> f64 {
        let outside = (self.min - p).max(p - self.max).max(DVec2::ZERO).length();
        let edge = 1.6 + 0.4 * (0.31 * p.x + 0.6).sin() + 0.3 * (0.23 * p.y).cos();
        let start = 3.0 + 0.8 * (0.4 * p.x).sin() * (0.33 * p.y).cos();
        let rolling = 0.35 * (0.55 * p.x + 0.4 * p.y).sin() + 0.25 * (0.7 * p.y - 0.3 * p.x).sin() + 0.6;
        GROUND + edge * smooth_step(start, start + 2.8, outside) + rolling * smooth_step(3.5, 12.0, outside)
    }

    /// The surface over a grid, without the cells whose middle is more than a metre within the pavement.
    pub(super) fn surface(&self, xs: &[f64], zs: &[f64]) -> Surface {
        let point = |z: f64, x: f64| {
            let height = |dx: f64, dz: f64| self.height(DVec2::new(x + dx, z + dz));
            // About as wide as a cell, so that the normal is that of the mesh rather than of the formula.
            let step = 0.4;
            let slope_x = (height(step, 0.0) - height(-step, 0.0)) / (2.0 * step);
            let slope_z = (height(0.0, step) - height(0.0, -step)) / (2.0 * step);
            (DVec3::new(x, height(0.0, 0.0), z), DVec3::new(-slope_x, 1.0, -slope_z).normalize())
        };
        Surface::patch_where(zs, xs, point, |z, x| {
            let p = DVec2::new(x, z);
            let [min, max] = self.paved;
            (min - p).max(p - max).max_element() > -1.0
        })
    }
}

/// 0 before `from`, 1 after `to`, a cubic between.
fn smooth_step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
