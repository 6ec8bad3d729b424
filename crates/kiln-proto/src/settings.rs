//! Settings of a bake. An absent value on the wire is the default; a list that is absent in the domain is empty.

use crate::{
    field::{FieldError, at_most, in_range, positive, text},
    limits, v1,
};
use kiln_core::{
    Attribute, BakeSettings, ColorMode, FoliageMode, MAX_CHANNELS, OutputSettings, Quality, Remap, SkipRule,
    TreeValues, ValueFormat,
};
use std::collections::BTreeSet;

/// Most points of a curve.
const CURVE_POINTS: usize = 1024;

impl From<&BakeSettings> for v1::BakeSettings {
    fn from(settings: &BakeSettings) -> Self {
        let quality = match settings.quality {
            Quality::Low => v1::Quality::Low,
            Quality::Medium => v1::Quality::Medium,
            Quality::High => v1::Quality::High,
            Quality::Reference => v1::Quality::Reference,
        };
        Self {
            quality: quality.into(),
            half_distances_m: settings.half_distances_m.clone().unwrap_or_default(),
            occlusion_ray_distance_m: settings.occlusion_ray_distance_m,
            target_rmse: settings.target_rmse,
            fixed_samples: settings.fixed_samples,
            rays_per_sample: settings.rays_per_sample,
            density_per_m2: settings.density_per_m2,
            max_samples_per_face: settings.max_samples_per_face,
            back_face_limit: Some(settings.back_face_limit),
            regularization: Some(settings.regularization),
            ground_plane: settings.ground_plane,
            foliage: v1::FoliageMode::from(settings.foliage).into(),
            trees: match settings.trees {
                TreeValues::Volume => v1::TreeValues::Volume,
                TreeValues::Traced => v1::TreeValues::Traced,
            }
            .into(),
            drop_bad_faces: settings.drop_bad_faces,
            only: settings.only.clone(),
            seed: settings.seed,
            output: Some((&settings.output).into()),
            no_skip: settings.no_skip.iter().map(|rule| v1::SkipRule::from(*rule).into()).collect(),
        }
    }
}

impl TryFrom<v1::BakeSettings> for BakeSettings {
    type Error = FieldError;

    fn try_from(settings: v1::BakeSettings) -> Result<Self, FieldError> {
        let default = Self::default();
        let quality = match settings.quality() {
            v1::Quality::Unspecified => default.quality,
            v1::Quality::Low => Quality::Low,
            v1::Quality::Medium => Quality::Medium,
            v1::Quality::High => Quality::High,
            v1::Quality::Reference => Quality::Reference,
        };
        let foliage = match settings.foliage() {
            v1::FoliageMode::Unspecified => default.foliage,
            v1::FoliageMode::Expected => FoliageMode::Expected,
            v1::FoliageMode::Attenuate => FoliageMode::Attenuate,
            v1::FoliageMode::Geometry => FoliageMode::Geometry,
        };
        let trees = match settings.trees() {
            v1::TreeValues::Unspecified => default.trees,
            v1::TreeValues::Volume => TreeValues::Volume,
            v1::TreeValues::Traced => TreeValues::Traced,
        };
        at_most("half_distances_m", settings.half_distances_m.len(), MAX_CHANNELS)?;
        for (i, &half_distance_m) in settings.half_distances_m.iter().enumerate() {
            positive(&format!("half_distances_m[{i}]"), half_distance_m)?;
        }
        if let Some(distance_m) = settings.occlusion_ray_distance_m {
            in_range("occlusion_ray_distance_m", distance_m, f64::MIN_POSITIVE..=f64::INFINITY)?;
        }
        if let Some(rays) = settings.rays_per_sample
            && !(rays.is_power_of_two() && rays <= 65_536)
        {
            let problem = format!("is {rays}; it must be a power of two from 1 to 65536");
            return Err(FieldError::new("rays_per_sample", problem));
        }
        if settings.max_samples_per_face == Some(0) {
            return Err(FieldError::new("max_samples_per_face", "is 0; it must be at least 1"));
        }
        settings.density_per_m2.map(|density| positive("density_per_m2", density)).transpose()?;
        settings.target_rmse.map(|rmse| positive("target_rmse", rmse)).transpose()?;
        let back_face_limit = settings.back_face_limit.unwrap_or(default.back_face_limit);
        let regularization = settings.regularization.unwrap_or(default.regularization);
        if let Some(only) = &settings.only {
            text("only", only, limits::PATH_BYTES)?;
        }
        let output = settings.output.unwrap_or_default();
        Ok(Self {
            quality,
            half_distances_m: some_list(settings.half_distances_m),
            occlusion_ray_distance_m: settings.occlusion_ray_distance_m,
            target_rmse: settings.target_rmse,
            fixed_samples: settings.fixed_samples,
            rays_per_sample: settings.rays_per_sample,
            density_per_m2: settings.density_per_m2,
            max_samples_per_face: settings.max_samples_per_face,
            back_face_limit: in_range("back_face_limit", back_face_limit, 0.0..=1.0)?,
            regularization: in_range("regularization", regularization, 0.0..=f64::MAX)?,
            ground_plane: settings.ground_plane,
            foliage,
            trees,
            drop_bad_faces: settings.drop_bad_faces,
            only: settings.only,
            seed: settings.seed,
            no_skip: rules(&settings.no_skip)?,
            output: output.try_into().map_err(|e: FieldError| e.within("output"))?,
        })
    }
}

