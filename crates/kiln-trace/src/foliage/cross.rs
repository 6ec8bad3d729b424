//! Takes bundles of rays through foliage: all that they cross counts.

use super::{
    CrossingMesh, FogBox, Foliage, Lost, Placed, What,
    groups::{self, Spheres},
    inside::InBox,
};
use crate::{
    Hit,
    alone::{self, Leaves, Stack},
    bundle::{self, BundleLeaves, Hits, Memory},
    levels::go_alone,
    node::MAX_LEAF,
    path::{Compiled, Kernel},
    ray::TracedRay,
    rays::{BUNDLE, Rays},
    triangle::entry,
};
use glam::Vec3;

/// What the way of a bundle through foliage needs.
pub(crate) struct FoliageMemory {
    pub(crate) lost: Lost,
    object: Rays,
    scene_memory: Memory,
    mesh_memory: Memory,
    stack: Stack,
    group: GroupMemory,
}

/// What the way through a group needs.
struct GroupMemory {
    spheres: Spheres,
    /// Boxes that rays of the bundle came to, and those around them.
    boxes: [(FogBox, [Vec3; 2]); groups::MOST],
}

impl FoliageMemory {
    pub(crate) const NEW: Self = Self {
        lost: Lost::NEW,
        object: Rays::NEW,
        scene_memory: Memory::NEW,
        mesh_memory: Memory::NEW,
        stack: Stack::NEW,
        group: GroupMemory { spheres: Spheres::NEW, boxes: [(FogBox::NOTHING, [Vec3::ZERO; 2]); groups::MOST] },
    };
}

/// Finds what the first `count` rays of a bundle lose before their closest hits, which are known.
pub(crate) struct CrossBundle<'a, const SHARED: bool> {
    pub(crate) foliage: &'a Foliage,
    pub(crate) count: usize,
    pub(crate) rays: &'a Rays,
    pub(crate) hits: &'a mut Hits,
    pub(crate) memory: &'a mut FoliageMemory,
}

impl<const SHARED: bool> Kernel for CrossBundle<'_, SHARED> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { foliage, count, rays, hits, memory } = self;
        let FoliageMemory { lost, object, scene_memory, mesh_memory, stack, group } = memory;
        lost.start(foliage.mode);
        let mask = u64::MAX >> (BUNDLE - count.clamp(1, BUNDLE));
        let leaves = &mut Objects { foliage, lost, object, memory: mesh_memory, stack, group };
        let walk: bundle::Walk<'_, _, false, SHARED> =
            bundle::Walk { nodes: &foliage.nodes, leaves, rays, mask, hits, memory: scene_memory };
        walk.run::<V>();
        lost.finish();
    }
}

/// The objects of foliage, for a bundle of rays.
struct Objects<'a> {
    foliage: &'a Foliage,
    lost: &'a mut Lost,
    object: &'a mut Rays,
    memory: &'a mut Memory,
    stack: &'a mut Stack,
    group: &'a mut GroupMemory,
}

impl Objects<'_> {
    /// Takes the rays of a mask through the shrubs of a group.
    #[inline(always)]
    fn cross_group<V: Compiled>(&mut self, group: usize, mask: u64, rays: &Rays, hits: &mut Hits) {
        let groups = &self.foliage.groups;
        let GroupMemory { spheres, boxes } = &mut *self.group;
        groups.spheres(group, spheres);
        // Boxes are unpacked when the first ray comes to them.
        let mut unpacked = 0u32;
        let mut rest = mask;
        while rest != 0 {
            let index = rest.trailing_zeros() as usize % BUNDLE;
            rest &= rest - 1;
            let (ray, t_max) = (rays.alone(index), hits.get(index).t);
            let mut met = spheres.met::<V>(ray.origin, ray.direction, t_max);
            while met != 0 {
                let shrub = met.trailing_zeros() as usize % groups::MOST;
                met &= met - 1;
                if unpacked >> shrub & 1 == 0 {
                    let fog = groups.shrub(group, shrub);
                    boxes[shrub] = (fog, fog.bounds());
                    unpacked |= 1 << shrub;
                }
                let (fog, bounds) = &boxes[shrub];
                if let Some(part) = fog.part(*bounds, &ray, t_max)
                    && self.lost.go_through(index, part, fog.rate)
                {
                    hits.stop(index);
                    break;
                }
            }
        }
    }
}

