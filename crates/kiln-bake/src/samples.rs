//! Sample points of a face: low-discrepancy positions, robust origins, shading normals.

use crate::scramble::{InstanceKey, Stream};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use kiln_core::Mesh;
use kiln_trace::{PositionError, SobolScramble, SurfaceSample, sobol_point};
use std::ops::Range;

/// Makes the samples of one instance's faces.
pub(crate) struct SampleMaker<'a> {
    mesh: &'a Mesh,
    world_from_object: &'a DAffine3,
    /// Takes object-space normals to world space, up to length.
    normal_matrix: DMat3,
    /// −1 for a mirroring transform.
    orientation: f64,
    error: PositionError,
    key: InstanceKey,
    rays_per_sample: u32,
}

/// New positions of halves of faces, one after the other, and the samples at them.
#[derive(Default)]
pub(crate) struct Batch {
    /// Positions of each half.
    pub(crate) counts: Vec<usize>,
    pub(crate) positions: Vec<Position>,
    pub(crate) samples: Vec<SurfaceSample>,
}

/// One position on a face.
pub(crate) struct Position {
    /// Barycentric coordinates.
    pub(crate) phi: [f64; 3],
    /// Samples at it, one for each side that receives: front, then back.
    pub(crate) sides: usize,
}

impl<'a> SampleMaker<'a> {
    pub(crate) fn new(mesh: &'a Mesh, world_from_object: &'a DAffine3, seed: u64, rays_per_sample: u32) -> Self {
        let orientation = orientation(world_from_object);
        let error = PositionError::new(world_from_object);
        let key = InstanceKey::new(world_from_object, seed);
        Self {
            mesh,
            world_from_object,
            normal_matrix: normal_matrix(world_from_object),
            orientation,
            error,
            key,
            rays_per_sample,
        }
    }

    /// Appends positions of one half of a face's samples, by their indices in its sequence; none if the face has no area in
    /// world space.
    pub(crate) fn half(&self, face: usize, half: usize, indices: Range<u32>, batch: &mut Batch) {
        if indices.is_empty() {
            return;
        }
        let Some(surface) = self.surface(face, half) else { return };
        let positions = self.key.face(self.mesh.corners(face)).scramble(half, Stream::Positions);
        for index in indices {
            let phi = barycentric(sobol_point(position_index(index), positions).map(f64::from));
            surface.add(phi, index * self.rays_per_sample, batch);
        }
    }

    /// Appends a given position on a face, the `index`th there; nothing if the face has no area in world space.
    pub(crate) fn position(&self, face: usize, phi: [f64; 3], index: u32, batch: &mut Batch) {
        if let Some(surface) = self.surface(face, 0) {
            surface.add(phi, index * self.rays_per_sample, batch);
        }
    }

    /// A face in world space; nothing if it has no area there.
    fn surface(&self, face: usize, half: usize) -> Option<FaceInWorld> {
        let object = self.mesh.corners(face);
        let corners = object.map(|c| self.world_from_object.transform_point3(c.as_dvec3()));
        let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let geometric = (cross * self.orientation).normalize_or_zero();
        if geometric == DVec3::ZERO {
            return None;
        }
        let [a, b, c] = object.map(Vec3::as_dvec3);
        let extent = (b - a).length().max((c - b).length()).max((a - c).length());
        // The bound grows with the coordinates, so that of their greatest on the face is one for all of its points.
        let furthest = corners.iter().fold(DVec3::ZERO, |most, corner| most.max(corner.abs()));
        let offset = geometric * self.error.bound(furthest, extent).dot(geometric.abs());
        let key = self.key.face(object);
        let directions = [Stream::FrontDirections, Stream::BackDirections].map(|stream| key.scramble(half, stream));
        let (normals, is_double_sided) = (self.corner_normals(face), self.mesh.group(face).double_sided);
        Some(FaceInWorld { corners, geometric, offset, normals, directions, is_double_sided })
    }