impl From<FoliageMode> for v1::FoliageMode {
    fn from(mode: FoliageMode) -> Self {
        match mode {
            FoliageMode::Expected => Self::Expected,
            FoliageMode::Attenuate => Self::Attenuate,
            FoliageMode::Geometry => Self::Geometry,
        }
    }
}

impl From<SkipRule> for v1::SkipRule {
    fn from(rule: SkipRule) -> Self {
        match rule {
            SkipRule::Reach => Self::Reach,
            SkipRule::Empty => Self::Empty,
            SkipRule::Buried => Self::Buried,
            SkipRule::Duplicates => Self::Duplicates,
            SkipRule::Adaptive => Self::Adaptive,
            SkipRule::Unchanged => Self::Unchanged,
        }
    }
}

fn rules(numbers: &[i32]) -> Result<BTreeSet<SkipRule>, FieldError> {
    at_most("no_skip", numbers.len(), SkipRule::ALL.len())?;
    let rule = |(i, number): (usize, &i32)| match v1::SkipRule::try_from(*number) {
        Ok(v1::SkipRule::Reach) => Ok(SkipRule::Reach),
        Ok(v1::SkipRule::Empty) => Ok(SkipRule::Empty),
        Ok(v1::SkipRule::Buried) => Ok(SkipRule::Buried),
        Ok(v1::SkipRule::Duplicates) => Ok(SkipRule::Duplicates),
        Ok(v1::SkipRule::Adaptive) => Ok(SkipRule::Adaptive),
        Ok(v1::SkipRule::Unchanged) => Ok(SkipRule::Unchanged),
        Ok(v1::SkipRule::Unspecified) | Err(_) => {
            let problem = format!("is {number}, which is no rule; they are numbered from 1 to {}", SkipRule::ALL.len());
            Err(FieldError::new(format!("no_skip[{i}]"), problem))
        }
    };
    numbers.iter().enumerate().map(rule).collect()
}

