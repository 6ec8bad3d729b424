//! A farm of processes: coordinator, workers, clients over TCP; and what survives SIGKILL.

use kiln_tests::{Background, Workplace, wait_for};
use serde_json::Value;

const BAKE: [&str; 4] = ["--quality", "high", "--backend", "cpu"];

/// A coordinator on a free port.
fn serve(place: &Workplace) -> (Background, String) {
    // What an earlier one left.
    let _ = std::fs::remove_file(place.path("address"));
    let server = place.start(&["serve", "--listen", "127.0.0.1:0", "--data-dir", "farm", "--address-file", "address"]);
    let read = || std::fs::read_to_string(place.path("address")).ok().filter(|text| text.ends_with('\n'));
    let address = wait_for("the coordinator's start", read);
    (server, address.trim().to_owned())
}

fn worker(place: &Workplace, address: &str, name: &str) -> Background {
    let folder = format!("worker-{name}");
    place.start(&[
        "worker",
        "--coordinator",
        address,
        "--name",
        name,
        "--data-dir",
        &folder,
        "--threads",
        "1",
        "--backend",
        "cpu",
    ])
}

fn list(place: &Workplace, address: &str) -> Vec<Value> {
    let output = place.run(&["ls", "--coordinator", address, "--json"]);
    let list: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    list["bakes"].as_array().cloned().unwrap_or_default()
}

/// Waits until a good part of the bake's tasks is done, and returns how many.
fn wait_for_progress(place: &Workplace, address: &str, bake: &str) -> u64 {
    wait_for("progress of the bake", || {
        let bakes = list(place, address);
        let found = bakes.iter().find(|b| b["bake"] == bake)?;
        assert_ne!(found["state"], "failed", "{found}");
        found["tasks_done"].as_u64().filter(|&done| done >= 8)
    })
}

#[test]
fn a_farm_that_loses_a_worker_gives_the_same_bytes() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let (_server, address) = serve(&place);
    let mut workers = ["a", "b", "c"].map(|name| worker(&place, &address, name));
    let bake = place.succeed(&[&["submit", "level.glb", "--coordinator", &address][..], &BAKE].concat());
    let bake = bake.trim();
    wait_for_progress(&place, &address, bake);
    workers[0].kill();
    place.succeed(&["watch", bake, "--coordinator", &address]);
    place.succeed(&["fetch", bake, "--coordinator", &address, "-o", "farm.glb", "--report", "r.json"]);

    place.succeed(&[&["bake", "level.glb", "-o", "alone.glb"][..], &BAKE].concat());
    assert_eq!(place.read("farm.glb"), place.read("alone.glb"));
    let report = place.json("r.json");
    assert_eq!(report["cache"]["hits"], 0);
    assert!(report["cache"]["by_stage"]["trace"]["misses"].as_u64() > Some(50));
}

#[test]
fn a_coordinator_that_is_killed_goes_on_where_it_was() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let (mut server, address) = serve(&place);
    let mut first = worker(&place, &address, "a");
    let bake = place.succeed(&[&["submit", "level.glb", "--coordinator", &address][..], &BAKE].concat());
    let bake = bake.trim();
    let done = wait_for_progress(&place, &address, bake);
    server.kill();
    first.kill();

    let (_server, address) = serve(&place);
    let _second = worker(&place, &address, "b");
    place.succeed(&["watch", bake, "--coordinator", &address]);
    place.succeed(&["fetch", bake, "--coordinator", &address, "-o", "farm.glb", "--report", "r.json"]);
    let hits = place.json("r.json")["cache"]["hits"].as_u64().unwrap();
    assert!(hits >= done, "{hits} results of {done} were kept");
    place.succeed(&[&["bake", "level.glb", "-o", "alone.glb"][..], &BAKE].concat());
    assert_eq!(place.read("farm.glb"), place.read("alone.glb"));
}