impl BundleLeaves for Objects<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, first: u32) {
        match (first as usize).checked_sub(self.foliage.groups.len()) {
            Some(index) => V::prefetch(self.foliage.objects.get(index..=index).unwrap_or_default()),
            None => self.foliage.groups.prefetch::<V>(first as usize),
        }
    }

    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool, const SHARED: bool>(
        &mut self,
        first: u32,
        _: u32,
        mask: u64,
        rays: &Rays,
        hits: &mut Hits,
    ) {
        let Some(index) = (first as usize).checked_sub(self.foliage.groups.len()) else {
            return self.cross_group::<V>(first as usize, mask, rays, hits);
        };
        let placed @ Placed { place, is_unmoved, what } = &self.foliage.objects[index];
        match what {
            What::Fog { min, max, rate } => {
                let mut rest = mask;
                while rest != 0 {
                    let ray = rest.trailing_zeros() as usize % BUNDLE;
                    rest &= rest - 1;
                    let in_box = InBox { min: *min, max: *max, t_max: hits.get(ray).t };
                    let Some(part) = in_box.part(&placed.ray(&rays.alone(ray))) else { continue };
                    if self.lost.go_through(ray, part, *rate) {
                        hits.stop(ray);
                    }
                }
            }
            What::Crossings(mesh) => {
                let rays = if *is_unmoved {
                    rays
                } else {
                    self.object.put_seen_from(place, rays, mask);
                    &*self.object
                };
                let leaves = &mut Faces { mesh, lost: self.lost, stack: self.stack };
                let (nodes, memory) = (&*mesh.bvh.nodes, &mut *self.memory);
                let walk: bundle::Walk<'_, _, false, SHARED> = bundle::Walk { nodes, leaves, rays, mask, hits, memory };
                V::compiled(walk);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let leaves =
            &mut ObjectsAlone { foliage: self.foliage, lost: self.lost, ray, spheres: &mut self.group.spheres };
        go_alone::<V, _, false>(&self.foliage.nodes, leaves, start, ray, rays, hits, self.stack);
    }
}

/// The objects of foliage, for one ray of a bundle.
struct ObjectsAlone<'a> {
    foliage: &'a Foliage,
    lost: &'a mut Lost,
    /// Its index in the bundle.
    ray: usize,
    spheres: &'a mut Spheres,
}

impl ObjectsAlone<'_> {
    #[inline(always)]
    fn cross_group<V: Compiled>(&mut self, group: usize, ray: &TracedRay, t_max: f32) {
        let groups = &self.foliage.groups;
        groups.spheres(group, self.spheres);
        let mut met = self.spheres.met::<V>(ray.origin, ray.direction, t_max);
        while met != 0 {
            let shrub = groups.shrub(group, met.trailing_zeros() as usize);
            met &= met - 1;
            if let Some(part) = shrub.part(shrub.bounds(), ray, t_max) {
                self.lost.go_through(self.ray, part, shrub.rate);
            }
        }
    }
}

impl Leaves for ObjectsAlone<'_> {
    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(
        &mut self,
        first: u32,
        _: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut Stack,
        top: usize,
    ) {
        let Some(index) = (first as usize).checked_sub(self.foliage.groups.len()) else {
            return self.cross_group::<V>(first as usize, ray, best.t);
        };
        let placed = &self.foliage.objects[index];
        let seen = placed.ray(ray);
        match &placed.what {
            What::Fog { min, max, rate } => {
                if let Some(part) = (InBox { min: *min, max: *max, t_max: best.t }).part(&seen) {
                    self.lost.go_through(self.ray, part, *rate);
                }
            }
            What::Crossings(mesh) => {
                let leaves = &mut FacesAlone { mesh, lost: self.lost, ray: self.ray };
                let nodes = &*mesh.bvh.nodes;
                let walk = alone::Walk::<_, ANY> { nodes, leaves, start: 0, ray: &seen, best, stack, bottom: top };
                V::compiled(walk);
            }
        }
    }
}

/// The faces of a tree, for a bundle of rays.
struct Faces<'a> {
    mesh: &'a CrossingMesh,
    lost: &'a mut Lost,
    stack: &'a mut Stack,
}

