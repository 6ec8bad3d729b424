//! A moving object: the region it is in, and what it is lit by.

use crate::{Pack, TemporalBlend};

/// What an engine keeps for a moving object: the region of the last frame and the coefficients it was shown with.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct MovingObject {
    region: Option<u32>,
    shown: Option<[f32; 4]>,
}

impl MovingObject {
    /// An object that appears: it gets its first value at once.
    pub const fn new() -> Self {
        Self { region: None, shown: None }
    }

    /// An object as an engine kept it: the region that it was in last, and the coefficients that were shown.
    pub const fn resume(region: Option<u32>, shown: Option<[f32; 4]>) -> Self {
        Self { region, shown }
    }

    /// The region that it was in last.
    pub const fn region(&self) -> Option<u32> {
        self.region
    }

    /// The coefficients that were shown last.
    pub const fn coefficients(&self) -> Option<[f32; 4]> {
        self.shown
    }

    /// Moves it to a point, metres relative to the level's origin, `dt_secs` after the last call: finds its region,
    /// evaluates the engine's form of the model there, and blends with what was shown before. Gives linear coefficients
    /// for [`crate::ao_linear`]; none, and no change, where the pack has no regions or the point is not finite. An object
    /// that is put elsewhere at once is a new one: else it fades from one place to the other.
    pub fn update(&mut self, pack: &Pack<'_>, point: [f32; 3], dt_secs: f32, blend: TemporalBlend) -> Option<[f32; 4]> {
        let hit = pack.region_at(point, self.region)?;
        let now = pack.engine_at(hit.region, point)?;
        let shown = self.shown.map_or(now, |previous| blend.blend(previous, now, dt_secs));
        *self = Self { region: Some(hit.region), shown: Some(shown) };
        Some(shown)
    }
}
