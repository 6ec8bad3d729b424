//! From what a person asked for to what is baked: the sidecar, the quality and the level fill in what is absent.

use crate::{
    SceneError, Sidecar,
    findings::{Finding, Findings},
};
use glam::DVec3;
use globset::{Glob, GlobMatcher};
use kiln_core::{
    BakeSettings, Bounds, DigestBuilder, Kernel, MAX_CHANNELS, OutputSettings, Quality, Remap, Sampling, SkipRule,
    SolveSettings, Target,
};

/// The grid that origins are on, metres: an edit moves the origin seldom, and its coordinates are exact.
const ORIGIN_GRID_M: f64 = 1024.0;
/// Automatic half-distances, metres: the short one and its greatest part of the diagonal, then the long one.
const SHORT_M: (f64, f64) = (2.0, 0.04);
const LONG_M: (f64, f64) = (300.0, 6.0);
/// Weights of the short and the long half-distance in a colour (Sloan et al. 2013).
const BLEND: [f64; 2] = [0.03, 0.97];
const MOST_RAYS: u32 = 65_536;
const MOST_SAMPLES: u32 = 65_536;

/// What settings come to in one level.
pub(crate) struct Resolved {
    pub(crate) sampling: Sampling,
    pub(crate) solve: SolveSettings,
    pub(crate) output: OutputSettings,
}

/// Where the local origin is put for a level with these bounds.
pub(crate) fn origin(bounds: &Bounds) -> DVec3 {
    (bounds.center() / ORIGIN_GRID_M).round() * ORIGIN_GRID_M
}

/// Refuses settings that no level can be baked with, before anything is read.
pub(crate) fn check(settings: &BakeSettings) -> Result<(), SceneError> {
    let refuse = |setting, problem: String| Err(SceneError::Setting { setting, problem });
    let positive = |value: f64| value.is_finite() && value > 0.0;
    if let Some(distances) = &settings.half_distances_m {
        if distances.is_empty() || distances.len() > MAX_CHANNELS || !distances.iter().all(|&d| positive(d)) {
            return refuse("--half-distance", format!("{distances:?} is not one to four positive lengths in metres"));
        }
        if settings.occlusion_ray_distance_m.is_some() {
            return refuse("--half-distance", "plain occlusion has none; leave it out or use obscurance".to_owned());
        }
    }
    if let Some(distance) = settings.occlusion_ray_distance_m.filter(|distance| distance.is_nan() || *distance <= 0.0) {
        return refuse("--ray-distance", format!("{distance} m is not a positive length or inf"));
    }
    if let Some(rays) = settings.rays_per_sample.filter(|rays| !rays.is_power_of_two() || *rays > MOST_RAYS) {
        return refuse("--rays", format!("{rays} is not a power of two from 1 to {MOST_RAYS}"));
    }
    if let Some(density) = settings.density_per_m2.filter(|&density| !positive(density)) {
        return refuse("--density", format!("{density} is not a positive number of samples per square metre"));
    }
    if let Some(most) = settings.max_samples_per_face.filter(|most| !(1..=MOST_SAMPLES).contains(most)) {
        return refuse("--max-samples-per-face", format!("{most} is not a number from 1 to {MOST_SAMPLES}"));
    }
    if !(0.0..=1.0).contains(&settings.back_face_limit) {
        return refuse("--back-face-limit", format!("{} is not between 0 and 1", settings.back_face_limit));
    }
    if !(settings.regularization.is_finite() && settings.regularization >= 0.0) {
        return refuse("--regularization", format!("{} is not a number of at least 0", settings.regularization));
    }
    check_output(&settings.output)
}

