//! The plot of a bake's cost: against faces for given levels, against instances for scenes made by code; log-log.

use super::{LevelReport, scaling::Cost};
use crate::{
    accuracy::svg::{axis::Axis, escape},
    rays::scaling::plot::{HEIGHT, LEFT, MADE, MARGIN, Place, TOP, WIDTH, axes, line},
};
use std::fmt::{Result, Write};

/// Name and value.
type Quantity = (&'static str, fn(&Cost) -> f64);

const WALL: [Quantity; 1] = [("wall", |cost| cost.wall_secs)];
const FACE: [Quantity; 1] = [("bake", |cost| cost.micros_per_face)];
const RAY: [Quantity; 2] = [("bake", |cost| cost.nanos_per_ray), ("tracing", |cost| cost.tracing_nanos_per_ray)];
const COLUMNS: [(&str, &[Quantity]); 3] =
    [("bake, wall seconds", &WALL), ("CPU, µs per face", &FACE), ("CPU, ns per ray", &RAY)];

/// Draws all levels.
pub(super) fn draw(levels: &[LevelReport], title: &str) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = page(&mut out, levels, title);
    out
}

fn page(out: &mut String, levels: &[LevelReport], title: &str) -> Result {
    let costs = |is_made: bool, size: fn(&Cost) -> f64| {
        let chosen = levels.iter().filter(|level| level.made_of.is_some() == is_made);
        let mut costs: Vec<Cost> = chosen.filter_map(Cost::of).collect();
        costs.sort_by(|a, b| size(a).total_cmp(&size(b)));
        costs
    };
    let given: (&str, fn(&Cost) -> f64) = ("faces of given levels", |cost| cost.faces);
    let made: (&str, fn(&Cost) -> f64) = ("instances, of scenes made by code", |cost| cost.instances);
    let rows = [(given, costs(false, given.1)), (made, costs(true, made.1))];
    let rows: Vec<_> = rows.into_iter().filter(|(_, costs)| !costs.is_empty()).collect();
    let (width, height) = (2.0 * LEFT + WIDTH * 3.0, TOP + HEIGHT * rows.len() as f64 + 10.0);
    write!(
        out,
        r##"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif" font-size="11">
<rect width="{width}" height="{height}" fill="#ffffff"/>
<text x="{LEFT}" y="26" font-size="16" font-weight="bold" fill="#222222">Cost of a bake against the size of the level</text>
<text x="{LEFT}" y="44" fill="#555555">{}</text>
"##,
        escape(title)
    )?;
    for (row, ((label, size), costs)) in rows.iter().enumerate() {
        for (column, (title, quantities)) in COLUMNS.into_iter().enumerate() {
            let corner = (LEFT + WIDTH * column as f64, TOP + HEIGHT * row as f64);
            panel(out, costs, *size, (title, label, quantities), corner)?;
        }
    }
    writeln!(out, "</svg>")
}

fn panel(
    out: &mut String,
    costs: &[Cost],
    size: fn(&Cost) -> f64,
    (title, label, quantities): (&str, &str, &[Quantity]),
    (left, top): (f64, f64),
) -> Result {
    let values = quantities.iter().flat_map(|(_, value)| costs.iter().map(value));
    let (Some(across), Some(up)) = (Axis::around(costs.iter().map(size)), Axis::around(values)) else {
        return Ok(());
    };
    let place = Place { across, up, left: left + MARGIN[3], top: top + MARGIN[0] };
    let (x, y) = (place.left, place.top - 8.0);
    writeln!(out, r##"<text x="{x:.1}" y="{y:.1}" font-weight="bold" fill="#222222">{}</text>"##, escape(title))?;
    axes(out, &place, label)?;
    for ((name, value), color) in quantities.iter().zip(MADE) {
        let shown = costs.iter().filter(|cost| value(cost) > 0.0);
        let points: Vec<(f64, f64)> = shown.map(|cost| (place.x(size(cost)), place.y(value(cost)))).collect();
        line(out, &points, color, name)?;
    }
    Ok(())
}
