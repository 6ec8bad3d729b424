//! Random numbers keyed by content: by a face's corners, its instance's transform and the seed, and by nothing else.
//! An edit elsewhere, another order of faces, another batch or another worker leaves them as they are.

use glam::{DAffine3, Vec3};
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
        let coordinates = corners.iter().flat_map(Vec3::to_array).map(|x| u64::from((x + 0.0).to_bits()));
        FaceKey(coordinates.fold(self.0, |key, bits| mix(key ^ bits)))
    }
}

/// The key of one face of one instance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FaceKey(u64);

impl FaceKey {
    /// The scramble of one half's positions or directions. The two halves are independent.
    pub(crate) fn scramble(self, half: usize, stream: Stream) -> SobolScramble {
        let bits = mix(self.0 ^ (2 * stream as u64 + half as u64 + 1));
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
    use glam::DVec3;

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
    }
}
