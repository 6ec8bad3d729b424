//! Random numbers keyed by content: by a face's corners, its instance's transform and the seed, and by nothing else.
//! An edit elsewhere, another order of faces, another batch or another worker leaves them as they are.

use glam::{DAffine3, DVec3, Vec3};
use kiln_core::DigestBuilder;
use kiln_trace::SobolScramble;

/// The part of the key that all faces of an instance share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InstanceKey(u64);

/// What a stream of numbers is for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Stream {
    Positions,
    FrontDirections,
    BackDirections,
}

impl InstanceKey {
    pub(crate) fn new(world_from_object: &DAffine3, seed: u64) -> Self {
        let mut builder = DigestBuilder::new("kiln scramble");
        builder.integer(seed);
        for value in world_from_object.to_cols_array() {
            builder.float(value);
        }
        let bytes = builder.finish().0;
        Self(u64::from_le_bytes(std::array::from_fn(|i| bytes[i])))
    }

    /// Key of a face, by its corners in object space in the mesh's canonical order.
    pub(crate) fn face(self, corners: [Vec3; 3]) -> FaceKey {
        self.of(&corners)
    }

    /// Key of a vertex, by its position in object space.
    pub(crate) fn vertex(self, position: Vec3) -> FaceKey {
        self.of(&[position])
    }

    fn of(self, points: &[Vec3]) -> FaceKey {
        let coordinates = points.iter().flat_map(Vec3::to_array).map(|x| u64::from((x + 0.0).to_bits()));
        FaceKey(coordinates.fold(self.0, |key, bits| mix(key ^ bits)))
    }
}

/// The scramble of the directions about a point that belongs to no instance, by its place in the level.
pub(crate) fn point_scramble(point: DVec3, seed: u64) -> SobolScramble {
    InstanceKey::new(&DAffine3::from_translation(point), seed).vertex(Vec3::ZERO).scramble(0, Stream::FrontDirections)
}

/// The key of one face, or one vertex, of one instance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FaceKey(u64);

impl FaceKey {
    /// The scramble of one half's positions or directions. The two halves are independent.
    pub(crate) fn scramble(self, half: usize, stream: Stream) -> SobolScramble {
        let bits = mix(self.0 ^ (2 * stream as u64 + half as u64 + 1));
        SobolScramble([bits as u32, (bits >> 32) as u32])
    }
}

/// The part of the key that all voxels of a lattice share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LatticeKey(u64);

impl LatticeKey {
    pub(crate) fn new(spacing_m: f64, seed: u64) -> Self {
        let bytes = DigestBuilder::new("kiln voxel scramble").integer(seed).float(spacing_m).finish().0;
        Self(u64::from_le_bytes(std::array::from_fn(|i| bytes[i])))
    }

    /// The scramble of the directions of a voxel, by its coordinates in the lattice.
    pub(crate) fn voxel(self, coordinates: [i32; 3]) -> SobolScramble {
        let bits = coordinates.iter().fold(self.0, |key, x| mix(key ^ u64::from(x.cast_unsigned())));
        SobolScramble([bits as u32, (bits >> 32) as u32])
    }
}

/// A bijection of 64-bit words whose outputs pass for random: the finaliser of splitmix64 (Steele, Lea and Flood
/// 2014), after an odd increment.
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_of_the_key_counts() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let here = DAffine3::IDENTITY;
        let there = DAffine3::from_translation(DVec3::X * 1e-9);
        let of = |place: &DAffine3, seed, corners, half, stream| {
            InstanceKey::new(place, seed).face(corners).scramble(half, stream).0
        };
        let base = of(&here, 1, corners, 0, Stream::Positions);
        assert_eq!(base, of(&here, 1, corners, 0, Stream::Positions));
        assert_ne!(base, of(&there, 1, corners, 0, Stream::Positions));
        assert_ne!(base, of(&here, 2, corners, 0, Stream::Positions));
        assert_ne!(base, of(&here, 1, [Vec3::ZERO, Vec3::Y, Vec3::X], 0, Stream::Positions));
        assert_ne!(base, of(&here, 1, corners, 1, Stream::Positions));
        assert_ne!(base, of(&here, 1, corners, 0, Stream::FrontDirections));
        assert_ne!(base, of(&here, 1, corners, 0, Stream::BackDirections));
        assert_eq!(base, of(&here, 1, [Vec3::new(-0.0, 0.0, 0.0), Vec3::X, Vec3::Y], 0, Stream::Positions));
        assert_ne!(point_scramble(DVec3::X, 1), point_scramble(DVec3::X, 2));
        assert_ne!(point_scramble(DVec3::X, 1), point_scramble(DVec3::X * (1.0 + 1e-15), 1));
        assert_eq!(point_scramble(DVec3::X, 1), point_scramble(DVec3::new(1.0, -0.0, 0.0), 1));
    }

    #[test]
    fn voxels_have_directions_of_their_own() {
        let of = |spacing, seed, voxel| LatticeKey::new(spacing, seed).voxel(voxel).0;
        let base = of(1.0, 3, [1, 2, 3]);
        assert_eq!(base, of(1.0, 3, [1, 2, 3]));
        for other in [of(0.5, 3, [1, 2, 3]), of(1.0, 4, [1, 2, 3]), of(1.0, 3, [1, 3, 2]), of(1.0, 3, [-1, 2, 3])] {
            assert_ne!(base, other);
        }
    }
}
