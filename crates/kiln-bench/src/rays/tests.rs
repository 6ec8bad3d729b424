//! The whole command on scenes made by code.

use super::{
    files::{FileHit, Paths, RaySet, read_hits},
    *,
};
use clap::Parser;
use kiln_core::Mesh;
use std::fs;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: Args,
}

fn args(words: &[&str]) -> Args {
    Line::try_parse_from([&["rays"], words].concat()).unwrap_or_else(|error| panic!("{error}")).args
}

/// A level of the examples, which has instances and mirrored ones.
fn level(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(format!("{name}.glb"));
    let bytes = kiln_scene::example::build(name).unwrap_or_else(|| panic!("there is an example {name}"));
    fs::write(&path, bytes).unwrap_or_else(|error| panic!("{error}"));
    path
}

fn measure(args: &Args) -> SceneReport {
    args.measure(&args.scenes[0], &Backend::Cpu, &BuildPlace::Here).unwrap_or_else(|error| panic!("{error}"))
}

/// A floor of two triangles and two points above it with two rays each, down and up.
fn floor(folder: &Path) -> Paths {
    let paths = Paths::of(&folder.join("floor"));
    let mesh = Mesh {
        positions: vec![[0.0, 0.0, 0.0], [0.0, 0.0, 4.0], [4.0, 0.0, 0.0], [4.0, 0.0, 4.0]],
        normals: vec![[0.0; 3]; 4],
        faces: vec![[0, 1, 2], [1, 3, 2]],
        face_group: vec![0, 0],
        groups: vec![files::group(false)],
        ..Mesh::default()
    };
    let rays = RaySet {
        per_point: 2,
        diagonal_m: 40.0,
        origins: vec![[1.0, 0.5, 1.0], [3.0, -8.0, 3.0]],
        normals: vec![[0.0, 1.0, 0.0]; 2],
        directions: [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]].repeat(2),
    };
    paths.write(&mesh, &rays).unwrap_or_else(|error| panic!("{error}"));
    paths
}

#[test]
fn files_are_traced_and_hits_written() {
    let scratch = Scratch::new("rays-floor").unwrap();
    let paths = floor(scratch.path());
    let hits = scratch.path().join("hits");
    let words = [scratch.path().join("floor").display().to_string(), hits.display().to_string()];
    let args = args(&[&words[0], "--out", &words[1], "--reps", "2", "--thread-counts", "1,2", "--gather", "16"]);
    let report = measure(&args);
    let expected = [
        FileHit { t: 0.5, triangle: 0, is_back: false },
        FileHit::MISS,
        FileHit::MISS,
        FileHit { t: 8.0, triangle: 1, is_back: true },
    ];
    assert_eq!(read_hits(&hits, 4).unwrap(), expected);
    assert_eq!(
        report.builds.iter().map(|build| (build.threads, build.triangles)).collect::<Vec<_>>(),
        [(1, 2), (2, 2)]
    );
    let names: Vec<(usize, &str)> = report.standings.rows.iter().map(|row| (row.threads, row.mode.as_str())).collect();
    assert_eq!(names, [(1, "closest"), (1, "any"), (1, "gather 16"), (2, "closest"), (2, "any"), (2, "gather 16")]);
    let closest = &report.standings.rows[0].laps;
    assert_eq!((closest.len(), closest[0].rays, closest[0].hit_fraction), (2, 4, Some(0.5)));
    assert_eq!(closest[0].mean_t, Some(4.25));
    // Within 2 m, 5 % of the diagonal, there is one of the two.
    assert_eq!(report.standings.rows[1].laps[0].hit_fraction, Some(0.25));
    assert_eq!(report.standings.rows[2].laps[0].rays, 32);
    assert!(paths.rays.exists(), "what is given stays");
}

#[test]
fn a_level_is_the_same_in_one_and_in_two_levels() {
    let scratch = Scratch::new("rays-levels").unwrap();
    for example in ["mirrored", "courtyard"] {
        let input = Input::Level(level(scratch.path(), example));
        let counts = RayCounts { points: 500, per_point: 8 };
        let case = Case::read(&input, counts).unwrap();
        let placed = hits_of(&case);
        assert!(placed.iter().filter(|hit| hit.is_hit()).count() > 100, "{example}");
        let (mesh, rays) = (case.flat_mesh(), case.rays.clone());
        let flat = hits_of(&Case::read(&input, counts).unwrap().flatten());
        let found = agree::Agreement::of("flattened", &rays, &mesh, &placed, &flat);
        assert!(found.hit_differs <= 4 && found.distance_differs <= 40, "{example}: {found:?}");
    }
}

fn hits_of(case: &Case) -> Vec<FileHit> {
    let traced = Traced::new(&Backend::Cpu, &Arc::new(case.build())).unwrap_or_else(|error| panic!("{error}"));
    contest::hits(case, traced.tracer()).unwrap_or_else(|error| panic!("{error}"))
}

