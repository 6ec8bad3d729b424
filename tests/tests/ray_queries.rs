//! `--ray-queries` from the command line. The device is a software driver's.

use kiln_tests::Workplace;
use std::process::Output;

/// Runs a command on the software driver with ray queries; `None` where the driver has none, which `KILN_REQUIRE_RAY_QUERIES=1` forbids.
#[expect(clippy::print_stderr, reason = "a test that tests nothing says so")]
fn with_ray_queries(place: &Workplace, arguments: &[&str]) -> Option<Output> {
    let own = ["--backend", "gpu", "--ray-queries"];
    let output = place.command(&[arguments, &own].concat()).env("KILN_GPU", "software").output().expect("it starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if said.contains("cannot trace by ray queries") {
        assert!(said.contains("VK_KHR_ray_query") && said.contains("leave --ray-queries away"), "{said}");
        let is_required = std::env::var("KILN_REQUIRE_RAY_QUERIES").is_ok_and(|value| value == "1");
        assert!(!is_required, "KILN_REQUIRE_RAY_QUERIES is 1: {said}");
        eprintln!("NOT TESTED, no ray queries: {said}");
        return None;
    }
    assert!(output.status.success(), "{said}");
    Some(output)
}

#[test]
fn a_bake_with_ray_queries_has_the_same_bytes() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    // Folders of their own: a bake takes nothing from the other.
    let bake = |name, folder| ["bake", "level.glb", "-o", name, "--quality", "low", "--data-dir", folder];
    let Some(output) = with_ray_queries(&place, &bake("hardware.glb", "one")) else { return };
    let said = String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("with ray queries"), "{said}");
    let software = [&bake("software.glb", "other")[..], &["--backend", "gpu"]].concat();
    let output = place.command(&software).env("KILN_GPU", "software").output().expect("it starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(place.read("hardware.glb") == place.read("software.glb"));
}

#[test]
fn rays_are_compared_both_ways() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let bench = ["bench", "rays", "level.glb", "--points", "500", "--reps", "2", "--thread-counts", "1"];
    let Some(output) = with_ray_queries(&place, &bench) else { return };
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("of 32000 rays 0 closest hits and 0 any hits differ"), "{said}");
    for mode in ["closest", "any", "gather 16"] {
        assert!(said.lines().any(|line| line.starts_with(&format!("- {mode}: ")) && line.contains("ratio")), "{said}");
    }
}

#[test]
fn without_a_graphics_card_they_are_refused() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    for command in [&["bake", "level.glb", "-o", "x.glb", "--backend", "cpu"][..], &["bench", "rays", "level.glb"]] {
        let said = place.fail(2, &[command, &["--ray-queries"]].concat());
        assert!(said.contains("--ray-queries is for graphics cards"), "{said}");
    }
    let said = place.fail(2, &["submit", "level.glb", "--ray-queries"]);
    assert!(said.contains("kiln worker --ray-queries"), "{said}");
}
