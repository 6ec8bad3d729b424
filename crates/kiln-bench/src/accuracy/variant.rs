//! What is measured: ways to bake, by family.

use super::settings::{GOALS, Goal};
use std::{collections::BTreeSet, fmt, str::FromStr};

/// A way to bake, without its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Family {
    /// Kiln as it bakes, adaptively: the qualities, and other targets.
    Kiln,
    /// Kiln with fixed numbers of samples per face and rays per sample.
    Fixed,
    /// The same positions, with independent random directions.
    Random,
    /// AO at the vertices.
    Vertices,
    /// Averages of the samples of `Fixed` around each vertex.
    Average,
    /// Least squares on the samples of `Fixed` with α = 0.
    Alpha0,
    /// Least squares on the samples of `Fixed` with α = 1.
    Alpha1,
}

impl Family {
    /// All, in the order of tables.
    pub(super) const ALL: [Self; 7] =
        [Self::Kiln, Self::Fixed, Self::Random, Self::Vertices, Self::Average, Self::Alpha0, Self::Alpha1];

    /// The name on the command line.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Kiln => "kiln",
            Self::Fixed => "fixed",
            Self::Random => "random",
            Self::Vertices => "vertices",
            Self::Average => "average",
            Self::Alpha0 => "alpha0",
            Self::Alpha1 => "alpha1",
        }
    }

    /// What it is, for tables and legends.
    pub(super) const fn title(self) -> &'static str {
        match self {
            Self::Kiln => "Kiln, adaptive",
            Self::Fixed => "fixed counts",
            Self::Random => "random directions",
            Self::Vertices => "AO at vertices",
            Self::Average => "area average",
            Self::Alpha0 => "least squares, α = 0",
            Self::Alpha1 => "least squares, α = 1",
        }
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Family {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|family| family.name() == text)
            .ok_or_else(|| format!("{text:?} is none of {}", names()))
    }
}

/// One way to sample. What is done with the samples may be several ways to bake.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Method {
    /// Kiln as it bakes.
    Adaptive(Goal),
    /// Fixed counts.
    Fixed { samples: u32, rays: u32 },
    /// Fixed counts, random directions.
    Random { samples: u32, rays: u32 },
    /// Rays at each vertex.
    Vertices { rays: u32 },
}

impl Method {
    /// The family of its main way to bake.
    pub(super) fn family(&self) -> Family {
        match self {
            Self::Adaptive(_) => Family::Kiln,
            Self::Fixed { .. } => Family::Fixed,
            Self::Random { .. } => Family::Random,
            Self::Vertices { .. } => Family::Vertices,
        }
    }

    /// The row's label in tables.
    pub(super) fn label(&self) -> String {
        match self {
            Self::Adaptive(goal) => goal.label(),
            Self::Fixed { samples, rays } | Self::Random { samples, rays } => format!("{samples} × {rays}"),
            Self::Vertices { rays } => format!("{rays} rays"),
        }
    }

    /// Rays per face that it is expected to take, where it is known beforehand.
    fn rays_per_face(&self) -> Option<u64> {
        match *self {
            Self::Fixed { samples, rays } | Self::Random { samples, rays } => {
                Some(u64::from(samples) * u64::from(rays))
            }
            // A closed mesh has half as many vertices as faces, a soup three times as many.
            Self::Vertices { rays } => Some(u64::from(rays)),
            Self::Adaptive(_) => None,
        }
    }
}

/// Samples per face that are tried; the least is 2, since each of the two halves has one.
const SAMPLES: [u32; 4] = [2, 4, 16, 64];
/// Rays per sample that are tried.
const RAYS: [u32; 4] = [16, 64, 256, 1024];
/// Random directions are tried with this many samples per face.
const RANDOM_SAMPLES: u32 = 4;

/// The methods of the chosen families that take at most `most_rays` on `faces` faces; and the labels of the others.
pub(super) fn methods(families: &BTreeSet<Family>, faces: u64, most_rays: u64) -> (Vec<Method>, Vec<String>) {
    let on_fixed = [Family::Fixed, Family::Average, Family::Alpha0, Family::Alpha1];
    let mut all = Vec::new();
    if families.contains(&Family::Kiln) {
        all.extend(GOALS.map(Method::Adaptive));
    }
    if on_fixed.iter().any(|family| families.contains(family)) {
        all.extend(SAMPLES.into_iter().flat_map(|samples| RAYS.map(|rays| Method::Fixed { samples, rays })));
    }
    if families.contains(&Family::Random) {
        all.extend(RAYS.map(|rays| Method::Random { samples: RANDOM_SAMPLES, rays }));
    }
    if families.contains(&Family::Vertices) {
        all.extend(RAYS.map(|rays| Method::Vertices { rays }));
    }
    let fits = |method: &Method| method.rays_per_face().is_none_or(|rays| rays * faces <= most_rays);
    let (kept, left_out): (Vec<_>, Vec<_>) = all.into_iter().partition(fits);
    (kept, left_out.iter().map(|method| format!("{} {}", method.family(), method.label())).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_back() {
        for family in Family::ALL {
            assert_eq!(family.name().parse(), Ok(family));
        }
        assert!("adaptive".parse::<Family>().unwrap_err().contains("kiln, fixed"));
    }

    #[test]
    fn what_would_take_too_many_rays_is_left_out_by_name() {
        let families = BTreeSet::from([Family::Average]);
        let (kept, left_out) = methods(&families, 1000, 1_100_000);
        assert_eq!(kept.len() + left_out.len(), 16);
        assert!(kept.contains(&Method::Fixed { samples: 4, rays: 256 }));
        assert!(left_out.contains(&"fixed 64 × 1024".to_owned()) && !left_out.contains(&"fixed 4 × 256".to_owned()));
    }
}
