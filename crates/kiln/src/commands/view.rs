//! `kiln view`: a picture of the AO in a baked file.

use crate::{
    args::{Common, ViewArgs},
    failure::Failure,
    picture::{Camera, Image, Shading, render, write_png},
    source::read_baked,
};
use kiln_scene::BakedScene;
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
    let mut image = picture(&scene, &args.baked, &camera, args.channel, args.size)?;
    if let Some(other) = &args.side_by_side {
        let right = picture(&read_baked(other)?, other, &camera, args.channel, args.size)?;
        image = image.beside(&right);
    }
    write_png(&args.output, &image)?;
    if common.json {
        println!("{}", serde_json::json!({ "path": args.output, "width": image.width, "height": image.height }));
    } else {
        println!("wrote {} ({} × {})", args.output.display(), image.width, image.height);
    }
    Ok(())
}

/// The picture that `kiln bake --preview` leaves.
pub(crate) fn preview(baked: &Path, output: &Path) -> Result<(), Failure> {
    let (scene, size) = (read_baked(baked)?, [1280, 800]);
    let camera = Camera::overview(&scene, f64::from(size[0]) / f64::from(size[1]));
    write_png(output, &picture(&scene, baked, &camera, None, size)?)?;
    Ok(())
}

fn picture(
    scene: &BakedScene,
    path: &Path,
    camera: &Camera,
    channel: Option<usize>,
    [width, height]: [u32; 2],
) -> Result<Image, Failure> {
    let channels = scene.parts.iter().map(|part| part.channels).max().unwrap_or(0);
    let shading =
        Shading::new(channel, channels).map_err(|error| Failure::usage(format!("{}: {error}", path.display())))?;
    Ok(render(scene, camera, &shading, width, height))
}
