//! Where a picture is taken from.

use glam::{DVec3, Vec3};
use kiln_scene::{BakedPart, BakedScene};

/// A pinhole camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Camera {
    pub(crate) eye: DVec3,
    pub(crate) target: DVec3,
    /// Vertical field of view, degrees.
    pub(crate) fov_degrees: f64,
}

impl Camera {
    /// From `X,Y,Z,TX,TY,TZ[,FOV]`.
    pub(crate) fn parse(numbers: &[f64]) -> Result<Self, String> {
        let (eye, target, fov_degrees) = match *numbers {
            [x, y, z, tx, ty, tz] => (DVec3::new(x, y, z), DVec3::new(tx, ty, tz), 50.0),
            [x, y, z, tx, ty, tz, fov] => (DVec3::new(x, y, z), DVec3::new(tx, ty, tz), fov),
            _ => return Err(format!("a camera is 6 or 7 numbers, not {}", numbers.len())),
        };
        let is_good = eye.is_finite() && target.is_finite() && (1.0..=170.0).contains(&fov_degrees);
        if !is_good || eye.distance(target) <= 0.0 {
            return Err("eye and target must differ, and the field of view be from 1 to 170 degrees".into());
        }
        Ok(Self { eye, target, fov_degrees })
    }

    /// Looks down from a corner at where there is something to see: faces count by how closed they are, so that open
    /// ground and far scenery stay at the edge. The aspect is width over height.
    pub(crate) fn overview(scene: &BakedScene, aspect: f64) -> Self {
        let faces = scene.parts.iter().flat_map(faces_of).filter(|(center, _)| center.is_finite());
        let mut faces: Vec<(DVec3, f64)> = faces.collect();
        let (mut low, mut high) = (DVec3::ZERO, DVec3::ONE);
        if !faces.is_empty() {
            for axis in 0..3 {
                (low[axis], high[axis]) = middle(&mut faces, axis);
            }
        }
        let fov_degrees: f64 = 40.0;
        let radius = (0.5 * (high - low).length()).max(1e-6);
        let half_angle =
            (0.5 * fov_degrees.to_radians()).tan().min((0.5 * fov_degrees.to_radians()).tan() * aspect).atan();
        let target = 0.5 * (low + high);
        let direction = DVec3::new(0.62, 0.52, 0.80).normalize();
        Self { eye: target + direction * (0.92 * radius / half_angle.sin()), target, fov_degrees }
    }

    /// Direction through a point of the picture, each coordinate in [−1, 1], y up.
    pub(crate) fn direction(&self, x: f64, y: f64, aspect: f64) -> Vec3 {
        let forward = (self.target - self.eye).normalize();
        let side = if forward.cross(DVec3::Y).length() < 1e-6 { DVec3::X } else { forward.cross(DVec3::Y).normalize() };
        let up = side.cross(forward);
        let scale = (0.5 * self.fov_degrees.to_radians()).tan();
        (forward + side * (x * scale * aspect) + up * (y * scale)).normalize().as_vec3()
    }
}

/// Centre of each face, and how much it counts.
fn faces_of(part: &BakedPart) -> impl Iterator<Item = (DVec3, f64)> {
    /// What a face that is quite open counts.
    const OPEN: f64 = 0.02;
    let openness = |v: u32| {
        let all =
            part.ao.get(v as usize * part.channels..).and_then(|rest| rest.get(..part.channels)).unwrap_or_default();
        all.iter().map(|&ao| f64::from(ao)).sum::<f64>() / part.channels.max(1) as f64
    };
    part.faces.iter().map(move |face| {
        let center = face.map(|v| part.positions[v as usize]).iter().sum::<DVec3>() / 3.0;
        (center, (1.0 - face.map(openness).iter().sum::<f64>() / 3.0).max(0.0) + OPEN)
    })
}

/// The range of an axis between the third and the last but third hundredth of what counts.
fn middle(faces: &mut [(DVec3, f64)], axis: usize) -> (f64, f64) {
    const TRIM: f64 = 0.03;
    faces.sort_unstable_by(|a, b| a.0[axis].total_cmp(&b.0[axis]));
    let total: f64 = faces.iter().map(|face| face.1).sum();
    let mut before = 0.0;
    let mut range = (faces[0].0[axis], faces[faces.len() - 1].0[axis]);
    for (center, weight) in faces.iter() {
        if before <= TRIM * total {
            range.0 = center[axis];
        }
        before += weight;
        if before >= (1.0 - TRIM) * total {
            range.1 = center[axis];
            break;
        }
    }
    range
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_the_picture_is_the_target() {
        let camera = Camera::parse(&[3.0, 4.0, 5.0, 1.0, 1.0, 1.0]).unwrap();
        let direction = camera.direction(0.0, 0.0, 1.6).as_dvec3();
        assert!(direction.distance((camera.target - camera.eye).normalize()) < 1e-6);
        assert!(camera.direction(0.0, 1.0, 1.6).y > camera.direction(0.0, -1.0, 1.6).y);
        assert!(Camera::parse(&[0.0; 6]).is_err() && Camera::parse(&[1.0; 5]).is_err());
    }
}
