//! Spheres on the CPU: bundles of 64 rays, a cone of one point each.

use crate::{
    Hit, KernelRates, Scene, SpherePoint, SphereSums,
    levels::{GoThrough, TraceBundle, Workspace},
    path::{Compiled, Kernel},
    rays::BUNDLE,
    sphere::directions_in_cones,
    stream::Answer,
};
use glam::Vec3;

/// Gathers points in their order.
pub(crate) struct GatherSphere<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) kernel: &'a KernelRates,
    pub(crate) rays_per_point: u32,
    pub(crate) points: &'a [SpherePoint],
    pub(crate) sums: &'a mut [SphereSums],
    pub(crate) workspace: &'a mut Workspace,
}

impl Kernel for GatherSphere<'_> {
    #[inline(always)]
    fn run<V: Compiled>(mut self) {
        let mut directions = Vec::new();
        for (index, point) in self.points.iter().enumerate() {
            directions_in_cones(point.scramble, self.rays_per_point, &mut directions);
            let mut sum = SphereSums::default();
            for cone in directions.chunks(BUNDLE) {
                self.cone::<V>(point.origin, cone, &mut sum);
            }
            self.sums[index] = sum;
        }
    }
}

impl GatherSphere<'_> {
    #[inline(always)]
    fn cone<V: Compiled>(&mut self, origin: Vec3, directions: &[Vec3], sum: &mut SphereSums) {
        let (scene, workspace, count) = (self.scene, &mut *self.workspace, directions.len());
        for (ray, direction) in directions.iter().enumerate() {
            workspace.rays.put(ray, origin, *direction);
            workspace.hits.start(ray, self.kernel.t_max);
        }
        V::compiled(TraceBundle::<false, true> { scene, count, workspace });
        V::compiled(GoThrough::<true> { scene, count, workspace });
        for (ray, direction) in directions.iter().enumerate() {
            let hit = Hit::of(self.workspace.hits.get(ray));
            let values = self.workspace.foliage.lost.values(ray, self.kernel, hit.is_hit().then_some(hit.t));
            sum.add(*direction, &values, self.kernel.channels, hit.is_hit() && hit.back_face);
        }
    }
}