impl From<&OutputSettings> for v1::OutputSettings {
    fn from(output: &OutputSettings) -> Self {
        use v1::output_settings::Remap as WireRemap;
        let attribute = match output.attribute {
            Attribute::Ao => v1::OutputAttribute::Ao,
            Attribute::Color => v1::OutputAttribute::Color,
            Attribute::Both => v1::OutputAttribute::Both,
        };
        let format = match output.format {
            ValueFormat::F32 => v1::ValueFormat::F32,
            ValueFormat::U16 => v1::ValueFormat::U16,
        };
        let color = match output.color {
            None => v1::ColorMode::Unspecified,
            Some(ColorMode::Multiply) => v1::ColorMode::Multiply,
            Some(ColorMode::Replace) => v1::ColorMode::Replace,
        };
        let remap = output.remap.as_ref().map(|remap| match remap {
            Remap::Gamma(gamma) => WireRemap::Gamma(*gamma),
            Remap::Curve(points) => {
                let points = points.iter().map(|&[input, output]| v1::RemapPoint { input, output }).collect();
                WireRemap::Curve(v1::RemapCurve { points })
            }
        });
        Self {
            attribute: attribute.into(),
            format: format.into(),
            color: color.into(),
            blend: output.blend.clone().unwrap_or_default(),
            remap,
            residual: output.residual,
            pack: output.pack,
        }
    }
}

impl TryFrom<v1::OutputSettings> for OutputSettings {
    type Error = FieldError;

    fn try_from(output: v1::OutputSettings) -> Result<Self, FieldError> {
        use v1::output_settings::Remap as WireRemap;
        let attribute = match output.attribute() {
            v1::OutputAttribute::Unspecified | v1::OutputAttribute::Ao => Attribute::Ao,
            v1::OutputAttribute::Color => Attribute::Color,
            v1::OutputAttribute::Both => Attribute::Both,
        };
        let format = match output.format() {
            v1::ValueFormat::Unspecified | v1::ValueFormat::F32 => ValueFormat::F32,
            v1::ValueFormat::U16 => ValueFormat::U16,
        };
        let color = match output.color() {
            v1::ColorMode::Unspecified => None,
            v1::ColorMode::Multiply => Some(ColorMode::Multiply),
            v1::ColorMode::Replace => Some(ColorMode::Replace),
        };
        at_most("blend", output.blend.len(), MAX_CHANNELS)?;
        for (i, &weight) in output.blend.iter().enumerate() {
            in_range(&format!("blend[{i}]"), weight, 0.0..=f64::MAX)?;
        }
        let remap = match output.remap {
            None => None,
            Some(WireRemap::Gamma(gamma)) => Some(Remap::Gamma(positive("gamma", gamma)?)),
            Some(WireRemap::Curve(curve)) => Some(Remap::Curve(points(&curve)?)),
        };
        let (blend, residual, pack) = (some_list(output.blend), output.residual, output.pack);
        Ok(Self { attribute, format, color, blend, remap, residual, pack })
    }
}

fn points(curve: &v1::RemapCurve) -> Result<Vec<[f64; 2]>, FieldError> {
    at_most("curve.points", curve.points.len(), CURVE_POINTS)?;
    if curve.points.len() < 2 {
        return Err(FieldError::new("curve.points", "has fewer than two points"));
    }
    if !curve.points.is_sorted_by(|a, b| a.input < b.input) {
        return Err(FieldError::new("curve.points", "has inputs that do not rise"));
    }
    let points = curve.points.iter().enumerate().map(|(i, point)| {
        let input = in_range(&format!("curve.points[{i}].input"), point.input, 0.0..=1.0)?;
        let output = in_range(&format!("curve.points[{i}].output"), point.output, 0.0..=1.0)?;
        Ok([input, output])
    });
    points.collect()
}

