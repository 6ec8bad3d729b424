//! What a person may set, and what it resolves to.

use crate::{REACH_EPSILON, SkipRule};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The most half-distances that one bake computes: the components of a VEC4.
pub const MAX_CHANNELS: usize = 4;

/// Weight α of the edge regulariser where none is given: the least surface error over the levels in
/// docs/benchmarks/least-squares.md. The paper's 1 smooths contact shadows away.
pub const DEFAULT_REGULARIZATION: f64 = 0.003;

/// How much work a bake does, and so how small its error is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// A quick look; target RMSE .016.
    Low,
    /// For the game; target RMSE .006.
    #[default]
    Medium,
    /// For a release; target RMSE .003.
    High,
    /// To compare others with: 1,024 samples of 16 rays on every face, at positions that no other quality uses. What is left
    /// of the error is in the positions, and samples of as many rays as the others' are valid by the same rule.
    Reference,
}

impl Quality {
    /// RMSE of estimation that adaptive sampling aims for; a reference gets its samples whatever they find.
    pub const fn target_rmse(self) -> Option<f64> {
        match self {
            Self::Low => Some(0.016),
            Self::Medium => Some(0.006),
            Self::High => Some(0.003),
            Self::Reference => None,
        }
    }

    /// Most samples per face on average that adaptive sampling gives to a piece.
    pub const fn most_samples_per_face_on_average(self) -> f64 {
        match self {
            Self::Low => 8.0,
            Self::Medium => 32.0,
            Self::High | Self::Reference => 128.0,
        }
    }

    /// Mean number of samples per face, over the faces of an instance, with which adaptive sampling begins.
    pub const fn first_samples_per_face(self) -> f64 {
        match self {
            Self::Low | Self::Medium => 3.0,
            Self::High => 4.0,
            Self::Reference => 1024.0,
        }
    }

    /// Mean number of samples per face, over the faces of an instance, where sampling is not adaptive.
    pub const fn mean_samples_per_face(self) -> f64 {
        match self {
            Self::Low => 2.0,
            Self::Medium => 4.0,
            Self::High => 16.0,
            Self::Reference => 1024.0,
        }
    }

    /// Most samples of one face.
    pub const fn max_samples_per_face(self) -> u32 {
        match self {
            Self::Low => 64,
            Self::Medium => 256,
            Self::High | Self::Reference => 1024,
        }
    }

    /// Least samples of one face: even, so that the two halves get as many.
    pub const fn min_samples_per_face(self) -> u32 {
        match self {
            Self::Reference => 1024,
            _ => 2,
        }
    }

    /// Rays of one sample: the fewest by which a quarter of back faces can be told.
    pub const RAYS_PER_SAMPLE: u32 = 16;
}

/// The value of a ray as a function of the distance to what it hits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Kernel {
    /// `1 − 2^(−t/d)` for each half-distance d, metres (Sloan et al. 2013, equation 1).
    Obscurance {
        /// The half-distances, metres, at most [`MAX_CHANNELS`].
        half_distances_m: Vec<f64>,
    },
    /// 0 for a hit nearer than the ray distance, else 1.
    Occlusion {
        /// Metres; may be infinite.
        ray_distance_m: f64,
    },
}

impl Kernel {
    /// How many values each sample has.
    pub fn channel_count(&self) -> usize {
        match self {
            Self::Obscurance { half_distances_m } => half_distances_m.len(),
            Self::Occlusion { .. } => 1,
        }
    }

    /// Distance beyond which a hit changes a ray's value by less than `epsilon`, metres.
    pub fn reach_m(&self, epsilon: f64) -> f64 {
        match self {
            Self::Obscurance { half_distances_m } => {
                half_distances_m.iter().fold(0.0, |d: f64, &h| d.max(h)) * (1.0 / epsilon).log2()
            }
            Self::Occlusion { ray_distance_m } => *ray_distance_m,
        }
    }
}