    /// The normals of a face's corners in world space, up to a common length, where all three have one.
    fn corner_normals(&self, face: usize) -> Option<[DVec3; 3]> {
        let normals = self.mesh.faces[face].map(|v| Vec3::from_array(self.mesh.normals[v as usize]).as_dvec3());
        (!normals.contains(&DVec3::ZERO)).then(|| normals.map(|normal| self.normal_matrix * normal))
    }
}

/// What the samples of a face have in common.
struct FaceInWorld {
    corners: [DVec3; 3],
    geometric: DVec3,
    /// From the face to the origins of rays on its front.
    offset: DVec3,
    normals: Option<[DVec3; 3]>,
    /// Of the front, and of the back.
    directions: [SobolScramble; 2],
    is_double_sided: bool,
}

impl FaceInWorld {
    /// Appends a position.
    fn add(&self, phi: [f64; 3], first_index: u32, batch: &mut Batch) {
        let [a, b, c] = self.corners;
        let point = a * phi[0] + b * phi[1] + c * phi[2];
        let shading = shading_normal(&self.normals, phi, self.geometric);
        let side = |sign: f64, scramble: SobolScramble| SurfaceSample {
            origin: (point + self.offset * sign).as_vec3(),
            normal: (shading * sign).as_vec3(),
            geometric: (self.geometric * sign).as_vec3(),
            scramble,
            first_index,
        };
        let [front, back] = self.directions;
        batch.samples.push(side(1.0, front));
        if self.is_double_sided {
            batch.samples.push(side(-1.0, back));
        }
        batch.positions.push(Position { phi, sides: 1 + usize::from(self.is_double_sided) });
    }
}

/// −1 for a mirroring transform, else 1.
fn orientation(world_from_object: &DAffine3) -> f64 {
    if world_from_object.matrix3.determinant() < 0.0 { -1.0 } else { 1.0 }
}

/// Takes object-space normals of fronts to world space, up to length, whether the transform mirrors or not.
pub(crate) fn normal_matrix(world_from_object: &DAffine3) -> DMat3 {
    let m = world_from_object.matrix3;
    // The cofactor matrix, det · inverse transpose, exists for every transform.
    let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    cofactor * orientation(world_from_object)
}

/// The interpolated normal where the corners have normals and it is on the geometric one's side.
fn shading_normal(corners: &Option<[DVec3; 3]>, phi: [f64; 3], geometric: DVec3) -> DVec3 {
    let Some([a, b, c]) = corners else { return geometric };
    let normal = (*a * phi[0] + *b * phi[1] + *c * phi[2]).normalize_or_zero();
    if normal.dot(geometric) > 0.0 { normal } else { geometric }
}

/// Column b is what bit b of a sample's index adds to the index of its position.
const COLUMNS: [u32; 14] =
    [0x0001, 0x0002, 0x0004, 0x0009, 0x0013, 0x0027, 0x006a, 0x00c1, 0x01b2, 0x034c, 0x075d, 0x0e87, 0x109b, 0x2be3];

/// Where in the sequence of positions a sample is taken whose directions are block `index` of the sequence of directions.
///
/// With one order for both, a part of the face would see a part of the sky: the lowest bit of the index is the half of
/// the face, and it is also the fifth digit of the directions' first coordinate. The means of faces would be right, their
/// slopes wrong by what the other directions hold, however many samples there are. This linear map over GF(2), upper
/// triangular with a unit diagonal, keeps the set of the first 2ᵏ positions, for every k, and was searched to make
/// positions and directions (16 a sample) one sequence of four dimensions: with up to 3 binary digits of the positions
/// fixed, directions are a net of quality t ≤ 3 for up to 2¹⁴ samples, where one order has t = k − 1.
fn position_index(index: u32) -> u32 {
    let column = |bit: u32| COLUMNS.get(bit as usize).copied().unwrap_or(1 << bit);
    let (mut rest, mut position) = (index, 0);
    while rest != 0 {
        position ^= column(rest.trailing_zeros());
        rest &= rest - 1;
    }
    position
}

