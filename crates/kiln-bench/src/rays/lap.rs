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

/// Points that the rays of one task start at, on the CPU.
const POINTS_PER_TASK: usize = 64;
/// Points whose rays are made and traced in one call, on the CPU.
const POINTS_PER_CALL: usize = 8;
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
    rays: &'a RaySet,
    /// Points whose rays are traced.
    points: Vec<usize>,
    is_cpu: bool,
    /// The rays of a graphics device, which gets them all in one call. Those of the CPU are made where they are traced, as
    /// in the comparison programs.
    closest: Vec<Ray>,
    any: Vec<Ray>,
    samples: Vec<SurfaceSample>,
    kernel: KernelRates,
}

/// What a tracer answers.
trait Answer: Clone + Send {
    const NONE: Self;

    fn ask(tracer: &dyn Tracer, rays: &[Ray], answers: &mut [Self]) -> Result<(), TraceError>;

    /// The distance of a hit, as far as it is known.
    fn hit(&self) -> Option<f64>;
}

impl Answer for Hit {
    const NONE: Self = Self::MISS;

    fn ask(tracer: &dyn Tracer, rays: &[Ray], answers: &mut [Self]) -> Result<(), TraceError> {
        tracer.trace(rays, answers)
    }

    fn hit(&self) -> Option<f64> {
        self.is_hit().then_some(f64::from(self.t))
    }
}

impl Answer for bool {
    const NONE: Self = false;

    fn ask(tracer: &dyn Tracer, rays: &[Ray], answers: &mut [Self]) -> Result<(), TraceError> {
        tracer.any_hit(rays, answers)
    }

    fn hit(&self) -> Option<f64> {
        self.then_some(0.0)
    }
}

/// What rays found.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    rays: usize,
    hits: usize,
    distance: f64,
}

impl Tally {
    fn add(&mut self, answers: &[impl Answer]) {
        self.rays += answers.len();
        for distance in answers.iter().filter_map(Answer::hit) {
            self.hits += 1;
            self.distance += distance;
        }
    }

    fn sum(tallies: impl IntoIterator<Item = Self>) -> Self {
        tallies.into_iter().fold(Self::default(), |sum, part| Self {
            rays: sum.rays + part.rays,
            hits: sum.hits + part.hits,
            distance: sum.distance + part.distance,
        })
    }
}

impl<'a> Course<'a> {
    /// Of every `stride`th run of [`POINTS_PER_STRIDE`] points. On the CPU calls are small, and share the threads.
    pub(super) fn new(tracer: &'a dyn Tracer, case: &'a Case, stride: usize, is_cpu: bool) -> Self {
        let rays = &case.rays;
        let count = rays.origins.len();
        let starts = (0..count).step_by(POINTS_PER_STRIDE * stride);
        let points: Vec<usize> = starts.flat_map(|start| start..(start + POINTS_PER_STRIDE).min(count)).collect();
        let prepared: &[usize] = if is_cpu { &[] } else { &points };
        let closest: Vec<Ray> = prepared.iter().flat_map(|point| rays_of_point(rays, *point, f32::INFINITY)).collect();
        let t_max = rays.diagonal_m * ANY_SHARE;
        Self {
            tracer,
            rays,
            is_cpu,
            any: closest.iter().map(|ray| Ray { t_max, ..*ray }).collect(),
            closest,
            samples: points.iter().map(|point| sample(rays, *point)).collect(),
            points,
            kernel: KernelRates::new(&case.kernel),
        }
    }