/// What a person asks for. Absent values are resolved at import, from the sidecar, the quality or the level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakeSettings {
    /// Sets the counts that are not given.
    pub quality: Quality,
    /// Half-distances, metres; from the sidecar or the level's size if absent.
    pub half_distances_m: Option<Vec<f64>>,
    /// Plain occlusion with this ray distance, metres, in place of obscurance.
    pub occlusion_ray_distance_m: Option<f64>,
    /// RMSE at which adaptive sampling stops.
    pub target_rmse: Option<f64>,
    /// Every face gets the quality's samples, whatever they find. So it is too where a density is given.
    pub fixed_samples: bool,
    /// Rays per sample, a power of two from 1 to 65,536.
    pub rays_per_sample: Option<u32>,
    /// Samples per square metre.
    pub density_per_m2: Option<f64>,
    /// Most samples of one face.
    pub max_samples_per_face: Option<u32>,
    /// A sample with a greater fraction of back-face hits is invalid.
    pub back_face_limit: f64,
    /// Weight α of the edge regulariser, without unit.
    pub regularization: f64,
    /// Adds a plane under the level that occludes.
    pub ground_plane: bool,
    /// What trees and shrubs do to rays.
    pub foliage: FoliageMode,
    /// What the numbers of trees are fitted to.
    pub trees: TreeValues,
    /// Drops faces with non-finite positions or indices out of range, instead of refusing the file.
    pub drop_bad_faces: bool,
    /// Gives values only to nodes, meshes or materials whose name matches.
    pub only: Option<String>,
    /// Another seed gives another, equally good result.
    pub seed: u64,
    /// Rules that leave out work, turned off.
    pub no_skip: BTreeSet<SkipRule>,
    /// What is written.
    pub output: OutputSettings,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self {
            quality: Quality::default(),
            half_distances_m: None,
            occlusion_ray_distance_m: None,
            target_rmse: None,
            fixed_samples: false,
            rays_per_sample: None,
            density_per_m2: None,
            max_samples_per_face: None,
            back_face_limit: 0.25,
            regularization: DEFAULT_REGULARIZATION,
            ground_plane: false,
            foliage: FoliageMode::default(),
            trees: TreeValues::default(),
            drop_bad_faces: false,
            only: None,
            seed: 0,
            no_skip: BTreeSet::new(),
            output: OutputSettings::default(),
        }
    }
}

/// What trees and shrubs do to rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum FoliageMode {
    /// A ray ends at each crossing, and in each stretch of fog, with the probability of being absorbed there; its value is the
    /// expected one. Foliage far beyond the half-distance is forgotten, as other occluders are.
    #[default]
    Expected,
    /// A ray's value is multiplied by what the foliage up to its closest hit, or its reach, keeps (Sloan et al. 2013,
    /// section 2.1).
    Attenuate,
    /// Foliage is opaque geometry: what the other two stand for, where leaves have no holes.
    Geometry,
}

/// What the numbers of a tree's instances are fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum TreeValues {
    /// What is traced at points on the surface of each instance: more accurate than the volume, and fewer rays.
    #[default]
    Traced,
    /// The volume of visibility around trees, whose rays all of them share (Sloan et al. 2013, section 2.2).
    Volume,
}

/// When adaptive sampling has enough.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// RMSE of estimation, over the area of a piece that can be seen, that every half-distance should reach.
    pub rmse: f64,
    /// The same where samples vary so little that no more can be seen: below `rmse` in levels so small that it is cheap.
    pub fine_rmse: f64,
    /// Most samples per face on average in a piece, however noisy, for `rmse`; infinite if only the error counts.
    pub samples_per_face: f64,
    /// Area of the faces that make up most of the level, square metres: in pieces of smaller faces the target is
    /// greater, and their share of samples smaller, by the fourth root of the areas' ratio, up to three times. Where it is
    /// 0 the target is the same everywhere.
    ///
    /// At a given number of rays the error of a level is least if the samples of a face go as the root of its area.
    pub face_area_m2: f64,
}

impl Target {
    /// Faces of a level from which on its target is what the quality says.
    const LARGE_LEVEL_FACES: f64 = 262_144.0;
    /// The finest target, as a fraction of the quality's.
    const FINEST: f64 = 0.25;
    /// An error that cannot be seen next to what the samples vary by.
    const PART_OF_DEVIATION: f64 = 0.05;
    /// The coarsest, where faces are small, as a multiple.
    const COARSEST: f64 = 3.0;

    /// The target that a quality has in a level of as many faces, most of it made of faces of the given area; `None` for
    /// a reference. What takes seconds in a small level is made finer, with the square root of the number of its faces.
    /// Both numbers are rounded up to powers of four, so that small edits do not change the target.
    pub fn of_quality(quality: Quality, faces: u64, face_area_m2: f64) -> Option<Self> {
        let rmse = quality.target_rmse()?;
        let fraction = (power_of_four(faces as f64) / Self::LARGE_LEVEL_FACES).sqrt().clamp(Self::FINEST, 1.0);
        Some(Self {
            rmse,
            fine_rmse: rmse * fraction,
            samples_per_face: quality.most_samples_per_face_on_average(),
            face_area_m2: power_of_four(face_area_m2),
        })
    }

    /// A target that somebody named, whatever it costs.
    pub fn named(rmse: f64) -> Self {
        Self { rmse, fine_rmse: rmse, samples_per_face: f64::INFINITY, face_area_m2: 0.0 }
    }

    /// What a piece aims for whose samples have this standard deviation about the values: an error far below that cannot
    /// be seen, so the finer target is for smooth places.
    pub fn goal(&self, deviation: f64) -> f64 {
        (deviation * Self::PART_OF_DEVIATION).min(self.rmse).max(self.fine_rmse)
    }

