//! Tasks, kinds and lanes.

use crate::{
    field::{FieldError, digest, digests, required, text},
    limits, v1,
};
use kiln_core::{
    ExportSpec, FitWork, Lane, ModelWork, PlanSpec, PointsWork, ReadWork, RegionsWork, ResampleWork, SolveWork,
    TaskKind, TaskSpec, TraceWork, VolumeWork, Work, WorkSpec,
};

impl From<TaskKind> for v1::TaskKind {
    fn from(kind: TaskKind) -> Self {
        match kind {
            TaskKind::Import => Self::Import,
            TaskKind::Plan => Self::Plan,
            TaskKind::Trace => Self::Trace,
            TaskKind::Solve => Self::Solve,
            TaskKind::Volume => Self::Volume,
            TaskKind::Fit => Self::Fit,
            TaskKind::Read => Self::Read,
            TaskKind::Points => Self::Points,
            TaskKind::Regions => Self::Regions,
            TaskKind::Model => Self::Model,
            TaskKind::Resample => Self::Resample,
            TaskKind::Export => Self::Export,
        }
    }
}

impl TryFrom<v1::TaskKind> for TaskKind {
    type Error = FieldError;

    fn try_from(kind: v1::TaskKind) -> Result<Self, FieldError> {
        match kind {
            v1::TaskKind::Import => Ok(Self::Import),
            v1::TaskKind::Plan => Ok(Self::Plan),
            v1::TaskKind::Trace => Ok(Self::Trace),
            v1::TaskKind::Solve => Ok(Self::Solve),
            v1::TaskKind::Volume => Ok(Self::Volume),
            v1::TaskKind::Fit => Ok(Self::Fit),
            v1::TaskKind::Read => Ok(Self::Read),
            v1::TaskKind::Points => Ok(Self::Points),
            v1::TaskKind::Regions => Ok(Self::Regions),
            v1::TaskKind::Model => Ok(Self::Model),
            v1::TaskKind::Resample => Ok(Self::Resample),
            v1::TaskKind::Export => Ok(Self::Export),
            v1::TaskKind::Unspecified => Err(FieldError::new("kind", "is missing or unknown")),
        }
    }
}

impl From<&Lane> for v1::Lane {
    fn from(lane: &Lane) -> Self {
        Self { trace: lane.trace.clone(), solve: lane.solve.clone() }
    }
}

impl TryFrom<v1::Lane> for Lane {
    type Error = FieldError;

    fn try_from(lane: v1::Lane) -> Result<Self, FieldError> {
        for (field, value) in [("trace", &lane.trace), ("solve", &lane.solve)] {
            text(field, value, limits::NAME_BYTES)?;
            if value.is_empty() {
                return Err(FieldError::new(field, "is empty; a lane names where arithmetic runs, such as `cpu`"));
            }
        }
        Ok(Self { trace: lane.trace, solve: lane.solve })
    }
}

impl From<&TaskSpec> for v1::TaskSpec {
    fn from(spec: &TaskSpec) -> Self {
        use v1::task_spec::Spec;
        let spec = match spec {
            TaskSpec::Import { source } => Spec::Import(v1::ImportTask { source: source.0.to_vec() }),
            TaskSpec::Plan(plan) => {
                Spec::Plan(v1::PlanTask { level: plan.level.0.to_vec(), lane: Some((&plan.lane).into()) })
            }
            TaskSpec::Work(spec) => Spec::Work(v1::WorkTask {
                level: spec.level.0.to_vec(),
                inputs: spec.inputs.iter().map(|digest| digest.0.to_vec()).collect(),
                work: Some((&spec.work).into()),
            }),
            TaskSpec::Export(export) => Spec::Export(v1::ExportTask {
                source: export.source.0.to_vec(),
                level: export.level.0.to_vec(),
                outputs: export.outputs.0.to_vec(),
            }),
        };
        Self { spec: Some(spec) }
    }
}

impl TryFrom<v1::TaskSpec> for TaskSpec {
    type Error = FieldError;

    fn try_from(spec: v1::TaskSpec) -> Result<Self, FieldError> {
        use v1::task_spec::Spec;
        match required("spec", spec.spec)? {
            Spec::Import(import) => Ok(Self::Import { source: digest("import.source", &import.source)? }),
            Spec::Plan(plan) => Ok(Self::Plan(PlanSpec {
                level: digest("plan.level", &plan.level)?,
                lane: required("plan.lane", plan.lane)?.try_into().map_err(|e: FieldError| e.within("plan.lane"))?,
            })),
            Spec::Work(task) => Ok(Self::Work(WorkSpec {
                level: digest("work.level", &task.level)?,
                inputs: digests("work.inputs", &task.inputs, limits::INPUTS)?,
                work: required("work.work", task.work)?.try_into().map_err(|e: FieldError| e.within("work"))?,
            })),
            Spec::Export(export) => Ok(Self::Export(ExportSpec {
                source: digest("export.source", &export.source)?,
                level: digest("export.level", &export.level)?,
                outputs: digest("export.outputs", &export.outputs)?,
            })),
        }
    }
}

