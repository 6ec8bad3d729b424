//! A ball that moves through a level, lit by the models of visibility regions as an engine does it: for each frame what its
//! region's model says at its middle, and that blended over time; beside both what is traced there.

mod path;
mod strip;
mod traced;

pub(crate) use path::FlightPath;
pub(crate) use strip::draw;
pub(crate) use traced::BallTracer;

use crate::failure::Failure;
use glam::{DVec3, Vec3};
use kiln_runtime::{Pack, TemporalBlend, ao_quadratic};
use serde::Serialize;

/// Quadratic harmonics.
const HARMONICS: usize = 9;

/// Frames of a second of an engine: what is blended over time is blended so often.
const FRAMES_PER_SEC: f64 = 60.0;

/// AO as a function of the normal: the blend of the half-distances.
pub(crate) type Light = [f32; HARMONICS];

/// What a ball is lit by.
pub(crate) struct Row {
    pub(crate) name: String,
    /// For each picture.
    pub(crate) lights: Vec<Light>,
    /// Greatest change of AO of an upward normal from one frame to the next.
    pub(crate) greatest_step: f32,
}

/// What was found, for machines.
#[derive(Serialize)]
pub(crate) struct FlightReport {
    /// Frames that were gone through.
    pub(crate) frames: usize,
    /// Times that the ball came into another region, by each pack.
    pub(crate) crossings: Vec<usize>,
    pub(crate) rows: Vec<RowReport>,
}

/// A row, for machines.
#[derive(Serialize)]
pub(crate) struct RowReport {
    pub(crate) name: String,
    /// AO of an upward normal in each picture.
    pub(crate) ao_up: Vec<f32>,
    pub(crate) greatest_step: f32,
}

impl From<&Row> for RowReport {
    fn from(row: &Row) -> Self {
        let ao_up = row.lights.iter().map(|light| ao(light, Vec3::Y)).collect();
        Self { name: row.name.clone(), ao_up, greatest_step: row.greatest_step }
    }
}

/// AO of a unit normal.
pub(crate) fn ao(light: &Light, normal: Vec3) -> f32 {
    ao_quadratic(*light, normal.to_array())
}

/// The ball's place in each frame of an engine, and which of them are pictures.
pub(crate) struct Frames {
    pub(crate) places: Vec<DVec3>,
    /// Ascending indices into `places`.
    pub(crate) pictures: Vec<usize>,
}

impl Frames {
    pub(crate) fn of(path: &FlightPath) -> Self {
        let seconds = path.length_m() / path.speed_m_per_s;
        let count = ((seconds * FRAMES_PER_SEC).ceil() as usize).max(path.pictures);
        let along = |frame: usize| path.at(path.length_m() * frame as f64 / (count - 1).max(1) as f64);
        let picture = |index: usize| index * (count - 1) / (path.pictures - 1).max(1);
        Self { places: (0..count).map(along).collect(), pictures: (0..path.pictures).map(picture).collect() }
    }

    /// A row from what the ball is lit by in each frame.
    fn row(&self, name: String, lights: &[Light]) -> Row {
        let up = |light: &Light| ao(light, Vec3::Y);
        let greatest_step = lights.windows(2).map(|two| (up(&two[1]) - up(&two[0])).abs()).fold(0.0, f32::max);
        Row { name, lights: self.pictures.iter().map(|frame| lights[*frame]).collect(), greatest_step }
    }

    /// What is traced in each frame; the greatest change is between pictures, for the frames between are not traced.
    pub(crate) fn traced(&self, tracer: &BallTracer) -> Result<Row, Failure> {
        let places: Vec<DVec3> = self.pictures.iter().map(|frame| self.places[*frame]).collect();
        let lights = tracer.lights(&places)?;
        let all = Self { places, pictures: (0..lights.len()).collect() };
        Ok(all.row("traced (changes from picture to picture)".to_owned(), &lights))
    }

    /// What the models of a pack say, without and with blending over time, and how often the region changes.
    pub(crate) fn modelled(&self, pack: &Pack<'_>, name: &str) -> Result<([Row; 2], usize), Failure> {
        let (mut now, mut shown) = (Vec::new(), Vec::new());
        let (mut region, mut crossings) = (None, 0);
        let blend = TemporalBlend::default();
        let step_secs = (1.0 / FRAMES_PER_SEC) as f32;
        for place in &self.places {
            let point = pack.meta().local(place.to_array());
            let hit = pack.region_at(point, region);
            let light = hit.and_then(|hit| light(pack, hit.region, point)).ok_or_else(|| {
                Failure::refused(format!("{name} has no models of visibility regions; bake a level that has regions"))
            })?;
            let found = hit.map(|hit| hit.region);
            crossings += usize::from(region.is_some() && region != found);
            region = found;
            now.push(light);
            shown.push(shown.last().map_or(light, |before| blend.blend(*before, light, step_secs)));
        }
        let rows = [self.row(format!("{name}: models"), &now), self.row(format!("{name}: blended over time"), &shown)];
        Ok((rows, crossings))
    }
}

/// The blend of the channels.
fn light(pack: &Pack<'_>, region: u32, point: [f32; 3]) -> Option<Light> {
    let mut light = [0.0; HARMONICS];
    for (channel, weight) in pack.meta().blend().iter().enumerate() {
        let of_channel = pack.full_at(region, point, channel)?;
        light.iter_mut().zip(of_channel).for_each(|(sum, value)| *sum += weight * value);
    }
    Some(light)
}
