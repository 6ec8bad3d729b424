//! A job as its clients see it.

use super::{Job, Outcome, Phase};
use kiln_proto::v1;

impl Job {
    /// The job as shown; it includes every event up to `last_event`.
    pub(crate) fn view(&self, last_event: u64) -> v1::Bake {
        let (mut result, mut failure, mut ended_unix_ms) = (None, None, 0);
        if let Phase::Ended(ended) = &self.phase {
            ended_unix_ms = ended.at_unix_ms as i64;
            match &ended.outcome {
                Outcome::Succeeded(success) => {
                    result = Some(v1::BakeResult::new(success.digest, &success.baked, success.from_store));
                }
                Outcome::Failed(reason) => failure = Some(reason.clone()),
                Outcome::Cancelled => {}
            }
        }
        v1::Bake {
            bake_id: self.order.id.to_string(),
            name: self.order.name.clone(),
            state: self.phase.shown().into(),
            paused: self.paused,
            source: self.order.source.0.to_vec(),
            backend: self.order.backend.into(),
            priority: self.order.priority,
            lane: self.lane.as_ref().map(Into::into),
            stages: self.progress.stages(),
            warnings: self.warnings.clone(),
            submitted_unix_ms: self.order.submitted_unix_ms as i64,
            ended_unix_ms,
            result,
            failure,
            last_event,
        }
    }
}
