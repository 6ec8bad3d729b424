//! The same rays by a card's ray queries and by the software traversal on the same device: which differ, and how fast each is.

use super::{
    case::Case,
    contest::Plan,
    lap::{Course, Mode, all_hits},
    predicted::{COUNTED, Traced},
};
use crate::{BenchError, spread::Spread};
use kiln_gpu::{GpuTracer, Visits};
use kiln_trace::{Hit, Ray, Scene, Tracer};
use serde::Serialize;
use std::sync::Arc;

/// Rates of one mode, by repetition.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Rates {
    mode: String,
    /// Millions of rays per second on the wall.
    ray_queries: Spread,
    software: Spread,
    /// Ray queries to software.
    ratio: Spread,
}

/// What was found.
#[derive(Clone, Debug, Serialize)]
pub(super) struct BothWays {
    rays: usize,
    /// Rays whose closest hits differ in any bit.
    hits_differ: usize,
    /// Rays that one way finds blocked, within the distance of the any-hit modes, and the other does not.
    any_hits_differ: usize,
    /// Boxes that the hardware proposes, and triangles that are tested then, for each ray to its closest hit.
    boxes_per_ray: f64,
    triangles_per_ray: f64,
    /// Triangles that the software traversal tests.
    software_triangles_per_ray: f64,
    rates: Vec<Rates>,
}

impl BothWays {
    /// A section for the tables.
    pub(super) fn text(&self) -> String {
        let Self { rays, hits_differ, any_hits_differ, rates, .. } = self;
        let Self { boxes_per_ray, triangles_per_ray, software_triangles_per_ray, .. } = self;
        let mut text = format!(
            "\nRay queries against the software traversal: of {rays} rays {hits_differ} closest hits and {any_hits_differ} any hits differ.\n\n"
        );
        text += &format!(
            "- a ray is proposed {boxes_per_ray:.1} boxes, in which {triangles_per_ray:.1} triangles are tested; the software traversal tests \
             {software_triangles_per_ray:.1}\n"
        );
        for Rates { mode, ray_queries, software, ratio } in rates {
            let (fast, slow, ratio) = (ray_queries.text(2), software.text(2), ratio.text(2));
            text += &format!("- {mode}: {fast} against {slow} Mrays per wall second, ratio {ratio}\n");
        }
        text
    }
}

/// Compares both ways, in turns; nothing where rays are not traced by ray queries.
pub(super) fn compare(
    traced: &Traced,
    scene: &Scene,
    case: &Case,
    plan: &Plan,
    progress: &mut dyn FnMut(&str),
) -> Result<Option<BothWays>, BenchError> {
    let Traced::Gpu(device, hardware) = traced else { return Ok(None) };
    if !hardware.has_ray_queries() {
        return Ok(None);
    }
    progress("the software traversal beside ray queries");
    let software = GpuTracer::without_ray_queries(Arc::clone(device), scene);
    let software = software.map_err(|error| failed("sending the scene to the device")(error.to_string()))?;
    let courses = [hardware, &software].map(|tracer| Course::new(tracer, case, plan.stride, false));
    let [a, b] = [all_hits(hardware, &case.rays)?, all_hits(&software, &case.rays)?];
    let [any_a, any_b] =
        [any_hits(hardware, courses[0].rays(Mode::Any))?, any_hits(&software, courses[0].rays(Mode::Any))?];
    let modes = [Mode::Closest, Mode::Any].into_iter().chain(plan.gather.iter().map(|rays| Mode::Gather(*rays)));
    let [boxes, counted] = [visits(hardware, &courses[0])?, visits(&software, &courses[0])?];
    let per_ray = |visits: &Visits, count: u64| count as f64 / visits.rays.max(1) as f64;
    Ok(Some(BothWays {
        boxes_per_ray: per_ray(&boxes, boxes.nodes),
        triangles_per_ray: per_ray(&boxes, boxes.triangles),
        software_triangles_per_ray: per_ray(&counted, counted.triangles),
        rays: a.len(),
        hits_differ: differing(&a, &b, |hit: &Hit| (hit.t.to_bits(), hit.instance, hit.primitive, hit.back_face)),
        any_hits_differ: differing(&any_a, &any_b, |blocked: &bool| *blocked),
        rates: modes.map(|mode| rates(&courses, mode, plan.reps)).collect::<Result<_, _>>()?,
    }))
}

/// What some of the rays to their closest hits cost.
fn visits(tracer: &GpuTracer, course: &Course<'_>) -> Result<Visits, BenchError> {
    let rays = course.rays(Mode::Closest);
    let some: Vec<Ray> = rays.iter().copied().step_by(rays.len().div_ceil(COUNTED).max(1)).collect();
    tracer.visits(&some).map_err(|error| failed("counting visits")(error.to_string()))
}

fn any_hits(tracer: &GpuTracer, rays: &[Ray]) -> Result<Vec<bool>, BenchError> {
    let mut blocked = vec![false; rays.len()];
    tracer.any_hit(rays, &mut blocked).map_err(|error| failed("tracing")(error.to_string()))?;
    Ok(blocked)
}

fn differing<T, K: PartialEq>(a: &[T], b: &[T], key: impl Fn(&T) -> K) -> usize {
    a.iter().zip(b).filter(|(a, b)| key(a) != key(b)).count()
}

/// Laps of both in turn; the first of each is not counted, since it compiles.
fn rates(courses: &[Course<'_>; 2], mode: Mode, reps: usize) -> Result<Rates, BenchError> {
    let pool = super::pool(1)?;
    let mut laps = Vec::new();
    for _ in 0..=reps {
        let [a, b] = courses.each_ref().map(|course| course.run(mode, &pool));
        laps.push([a?.mrays_per_wall_second, b?.mrays_per_wall_second]);
    }
    let spread = |value: fn(&[f64; 2]) -> f64| {
        Spread::of(laps.iter().skip(1).map(value))
            .ok_or_else(|| failed("timing")("there were no repetitions".to_owned()))
    };
    Ok(Rates {
        mode: mode.name(),
        ray_queries: spread(|lap| lap[0])?,
        software: spread(|lap| lap[1])?,
        ratio: spread(|lap| lap[0] / lap[1])?,
    })
}

fn failed(step: &'static str) -> impl Fn(String) -> BenchError {
    move |reason| BenchError::Failed { step, reason }
}
