//! Finds samples that need no ray: nothing lies above their surface within reach, so that AO is 1.

use crate::{
    BvhChild, CosineSums, Foliage, ONE, Scene, SurfaceSample, cosine_direction,
    node::{BvhLink, MAX_STACK, WideNode},
    orthonormal_basis,
    scene::linear,
    sobol_point,
};
use glam::Vec3;

/// Whether no occluding triangle within `reach` (metres, a box's distance) has a corner above the plane through
/// `origin` with unit normal `normal`, and no box of foliage or of faces with holes. A ray above the plane then meets nothing.
pub fn is_open_above(scene: &Scene, origin: Vec3, normal: Vec3, reach: f32) -> bool {
    let plane = HalfSpace { normal, offset: normal.dot(origin), near: Some((origin, reach)) };
    // Each shrub by itself: what shares its leaf changes nothing.
    let is_above = |foliage: &Foliage| {
        let is_leaf_above = |leaf, _| match foliage.group_bounds(leaf) {
            Some(mut boxes) => boxes.any(|bounds| plane.reaches_box(bounds)),
            None => true,
        };
        any_above(&foliage.nodes, &plane, is_leaf_above)
    };
    if scene.foliage.as_ref().is_some_and(is_above) {
        return false;
    }
    if scene.cutouts.as_ref().is_some_and(|cutouts| any_above(&cutouts.nodes, &plane, |_, _| true)) {
        return false;
    }
    !any_above(&scene.nodes, &plane, |index, _| {
        let instance = &scene.instances[index as usize];
        let mesh = &scene.meshes[instance.mesh()];
        // n·x > c in the world is (W⁻ᵀ n)·y > c' for y = W x + w: found from y itself, W being object_from_world.
        let world_from_object = linear(&instance.place).inverse();
        let normal = world_from_object.transpose() * plane.normal;
        let offset = normal.dot(instance.place.point(origin));
        let inner = HalfSpace { normal, offset, near: None };
        any_above(&mesh.nodes, &inner, |first, count| {
            (0..count).any(|lane| {
                let corners = mesh.triangles.leaf(first, count).corners(lane as usize);
                corners.iter().any(|corner| inner.normal.dot(*corner) > inner.offset)
            })
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
    fn reaches(&self, node: &WideNode) -> u32 {
        let (mut height, mut squared) = ([-self.offset; 8], [0.0; 8]);
        for axis in 0..3 {
            let (n, low, high) = (self.normal[axis], &node.bounds[axis], &node.bounds[axis + 3]);
            for lane in 0..8 {
                height[lane] += (low[lane] * n).max(high[lane] * n);
            }
        }
        let mut reach = f32::INFINITY;
        if let Some((point, distance)) = self.near {
            reach = distance;
            for axis in 0..3 {
                let (p, low, high) = (point[axis], &node.bounds[axis], &node.bounds[axis + 3]);
                for lane in 0..8 {
                    let gap = (low[lane] - p).max(p - high[lane]).max(0.0);
                    squared[lane] += gap * gap;
                }
            }
        }
        let is_reached = |lane: &usize| height[*lane] > 0.0 && squared[*lane] <= reach * reach;
        (0..8).filter(is_reached).fold(0, |mask, lane| mask | 1 << lane)
    }

    /// Likewise for one box: a node's box around it is reached where it is.
    fn reaches_box(&self, [min, max]: [Vec3; 2]) -> bool {
        let link = BvhLink::Leaf { first: 0, count: 1 };
        self.reaches(&WideNode::new(&[BvhChild { min, max, link }])) & 1 != 0
    }
}

fn any_above(nodes: &[WideNode], plane: &HalfSpace, mut leaf: impl FnMut(u32, u32) -> bool) -> bool {
    let mut stack = [0u32; MAX_STACK];
    let mut depth = usize::from(!nodes.is_empty());
    while depth > 0 {
        depth -= 1;
        let node = &nodes[stack[depth] as usize];
        let mask = plane.reaches(node);
        for slot in (0..8).filter(|slot| mask & (1 << slot) != 0 && node.children[*slot] != u32::MAX) {
            match BvhLink::of_reference(node.children[slot]) {
                BvhLink::Node(child) => {
                    stack[depth] = child;
                    depth += 1;
                }
                BvhLink::Leaf { first, count } if leaf(first, count) => return true,
                BvhLink::Leaf { .. } => {}
            }
        }
    }
    false
}
