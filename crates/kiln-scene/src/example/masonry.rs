//! Built things of the example levels: arcade, room, stairs, terrace, pavement. Metres, y up; all stand on y = 0.

use super::surface::{Surface, line_runs, lines};
use glam::{DAffine3, DVec2, DVec3};
use std::f64::consts::PI;

/// Width of one bay of the arcade, along x.
pub(super) const BAY_WIDTH: f64 = 3.0;
/// Height of the arcade's wall.
pub(super) const ARCADE_HEIGHT: f64 = 4.0;
/// Thickness of all walls.
pub(super) const WALL: f64 = 0.5;
/// Half the clear width of an arch, and the radius of its half circle.
const ARCH_RADIUS: f64 = 1.0;
/// Where the half circle springs.
const SPRING: f64 = 2.0;
const CELL: f64 = 0.25;
/// Pieces of the half circle: four up each side of the bay's outline, eight along its top.
const ARCH_PIECES: u32 = 16;

/// One bay of an arcade, centred on x = 0 and z = 0: both faces and the inside of the arch. Its top is meant to
/// carry a roof and its ends to meet neighbours or [`arcade_end`].
pub(super) fn arch_bay() -> Surface {
    let front = arch_front();
    let mut bay = front.clone().moved(DAffine3::from_rotation_y(PI));
    bay.append(&front);
    bay.append(&arch_inside());
    bay
}

/// Centre of the half circle's corner `i`, from left to right.
fn arch_direction(i: f64) -> DVec2 {
    DVec2::from_angle(PI * (1.0 - i / f64::from(ARCH_PIECES)))
}

fn arch_front() -> Surface {
    let half = 0.5 * BAY_WIDTH;
    let z = DVec3::Z * 0.5 * WALL;
    let ys = lines(0.0, SPRING, CELL);
    let mut front = Surface::rectangle(&lines(-half, -ARCH_RADIUS, CELL), &ys, z, DVec3::X, DVec3::Y);
    front.append(&Surface::rectangle(&lines(ARCH_RADIUS, half, CELL), &ys, z, DVec3::X, DVec3::Y));
    let quarter = f64::from(ARCH_PIECES) / 4.0;
    let outline = |i: f64| {
        let along_top = (i - 2.0 * quarter).clamp(-quarter, quarter) / quarter;
        let up_side = i.min(4.0 * quarter - i).min(quarter) / quarter;
        DVec2::new(half * along_top, SPRING + (ARCADE_HEIGHT - SPRING) * up_side)
    };
    let pieces: Vec<f64> = (0..=ARCH_PIECES).map(f64::from).collect();
    front.append(&Surface::patch(&pieces, &[0.0, 0.5, 1.0], |i, outwards| {
        let arch = DVec2::Y * SPRING + ARCH_RADIUS * arch_direction(i);
        (arch.lerp(outline(i), outwards).extend(z.z), DVec3::Z)
    }));
    front
}

/// Jambs and half circle as one smooth strip.
fn arch_inside() -> Surface {
    let jamb = lines(0.0, SPRING, CELL);
    let left = jamb.iter().map(|&y| (DVec2::new(-ARCH_RADIUS, y), DVec2::X));
    let arch = (1..ARCH_PIECES).map(|i| {
        let direction = arch_direction(f64::from(i));
        (DVec2::Y * SPRING + ARCH_RADIUS * direction, -direction)
    });
    let right = jamb.iter().rev().map(|&y| (DVec2::new(ARCH_RADIUS, y), -DVec2::X));
    let curve: Vec<(DVec2, DVec2)> = left.chain(arch).chain(right).collect();
    let parameters: Vec<f64> = (0..curve.len() as u32).map(f64::from).collect();
    Surface::patch(&parameters, &lines(-0.5 * WALL, 0.5 * WALL, CELL), |i, z| {
        let (point, normal) = curve[i as usize];
        (point.extend(z), normal.extend(0.0))
    })
}

/// The end of an arcade that faces −x, at x = 0.
pub(super) fn arcade_end() -> Surface {
    let zs = lines(-0.5 * WALL, 0.5 * WALL, CELL);
    let ys = line_runs(0.0, &[(SPRING, CELL), (ARCADE_HEIGHT, 2.0 * CELL)]);
    Surface::rectangle(&zs, &ys, DVec3::ZERO, DVec3::Z, DVec3::Y)
}

