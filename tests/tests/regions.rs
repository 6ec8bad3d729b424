//! Visibility regions as a user makes them for a level that has none.

use kiln_tests::Workplace;
use serde_json::Value;

fn courtyard() -> Workplace {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    place
}

fn text(place: &Workplace, name: &str) -> String {
    String::from_utf8(place.read(name)).expect("a sidecar is text")
}

fn count(report: &Value, name: &str) -> u64 {
    report[name].as_u64().unwrap_or_else(|| panic!("{name} is no count: {report}"))
}

#[test]
fn regions_are_made_and_read_again() {
    let place = courtyard();
    let before = "# kept as it is\nblend = [0.5, 0.5]";
    std::fs::write(place.path("level.kiln.toml"), before).expect("the sidecar can be written");
    let report = place.succeed(&["regions", "level.glb", "-o", "made.toml", "--json"]);
    let report: Value = serde_json::from_str(&report).expect("--json prints JSON");
    let (regions, edges) = (count(&report, "regions"), count(&report, "edges"));
    assert!((10..100).contains(&regions) && edges >= regions - 1, "{report}");
    assert!(report["free_volume_m3"].as_f64() <= report["box_volume_m3"].as_f64(), "{report}");
    let made = text(&place, "made.toml");
    assert!(made.starts_with(before));
    assert_eq!(made.matches("[[region]]").count() as u64, regions);
    assert_eq!(made.matches("[[edge]]").count() as u64, edges);

    // They are read where they are, and only once.
    place.succeed(&["check", "level.glb", "--level", "made.toml"]);
    let again = place.run(&["regions", "level.glb", "--level", "made.toml", "-o", "again.toml"]);
    assert_eq!(again.status.code(), Some(3));
    let message = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(message.contains("made.toml") && message.contains("regions already"), "{message}");
    assert!(!place.path("again.toml").exists());
}

#[test]
fn threads_do_not_matter_and_seeds_do() {
    let place = courtyard();
    let make = |name: &str, more: &[&str]| {
        let line = ["regions", "level.glb", "-o", name, "--cell", "0.5"];
        place.succeed(&[&line[..], more].concat());
        text(&place, name)
    };
    let one = make("one.toml", &["--threads", "1"]);
    assert_eq!(one, make("two.toml", &["--threads", "2"]));
    assert_eq!(make("few.toml", &["--max-regions", "3"]).matches("[[region]]").count(), 3);
    assert!(make("seeded.toml", &["--seed-point", "0,1,0"]).contains("[[region]]"));
}

#[test]
fn what_cannot_be_made_is_refused() {
    let place = courtyard();
    for (more, code, word) in [
        (["--cell", "0.001"], 3, "use --cell"),
        (["--seed-point", "900,0,0"], 3, "outside the level's bounds"),
        (["--seed-point", "1,2"], 2, "X,Y,Z"),
        (["--cell", "0"], 2, "a positive number"),
    ] {
        let line = ["regions", "level.glb", "-o", "x.toml"];
        let output = place.run(&[&line[..], &more[..]].concat());
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.contains(word), "{message}");
    }
    place.succeed(&["example", "empty", "-o", "empty.glb"]);
    let output = place.run(&["regions", "empty.glb", "-o", "x.toml"]);
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&output.stderr).contains("nothing in the level stops a ray"));
}
