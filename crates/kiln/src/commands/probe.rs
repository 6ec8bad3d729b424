//! `kiln probe`: AO at given points, for spot checks against other tools.

use crate::{
    args::{Common, ProbeArgs},
    failure::Failure,
    half_distances::channel_names,
    source::Source,
};
use glam::DVec3;
use kiln_bake::{ProbePoint, ProbeResult, probe};
use kiln_core::BakeSettings;
use serde::Deserialize;
use std::{fs, path::Path};

/// What else is in the file, such as what `kiln bench accuracy --points-out` writes, is left alone.
#[derive(Deserialize)]
struct PointsFile {
    points: Vec<Point>,
}

#[derive(Deserialize)]
struct Point {
    position: [f64; 3],
    normal: [f64; 3],
    /// Normal of the surface, if it is another: directions below it are left out.
    geometric_normal: Option<[f64; 3]>,
}

pub(crate) fn run(args: &ProbeArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let points = read_points(&args.points)?;
    let source = Source::read(&args.level, args.sidecar.as_deref())?;
    let half_distances_m = args.half_distance.0.clone();
    let settings = BakeSettings { half_distances_m, foliage: args.foliage.into(), ..BakeSettings::default() };
    let level = super::load(&source, &settings)?;
    let backend = super::choose_backend(common)?;
    let (_, tracer) = level.tracer(&backend).map_err(anyhow::Error::from)?;
    let origin = level.level.origin_m;
    let relative: Vec<ProbePoint> = points
        .iter()
        .map(|p| ProbePoint {
            position: DVec3::from(p.position) - origin,
            normal: DVec3::from(p.normal),
            geometric: p.geometric_normal.map(DVec3::from),
        })
        .collect();
    let kernel = &level.level.sampling.kernel;
    let results = probe(&**tracer, &relative, kernel, args.rays, args.seed).map_err(anyhow::Error::from)?;
    print(&points, &results, &channel_names(kernel), common);
    Ok(())
}

fn read_points(path: &Path) -> Result<Vec<Point>, Failure> {
    let refuse = |what: String| {
        Failure::refused(format!("{}: {what}; `kiln probe --help` shows the form of a points file", path.display()))
    };
    let text = fs::read_to_string(path).map_err(|error| refuse(error.to_string()))?;
    let file: PointsFile = serde_json::from_str(&text).map_err(|error| refuse(error.to_string()))?;
    for (index, point) in file.points.iter().enumerate() {
        let normals = || [Some(point.normal), point.geometric_normal].into_iter().flatten();
        let is_finite =
            DVec3::from(point.position).is_finite() && normals().all(|normal| DVec3::from(normal).is_finite());
        if !is_finite || normals().any(|normal| DVec3::from(normal).length() <= 0.0) {
            return Err(refuse(format!("points[{index}] needs a finite position and normals that are not zero")));
        }
    }
    Ok(file.points)
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print(points: &[Point], results: &[ProbeResult], channels: &[String], common: &Common) {
    if common.json {
        let one = |(point, result): (&Point, &ProbeResult)| {
            serde_json::json!({
                "position": point.position,
                "normal": point.normal,
                "ao": result.ao,
                "back_face_fraction": result.back_face_fraction,
            })
        };
        let list: Vec<_> = points.iter().zip(results).map(one).collect();
        println!("{}", serde_json::json!({ "points": list, "half_distances": channels }));
        return;
    }
    let header: String = channels.iter().map(|name| format!(" {name:>10}")).collect();
    println!("{:>32}{header} back faces", "position");
    for (point, result) in points.iter().zip(results) {
        let [x, y, z] = point.position;
        let ao: String = result.ao.iter().map(|ao| format!(" {ao:10.6}")).collect();
        println!("{x:10.4} {y:10.4} {z:10.4}{ao} {:9.4} ", result.back_face_fraction);
    }
}