/// Area-preserving map from the unit square to barycentric coordinates with little distortion (Heitz 2019, "A
/// low-distortion map between triangle and square").
fn barycentric([x, y]: [f64; 2]) -> [f64; 3] {
    let (u, v) = if y > x { (0.5 * x, y - 0.5 * x) } else { (x - 0.5 * y, 0.5 * y) };
    [u, v, 1.0 - u - v]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rank over GF(2) of rows of bits.
    fn rank(rows: &[u32]) -> usize {
        let mut basis: Vec<u32> = Vec::new();
        for row in rows {
            let rest = basis.iter().fold(*row, |row, of| row.min(row ^ of));
            if rest != 0 {
                basis.push(rest);
                basis.sort_unstable_by(|a, b| b.cmp(a));
            }
        }
        basis.len()
    }

    /// The digits of a Sobol point's two coordinates as linear functions of the bits of an index, the highest first.
    fn digits(bits: u32, map: impl Fn(u32) -> u32) -> [Vec<u32>; 2] {
        let unscrambled = |index: u32| kiln_trace::sobol_digits(map(index));
        let row = |axis: usize, digit: u32| {
            (0..bits).filter(|bit| unscrambled(1 << bit)[axis] >> (31 - digit) & 1 == 1).map(|bit| 1 << bit).sum()
        };
        [0, 1].map(|axis| (0..bits).map(|digit| row(axis, digit)).collect())
    }

    /// The least t such that in every part of a face, cut by as many digits of the positions' coordinates, the directions
    /// of 2ᵏ samples meet every elementary interval as often that is 2ᵗ times larger than the smallest possible.
    fn quality(k: u32, cut: [usize; 2], order: impl Fn(u32) -> u32) -> u32 {
        let bits = k + 4;
        let [x, y] = digits(bits, |index| order(index >> 4));
        let [u, v] = digits(bits, |index| index);
        let fixed = [&x[..cut[0]], &y[..cut[1]]].concat();
        let free = bits as usize - fixed.len();
        let is_net = |digits: usize| {
            (0..=digits).all(|first| {
                let rows = [&fixed, &u[..first], &v[..digits - first]].concat();
                rank(&rows) == rows.len()
            })
        };
        (0..=free).find(|t| is_net(free - t)).map_or(u32::MAX, |t| u32::try_from(t).expect("few digits"))
    }

    #[test]
    fn every_part_of_a_face_sees_every_part_of_the_sky() {
        for k in 3..=11 {
            for cut in [[1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3]] {
                let t = quality(k, cut, position_index);
                assert!(t <= 3, "2^{k} samples, {cut:?}: {t}");
            }
            assert_eq!(quality(k, [1, 0], |index| index), k - 1, "one order for both");
        }
    }

    #[test]
    fn the_first_positions_are_the_same_in_another_order() {
        for k in 0..12 {
            let mut seen: Vec<u32> = (0..1 << k).map(position_index).collect();
            seen.sort_unstable();
            assert!(seen.into_iter().eq(0..1 << k));
        }
    }

    #[test]
    fn barycentric_coordinates_are_uniform() {
        // Over a triangle: E[φ_i] = 1/3, E[φ_i²] = 1/6, E[φ_i φ_j] = 1/12.
        let n = 400;
        let mut sums = [0.0; 6];
        for i in 0..n * n {
            let phi = barycentric([(f64::from(i % n) + 0.5) / f64::from(n), (f64::from(i / n) + 0.5) / f64::from(n)]);
            assert!(phi.iter().all(|p| (0.0..=1.0).contains(p)));
            let products = [phi[0], phi[1], phi[2], phi[0] * phi[0], phi[2] * phi[2], phi[0] * phi[1]];
            sums.iter_mut().zip(products).for_each(|(sum, p)| *sum += p / f64::from(n * n));
        }
        for (sum, expected) in sums.iter().zip([1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 12.0]) {
            assert!((sum - expected).abs() < 1e-5, "{sums:?}");
        }
    }
}
