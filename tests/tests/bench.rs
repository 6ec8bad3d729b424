//! `kiln bench bake` on a small level: in this process's manner and by a farm of processes.

use kiln_tests::Workplace;

#[test]
fn bakes_are_measured_in_processes_of_their_own() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "courtyard.glb"]);
    let line = ["bench", "bake", "courtyard.glb", "--quality", "low", "--thread-counts", "1,2", "--farm"];
    let out = ["--reference", "crate_0", "--markdown-out", "table.md", "--json-out", "table.json"];
    let printed = place.succeed(&[&line[..], &out].concat());
    for expected in
        ["| BVH build,", "| coordinator and worker, 2 threads |", "threads busy", "Against `--quality reference`"]
    {
        assert!(printed.contains(expected), "{expected} in {printed}");
    }
    assert!(!printed.contains("| NO |"), "all bakes give the same bytes: {printed}");
    assert!(String::from_utf8(place.read("table.md")).unwrap().contains("| Total |"));

    let report = place.json("table.json");
    let bakes = report["levels"][0]["bakes"].as_array().unwrap();
    assert_eq!(bakes.len(), 3);
    for bake in bakes {
        assert!(bake["wall_secs"].as_f64().unwrap() > 0.0);
        let stages = bake["report"]["stages"].as_array().unwrap();
        assert_eq!(stages.len(), 5);
        let trace = stages.iter().find(|stage| stage["name"] == "trace").unwrap();
        let [tracing, building] =
            ["tracing", "building"].map(|part| trace["parts"][part]["cpu_seconds"].as_f64().unwrap());
        let all = trace["cpu_seconds"].as_f64().unwrap();
        assert!(tracing > 0.0 && building > 0.0 && tracing + building <= all + 1e-9, "{trace}");
        let stage_cpu: f64 = stages.iter().map(|stage| stage["cpu_seconds"].as_f64().unwrap()).sum();
        if bake["variant"]["place"] == "process" {
            assert!(stage_cpu <= bake["report"]["cpu_seconds"].as_f64().unwrap(), "{bake}");
        }
    }
    let reference = &report["levels"][0]["reference"];
    let rmse = reference["rmse"][0].as_f64().unwrap();
    assert!(rmse > 0.0 && rmse < 0.1, "{reference}");
    assert!(reference["faces"].as_u64().unwrap() < reference["level_faces"].as_u64().unwrap());
}

#[test]
fn a_level_that_is_not_there_is_named() {
    let place = Workplace::new();
    let said = place.fail(1, &["bench", "bake", "missing.glb"]);
    assert!(said.contains("missing.glb"), "{said}");
}
