//! Points and normals that no model was fitted to, and what is traced there.

use super::Args;
use glam::DVec3;
use kiln_bake::{ProbePoint, gather_points, probe};
use kiln_core::{Level, REGION_HARMONICS, RegionSamples};
use kiln_trace::{
    KernelRates, Ray, SobolScramble, TraceError, Tracer, quadratic_harmonics, sobol_point, sphere_direction,
};
use rayon::prelude::*;

/// Rays of the sphere at a point whose harmonics are compared.
const SPHERE_RAYS: u32 = 4096;

/// Root mean square of errors, for each channel.
#[derive(Clone, Debug, Default)]
pub(super) struct Rmse(pub(super) Vec<f64>);

impl Rmse {
    pub(super) fn text(&self) -> String {
        let all: Vec<String> = self.0.iter().map(|error| format!("{error:.4}")).collect();
        all.join(" / ")
    }
}

struct Place {
    region: usize,
    point: DVec3,
    normal: DVec3,
    /// Traced, for each channel.
    ao: Vec<f64>,
    /// Coefficients of what is seen at the very point, for each channel.
    harmonics: Vec<f64>,
}

/// Places in all regions.
pub(super) struct HeldOut(Vec<Place>);

impl HeldOut {
    /// Traces random points of each region that the nearest valid point sees, about random normals.
    pub(super) fn trace(
        level: &Level,
        tracer: &dyn Tracer,
        samples: &RegionSamples,
        args: &Args,
    ) -> Result<Self, TraceError> {
        let regions = (0..level.regions.regions.len()).into_par_iter();
        let places = regions.map(|region| of_region(level, tracer, samples, region, args));
        Ok(Self(places.collect::<Result<Vec<Vec<Place>>, _>>()?.into_iter().flatten().collect()))
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Of models that give all coefficients at a point of a region.
    pub(super) fn rmse(&self, model: impl Fn(usize, DVec3) -> Vec<f64>) -> Rmse {
        self.errors(|place| model(place.region, place.point))
    }

    /// Of the nine harmonics at each point itself: what no model of them can be better than.
    pub(super) fn rmse_of_harmonics(&self) -> Rmse {
        self.errors(|place| place.harmonics.clone())
    }

    fn errors(&self, coefficients: impl Fn(&Place) -> Vec<f64>) -> Rmse {
        let channels = self.0.first().map_or(0, |place| place.ao.len());
        let mut sums = vec![0.0; channels];
        for place in &self.0 {
            let all = coefficients(place);
            for (channel, sum) in sums.iter_mut().enumerate() {
                *sum += (ao(&all, channel, place.normal) - place.ao[channel]).powi(2);
            }
        }
        Rmse(sums.into_iter().map(|sum| (sum / self.0.len().max(1) as f64).sqrt()).collect())
    }
}

/// AO of a channel about a unit normal.
pub(super) fn ao(coefficients: &[f64], channel: usize, normal: DVec3) -> f64 {
    let of_channel = &coefficients[channel * REGION_HARMONICS..][..REGION_HARMONICS];
    let basis = quadratic_harmonics(normal.as_vec3());
    of_channel.iter().zip(basis).map(|(c, y)| c * f64::from(y)).sum::<f64>().clamp(0.0, 1.0)
}

fn of_region(
    level: &Level,
    tracer: &dyn Tracer,
    samples: &RegionSamples,
    region: usize,
    args: &Args,
) -> Result<Vec<Place>, TraceError> {
    let box_of = &level.regions.regions[region];
    let limit = level.regions.settings.back_face_limit;
    let kernel = KernelRates::of(&level.sampling);
    let valid: Vec<DVec3> = samples.valid[region].iter().map(|index| box_of.candidate(index)).collect();
    let mut places = Vec::new();
    for index in 0..args.held_out {
        let random = |stream: u32| sobol_point(index, SobolScramble([region as u32 * 4 + stream, 77 + stream]));
        let [[x, y], [z, _]] = [random(0), random(1)];
        let at = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
        let point = box_of.bounds.min + (box_of.bounds.max - box_of.bounds.min) * at;
        let distance = |p: &&DVec3| p.distance_squared(point);
        let nearest = valid.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let Some(nearest) = nearest else { continue };
        if !sees(tracer, *nearest, point)? {
            continue;
        }
        let normal = sphere_direction(random(2)).as_dvec3();
        let asked = ProbePoint { position: point, normal, geometric: None };
        let found = probe(tracer, &[asked], &level.sampling.kernel, args.rays, index)?.remove(0);
        if found.back_face_fraction > limit {
            continue;
        }
        let harmonics = gather_points(tracer, &[point], (&kernel, SPHERE_RAYS, 1))?.remove(0);
        let harmonics = harmonics.into_iter().flatten().map(f64::from).collect();
        places.push(Place { region, point, normal, ao: found.ao, harmonics });
    }
    Ok(places)
}

fn sees(tracer: &dyn Tracer, from: DVec3, to: DVec3) -> Result<bool, TraceError> {
    let origin = from.as_vec3();
    let mut blocked = [false];
    tracer.any_hit(&[Ray { origin, direction: to.as_vec3() - origin, t_max: 1.0 }], &mut blocked)?;
    Ok(!blocked[0])
}
