//! Small decorators: one scalar from the values of the surfaces around the anchor (Sloan et al. 2013, section 2.2.1).

use super::{
    baked::BakedSurface,
    sphere::{Reach, Reading, Sphere, SphereReader},
};
use crate::scramble::point_scramble;
use glam::DVec3;
use kiln_core::Bounds;
use kiln_trace::{TraceError, Tracer};

/// Fewer hits than this are held to be too few, and the sphere is made larger.
const LEAST_HITS: u32 = 8;

/// How often a sphere is made twice as large.
const MOST_DOUBLINGS: u32 = 3;

/// Decorators whose rays are made at once.
const DECORATORS_PER_BATCH: usize = 4096;

/// A small decorator, such as a clump of grass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decorator {
    /// Where it stands, metres relative to the level's origin.
    pub anchor_m: DVec3,
    /// Radius of the sphere in which surfaces are read, metres.
    pub radius_m: f64,
}

impl Decorator {
    /// A decorator with the default radius: half the diagonal of its bounds in world space.
    pub fn new(anchor_m: DVec3, bounds_m: &Bounds) -> Self {
        Self { anchor_m, radius_m: 0.5 * bounds_m.diagonal() }
    }

    /// Whether there is a sphere to read.
    fn is_usable(&self) -> bool {
        let largest = self.anchor_m.abs().max_element() + self.radius_m * f64::from(1u32 << MOST_DOUBLINGS);
        self.radius_m > 0.0 && largest < f64::from(f32::MAX)
    }
}

/// How decorators are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoratorSettings {
    /// Directions of each sphere; a power of two is spread best. At least 1.
    pub directions: u32,
    /// Another seed gives another, equally good result.
    pub seed: u64,
}

impl Default for DecoratorSettings {
    fn default() -> Self {
        Self { directions: 256, seed: 0 }
    }
}

/// What a decorator gets.
#[derive(Clone, Debug, PartialEq)]
pub struct DecoratorScalar {
    /// AO for each channel, in [0, 1]; 1 where nothing was read.
    pub ao: Vec<f64>,
    /// Rays that read a value.
    pub hits: u32,
    /// Radius of the sphere that was read in the end, metres: of those with the most hits the largest.
    pub radius_m: f64,
    /// Nothing was read: there is no surface with values around it, or it has no finite place and radius above 0.
    pub is_open: bool,
}

/// Reads each decorator's scalar: the mean of the values where rays from the boundary of its sphere to its centre first meet
/// a surface, from either side, weighted by the distance to the boundary. The sphere is made twice as large, at most three
/// times, until at least eight rays read a value; if none does at last, the scalar is 1 and flagged.
///
/// Surfaces without values stop rays as all do; a ray that they stop reads nothing and does not count, as if it had missed.
/// A decorator's scalar depends on itself, the scene and the settings alone: directions are keyed by its anchor and the
/// seed. The tracer is called once for each round of up to 4,096 decorators, if they have the default 256 directions.
pub fn read_decorators(
    tracer: &dyn Tracer,
    baked: &BakedSurface<'_>,
    decorators: &[Decorator],
    settings: &DecoratorSettings,
) -> Result<Vec<DecoratorScalar>, TraceError> {
    let reader = SphereReader { tracer, baked, directions: settings.directions.max(1) };
    let mut scalars = Vec::with_capacity(decorators.len());
    for batch in decorators.chunks(DECORATORS_PER_BATCH) {
        let spheres: Vec<Sphere> = batch.iter().map(|decorator| sphere(decorator, settings.seed)).collect();
        scalars.extend(read_batch(&reader, batch, &spheres)?);
    }
    Ok(scalars)
}

fn sphere(decorator: &Decorator, seed: u64) -> Sphere {
    Sphere {
        center_m: decorator.anchor_m,
        radius_m: decorator.radius_m,
        reach: Reach::Center,
        scramble: point_scramble(decorator.anchor_m, seed),
        first_index: 0,
    }
}

fn read_batch(
    reader: &SphereReader<'_>,
    decorators: &[Decorator],
    spheres: &[Sphere],
) -> Result<Vec<DecoratorScalar>, TraceError> {
    let mut best: Vec<(f64, Reading)> = spheres.iter().map(|sphere| (sphere.radius_m, Reading::default())).collect();
    let mut sparse: Vec<usize> = (0..spheres.len()).filter(|index| decorators[*index].is_usable()).collect();
    for doublings in 0..=MOST_DOUBLINGS {
        let scale = f64::from(1u32 << doublings);
        let larger = |index: &usize| Sphere { radius_m: scale * spheres[*index].radius_m, ..spheres[*index] };
        let round: Vec<Sphere> = sparse.iter().map(larger).collect();
        for ((index, sphere), reading) in sparse.iter().zip(&round).zip(reader.read(&round)?) {
            // A larger sphere may begin behind what has no values, and read less.
            if reading.hits >= best[*index].1.hits {
                best[*index] = (sphere.radius_m, reading);
            }
        }
        sparse.retain(|index| best[*index].1.hits < LEAST_HITS.min(reader.directions));
    }
    Ok(best.iter().map(|(radius_m, reading)| scalar(*radius_m, reading, reader.baked.channel_count())).collect())
}

fn scalar(radius_m: f64, reading: &Reading, channels: usize) -> DecoratorScalar {
    let is_open = reading.hits == 0;
    let ao = if is_open { vec![1.0; channels] } else { reading.ao[..channels].to_vec() };
    DecoratorScalar { ao, hits: reading.hits, radius_m, is_open }
}
