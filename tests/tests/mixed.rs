//! One bake on the processor and a device at once, in one process and on a farm. The device is a software driver's.

use kiln_tests::{Workplace, wait_for};
use serde_json::Value;

const BAKE: [&str; 2] = ["--quality", "low"];

/// Longer than a worker takes to start.
const LONGER: [&str; 2] = ["--quality", "high"];

fn lanes(place: &Workplace, report: &str) -> (String, Vec<String>) {
    let backend = &place.json(report)["backend"];
    let traced_in = backend["traced_in"].as_array().expect("the report names lanes");
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    (text(&backend["trace"]), traced_in.iter().map(text).collect())
}

#[test]
fn a_mixed_bake_is_within_the_bound_and_says_where_it_was_traced() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let bake = |name: &str, backend: &str| {
        let (file, report) = (format!("{name}.glb"), format!("{name}.json"));
        let own = ["bake", "level.glb", "-o", &file, "--report", &report, "--backend", backend];
        let output =
            place.command(&[&own[..], &BAKE].concat()).env("KILN_GPU", "software").output().expect("it starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        lanes(&place, &report)
    };
    let (trace, traced_in) = bake("mixed", "mixed");
    assert_eq!(trace, "mixed");
    assert!(traced_in[0] == "cpu" && traced_in[1].starts_with("gpu:") && traced_in.len() == 2, "{traced_in:?}");
    // Bakes in one lane take nothing of it, though they share its store.
    assert_eq!(bake("cpu", "cpu"), ("cpu".to_owned(), vec!["cpu".to_owned()]));
    assert_eq!(place.json("cpu.json")["cache"]["by_stage"]["trace"]["hits"], 0);
    let (gpu, traced_in) = bake("gpu", "gpu");
    assert_eq!(traced_in, [gpu]);
    // The three differ by what rounding decides: single rays of single samples.
    for other in ["mixed.glb", "gpu.glb"] {
        place.succeed(&["compare", "cpu.glb", other, "--fail-above", "0.002"]);
    }
    // What is known from before names the lanes that traced it, too.
    assert_eq!(bake("mixed", "mixed").1.len(), 2);
    assert_eq!(place.json("mixed.json")["cache"]["by_stage"]["trace"]["misses"], 0);
}

#[test]
fn a_farm_of_both_works_on_one_bake() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let serve = ["serve", "--listen", "127.0.0.1:0", "--data-dir", "farm", "--address-file", "address"];
    let _server = place.start(&serve);
    let read = || std::fs::read_to_string(place.path("address")).ok().filter(|text| text.ends_with('\n'));
    let address = wait_for("the coordinator's start", read);
    let address = address.trim();
    let worker = |backend: &str| {
        let own = ["worker", "--coordinator", address, "--name", backend, "--data-dir", backend, "--threads", "1"];
        place.start_with(&[&own[..], &["--backend", backend]].concat(), &[("KILN_GPU", "software")])
    };
    let submit = ["submit", "level.glb", "--coordinator", address, "--backend", "mixed"];
    let bake = place.succeed(&[&submit[..], &LONGER].concat());
    // The processor would be done before the device's first kernel is compiled: it comes when the device has traced something.
    let _device = worker("gpu");
    let has_traced = || {
        let output = place.run(&["ls", "--coordinator", address, "--workers", "--json"]);
        let list: Value = serde_json::from_slice(&output.stdout).ok()?;
        (list["workers"][0]["rays"].as_u64()? > 0).then_some(())
    };
    wait_for("the device's first piece", has_traced);
    let _processor = worker("cpu");
    place.succeed(&["watch", bake.trim(), "--coordinator", address]);
    place.succeed(&["fetch", bake.trim(), "--coordinator", address, "-o", "farm.glb", "--report", "farm.json"]);
    let (trace, traced_in) = lanes(&place, "farm.json");
    assert!(trace == "mixed" && traced_in.len() == 2, "{traced_in:?}");
    place.succeed(&[&["bake", "level.glb", "-o", "cpu.glb", "--backend", "cpu"][..], &LONGER].concat());
    place.succeed(&["compare", "cpu.glb", "farm.glb", "--fail-above", "0.002"]);
}
