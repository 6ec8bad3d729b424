//! `kiln compare`: how far two baked files of one level are apart, over the surface that can be seen.

use crate::{
    args::{Common, CompareArgs},
    difference::Difference,
    failure::{Failure, GATE},
    source::read_baked,
    visibility::visible_parts,
};
use kiln_scene::{BakedPart, BakedScene};
use serde::Serialize;
use std::path::Path;

pub(crate) fn run(args: &CompareArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let (a, b) = (read_baked(&args.a)?, read_baked(&args.b)?);
    let mut pairs = pairs(&a, &b, &args.a, &args.b)?;
    if !args.all_area {
        find_visible(&a, &mut pairs)?;
    }
    let comparison = Comparison::new(&pairs);
    if common.json {
        print_json(&comparison);
    } else {
        print_table(&comparison);
    }
    let worst = comparison.shown().iter().map(|d| d.rmse).fold(0.0, f64::max);
    match args.fail_above {
        Some(limit) if worst > limit => {
            let over = if args.all_area { "all area" } else { "what can be seen" };
            Err(Failure::new(GATE, format!("the RMSE over {over} is {worst:.5}, above the limit of {limit}")))
        }
        _ => Ok(()),
    }
}

/// A pair of parts that have the same faces.
struct Pair<'a> {
    a: &'a BakedPart,
    b: &'a BakedPart,
    channels: usize,
    areas: Vec<f64>,
    /// Area of each face that can be seen, if it is known.
    visible_areas: Option<Vec<f64>>,
}

impl<'a> Pair<'a> {
    fn new(a: &'a BakedPart, b: &'a BakedPart) -> Self {
        let area = |face: &[u32; 3]| {
            let [p, q, r] = face.map(|v| a.positions[v as usize]);
            0.5 * (q - p).cross(r - p).length()
        };
        let areas = a.faces.iter().map(area).collect();
        Self { a, b, channels: a.channels.min(b.channels), areas, visible_areas: None }
    }

    /// Differences at the corners of each face.
    fn corners(&self, channel: usize) -> impl Iterator<Item = [f64; 3]> {
        let value = move |part: &BakedPart, v: u32| f64::from(part.ao[v as usize * part.channels + channel]);
        let has = channel < self.channels;
        let faces = self.a.faces.iter().filter(move |_| has);
        faces.map(move |face| face.map(|v| value(self.a, v) - value(self.b, v)))
    }

    /// Area and differences of each face.
    fn faces(&self, channel: usize) -> impl Iterator<Item = (f64, [f64; 3])> {
        self.areas.iter().copied().zip(self.corners(channel))
    }

    /// The same by the area that can be seen, of faces of which something can be.
    fn visible_faces(&self, channel: usize) -> impl Iterator<Item = (f64, [f64; 3])> {
        let areas = self.visible_areas.iter().flatten().copied();
        areas.zip(self.corners(channel)).filter(|(area, _)| *area > 0.0)
    }
}

fn pairs<'a>(a: &'a BakedScene, b: &'a BakedScene, first: &Path, second: &Path) -> Result<Vec<Pair<'a>>, Failure> {
    let (first, second) = (first.display(), second.display());
    let baked = |scene: &'a BakedScene| scene.parts.iter().filter(|part| part.channels > 0);
    let (count_a, count_b) = (baked(a).count(), baked(b).count());
    if count_a == 0 || count_b == 0 {
        let empty = if count_a == 0 { &first } else { &second };
        return Err(Failure::refused(format!("{empty} has no `_AO`; bake it with kiln bake, --attribute ao or both")));
    }
    if count_a != count_b {
        let message =
            format!("{first} has {count_a} baked primitives, {second} has {count_b}: they are different levels");
        return Err(Failure::refused(message));
    }
    let pair = |(a, b): (&'a BakedPart, &'a BakedPart)| {
        if a.faces != b.faces || a.positions.len() != b.positions.len() {
            let message = format!(
                "node {} ({}) has other faces in {first} than in {second}: they are different levels",
                a.node, a.mesh
            );
            return Err(Failure::refused(message));
        }
        Ok(Pair::new(a, b))
    };
    baked(a).zip(baked(b)).map(pair).collect()
}

