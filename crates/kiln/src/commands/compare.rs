//! `kiln compare`: how far two baked files of one level are apart, over the surface.

use crate::{
    args::{Common, CompareArgs},
    failure::{Failure, GATE},
    source::read_baked,
};
use kiln_scene::{BakedPart, BakedScene};
use serde::Serialize;
use std::path::Path;

/// Difference of one half-distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Difference {
    rmse: f64,
    p50: f64,
    p99: f64,
    max: f64,
    bias: f64,
}

#[derive(Serialize)]
struct PartDifference {
    node: String,
    mesh: String,
    area_m2: f64,
    channels: Vec<Difference>,
}

pub(crate) fn run(args: &CompareArgs, common: &Common) -> Result<(), Failure> {
    let (a, b) = (read_baked(&args.a)?, read_baked(&args.b)?);
    let parts = compare(&a, &b, &args.a, &args.b)?;
    let channels = parts.iter().map(|p| p.channels).max().unwrap_or(0);
    let total: Vec<Difference> = (0..channels).map(|c| difference(parts.iter().flat_map(|p| p.faces(c)))).collect();
    if common.json {
        print_json(&total, &parts);
    } else {
        print_table(&total, &parts);
    }
    let worst = total.iter().map(|d| d.rmse).fold(0.0, f64::max);
    match args.fail_above {
        Some(limit) if worst > limit => {
            Err(Failure::new(GATE, format!("the RMSE is {worst:.5}, above the limit of {limit}")))
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
}

impl<'a> Pair<'a> {
    fn new(a: &'a BakedPart, b: &'a BakedPart) -> Self {
        let area = |face: &[u32; 3]| {
            let [p, q, r] = face.map(|v| a.positions[v as usize]);
            0.5 * (q - p).cross(r - p).length()
        };
        Self { a, b, channels: a.channels.min(b.channels), areas: a.faces.iter().map(area).collect() }
    }

    /// Area and differences at the corners of each face.
    fn faces(&self, channel: usize) -> impl Iterator<Item = (f64, [f64; 3])> {
        let has = channel < self.channels;
        let value = move |part: &BakedPart, v: u32| f64::from(part.ao[v as usize * part.channels + channel]);
        let corners = move |face: &[u32; 3]| face.map(|v| value(self.a, v) - value(self.b, v));
        self.a.faces.iter().zip(&self.areas).filter(move |_| has).map(move |(face, &area)| (area, corners(face)))
    }
}

fn compare<'a>(a: &'a BakedScene, b: &'a BakedScene, first: &Path, second: &Path) -> Result<Vec<Pair<'a>>, Failure> {
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

/// Statistics of a piecewise linear difference over the surface. RMSE and bias are exact integrals; quantiles give a
/// third of each face's area to each of its corners.
fn difference(faces: impl Iterator<Item = (f64, [f64; 3])>) -> Difference {
    let (mut area, mut squares, mut sum) = (0.0, 0.0, 0.0);
    let mut weighted = Vec::new();
    for (face_area, d) in faces {
        let [p, q, r] = d;
        area += face_area;
        squares += face_area / 6.0 * (p * p + q * q + r * r + p * q + q * r + r * p);
        sum += face_area / 3.0 * (p + q + r);
        weighted.extend(d.map(|d| (d.abs(), face_area / 3.0)));
    }
    weighted.sort_unstable_by(|x, y| x.0.total_cmp(&y.0));
    let quantile = |fraction: f64| {
        let mut before = 0.0;
        let reached = |&&(_, weight): &&(f64, f64)| {
            before += weight;
            before >= fraction * area
        };
        weighted.iter().find(reached).or(weighted.last()).map_or(0.0, |&(d, _)| d)
    };
    let (p50, p99) = (quantile(0.5), quantile(0.99));
    let max = weighted.last().map_or(0.0, |&(d, _)| d);
    let mean = |x: f64| if area > 0.0 { x / area } else { 0.0 };
    Difference { rmse: mean(squares).sqrt(), p50, p99, max, bias: mean(sum) }
}

fn part_differences(parts: &[Pair<'_>]) -> Vec<PartDifference> {
    let one = |pair: &Pair<'_>| PartDifference {
        node: pair.a.node.clone(),
        mesh: pair.a.mesh.clone(),
        area_m2: pair.areas.iter().sum(),
        channels: (0..pair.channels).map(|c| difference(pair.faces(c))).collect(),
    };
    parts.iter().map(one).collect()
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print_json(total: &[Difference], parts: &[Pair<'_>]) {
    println!("{}", serde_json::json!({ "total": total, "meshes": part_differences(parts) }));
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print_table(total: &[Difference], parts: &[Pair<'_>]) {
    /// Parts shown: those that differ most.
    const SHOWN: usize = 12;
    println!("{:40} {:>2} {:>9} {:>9} {:>9} {:>9} {:>9}", "", "#", "RMSE", "p50", "p99", "max", "bias");
    let row = |name: &str, channel: usize, d: &Difference| {
        let name: String = name.chars().take(40).collect();
        println!("{name:40} {channel:>2} {:9.5} {:9.5} {:9.5} {:9.5} {:+9.5}", d.rmse, d.p50, d.p99, d.max, d.bias);
    };
    let mut all = part_differences(parts);
    let worst = |part: &PartDifference| part.channels.iter().map(|d| d.rmse).fold(0.0, f64::max);
    all.sort_by(|x, y| worst(y).total_cmp(&worst(x)));
    if all.len() > 1 {
        for part in all.iter().take(SHOWN) {
            part.channels.iter().enumerate().for_each(|(c, d)| row(&part.node, c, d));
        }
        if all.len() > SHOWN {
            println!("… and {} more; --json lists them all", all.len() - SHOWN);
        }
    }
    total.iter().enumerate().for_each(|(c, d)| row("total", c, d));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_known_differences() {
        // A constant.
        let constant = difference([(2.0, [-0.1; 3]), (1.0, [-0.1; 3])].into_iter());
        assert!((constant.rmse - 0.1).abs() < 1e-12 && (constant.bias + 0.1).abs() < 1e-12);
        assert_eq!((constant.p50, constant.p99, constant.max), (0.1, 0.1, 0.1));
        // 1 at one corner of one face: ∫ φ² / A = 1/6.
        let hat = difference([(5.0, [1.0, 0.0, 0.0])].into_iter());
        assert!((hat.rmse - (1.0f64 / 6.0).sqrt()).abs() < 1e-12 && (hat.bias - 1.0 / 3.0).abs() < 1e-12);
        // A face of no area counts for the maximum only.
        let sliver = difference([(1.0, [0.0; 3]), (0.0, [1.0; 3])].into_iter());
        assert_eq!((sliver.rmse, sliver.p99, sliver.max), (0.0, 0.0, 1.0));
        assert_eq!(difference(std::iter::empty()).rmse, 0.0);
    }
}