/// A comparison program that knows the floor's hits but for one.
#[cfg(unix)]
const PEER: &str = r#"#!/bin/sh
test "$1" || exit 1
while [ $# -gt 0 ]; do
    case "$1" in
        --out) printf '\0\0\0\077\0\0\0\0\0\0\0\0''\0\0\200\177\377\377\377\377\0\0\0\0''\0\0\200\177\377\377\377\377\0\0\0\0''\0\0\200\177\377\377\377\377\0\0\0\0' > "$2" ;;
    esac
    shift
done
echo '{"embree":40400,"triangles":2,"build_seconds":0.25,"threads":1,"memory_bytes":128}'
echo '{"mode":"closest1","rays":4,"hit_fraction":0.25,"mean_t":0.5,"mrays_per_cpu_second":2.0,"mrays_per_wall_second":1.0}'
"#;

#[cfg(unix)]
#[test]
fn a_program_is_run_in_turn_and_its_hits_compared() {
    let scratch = Scratch::new("rays-peer").unwrap();
    floor(scratch.path());
    let script = scratch.path().join("peer.sh");
    fs::write(&script, PEER).unwrap();
    let program = Peer { program: PathBuf::from("sh"), is_robust: false };
    // A shell that is given the script in place of a file: a program just written may not be run while other tests fork.
    let paths = Paths { positions: script, ..Paths::of(&scratch.path().join("floor")) };
    let case = Case::read(&Input::Files(scratch.path().join("floor")), RayCounts { points: 1, per_point: 1 }).unwrap();
    let plan = Plan { threads: vec![1], reps: 3, stride: 1, gather: Vec::new(), peers: vec![program], is_cpu: true };
    let traced = Traced::new(&Backend::Cpu, &Arc::new(case.build())).unwrap();
    let standings = plan.hold(&case, traced.tracer(), &paths, scratch.path(), &mut |_| {}).unwrap();
    let found = &standings.agreements[0];
    assert_eq!((found.kiln_hits, found.peer_hits, found.hit_differs, found.ties), (2, 1, 1, 0));
    assert_eq!((found.worst[0].ray, found.worst[0].f64_t), (3, 8.0));
    assert_eq!((found.kiln_wrong, found.holds()), (0, true), "the program misses what is there");
    let peer = standings.rows.iter().find(|row| row.mode == "closest1").unwrap();
    assert_eq!((peer.tracer.as_str(), peer.laps.len()), ("Embree", 3));
    let (closest, ratios) = (&standings.rows[0].laps[0], standings.ratios(peer).unwrap());
    assert!(
        ratios.cpu.min <= closest.mrays_per_cpu_second / 2.0 && ratios.cpu.max >= closest.mrays_per_cpu_second / 2.0
    );
    assert_eq!(
        (standings.peer_builds[0].builds.len(), standings.peer_builds[0].builds[0].memory_bytes),
        (3, Some(128))
    );
    let report = SceneReport {
        name: "floor".to_owned(),
        points: 2,
        rays_per_point: 2,
        diagonal_m: 40.0,
        builds: vec![Build::of(&case, 1)],
        standings,
        predicted: Vec::new(),
        ray_queries: None,
    };
    let text = table::scene(&report);
    assert!(
        text.contains("### floor") && text.contains("| 0: agrees |") && text.contains("in f64 8.000000000"),
        "{text}"
    );
}

#[test]
fn what_is_missing_is_said() {
    assert!(args(&[]).check().unwrap_err().to_string().contains("name a level"));
    assert!(args(&["a", "b", "--out", "hits"]).check().unwrap_err().to_string().contains("--out needs one scene"));
    assert!(Line::try_parse_from(["rays", "a", "--gather", "12"]).is_err());
    assert!(Line::try_parse_from(["rays", "a", "--svg-out", "x.svg"]).is_err());
    let missing = args(&["no-such-folder/scene.glb"]);
    let said = missing.measure(&missing.scenes[0], &Backend::Cpu, &BuildPlace::Here).unwrap_err().to_string();
    assert!(said.contains("no-such-folder/scene.glb"), "{said}");
}

#[test]
fn inputs_are_told_by_their_endings() {
    let input = |text: &str| text.parse::<Input>().unwrap_or_else(|never| match never {});
    assert_eq!(input("a/b.glb"), Input::Level(PathBuf::from("a/b.glb")));
    assert_eq!(input("a/b.GLTF"), Input::Level(PathBuf::from("a/b.GLTF")));
    assert_eq!(input("a/b.v2.rays"), Input::Files(PathBuf::from("a/b.v2")));
    assert_eq!(input("a/b.v2"), Input::Files(PathBuf::from("a/b.v2")));
}
