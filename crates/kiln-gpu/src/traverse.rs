//! A scene on the device; the host side of `scene.wgsl`, `stack.wgsl` and `traverse.wgsl`. [`crate::ray_query`] is the other way of traversal.
//!
//! # Data
//!
//! One array of words of 16 bytes: the records of the tree over the instances, then nodes and triangles of each mesh,
//! which are made from the CPU's trees ([`crate::widen`]). References inside a mesh are relative to it. An instance's record
//! has the size of a node and lies where its node would: it says where its mesh starts. Where the array exceeds what one
//! storage binding may hold, it is spread over several, cut at powers of two.
//!
//! # Traversal
//!
//! A group is the children of one node that a ray has entered and not yet visited, in 8 bytes: the first record, a bit for
//! each child in the ray's order, which slots have records, which are nodes. The next child is the lowest bit; the rest of
//! the group, if any, goes to the stack, and the child's own children become the group. So a level of the tree takes one
//! entry of the stack, whatever its width. The triangles of a node are tested when the node is visited, before its
//! children: the hits that they give cut off what is behind.
//!
//! - One stack serves both levels. An instance starts at the current depth and ends when the stack is back there;
//!   the ray in world space is then made anew from origin and direction, which costs three divisions but
//!   keeps nine registers free.
//! - A group keeps no distances: it is not tested again when it is popped, but its children are tested against the closest
//!   hit so far when their own node is read.
//! - Whether a triangle is hit says the CPU's test to the bit where the device rounds as IEEE 754 does, how far away the same plane in f32
//!   ([`crate::triangle`]); boxes are conservative ([`crate::node`]). So the closest hit is that of all triangles, whatever tree and order of visits.
//! - An any-hit kernel is the same traversal, left at the first hit.
//!
//! # What a ray costs
//!
//! The first eight entries of the stack lie in the workgroup's memory (4 KiB for 64 lanes), interleaved, so that lanes at
//! one depth use different banks; deeper ones are private. Depth is compiled in, rounded up to a multiple of four, so
//! that a device sets aside no more than the scene needs. Bytes, operations and rates: docs/gpu.md, [`crate::model`].

use crate::{
    GpuDevice, acceleration,
    boxes::Boxes,
    device::CALL_STORAGE_BUFFERS,
    foliage::FoliageShape,
    layout::{Layout, WORD_BYTES},
    shader::SceneShape,
    triangle::MISS_RANK,
    upload::Upload,
};
use bytemuck::{Pod, Zeroable, bytes_of};
use kiln_trace::{Scene, TraceError};

/// The most bindings that the geometry is spread over.
const MAX_BINDINGS: u32 = 8;

/// The greatest distance that a ray is given: widened, it is still finite.
pub(crate) const MOST_DISTANCE: f32 = 3e38;

/// Keep in sync with `SceneInfo` in `scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct SceneInfo {
    is_empty: u32,
    zero: u32,
    foliage_words: u32,
    padding: u32,
}

const _: () = assert!(size_of::<SceneInfo>() == 16);

impl SceneInfo {
    #[expect(clippy::cast_possible_truncation, reason = "`shape` has checked the greatest word")]
    fn of(scene: &Scene, layout: &Layout<'_>) -> Self {
        let foliage_words = layout.foliage.as_ref().map_or(0, |foliage| foliage.first_word as u32);
        Self { is_empty: u32::from(scene.is_empty()), zero: 0, foliage_words, padding: 0 }
    }
}

/// A scene in the device's memory.
#[derive(Debug)]
pub(crate) struct SceneBuffers {
    pub(crate) shape: SceneShape,
    pub(crate) group: wgpu::BindGroup,
    /// Without acceleration structures, whose size no driver tells.
    pub(crate) memory_bytes: u64,
    /// Greatest coordinate of a ray's origin, metres.
    pub(crate) origin_reach: f32,
}

impl SceneBuffers {
    /// Sends a scene. `binding_bytes` is the most that one binding may hold; the device's own limit holds too.
    pub(crate) fn upload(
        gpu: &GpuDevice,
        scene: &Scene,
        binding_bytes: u64,
        ray_queries: bool,
    ) -> Result<Self, TraceError> {
        let layout = Layout::of(scene, ray_queries);
        let shape = shape(gpu, scene, &layout, binding_bytes)?;
        let boxes = ray_queries.then(|| Boxes::of(scene, &layout));
        let structure = boxes.as_ref().map(|boxes| acceleration::build(gpu, boxes)).transpose()?;
        let words_per_binding = 1u64 << shape.binding_shift;
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let mut buffers = Vec::new();
        for binding in 0..u64::from(shape.bindings) {
            let words = (layout.total_words - binding * words_per_binding).min(words_per_binding);
            buffers.push(gpu.create_buffer("the scene's geometry", words * WORD_BYTES, usage)?);
        }
        let info = SceneInfo::of(scene, &layout);
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let info_buffer = gpu.create_buffer("the scene's header", size_of::<SceneInfo>() as u64, usage)?;
        gpu.queue.write_buffer(&info_buffer, 0, bytes_of(&info));
        layout.send(scene, Upload::new(gpu, &buffers, words_per_binding * WORD_BYTES))?;
        let resources = std::iter::once(&info_buffer).chain(&buffers).map(wgpu::Buffer::as_entire_binding);
        let entry = |(binding, resource)| wgpu::BindGroupEntry { binding, resource };
        let structure = structure.iter().map(|structure| (shape.structure_binding(), structure.as_binding()));
        let entries: Vec<_> = (0u32..).zip(resources).chain(structure).map(entry).collect();
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene"),
            layout: &gpu.scene_layout(&shape),
            entries: &entries,
        });
        gpu.check()?;
        let origin_reach = boxes.map_or(f32::INFINITY, |boxes| boxes.origin_reach);
        Ok(Self { shape, group, memory_bytes: layout.total_words * WORD_BYTES, origin_reach })
    }
}

/// Spreads the geometry over bindings, or says that it does not fit.
fn shape(gpu: &GpuDevice, scene: &Scene, layout: &Layout<'_>, binding_bytes: u64) -> Result<SceneShape, TraceError> {
    let limits = gpu.limits();
    let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size).min(binding_bytes);
    // Words are counted in 32 bits.
    let binding_shift = (most / WORD_BYTES).max(1).ilog2().min(31);
    let spare = limits.max_storage_buffers_per_shader_stage.saturating_sub(CALL_STORAGE_BUFFERS);
    let available = (u64::from(spare.min(MAX_BINDINGS)) << binding_shift).min(u64::from(u32::MAX));
    if layout.total_words > available {
        let (needed, available) = (layout.total_words * WORD_BYTES, available * WORD_BYTES);
        return Err(gpu.too_large("the scene's geometry", needed, available));
    }
    // A rank is an object's index below MISS_RANK.
    let instances = scene.instances.iter().map(|instance| u64::from(instance.object) + 1).max().unwrap_or(0);
    if instances >= u64::from(MISS_RANK) {
        return Err(gpu.too_large("the table of objects", instances, u64::from(MISS_RANK)));
    }
    let bindings = u32::try_from(layout.total_words.div_ceil(1 << binding_shift)).unwrap_or(u32::MAX);
    let (stack_entries, ray_queries) = (layout.stack_entries(), layout.ray_queries);
    let foliage = FoliageShape::of(scene);
    Ok(SceneShape { bindings, binding_shift, stack_entries, ray_queries, foliage })
}