    /// By how much the target of a piece is greater, whose faces have this area on average.
    pub fn relaxed(&self, face_area_m2: f64) -> f64 {
        let ratio = if face_area_m2 > 0.0 { self.face_area_m2 / face_area_m2 } else { 1.0 };
        ratio.sqrt().sqrt().clamp(1.0, Self::COARSEST)
    }
}

/// The least power of four that is not below a number; 0 where the number is not positive.
fn power_of_four(number: f64) -> f64 {
    if number > 0.0 && number.is_finite() { ((number.log2() / 2.0).ceil() * 2.0).exp2() } else { 0.0 }
}

/// Settings of sampling and tracing, resolved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sampling {
    /// The value of a ray.
    pub kernel: Kernel,
    /// Rays per sample, a power of two.
    pub rays_per_sample: u32,
    /// When adaptive sampling has enough; without it, sampling is not adaptive.
    pub target: Option<Target>,
    /// Mean samples per face that the density is chosen for, where none is given. Adaptive sampling begins with these.
    pub mean_samples_per_face: f64,
    /// Samples per square metre, if fixed.
    pub density_per_m2: Option<f64>,
    /// Least samples of one face, even and at least 2.
    pub min_samples_per_face: u32,
    /// Most samples of one face, even.
    pub max_samples_per_face: u32,
    /// A sample with a greater fraction of back-face hits is invalid.
    pub back_face_limit: f64,
    /// Mixed into every scramble; a reference bake's differs from every other quality's.
    pub seed: u64,
    /// What trees and shrubs do to rays.
    pub foliage: FoliageMode,
    /// Height of a plane that occludes, relative to the origin, metres along +y, if wanted.
    pub ground_plane_y_m: Option<f64>,
    /// Rules that leave out work, turned off: [`SkipRule::of_sampling`].
    pub no_skip: BTreeSet<SkipRule>,
}

impl Sampling {
    /// Whether a rule that leaves out work applies.
    pub fn skips(&self, rule: SkipRule) -> bool {
        !self.no_skip.contains(&rule)
    }

    /// Distance at which rays end, metres. The distance of plain occlusion is what it means, not a rule that could be
    /// turned off.
    pub fn reach_m(&self) -> f64 {
        match self.kernel {
            Kernel::Obscurance { .. } if !self.skips(SkipRule::Reach) => f64::INFINITY,
            _ => self.kernel.reach_m(REACH_EPSILON),
        }
    }
}

/// Settings of the solve, resolved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SolveSettings {
    /// Weight α of the edge regulariser, without unit (20-least-squares normalisation, S = (A1 + A2)/3).
    pub regularization: f64,
    /// Weight μ of the anchor towards the local average.
    pub anchor: f64,
    /// Vertices at one position whose normals are within this angle, degrees, are one unknown.
    pub weld_degrees: f64,
    /// Rays of each sample, by which the noise of its directions is told from what vertex values cannot follow.
    pub rays_per_sample: u32,
}

impl Default for SolveSettings {
    fn default() -> Self {
        Self { regularization: DEFAULT_REGULARIZATION, anchor: 1e-3, weld_degrees: 5.0, rays_per_sample: 16 }
    }
}

/// Which attributes are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Attribute {
    /// `_AO`, one component for each half-distance.
    #[default]
    Ao,
    /// `COLOR_0`, the blend of the half-distances as grey.
    Color,
    /// Both.
    Both,
}

/// What to do where a COLOR_0 exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ColorMode {
    /// The colour is multiplied by the AO.
    Multiply,
    /// The AO takes the colour's place.
    Replace,
}

/// Component type of `_AO`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum ValueFormat {
    /// 32-bit floats.
    #[default]
    F32,
    /// Normalised 16-bit unsigned integers.
    U16,
}

/// A curve applied to the blend that is written as a colour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Remap {
    /// `ao^gamma`.
    Gamma(f64),
    /// Piecewise linear through (input, output) points with rising inputs.
    Curve(Vec<[f64; 2]>),
}

/// What is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct OutputSettings {
    /// Which attributes.
    pub attribute: Attribute,
    /// Component type of `_AO`.
    pub format: ValueFormat,
    /// What to do where a COLOR_0 exists; must be given if one does.
    pub color: Option<ColorMode>,
    /// Weight of each half-distance in the blend; from the sidecar, or `.03, .97`, if absent.
    pub blend: Option<Vec<f64>>,
    /// A curve applied to the blend.
    pub remap: Option<Remap>,
    /// Whether `_AO_RESIDUAL` is written too: where the mesh is too coarse.
    pub residual: bool,
    /// Whether a pack is written, which an engine loads; it is where the level has visibility regions, too.
    pub pack: bool,
}
