//! `kiln view`: a picture of the AO in a baked file, or of where its meshes are too coarse for it.

use crate::{
    args::{Common, OverlayChoice, ViewArgs},
    failure::Failure,
    flight::{BallTracer, FlightPath, FlightReport, Frames, draw},
    picture::{Camera, Image, Shading, TICK, TOP, render, write_png},
    source::read_baked,
};
use anyhow::Context;
use kiln_core::CoarseFaces;
use kiln_runtime::Pack;
use kiln_scene::{BakedPart, BakedScene};
use std::path::Path;

#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &ViewArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let scene = read_baked(&args.baked)?;
    if let Some(path) = &args.fly {
        return fly(args, path, &scene, common);
    }
    let [width, height] = args.size.unwrap_or([1280, 800]);
    let camera = match &args.camera {
        Some(numbers) => Camera::parse(numbers).map_err(|error| Failure::usage(format!("--camera: {error}")))?,
        None => Camera::overview(&scene, f64::from(width) / f64::from(height)),
    };
    let draw = |scene: &BakedScene, path: &Path| {
        let shading = shading(scene, path, args.overlay, args.channel)?;
        Ok::<Image, Failure>(render(scene, &camera, &shading, width, height))
    };
    let mut image = draw(&scene, &args.baked)?;
    if let Some(other) = &args.side_by_side {
        image = image.beside(&draw(&read_baked(other)?, other)?);
    }
    write_png(&args.output, &image)?;
    if common.json {
        let mut said = serde_json::json!({ "path": args.output, "width": image.width, "height": image.height });
        if args.overlay.is_some() {
            said["scale"] =
                serde_json::json!({ "low": 0.0, "high": TOP, "tick": TICK, "coarse": CoarseFaces::LEAST_DEVIATION });
        }
        println!("{said}");
        return Ok(());
    }
    println!("wrote {} ({} × {})", args.output.display(), image.width, image.height);
    if args.overlay.is_some() {
        println!(
            "deviation of the AO from what its vertices can hold: 0 dark blue, {TOP} and more yellow, a tick of the bar at \
             each {TICK}; from {} on a face is too coarse",
            CoarseFaces::LEAST_DEVIATION
        );
    }
    Ok(())
}

/// A strip of pictures of a ball that moves through the level.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn fly(args: &ViewArgs, path: &Path, scene: &BakedScene, common: &Common) -> Result<(), Failure> {
    let path = FlightPath::read(path)?;
    let frames = Frames::of(&path);
    let bytes = args.pack.iter().map(|file| {
        let context = || format!("{} cannot be read", file.display());
        std::fs::read(file).with_context(context)
    });
    let bytes = bytes.collect::<Result<Vec<Vec<u8>>, _>>()?;
    let (mut rows, mut crossings, mut tracer) = (Vec::new(), Vec::new(), None);
    for (file, bytes) in args.pack.iter().zip(&bytes) {
        let name = file.display().to_string();
        let pack = Pack::new(bytes).map_err(|error| Failure::refused(format!("{name}: {error}")))?;
        if tracer.is_none() {
            let found = tracer.insert(BallTracer::new(scene, frames.places[0], pack.meta()));
            rows.push(frames.traced(found)?);
        }
        let (two, crossed) = frames.modelled(&pack, &name)?;
        rows.extend(two);
        crossings.push(crossed);
    }
    let Some(tracer) = tracer else { return Err(Failure::usage("--fly: give a pack by --pack")) };
    let shading = shading(scene, &args.baked, None, args.channel)?;
    let size = args.size.unwrap_or([320, 240]);
    let image = draw(scene, &shading, &path, &frames, &rows, &tracer, size);
    write_png(&args.output, &image)?;
    let report = FlightReport { frames: frames.places.len(), crossings, rows: rows.iter().map(Into::into).collect() };
    if common.json {
        println!("{}", serde_json::to_string(&report).map_err(anyhow::Error::from)?);
        return Ok(());
    }
    println!("wrote {} ({} × {}); rows from the top:", args.output.display(), image.width, image.height);
    for row in &report.rows {
        println!("  {}: greatest change of AO in a frame {:.4}", row.name, row.greatest_step);
    }
    println!("the ball came into another region {:?} times in {} frames", report.crossings, report.frames);
    Ok(())
}

/// The picture that `kiln bake --preview` leaves.
pub(crate) fn preview(baked: &Path, output: &Path) -> Result<(), Failure> {
    let (scene, size) = (read_baked(baked)?, [1280, 800]);
    let camera = Camera::overview(&scene, f64::from(size[0]) / f64::from(size[1]));
    let shading = shading(&scene, baked, None, None)?;
    write_png(output, &render(&scene, &camera, &shading, size[0], size[1]))?;
    Ok(())
}

/// What a file shows, if it has it.
fn shading(
    scene: &BakedScene,
    path: &Path,
    overlay: Option<OverlayChoice>,
    channel: Option<usize>,
) -> Result<Shading, Failure> {
    let most = |of: fn(&BakedPart) -> usize| scene.parts.iter().map(of).max().unwrap_or(0);
    let shading = match overlay {
        None => Shading::ao(channel, most(|part| part.channels)),
        Some(OverlayChoice::Residual) => {
            let channels = most(|part| part.residual_channels);
            if channels == 0 {
                let advice = "bake it with `kiln bake --residual`";
                return Err(Failure::refused(format!("{} has no `_AO_RESIDUAL`; {advice}", path.display())));
            }
            Shading::residual(channel, channels)
        }
    };
    shading.map_err(|error| Failure::usage(format!("{}: {error}", path.display())))
}
