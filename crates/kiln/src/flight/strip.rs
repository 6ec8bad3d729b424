//! The strip of pictures: a column for each place, a row for each way to light the ball there.

use super::{BallTracer, FlightPath, Frames, Light, Row, ao};
use crate::picture::{Ball, Camera, Image, Shading, Surface};
use glam::{DVec3, Vec3};
use kiln_scene::BakedScene;
use kiln_trace::Ray;

/// Vertical field of view, degrees.
const FOV_DEGREES: f64 = 50.0;

/// How much of the way to what is behind the camera it may go.
const ROOM: f64 = 0.9;

/// Where the camera may stand, as turns from right behind, in the order in which they are taken.
const TURNS_DEGREES: [f64; 8] = [20.0, -20.0, 60.0, -60.0, 100.0, -100.0, 140.0, -140.0];

/// Draws all rows.
pub(crate) fn draw(
    scene: &BakedScene,
    shading: &Shading,
    path: &FlightPath,
    frames: &Frames,
    rows: &[Row],
    tracer: &BallTracer,
    size: [u32; 2],
) -> Image {
    let surface = Surface::new(scene, shading, tracer.space().1);
    let columns: Vec<Vec<Image>> = (frames.pictures.iter().enumerate())
        .map(|(picture, frame)| {
            let place = frames.places[*frame];
            let before = frames.places[frame.saturating_sub(1)];
            let after = frames.places[(frame + 1).min(frames.places.len() - 1)];
            let camera = camera(tracer, place, after - before, path.camera_m);
            let lights: Vec<Light> = rows.iter().map(|row| row.lights[picture]).collect();
            let shades = |normal: Vec3| lights.iter().map(|light| ao(light, normal)).collect();
            surface.render_ball(&camera, &Ball { center: place, radius_m: path.radius_m }, &shades, lights.len(), size)
        })
        .collect();
    let mut columns = columns.iter().map(|column| Image::stacked(column));
    let first = columns.next().unwrap_or_else(|| Image { width: 0, height: 0, rgb: Vec::new() });
    columns.fold(first, |left, right| left.beside(&right))
}

/// From behind and above; where something stands in the way, from where there is most room.
fn camera(tracer: &BallTracer, place: DVec3, heading: DVec3, distance_m: f64) -> Camera {
    let level = DVec3::new(heading.x, 0.0, heading.z).normalize_or(DVec3::Z);
    let side = level.cross(DVec3::Y);
    let (tracer, origin) = tracer.space();
    let mut best = (DVec3::Y, 0.0);
    for turn in TURNS_DEGREES {
        let (sin, cos) = f64::sin_cos(turn * std::f64::consts::PI / 180.0);
        let away = (DVec3::Y * 0.5 - level * cos + side * sin).normalize();
        let ray = Ray { origin: (place - origin).as_vec3(), direction: away.as_vec3(), t_max: distance_m as f32 };
        let hit = tracer.closest_hit(&ray);
        let room = if hit.is_hit() { ROOM * f64::from(hit.t) } else { distance_m };
        if room > best.1 {
            best = (away, room);
        }
    }
    let (away, room) = best;
    Camera { eye: place + away * room.max(1e-3), target: place, fov_degrees: FOV_DEGREES }
}