    /// The rays of a mode that a graphics device is given; gathering makes its own.
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
            Mode::Closest => {
                let (tally, lap) = self.ask::<Hit>(mode, f32::INFINITY, pool)?;
                Ok(Lap { mean_t: Some(tally.distance / tally.hits.max(1) as f64), ..lap })
            }
            Mode::Any => Ok(self.ask::<bool>(mode, self.rays.diagonal_m * ANY_SHARE, pool)?.1),
            Mode::Gather(rays) => self.gather(rays, pool),
        }
    }

    fn ask<A: Answer>(&self, mode: Mode, t_max: f32, pool: &ThreadPool) -> Result<(Tally, Lap), BenchError> {
        let (tally, cost) =
            if self.is_cpu { self.ask_in_small_calls::<A>(t_max, pool)? } else { self.ask_at_once::<A>(mode, pool)? };
        let lap = lap(mode, tally.rays, cost, pool);
        Ok((tally, Lap { hit_fraction: share(tally.hits, tally.rays), ..lap }))
    }

    fn ask_at_once<A: Answer>(&self, mode: Mode, pool: &ThreadPool) -> Result<(Tally, Cost), BenchError> {
        let rays = self.rays(mode);
        let mut answers = vec![A::NONE; rays.len()];
        let cost = timed(pool, || A::ask(self.tracer, rays, &mut answers))?.1;
        let mut tally = Tally::default();
        tally.add(&answers);
        Ok((tally, cost))
    }

    fn ask_in_small_calls<A: Answer>(&self, t_max: f32, pool: &ThreadPool) -> Result<(Tally, Cost), BenchError> {
        let task = |(rays, answers): &mut (Vec<Ray>, Vec<A>), points: &[usize]| {
            let mut tally = Tally::default();
            for points in points.chunks(POINTS_PER_CALL) {
                rays.clear();
                points.iter().for_each(|point| rays.extend(rays_of_point(self.rays, *point, t_max)));
                answers.clear();
                answers.resize(rays.len(), A::NONE);
                A::ask(self.tracer, rays, answers)?;
                tally.add(answers);
            }
            Ok(tally)
        };
        let (tallies, cost) = timed(pool, || {
            // Each is a task of its own: how long one takes varies with where its points are.
            let tasks = self.points.par_chunks(POINTS_PER_TASK).with_max_len(1);
            tasks.map_init(|| (Vec::new(), Vec::new()), task).collect::<Result<Vec<Tally>, TraceError>>()
        })?;
        Ok((Tally::sum(tallies), cost))
    }

    fn gather(&self, rays: u32, pool: &ThreadPool) -> Result<Lap, BenchError> {
        let mut sums = vec![CosineSums::default(); self.samples.len()];
        let (width, tracer) = (if self.is_cpu { POINTS_PER_TASK } else { usize::MAX }, self.tracer);
        let ((), cost) = timed(pool, || {
            let calls = self.samples.par_chunks(width).zip(sums.par_chunks_mut(width)).with_max_len(1);
            calls.try_for_each(|(samples, sums)| tracer.gather_cosine(samples, &self.kernel, rays, sums))
        })?;
        let traced = sums.iter().map(|sum| sum.rays as usize).sum();
        Ok(lap(Mode::Gather(rays), traced, cost, pool))
    }
}

/// The closest hits of all rays of a scene.
pub(super) fn all_hits(tracer: &dyn Tracer, rays: &RaySet) -> Result<Vec<Hit>, BenchError> {
    let points = 0..rays.origins.len();
    let list: Vec<Ray> = points.flat_map(|point| rays_of_point(rays, point, f32::INFINITY)).collect();
    let mut hits = vec![Hit::MISS; list.len()];
    tracer.trace(&list, &mut hits).map_err(|error| failed(&error))?;
    Ok(hits)
}

fn rays_of_point(rays: &RaySet, point: usize, t_max: f32) -> impl Iterator<Item = Ray> {
    let origin = Vec3::from(rays.origins[point]);
    let directions = &rays.directions[point * rays.per_point..(point + 1) * rays.per_point];
    directions.iter().map(move |direction| Ray { origin, direction: Vec3::from(*direction), t_max })
}

fn sample(rays: &RaySet, point: usize) -> SurfaceSample {
    let normal = Vec3::from(rays.normals[point]).normalize_or(Vec3::Y);
    let origin = Vec3::from(rays.origins[point]);
    SurfaceSample { origin, normal, geometric: normal, scramble: scramble(point as u32), first_index: 0 }
}

fn timed<T: Send>(
    pool: &ThreadPool,
    work: impl FnOnce() -> Result<T, TraceError> + Send,
) -> Result<(T, Cost), BenchError> {
    let (done, cost) = pool.install(|| {
        let watch = Stopwatch::start();
        let done = work();
        (done, watch.read())
    });
    Ok((done.map_err(|error| failed(&error))?, cost))
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
