//! Options of the commands that look at levels and results.

use super::bake::{FoliageChoice, HalfDistances, SettingsArgs};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Reads and validates a level; prints what would be baked, every warning, and an estimate of time and memory.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  kiln check level.glb\n  kiln check level.glb --quality high --json")]
pub(crate) struct CheckArgs {
    /// The level: .glb or .gltf
    pub(crate) level: PathBuf,
    #[command(flatten)]
    pub(crate) settings: SettingsArgs,
}

/// Compares two baked files of one level: area-weighted RMSE, p50, p99, max, per mesh and in total, over what can be seen.
#[derive(Args, Debug)]
#[command(
    after_help = "Examples:\n  kiln compare baked.glb reference.glb\n  kiln compare a.glb b.glb --fail-above 0.006\n
Hidden area, whose values nobody sees, is found by tracing the first file; --all-area counts it too, as --json does in `total`"
)]
pub(crate) struct CompareArgs {
    /// A baked file
    pub(crate) a: PathBuf,
    /// Another, of the same level
    pub(crate) b: PathBuf,
    /// Exit with code 4 if the RMSE of any half-distance is above this
    #[arg(long, value_name = "X")]
    pub(crate) fail_above: Option<f64>,
    /// Weigh all area alike, also what is hidden in other geometry
    #[arg(long)]
    pub(crate) all_area: bool,
}

/// AO at given points and normals, for spot checks against other tools.
#[derive(Args, Debug)]
#[command(after_help = "Examples:
  kiln probe level.glb --points points.json --half-distance 2,300 --rays 4096 --json
  kiln probe level.glb --points points.json --pack baked.kiln
points.json: {\"points\": [{\"position\": [x, y, z], \"normal\": [x, y, z]}]}, metres in world space, moved off the surface;
\"geometric_normal\": [x, y, z] beside them leaves out directions below the surface. `kiln bench accuracy --points-out` writes such files")]
pub(crate) struct ProbeArgs {
    /// The level: .glb or .gltf
    pub(crate) level: PathBuf,
    /// The points
    #[arg(long, value_name = "P.json")]
    pub(crate) points: PathBuf,
    /// Say what the models of visibility regions in a pack say, too; the half-distances are the pack's
    #[arg(long, value_name = "P.kiln")]
    pub(crate) pack: Option<PathBuf>,
    /// Rays per point, rounded up to a power of two
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(1..=1 << 24))]
    pub(crate) rays: u32,
    /// Half-distances in metres, or `auto`
    #[arg(long, value_name = "D1,D2…", default_value = "auto")]
    pub(crate) half_distance: HalfDistances,
    /// What trees and shrubs do to rays
    #[arg(long, value_enum, default_value_t)]
    pub(crate) foliage: FoliageChoice,
    /// The sidecar [default: LEVEL.kiln.toml beside the level]
    #[arg(long = "level", value_name = "SIDE.toml")]
    pub(crate) sidecar: Option<PathBuf>,
    /// Another seed gives other directions
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) seed: u32,
}

/// What a picture shows in place of the AO.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum OverlayChoice {
    /// Where the mesh is too coarse for its shadows; needs a file baked with --residual.
    Residual,
}

/// Makes a picture of the AO in a baked file.
#[derive(Args, Debug)]
#[command(after_help = "Examples:
  kiln view baked.glb -o picture.png
  kiln view baked.glb -o both.png --side-by-side reference.glb
  kiln view baked.glb -o coarse.png --overlay residual
  kiln view baked.glb -o near.png --camera 4,2,6,0,1,0
  kiln view baked.glb -o strip.png --fly path.json --pack baked.kiln --pack unsmoothed.kiln")]
pub(crate) struct ViewArgs {
    /// The baked file
    pub(crate) baked: PathBuf,
    /// Where to write the picture
    #[arg(short, long, value_name = "P.png")]
    pub(crate) output: PathBuf,
    /// Eye and target in metres, and the vertical field of view in degrees: `X,Y,Z,TX,TY,TZ[,FOV]`
    #[arg(long, value_name = "CAMERA", value_delimiter = ',', num_args = 1, allow_hyphen_values = true)]
    pub(crate) camera: Option<Vec<f64>>,
    /// A second baked file to put on the right
    #[arg(long, value_name = "REF.glb")]
    pub(crate) side_by_side: Option<PathBuf>,
    /// Show something else in place of the AO
    #[arg(long, value_enum)]
    pub(crate) overlay: Option<OverlayChoice>,
    /// Show one half-distance, by number from 0 [default: the blend, or the greatest residual]
    #[arg(long, value_name = "N")]
    pub(crate) channel: Option<usize>,
    /// Draw a ball that moves through the level, lit by the models of visibility regions in packs: a strip of pictures, a row
    /// for what is traced, and for each pack one without and one with blending over time. The path: `{"points": [[x, y, z], …],
    /// "speed_m_per_s": 2, "radius_m": 0.3, "pictures": 8, "camera_m": 4}`
    #[arg(long, value_name = "PATH.json", requires = "pack", conflicts_with_all = ["camera", "side_by_side", "overlay"])]
    pub(crate) fly: Option<PathBuf>,
    /// With --fly: a pack with models; may be given again, to compare
    #[arg(long, value_name = "P.kiln", requires = "fly")]
    pub(crate) pack: Vec<PathBuf>,
    /// Width and height of the picture, pixels [default: 1280x800; with --fly each one's, 320x240]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub(crate) size: Option<[u32; 2]>,
}

/// Measures Kiln: error against time and rays, the tracer and the solver beside others.
#[derive(Args, Debug)]
pub(crate) struct BenchArgs {
    #[command(subcommand)]
    pub(crate) bench: kiln_bench::Bench,
}

/// Makes an example level by code.
#[derive(Args, Debug)]
#[command(
    after_help = "Examples:\n  kiln example courtyard -o courtyard.glb\n  kiln example lods --from level.glb -o lods.glb\n  kiln example --list"
)]
pub(crate) struct ExampleArgs {
    /// Which example
    #[arg(required_unless_present = "list")]
    pub(crate) name: Option<String>,
    /// Where to write it
    #[arg(short, long, value_name = "X.glb", required_unless_present = "list")]
    pub(crate) output: Option<PathBuf>,
    /// The level that `lods` makes lower levels of detail for; the courtyard if none is given
    #[arg(long, value_name = "LEVEL.glb")]
    pub(crate) from: Option<PathBuf>,
    /// List the examples
    #[arg(long)]
    pub(crate) list: bool,
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let parts: Vec<u32> = text.split('x').filter_map(|part| part.parse().ok()).collect();
    match parts[..] {
        [w, h] if (16..=8192).contains(&w) && (16..=8192).contains(&h) => Ok([w, h]),
        _ => Err("write WIDTHxHEIGHT, each from 16 to 8192".into()),
    }
}