fn some_list(list: Vec<f64>) -> Option<Vec<f64>> {
    (!list.is_empty()).then_some(list)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::{option, prelude::*, sample::select};

    fn any_output() -> impl Strategy<Value = OutputSettings> {
        let remap = prop_oneof![
            (0.1..4.0f64).prop_map(Remap::Gamma),
            Just(Remap::Curve(vec![[0.0, 0.1], [0.5, 0.9], [1.0, 1.0]]))
        ];
        (
            select(vec![Attribute::Ao, Attribute::Color, Attribute::Both]),
            select(vec![ValueFormat::F32, ValueFormat::U16]),
            option::of(select(vec![ColorMode::Multiply, ColorMode::Replace])),
            option::of(prop::collection::vec(0.0..1.0f64, 1..=4)),
            option::of(remap),
            any::<[bool; 2]>(),
        )
            .prop_map(|(attribute, format, color, blend, remap, [residual, pack])| OutputSettings {
                attribute,
                format,
                color,
                blend,
                remap,
                residual,
                pack,
            })
    }

    fn any_settings() -> impl Strategy<Value = BakeSettings> {
        let counts = (option::of(0..=16u32), option::of(1..1000u32), any::<u64>(), any::<bool>(), any::<bool>());
        let floats = (
            option::of(prop::collection::vec(0.01..1e4f64, 1..=4)),
            option::of(prop_oneof![0.1..100.0f64, Just(f64::INFINITY)]),
            option::of(0.1..100.0f64),
            0.0..=1.0f64,
            0.0..10.0f64,
            option::of(1e-4..1.0f64),
        );
        let quality = select(vec![Quality::Low, Quality::Medium, Quality::High, Quality::Reference]);
        let rules = prop::sample::subsequence(SkipRule::ALL.to_vec(), 0..=SkipRule::ALL.len());
        let modes = select(vec![FoliageMode::Expected, FoliageMode::Attenuate, FoliageMode::Geometry]);
        let quality = (quality, rules, modes);
        (counts, floats, quality, option::of("[a-z*]{0,8}"), any_output()).prop_map(|(n, f, quality, only, output)| {
            BakeSettings {
                quality: quality.0,
                foliage: quality.2,
                trees: if n.3 { TreeValues::Traced } else { TreeValues::Volume },
                no_skip: quality.1.into_iter().collect(),
                rays_per_sample: n.0.map(|bits| 1 << bits),
                max_samples_per_face: n.1,
                seed: n.2,
                ground_plane: n.3,
                drop_bad_faces: n.4,
                half_distances_m: f.0,
                occlusion_ray_distance_m: f.1,
                density_per_m2: f.2,
                target_rmse: f.5,
                fixed_samples: n.4,
                back_face_limit: f.3,
                regularization: f.4,
                only,
                output,
            }
        })
    }

    proptest! {
        #[test]
        fn settings_and_back(settings in any_settings()) {
            prop_assert_eq!(BakeSettings::try_from(v1::BakeSettings::from(&settings)), Ok(settings));
        }
    }

    #[test]
    fn nothing_given_is_the_default() {
        assert_eq!(BakeSettings::try_from(v1::BakeSettings::default()), Ok(BakeSettings::default()));
    }

    #[test]
    fn errors_name_the_field() {
        let field = |settings: v1::BakeSettings| BakeSettings::try_from(settings).unwrap_err().field;
        let with = v1::BakeSettings::default;
        assert_eq!(field(v1::BakeSettings { half_distances_m: vec![1.0, -1.0], ..with() }), "half_distances_m[1]");
        assert_eq!(field(v1::BakeSettings { half_distances_m: vec![1.0; 5], ..with() }), "half_distances_m");
        assert_eq!(field(v1::BakeSettings { rays_per_sample: Some(3), ..with() }), "rays_per_sample");
        assert_eq!(field(v1::BakeSettings { back_face_limit: Some(f64::NAN), ..with() }), "back_face_limit");
        assert_eq!(field(v1::BakeSettings { density_per_m2: Some(f64::INFINITY), ..with() }), "density_per_m2");
        for no_skip in [vec![1, 9], vec![1, 0]] {
            assert_eq!(field(v1::BakeSettings { no_skip, ..with() }), "no_skip[1]");
        }
        assert_eq!(field(v1::BakeSettings { no_skip: vec![1; 7], ..with() }), "no_skip");
        let remap = Some(v1::output_settings::Remap::Gamma(0.0));
        let output = Some(v1::OutputSettings { remap, ..Default::default() });
        assert_eq!(field(v1::BakeSettings { output, ..with() }), "output.gamma");
    }
}