impl BundleLeaves for Faces<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, first: u32) {
        self.mesh.bvh.triangles.words().prefetch::<V>(first);
    }

    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool, const SHARED: bool>(
        &mut self,
        first: u32,
        count: u32,
        mask: u64,
        rays: &Rays,
        hits: &mut Hits,
    ) {
        let mut rest = mask;
        while rest != 0 {
            let ray = rest.trailing_zeros() as usize % BUNDLE;
            rest &= rest - 1;
            let leaf = Leaf { mesh: self.mesh, first, count, t_max: hits.get(ray).t };
            if leaf.cross::<V>(&rays.alone(ray), ray, self.lost) {
                hits.stop(ray);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let leaves = &mut FacesAlone { mesh: self.mesh, lost: self.lost, ray };
        go_alone::<V, _, false>(&self.mesh.bvh.nodes, leaves, start, ray, rays, hits, self.stack);
    }
}

/// The faces of a tree, for one ray of a bundle.
struct FacesAlone<'a> {
    mesh: &'a CrossingMesh,
    lost: &'a mut Lost,
    /// Its index in the bundle.
    ray: usize,
}

impl Leaves for FacesAlone<'_> {
    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(
        &mut self,
        first: u32,
        count: u32,
        ray: &TracedRay,
        best: &mut Hit,
        _: &mut Stack,
        _: usize,
    ) {
        Leaf { mesh: self.mesh, first, count, t_max: best.t }.cross::<V>(ray, self.ray, self.lost);
    }
}

/// Faces that are tested side by side, and how far a ray goes.
struct Leaf<'a> {
    mesh: &'a CrossingMesh,
    first: u32,
    count: u32,
    t_max: f32,
}