#[test]
fn a_bake_that_is_killed_does_not_redo_what_it_finished() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let arguments =
        [&["bake", "level.glb", "-o", "baked.glb", "--report", "r.json", "--threads", "1"][..], &BAKE].concat();
    let packs = || std::fs::read_dir(place.path("data/packs")).map_or(0, Iterator::count);
    // Another bake, which shares no task with the one that follows, stores the BVHs: what comes then is of leases.
    place.succeed(&["bake", "level.glb", "-o", "low.glb", "--quality", "low", "--backend", "cpu", "--threads", "1"]);
    let before = packs();
    let mut first = place.start(&arguments);
    wait_for("some finished leases", || (packs() >= before + 8).then_some(()));
    assert!(first.is_running(), "the bake was too quick to be killed");
    first.kill();
    assert!(!place.path("baked.glb").exists());

    place.succeed(&arguments);
    let report = place.json("r.json");
    let trace = &report["cache"]["by_stage"]["trace"];
    assert!(trace["hits"].as_u64() > Some(0) && trace["misses"].as_u64() > Some(0), "{trace}");
    place.succeed(&[&["bake", "level.glb", "-o", "fresh.glb", "--data-dir", "other"][..], &BAKE].concat());
    assert_eq!(place.read("baked.glb"), place.read("fresh.glb"));
}

#[test]
fn requests_are_answered_once_and_bakes_can_be_cancelled() {
    let place = Workplace::new();
    place.succeed(&["example", "crates", "-o", "level.glb"]);
    place.succeed(&["example", "stairs", "-o", "other.glb"]);
    let (_server, address) = serve(&place);
    let submit = |level: &str| place.run(&["submit", level, "--coordinator", &address, "--request-id", "night-1"]);
    let first = submit("level.glb");
    assert!(first.status.success());
    assert_eq!(first.stdout, submit("level.glb").stdout);
    let other = submit("other.glb");
    assert_eq!(other.status.code(), Some(1), "another payload under the same id is an error");

    let bake = String::from_utf8(first.stdout).unwrap();
    let bake = bake.trim();
    assert!(place.fail(1, &["fetch", bake, "--coordinator", &address, "-o", "x.glb"]).contains("kiln watch"));
    place.succeed(&["cancel", bake, "--coordinator", &address]);
    assert_eq!(place.run(&["watch", bake, "--coordinator", &address]).status.code(), Some(130));

    // A coordinator that others can reach wants a token.
    assert!(place.fail(2, &["serve", "--listen", "0.0.0.0:0"]).contains("token"));
}

#[test]
fn a_farm_makes_the_same_pack() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let region =
        |id: &str, x: i32| format!("[[region]]\nid = \"{id}\"\nmin_m = [{x}, 0, -8]\nmax_m = [{}, 4, 8]\n", x + 8);
    let sidecar = [region("west", -8), region("east", 0)].concat();
    std::fs::write(place.path("level.kiln.toml"), sidecar).expect("a file can be written");
    let bake = ["bake", "level.glb", "-o", "local.glb", "--pack", "local.kiln", "--quality", "low", "--backend", "cpu"];
    place.succeed(&bake);
    let (_server, address) = serve(&place);
    let _workers = [worker(&place, &address, "a"), worker(&place, &address, "b")];
    let submit = ["submit", "level.glb", "--coordinator", &address, "--quality", "low", "--backend", "cpu"];
    place.succeed(&[&submit[..], &["--wait", "-o", "farm.glb", "--pack", "farm.kiln"]].concat());
    assert!(place.read("farm.kiln") == place.read("local.kiln"), "a farm's pack differs");
    assert!(place.read("farm.glb") == place.read("local.glb"), "a farm's file differs");
    // A level with regions has a pack without being asked, and it lies beside the file.
    let bake = list(&place, &address)[0]["bake"].as_str().expect("an id").to_owned();
    place.succeed(&["fetch", &bake, "--coordinator", &address, "-o", "again.glb"]);
    assert!(place.read("again.kiln") == place.read("local.kiln"));
}
