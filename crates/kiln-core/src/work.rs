//! What the tasks of a graph do: one variant of [`Work`] for each kind.
//!
//! A new kind is a variant here and in [`TaskKind`]; the compiler then asks for its lane, its inputs, the check of its
//! result, its message in `kiln-proto` and its arm in `kiln-worker`. Whoever plans, leases, stores or skips tasks
//! treats all kinds alike.

use crate::{
    CANDIDATES, FaceMoments, InstanceNumbers, MomentsError, PointValues, RegionModels, RegionSamples, Solution,
    TaskKind, TreeFits, codec,
};
use serde::{Deserialize, Serialize};

/// What a task of a graph does, with all that a worker needs besides the level and the results of other tasks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Work {
    /// Gives encoded [`FaceMoments`]; takes nothing.
    Trace(TraceWork),
    /// Gives an encoded [`Solution`]; takes the moments of its instance's pieces, in the order of their faces.
    Solve(SolveWork),
    /// Gives an encoded `kiln_bake::volume::VolumeBatch`; takes nothing.
    Volume(VolumeWork),
    /// Gives encoded [`PointValues`]; takes nothing.
    Points(PointsWork),
    /// Gives encoded [`RegionSamples`]; takes nothing.
    Regions(RegionsWork),
    /// Gives encoded [`RegionModels`]; takes the samples of all regions, in their order.
    Model(ModelWork),
    /// Gives encoded [`TreeFits`]; takes the [`Solution`] of its model alone, then all batches of the volume, or the values
    /// at the points of all its instances; of a lower level of detail, the fits of the full one.
    Fit(FitWork),
    /// Gives an encoded `Vec<InstanceNumbers>`; takes the solutions of the instances around.
    Read(ReadWork),
    /// Gives encoded [`FaceMoments`], as a trace does; takes the solutions of the instances that it stands for.
    Resample(ResampleWork),
}

/// One piece of an instance to be traced: a run of its faces. Its cost is the rays that it will need at most.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TraceWork {
    /// Index of the instance.
    pub instance: u32,
    /// First face of the piece.
    pub first_face: u32,
    /// Faces of the piece, at least one.
    pub face_count: u32,
    /// Samples per square metre of the instance, finite and not negative.
    pub density_per_m2: f64,
    /// It is traced as a model: at the scale of its model, with nothing around it.
    pub alone: bool,
}

/// The solve of one instance. Its cost is its vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SolveWork {
    /// Index of the instance.
    pub instance: u32,
    /// Vertices of its mesh.
    pub vertex_count: u32,
    /// Its pieces were traced as a model's.
    pub alone: bool,
}

/// Rays of each voxel of the volume around trees (Sloan et al. 2013, section 4).
pub const RAYS_PER_VOXEL: u32 = 1024;

/// Rays of each side of a point on an instance of a model that has so many: of what many instances say of their model's own
/// AO the noise averages out, and the four numbers of each are of thousands of points.
pub const fn rays_per_point(instances: usize) -> u32 {
    if instances < 32 { 128 } else { 32 }
}

/// Some bricks of the volume around a level's trees. Its cost is the rays of their voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VolumeWork {
    /// Index of the first brick in the level's layout.
    pub first_brick: u32,
    /// Bricks, at least one.
    pub brick_count: u32,
}

/// What can be seen from the points of some instances of a model. Its cost is the rays of their points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointsWork {
    /// Index of the model's mesh in the level.
    pub mesh: u32,
    /// The first of the model's instances that receive.
    pub first: u32,
    /// How many of them, at least one.
    pub count: u32,
    /// Points of each.
    pub point_count: u32,
    /// Rays of each side of a point, a power of two.
    pub rays: u32,
}

/// What can be seen in some visibility regions. Its cost is the rays of their candidates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionsWork {
    /// Index of the first region in the level.
    pub first: u32,
    /// How many, at least one.
    pub count: u32,
}

/// The models of all visibility regions. Its cost is their candidates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelWork {
    /// Regions of the level, at least one.
    pub region_count: u32,
}

impl ModelWork {
    /// Points that there are at most.
    pub const fn points(self) -> u64 {
        self.region_count as u64 * CANDIDATES as u64
    }
}

/// The fit of all instances of one model of trees. Its cost is their vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FitWork {
    /// Index of the model's mesh in the level.
    pub mesh: u32,
    /// Vertices of the mesh.
    pub vertex_count: u32,
    /// Its instances that receive.
    pub instance_count: u32,
}

