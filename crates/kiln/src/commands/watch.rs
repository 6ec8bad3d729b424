//! `kiln watch`: follows a bake to its end.

use crate::{
    args::{Common, WatchArgs},
    failure::Failure,
    outcome::Outcome,
    progress::{Progress, client_failure},
};
use kiln_proto::{client::Farm, v1};

pub(crate) fn run(args: &WatchArgs, common: &Common) -> Result<(), Failure> {
    super::runtime()?.block_on(watch(args, common))
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
async fn watch(args: &WatchArgs, common: &Common) -> Result<(), Failure> {
    let farm = super::farm(&args.farm).await?;
    let bake = follow(&farm, &args.bake, common).await?;
    let outcome = Outcome::of(&farm, bake).await?;
    if common.json {
        println!(
            "{}",
            serde_json::json!({ "bake": args.bake, "state": "succeeded", "file_bytes": outcome.baked.bytes })
        );
    } else {
        println!("bake {} succeeded; `kiln fetch {} -o OUT.glb` gets the file", args.bake, args.bake);
    }
    Ok(())
}

/// Follows a bake; Ctrl-C stops watching, not the bake.
pub(crate) async fn follow(farm: &Farm, bake_id: &str, common: &Common) -> Result<v1::Bake, Failure> {
    let mut progress = Progress::new(common, false);
    tokio::select! {
        bake = progress.follow(farm.watch(bake_id)) => bake.map_err(client_failure),
        _ = tokio::signal::ctrl_c() => Err(Failure::new(
            crate::failure::INTERRUPTED,
            format!("stopped watching; the bake goes on: `kiln watch {bake_id}` takes it up, `kiln cancel {bake_id}` ends it"),
        )),
    }
}
