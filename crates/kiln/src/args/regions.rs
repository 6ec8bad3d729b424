//! Options of `kiln regions`.

use clap::Args;
use kiln_bake::regions::MakeSettings;
use std::path::PathBuf;

/// Makes visibility regions for a level that has none: boxes of free space in which moving objects are lit.
#[derive(Args, Debug)]
#[command(after_help = "Examples:
  kiln regions level.glb -o level.kiln.toml
  kiln regions level.glb -o level.kiln.toml --cell 0.25 --max-regions 500
  kiln regions cave.glb -o cave.kiln.toml --seed-point 0,1,4

A sidecar that the level has is kept as it is, and the regions are added to it. Without --seed-point all spaces are taken that
have ground and see few backs of faces. Rays are traced on the CPU, whatever the backend, so that the result is the same everywhere")]
pub(crate) struct RegionsArgs {
    /// The level: .glb or .gltf
    pub(crate) level: PathBuf,
    /// Where to write the sidecar
    #[arg(short, long, value_name = "SIDE.toml")]
    pub(crate) output: PathBuf,
    /// The sidecar that is continued [default: LEVEL.kiln.toml beside the level]
    #[arg(long = "level", value_name = "SIDE.toml")]
    pub(crate) sidecar: Option<PathBuf>,
    /// Edge of the cells that space is cut into, metres [default: by the size of the level, at most 0.5 if it is not too large]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    pub(crate) cell: Option<f64>,
    /// A point in a space to be filled, world space, metres; may be given several times
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub(crate) seed_point: Vec<[f64; 3]>,
    /// How far above the ground regions reach under the open sky, metres [default: 10, or a fifth of a smaller level]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    pub(crate) height: Option<f64>,
    /// Longest edge of a region, metres [default: 16, or half of a smaller level, or 32 cells if that is more]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    pub(crate) max_edge: Option<f64>,
    /// Leave out spaces with less volume, cubic metres [default: 27 cells]
    #[arg(long, value_name = "M3", value_parser = positive)]
    pub(crate) min_volume: Option<f64>,
    /// The most regions; where more are needed, those that fit worst stay coarse
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) max_regions: u32,
}

impl RegionsArgs {
    /// What regions are made by, but for the seeds, which are in world space.
    pub(crate) fn settings(&self) -> MakeSettings {
        MakeSettings {
            cell_m: self.cell,
            height_m: self.height,
            max_edge_m: self.max_edge,
            min_volume_m3: self.min_volume,
            max_regions: self.max_regions as usize,
            ..MakeSettings::default()
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "give a positive number".to_owned())
}

fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    let numbers = numbers.filter(|numbers| numbers.iter().all(|number| number.is_finite()));
    numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| "write three numbers as X,Y,Z".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_lengths() {
        assert_eq!(point("1,-2.5, 3e1"), Ok([1.0, -2.5, 30.0]));
        assert!(["1,2", "1,2,3,4", "1,2,x", "1,2,inf", ""].iter().all(|text| point(text).is_err()));
        assert_eq!(positive("0.25"), Ok(0.25));
        assert!(["0", "-1", "nan", "inf", "x"].iter().all(|text| positive(text).is_err()));
    }
}
