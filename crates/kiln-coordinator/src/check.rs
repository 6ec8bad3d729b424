//! Whether a result may be accepted: it is there, it can be read, it has the right size, and its numbers make
//! sense. A worker may be broken or lie; what passes here harms nobody but the bake's own picture.

use kiln_core::{Baked, Digest, Level, TaskGraph, Work, codec};
use kiln_store::{Store, StoreError};

/// What a task's result must be.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Expect {
    /// An encoded [`Level`] whose meshes are stored.
    Level,
    /// An encoded [`TaskGraph`] of the level, whose parts fit together.
    Graph { level: Digest },
    /// The result of a task of a graph, in a bake of so many channels.
    Work { work: Work, channels: usize },
    /// An encoded [`Baked`] of the level whose file is stored.
    Baked { level: Digest },
}

/// Why a result is not accepted.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CheckError {
    #[error("the result {0} is not in the store")]
    Absent(Digest),
    #[error("the result {digest} is no good: {problem}")]
    Bad { digest: Digest, problem: String },
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Checks a result.
pub(crate) fn check(store: &Store, expect: &Expect, digest: Digest) -> Result<(), CheckError> {
    let bytes = store.get(&digest)?.ok_or(CheckError::Absent(digest))?;
    let needed = content(expect, &bytes).map_err(|problem| CheckError::Bad { digest, problem })?;
    if let Some(absent) = store.missing(&needed)?.first() {
        let problem = format!("it names the artefact {absent}, which is not in the store");
        return Err(CheckError::Bad { digest, problem });
    }
    Ok(())
}

/// Checks the bytes of a result; gives the artefacts that must be there besides.
fn content(expect: &Expect, bytes: &[u8]) -> Result<Vec<Digest>, String> {
    match expect {
        Expect::Level => {
            let level: Level = codec::decode("a level", bytes).map_err(|e| e.to_string())?;
            Ok(level.meshes.iter().map(|mesh| mesh.digest).collect())
        }
        Expect::Graph { level } => {
            let graph: TaskGraph = codec::decode("a task graph", bytes).map_err(|e| e.to_string())?;
            graph.check(*level).map_err(|e| e.to_string())?;
            Ok(Vec::new())
        }
        Expect::Work { work, channels } => {
            work.check_result(*channels, bytes).map_err(|e| e.to_string())?;
            Ok(Vec::new())
        }
        Expect::Baked { level } => {
            let baked: Baked = codec::decode("a bake's summary", bytes).map_err(|e| e.to_string())?;
            match baked.summary.level == *level {
                true => Ok(baked.files().collect()),
                false => Err(format!("it is of the level {} in place of {level}", baked.summary.level)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::tests::{baked, graph};
    use kiln_core::{FaceMoments, HalfMoments, TraceWork};

    #[test]
    fn results_are_of_their_task_and_level() {
        let level = Digest::of(b"level");
        let refused = |expect: &Expect, bytes: &[u8]| content(expect, bytes).unwrap_err();
        let of_level = Expect::Graph { level };
        let mut plan = graph(&[2, 1]);
        assert_eq!(content(&of_level, &codec::encode(&plan)), Ok(Vec::new()));
        plan.inputs[0] = 7;
        assert!(refused(&of_level, &codec::encode(&plan)).contains("task 2 takes the result of task 7"));
        assert!(
            refused(&Expect::Graph { level: Digest::default() }, &codec::encode(&graph(&[])))
                .contains("is of the level")
        );

        let summary = codec::encode(&baked());
        assert_eq!(content(&Expect::Baked { level }, &summary), Ok(vec![baked().file]));
        let pack = kiln_core::PackFile { digest: Digest::of(b"pack"), bytes: 4, sizes: Vec::new() };
        let packed = codec::encode(&Baked { pack: Some(pack.clone()), ..baked() });
        assert_eq!(content(&Expect::Baked { level }, &packed), Ok(vec![baked().file, pack.digest]));
        assert!(refused(&Expect::Baked { level: Digest::default() }, &summary).contains("is of the level"));

        let mut moments = FaceMoments::new(2);
        moments.push(&[HalfMoments::default(); 2]);
        let work =
            Work::Trace(TraceWork { instance: 0, first_face: 0, face_count: 1, density_per_m2: 1.0, alone: false });
        let expect = |channels| Expect::Work { work: work.clone(), channels };
        assert_eq!(content(&expect(2), &moments.to_bytes()), Ok(Vec::new()));
        assert!(refused(&expect(1), &moments.to_bytes()).contains("2 channels in place of 1"));
    }
}
