//! `kiln bake`: a level in one process, by the farm's own code.

use crate::{
    args::{BackendChoice, BakeArgs, Common},
    failure::{FAILED, Failure, GATE, INTERRUPTED},
    gates,
    local_farm::{LocalFarm, TENANT},
    outcome::{Outcome, write_whole},
    progress::{Progress, client_failure},
    report::Output,
    source::Source,
};
use kiln_core::{BakeSettings, Digest};
use kiln_proto::{Submission, client::Farm, v1};
use kiln_scene::{Gates, Sidecar};
use kiln_worker::WorkerError;
use std::time::Instant;
use tokio::task::JoinHandle;

pub(crate) fn run(args: &BakeArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let started = Instant::now();
    let outcome = super::runtime()?.block_on(bake(args, common, started));
    if let (Some(path), Err(failure)) = (&args.junit, &outcome)
        && failure.code != GATE
    {
        let level = args.level.display().to_string();
        let xml = gates::junit(&level, started.elapsed().as_secs_f64(), Some(failure.message()), &[]);
        write_whole(path, xml.as_bytes())?;
    }
    outcome
}

async fn bake(args: &BakeArgs, common: &Common, started: Instant) -> Result<(), Failure> {
    let mut settings = args.settings.resolve()?;
    settings.output.pack = args.pack.is_some();
    let source = Source::read(&args.level, args.settings.sidecar.as_deref())?;
    let gates = match source.sidecar().filter(|_| args.ci) {
        Some(text) => Sidecar::parse(text).map_err(Failure::refused)?.gates,
        None => Gates::default(),
    };
    let mut progress = Progress::new(common, args.ci);
    let mut local = LocalFarm::start(common, |text| progress.line(text)).await?;
    progress.line(&format!("tracing on {}", local.backend));
    let outcome = tokio::select! {
        outcome = follow(&local.farm, source, &settings, common, &mut progress) => outcome,
        failure = worker_ended(&mut local.worker) => Err(failure),
        _ = tokio::signal::ctrl_c() => Err(interrupted()),
    };
    let finished = match outcome {
        Ok(outcome) => finish(args, common, &local, outcome, &settings, started).await,
        Err(failure) => Err(failure),
    };
    local.stop().await?;
    let (outcome, seconds) = finished?;
    check_gates(args, &gates, &outcome, seconds)
}

fn interrupted() -> Failure {
    Failure::new(INTERRUPTED, "interrupted; what is finished is kept, and the next run goes on from there")
}

/// Completes when this process's worker can do no more, as where its device was lost: nobody else would go on.
async fn worker_ended(worker: &mut JoinHandle<Result<(), WorkerError>>) -> Failure {
    match worker.await {
        Ok(Err(WorkerError::DeviceLost { reason })) => {
            let advice = "what is finished is kept; bake again, with --backend mixed to go on without the device";
            Failure::new(FAILED, format!("{reason}; {advice}"))
        }
        Ok(Err(error)) => Failure::new(FAILED, error),
        Ok(Ok(())) | Err(_) => Failure::new(FAILED, "this process's worker has ended"),
    }
}

/// Submits the source and follows the bake to its end.
async fn follow(
    farm: &Farm,
    source: Source,
    settings: &BakeSettings,
    common: &Common,
    progress: &mut Progress,
) -> Result<Outcome, Failure> {
    cancel_left_over(farm).await?;
    let name = source.name().to_owned();
    let (manifest, files) = source.submission(settings.clone());
    let submission = Submission {
        request_id: super::submit::unique_id(),
        source: manifest,
        // The only worker has the backend that was asked for.
        backend: if common.backend == BackendChoice::Mixed { v1::Backend::Mixed } else { v1::Backend::Auto },
        priority: 0,
        name,
        tenant: TENANT.to_owned(),
    };
    let (bake, _) = farm.submit_with_files(&submission, &files).await.map_err(client_failure)?;
    let bake = progress.follow(farm.watch(&bake.bake_id)).await.map_err(client_failure)?;
    Outcome::of(farm, bake).await
}

/// Forgets bakes of runs that were killed: their results stay, and are found by their keys.
async fn cancel_left_over(farm: &Farm) -> Result<(), Failure> {
    let mut page = String::new();
    loop {
        let (bakes, next) = farm.list(1000, &page, true).await.map_err(client_failure)?;
        for bake in bakes {
            farm.cancel(&bake.bake_id).await.map_err(client_failure)?;
        }
        match next {
            Some(token) => page = token,
            None => return Ok(()),
        }
    }
}

/// Writes the file, the picture and the report, and prints the result.
async fn finish(
    args: &BakeArgs,
    common: &Common,
    local: &LocalFarm,
    outcome: Outcome,
    settings: &BakeSettings,
    started: Instant,
) -> Result<(Outcome, f64), Failure> {
    let mut outputs = outcome.save(&local.farm, &args.output, args.pack.as_deref()).await?;
    if let Some(path) = &args.preview {
        super::view::preview(&args.output, path)?;
        let bytes = std::fs::read(path).map_err(anyhow::Error::from)?;
        outputs.push(Output {
            path: path.display().to_string(),
            digest: Digest::of(&bytes),
            bytes: bytes.len() as u64,
        });
    }
    let seconds = started.elapsed().as_secs_f64();
    let report = |outcome: &Outcome| outcome.report(settings, seconds, &outputs, Some(local.executor.bvh_counts()));
    outcome.tell(report, args.report.as_deref(), &outputs, seconds, common)?;
    Ok((outcome, seconds))
}

fn check_gates(args: &BakeArgs, gates: &Gates, outcome: &Outcome, seconds: f64) -> Result<(), Failure> {
    let verdicts = gates::check(gates, &outcome.baked.summary, seconds);
    if let Some(path) = &args.junit {
        let level = args.level.display().to_string();
        write_whole(path, gates::junit(&level, seconds, None, &verdicts).as_bytes())?;
    }
    gates::missed(&verdicts).map_or(Ok(()), |message| Err(Failure::new(GATE, message)))
}