fn check_output(output: &OutputSettings) -> Result<(), SceneError> {
    let refuse = |setting, problem: String| Err(SceneError::Setting { setting, problem });
    if let Some(blend) = &output.blend {
        let good = blend.iter().all(|weight| weight.is_finite() && *weight >= 0.0) && blend.iter().sum::<f64>() > 0.0;
        if !good {
            return refuse("--blend", format!("{blend:?}: weights are not negative, and at least one is positive"));
        }
    }
    match &output.remap {
        Some(Remap::Gamma(gamma)) if !(gamma.is_finite() && *gamma > 0.0) => {
            refuse("--remap", format!("a gamma of {gamma} is not a positive number"))
        }
        Some(Remap::Curve(points)) => {
            let finite = points.iter().flatten().all(|value| value.is_finite());
            let rising = points.windows(2).all(|pair| pair[0][0] < pair[1][0]);
            if points.len() >= 2 && finite && rising {
                return Ok(());
            }
            refuse("--remap", "a curve has at least two points, whose inputs rise".to_owned())
        }
        _ => Ok(()),
    }
}

/// The glob of `--only`.
pub(crate) fn only(settings: &BakeSettings) -> Result<Option<GlobMatcher>, SceneError> {
    let compile = |glob: &String| Glob::new(glob).map(|glob| glob.compile_matcher());
    let error = |error: globset::Error| SceneError::Setting { setting: "--only", problem: error.to_string() };
    settings.only.as_ref().map(compile).transpose().map_err(error)
}

/// Resolves checked settings for a level with these bounds, which are relative to its origin, and as many faces in
/// all its instances, most of them of the given area.
pub(crate) fn resolve(
    settings: &BakeSettings,
    sidecar: &Sidecar,
    bounds: &Bounds,
    (faces, face_area_m2): (u64, f64),
    findings: &mut Findings,
) -> Result<Resolved, SceneError> {
    let kernel = kernel(settings, sidecar, bounds);
    let blend = blend(settings, sidecar, kernel.channel_count(), findings)?;
    let quality = settings.quality;
    let most = settings.max_samples_per_face.unwrap_or(quality.max_samples_per_face()).next_multiple_of(2);
    let fixed = settings.fixed_samples || settings.no_skip.contains(&SkipRule::Adaptive);
    let target = if fixed || settings.density_per_m2.is_some() {
        None
    } else {
        settings.target_rmse.map(Target::named).or_else(|| Target::of_quality(quality, faces, face_area_m2))
    };
    let adaptive_mean = target.map(|_| quality.first_samples_per_face());
    let sampling = Sampling {
        target,
        rays_per_sample: settings.rays_per_sample.unwrap_or(Quality::RAYS_PER_SAMPLE),
        mean_samples_per_face: adaptive_mean.unwrap_or(quality.mean_samples_per_face()),
        density_per_m2: settings.density_per_m2,
        min_samples_per_face: quality.min_samples_per_face().min(most),
        max_samples_per_face: most,
        back_face_limit: settings.back_face_limit,
        seed: seed(settings),
        foliage: settings.foliage,
        ground_plane_y_m: (settings.ground_plane && !bounds.is_empty()).then_some(bounds.min.y),
        no_skip: SkipRule::of_sampling(&settings.no_skip),
        kernel,
    };
    let solve = SolveSettings {
        regularization: settings.regularization,
        rays_per_sample: sampling.rays_per_sample,
        ..SolveSettings::default()
    };
    Ok(Resolved { sampling, solve, output: OutputSettings { blend: Some(blend), ..settings.output.clone() } })
}

fn kernel(settings: &BakeSettings, sidecar: &Sidecar, bounds: &Bounds) -> Kernel {
    if let Some(ray_distance_m) = settings.occlusion_ray_distance_m {
        return Kernel::Occlusion { ray_distance_m };
    }
    let given = settings.half_distances_m.clone().or_else(|| sidecar.half_distances_m.clone());
    Kernel::Obscurance { half_distances_m: given.unwrap_or_else(|| automatic_half_distances(bounds.diagonal())) }
}

