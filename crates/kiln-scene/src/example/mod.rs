//! Example levels made by code, as the bytes of .glb files.
//!
//! There are four groups, told apart by the first word of the description: *level*, the courtyard; *part*, each
//! part of it as a level of its own; *oracle*, scenes whose AO is known in closed form at a point (see
//! [`oracles`]); and *case*, small files with one thing that tools must get right. All are in metres with y up;
//! faces are counter-clockwise seen from outside, every vertex has a normal, and hard edges are split.

mod builder;
mod case;
pub mod closed_form;
mod cutout;
mod level;
mod lods;
mod masonry;
mod oracle;
mod planted;
mod props;
mod quadrature;
mod round;
mod surface;

pub use case::{coincident, double_sided, empty, gpu_instancing, mirrored, quantized, triangle};
pub use lods::with_lods;
pub use oracle::{Oracle, RECEIVER_GAP_M, oracle, oracles};
pub use planted::planted;

type Entry = (&'static str, &'static str, fn() -> Vec<u8>);

const COUNT: usize = 25;

const EXAMPLES: [Entry; COUNT] = [
    (
        "courtyard",
        "level: a courtyard with arches, a closed room with a window, stairs, pillars, crates and a terrain edge",
        level::courtyard,
    ),
    ("arches", "part: an arcade of three bays with a gallery behind it", level::arches),
    ("room", "part: a closed room with one window", level::room_alone),
    ("stairs", "part: stairs beside a landing", level::stairs_alone),
    ("pillars", "part: six pillars of one mesh that carry beams and rafters", level::pillars),
    ("terrain", "part: the edge of a terrain that rises from a pavement", level::terrain_edge),
    ("crates", "part: crates that reach into one another and into the floor", level::crates),
    ("oracle_plane", "oracle: a plane without end, 2 m above the receiver", oracle::plane),
    ("oracle_sphere", "oracle: the inside of a sphere of radius 1 m", oracle::sphere_inside),
    ("oracle_wall", "oracle: a wall without end, 1 m from the probed point", oracle::wall),
    ("oracle_wall_finite", "oracle: a wall 3 m high, 1 m from the probed point", oracle::wall_finite),
    ("oracle_disk", "oracle: a disk of radius 1 m, 1 m above the receiver", oracle::disk_above),
    ("oracle_ball", "oracle: a ball of radius 1 m with its centre 2 m above the receiver", oracle::ball),
    ("oracle_box", "oracle: the inside of a closed room of 4 × 6 × 3 m", oracle::closed_box),
    ("oracle_cylinder", "oracle: the inside of a long tube of radius 1 m, probed on its axis", oracle::cylinder),
    ("mirrored", "case: one mesh under a negative and under a negative non-uniform scale", mirrored),
    ("coincident", "case: coincident opposite faces, and faces that are there twice", coincident),
    ("double_sided", "case: an open double-sided sheet over a floor", double_sided),
    ("gpu_instancing", "case: five instances of one node by EXT_mesh_gpu_instancing", gpu_instancing),
    ("quantized", "case: 16-bit positions and 8-bit normals by KHR_mesh_quantization", quantized),
    ("cutout", "case: a lattice as an alpha mask on plates around a floor", cutout::cutout),
    ("cutout_geometry", "case: the same lattice as geometry", cutout::cutout_geometry),
    ("empty", "case: a scene without a mesh", empty),
    ("triangle", "case: one triangle", triangle),
    ("lods", "level: the courtyard with lower levels of detail by MSFT_lod", lods::courtyard),
];

const NAMES: [(&str, &str); COUNT] = {
    let mut names = [("", ""); COUNT];
    let mut i = 0;
    while i < COUNT {
        names[i] = (EXAMPLES[i].0, EXAMPLES[i].1);
        i += 1;
    }
    names
};

/// Name and description of every example, the main one first; a description starts with its group.
pub fn names() -> &'static [(&'static str, &'static str)] {
    &NAMES
}

/// The .glb file of an example, or nothing if there is none of the name.
pub fn build(name: &str) -> Option<Vec<u8>> {
    EXAMPLES.iter().find(|example| example.0 == name).map(|(_, _, build)| build())
}

#[cfg(test)]
mod inspect;
#[cfg(test)]
mod surface_integral;
#[cfg(test)]
mod tests;