/// Outer size of the room along x and z; its walls are [`WALL`] thick and it has no door.
pub(super) const ROOM_SIZE: [f64; 2] = [5.0, 6.0];

/// A closed room from x = z = 0, with one window in its wall towards +x. Walls, floor and roof are one closed solid
/// whose foot is sunk into the ground.
pub(super) fn room() -> Surface {
    let [width, length] = ROOM_SIZE;
    let ys = line_runs(-0.3, &[(0.0, 0.3), (0.15, 0.15), (1.15, 0.5), (2.25, 0.55), (3.05, 0.4), (3.4, 0.35)]);
    let inside = |v: f64, size: f64| v > WALL && v < size - WALL;
    Surface::solid([&lines(0.0, width, 0.5), &ys, &lines(0.0, length, 0.5)], |p| {
        let hollow = inside(p.x, width) && inside(p.z, length) && p.y > 0.15 && p.y < 3.05;
        let window = p.x > width - WALL && p.z > 2.5 && p.z < 4.0 && p.y > 1.15 && p.y < 2.25;
        !hollow && !window
    })
}

/// Rise and run of a step, and the number of steps.
const STEP: (f64, f64, u32) = (0.18, 0.3, 15);
/// Width of the stairs, along x.
const STAIRS_WIDTH: f64 = 1.5;
/// Height of the top step.
pub(super) const STAIRS_HEIGHT: f64 = 2.7;

/// Solid stairs from x = z = 0, rising towards +z.
pub(super) fn stairs() -> Surface {
    stairs_of(STEP.2, &lines(0.0, STAIRS_WIDTH, 0.5))
}

/// Solid stairs of a number of steps and given lines along x.
pub(super) fn stairs_of(steps: u32, xs: &[f64]) -> Surface {
    let (rise, run, _) = STEP;
    let each = |size: f64| (0..=steps).map(|i| f64::from(i) * size).collect::<Vec<_>>();
    Surface::solid([xs, &each(rise), &each(run)], |p| (p.y / rise).floor() <= (p.z / run).floor())
}

/// A raised terrace from x = 0 along z, with a parapet on its side towards +x.
pub(super) fn terrace(width: f64, zs: &[f64]) -> Surface {
    let ys = line_runs(-0.3, &[(0.0, 0.3), (STAIRS_HEIGHT, 0.45), (3.6, 0.45)]);
    Surface::solid([&lines(0.0, width, 0.5), &ys, zs], |p| p.y < STAIRS_HEIGHT || p.x > width - WALL)
}

/// A pavement at y = 0 with sides that go down into the ground; open below.
pub(super) fn pavement(xs: &[f64], zs: &[f64]) -> Surface {
    let mut surface = Surface::floor(xs, zs, 0.0);
    let depth = [-0.3, 0.0];
    let (west, east) = (DVec3::X * xs[0], DVec3::X * xs[xs.len() - 1]);
    let (north, south) = (DVec3::Z * zs[0], DVec3::Z * zs[zs.len() - 1]);
    for side in [
        Surface::rectangle(xs, &depth, south, DVec3::X, DVec3::Y),
        Surface::rectangle(&depth, xs, north, DVec3::Y, DVec3::X),
        Surface::rectangle(&depth, zs, east, DVec3::Y, DVec3::Z),
        Surface::rectangle(zs, &depth, west, DVec3::Z, DVec3::Y),
    ] {
        surface.append(&side);
    }
    surface
}

/// A wall or slab between two corners, closed, in cells of at most half a metre, with a line at the ground.
pub(super) fn wall(min: DVec3, max: DVec3) -> Surface {
    let ys = if min.y < 0.0 && max.y > 0.0 {
        line_runs(min.y, &[(0.0, 0.5), (max.y, 0.5)])
    } else {
        lines(min.y, max.y, 0.5)
    };
    Surface::block(&lines(min.x, max.x, 0.5), &ys, &lines(min.z, max.z, 0.5))
}
