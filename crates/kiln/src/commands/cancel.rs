//! `kiln cancel`: ends a bake; what is finished keeps its results.

use crate::{
    args::{CancelArgs, Common},
    failure::Failure,
    progress::client_failure,
};

#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &CancelArgs, common: &Common) -> Result<(), Failure> {
    let bake = super::runtime()?.block_on(async {
        let farm = super::farm(&args.farm).await?;
        farm.cancel(&args.bake).await.map_err(client_failure)
    })?;
    let state = super::ls::state(&bake);
    if common.json {
        println!("{}", serde_json::json!({ "bake": bake.bake_id, "state": state }));
    } else {
        println!("bake {} is {state}", bake.bake_id);
    }
    Ok(())
}
