//! `kiln view`: a picture of the AO in a baked file, or of where its meshes are too coarse for it.

use crate::{
    args::{Common, OverlayChoice, ViewArgs},
    failure::Failure,
    picture::{Camera, Image, Shading, TICK, TOP, render, write_png},
    source::read_baked,
};
use kiln_core::CoarseFaces;
use kiln_scene::{BakedPart, BakedScene};
use std::path::Path;

#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &ViewArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let scene = read_baked(&args.baked)?;
    let [width, height] = args.size;
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
