//! One timed run of a tracer over a scene's rays.

use super::{case::Case, files::RaySet, surface::scramble};
use crate::{
    BenchError,
    clock::{Cost, Stopwatch},
};
use glam::Vec3;
use kiln_trace::{CosineSums, Hit, KernelRates, Ray, SurfaceSample, TraceError, Tracer};
use rayon::{ThreadPool, prelude::*};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Points that the rays of one task start at, on the CPU.
const POINTS_PER_TASK: usize = 64;
/// Points that are taken or left out together.
const POINTS_PER_STRIDE: usize = 1024;
/// Rays of the any-hit modes end at this share of the scene's diagonal.
const ANY_SHARE: f32 = 0.05;

/// What rays ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// The closest hit, however far.
    Closest,
    /// Whether there is a hit within [`ANY_SHARE`] of the diagonal.
    Any,
    /// The mean value of so many cosine-distributed rays at each point, made by the tracer itself.
    Gather(u32),
}

impl Mode {
    /// What tables call it.
    pub(super) fn name(self) -> String {
        match self {
            Self::Closest => "closest".to_owned(),
            Self::Any => "any".to_owned(),
            Self::Gather(rays) => format!("gather {rays}"),
        }
    }
}

/// What one run came to, in the words of the comparison programs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Lap {
    /// What was asked.
    pub(super) mode: String,
    /// Rays traced.
    pub(super) rays: u64,
    /// Share of the rays that hit something.
    #[serde(default)]
    pub(super) hit_fraction: Option<f64>,
    /// Mean distance of closest hits.
    #[serde(default)]
    pub(super) mean_t: Option<f64>,
    /// Millions of rays in a second of the mean thread's processor time.
    pub(super) mrays_per_cpu_second: f64,
    /// Millions of rays in a second on the wall.
    pub(super) mrays_per_wall_second: f64,
}

impl Lap {
    /// Takes over the better of each rate.
    pub(super) fn keep_best(&mut self, other: &Self) {
        self.mrays_per_cpu_second = self.mrays_per_cpu_second.max(other.mrays_per_cpu_second);
        self.mrays_per_wall_second = self.mrays_per_wall_second.max(other.mrays_per_wall_second);
    }
}

/// A tracer and the rays it is given.
pub(super) struct Course<'a> {
    tracer: &'a dyn Tracer,
    /// Rays and samples of one call; a graphics device gets them all.
    rays_per_call: usize,
    samples_per_call: usize,
    closest: Vec<Ray>,
    any: Vec<Ray>,
    samples: Vec<SurfaceSample>,
    kernel: KernelRates,
}

impl<'a> Course<'a> {
    /// Of every `stride`th run of [`POINTS_PER_STRIDE`] points. On the CPU calls are small, and share the threads.
    pub(super) fn new(tracer: &'a dyn Tracer, case: &Case, stride: usize, is_cpu: bool) -> Self {
        let rays = &case.rays;
        let count = rays.origins.len();
        let starts = (0..count).step_by(POINTS_PER_STRIDE * stride);
        let chosen: Vec<usize> = starts.flat_map(|start| start..(start + POINTS_PER_STRIDE).min(count)).collect();
        let of = |point: &usize| rays_of(rays, point * rays.per_point..(point + 1) * rays.per_point, f32::INFINITY);
        let closest: Vec<Ray> = chosen.iter().flat_map(of).collect();
        let t_max = rays.diagonal_m * ANY_SHARE;
        let points_per_call = if is_cpu { POINTS_PER_TASK } else { usize::MAX };
        Self {
            tracer,
            rays_per_call: points_per_call.saturating_mul(rays.per_point),
            samples_per_call: points_per_call,
            any: closest.iter().map(|ray| Ray { t_max, ..*ray }).collect(),
            closest,
            samples: chosen.iter().map(|point| sample(rays, *point)).collect(),
            kernel: KernelRates::new(&case.kernel),
        }
    }

    /// The rays of a mode; gathering makes its own.
    pub(super) fn rays(&self, mode: Mode) -> &[Ray] {
        match mode {
            Mode::Closest => &self.closest,
            Mode::Any => &self.any,
            Mode::Gather(_) => &[],
        }
    }

    /// Traces once on the threads of a pool.
    pub(super) fn run(&self, mode: Mode, pool: &ThreadPool) -> Result<Lap, BenchError> {
        match mode {
            Mode::Closest => self.closest(pool),
            Mode::Any => self.any(pool),
            Mode::Gather(rays) => self.gather(rays, pool),
        }
    }