impl From<&Work> for v1::work_task::Work {
    fn from(work: &Work) -> Self {
        match work {
            Work::Trace(TraceWork { instance, first_face, face_count, density_per_m2, alone }) => {
                Self::Trace(v1::TraceWork {
                    instance: *instance,
                    first_face: *first_face,
                    face_count: *face_count,
                    density_per_m2: *density_per_m2,
                    alone: *alone,
                })
            }
            Work::Solve(SolveWork { instance, vertex_count, alone }) => {
                Self::Solve(v1::SolveWork { instance: *instance, vertex_count: *vertex_count, alone: *alone })
            }
            Work::Volume(VolumeWork { first_brick, brick_count }) => {
                Self::Volume(v1::VolumeWork { first_brick: *first_brick, brick_count: *brick_count })
            }
            Work::Fit(FitWork { mesh, vertex_count, instance_count }) => {
                Self::Fit(v1::FitWork { mesh: *mesh, vertex_count: *vertex_count, instance_count: *instance_count })
            }
            Work::Regions(RegionsWork { first, count }) => {
                Self::Regions(v1::RegionsWork { first: *first, count: *count })
            }
            Work::Model(ModelWork { region_count }) => Self::Model(v1::ModelWork { region_count: *region_count }),
            Work::Read(ReadWork { first, count }) => Self::Read(v1::ReadWork { first: *first, count: *count }),
            Work::Points(PointsWork { mesh, first, count, point_count, rays }) => Self::Points(v1::PointsWork {
                mesh: *mesh,
                first: *first,
                count: *count,
                point_count: *point_count,
                rays: *rays,
            }),
            Work::Resample(ResampleWork { instance, first_face, face_count, density_per_m2 }) => {
                Self::Resample(v1::ResampleWork {
                    instance: *instance,
                    first_face: *first_face,
                    face_count: *face_count,
                    density_per_m2: *density_per_m2,
                })
            }
        }
    }
}

impl TryFrom<v1::work_task::Work> for Work {
    type Error = FieldError;

