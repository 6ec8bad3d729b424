//! `kiln probe`: AO at given points, for spot checks against other tools.

use crate::{
    args::{Common, ProbeArgs},
    failure::Failure,
    half_distances::{channel_names, kernel_of},
    source::Source,
};
use glam::DVec3;
use kiln_bake::{ProbePoint, ProbeResult, probe};
use kiln_core::{BakeSettings, Kernel};
use kiln_runtime::{Pack, ao_quadratic};
use serde::{Deserialize, Serialize};
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
    let bytes = args.pack.as_deref().map(read).transpose()?;
    let pack = bytes.as_deref().map(Pack::new).transpose();
    let of_pack = || args.pack.as_deref().map_or_else(String::new, |path| path.display().to_string());
    let pack = pack.map_err(|error| Failure::refused(format!("{}: {error}", of_pack())))?;
    if pack.as_ref().is_some_and(|pack| pack.model_count() == 0) {
        let advice = "bake a level that has visibility regions";
        return Err(Failure::refused(format!("{} has no models of regions; {advice}", of_pack())));
    }
    let settings = BakeSettings { foliage: args.foliage.into(), ..BakeSettings::default() };
    let settings = match (&args.half_distance.0, pack.as_ref().map(|pack| kernel_of(pack.meta()))) {
        (None, Some(Kernel::Occlusion { ray_distance_m })) => {
            BakeSettings { occlusion_ray_distance_m: Some(ray_distance_m), ..settings }
        }
        (None, Some(Kernel::Obscurance { half_distances_m })) => {
            BakeSettings { half_distances_m: Some(half_distances_m), ..settings }
        }
        (given, _) => BakeSettings { half_distances_m: given.clone(), ..settings },
    };
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
    let models = pack.map(|pack| points.iter().map(|point| Modelled::of(&pack, point)).collect::<Vec<_>>());
    print(&points, &results, models.as_deref(), &channel_names(kernel), common);
    Ok(())
}

fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    fs::read(path).map_err(|error| Failure::refused(format!("{}: {error}", path.display())))
}

/// What the model of a point's region says.
#[derive(Serialize)]
struct Modelled {
    region: String,
    /// How far the point is from the region's box, metres.
    distance_m: f32,
    /// For each half-distance of the pack.
    ao: Vec<f32>,
}

impl Modelled {
    /// Of a pack that has models.
    fn of(pack: &Pack<'_>, point: &Point) -> Option<Self> {
        let local = pack.meta().local(point.position);
        let hit = pack.region_at(local, None)?;
        let normal = DVec3::from(point.normal).normalize_or(DVec3::Y).as_vec3().to_array();
        let channel = |channel| Some(ao_quadratic(pack.full_at(hit.region, local, channel)?, normal));
        Some(Self {
            region: pack.region_id(hit.region)?.to_owned(),
            distance_m: hit.distance_m,
            ao: (0..pack.meta().channels()).map(channel).collect::<Option<_>>()?,
        })
    }
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
fn print(
    points: &[Point],
    results: &[ProbeResult],
    models: Option<&[Option<Modelled>]>,
    channels: &[String],
    common: &Common,
) {
    let model = |index: usize| models.and_then(|models| models[index].as_ref());
    if common.json {
        let one = |(index, (point, result)): (usize, (&Point, &ProbeResult))| {
            let mut one = serde_json::json!({
                "position": point.position,
                "normal": point.normal,
                "ao": result.ao,
                "back_face_fraction": result.back_face_fraction,
            });
            if let Some(model) = model(index) {
                one["model"] = serde_json::json!(model);
            }
            one
        };
        let list: Vec<_> = points.iter().zip(results).enumerate().map(one).collect();
        println!("{}", serde_json::json!({ "points": list, "half_distances": channels }));
        return;
    }
    let header: String = channels.iter().map(|name| format!(" {name:>10}")).collect();
    let of_models = if models.is_some() { " models" } else { "" };
    println!("{:>32}{header} back faces{of_models}", "position");
    for (index, (point, result)) in points.iter().zip(results).enumerate() {
        let [x, y, z] = point.position;
        let ao: String = result.ao.iter().map(|ao| format!(" {ao:10.6}")).collect();
        let model = model(index).map_or_else(String::new, |model| {
            let ao: String = model.ao.iter().map(|ao| format!(" {ao:.6}")).collect();
            format!("{ao} in {}", model.region)
        });
        println!("{x:10.4} {y:10.4} {z:10.4}{ao} {:9.4} {model}", result.back_face_fraction);
    }
}
