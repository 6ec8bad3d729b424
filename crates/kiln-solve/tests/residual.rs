//! Where a mesh is too coarse, by whole solves.

mod shapes;

use glam::{DAffine3, DVec3};
use kiln_core::SolveSettings;
use kiln_solve::SolverParams;
use shapes::*;

/// As if each sample had so many rays that its directions had no noise.
fn exact() -> SolveSettings {
    SolveSettings { rays_per_sample: 1 << 15, ..settings(1e-3, 1e-3) }
}

#[test]
fn a_linear_signal_leaves_nothing_and_a_step_is_found_where_it_is() {
    let mesh = grid(&steps(9), &steps(9));
    let linear = |p: DVec3| 0.1 + 0.05 * p.x + 0.03 * p.y;
    let solution = solve(&mesh, &moments(&mesh, 8, |s| Some(linear(s.point))), &exact());
    assert!(solution.residuals.iter().all(|r| *r < 2e-3), "{:?}", solution.residuals);
    assert_eq!(solution.summary.too_coarse.count, 0);

    // A step across the middle of the fourth column of faces, in a mesh four times as large in the world.
    let step = moments(&mesh, 64, |s| Some(f64::from(s.point.x > 3.5)));
    let world = DAffine3::from_scale(DVec3::splat(4.0));
    let solution = solve_at(&mesh, &step, &exact(), world, &SolverParams::default());
    let coarse = &solution.summary.too_coarse;
    let column = |x: f64| (3.0..=4.0).contains(&x);
    for face in &coarse.worst {
        let center = mesh.corners(face.face as usize).map(|c| f64::from(c.x)).iter().sum::<f64>() / 3.0;
        assert!(column(center) && (0.15..0.5).contains(&face.deviation), "{face:?}");
    }
    assert_eq!(coarse.count, 16);
    assert!((coarse.visible_area_m2 - 128.0).abs() < 1e-3, "{}", coarse.visible_area_m2);
    for (position, residual) in mesh.positions.iter().zip(&solution.residuals) {
        let x = f64::from(position[0]);
        assert!(
            if column(x) { *residual > 0.1 } else { *residual < 0.1 || (1.0..=6.0).contains(&x) },
            "{x}: {residual}"
        );
    }

    // What one ray finds says nothing of the mesh.
    let blind = solve(&mesh, &step, &SolveSettings { rays_per_sample: 1, ..exact() });
    assert!(blind.summary.too_coarse.count == 0 && blind.residuals.iter().all(|r| *r == 0.0));
}
