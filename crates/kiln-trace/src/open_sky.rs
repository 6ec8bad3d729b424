//! Finds samples that need no ray: nothing lies above their surface within reach, so that AO is 1.

use crate::{
    CosineSums, ONE, Scene, SurfaceSample,
    bvh::{BvhNode, LEAF_BIT, MAX_STACK, NO_CHILD},
    cosine_direction, orthonormal_basis,
    scene::linear,
    sobol_point,
};
use glam::{Vec3, Vec4};

/// Whether no occluding triangle within `reach` (metres, a box's distance) has a corner above the plane through
/// `origin` with unit normal `normal`. A ray above the plane then hits nothing.
pub fn is_open_above(scene: &Scene, origin: Vec3, normal: Vec3, reach: f32) -> bool {
    let plane = HalfSpace { normal, offset: normal.dot(origin), near: Some((origin, reach)) };
    !any_above(&scene.nodes, &plane, |index| {
        let instance = &scene.instances[index as usize];
        let mesh = &scene.meshes[instance.mesh as usize];
        // n·x > c in the world is (W⁻ᵀ n)·y > c' for y = W x + w: found from y itself, W being object_from_world.
        let world_from_object = linear(instance).inverse();
        let normal = world_from_object.transpose() * plane.normal;
        let offset = normal.dot(instance.point(origin));
        let inner = HalfSpace { normal, offset, near: None };
        any_above(&mesh.nodes, &inner, |block| {
            let block = &mesh.blocks[block as usize];
            let used = block.primitives.iter().filter(|&&id| id != crate::NO_PRIMITIVE).count();
            (0..used).any(|lane| (0..3).any(|corner| inner.normal.dot(block.corner(corner, lane)) > inner.offset))
        })
    })
}

/// What tracing the rays of a sample would give that sees nothing. Rays are counted as one whole: without a ray above the
/// surface, which no shading normal but a slanting one causes, the sample has none.
pub fn open_sums(sample: &SurfaceSample, rays_per_sample: u32) -> CosineSums {
    let basis = orthonormal_basis(sample.normal);
    let is_above = |index: u32| {
        let point = sobol_point(sample.first_index.wrapping_add(index), sample.scramble);
        cosine_direction(point, sample.normal, basis).dot(sample.geometric) > 0.0
    };
    if !(0..rays_per_sample).any(is_above) {
        return CosineSums::default();
    }
    CosineSums { values: [ONE * rays_per_sample; 4], rays: rays_per_sample, back_faces: 0 }
}

struct HalfSpace {
    normal: Vec3,
    offset: f32,
    /// Boxes further than the reach from the point do not count.
    near: Option<(Vec3, f32)>,
}

impl HalfSpace {
    /// Lanes whose box has a point above the plane, and within reach.
    fn reaches(&self, node: &BvhNode) -> u32 {
        let mut height = Vec4::splat(-self.offset);
        for axis in 0..3 {
            let n = Vec4::splat(self.normal[axis]);
            height += (node.bounds[axis] * n).max(node.bounds[axis + 3] * n);
        }
        let mut mask = height.cmpgt(Vec4::ZERO);
        if let Some((point, reach)) = self.near {
            let mut squared = Vec4::ZERO;
            for axis in 0..3 {
                let p = Vec4::splat(point[axis]);
                let gap = (node.bounds[axis] - p).max(p - node.bounds[axis + 3]).max(Vec4::ZERO);
                squared += gap * gap;
            }
            mask &= squared.cmple(Vec4::splat(reach) * reach);
        }
        mask.bitmask()
    }
}

fn any_above(nodes: &[BvhNode], plane: &HalfSpace, mut leaf: impl FnMut(u32) -> bool) -> bool {
    let mut stack = [0u32; MAX_STACK];
    let mut depth = usize::from(!nodes.is_empty());
    while depth > 0 {
        depth -= 1;
        let node = &nodes[stack[depth] as usize];
        let mask = plane.reaches(node);
        for lane in (0..4).filter(|lane| mask & (1 << lane) != 0) {
            let child = node.children[lane];
            if child == NO_CHILD {
                continue;
            }
            if child & LEAF_BIT == 0 {
                stack[depth] = child;
                depth += 1;
            } else if leaf(child & !LEAF_BIT) {
                return true;
            }
        }
    }
    false
}
