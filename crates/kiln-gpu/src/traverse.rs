//! A scene on the device; the host side of `traverse.wgsl`.
//!
//! # Data
//!
//! The nodes, triangle blocks and instances of a [`Scene`] are sent as they are, one after another, as one array of
//! words of 16 bytes: the tree over the instances, the instance table, then nodes and blocks of each mesh. References
//! inside a mesh stay relative to it; the instance table says where its nodes and blocks start. Where the
//! array exceeds what one storage binding may hold, it is spread over several, cut at powers of two.
//!
//! # Traversal
//!
//! The arithmetic is the CPU's: the same slab test with the same widening, the same watertight triangle test, the same
//! tie rule, so that the closest hit is that of all triangles, whatever the order of the visits. Differences:
//!
//! - One stack serves both levels. An instance starts at the current depth and ends when the stack is back there;
//!   the ray in world space is then made anew from origin and direction, which costs three divisions but
//!   keeps nine registers free.
//! - Children are sorted by the bits of their distance, whose lowest two give way to the slot, by a network of five
//!   exchanges. The distance that is kept is so at most 3 ULP too small: a visit too many, never one too few.
//! - A slot without a child is told by its reference, not by its infinite box alone: a driver may assume that
//!   infinities do not occur.
//! - Products of the edge functions and of the shear pass through `rounded`, an exclusive or with a zero that
//!   no compiler can see through. Drivers may fuse a product into a sum (WGSL cannot forbid it), and edge functions of
//!   neighbouring faces would no longer be exact negatives: rays would slip through. Elsewhere fusing does no harm.
//!
//! # What a ray costs
//!
//! Stack: 8 bytes an entry, three entries for each level of the deepest path, rounded up to 16 entries and compiled
//! into the shader, so that a device sets aside no more than a scene needs: typically 64 entries, 512 bytes a ray, and
//! 1,536 bytes at the very most, where a fixed bound would always take that. It is private memory that a ray
//! touches the lowest few entries of, which stay in the first cache. Live across the loop are about 35 registers (ray
//! in the world 6, slab ray 9 and its plane words 6, sheared ray 9, hit 3, stack and level 5); the triangle test adds
//! nine vectors of four. At about 96 registers a lane, a multiprocessor with 64 Ki registers holds 20 warps.
//!
//! A node is 112 bytes, a block of four triangles 160. Counted on scenes from 700 to 500,000 triangles, a ray visits 11
//! to 27 of the one and 2 to 5 of the other: 1.6 to 3.7 kB, for some 100 and 240 operations each, so about one operation
//! a byte. A GPU does 20 to 40 for each byte that its memory gives: without caches a ray would cost its bytes alone. What
//! decides is how many of them come from the caches, hence the cones, whose lanes read mostly the same nodes.

use crate::{GpuDevice, shader::SceneShape};
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice};
use kiln_trace::{BvhNode, LEAF_BIT, MAX_STACK, NO_CHILD, Scene, SceneInstance, TraceError, TriangleBlock};

/// Bytes of a word of the geometry.
const WORD_BYTES: u64 = 16;
const NODE_WORDS: u64 = 7;
const BLOCK_WORDS: u64 = 10;
const INSTANCE_WORDS: u64 = 4;

/// The most bindings that the geometry is spread over.
const MAX_BINDINGS: u32 = 8;

/// Entries of the stack are a multiple of this, so that few shaders are compiled.
const STACK_STEP: u32 = 16;

/// Bytes that are sent before the device is waited for: they are held twice until then.
const UPLOAD_BYTES: u64 = 32 << 20;

/// Set in the rank of a back-face hit; keep in sync with `traverse.wgsl`.
pub(crate) const BACK_BIT: u32 = 1 << 31;
/// The rank of no hit; keep in sync with `traverse.wgsl`.
pub(crate) const MISS_RANK: u32 = BACK_BIT - 1;

/// The greatest distance that a ray is given: widened, it is still finite.
pub(crate) const MOST_DISTANCE: f32 = 3e38;

