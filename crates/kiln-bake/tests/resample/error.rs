//! Least squares against reading at the vertices: which is nearer to the full mesh's values over the LOD's surface.

use crate::{
    lods::{read, solve},
    nearest::Nearest,
    shapes::{Full, bumpy_torus, detailed, sampling, terrain},
};
use glam::{DAffine3, DVec3, Vec3};
use kiln_bake::read_at_vertices;
use kiln_core::{FaceMoments, HalfMoments, Mesh};
use kiln_trace::{SobolScramble, sobol_point};

/// Points of a face that no sample is at.
const HELD_OUT: [[f64; 3]; 4] = [[0.34, 0.33, 0.33], [0.7, 0.2, 0.1], [0.1, 0.68, 0.22], [0.15, 0.15, 0.7]];

/// The full mesh's value at the point that is nearest to a point of a LOD's face.
fn truth(nearest: &Nearest<'_>, lod: &Mesh, face: usize, phi: [f64; 3]) -> f64 {
    nearest.value(lod.corners(face).iter().zip(phi).map(|(corner, phi)| corner.as_dvec3() * phi).sum())
}

/// Root of the mean square, over the surface of a LOD, of what its vertex values are off the truth.
fn error(nearest: &Nearest<'_>, lod: &Mesh, values: &[f32]) -> f64 {
    let (mut squares, mut areas) = (0.0, 0.0);
    for (face, vertices) in lod.faces.iter().enumerate() {
        let [a, b, c]: [DVec3; 3] = lod.corners(face).map(Vec3::as_dvec3);
        let area = (b - a).cross(c - a).length();
        for phi in HELD_OUT {
            let value: f64 =
                vertices.iter().zip(phi).map(|(vertex, phi)| f64::from(values[*vertex as usize]) * phi).sum();
            squares += area * (value - truth(nearest, lod, face, phi)).powi(2);
            areas += area;
        }
    }
    (squares / areas).sqrt()
}

/// Moments of the truth itself, at 12 points of each face.
fn true_moments(nearest: &Nearest<'_>, lod: &Mesh) -> FaceMoments {
    let mut moments = FaceMoments::new(1);
    for face in 0..lod.faces.len() {
        let mut halves = [HalfMoments::default(); 2];
        for index in 0..12 {
            let [x, y] = sobol_point(index, SobolScramble([face as u32, 77])).map(f64::from);
            let (x, y) = if x + y > 1.0 { (1.0 - x, 1.0 - y) } else { (x, y) };
            let phi = [1.0 - x - y, x, y];
            halves[index as usize % 2].add(phi, &[truth(nearest, lod, face, phi)]);
        }
        moments.push(&halves);
    }
    moments
}

/// Errors of least squares over what is read, of least squares over the truth, and of reading at the vertices.
fn errors(full: Mesh, lod: &Mesh) -> [f64; 3] {
    let here = DAffine3::IDENTITY;
    let full = Full::one(full, here, detailed);
    let nearest = Nearest::new(&full.parts[0].mesh, full.parts[0].values.as_ref().expect("values"));
    let fitted = solve(lod, &here, &read(&full, lod, &here, &sampling())).values;
    let best = solve(lod, &here, &true_moments(&nearest, lod)).values;
    let read = read_at_vertices(&full.tracer(), &full.baked(), lod, &here, 64, 7).expect("a CPU traces").values;
    [fitted, best, read].map(|values| error(&nearest, lod, &values))
}

#[test]
fn least_squares_beat_reading_at_vertices() {
    for (name, make, cells) in [("terrain", terrain as fn(u32) -> Mesh, 64), ("torus", bumpy_torus, 48)] {
        for part in [2, 4] {
            let [fitted, best, read] = errors(make(cells), &make(cells / part));
            println!("{name} 1/{part}: least squares {fitted:.5}, of the truth {best:.5}, at vertices {read:.5}");
            assert!(fitted < 0.9 * read, "{name} 1/{part}: {fitted} {read}");
            assert!(fitted < 1.03 * best, "{name} 1/{part}: {fitted} {best}");
        }
    }
}