/// Finds the area that can be seen, in the scene whose baked parts the pairs have as their first.
fn find_visible(scene: &BakedScene, pairs: &mut [Pair<'_>]) -> Result<(), Failure> {
    let visible = visible_parts(scene)?;
    let baked = scene.parts.iter().zip(&visible).filter(|(part, _)| part.channels > 0);
    for (pair, (_, visible)) in pairs.iter_mut().zip(baked) {
        pair.visible_areas = Some(pair.areas.iter().zip(visible).map(|(area, visible)| area * visible).collect());
    }
    Ok(())
}

/// Differences of a whole level or of a part of it. `channels` and `area_m2` are over all area.
#[derive(Serialize)]
struct Differences {
    area_m2: f64,
    channels: Vec<Difference>,
    visible_area_m2: Option<f64>,
    visible_channels: Option<Vec<Difference>>,
}

impl Differences {
    fn of(pairs: &[&Pair<'_>]) -> Self {
        let channels = pairs.iter().map(|pair| pair.channels).max().unwrap_or(0);
        let all = |c: usize| Difference::over(pairs.iter().flat_map(|pair| pair.faces(c)));
        let seen = |c: usize| Difference::over(pairs.iter().flat_map(|pair| pair.visible_faces(c)));
        let is_known = pairs.iter().any(|pair| pair.visible_areas.is_some());
        Self {
            area_m2: pairs.iter().flat_map(|pair| &pair.areas).sum(),
            channels: (0..channels).map(all).collect(),
            visible_area_m2: is_known.then(|| pairs.iter().flat_map(|pair| &pair.visible_areas).flatten().sum()),
            visible_channels: is_known.then(|| (0..channels).map(seen).collect()),
        }
    }

    /// Those over what can be seen, or over all where that is not known.
    fn shown(&self) -> &[Difference] {
        self.visible_channels.as_ref().unwrap_or(&self.channels)
    }
}

#[derive(Serialize)]
struct PartDifferences {
    node: String,
    mesh: String,
    #[serde(flatten)]
    differences: Differences,
}

struct Comparison {
    total: Differences,
    parts: Vec<PartDifferences>,
}

impl Comparison {
    fn new(pairs: &[Pair<'_>]) -> Self {
        let part = |pair: &Pair<'_>| PartDifferences {
            node: pair.a.node.clone(),
            mesh: pair.a.mesh.clone(),
            differences: Differences::of(&[pair]),
        };
        let all: Vec<&Pair<'_>> = pairs.iter().collect();
        Self { total: Differences::of(&all), parts: pairs.iter().map(part).collect() }
    }

    fn shown(&self) -> &[Difference] {
        self.total.shown()
    }
}

/// `total` is over all area, as it has always been; `visible` over what can be seen.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print_json(comparison: &Comparison) {
    let Comparison { total, parts } = comparison;
    let visible = total.visible_channels.as_ref();
    let visible = visible.map(|total| serde_json::json!({ "total": total }));
    println!(
        "{}",
        serde_json::json!({
            "total": total.channels, "area_m2": total.area_m2,
            "visible": visible, "visible_area_m2": total.visible_area_m2,
            "meshes": parts,
        })
    );
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print_table(comparison: &Comparison) {
    /// Parts shown: those that differ most.
    const SHOWN: usize = 12;
    let Comparison { total, parts } = comparison;
    match total.visible_area_m2 {
        Some(visible) if total.area_m2 > 0.0 => {
            let percent = 100.0 * visible / total.area_m2;
            println!("over the {percent:.1} % of the area that can be seen; last, the RMSE over all area");
        }
        _ => println!("over all area, also what is hidden in other geometry"),
    }
    println!(
        "{:40} {:>2} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9}",
        "", "#", "RMSE", "p50", "p99", "max", "bias", "all area"
    );
    let rows = |name: &str, differences: &Differences| {
        let name: String = name.chars().take(40).collect();
        for (channel, (d, all)) in differences.shown().iter().zip(&differences.channels).enumerate() {
            let Difference { rmse, p50, p99, max, bias } = d;
            println!("{name:40} {channel:>2} {rmse:9.5} {p50:9.5} {p99:9.5} {max:9.5} {bias:+9.5} {:9.5}", all.rmse);
        }
    };
    let mut sorted: Vec<&PartDifferences> = parts.iter().collect();
    let worst = |part: &PartDifferences| part.differences.shown().iter().map(|d| d.rmse).fold(0.0, f64::max);
    sorted.sort_by(|x, y| worst(y).total_cmp(&worst(x)));
    if sorted.len() > 1 {
        sorted.iter().take(SHOWN).for_each(|part| rows(&part.node, &part.differences));
        if sorted.len() > SHOWN {
            println!("… and {} more; --json lists them all", sorted.len() - SHOWN);
        }
    }
    rows("total", total);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::tests::{boxed, scene};
    use glam::DVec3;

    /// A box with another in it, whose values differ from what `boxed` has.
    fn nested(outer: f32, inner: f32) -> BakedScene {
        let mut parts = vec![boxed(-DVec3::ONE, DVec3::ONE), boxed(DVec3::splat(-0.5), DVec3::splat(0.5))];
        parts[0].ao.fill(outer);
        parts[1].ao.fill(inner);
        scene(parts)
    }

    fn compared(a: &BakedScene, b: &BakedScene) -> Comparison {
        let mut pairs = pairs(a, b, Path::new("a.glb"), Path::new("b.glb")).map_err(|_| ()).unwrap();
        find_visible(a, &mut pairs).map_err(|_| ()).unwrap();
        Comparison::new(&pairs)
    }

    #[test]
    fn what_is_hidden_does_not_count_unless_asked() {
        let buried = compared(&nested(0.5, 0.5), &nested(0.5, 0.9));
        assert_eq!((buried.shown()[0].rmse, buried.shown()[0].max), (0.0, 0.0));
        // Over all: a fifth of the area differs by .4.
        assert!((buried.total.channels[0].rmse - (0.16f64 / 5.0).sqrt()).abs() < 1e-7);
        assert_eq!((buried.total.area_m2, buried.total.visible_area_m2), (30.0, Some(24.0)));
        assert_eq!(buried.parts[1].differences.visible_area_m2, Some(0.0));
        let seen = compared(&nested(0.5, 0.5), &nested(0.75, 0.5));
        assert!((seen.shown()[0].rmse - 0.25).abs() < 1e-12 && (seen.shown()[0].bias + 0.25).abs() < 1e-12);
    }
}