/// Keep in sync with `SceneInfo` in `traverse.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct SceneInfo {
    instance_words: u32,
    is_empty: u32,
    zero: u32,
    padding: u32,
}

/// An entry of the instance table: rows of the inverse transform, then the first words of its mesh's nodes and blocks.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct InstanceRecord {
    object_from_world: [[f32; 4]; 3],
    node_words: u32,
    block_words: u32,
    padding: [u32; 2],
}

const _: () = {
    assert!(size_of::<SceneInfo>() == 16);
    assert!(size_of::<BvhNode>() as u64 == NODE_WORDS * WORD_BYTES);
    assert!(size_of::<TriangleBlock>() as u64 == BLOCK_WORDS * WORD_BYTES);
    assert!(size_of::<InstanceRecord>() as u64 == INSTANCE_WORDS * WORD_BYTES);
};

/// A scene in the device's memory.
#[derive(Debug)]
pub(crate) struct SceneBuffers {
    pub(crate) shape: SceneShape,
    pub(crate) group: wgpu::BindGroup,
    pub(crate) memory_bytes: u64,
}

/// Where everything goes, in words.
struct Layout {
    instance_words: u64,
    /// First words of nodes and blocks of each mesh.
    meshes: Vec<[u64; 2]>,
    total_words: u64,
}

impl Layout {
    fn of(scene: &Scene) -> Self {
        let instance_words = scene.nodes.len() as u64 * NODE_WORDS;
        let mut at = instance_words + scene.instances.len() as u64 * INSTANCE_WORDS;
        let mut meshes = Vec::with_capacity(scene.meshes.len());
        for mesh in &scene.meshes {
            let blocks = at + mesh.nodes.len() as u64 * NODE_WORDS;
            meshes.push([at, blocks]);
            at = blocks + mesh.blocks.len() as u64 * BLOCK_WORDS;
        }
        Self { instance_words, meshes, total_words: at.max(1) }
    }

    #[expect(clippy::cast_possible_truncation, reason = "SceneBuffers::upload has checked the greatest word")]
    fn record(&self, instance: &SceneInstance) -> InstanceRecord {
        let [nodes, blocks] = self.meshes[instance.mesh as usize];
        InstanceRecord {
            object_from_world: instance.object_from_world,
            node_words: nodes as u32,
            block_words: blocks as u32,
            padding: [0; 2],
        }
    }
}

impl SceneBuffers {
    /// Sends a scene. `binding_bytes` is the most that one binding may hold; the device's own limit holds too.
    pub(crate) fn upload(gpu: &GpuDevice, scene: &Scene, binding_bytes: u64) -> Result<Self, TraceError> {
        let layout = Layout::of(scene);
        let shape = shape(gpu, scene, &layout, binding_bytes)?;
        let words_per_binding = 1u64 << shape.binding_shift;
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let mut buffers = Vec::new();
        for binding in 0..u64::from(shape.bindings) {
            let words = (layout.total_words - binding * words_per_binding).min(words_per_binding);
            buffers.push(gpu.create_buffer("the scene's geometry", words * WORD_BYTES, usage)?);
        }
        let mut upload =
            Upload { gpu, buffers: &buffers, binding_bytes: words_per_binding * WORD_BYTES, at: 0, sent: 0 };
        upload.write(cast_slice(&scene.nodes))?;
        for instances in scene.instances.chunks(1 << 16) {
            let records: Vec<InstanceRecord> = instances.iter().map(|instance| layout.record(instance)).collect();
            upload.write(cast_slice(&records))?;
        }
        for mesh in &scene.meshes {
            upload.write(cast_slice(&mesh.nodes))?;
            upload.write(cast_slice(&mesh.blocks))?;
        }
        let info = SceneInfo {
            instance_words: u32::try_from(layout.instance_words).unwrap_or(u32::MAX),
            is_empty: u32::from(scene.nodes.is_empty()),
            zero: 0,
            padding: 0,
        };
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let info_buffer = gpu.create_buffer("the scene's header", size_of::<SceneInfo>() as u64, usage)?;
        gpu.queue.write_buffer(&info_buffer, 0, bytes_of(&info));
        upload.flush()?;
        let resources = std::iter::once(&info_buffer).chain(&buffers).map(wgpu::Buffer::as_entire_binding);
        let entry = |(binding, resource)| wgpu::BindGroupEntry { binding, resource };
        let entries: Vec<_> = (0u32..).zip(resources).map(entry).collect();
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene"),
            layout: &gpu.scene_layout(&shape),
            entries: &entries,
        });
        gpu.check()?;
        Ok(Self { shape, group, memory_bytes: layout.total_words * WORD_BYTES })
    }
}