/// Some shrubs and decorators that get one number each. Its cost is the rays that read what is around them, at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReadWork {
    /// Index of the first in the level's list of them.
    pub first: u32,
    /// How many, at least one.
    pub count: u32,
}

/// One piece of a lower level of detail: a run of its faces, to be read from the full-detail mesh. Its cost is its samples,
/// about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResampleWork {
    /// Index of the instance.
    pub instance: u32,
    /// First face of the piece.
    pub first_face: u32,
    /// Faces of the piece, at least one.
    pub face_count: u32,
    /// Samples per square metre of the instance, finite and not negative.
    pub density_per_m2: f64,
}

/// What an output of a graph is to the export.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Output {
    /// The [`Solution`] of an instance that receives.
    Solution {
        /// Index of the instance.
        instance: u32,
    },
    /// The [`TreeFits`] of a model.
    Trees {
        /// Index of its mesh in the level.
        mesh: u32,
    },
    /// Numbers of some shrubs and decorators.
    Scalars {
        /// Index of the first in the level's list of them.
        first: u32,
        /// How many.
        count: u32,
    },
    /// The [`RegionModels`] of the level.
    Regions,
}

/// Work that cannot be done, whatever the level.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} {problem}")]
pub struct WorkError {
    /// The field at fault.
    pub field: &'static str,
    /// What is wrong with it, and what it must be.
    pub problem: String,
}

/// A result that a task of its kind cannot have given.
#[derive(Debug, thiserror::Error)]
pub enum ResultError {
    /// It cannot be decoded.
    #[error(transparent)]
    Encoding(#[from] codec::DecodeError),
    /// They are no moments.
    #[error(transparent)]
    Moments(#[from] MomentsError),
    /// It has another size than the task's.
    #[error(
        "it has {found} {what} in place of {expected}; the task is of another version of Kiln, or its code is wrong"
    )]
    Size {
        /// What is counted, in the plural.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// A number is not in [0, 1].
    #[error("{what} {index} is {number}, which is not in [0, 1]; the solve's code is wrong")]
    Range {
        /// What the number is.
        what: &'static str,
        /// Its place.
        index: usize,
        /// The number.
        number: f32,
    },
}

impl Work {
    /// The kind of the task.
    pub const fn kind(&self) -> TaskKind {
        match self {
            Self::Trace(_) => TaskKind::Trace,
            Self::Solve(_) => TaskKind::Solve,
            Self::Volume(_) => TaskKind::Volume,
            Self::Points(_) => TaskKind::Points,
            Self::Regions(_) => TaskKind::Regions,
            Self::Model(_) => TaskKind::Model,
            Self::Fit(_) => TaskKind::Fit,
            Self::Read(_) => TaskKind::Read,
            Self::Resample(_) => TaskKind::Resample,
        }
    }

    /// Checks the fields on their own, without the level: what comes from a peer is not believed.
    pub fn check(&self) -> Result<(), WorkError> {
        match self {
            Self::Trace(TraceWork { first_face, face_count, density_per_m2, .. })
            | Self::Resample(ResampleWork { first_face, face_count, density_per_m2, .. }) => {
                check_run("face_count", *first_face, *face_count)?;
                check_density(*density_per_m2)
            }
            Self::Points(PointsWork { first, count, rays, .. }) => {
                check_run("count", *first, *count)?;
                check_rays(*rays)
            }
            Self::Volume(VolumeWork { first_brick, brick_count }) => {
                check_run("brick_count", *first_brick, *brick_count)
            }
            Self::Read(ReadWork { first, count }) | Self::Regions(RegionsWork { first, count }) => {
                check_run("count", *first, *count)
            }
            Self::Model(ModelWork { region_count }) => check_run("region_count", 0, *region_count),
            Self::Fit(FitWork { instance_count: 0, .. }) => {
                Err(WorkError { field: "instance_count", problem: "is 0; a model has instances".to_owned() })
            }
            // Whether there is such an instance or mesh, the level says.
            Self::Solve(_) | Self::Fit(_) => Ok(()),
        }
    }