    fn closest(&self, pool: &ThreadPool) -> Result<Lap, BenchError> {
        let mut hits = vec![Hit::MISS; self.closest.len()];
        let cost = timed(pool, || trace_all(self.tracer, &self.closest, &mut hits, self.rays_per_call))?;
        let distances = hits.iter().filter(|hit| hit.is_hit()).map(|hit| f64::from(hit.t));
        let (count, sum) = distances.fold((0usize, 0.0), |(count, sum), t| (count + 1, sum + t));
        let lap = lap(Mode::Closest, hits.len(), cost, pool);
        Ok(Lap { hit_fraction: share(count, hits.len()), mean_t: Some(sum / count.max(1) as f64), ..lap })
    }

    fn any(&self, pool: &ThreadPool) -> Result<Lap, BenchError> {
        let mut blocked = vec![false; self.any.len()];
        let (width, tracer) = (self.rays_per_call, self.tracer);
        let cost = timed(pool, || {
            let calls = self.any.par_chunks(width).zip(blocked.par_chunks_mut(width));
            calls.try_for_each(|(rays, blocked)| tracer.any_hit(rays, blocked))
        })?;
        let count = blocked.iter().filter(|blocked| **blocked).count();
        Ok(Lap { hit_fraction: share(count, blocked.len()), ..lap(Mode::Any, blocked.len(), cost, pool) })
    }

    fn gather(&self, rays: u32, pool: &ThreadPool) -> Result<Lap, BenchError> {
        let mut sums = vec![CosineSums::default(); self.samples.len()];
        let (width, tracer) = (self.samples_per_call, self.tracer);
        let cost = timed(pool, || {
            let calls = self.samples.par_chunks(width).zip(sums.par_chunks_mut(width));
            calls.try_for_each(|(samples, sums)| tracer.gather_cosine(samples, &self.kernel, rays, sums))
        })?;
        let traced = sums.iter().map(|sum| sum.rays as usize).sum();
        Ok(lap(Mode::Gather(rays), traced, cost, pool))
    }
}

/// The closest hits of all rays of a scene.
pub(super) fn all_hits(tracer: &dyn Tracer, rays: &RaySet) -> Result<Vec<Hit>, BenchError> {
    let list: Vec<Ray> = rays_of(rays, 0..rays.directions.len(), f32::INFINITY).collect();
    let mut hits = vec![Hit::MISS; list.len()];
    tracer.trace(&list, &mut hits).map_err(|error| failed(&error))?;
    Ok(hits)
}

fn trace_all(tracer: &dyn Tracer, rays: &[Ray], hits: &mut [Hit], width: usize) -> Result<(), TraceError> {
    let calls = rays.par_chunks(width).zip(hits.par_chunks_mut(width));
    calls.try_for_each(|(rays, hits)| tracer.trace(rays, hits))
}

fn rays_of(rays: &RaySet, range: Range<usize>, t_max: f32) -> impl Iterator<Item = Ray> {
    range.map(move |index| {
        let (origin, direction) = rays.ray(index);
        Ray { origin: Vec3::from(origin), direction: Vec3::from(direction), t_max }
    })
}

fn sample(rays: &RaySet, point: usize) -> SurfaceSample {
    let normal = Vec3::from(rays.normals[point]).normalize_or(Vec3::Y);
    let origin = Vec3::from(rays.origins[point]);
    SurfaceSample { origin, normal, geometric: normal, scramble: scramble(point as u32), first_index: 0 }
}

fn timed(pool: &ThreadPool, work: impl FnOnce() -> Result<(), TraceError> + Send) -> Result<Cost, BenchError> {
    let (done, cost) = pool.install(|| {
        let watch = Stopwatch::start();
        let done = work();
        (done, watch.read())
    });
    done.map_err(|error| failed(&error))?;
    Ok(cost)
}

fn lap(mode: Mode, rays: usize, cost: Cost, pool: &ThreadPool) -> Lap {
    let mega = rays as f64 / 1e6;
    let thread_secs = cost.cpu_secs / pool.current_num_threads() as f64;
    Lap {
        mode: mode.name(),
        rays: rays as u64,
        hit_fraction: None,
        mean_t: None,
        mrays_per_cpu_second: mega / thread_secs.max(f64::MIN_POSITIVE),
        mrays_per_wall_second: mega / cost.wall_secs.max(f64::MIN_POSITIVE),
    }
}

fn share(count: usize, of: usize) -> Option<f64> {
    Some(count as f64 / of.max(1) as f64)
}

fn failed(error: &TraceError) -> BenchError {
    BenchError::Failed { step: "tracing", reason: error.to_string() }
}
