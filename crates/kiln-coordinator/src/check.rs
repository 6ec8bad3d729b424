//! Whether a result may be accepted: it is there, it can be read, it has the right size, and its numbers make
//! sense. A worker may be broken or lie; what passes here harms nobody but the bake's own picture.

use kiln_core::{Baked, Digest, FaceMoments, Level, Solution, TaskGraph, codec};
use kiln_store::{Store, StoreError};

/// What a task's result must be.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Expect {
    /// An encoded [`Level`] whose meshes are stored.
    Level,
    /// An encoded [`TaskGraph`] of the level.
    Graph { level: Digest },
    /// [`FaceMoments`] of so many faces.
    Moments { faces: usize, channels: usize },
    /// An encoded [`Solution`].
    Solution { vertices: usize, channels: usize },
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
            of_level(*level, graph.level)
        }
        Expect::Moments { faces, channels } => {
            let moments = FaceMoments::from_bytes(bytes).map_err(|e| e.to_string())?;
            size("faces", moments.face_count(), *faces)?;
            size("channels", moments.channel_count(), *channels)
        }
        Expect::Solution { vertices, channels } => solution(bytes, *vertices, *channels),
        Expect::Baked { level } => {
            let baked: Baked = codec::decode("a bake's summary", bytes).map_err(|e| e.to_string())?;
            of_level(*level, baked.summary.level)?;
            Ok(vec![baked.file])
        }
    }
}

fn solution(bytes: &[u8], vertices: usize, channels: usize) -> Result<Vec<Digest>, String> {
    let solution: Solution = codec::decode("a solution", bytes).map_err(|e| e.to_string())?;
    size("channels", solution.channels as usize, channels)?;
    for (what, numbers) in [("value", &solution.values), ("residual", &solution.residuals)] {
        size(&format!("{what}s"), numbers.len(), vertices * channels)?;
        if let Some(at) = numbers.iter().position(|number| !(0.0..=1.0).contains(number)) {
            return Err(format!("{what} {at} is {}, which is not in [0, 1]", numbers[at]));
        }
    }
    Ok(Vec::new())
}

fn size(what: &str, found: usize, expected: usize) -> Result<Vec<Digest>, String> {
    match found == expected {
        true => Ok(Vec::new()),
        false => Err(format!("it has {found} {what} in place of {expected}")),
    }
}

fn of_level(expected: Digest, found: Digest) -> Result<Vec<Digest>, String> {
    match found == expected {
        true => Ok(Vec::new()),
        false => Err(format!("it is of the level {found} in place of {expected}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::{HalfMoments, SolveSummary};

    #[test]
    fn moments_have_the_right_size() {
        let mut moments = FaceMoments::new(2);
        moments.push(&[HalfMoments::default(); 2]);
        let bytes = moments.to_bytes();
        assert!(content(&Expect::Moments { faces: 1, channels: 2 }, &bytes).is_ok());
        assert!(content(&Expect::Moments { faces: 2, channels: 2 }, &bytes).unwrap_err().contains("1 faces"));
        assert!(content(&Expect::Moments { faces: 1, channels: 1 }, &bytes).is_err());
        assert!(content(&Expect::Moments { faces: 1, channels: 2 }, &bytes[1..]).is_err());
    }

    #[test]
    fn solutions_are_finite_and_in_range() {
        let with_residuals = |values: Vec<f32>, residuals: Vec<f32>| {
            let summary = SolveSummary::default();
            codec::encode(&Solution { channels: 1, values, residuals, unsampled: false, summary })
        };
        let bytes = |values: Vec<f32>| with_residuals(values, vec![0.5; 2]);
        let expect = Expect::Solution { vertices: 2, channels: 1 };
        assert!(content(&expect, &bytes(vec![0.0, 1.0])).is_ok());
        assert!(content(&expect, &bytes(vec![0.0])).unwrap_err().contains("1 values"));
        for bad in [f32::NAN, f32::INFINITY, -0.1, 1.1] {
            assert!(content(&expect, &bytes(vec![0.5, bad])).unwrap_err().contains("value 1"), "{bad}");
            let residual = with_residuals(vec![0.5; 2], vec![0.5, bad]);
            assert!(content(&expect, &residual).unwrap_err().contains("residual 1"), "{bad}");
        }
    }
}