/// min(2 m, 4 % of D) and min(300 m, 6 D), where D is the diagonal rounded up to a power of two, so that small edits
/// don't change them. In an empty level, D has no say.
fn automatic_half_distances(diagonal_m: f64) -> Vec<f64> {
    let diagonal_m = if diagonal_m > 0.0 { power_of_two_above(diagonal_m) } else { f64::INFINITY };
    [SHORT_M, LONG_M].map(|(most, part)| f64::min(most, part * diagonal_m)).to_vec()
}

/// The least power of two that is not below a positive number; numbers below 2⁻¹⁰²² give that.
fn power_of_two_above(value: f64) -> f64 {
    const MANTISSA_BITS: u32 = 52;
    let bits = value.max(f64::MIN_POSITIVE).to_bits();
    let whole = bits >> MANTISSA_BITS;
    let above = whole + u64::from(bits != whole << MANTISSA_BITS);
    f64::from_bits(above << MANTISSA_BITS)
}

/// The weights of the channels, with the sum 1: from the settings, else from the sidecar, else .03 and .97 for two
/// channels and equal ones for any other number.
fn blend(
    settings: &BakeSettings,
    sidecar: &Sidecar,
    channels: usize,
    findings: &mut Findings,
) -> Result<Vec<f64>, SceneError> {
    if let Some(blend) = &settings.output.blend
        && blend.len() != channels
    {
        let problem = format!("{} weights for {channels} channels; give one for each", blend.len());
        return Err(SceneError::Setting { setting: "--blend", problem });
    }
    let from_sidecar = sidecar.blend.as_ref().filter(|blend| {
        let fits = blend.len() == channels;
        findings.add(Finding::UnusedBlend, "the sidecar", u64::from(!fits && settings.output.blend.is_none()));
        fits
    });
    let default = || if channels == BLEND.len() { BLEND.to_vec() } else { vec![1.0; channels] };
    let mut weights = settings.output.blend.as_ref().or(from_sidecar).cloned().unwrap_or_else(default);
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= sum);
    Ok(weights)
}

