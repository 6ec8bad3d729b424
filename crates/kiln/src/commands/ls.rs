//! `kiln ls`: bakes and workers of a farm.

use crate::{
    args::{Common, LsArgs},
    failure::Failure,
    progress::client_failure,
};
use kiln_proto::{client::Farm, v1};
use serde_json::json;

/// Bakes asked for at once.
const PAGE: u32 = 100;

pub(crate) fn run(args: &LsArgs, common: &Common) -> Result<(), Failure> {
    super::runtime()?.block_on(async {
        let farm = super::farm(&args.farm).await?;
        if args.workers { workers(&farm, common).await } else { bakes(&farm, common).await }
    })
}

/// A bake's state in one word.
pub(crate) fn state(bake: &v1::Bake) -> String {
    let name = bake.state().as_str_name().trim_start_matches("BAKE_STATE_").to_lowercase();
    if bake.paused && !bake.has_ended() { format!("{name}, paused") } else { name }
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
async fn bakes(farm: &Farm, common: &Common) -> Result<(), Failure> {
    let (mut page, mut all) = (String::new(), Vec::new());
    loop {
        let (bakes, next) = farm.list(PAGE, &page, false).await.map_err(client_failure)?;
        all.extend(bakes);
        match next {
            Some(token) => page = token,
            None => break,
        }
    }
    if common.json {
        let one = |b: &v1::Bake| {
            let (done, total) = tasks(b);
            json!({ "bake": b.bake_id, "name": b.name, "state": state(b), "tasks_done": done, "tasks": total,
                "priority": b.priority, "submitted_unix_ms": b.submitted_unix_ms, "ended_unix_ms": b.ended_unix_ms })
        };
        println!("{}", json!({ "bakes": all.iter().map(one).collect::<Vec<_>>() }));
        return Ok(());
    }
    if all.is_empty() {
        println!("no bakes; `kiln submit LEVEL` starts one");
    }
    for bake in &all {
        let (done, total) = tasks(bake);
        println!("{:20} {:12} {done:>7}/{total:<7} {}", bake.bake_id, state(bake), bake.name);
    }
    Ok(())
}

fn tasks(bake: &v1::Bake) -> (u64, u64) {
    bake.stages.iter().fold((0, 0), |(done, total), s| (done + s.done, total + s.total))
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
async fn workers(farm: &Farm, common: &Common) -> Result<(), Failure> {
    let all = farm.list_workers().await.map_err(client_failure)?;
    let state = |w: &v1::Worker| w.state().as_str_name().trim_start_matches("WORKER_STATE_").to_lowercase();
    if common.json {
        let one = |w: &v1::Worker| {
            json!({ "worker": w.worker_id, "name": w.name, "state": state(w), "version": w.version,
                "trace_lanes": w.trace_lanes, "solve_lane": w.solve_lane, "adapter": w.adapter, "cores": w.cores,
                "leases": w.leases, "tasks_done": w.tasks_done, "tasks_failed": w.tasks_failed, "rays": w.rays })
        };
        println!("{}", json!({ "workers": all.iter().map(one).collect::<Vec<_>>() }));
        return Ok(());
    }
    if all.is_empty() {
        println!("no workers; `kiln worker` starts one");
    }
    for w in &all {
        println!(
            "{:28} {:10} {:>3} cores {:>2} leases {:>8} tasks  {}",
            w.name,
            state(w),
            w.cores,
            w.leases,
            w.tasks_done,
            w.adapter
        );
    }
    Ok(())
}
