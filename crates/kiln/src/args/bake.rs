//! Options of `kiln bake` and `kiln submit`, and what they resolve to.

use crate::failure::Failure;
use clap::{Args, ValueEnum};
use kiln_core::{
    Attribute, BakeSettings, ColorMode, DEFAULT_REGULARIZATION, FoliageMode, MAX_CHANNELS, OutputSettings, Quality,
    Remap, SkipRule, TreeValues, ValueFormat,
};
use std::{collections::BTreeSet, path::PathBuf};

/// Bakes a level in this process; a second run resumes or answers at once.
#[derive(Args, Debug)]
#[command(after_help = "Examples:
  kiln bake level.glb -o baked.glb
  kiln bake level.glb -o baked.glb --quality high --preview picture.png --report report.json
  kiln bake level.glb -o baked.glb --half-distance 0.5,20 --ci --junit junit.xml")]
pub(crate) struct BakeArgs {
    /// The level: .glb or .gltf
    pub(crate) level: PathBuf,
    /// Where to write the baked .glb
    #[arg(short, long, value_name = "OUT.glb")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) settings: SettingsArgs,
    /// Write what was done and how well, as JSON
    #[arg(long, value_name = "R.json")]
    pub(crate) report: Option<PathBuf>,
    /// Write a picture of the AO
    #[arg(long, value_name = "P.png")]
    pub(crate) preview: Option<PathBuf>,
    /// Write the pack that an engine loads [default: beside the output, if the level has visibility regions]
    #[arg(long, value_name = "P.kiln")]
    pub(crate) pack: Option<PathBuf>,
    /// For CI: no progress, quality gates from the sidecar
    #[arg(long)]
    pub(crate) ci: bool,
    /// With --ci: write the gates as JUnit test cases
    #[arg(long, value_name = "J.xml", requires = "ci")]
    pub(crate) junit: Option<PathBuf>,
}

/// What is computed and written.
#[derive(Args, Debug)]
pub(crate) struct SettingsArgs {
    /// The sidecar [default: LEVEL.kiln.toml beside the level]
    #[arg(long = "level", value_name = "SIDE.toml")]
    pub(crate) sidecar: Option<PathBuf>,
    /// How much work to do
    #[arg(long, value_enum, default_value_t)]
    pub(crate) quality: QualityChoice,
    /// Half-distances in metres, or `auto`
    #[arg(long, value_name = "D1,D2…", default_value = "auto")]
    pub(crate) half_distance: HalfDistances,
    /// Obscurance, or plain occlusion up to --ray-distance
    #[arg(long, value_enum, default_value_t)]
    pub(crate) kernel: KernelChoice,
    /// With --kernel occlusion: hits beyond this many metres do not count [default: infinite]
    #[arg(long, value_name = "METRES")]
    pub(crate) ray_distance: Option<f64>,
    /// Error of estimation at which a place has enough samples [default: the quality's: low .016, medium .006, high .003]
    #[arg(long, value_name = "X", conflicts_with_all = ["fixed_samples", "density"])]
    pub(crate) target_rmse: Option<f64>,
    /// Give every face the quality's samples, whatever they find
    #[arg(long)]
    pub(crate) fixed_samples: bool,
    /// Rays per sample, a power of two
    #[arg(long, value_name = "N")]
    pub(crate) rays: Option<u32>,
    /// Samples per square metre, whatever they find
    #[arg(long, value_name = "S")]
    pub(crate) density: Option<f64>,
    /// Most samples of one face
    #[arg(long, value_name = "N")]
    pub(crate) max_samples_per_face: Option<u32>,
    /// A sample with a greater fraction of back-face hits is invalid
    #[arg(long, value_name = "F", default_value_t = 0.25)]
    pub(crate) back_face_limit: f64,
    /// Weight of the edge regulariser
    #[arg(long, value_name = "ALPHA", default_value_t = DEFAULT_REGULARIZATION)]
    pub(crate) regularization: f64,
    /// What trees and shrubs do to rays
    #[arg(long, value_enum, default_value_t)]
    pub(crate) foliage: FoliageChoice,
    /// What the numbers of trees are fitted to
    #[arg(long, value_enum, default_value_t)]
    pub(crate) trees: TreeChoice,
    /// Add a plane under the level that occludes
    #[arg(long)]
    pub(crate) ground_plane: bool,
    /// Drop faces with bad positions or indices instead of refusing the level
    #[arg(long)]
    pub(crate) drop_bad_faces: bool,
    /// Give values only to nodes, meshes or materials whose name matches; the rest keeps what it has
    #[arg(long, value_name = "GLOB")]
    pub(crate) only: Option<String>,
    /// Another seed gives another, equally good result
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Rules that leave out work, turned off, to see what they change (docs/skips.md)
    #[arg(long, value_enum, value_name = "RULE,RULE…", value_delimiter = ',')]
    pub(crate) no_skip: Vec<RuleChoice>,
    /// Attributes to write: `_AO`, COLOR_0, or both
    #[arg(long, value_enum, default_value_t)]
    pub(crate) attribute: AttributeChoice,
    /// Component type of `_AO`
    #[arg(long, value_enum, default_value_t)]
    pub(crate) format: FormatChoice,
    /// What to do where a COLOR_0 exists
    #[arg(long, value_enum)]
    pub(crate) color: Option<ColorChoice>,
    /// Weight of each half-distance in COLOR_0 [default: the sidecar's, or .03,.97]
    #[arg(long, value_name = "W1,W2…", value_delimiter = ',')]
    pub(crate) blend: Option<Vec<f64>>,
    /// Write `_AO_RESIDUAL` too, where the mesh is too coarse: `kiln view --overlay residual` shows it
    #[arg(long)]
    pub(crate) residual: bool,
    /// Curve applied to COLOR_0: `gamma:G`, or `curve:IN=OUT,IN=OUT…`
    #[arg(long, value_name = "CURVE", value_parser = parse_remap)]
    pub(crate) remap: Option<Remap>,
}