/// The seed of a bake; a reference bake's is another number, so that it shares no position with what it judges.
fn seed(settings: &BakeSettings) -> u64 {
    if settings.quality != Quality::Reference {
        return settings.seed;
    }
    let digest = DigestBuilder::new("kiln reference seed").integer(settings.seed).finish();
    u64::from_le_bytes(std::array::from_fn(|i| digest.as_bytes()[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(size: f64) -> Bounds {
        Bounds { min: DVec3::ZERO, max: DVec3::new(size, 0.0, 0.0) }
    }

    fn resolved(settings: &BakeSettings, sidecar: &Sidecar, size: f64) -> Resolved {
        check(settings).unwrap();
        resolve(settings, sidecar, &bounds(size), (1000, 1.0), &mut Findings::default()).unwrap()
    }

    fn half_distances(settings: &BakeSettings, sidecar: &Sidecar, size: f64) -> Vec<f64> {
        match resolved(settings, sidecar, size).sampling.kernel {
            Kernel::Obscurance { half_distances_m } => half_distances_m,
            Kernel::Occlusion { .. } => Vec::new(),
        }
    }

    #[test]
    fn powers_of_two() {
        for (value, above) in [(1.0, 1.0), (1.0 + 1e-15, 2.0), (0.3, 0.5), (100.0, 128.0), (1e-320, f64::MIN_POSITIVE)]
        {
            assert_eq!(power_of_two_above(value), above);
        }
    }

    #[test]
    fn half_distances_come_from_settings_then_sidecar_then_size() {
        let (mut settings, mut sidecar) = (BakeSettings::default(), Sidecar::default());
        assert_eq!(half_distances(&settings, &sidecar, 3.9), [0.16, 24.0]);
        assert_eq!(half_distances(&settings, &sidecar, 4.0), [0.16, 24.0]);
        assert_eq!(half_distances(&settings, &sidecar, 1000.0), [2.0, 300.0]);
        let empty = resolve(&settings, &sidecar, &Bounds::EMPTY, (0, 0.0), &mut Findings::default()).unwrap();
        assert_eq!(empty.sampling.kernel, Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] });
        sidecar.half_distances_m = Some(vec![5.0]);
        assert_eq!(half_distances(&settings, &sidecar, 4.0), [5.0]);
        settings.half_distances_m = Some(vec![1.0, 2.0, 3.0]);
        assert_eq!(half_distances(&settings, &sidecar, 4.0), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn blends_sum_to_one() {
        let (mut settings, mut sidecar) = (BakeSettings::default(), Sidecar::default());
        assert_eq!(resolved(&settings, &sidecar, 4.0).output.blend, Some(vec![0.03, 0.97]));
        sidecar.blend = Some(vec![1.0, 3.0]);
        assert_eq!(resolved(&settings, &sidecar, 4.0).output.blend, Some(vec![0.25, 0.75]));
        settings.half_distances_m = Some(vec![1.0, 2.0, 3.0, 4.0]);
        let mut findings = Findings::default();
        let output = resolve(&settings, &sidecar, &bounds(4.0), (1000, 1.0), &mut findings).unwrap().output;
        assert_eq!(output.blend, Some(vec![0.25; 4]));
        assert_eq!(findings.into_warnings()[0].code, "unused_blend");
        settings.output.blend = Some(vec![1.0]);
        assert!(resolve(&settings, &sidecar, &bounds(4.0), (1000, 1.0), &mut Findings::default()).is_err());
    }

    #[test]
    fn reference_has_positions_of_its_own_and_even_counts() {
        let mut settings = BakeSettings { max_samples_per_face: Some(7), seed: 5, ..BakeSettings::default() };
        let sampling = resolved(&settings, &Sidecar::default(), 4.0).sampling;
        assert_eq!((sampling.seed, sampling.max_samples_per_face), (5, 8));
        settings.quality = Quality::Reference;
        let reference = resolved(&settings, &Sidecar::default(), 4.0).sampling;
        assert_ne!(reference.seed, 5);
        assert_eq!((reference.min_samples_per_face, reference.max_samples_per_face), (8, 8));
    }

    #[test]
    fn wrong_settings_are_refused() {
        let refused = |change: fn(&mut BakeSettings)| {
            let mut settings = BakeSettings::default();
            change(&mut settings);
            check(&settings).is_err()
        };
        assert!(!refused(|_| {}));
        assert!(!refused(|s| s.occlusion_ray_distance_m = Some(f64::INFINITY)));
        assert!(refused(|s| s.half_distances_m = Some(vec![])));
        assert!(refused(|s| s.half_distances_m = Some(vec![f64::NAN])));
        assert!(refused(|s| s.occlusion_ray_distance_m = Some(0.0)));
        assert!(refused(|s| (s.occlusion_ray_distance_m, s.half_distances_m) = (Some(1.0), Some(vec![1.0]))));
        assert!(refused(|s| s.rays_per_sample = Some(24)));
        assert!(refused(|s| s.density_per_m2 = Some(0.0)));
        assert!(refused(|s| s.max_samples_per_face = Some(0)));
        assert!(refused(|s| s.back_face_limit = 1.5));
        assert!(refused(|s| s.regularization = -1.0));
        assert!(refused(|s| s.output.blend = Some(vec![-1.0, 2.0])));
        assert!(refused(|s| s.output.remap = Some(Remap::Gamma(0.0))));
        assert!(refused(|s| s.output.remap = Some(Remap::Curve(vec![[0.0, 0.0], [0.0, 1.0]]))));
    }

    #[test]
    fn origins_are_on_the_grid() {
        let bounds = Bounds { min: DVec3::new(1500.0, -10.0, -600.0), max: DVec3::new(1600.0, 10.0, -500.0) };
        assert_eq!(origin(&bounds), DVec3::new(2048.0, 0.0, -1024.0));
        assert_eq!(origin(&Bounds::EMPTY), DVec3::ZERO);
    }
}
