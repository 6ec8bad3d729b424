//! `kiln submit`: a level to a farm.

use crate::{
    args::{BackendChoice, Common, SubmitArgs},
    failure::{Failure, USAGE},
    progress::client_failure,
    source::Source,
};
use kiln_proto::{Submission, v1};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

pub(crate) fn run(args: &SubmitArgs, common: &Common) -> Result<(), Failure> {
    if common.ray_queries {
        let message = "a farm's workers say whether they use ray queries: start them by kiln worker --ray-queries";
        return Err(Failure::new(USAGE, message));
    }
    super::runtime()?.block_on(submit(args, common))
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
async fn submit(args: &SubmitArgs, common: &Common) -> Result<(), Failure> {
    let started = Instant::now();
    let mut settings = args.settings.resolve()?;
    settings.output.pack = args.pack.is_some();
    let source = Source::read(&args.level, args.settings.sidecar.as_deref())?;
    let name = source.name().to_owned();
    let (manifest, files) = source.submission(settings.clone());
    let submission = Submission {
        request_id: args.request_id.clone().unwrap_or_else(unique_id),
        source: manifest,
        backend: match common.backend {
            BackendChoice::Auto => v1::Backend::Auto,
            BackendChoice::Cpu => v1::Backend::Cpu,
            BackendChoice::Gpu => v1::Backend::Gpu,
            BackendChoice::Mixed => v1::Backend::Mixed,
        },
        priority: args.priority,
        name,
        tenant: String::new(),
    };
    let farm = super::farm(&args.farm).await?;
    let (bake, repeated) = farm.submit_with_files(&submission, &files).await.map_err(client_failure)?;
    if !args.wait {
        if common.json {
            println!("{}", serde_json::json!({ "bake": bake.bake_id, "repeated": repeated }));
        } else {
            println!("{}", bake.bake_id);
        }
        return Ok(());
    }
    let ended = super::watch::follow(&farm, &bake.bake_id, common).await?;
    let files = super::fetch::Files {
        output: args.output.as_deref(),
        pack: args.pack.as_deref(),
        report: args.report.as_deref(),
    };
    super::fetch::finish(&farm, ended, files, &settings, started, common).await
}

/// An id that no other process on any machine has chosen: time, process and a hash seed of the system's.
pub(crate) fn unique_id() -> String {
    use std::hash::{BuildHasher, Hasher, RandomState};
    let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos());
    let random = RandomState::new().build_hasher().finish();
    format!("{time:x}-{:x}-{random:x}", std::process::id())
}