    fn try_from(work: v1::work_task::Work) -> Result<Self, FieldError> {
        let work = match work {
            v1::work_task::Work::Trace(work) => {
                let v1::TraceWork { instance, first_face, face_count, density_per_m2, alone } = work;
                Self::Trace(TraceWork { instance, first_face, face_count, density_per_m2, alone })
            }
            v1::work_task::Work::Solve(v1::SolveWork { instance, vertex_count, alone }) => {
                Self::Solve(SolveWork { instance, vertex_count, alone })
            }
            v1::work_task::Work::Volume(v1::VolumeWork { first_brick, brick_count }) => {
                Self::Volume(VolumeWork { first_brick, brick_count })
            }
            v1::work_task::Work::Fit(v1::FitWork { mesh, vertex_count, instance_count }) => {
                Self::Fit(FitWork { mesh, vertex_count, instance_count })
            }
            v1::work_task::Work::Regions(v1::RegionsWork { first, count }) => {
                Self::Regions(RegionsWork { first, count })
            }
            v1::work_task::Work::Model(v1::ModelWork { region_count }) => Self::Model(ModelWork { region_count }),
            v1::work_task::Work::Read(v1::ReadWork { first, count }) => Self::Read(ReadWork { first, count }),
            v1::work_task::Work::Points(v1::PointsWork { mesh, first, count, point_count, rays }) => {
                Self::Points(PointsWork { mesh, first, count, point_count, rays })
            }
            v1::work_task::Work::Resample(work) => {
                let v1::ResampleWork { instance, first_face, face_count, density_per_m2 } = work;
                Self::Resample(ResampleWork { instance, first_face, face_count, density_per_m2 })
            }
        };
        let name = work.kind().name();
        work.check().map_err(|error| FieldError::new(format!("{name}.{}", error.field), error.problem))?;
        Ok(work)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::Digest;
    use proptest::prelude::*;

    fn any_digest() -> impl Strategy<Value = Digest> {
        any::<[u8; 32]>().prop_map(Digest)
    }

    fn any_work() -> impl Strategy<Value = Work> {
        let trace = (any::<u32>(), 0..=u32::MAX / 2, 1..=u32::MAX / 2, 0.0..1e9f64, any::<bool>()).prop_map(
            |(instance, first_face, face_count, density_per_m2, alone)| {
                Work::Trace(TraceWork { instance, first_face, face_count, density_per_m2, alone })
            },
        );
        let numbers = || (0..=u32::MAX / 2, 1..=u32::MAX / 2, 1..=u32::MAX);
        let solve = (any::<u32>(), any::<u32>(), any::<bool>());
        let solve =
            solve.prop_map(|(instance, vertex_count, alone)| Work::Solve(SolveWork { instance, vertex_count, alone }));
        let volume =
            numbers().prop_map(|(first_brick, brick_count, _)| Work::Volume(VolumeWork { first_brick, brick_count }));
        let fit = numbers()
            .prop_map(|(mesh, vertex_count, instance_count)| Work::Fit(FitWork { mesh, vertex_count, instance_count }));
        let regions = numbers().prop_map(|(first, count, _)| Work::Regions(RegionsWork { first, count }));
        let model = numbers().prop_map(|(_, region_count, _)| Work::Model(ModelWork { region_count }));
        let read = numbers().prop_map(|(first, count, _)| Work::Read(ReadWork { first, count }));
        let points = (any::<u32>(), numbers()).prop_map(|(mesh, (first, count, point_count))| {
            Work::Points(PointsWork { mesh, first, count, point_count, rays: 1 << (point_count % 17) })
        });
        let resample = (any::<u32>(), numbers(), 0.0..1e9f64).prop_map(
            |(instance, (first_face, face_count, _), density_per_m2)| {
                Work::Resample(ResampleWork { instance, first_face, face_count, density_per_m2 })
            },
        );
        prop_oneof![trace, solve, volume, fit, read, points, regions, model, resample]
    }

    fn any_spec() -> impl Strategy<Value = TaskSpec> {
        let lane = ("[ -~]{1,20}", "[ -~]{1,20}").prop_map(|(trace, solve)| Lane { trace, solve });
        prop_oneof![
            any_digest().prop_map(|source| TaskSpec::Import { source }),
            (any_digest(), lane).prop_map(|(level, lane)| TaskSpec::Plan(PlanSpec { level, lane })),
            (any_digest(), any_work(), prop::collection::vec(any_digest(), 0..5))
                .prop_map(|(level, work, inputs)| TaskSpec::Work(WorkSpec { level, work, inputs })),
            (any_digest(), any_digest(), any_digest())
                .prop_map(|(source, level, outputs)| TaskSpec::Export(ExportSpec { source, level, outputs })),
        ]
    }

    proptest! {
        #[test]
        fn a_task_survives_the_wire(spec in any_spec()) {
            use prost::Message;
            let bytes = v1::TaskSpec::from(&spec).encode_to_vec();
            let message = v1::TaskSpec::decode(bytes.as_slice()).unwrap();
            prop_assert_eq!(TaskSpec::try_from(message).unwrap(), spec);
        }

        #[test]
        fn damaged_bytes_never_panic(spec in any_spec(), at in any::<prop::sample::Index>(), to in any::<u8>()) {
            use prost::Message;
            let mut bytes = v1::TaskSpec::from(&spec).encode_to_vec();
            let at = at.index(bytes.len());
            bytes[at] = to;
            if let Ok(message) = v1::TaskSpec::decode(bytes.as_slice()) {
                let _ = TaskSpec::try_from(message);
            }
        }
    }

    /// That each kind has a value of its own, and each value a kind, the compiler sees; here, that they are each other's,
    /// and that no kind is left out of the list.
    #[test]
    fn kinds_and_back() {
        for kind in TaskKind::ALL {
            assert_eq!(TaskKind::try_from(v1::TaskKind::from(kind)), Ok(kind));
            let name = format!("TASK_KIND_{}", kind.name().to_uppercase());
            assert_eq!(v1::TaskKind::from(kind).as_str_name(), name);
        }
        let values = (0..1000).filter_map(|value| v1::TaskKind::try_from(value).ok());
        let (kinds, others): (Vec<_>, Vec<_>) = values.partition(|&value| TaskKind::try_from(value).is_ok());
        assert_eq!(others, [v1::TaskKind::Unspecified]);
        assert_eq!(kinds.len(), TaskKind::ALL.len(), "TaskKind::ALL lacks a kind");
    }

    #[test]
    fn errors_name_the_field() {
        let field = |spec| TaskSpec::try_from(v1::TaskSpec { spec }).unwrap_err().field;
        use v1::task_spec::Spec;
        assert_eq!(field(None), "spec");
        assert_eq!(field(Some(Spec::Import(v1::ImportTask { source: vec![1; 31] }))), "import.source");
        let good = vec![0; 32];
        let plan = v1::PlanTask { level: good.clone(), lane: Some(v1::Lane::default()) };
        assert_eq!(field(Some(Spec::Plan(plan))), "plan.lane.trace");
        let work = |work, inputs| Some(Spec::Work(v1::WorkTask { level: vec![0; 32], inputs, work }));
        let solve = v1::work_task::Work::Solve(v1::SolveWork { instance: 0, vertex_count: 3, alone: false });
        assert_eq!(field(work(Some(solve), vec![good, vec![]])), "work.inputs[1]");
        assert_eq!(field(work(None, vec![])), "work.work");
        let trace = |trace| field(work(Some(v1::work_task::Work::Trace(trace)), vec![]));
        let piece = v1::TraceWork { instance: 0, first_face: 1, face_count: 1, density_per_m2: 1.0, alone: false };
        assert_eq!(trace(v1::TraceWork { density_per_m2: f64::NAN, ..piece }), "work.trace.density_per_m2");
        assert_eq!(trace(v1::TraceWork { face_count: 0, ..piece }), "work.trace.face_count");
        assert_eq!(trace(v1::TraceWork { face_count: u32::MAX, ..piece }), "work.trace.face_count");
        let read = v1::work_task::Work::Read(v1::ReadWork { first: 3, count: 0 });
        assert_eq!(field(work(Some(read), vec![])), "work.read.count");
    }
}