    /// Whether the result of a task that does `input` may be an input of this one.
    pub fn takes(&self, input: &Self) -> bool {
        match (self, input) {
            (Self::Solve(solve), Self::Trace(piece)) => (piece.instance, piece.alone) == (solve.instance, solve.alone),
            (Self::Solve(solve), Self::Resample(piece)) => !solve.alone && piece.instance == solve.instance,
            (Self::Resample(piece), Self::Solve(solve)) => !solve.alone && piece.instance != solve.instance,
            (Self::Fit(fit), Self::Points(points)) => points.mesh == fit.mesh,
            (Self::Fit(_), Self::Solve(solve)) => solve.alone,
            (Self::Fit(_), Self::Volume(_)) => true,
            (Self::Fit(lod), Self::Fit(full)) => lod.mesh != full.mesh,
            (Self::Read(_), Self::Solve(solve)) => !solve.alone,
            (Self::Model(_), Self::Regions(_)) => true,
            (
                Self::Trace(_)
                | Self::Solve(_)
                | Self::Volume(_)
                | Self::Points(_)
                | Self::Regions(_)
                | Self::Model(_)
                | Self::Fit(_)
                | Self::Read(_)
                | Self::Resample(_),
                _,
            ) => false,
        }
    }

    /// Checks bytes that are said to be the result, in a bake of so many channels: they can be read, have the right size,
    /// and their numbers make sense. The result of a task of a graph is one artefact, which names no others.
    pub fn check_result(&self, channels: usize, bytes: &[u8]) -> Result<(), ResultError> {
        match self {
            Self::Trace(TraceWork { face_count, .. }) | Self::Resample(ResampleWork { face_count, .. }) => {
                let moments = FaceMoments::from_bytes(bytes)?;
                check_size("faces", moments.face_count(), *face_count as usize)?;
                check_size("channels", moments.channel_count(), channels)
            }
            Self::Points(points) => codec::decode::<PointValues>("values at points", bytes)?.check(points, channels),
            Self::Solve(solve) => check_solution(solve.vertex_count as usize, channels, bytes),
            // Its own crate checks all of it when it is read.
            Self::Volume(_) => check_size("empty results", usize::from(bytes.is_empty()), 0),
            Self::Regions(run) => {
                codec::decode::<RegionSamples>("samples of regions", bytes)?.check(run.count as usize, channels)
            }
            Self::Model(model) => {
                codec::decode::<RegionModels>("models of regions", bytes)?.check(model.region_count as usize, channels)
            }
            Self::Fit(fit) => codec::decode::<TreeFits>("fits of trees", bytes)?.check(fit, channels),
            Self::Read(read) => {
                let numbers: Vec<InstanceNumbers> = codec::decode("numbers of instances", bytes)?;
                check_size("numbers", numbers.len(), read.count as usize)?;
                numbers.iter().try_for_each(|numbers| numbers.check(channels))
            }
        }
    }
}

pub(crate) fn check_range(what: &'static str, numbers: &[f32]) -> Result<(), ResultError> {
    match numbers.iter().position(|number| !(0.0..=1.0).contains(number)) {
        Some(index) => Err(ResultError::Range { what, index, number: numbers[index] }),
        None => Ok(()),
    }
}

/// Most rays of one side of a point.
const MOST_RAYS: u32 = 65_536;

fn check_density(density_per_m2: f64) -> Result<(), WorkError> {
    if density_per_m2 >= 0.0 && density_per_m2.is_finite() {
        return Ok(());
    }
    let problem = format!("is {density_per_m2}; it must be finite and not negative");
    Err(WorkError { field: "density_per_m2", problem })
}

/// A run of things that are numbered, at least one.
fn check_run(field: &'static str, first: u32, count: u32) -> Result<(), WorkError> {
    if count > 0 && first.checked_add(count).is_some() {
        return Ok(());
    }
    Err(WorkError { field, problem: format!("is {count} from {first}; it must be a run of at least one") })
}

fn check_rays(rays: u32) -> Result<(), WorkError> {
    if rays.is_power_of_two() && rays <= MOST_RAYS {
        return Ok(());
    }
    Err(WorkError { field: "rays", problem: format!("is {rays}; it must be a power of two up to {MOST_RAYS}") })
}

fn check_solution(vertices: usize, channels: usize, bytes: &[u8]) -> Result<(), ResultError> {
    let solution: Solution = codec::decode("a solution", bytes)?;
    check_size("channels", solution.channels as usize, channels)?;
    let all = [("value", "values", &solution.values), ("residual", "residuals", &solution.residuals)];
    for (what, plural, numbers) in all {
        check_size(plural, numbers.len(), vertices.saturating_mul(channels))?;
        check_range(what, numbers)?;
    }
    Ok(())
}

pub(crate) fn check_size(what: &'static str, found: usize, expected: usize) -> Result<(), ResultError> {
    if found == expected { Ok(()) } else { Err(ResultError::Size { what, found, expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HalfMoments, SolveSummary};

    fn piece(face_count: u32) -> Work {
        Work::Trace(TraceWork { instance: 0, first_face: 0, face_count, density_per_m2: 1.0, alone: false })
    }

    #[test]
    fn runs_are_not_empty() {
        let run = |first, count| {
            let works = [
                Work::Volume(VolumeWork { first_brick: first, brick_count: count }),
                Work::Read(ReadWork { first, count }),
                Work::Regions(RegionsWork { first, count }),
                Work::Points(PointsWork { mesh: 0, first, count, point_count: 5, rays: 128 }),
                Work::Resample(ResampleWork { instance: 0, first_face: first, face_count: count, density_per_m2: 1.0 }),
                Work::Trace(TraceWork {
                    instance: 0,
                    first_face: first,
                    face_count: count,
                    density_per_m2: 1.0,
                    alone: true,
                }),
            ];
            works.map(|work| work.check().is_ok())
        };
        assert_eq!((run(7, 1), run(7, 0), run(u32::MAX, 1)), ([true; 6], [false; 6], [false; 6]));
        let rays =
            |rays| Work::Points(PointsWork { mesh: 0, first: 0, count: 1, point_count: 5, rays }).check().is_ok();
        assert!(rays(32) && !rays(0) && !rays(33));
        let fit = |instance_count| Work::Fit(FitWork { mesh: 0, vertex_count: 3, instance_count }).check().is_ok();
        assert!(fit(1) && !fit(0));
    }

    #[test]
    fn a_piece_is_a_run_of_faces_with_a_density() {
        let good = TraceWork { instance: 0, first_face: 5, face_count: 1, density_per_m2: 0.0, alone: false };
        assert_eq!(Work::Trace(good).check(), Ok(()));
        let field = |work: TraceWork| Work::Trace(work).check().unwrap_err().field;
        for face_count in [0, u32::MAX - 4] {
            assert_eq!(field(TraceWork { face_count, ..good }), "face_count");
        }
        for density_per_m2 in [-1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(field(TraceWork { density_per_m2, ..good }), "density_per_m2");
        }
    }

    #[test]
    fn moments_have_the_right_size() {
        let mut moments = FaceMoments::new(2);
        moments.push(&[HalfMoments::default(); 2]);
        let bytes = moments.to_bytes();
        piece(1).check_result(2, &bytes).unwrap();
        let refused =
            |faces, channels, bytes: &[u8]| piece(faces).check_result(channels, bytes).unwrap_err().to_string();
        assert!(refused(2, 2, &bytes).contains("1 faces in place of 2"));
        assert!(refused(1, 1, &bytes).contains("2 channels in place of 1"));
        assert!(matches!(piece(1).check_result(2, &bytes[1..]), Err(ResultError::Moments(_))));
    }

    #[test]
    fn solutions_are_finite_and_in_range() {
        let encoded = |values: Vec<f32>, residuals: Vec<f32>| {
            let summary = SolveSummary::default();
            codec::encode(&Solution { channels: 1, values, residuals, unsampled: false, summary })
        };
        let solve = Work::Solve(SolveWork { instance: 0, vertex_count: 2, alone: false });
        let refused = |bytes: &[u8]| solve.check_result(1, bytes).unwrap_err().to_string();
        let good = encoded(vec![0.0, 1.0], vec![0.5; 2]);
        solve.check_result(1, &good).unwrap();
        assert!(solve.check_result(2, &good).is_err());
        assert!(refused(&encoded(vec![0.0], vec![0.5; 2])).contains("1 values"));
        assert!(refused(&encoded(vec![0.0; 2], vec![0.5; 3])).contains("3 residuals"));
        assert!(matches!(solve.check_result(1, &good[1..]), Err(ResultError::Encoding(_))));
        for bad in [f32::NAN, f32::INFINITY, -0.1, 1.1] {
            assert!(refused(&encoded(vec![0.5, bad], vec![0.5; 2])).contains("value 1"), "{bad}");
            assert!(refused(&encoded(vec![0.5; 2], vec![0.5, bad])).contains("residual 1"), "{bad}");
        }
    }
}
