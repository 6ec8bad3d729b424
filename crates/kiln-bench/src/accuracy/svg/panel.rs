//! One panel: axes, points, and the frontier of each series.

use super::{
    super::curve::frontier,
    PANEL_HEIGHT, PANEL_WIDTH,
    axis::{Axis, label},
};
use std::fmt::Write;

const MARGIN_LEFT: f64 = 42.0;
const MARGIN_RIGHT: f64 = 54.0;
const MARGIN_TOP: f64 = 24.0;
const MARGIN_BOTTOM: f64 = 38.0;
/// Least distance of two labels, pixels.
const LABEL_HEIGHT: f64 = 10.0;

/// (processor seconds, error) pairs of one family.
pub(super) struct Series {
    pub(super) name: &'static str,
    pub(super) color: &'static str,
    pub(super) points: Vec<(f64, f64)>,
}

/// One plot. The title is escaped already.
pub(super) struct Panel {
    pub(super) title: String,
    pub(super) series: Vec<Series>,
    /// An error that no time gets below.
    pub(super) floor: Option<f64>,
}

/// Where values lie on the page.
struct Place {
    time: Axis,
    error: Axis,
    x: f64,
    y: f64,
}

impl Place {
    const WIDTH: f64 = PANEL_WIDTH - MARGIN_LEFT - MARGIN_RIGHT;
    const HEIGHT: f64 = PANEL_HEIGHT - MARGIN_TOP - MARGIN_BOTTOM;

    fn x(&self, secs: f64) -> f64 {
        self.x + Self::WIDTH * self.time.place(secs)
    }

    fn y(&self, error: f64) -> f64 {
        self.y + Self::HEIGHT * (1.0 - self.error.place(error))
    }
}

impl Panel {
    /// Draws it with its upper left corner at a place. A panel without a point stays empty.
    pub(super) fn draw(&self, out: &mut String, left: f64, top: f64) {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let (Some(time), Some(error)) = (
            Axis::around(points().map(|point| point.0)),
            Axis::around(points().map(|point| point.1).chain(self.floor)),
        ) else {
            return;
        };
        let place = Place { time, error, x: left + MARGIN_LEFT, y: top + MARGIN_TOP };
        // Writing to a string does not fail.
        let _ = writeln!(
            out,
            r##"<text x="{:.1}" y="{:.1}" font-weight="bold" fill="#222222">{}</text>"##,
            place.x,
            place.y - 8.0,
            self.title
        );
        axes(out, &place);
        if let Some(floor) = self.floor {
            draw_floor(out, &place, floor);
        }
        self.series.iter().rev().for_each(|series| draw_series(out, &place, series));
        self.draw_labels(out, &place);
    }

    /// The names of the series at the ends of their frontiers, moved apart.
    fn draw_labels(&self, out: &mut String, place: &Place) {
        let end = |series: &Series| Some((place.y(frontier(&series.points).last()?.1), series.name, series.color));
        let mut labels: Vec<_> = self.series.iter().filter_map(end).collect();
        labels.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut least = place.y;
        for (y, name, color) in labels {
            let y = y.max(least);
            least = y + LABEL_HEIGHT;
            let x = place.x + Place::WIDTH + 5.0;
            let _ = writeln!(out, r#"<text x="{x:.1}" y="{:.1}" font-size="9" fill="{color}">{name}</text>"#, y + 3.0);
        }
    }
}

fn axes(out: &mut String, place: &Place) {
    let (left, right) = (place.x, place.x + Place::WIDTH);
    let (top, bottom) = (place.y, place.y + Place::HEIGHT);
    for tick in place.error.ticks() {
        let y = place.y(tick);
        let _ = writeln!(
            out,
            r##"<line x1="{left:.1}" y1="{y:.1}" x2="{right:.1}" y2="{y:.1}" stroke="#e4e4e4"/><text x="{:.1}" y="{:.1}" font-size="9" text-anchor="end" fill="#555555">{}</text>"##,
            left - 4.0,
            y + 3.0,
            label(tick)
        );
    }
    for tick in place.time.ticks() {
        let x = place.x(tick);
        let _ = writeln!(
            out,
            r##"<line x1="{x:.1}" y1="{top:.1}" x2="{x:.1}" y2="{bottom:.1}" stroke="#e4e4e4"/><text x="{x:.1}" y="{:.1}" font-size="9" text-anchor="middle" fill="#555555">{}</text>"##,
            bottom + 12.0,
            label(tick)
        );
    }
    let _ = writeln!(
        out,
        r##"<path d="M{left:.1} {top:.1}V{bottom:.1}H{right:.1}" fill="none" stroke="#555555"/><text x="{right:.1}" y="{:.1}" font-size="9" text-anchor="end" fill="#555555">CPU seconds</text>"##,
        bottom + 24.0
    );
}

fn draw_floor(out: &mut String, place: &Place, floor: f64) {
    let (y, right) = (place.y(floor), place.x + Place::WIDTH);
    let _ = writeln!(
        out,
        r##"<line x1="{:.1}" y1="{y:.1}" x2="{right:.1}" y2="{y:.1}" stroke="#999999" stroke-dasharray="3 3"/><text x="{:.1}" y="{:.1}" font-size="8" fill="#777777">converged</text>"##,
        place.x,
        place.x + 3.0,
        y - 2.0
    );
}

fn draw_series(out: &mut String, place: &Place, series: &Series) {
    let color = series.color;
    let line: Vec<String> = frontier(&series.points)
        .into_iter()
        .map(|(secs, error)| format!("{:.1},{:.1}", place.x(secs), place.y(error)))
        .collect();
    let _ = writeln!(out, r#"<polyline points="{}" fill="none" stroke="{color}" stroke-width="1.5"/>"#, line.join(" "));
    for &(secs, error) in series.points.iter().filter(|(secs, error)| *secs > 0.0 && *error > 0.0) {
        let (x, y) = (place.x(secs), place.y(error));
        let _ = writeln!(out, r#"<circle cx="{x:.1}" cy="{y:.1}" r="2.2" fill="{color}"/>"#);
    }
}
