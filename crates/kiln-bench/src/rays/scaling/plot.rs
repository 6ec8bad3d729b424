//! The plot of cost against size: a row of panels against triangles, one against instances, log-log.

use super::{Kind, Measured};
use crate::accuracy::svg::{
    axis::{Axis, label},
    escape,
};
use std::fmt::{Result, Write};

pub(crate) const WIDTH: f64 = 300.0;
pub(crate) const HEIGHT: f64 = 210.0;
pub(crate) const LEFT: f64 = 20.0;
pub(crate) const TOP: f64 = 70.0;
pub(crate) const MARGIN: [f64; 4] = [24.0, 20.0, 40.0, 46.0];

/// What a panel shows of a scene: name, unit, value.
type Quantity = (&'static str, fn(&Measured) -> f64);

const RATES: [Quantity; 2] = [("closest", |m| m.closest.mrays_per_cpu_second), ("any", |m| m.any.mrays_per_cpu_second)];
const BUILD: [Quantity; 1] = [("build", |m| m.build.wall_secs)];
const BYTES: [Quantity; 1] = [("tree", |m| m.build.bvh_bytes as f64 / 1e6)];
const COLUMNS: [(&str, &[Quantity]); 3] =
    [("Mrays per second of a thread's time, × threads", &RATES), ("build, wall seconds", &BUILD), ("tree, MB", &BYTES)];

/// Colours that colour-blind people can tell apart (Okabe and Ito 2008): by quantity, then for given levels.
pub(crate) const MADE: [&str; 2] = ["#0072b2", "#d55e00"];
const GIVEN: [&str; 2] = ["#56b4e9", "#e69f00"];

/// Draws all scenes.
pub(super) fn draw(scenes: &[Measured], title: &str) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = page(&mut out, scenes, title);
    out
}

fn page(out: &mut String, scenes: &[Measured], title: &str) -> Result {
    let (width, height) = (2.0 * LEFT + WIDTH * 3.0, TOP + 2.0 * HEIGHT + 10.0);
    write!(
        out,
        r##"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif" font-size="11">
<rect width="{width}" height="{height}" fill="#ffffff"/>
<text x="{LEFT}" y="26" font-size="16" font-weight="bold" fill="#222222">Cost against the size of the scene</text>
<text x="{LEFT}" y="44" fill="#555555">{}</text>
<text x="{LEFT}" y="60" fill="#555555">Lines: scenes made by code. Squares: given levels, with their instances.</text>
"##,
        escape(title)
    )?;
    for (row, kind) in [Kind::Triangles, Kind::Instances].into_iter().enumerate() {
        for (column, (title, quantities)) in COLUMNS.into_iter().enumerate() {
            let corner = (LEFT + WIDTH * column as f64, TOP + HEIGHT * row as f64);
            panel(out, scenes, kind, (title, quantities), corner)?;
        }
    }
    writeln!(out, "</svg>")
}

/// Where values lie on the page.
pub(crate) struct Place {
    pub(crate) across: Axis,
    pub(crate) up: Axis,
    pub(crate) left: f64,
    pub(crate) top: f64,
}

impl Place {
    const INNER_WIDTH: f64 = WIDTH - MARGIN[1] - MARGIN[3];
    const INNER_HEIGHT: f64 = HEIGHT - MARGIN[0] - MARGIN[2];

    pub(crate) fn x(&self, value: f64) -> f64 {
        self.left + Self::INNER_WIDTH * self.across.place(value)
    }

    pub(crate) fn y(&self, value: f64) -> f64 {
        self.top + Self::INNER_HEIGHT * (1.0 - self.up.place(value))
    }
}

fn panel(
    out: &mut String,
    scenes: &[Measured],
    kind: Kind,
    (title, quantities): (&str, &[Quantity]),
    (left, top): (f64, f64),
) -> Result {
    let made: Vec<&Measured> = scenes.iter().filter(|scene| scene.kind == kind).collect();
    // Levels have both, but what their triangles are says more of their cost.
    let is_shown = |scene: &&Measured| scene.kind == Kind::Level && kind == Kind::Triangles;
    let given: Vec<&Measured> = scenes.iter().filter(is_shown).collect();
    let all = || made.iter().chain(&given);
    let values = quantities.iter().flat_map(|(_, value)| all().map(move |scene| value(scene)));
    let (Some(across), Some(up)) = (Axis::around(all().map(|scene| kind.size(scene))), Axis::around(values)) else {
        return Ok(());
    };
    let place = Place { across, up, left: left + MARGIN[3], top: top + MARGIN[0] };
    let (x, y) = (place.left, place.top - 8.0);
    writeln!(out, r##"<text x="{x:.1}" y="{y:.1}" font-weight="bold" fill="#222222">{}</text>"##, escape(title))?;
    axes(out, &place, kind.label())?;
    for (index, (name, value)) in quantities.iter().enumerate() {
        let at = |scene: &&Measured| (place.x(kind.size(scene)), place.y(value(scene)));
        line(out, &made.iter().map(at).collect::<Vec<_>>(), MADE[index], name)?;
        for (x, y) in given.iter().map(at) {
            let color = GIVEN[index];
            writeln!(out, r#"<rect x="{:.1}" y="{:.1}" width="6" height="6" fill="{color}"/>"#, x - 3.0, y - 3.0)?;
        }
    }
    Ok(())
}

/// A line through points on the page, with its name.
pub(crate) fn line(out: &mut String, points: &[(f64, f64)], color: &str, name: &str) -> Result {
    let list: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    writeln!(out, r#"<polyline points="{}" fill="none" stroke="{color}" stroke-width="1.5"/>"#, list.join(" "))?;
    for (x, y) in points {
        writeln!(out, r#"<circle cx="{x:.1}" cy="{y:.1}" r="2.5" fill="{color}"/>"#)?;
    }
    let Some((x, y)) = points.first() else { return Ok(()) };
    writeln!(out, r#"<text x="{:.1}" y="{:.1}" font-size="9" fill="{color}">{name}</text>"#, x + 4.0, y - 6.0)
}

/// Ticks, and what is across.
pub(crate) fn axes(out: &mut String, place: &Place, label_across: &str) -> Result {
    let (left, right) = (place.left, place.left + Place::INNER_WIDTH);
    let (top, bottom) = (place.top, place.top + Place::INNER_HEIGHT);
    for tick in place.up.ticks() {
        let (x, y) = (left - 4.0, place.y(tick));
        writeln!(
            out,
            r##"<line x1="{left:.1}" y1="{y:.1}" x2="{right:.1}" y2="{y:.1}" stroke="#e4e4e4"/><text x="{x:.1}" y="{:.1}" font-size="9" text-anchor="end" fill="#555555">{}</text>"##,
            y + 3.0,
            label(tick)
        )?;
    }
    for tick in place.across.ticks() {
        let (x, y) = (place.x(tick), bottom + 12.0);
        writeln!(
            out,
            r##"<line x1="{x:.1}" y1="{top:.1}" x2="{x:.1}" y2="{bottom:.1}" stroke="#e4e4e4"/><text x="{x:.1}" y="{y:.1}" font-size="9" text-anchor="middle" fill="#555555">{}</text>"##,
            label(tick)
        )?;
    }
    let y = bottom + 25.0;
    writeln!(
        out,
        r##"<path d="M{left:.1} {top:.1}V{bottom:.1}H{right:.1}" fill="none" stroke="#555555"/><text x="{right:.1}" y="{y:.1}" font-size="9" text-anchor="end" fill="#555555">{}</text>"##,
        escape(label_across)
    )
}
