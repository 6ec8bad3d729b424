//! Cleaning of a mesh's faces, on Kiln's own copy: faces without area and, by default, repeated faces go, and the rest is put
//! into an order that depends on nothing but the geometry.
//!
//! Each face is turned so that it starts at its corner with the least position bits (the winding stays), and faces
//! are sorted by the 63-bit Morton code of their centroid within the mesh's bounds, then by the position bits of
//! their corners, group and vertices. So a permutation of the source's faces, or of the corners of one, gives the
//! same mesh, a contiguous run of faces is compact, and faces that repeat one another are neighbours. Faces with other texture
//! coordinates, where these have a say, are others.

use crate::limits;
use glam::DVec3;
use kiln_core::Bounds;
use rayon::slice::ParallelSliceMut;

/// A face is without area if twice its area is at most this part of its longest edge squared. Positions have 24
/// bits, so a face that is thinner than 2⁻³⁰ of its length is a line as far as its own positions tell.
const FLATNESS: f64 = 1.0 / (1u64 << 30) as f64;

/// A face of the source: vertices and group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Face {
    pub(crate) vertices: [u32; 3],
    pub(crate) group: u16,
    /// Which of all [`Coordinates`] are its own.
    pub(crate) coordinates: u16,
}

/// Texture coordinates of runs of vertices, for the faces that refer to them.
#[derive(Debug, Default)]
pub(crate) struct Coordinates {
    /// The run's first vertex, and its coordinates; a face refers to them by the index plus one.
    runs: Vec<(u32, Vec<[f32; 2]>)>,
    count: u64,
}

impl Coordinates {
    /// What a face refers to whose texture coordinates have no say.
    pub(crate) const NONE: u16 = 0;

    /// Adds those of a run of vertices, and returns what faces refer to them by; or how many there would be, if that is too
    /// many.
    pub(crate) fn add(&mut self, first_vertex: u32, values: Vec<[f32; 2]>) -> Result<u16, u64> {
        let run = (first_vertex, values);
        let known = self.runs.iter().position(|known| *known == run);
        let index = known.unwrap_or(self.runs.len());
        if known.is_none() {
            self.count += run.1.len() as u64;
            self.runs.push(run);
        }
        let reference = u16::try_from(index + 1).map_err(|_| self.count)?;
        if self.count <= limits::VERTICES { Ok(reference) } else { Err(self.count) }
    }

    /// Of the corners of a face, in their order; zeros where they have no say.
    pub(crate) fn of(&self, face: &Face) -> [[f32; 2]; 3] {
        let run = usize::from(face.coordinates).checked_sub(1).and_then(|index| self.runs.get(index));
        let of = |vertex: u32| run.and_then(|(first, values)| values.get((vertex - first) as usize)).copied();
        face.vertices.map(|vertex| of(vertex).unwrap_or_default())
    }
}

/// Clean faces, and how many were left out.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Cleaned {
    pub(crate) faces: Vec<Face>,
    /// Bounds of the clean faces.
    pub(crate) bounds: Option<Bounds>,
    pub(crate) degenerate: u64,
    pub(crate) duplicate: u64,
}

/// Cleans and sorts; faces that repeat others may stay. All vertices of the faces must be in range and finite.
pub(crate) fn clean(
    positions: &[[f32; 3]],
    coordinates: &Coordinates,
    mut faces: Vec<Face>,
    keep_duplicates: bool,
) -> Cleaned {
    let source_count = faces.len();
    faces.retain(|face| !is_degenerate(positions, face));
    let degenerate = (source_count - faces.len()) as u64;
    if faces.is_empty() {
        return Cleaned { degenerate, ..Cleaned::default() };
    }
    let mut bounds = Bounds::EMPTY;
    for face in &mut faces {
        face.vertices = rotated(positions, face.vertices);
        face.vertices.iter().for_each(|&vertex| bounds.add(position(positions, vertex)));
    }
    let mut keyed: Vec<(u64, Face)> =
        faces.iter().map(|face| (morton(&centroid(positions, face), &bounds), *face)).collect();
    let corners = |face: &Face| face.vertices.map(|vertex| bits(positions, vertex));
    let texture = |face: &Face| coordinates.of(face).map(|corner| corner.map(f32::to_bits));
    keyed.par_sort_unstable_by(|(code_a, a), (code_b, b)| {
        let order = code_a.cmp(code_b).then_with(|| (corners(a), a.group).cmp(&(corners(b), b.group)));
        order.then_with(|| (texture(a), a.vertices, a.coordinates).cmp(&(texture(b), b.vertices, b.coordinates)))
    });
    let sorted_count = keyed.len();
    keyed.dedup_by(|(_, next), (_, kept)| {
        let is_same = next.group == kept.group && corners(next) == corners(kept) && texture(next) == texture(kept);
        !keep_duplicates && is_same
    });
    let duplicate = (sorted_count - keyed.len()) as u64;
    Cleaned { faces: keyed.into_iter().map(|(_, face)| face).collect(), bounds: Some(bounds), degenerate, duplicate }
}

fn position(positions: &[[f32; 3]], vertex: u32) -> DVec3 {
    DVec3::from(positions[vertex as usize].map(f64::from))
}

/// The bits of a position; the two zeros count as one.
fn bits(positions: &[[f32; 3]], vertex: u32) -> [u32; 3] {
    positions[vertex as usize].map(|coordinate| (coordinate + 0.0).to_bits())
}

fn is_degenerate(positions: &[[f32; 3]], face: &Face) -> bool {
    let [a, b, c] = face.vertices.map(|vertex| position(positions, vertex));
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let longest = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
    ab.cross(ac).length() <= FLATNESS * longest
}

