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
    let files = Files { output: Some(&args.output), pack: args.pack.as_deref(), report: args.report.as_deref() };
    finish(&farm, bake, files, &BakeSettings::default(), started, common).await
}

/// Files that are wanted of a bake.
pub(crate) struct Files<'a> {
    /// The baked file.
    pub(crate) output: Option<&'a Path>,
    /// The pack.
    pub(crate) pack: Option<&'a Path>,
    /// The report.
    pub(crate) report: Option<&'a Path>,
}

/// Writes what was asked for of a bake that has ended, and prints the result.
pub(crate) async fn finish(
    farm: &Farm,
    bake: v1::Bake,
    files: Files<'_>,
    settings: &BakeSettings,
    started: Instant,
    common: &Common,
) -> Result<(), Failure> {
    let outcome = Outcome::of(farm, bake).await?;
    let mut outputs = Vec::new();
    match (files.output, files.pack) {
        (Some(path), pack) => outputs.extend(outcome.save(farm, path, pack).await?),
        (None, Some(pack)) => outputs.push(outcome.save_pack(farm, pack).await?),
        (None, None) => {}
    }
    let seconds = started.elapsed().as_secs_f64();
    let report = |outcome: &Outcome| outcome.report(settings, seconds, &outputs, None);
    outcome.tell(report, files.report, &outputs, seconds, common)
}
