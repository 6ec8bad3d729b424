//! `kiln fetch`: the result of a finished bake.

use crate::{
    args::{Common, FetchArgs},
    failure::Failure,
    outcome::Outcome,
    progress::client_failure,
};
use kiln_core::BakeSettings;
use kiln_proto::{client::Farm, v1};
use std::{path::Path, time::Instant};

pub(crate) fn run(args: &FetchArgs, common: &Common) -> Result<(), Failure> {
    super::runtime()?.block_on(fetch(args, common))
}

async fn fetch(args: &FetchArgs, common: &Common) -> Result<(), Failure> {
    let started = Instant::now();
    let farm = super::farm(&args.farm).await?;
    let bake = farm.bake(&args.bake).await.map_err(client_failure)?;
    if !bake.has_ended() {
        let message = format!("bake {} has not ended; `kiln watch {}` follows it", args.bake, args.bake);
        return Err(Failure::new(crate::failure::FAILED, message));
    }
    let report = args.report.as_deref();
    finish(&farm, bake, Some(&args.output), report, &BakeSettings::default(), started, common).await
}

/// Writes what was asked for of a bake that has ended, and prints the result.
pub(crate) async fn finish(
    farm: &Farm,
    bake: v1::Bake,
    output: Option<&Path>,
    report_path: Option<&Path>,
    settings: &BakeSettings,
    started: Instant,
    common: &Common,
) -> Result<(), Failure> {
    let outcome = Outcome::of(farm, bake).await?;
    let mut outputs = Vec::new();
    if let Some(path) = output {
        outputs.push(outcome.save(farm, path).await?);
    }
    let seconds = started.elapsed().as_secs_f64();
    let report = |outcome: &Outcome| outcome.report(settings, seconds, &outputs, None);
    outcome.tell(report, report_path, &outputs, seconds, common)
}
