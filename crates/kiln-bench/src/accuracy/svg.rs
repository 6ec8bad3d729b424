//! The plot of error against time: a row of panels for each scene, log-log.

pub(crate) mod axis;
mod panel;

use super::{report::SceneReport, variant::Family};
use panel::{Panel, Series};
use std::fmt::Write;

const PANEL_WIDTH: f64 = 270.0;
const PANEL_HEIGHT: f64 = 210.0;
const LEFT: f64 = 20.0;
const TOP: f64 = 84.0;

/// Colours that colour-blind people can tell apart (Okabe and Ito 2008).
fn color(family: Family) -> &'static str {
    match family {
        Family::Kiln => "#d55e00",
        Family::Fixed => "#0072b2",
        Family::Random => "#56b4e9",
        Family::Vertices => "#777777",
        Family::Average => "#e69f00",
        Family::Alpha0 => "#009e73",
        Family::Alpha1 => "#cc79a7",
    }
}

/// Draws all scenes.
pub(super) fn draw(scenes: &[SceneReport], title: &str) -> String {
    let columns = scenes.iter().map(|scene| 2 * scene.result.half_distances_m.len()).max().unwrap_or(1);
    let width = 2.0 * LEFT + PANEL_WIDTH * columns.max(3) as f64;
    let height = TOP + PANEL_HEIGHT * scenes.len() as f64 + 10.0;
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = write!(
        out,
        r##"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif" font-size="11">
<rect width="{width}" height="{height}" fill="#ffffff"/>
<text x="{LEFT}" y="26" font-size="16" font-weight="bold" fill="#222222">Error against time</text>
<text x="{LEFT}" y="44" fill="#555555">{}</text>
"##,
        escape(title)
    );
    legend(&mut out, scenes);
    for (row, scene) in scenes.iter().enumerate() {
        for (column, panel) in panels(scene).into_iter().enumerate() {
            panel.draw(&mut out, LEFT + PANEL_WIDTH * column as f64, TOP + PANEL_HEIGHT * row as f64);
        }
    }
    out.push_str("</svg>\n");
    out
}

fn legend(out: &mut String, scenes: &[SceneReport]) {
    let is_there = |family: &Family| scenes.iter().flat_map(|scene| &scene.summary).any(|row| row.family == *family);
    let mut x = LEFT;
    for family in Family::ALL.into_iter().filter(is_there) {
        let (color, title) = (color(family), family.title());
        let _ = writeln!(
            out,
            r##"<line x1="{x}" y1="62" x2="{}" y2="62" stroke="{color}" stroke-width="2"/><circle cx="{}" cy="62" r="3" fill="{color}"/><text x="{}" y="66" fill="#222222">{title}</text>"##,
            x + 22.0,
            x + 11.0,
            x + 27.0
        );
        x += 45.0 + 6.0 * title.chars().count() as f64;
    }
}

/// Estimation error, then surface error, for each half-distance.
fn panels(scene: &SceneReport) -> Vec<Panel> {
    let mut panels = Vec::new();
    for (channel, distance) in scene.result.half_distances_m.iter().enumerate() {
        for (name, is_surface) in [("estimation error", false), ("surface error", true)] {
            let series = |family: Family| {
                let rows = scene.summary.iter().filter(|row| row.family == family);
                let error = |row: &super::summary::RowSummary| {
                    let errors = if is_surface { &row.surface } else { &row.estimation };
                    (row.cpu_secs.median, errors[channel].rmse)
                };
                Series { name: family.name(), color: color(family), points: rows.map(error).collect() }
            };
            let all = Family::ALL.into_iter().map(series).filter(|series| !series.points.is_empty());
            let floor = is_surface.then(|| scene.result.reference_surface[channel].rmse);
            let title = format!("{}, {distance} m: {name}", scene.result.scene);
            panels.push(Panel { title: escape(&title), series: all.collect(), floor });
        }
    }
    panels
}

/// Text as the content of an element.
pub(crate) fn escape(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).fold(String::new(), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c => out.push(c),
        }
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_break_out() {
        assert_eq!(escape("a<b>&\"c\"\u{1}"), "a&lt;b&gt;&amp;&quot;c&quot;");
    }
}
