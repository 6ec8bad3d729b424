//! All that was measured, as JSON, and the files it is written to.

use super::{
    derive::{self, ChannelResult, Overall},
    measure::SceneResult,
    summary::{RowSummary, summarize},
};
use crate::{BenchError, Provenance};
use serde::Serialize;
use serde_json::Value;
use std::{fs, path::Path};

/// A scene's measurement and what follows from it.
#[derive(Clone, Debug, Serialize)]
pub(super) struct SceneReport {
    /// Every run.
    #[serde(flatten)]
    pub(super) result: SceneResult,
    /// Every row over all seeds, in the order of the rows.
    pub(super) summary: Vec<RowSummary>,
    /// For each half-distance.
    pub(super) channels: Vec<ChannelResult>,
}

impl SceneReport {
    /// Draws the conclusions.
    pub(super) fn new(result: SceneResult) -> Self {
        let summary = summarize(&result);
        let channels = derive::channels(&result, &summary);
        Self { result, summary, channels }
    }
}

/// The whole measurement.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Report {
    /// Where and when it was made.
    pub(super) provenance: Provenance,
    /// Seeds of each row.
    pub(super) seeds: u64,
    /// Wall seconds of the whole measurement.
    pub(super) total_wall_secs: f64,
    /// Over all scenes.
    pub(super) overall: Overall,
    /// The scenes.
    pub(super) scenes: Vec<SceneReport>,
}

impl Report {
    /// Of the given scenes.
    pub(super) fn new(provenance: Provenance, seeds: u64, total_wall_secs: f64, scenes: Vec<SceneReport>) -> Self {
        let channels: Vec<Vec<ChannelResult>> = scenes.iter().map(|scene| scene.channels.clone()).collect();
        Self { provenance, seeds, total_wall_secs, overall: derive::overall(&channels), scenes }
    }
}

/// Writes a file.
pub(super) fn write(path: &Path, text: &str) -> Result<(), BenchError> {
    fs::write(path, text).map_err(|error| BenchError::File {
        path: path.to_path_buf(),
        reason: format!("cannot be written ({error}); check the folder and its permissions"),
    })
}

/// A value as JSON, numbers to six digits: more would be noise.
pub(super) fn json_text<T: Serialize>(value: &T) -> Result<String, BenchError> {
    let failed = |error: serde_json::Error| BenchError::Failed { step: "writing JSON", reason: error.to_string() };
    serde_json::to_string(&rounded(serde_json::to_value(value).map_err(failed)?)).map_err(failed)
}

fn rounded(value: Value) -> Value {
    match value {
        Value::Array(list) => list.into_iter().map(rounded).collect(),
        Value::Object(map) => map.into_iter().map(|(key, value)| (key, rounded(value))).collect(),
        Value::Number(number) if number.is_f64() => {
            let short = number.as_f64().and_then(|x| format!("{x:.5e}").parse::<f64>().ok());
            short.map_or(Value::Number(number), Value::from)
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_and_counts_are_not() {
        let value = serde_json::json!({ "a": [0.123_456_789, 1e-12], "b": 123_456_789u64, "c": null });
        assert_eq!(json_text(&value).expect("it is JSON"), r#"{"a":[0.123457,1e-12],"b":123456789,"c":null}"#);
    }
}