/// The vertices of a face, from the one with the least position bits on.
fn rotated(positions: &[[f32; 3]], vertices: [u32; 3]) -> [u32; 3] {
    let least = (0..3).min_by_key(|&corner| bits(positions, vertices[corner])).unwrap_or(0);
    std::array::from_fn(|corner| vertices[(least + corner) % 3])
}

fn centroid(positions: &[[f32; 3]], face: &Face) -> DVec3 {
    let [a, b, c] = face.vertices.map(|vertex| position(positions, vertex));
    (a + b + c) / 3.0
}

/// The Morton code (z-order) of a point within bounds: 21 bits for each axis, x lowest.
fn morton(point: &DVec3, bounds: &Bounds) -> u64 {
    const CELLS: f64 = (1u64 << 21) as f64;
    let size = bounds.max - bounds.min;
    let fraction = (*point - bounds.min) / DVec3::select(size.cmpgt(DVec3::ZERO), size, DVec3::ONE);
    let cell = (fraction * CELLS).clamp(DVec3::ZERO, DVec3::splat(CELLS - 1.0));
    spread(cell.x as u64) | spread(cell.y as u64) << 1 | spread(cell.z as u64) << 2
}

/// Moves bit i of a 21-bit number to bit 3 i.
const fn spread(x: u64) -> u64 {
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn face(vertices: [u32; 3]) -> Face {
        Face { vertices, group: 0, coordinates: Coordinates::NONE }
    }

    #[test]
    fn bits_are_spread() {
        for x in [0u64, 1, 0b101, 0x1f_ffff, 0x12_3456] {
            let expected = (0..21).fold(0, |sum, bit| sum | (x >> bit & 1) << (3 * bit));
            assert_eq!(spread(x), expected);
        }
    }

    #[test]
    fn degeneracy_does_not_depend_on_scale() {
        for scale in [1e-18f32, 1.0, 1e18] {
            let positions = [[0.0, 0.0, 0.0], [scale, 0.0, 0.0], [0.0, scale * 1e-4, 0.0], [scale * 2.0, 0.0, 0.0]];
            let faces = vec![face([0, 1, 2]), face([0, 1, 3]), face([0, 1, 1])];
            let cleaned = clean(&positions, &Coordinates::default(), faces, false);
            assert_eq!((cleaned.faces.len(), cleaned.degenerate), (1, 2), "{scale}");
        }
    }

    #[test]
    fn repeated_corners_by_position() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-0.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let cleaned =
            clean(&positions, &Coordinates::default(), vec![face([0, 1, 2]), face([0, 1, 3]), face([3, 2, 1])], false);
        assert_eq!((cleaned.degenerate, cleaned.duplicate), (1, 1));
        assert_eq!(cleaned.faces, [face([0, 1, 3])]);
    }

    #[test]
    fn facing_and_group_tell_faces_apart() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let other_group = Face { group: 1, ..face([1, 2, 0]) };
        let faces = vec![face([0, 1, 2]), face([2, 0, 1]), face([1, 0, 2]), other_group];
        let cleaned = clean(&positions, &Coordinates::default(), faces.clone(), false);
        assert_eq!((cleaned.faces.len(), cleaned.duplicate), (3, 1));
        let all = clean(&positions, &Coordinates::default(), faces, true);
        assert_eq!((all.faces.len(), all.duplicate), (4, 0));
    }

    #[test]
    fn texture_coordinates_tell_faces_apart_and_stay_with_their_corners() {
        let positions = [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let mut coordinates = Coordinates::default();
        let uv = [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]];
        let [one, again, mirrored] =
            [uv, uv, uv.map(|[u, v]| [1.0 - u, v])].map(|uv| coordinates.add(0, uv.to_vec()).unwrap());
        assert!(one == again && one != mirrored && one != Coordinates::NONE);
        let of = |coordinates| Face { coordinates, ..face([0, 1, 2]) };
        let cleaned = clean(&positions, &coordinates, vec![of(mirrored), of(one), of(again), of(one)], false);
        assert_eq!((cleaned.faces.len(), cleaned.duplicate), (2, 2));
        for face in &cleaned.faces {
            let expected = face.vertices.map(|vertex| uv[vertex as usize]);
            let expected = if face.coordinates == one { expected } else { expected.map(|[u, v]| [1.0 - u, v]) };
            assert_eq!(coordinates.of(face), expected);
        }
    }

    proptest! {
        #[test]
        fn order_of_the_source_does_not_matter(
            positions in proptest::collection::vec(prop::array::uniform3(-3i8..4), 3..12),
            corners in proptest::collection::vec((any::<[u8; 3]>(), 0u16..2), 1..40),
            seed in any::<u64>(),
        ) {
            let positions: Vec<[f32; 3]> = positions.iter().map(|p| p.map(f32::from)).collect();
            let vertex = |index: u8| u32::from(index) % positions.len() as u32;
            let faces: Vec<Face> =
                corners.iter().map(|&(c, group)| Face { group, ..face(c.map(vertex)) }).collect();
            let mut shuffled = faces.clone();
            let mut state = seed;
            for i in (1..shuffled.len()).rev() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                shuffled.swap(i, (state >> 33) as usize % (i + 1));
                shuffled[i].vertices.rotate_left((state >> 20) as usize % 3);
            }
            let cleaned = clean(&positions, &Coordinates::default(), faces.clone(), false);
            prop_assert_eq!(&cleaned, &clean(&positions, &Coordinates::default(), shuffled, false));
            let all = cleaned.faces.len() as u64 + cleaned.degenerate + cleaned.duplicate;
            prop_assert_eq!(all, faces.len() as u64);
        }
    }
}