/// `auto`, or a list.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HalfDistances(pub(crate) Option<Vec<f64>>);

impl std::str::FromStr for HalfDistances {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self(None));
        }
        let one = |part: &str| match part.trim().parse::<f64>() {
            Ok(d) if d.is_finite() && d > 0.0 => Ok(d),
            _ => Err(format!("{part:?} is no positive length in metres")),
        };
        let all = text.split(',').map(one).collect::<Result<Vec<_>, _>>()?;
        if all.len() > MAX_CHANNELS {
            return Err(format!("{} half-distances; at most {MAX_CHANNELS} fit one attribute", all.len()));
        }
        Ok(Self(Some(all)))
    }
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum QualityChoice {
    /// A quick look: 2 samples of 16 rays per face.
    Low,
    /// For the game: 4 samples of 32 rays per face.
    #[default]
    Medium,
    /// For a release: 16 samples of 32 rays per face.
    High,
    /// To compare others with: 1,024 samples of 16 rays per face.
    Reference,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum KernelChoice {
    /// 1 − 2^(−t/d).
    #[default]
    Obscurance,
    /// 0 for a hit, 1 for none.
    Occlusion,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum FoliageChoice {
    /// A ray ends where it is absorbed, with that probability: foliage far beyond the half-distance is forgotten.
    #[default]
    Expected,
    /// A ray's value is multiplied by what is kept on its way.
    Attenuate,
    /// Foliage is opaque geometry.
    Geometry,
}

impl From<FoliageChoice> for FoliageMode {
    fn from(choice: FoliageChoice) -> Self {
        match choice {
            FoliageChoice::Expected => Self::Expected,
            FoliageChoice::Attenuate => Self::Attenuate,
            FoliageChoice::Geometry => Self::Geometry,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum TreeChoice {
    /// What is traced at points on each tree.
    #[default]
    Traced,
    /// A volume around all trees, whose rays they share.
    Volume,
}

impl From<TreeChoice> for TreeValues {
    fn from(choice: TreeChoice) -> Self {
        match choice {
            TreeChoice::Volume => Self::Volume,
            TreeChoice::Traced => Self::Traced,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum AttributeChoice {
    /// `_AO`.
    #[default]
    Ao,
    /// COLOR_0.
    Color,
    /// Both.
    Both,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum FormatChoice {
    /// 32-bit floats.
    #[default]
    F32,
    /// Normalised 16-bit integers.
    U16,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ColorChoice {
    /// Multiply it by the AO.
    Multiply,
    /// Put the AO in its place.
    Replace,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum RuleChoice {
    /// Rays end where a hit hardly changes their value.
    Reach,
    /// No ray where nothing lies above a sample's surface.
    #[value(alias = "empty_hemisphere")]
    Empty,
    /// Few samples for faces that are hidden.
    #[value(alias = "buried_faces")]
    Buried,
    /// Faces that repeat others are left out.
    #[value(alias = "duplicate_faces")]
    Duplicates,
    /// Samples where the error is; off, the same as --fixed-samples.
    #[value(alias = "adaptive_sampling")]
    Adaptive,
    /// Results that are known are not made again.
    #[value(alias = "unchanged_work")]
    Unchanged,
    /// All of them.
    All,
}

impl SettingsArgs {
    /// The rules that are turned off.
    fn no_skip(&self) -> Result<BTreeSet<SkipRule>, Failure> {
        let off: BTreeSet<SkipRule> = self.no_skip.iter().flat_map(|choice| choice.rules()).copied().collect();
        if self.target_rmse.is_some() && off.contains(&SkipRule::Adaptive) {
            return Err(Failure::usage(
                "--target-rmse has no meaning without adaptive sampling; drop it, or --no-skip",
            ));
        }
        Ok(off)
    }

    /// The settings, checked.
    pub(crate) fn resolve(&self) -> Result<BakeSettings, Failure> {
        let occlusion = self.kernel == KernelChoice::Occlusion;
        if self.ray_distance.is_some() && !occlusion {
            return Err(Failure::usage("--ray-distance needs --kernel occlusion"));
        }
        if occlusion && self.half_distance.0.is_some() {
            return Err(Failure::usage("--half-distance has no meaning with --kernel occlusion; drop one of them"));
        }
        let rays_ok = |rays: u32| rays.is_power_of_two() && rays <= kiln_trace::MAX_RAYS_PER_SAMPLE;
        if let Some(rays) = self.rays.filter(|&rays| !rays_ok(rays)) {
            let message = format!("--rays {rays}: choose a power of two up to {}", kiln_trace::MAX_RAYS_PER_SAMPLE);
            return Err(Failure::usage(message));
        }
        positive("--ray-distance", self.ray_distance, true)?;
        positive("--density", self.density, false)?;
        positive("--target-rmse", self.target_rmse, false)?;
        if self.max_samples_per_face.is_some_and(|n| !(2..=65_536).contains(&n)) {
            return Err(Failure::usage("--max-samples-per-face: choose a number from 2 to 65536"));
        }
        if !(0.0..=1.0).contains(&self.back_face_limit) {
            return Err(Failure::usage("--back-face-limit: choose a fraction from 0 to 1"));
        }
        if !(0.0..=1e6).contains(&self.regularization) {
            return Err(Failure::usage("--regularization: choose a number from 0 to 1e6"));
        }
        if self.blend.iter().flatten().any(|w| !w.is_finite() || *w < 0.0) {
            return Err(Failure::usage("--blend: weights are numbers from 0 up"));
        }
        Ok(BakeSettings {
            quality: self.quality.into(),
            half_distances_m: self.half_distance.0.clone(),
            occlusion_ray_distance_m: occlusion.then(|| self.ray_distance.unwrap_or(f64::INFINITY)),
            target_rmse: self.target_rmse,
            fixed_samples: self.fixed_samples,
            rays_per_sample: self.rays,
            density_per_m2: self.density,
            max_samples_per_face: self.max_samples_per_face,
            back_face_limit: self.back_face_limit,
            regularization: self.regularization,
            foliage: self.foliage.into(),
            trees: self.trees.into(),
            ground_plane: self.ground_plane,
            drop_bad_faces: self.drop_bad_faces,
            only: self.only.clone(),
            seed: self.seed,
            no_skip: self.no_skip()?,
            output: OutputSettings {
                attribute: self.attribute.into(),
                format: self.format.into(),
                color: self.color.map(Into::into),
                blend: self.blend.clone(),
                remap: self.remap.clone(),
                residual: self.residual,
                pack: false,
            },
        })
    }
}

fn positive(option: &str, value: Option<f64>, may_be_infinite: bool) -> Result<(), Failure> {
    match value {
        Some(v) if !(v > 0.0 && (v.is_finite() || may_be_infinite)) => {
            Err(Failure::usage(format!("{option} {v}: choose a number above 0")))
        }
        _ => Ok(()),
    }
}

fn parse_remap(text: &str) -> Result<Remap, String> {
    let number = |part: &str| part.trim().parse::<f64>().map_err(|_| format!("{part:?} is no number"));
    if let Some(gamma) = text.strip_prefix("gamma:") {
        let gamma = number(gamma)?;
        return if gamma.is_finite() && gamma > 0.0 {
            Ok(Remap::Gamma(gamma))
        } else {
            Err("gamma must be above 0".into())
        };
    }
    let Some(points) = text.strip_prefix("curve:") else {
        return Err("write gamma:G, or curve:IN=OUT,IN=OUT…".into());
    };
    let point = |part: &str| {
        let (input, output) = part.split_once('=').ok_or_else(|| format!("{part:?} is no IN=OUT"))?;
        Ok::<_, String>([number(input)?, number(output)?])
    };
    let points = points.split(',').map(point).collect::<Result<Vec<_>, _>>()?;
    let is_rising = points.windows(2).all(|pair| pair[0][0] < pair[1][0]);
    let in_range = points.iter().flatten().all(|v| (0.0..=1.0).contains(v));
    if points.len() < 2 || !is_rising || !in_range {
        return Err("a curve has at least two points with rising inputs, all in [0, 1]".into());
    }
    Ok(Remap::Curve(points))
}

impl RuleChoice {
    fn rules(self) -> &'static [SkipRule] {
        match self {
            Self::Reach => &[SkipRule::Reach],
            Self::Empty => &[SkipRule::Empty],
            Self::Buried => &[SkipRule::Buried],
            Self::Duplicates => &[SkipRule::Duplicates],
            Self::Adaptive => &[SkipRule::Adaptive],
            Self::Unchanged => &[SkipRule::Unchanged],
            Self::All => &SkipRule::ALL,
        }
    }
}

impl From<QualityChoice> for Quality {
    fn from(choice: QualityChoice) -> Self {
        match choice {
            QualityChoice::Low => Self::Low,
            QualityChoice::Medium => Self::Medium,
            QualityChoice::High => Self::High,
            QualityChoice::Reference => Self::Reference,
        }
    }
}

impl From<AttributeChoice> for Attribute {
    fn from(choice: AttributeChoice) -> Self {
        match choice {
            AttributeChoice::Ao => Self::Ao,
            AttributeChoice::Color => Self::Color,
            AttributeChoice::Both => Self::Both,
        }
    }
}

impl From<FormatChoice> for ValueFormat {
    fn from(choice: FormatChoice) -> Self {
        match choice {
            FormatChoice::F32 => Self::F32,
            FormatChoice::U16 => Self::U16,
        }
    }
}

impl From<ColorChoice> for ColorMode {
    fn from(choice: ColorChoice) -> Self {
        match choice {
            ColorChoice::Multiply => Self::Multiply,
            ColorChoice::Replace => Self::Replace,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_distances_parse() {
        assert_eq!("auto".parse(), Ok(HalfDistances(None)));
        assert_eq!("2, 300".parse(), Ok(HalfDistances(Some(vec![2.0, 300.0]))));
        for bad in ["", "0", "-1", "nan", "inf", "1,2,3,4,5"] {
            assert!(bad.parse::<HalfDistances>().is_err(), "{bad}");
        }
    }

    #[test]
    fn remaps_parse() {
        assert_eq!(parse_remap("gamma:2.2"), Ok(Remap::Gamma(2.2)));
        assert_eq!(parse_remap("curve:0=0.1,1=0.9"), Ok(Remap::Curve(vec![[0.0, 0.1], [1.0, 0.9]])));
        for bad in ["gamma:0", "gamma:x", "curve:0=0", "curve:0=0,0=1", "curve:1=1,0=0", "soft"] {
            assert!(parse_remap(bad).is_err(), "{bad}");
        }
    }
}
