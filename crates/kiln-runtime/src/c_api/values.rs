//! Static geometry, trees, shrubs, and what is stored in five bits.

use super::{KILN_MAX_CHANNELS, KilnPack, KilnStatus, floats, give, opened, optional, status};
use crate::{Values, dequantise, dither, quantise, tree_ao};

/// Values of vertices: vertex by vertex, in it channel by channel.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct KilnValues {
    /// As they are stored; they stay as long as the pack's bytes.
    pub bytes: *const u8,
    /// Their size.
    pub size: usize,
    /// Number of vertices.
    pub vertex_count: u32,
    /// Whether they are 32-bit floats; else normalised 16-bit integers.
    pub is_f32: bool,
}

impl KilnValues {
    fn of(values: Values<'_>) -> Self {
        let bytes = values.bytes();
        let vertex_count = values.vertex_count() as u32;
        Self { bytes: bytes.as_ptr(), size: bytes.len(), vertex_count, is_f32: values.is_f32() }
    }
}

/// An instance of a model of trees.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KilnTree {
    /// Four numbers for each channel.
    pub numbers: [[f32; 4]; KILN_MAX_CHANNELS],
    /// Those of the blend.
    pub blend: [f32; 4],
    /// Centre of the model's box, in its mesh's space.
    pub center: [f32; 3],
    /// Half of the box's size.
    pub half_extent: [f32; 3],
    /// Index of the model.
    pub model: u32,
    /// Index of its mesh in the source.
    pub mesh: u32,
    /// How many primitives of it have local AO.
    pub block_count: u32,
}

/// Values of a primitive's vertices on a node, or on an instance of EXT_mesh_gpu_instancing, else KILN_NONE.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `values` to a KilnValues.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_vertex_values(
    pack: *const KilnPack,
    node: u32,
    gpu_instance: u32,
    primitive: u32,
    values: *mut KilnValues,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let pack = unsafe { opened(pack) }?;
        let set = pack.vertex_set(node, optional(gpu_instance), primitive).ok_or(KilnStatus::NotFound)?;
        // SAFETY: the caller's promise.
        unsafe { give(values, KilnValues::of(set.values)) }
    })
}

/// The tree at a node, or at an instance of EXT_mesh_gpu_instancing, else KILN_NONE.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `tree` to a KilnTree.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_tree(
    pack: *const KilnPack,
    node: u32,
    gpu_instance: u32,
    tree: *mut KilnTree,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let pack = unsafe { opened(pack) }?;
        let found = pack.tree_instance(node, optional(gpu_instance)).ok_or(KilnStatus::NotFound)?;
        let model = pack.tree_model(found.model).ok_or(KilnStatus::NotFound)?;
        let value = KilnTree {
            numbers: core::array::from_fn(|channel| found.numbers(channel).unwrap_or_default()),
            blend: found.blend(),
            center: model.center,
            half_extent: model.half_extent,
            model: found.model,
            mesh: model.mesh,
            block_count: model.block_count(),
        };
        // SAFETY: the caller's promise.
        unsafe { give(tree, value) }
    })
}

/// Local AO of a primitive of a model of trees: the `block`-th that has some, and which it is.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `primitive` to a number, `values` to a KilnValues.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_tree_values(
    pack: *const KilnPack,
    model: u32,
    block: u32,
    primitive: *mut u32,
    values: *mut KilnValues,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let pack = unsafe { opened(pack) }?;
        let model = pack.tree_model(model).ok_or(KilnStatus::NotFound)?;
        let block = pack.tree_block(&model, block).ok_or(KilnStatus::NotFound)?;
        // SAFETY: the caller's promise.
        unsafe {
            give(primitive, block.primitive)?;
            give(values, KilnValues::of(block.values))
        }
    })
}

/// AO of a vertex of a tree from its local AO, the instance's four numbers, and its place (three floats) in the model's box:
/// (position − center) / half_extent. 0 where a pointer is null.
///
/// # Safety
/// `numbers` points to four floats, `place` to three.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_tree_ao(local: f32, numbers: *const f32, place: *const f32) -> f32 {
    // SAFETY: the caller's promise.
    let given = unsafe { (floats(numbers), floats(place)) };
    if let (Ok(numbers), Ok(place)) = given { tree_ao(local, numbers, place) } else { 0.0 }
}

/// AO of the shrub or decorator at a node, or at an instance of EXT_mesh_gpu_instancing, else KILN_NONE: one value for each
/// channel, 0 for channels that are not there.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `values` to KILN_MAX_CHANNELS floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_scalar(
    pack: *const KilnPack,
    node: u32,
    gpu_instance: u32,
    values: *mut f32,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let pack = unsafe { opened(pack) }?;
        let scalar = pack.scalar(node, optional(gpu_instance)).ok_or(KilnStatus::NotFound)?;
        let value: [f32; KILN_MAX_CHANNELS] = core::array::from_fn(|channel| scalar.ao(channel).unwrap_or_default());
        // SAFETY: the caller's promise.
        unsafe { give(values.cast(), value) }
    })
}

/// The dither of a pixel in a frame, a fraction of 2³²; frame 0 for a pattern that stands still.
#[unsafe(no_mangle)]
pub extern "C" fn kiln_dither(x: u32, y: u32, frame: u32) -> u32 {
    dither(x, y, frame)
}

/// AO in 31 steps, 0 to 31, rounded up or down by a dither; 0x80000000 gives the nearest.
#[unsafe(no_mangle)]
pub extern "C" fn kiln_quantise(ao: f32, dither: u32) -> u32 {
    quantise(ao, dither)
}

/// AO of 0 to 31 steps.
#[unsafe(no_mangle)]
pub extern "C" fn kiln_dequantise(steps: u32) -> f32 {
    dequantise(steps)
}
