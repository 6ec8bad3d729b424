//! Tasks, kinds and lanes.

use crate::{
    field::{FieldError, digest, digests, required, text},
    limits, v1,
};
use kiln_core::{ExportSpec, Lane, PlanSpec, TaskKey, TaskKind, TaskSpec, TraceTask};

impl From<TaskKind> for v1::TaskKind {
    fn from(kind: TaskKind) -> Self {
        match kind {
            TaskKind::Import => Self::Import,
            TaskKind::Plan => Self::Plan,
            TaskKind::Trace => Self::Trace,
            TaskKind::Solve => Self::Solve,
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
            TaskSpec::Trace { level, task } => Spec::Trace(v1::TraceTask {
                level: level.0.to_vec(),
                key: task.key.0.0.to_vec(),
                family: task.family.0.to_vec(),
                instance: task.instance,
                first_face: task.first_face,
                face_count: task.face_count,
                density_per_m2: task.density_per_m2,
                ray_count: task.ray_count,
            }),
            TaskSpec::Solve { level, instance, moments } => Spec::Solve(v1::SolveTask {
                level: level.0.to_vec(),
                instance: *instance,
                moments: moments.iter().map(|digest| digest.0.to_vec()).collect(),
            }),
            TaskSpec::Export(export) => Spec::Export(v1::ExportTask {
                source: export.source.0.to_vec(),
                level: export.level.0.to_vec(),
                solutions: export.solutions.0.to_vec(),
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
            Spec::Trace(task) => trace(&task).map_err(|e| e.within("trace")),
            Spec::Solve(solve) => Ok(Self::Solve {
                level: digest("solve.level", &solve.level)?,
                instance: solve.instance,
                moments: digests("solve.moments", &solve.moments, limits::PIECES)?,
            }),
            Spec::Export(export) => Ok(Self::Export(ExportSpec {
                source: digest("export.source", &export.source)?,
                level: digest("export.level", &export.level)?,
                solutions: digest("export.solutions", &export.solutions)?,
            })),
        }
    }
}

fn trace(task: &v1::TraceTask) -> Result<TaskSpec, FieldError> {
    if task.face_count == 0 || task.first_face.checked_add(task.face_count).is_none() {
        let problem = format!("is {} from face {}; a piece is a run of faces", task.face_count, task.first_face);
        return Err(FieldError::new("face_count", problem));
    }
    if !(task.density_per_m2 >= 0.0 && task.density_per_m2.is_finite()) {
        let problem = format!("is {}; it must be finite and not negative", task.density_per_m2);
        return Err(FieldError::new("density_per_m2", problem));
    }
    Ok(TaskSpec::Trace {
        level: digest("level", &task.level)?,
        task: TraceTask {
            key: TaskKey(digest("key", &task.key)?),
            family: digest("family", &task.family)?,
            instance: task.instance,
            first_face: task.first_face,
            face_count: task.face_count,
            density_per_m2: task.density_per_m2,
            ray_count: task.ray_count,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::Digest;
    use proptest::prelude::*;

    fn any_digest() -> impl Strategy<Value = Digest> {
        any::<[u8; 32]>().prop_map(Digest)
    }

    fn any_trace() -> impl Strategy<Value = TaskSpec> {
        let numbers = (any::<u32>(), 0..=u32::MAX / 2, 1..=u32::MAX / 2, 0.0..1e9f64, any::<u64>());
        (any_digest(), any_digest(), any_digest(), numbers).prop_map(|(level, key, family, n)| {
            let (instance, first_face, face_count, density_per_m2, ray_count) = n;
            let key = TaskKey(key);
            let task = TraceTask { key, family, instance, first_face, face_count, density_per_m2, ray_count };
            TaskSpec::Trace { level, task }
        })
    }

    fn any_spec() -> impl Strategy<Value = TaskSpec> {
        let lane = ("[ -~]{1,20}", "[ -~]{1,20}").prop_map(|(trace, solve)| Lane { trace, solve });
        prop_oneof![
            any_digest().prop_map(|source| TaskSpec::Import { source }),
            (any_digest(), lane).prop_map(|(level, lane)| TaskSpec::Plan(PlanSpec { level, lane })),
            any_trace(),
            (any_digest(), any::<u32>(), prop::collection::vec(any_digest(), 0..5))
                .prop_map(|(level, instance, moments)| TaskSpec::Solve { level, instance, moments }),
            (any_digest(), any_digest(), any_digest())
                .prop_map(|(source, level, solutions)| TaskSpec::Export(ExportSpec { source, level, solutions })),
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

    #[test]
    fn kinds_and_back() {
        for kind in TaskKind::ALL {
            assert_eq!(TaskKind::try_from(v1::TaskKind::from(kind)), Ok(kind));
        }
        assert!(TaskKind::try_from(v1::TaskKind::Unspecified).is_err());
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
        let solve = v1::SolveTask { level: good.clone(), instance: 0, moments: vec![good.clone(), vec![]] };
        assert_eq!(field(Some(Spec::Solve(solve))), "solve.moments[1]");
        let trace = v1::TraceTask { density_per_m2: f64::NAN, face_count: 1, ..Default::default() };
        assert_eq!(field(Some(Spec::Trace(trace))), "trace.density_per_m2");
    }
}
