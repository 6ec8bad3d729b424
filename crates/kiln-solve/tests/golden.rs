//! The bits of one solve, which keys of stored results rely on.

mod shapes;

use glam::{DAffine3, DVec3};
use kiln_core::{ComponentMethod, Digest, TaskKind};
use kiln_solve::SolverParams;
use shapes::*;

/// Revision of solves, and the digest of the values that it gives for [`values`].
const GOLDEN: (u32, &str) = (4, "f0a06cf9acefc1fcbd01b6e42969da20e8050b623bb03a0d1e56d6d77eb292dd");

/// Two components with a hole, a seam and noise, one of them by conjugate gradients and one dense: what this
/// crate computes itself, and so the same on every machine.
fn values() -> Vec<u8> {
    let mut mesh = jittered(12);
    let small = mesh.positions.len() as u32;
    let corner = grid(&steps(5), &steps(5));
    mesh.positions.extend(corner.positions.iter().map(|p| [p[0] + 20.0, p[1], 0.25 * p[0] * p[1]]));
    mesh.positions.push(mesh.positions[small as usize + 24]);
    mesh.normals = vec![[0.0, 0.0, 1.0]; mesh.positions.len()];
    mesh.faces.extend(corner.faces.iter().map(|f| f.map(|v| v + small)));
    mesh.faces.last_mut().expect("the grid has faces")[2] = small + 25;
    mesh.face_group.resize(mesh.faces.len(), 0);
    let polynomial = |p: DVec3| (0.2 + 0.01 * p.x * p.y - 0.002 * p.x * p.x).clamp(0.0, 1.0);
    let samples = moments(&mesh, 3, |s| {
        let hole = s.point.x < 12.0 && s.point.distance(DVec3::new(5.0, 5.0, 0.0)) < 2.5;
        (!hole).then(|| 0.9 * polynomial(s.point) + 0.1 * noise(s.face as u64 ^ (s.number << 32)))
    });
    let params = SolverParams { dense_limit: 64, ..SolverParams::default() };
    let solution = solve_at(&mesh, &samples, &settings(1.0, 1e-3), DAffine3::IDENTITY, &params);
    assert_eq!(solution.summary.methods, [(ComponentMethod::Dense, 1), (ComponentMethod::Pcg, 1)]);
    assert_eq!(solution.summary.unknowns, 144 + 25);
    solution.values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn results_change_only_with_the_revision() {
    let found = (TaskKind::Solve.kernel_rev(), Digest::of(&values()).to_string());
    assert_eq!(
        (found.0, found.1.as_str()),
        GOLDEN,
        "solves give other values: raise TaskKind::Solve's kernel_rev and put both here"
    );
}