/// Spreads the geometry over bindings, or says that it does not fit.
fn shape(gpu: &GpuDevice, scene: &Scene, layout: &Layout, binding_bytes: u64) -> Result<SceneShape, TraceError> {
    let limits = gpu.limits();
    let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size).min(binding_bytes);
    // Words are counted in 32 bits.
    let binding_shift = (most / WORD_BYTES).max(1).ilog2().min(31);
    let spare = limits.max_storage_buffers_per_shader_stage.saturating_sub(crate::device::CALL_STORAGE_BUFFERS);
    let available = (u64::from(spare.min(MAX_BINDINGS)) << binding_shift).min(u64::from(u32::MAX));
    if layout.total_words > available {
        let (needed, available) = (layout.total_words * WORD_BYTES, available * WORD_BYTES);
        return Err(gpu.too_large("the scene's geometry", needed, available));
    }
    // A rank is an instance's index below MISS_RANK.
    let instances = scene.instances.len() as u64;
    if instances >= u64::from(MISS_RANK) {
        return Err(gpu.too_large("the instance table", instances, u64::from(MISS_RANK)));
    }
    let bindings = u32::try_from(layout.total_words.div_ceil(1 << binding_shift)).unwrap_or(u32::MAX);
    Ok(SceneShape { bindings, binding_shift, stack_entries: stack_entries(scene) })
}

/// Entries that no path through both levels exceeds: at each level, three children wait.
fn stack_entries(scene: &Scene) -> u32 {
    let deepest = scene.meshes.iter().map(|mesh| depth(&mesh.nodes)).max().unwrap_or(0);
    let entries = 3 * (depth(&scene.nodes) + deepest);
    debug_assert!(entries as usize <= 2 * MAX_STACK);
    entries.next_multiple_of(STACK_STEP).max(STACK_STEP)
}

/// Nodes on the longest path from the root.
fn depth(nodes: &[BvhNode]) -> u32 {
    let mut deepest = 0;
    let mut pending = if nodes.is_empty() { Vec::new() } else { vec![(0u32, 1u32)] };
    while let Some((index, level)) = pending.pop() {
        deepest = deepest.max(level);
        let children = nodes[index as usize].children;
        let inner = children.into_iter().filter(|&child| child != NO_CHILD && child & LEAF_BIT == 0);
        pending.extend(inner.map(|child| (child, level + 1)));
    }
    deepest
}

/// Writes one after another into several buffers.
struct Upload<'a> {
    gpu: &'a GpuDevice,
    buffers: &'a [wgpu::Buffer],
    binding_bytes: u64,
    at: u64,
    /// Bytes since the device was last waited for.
    sent: u64,
}

impl Upload<'_> {
    fn write(&mut self, mut bytes: &[u8]) -> Result<(), TraceError> {
        while !bytes.is_empty() {
            let (buffer, offset) = (self.at / self.binding_bytes, self.at % self.binding_bytes);
            let room = (self.binding_bytes - offset).min(UPLOAD_BYTES - self.sent);
            let (now, later) = bytes.split_at(bytes.len().min(usize::try_from(room).unwrap_or(usize::MAX)));
            self.gpu.queue.write_buffer(&self.buffers[buffer as usize], offset, now);
            self.at += now.len() as u64;
            self.sent += now.len() as u64;
            if self.sent == UPLOAD_BYTES {
                self.flush()?;
            }
            bytes = later;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), TraceError> {
        self.gpu.queue.submit([]);
        self.sent = 0;
        self.gpu.wait()
    }
}
