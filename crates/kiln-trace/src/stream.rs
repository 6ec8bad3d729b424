//! From streams of rays and samples to bundles, and from hits to sums.

use crate::{
    CosineSums, Hit, KernelRates, Ray, Scene, SurfaceSample,
    directions::cosine_directions,
    levels::{GoThrough, TraceBundle, Workspace},
    orthonormal_basis,
    path::{Compiled, Kernel},
    rays::BUNDLE,
};
use glam::Vec3;

/// An answer to what a ray hits.
pub(crate) trait Answer {
    /// The first hit found is enough.
    const ANY: bool;

    fn of(hit: Hit) -> Self;
}

impl Answer for Hit {
    const ANY: bool = false;

    fn of(hit: Hit) -> Self {
        if hit.instance == u32::MAX { Self::MISS } else { hit }
    }
}

impl Answer for bool {
    const ANY: bool = true;

    fn of(hit: Hit) -> Self {
        hit.instance != u32::MAX
    }
}

/// Traces rays in their order, as many at a time as a bundle holds.
pub(crate) struct Trace<'a, A> {
    pub(crate) scene: &'a Scene,
    pub(crate) rays: &'a [Ray],
    pub(crate) answers: &'a mut [A],
    pub(crate) workspace: &'a mut Workspace,
}

impl<A: Answer> Kernel for Trace<'_, A> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { scene, rays, answers, workspace } = self;
        let bundles = rays.chunks(BUNDLE);
        // Each bundle's rays are asked for while the one before it is traced, which is longer than hardware looks ahead.
        let next = bundles.clone().skip(1).chain([&[][..]]);
        for ((rays, next), answers) in bundles.zip(next).zip(answers.chunks_mut(BUNDLE)) {
            V::prefetch(next);
            let mut is_shared = true;
            for (index, ray) in rays.iter().enumerate() {
                workspace.rays.put(index, ray.origin, ray.direction);
                workspace.hits.start(index, ray.t_max);
                is_shared &= ray.origin == rays[0].origin;
            }
            let count = rays.len();
            match (A::ANY, is_shared) {
                (false, false) => V::compiled(TraceBundle::<false, false> { scene, count, workspace }),
                (false, true) => V::compiled(TraceBundle::<false, true> { scene, count, workspace }),
                (true, false) => V::compiled(TraceBundle::<true, false> { scene, count, workspace }),
                (true, true) => V::compiled(TraceBundle::<true, true> { scene, count, workspace }),
            }
            for (index, answer) in answers.iter_mut().enumerate() {
                *answer = A::of(workspace.hits.get(index));
            }
        }
    }
}

/// Gathers samples in their order. Rays of several samples share a bundle where one has too few to fill it.
pub(crate) struct Gather<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) kernel: &'a KernelRates,
    pub(crate) rays_per_sample: u32,
    pub(crate) samples: &'a [SurfaceSample],
    pub(crate) sums: &'a mut [CosineSums],
    pub(crate) workspace: &'a mut Workspace,
}

impl Kernel for Gather<'_> {
    #[inline(always)]
    fn run<V: Compiled>(mut self) {
        let mut bundle = Bundle { owners: [0; BUNDLE], count: 0 };
        for (index, sample) in self.samples.iter().enumerate() {
            self.sums[index] = CosineSums::default();
            let basis = orthonormal_basis(sample.normal);
            let mut first = 0;
            while first < self.rays_per_sample {
                let start = sample.first_index.wrapping_add(first);
                let directions = cosine_directions(start, sample.scramble, sample.normal, basis);
                for direction in directions.iter().take((self.rays_per_sample - first) as usize) {
                    if direction.dot(sample.geometric) > 0.0 {
                        bundle.push(index, sample.origin, *direction, self.kernel.t_max, self.workspace);
                        if bundle.count == BUNDLE {
                            self.finish::<V>(&mut bundle);
                        }
                    }
                }
                first += 8;
            }
            // Rays that share their origin cost less than what a bundle that is not full wastes.
            if self.rays_per_sample as usize >= BUNDLE {
                self.finish::<V>(&mut bundle);
            }
        }
        self.finish::<V>(&mut bundle);
    }
}

impl Gather<'_> {
    #[inline(always)]
    fn finish<V: Compiled>(&mut self, bundle: &mut Bundle) {
        let count = std::mem::take(&mut bundle.count);
        if count == 0 {
            return;
        }
        let (scene, workspace) = (self.scene, &mut *self.workspace);
        if bundle.owners[0] == bundle.owners[count - 1] {
            V::compiled(TraceBundle::<false, true> { scene, count, workspace });
            V::compiled(GoThrough::<true> { scene, count, workspace });
        } else {
            V::compiled(TraceBundle::<false, false> { scene, count, workspace });
            V::compiled(GoThrough::<false> { scene, count, workspace });
        }
        for (index, &owner) in bundle.owners[..count].iter().enumerate() {
            let (hit, sum) = (self.workspace.hits.get(index), &mut self.sums[owner as usize]);
            sum.rays += 1;
            let is_hit = hit.instance != u32::MAX;
            let values = self.workspace.foliage.lost.values(index, self.kernel, is_hit.then_some(hit.t));
            for (sum, value) in sum.values.iter_mut().zip(values) {
                *sum += value;
            }
            sum.back_faces += u32::from(is_hit && hit.back_face);
        }
    }
}

/// Whose rays are in the workspace.
struct Bundle {
    /// Samples, in rising order.
    owners: [u32; BUNDLE],
    count: usize,
}

impl Bundle {
    #[inline(always)]
    fn push(&mut self, sample: usize, origin: Vec3, direction: Vec3, t_max: f32, workspace: &mut Workspace) {
        let index = self.count;
        self.owners[index] = sample as u32;
        workspace.rays.put(index, origin, direction);
        workspace.hits.start(index, t_max);
        self.count = index + 1;
    }
}
