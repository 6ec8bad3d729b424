//! The path of a flight, from JSON.

use crate::failure::Failure;
use anyhow::Context;
use glam::DVec3;
use serde::Deserialize;
use std::{fs, path::Path};

/// Pictures of a strip, at most.
const MOST_PICTURES: usize = 64;

/// Frames of a flight, at most: an hour of them.
const LONGEST_SECS: f64 = 3600.0;

/// Where a ball goes.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(crate) struct FlightPath {
    /// Corners of the way, world space, metres.
    points: Vec<[f64; 3]>,
    /// How fast, metres a second.
    #[serde(default = "walking")]
    pub(crate) speed_m_per_s: f64,
    /// The ball's radius, metres.
    #[serde(default = "small")]
    pub(crate) radius_m: f64,
    /// How many pictures of it are made.
    #[serde(default = "few")]
    pub(crate) pictures: usize,
    /// How far the camera is from it, metres.
    #[serde(default = "near")]
    pub(crate) camera_m: f64,
}

const fn walking() -> f64 {
    2.0
}

const fn small() -> f64 {
    0.3
}

const fn few() -> usize {
    8
}

const fn near() -> f64 {
    4.0
}

impl FlightPath {
    pub(crate) fn read(path: &Path) -> Result<Self, Failure> {
        let context = || format!("{} cannot be read", path.display());
        let text = fs::read_to_string(path).with_context(context)?;
        Self::parse(&text).map_err(|problem| {
            let form =
                r#"{"points": [[x, y, z], …], "speed_m_per_s": 2, "radius_m": 0.3, "pictures": 8, "camera_m": 4}"#;
            Failure::refused(format!("{}: {problem}; a flight is {form}", path.display()))
        })
    }

    fn parse(text: &str) -> Result<Self, String> {
        let path: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        let lengths = [path.speed_m_per_s, path.radius_m, path.camera_m];
        let is_good = |length: &f64| length.is_finite() && *length > 0.0;
        if !lengths.iter().all(is_good) {
            return Err("speed, radius and the camera's distance must be positive".to_owned());
        }
        if !(2..=MOST_PICTURES).contains(&path.pictures) {
            return Err(format!("{} pictures; choose 2 to {MOST_PICTURES}", path.pictures));
        }
        if path.points.len() < 2 || !path.points.iter().flatten().all(|x| x.is_finite()) {
            return Err("a way has two points or more, all finite".to_owned());
        }
        let seconds = path.length_m() / path.speed_m_per_s;
        if !(seconds > 0.0 && seconds <= LONGEST_SECS) {
            return Err(format!("it takes {seconds} s; it must take some time, and at most {LONGEST_SECS} s"));
        }
        Ok(path)
    }

    fn legs(&self) -> impl Iterator<Item = [DVec3; 2]> + '_ {
        self.points.windows(2).map(|two| [DVec3::from_array(two[0]), DVec3::from_array(two[1])])
    }

    /// Length of the way, metres.
    pub(crate) fn length_m(&self) -> f64 {
        self.legs().map(|[from, to]| from.distance(to)).sum()
    }

    /// The place so far along the way; its end from there on.
    pub(crate) fn at(&self, mut distance_m: f64) -> DVec3 {
        for [from, to] in self.legs() {
            let length = from.distance(to);
            if distance_m <= length && length > 0.0 {
                return from.lerp(to, distance_m / length);
            }
            distance_m -= length;
        }
        self.points.last().map_or(DVec3::ZERO, |point| DVec3::from_array(*point))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_goes_through_its_corners() {
        let path = FlightPath::parse(r#"{"points": [[0, 0, 0], [3, 0, 0], [3, 0, 0], [3, 4, 0]]}"#).unwrap();
        assert_eq!((path.length_m(), path.pictures), (7.0, 8));
        assert_eq!(path.at(0.0), DVec3::ZERO);
        assert_eq!((path.at(3.0), path.at(5.0)), (DVec3::X * 3.0, DVec3::new(3.0, 2.0, 0.0)));
        assert_eq!((path.at(7.0), path.at(9.0)), (DVec3::new(3.0, 4.0, 0.0), DVec3::new(3.0, 4.0, 0.0)));
    }

    #[test]
    fn bad_ways_are_refused() {
        let refused = |text: &str| FlightPath::parse(text).unwrap_err();
        assert!(refused(r#"{"points": [[0, 0, 0]]}"#).contains("two points"));
        assert!(refused(r#"{"points": [[0, 0, 0], [0, 0, 0]]}"#).contains("takes 0 s"));
        assert!(refused(r#"{"points": [[0, 0, 0], [1, 0, 0]], "pictures": 1}"#).contains("1 pictures"));
        assert!(refused(r#"{"points": [[0, 0, 0], [1, 0, 0]], "radius_m": 0}"#).contains("positive"));
        assert!(refused(r#"{"points": [[0, 0, 0], [1, 0, 0]], "speed": 1}"#).contains("speed"));
        assert!(refused(r#"{"points": [[0, 0, 0], [1e9, 0, 0]]}"#).contains("at most"));
    }
}