impl Leaf<'_> {
    /// Takes note of each face that a ray crosses. Returns whether the ray has lost all there was.
    #[inline(always)]
    fn cross<V: Compiled>(&self, ray: &TracedRay, index: usize, lost: &mut Lost) -> bool {
        let leaf = self.mesh.bvh.triangles.words().leaf(self.first, self.count);
        let (mut lanes, margins) = leaf.edges::<V>(ray.origin).crossed(ray.direction);
        let mut all_lost = false;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % MAX_LEAF;
            lanes &= lanes - 1;
            let seen = leaf.seen(lane, ray.origin);
            let entry = || entry(leaf.corners(lane), ray.origin, ray.inverse);
            if let Some((t, _)) = seen.meet(ray.direction, margins[lane], self.t_max, entry)
                && self.mesh.is_there(seen.primitive, leaf.corners(lane), ray)
            {
                all_lost |= lost.cross(index, t, self.mesh.depth(seen.primitive));
            }
        }
        all_lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FoliageObject, foliage::through::ALL_LOST, path::Path};
    use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
    use kiln_core::{Bounds, Fog, FoliageMode};
    use proptest::prelude::*;

    /// What each ray of a bundle loses up to a distance, or all there was.
    fn depths(foliage: &Foliage, rays: &[[Vec3; 2]], t_max: f32) -> Vec<u64> {
        let [found, portable] = [Path::detect(), Path::Portable].map(|path| depths_by(path, foliage, rays, t_max));
        assert_eq!(found, portable);
        found
    }

    fn depths_by(path: Path, foliage: &Foliage, rays: &[[Vec3; 2]], t_max: f32) -> Vec<u64> {
        let (mut columns, mut hits, mut memory) = (Box::new(Rays::NEW), Hits::NEW, Box::new(FoliageMemory::NEW));
        for (index, [origin, direction]) in rays.iter().enumerate() {
            columns.put(index, *origin, *direction);
            hits.start(index, t_max);
        }
        columns.finish();
        hits.end(rays.len());
        let (rays, hits, memory, count) = (&*columns, &mut hits, &mut *memory, rays.len());
        path.run(CrossBundle::<false> { foliage, count, rays, hits, memory });
        (0..count).map(|ray| memory.lost.depth_of(ray).min(ALL_LOST + 1)).collect()
    }

    fn unit() -> impl Strategy<Value = DVec3> {
        let ball = prop::array::uniform3(-1.0f64..1.0).prop_map(DVec3::from_array);
        ball.prop_filter("no direction", |v| v.length() > 0.1).prop_map(DVec3::normalize)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// What a ray loses in shrubs is the sum of what it loses in each where there is no other, to the bit: whatever shares its group; in a
        /// bundle, by itself in the last nodes (there are enough for a second level), or all the way; and on both paths. Also where it
        /// only grazes edges from far away, which rounds rays by more than boxes have of slack.
        #[test]
        fn each_shrub_takes_what_it_takes_alone(
            shrubs in prop::collection::vec((unit(), unit(), 0.1f64..1.0, 0.5f64..6.0, 0.0f64..1.0), 1..600),
            aims in prop::collection::vec((any::<prop::sample::Index>(), unit(), prop::array::uniform3(-4e-4f64..4e-4), 0usize..3), 1..65),
            away in prop::sample::select(vec![3.0, 400.0, 3000.0]),
        ) {
            let place = |(at, axis, half, turn, out): &(DVec3, DVec3, f64, f64, f64)| {
                let turn = DQuat::from_axis_angle(*axis, *turn);
                DAffine3::from_scale_rotation_translation(DVec3::new(1.0, 0.6, 1.3) * *half, turn, *at * (2.0 + 12.0 * *out))
            };
            let places: Vec<DAffine3> = shrubs.iter().map(place).collect();
            let object = |world_from_object: &DAffine3| {
                let density_per_m = 10.0 + world_from_object.translation.x.abs();
                let fog = Fog { bounds: Bounds { min: DVec3::NEG_ONE, max: DVec3::ONE }, density_per_m };
                FoliageObject::Fog { fog, world_from_object: *world_from_object }
            };
            // Past the farthest corner along an axis, across that axis.
            let ray = |(at, direction, by, axis): &(prop::sample::Index, DVec3, [f64; 3], usize)| {
                let place = at.get(&places);
                let corner = place.matrix3.row(*axis).signum();
                let corner = place.transform_point3(corner) + DVec3::from_array(*by);
                let mut direction = *direction;
                direction[*axis] = 0.0;
                let direction = direction.normalize_or(DVec3::AXES[(axis + 1) % 3]);
                [(corner - direction * away).as_vec3(), direction.as_vec3()]
            };
            let rays: Vec<[Vec3; 2]> = aims.iter().map(ray).collect();
            let t_max = 2.0 * away as f32 + 20.0;
            let of = |places: &[DAffine3]| {
                let objects: Vec<FoliageObject> = places.iter().map(object).collect();
                Foliage::build(&objects, FoliageMode::Attenuate)
            };
            let all = of(&places);
            prop_assert_eq!(all.packed_shrubs(), places.len());
            let together = depths(&all, &rays, t_max);
            let mut sum = vec![0; rays.len()];
            for place in &places {
                let one = depths(&of(&[*place]), &rays, t_max);
                sum.iter_mut().zip(one).for_each(|(sum, depth)| *sum = (*sum + depth).min(ALL_LOST + 1));
            }
            prop_assert_eq!(&together, &sum);
            for (ray, depth) in rays.iter().zip(&together) {
                prop_assert_eq!(depths(&all, &[*ray], t_max), vec![*depth]);
            }
        }
    }

    /// Sheared boxes have no record, and are traced as they are.
    #[test]
    fn a_box_without_a_record_is_a_leaf() {
        let fog = Fog { bounds: Bounds { min: DVec3::NEG_ONE, max: DVec3::ONE }, density_per_m: 0.1 };
        let sheared = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::Z));
        let objects =
            [DAffine3::IDENTITY, sheared].map(|world_from_object| FoliageObject::Fog { fog, world_from_object });
        let foliage = Foliage::build(&objects, FoliageMode::Attenuate);
        assert_eq!(foliage.packed_shrubs(), 1);
        let ray = |y: f32| [Vec3::new(-9.0, y, 0.0), Vec3::X];
        let depths = depths(&foliage, &[ray(0.0), ray(0.5), ray(3.0)], 100.0);
        let depth = |length: f64| (length * 0.1 * std::f64::consts::LOG2_E * 65536.0).round() as u64;
        let is_near = |found: u64, expected: u64| found.abs_diff(expected) <= expected / 512 + 2;
        assert!(is_near(depths[0], depth(4.0)) && is_near(depths[1], depth(4.0)) && depths[2] == 0, "{depths:?}");
    }
}
