//! Regions as text that a sidecar can be continued with.

use glam::DVec3;
use kiln_core::{RegionSettings, Regions};
use std::fmt::Write;

/// The tables of a sidecar that say where regions are, and how their models are found if that is not as usual. Lengths are
/// rounded to `decimals` places; positions are moved by `origin_m` into world space. Validity bits are left out.
pub fn region_tables(regions: &Regions, origin_m: DVec3, decimals: usize) -> String {
    let mut text = model_table(&regions.settings);
    let id = |index: usize| toml::Value::from(regions.regions[index].id.as_str());
    let point = |point: DVec3| {
        let [x, y, z] = (point + origin_m).to_array().map(|number| rounded(number, decimals));
        format!("[{x}, {y}, {z}]")
    };
    for (index, region) in regions.regions.iter().enumerate() {
        let (min, max) = (point(region.bounds.min), point(region.bounds.max));
        // Writing to a string does not fail.
        let _ = write!(text, "\n[[region]]\nid = {}\nmin_m = {min}\nmax_m = {max}\n", id(index));
    }
    for edge in &regions.edges {
        let [a, b] = edge.regions.map(|index| id(index as usize));
        let (area, center) = (rounded(edge.area_m2, 2 * decimals), point(edge.center));
        let _ = write!(text, "\n[[edge]]\nregions = [{a}, {b}]\narea_m2 = {area}\ncenter_m = {center}\n");
    }
    text
}

/// What is not as usual.
fn model_table(settings: &RegionSettings) -> String {
    let usual = RegionSettings::default();
    let whole = |key, value: u32, usual: u32| (value != usual).then(|| format!("{key} = {value}\n"));
    let number = |key, value: f64, usual: f64| (value != usual).then(|| format!("{key} = {value:?}\n"));
    let lines: String = [
        whole("rays_per_point", settings.rays_per_point, usual.rays_per_point),
        number("smoothing", settings.smoothing, usual.smoothing),
        whole("sweeps", settings.sweeps, usual.sweeps),
        whole("min_points", settings.min_points, usual.min_points),
        number("min_volume_m3", settings.min_volume_m3, usual.min_volume_m3),
        number("back_face_limit", settings.back_face_limit, usual.back_face_limit),
    ]
    .into_iter()
    .flatten()
    .collect();
    if lines.is_empty() { lines } else { format!("\n[region_models]\n{lines}") }
}

/// A number with so many decimals at most, and one at least: TOML tells floats from integers by it.
fn rounded(number: f64, decimals: usize) -> String {
    let text = format!("{number:.0$}", decimals.max(1));
    let text = text.trim_end_matches('0');
    let text = if text.ends_with('.') { format!("{text}0") } else { text.to_owned() };
    if text == "-0.0" { "0.0".to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Sidecar, SidecarText};

    #[test]
    fn what_is_written_is_read() {
        let text = "[region_models]\nsweeps = 3\nmin_volume_m3 = 0.25\n\
                    [[region]]\nid = 'the \"hall\"'\nmin_m = [0, -0.5, 0]\nmax_m = [8.0, 4.0, 12.125]\n\
                    [[region]]\nid = 'door'\nmin_m = [8, 0, 2]\nmax_m = [9, 2, 4]\n\
                    [[edge]]\nregions = ['the \"hall\"', 'door']\narea_m2 = 3.2\ncenter_m = [8, 1, 3.5]\n";
        let read = |text: &str| Sidecar::parse(SidecarText { name: "l.kiln.toml", text }).unwrap().regions;
        let regions = read(text);
        assert_eq!(read(&region_tables(&regions, DVec3::ZERO, 3)), regions);
        let moved = read(&region_tables(&regions, DVec3::new(1024.0, 0.0, 0.0), 3));
        assert_eq!(moved.edges[0].center, DVec3::new(1032.0, 1.0, 3.5));
        assert_eq!(moved.regions[0].bounds.max, DVec3::new(1032.0, 4.0, 12.125));
    }

    #[test]
    fn numbers_are_short() {
        let numbers = [(0.1 + 0.2, 6), (2.0, 3), (-0.000_01, 3), (1234.56789, 2), (5.0, 0)];
        assert_eq!(numbers.map(|(n, d)| rounded(n, d)), ["0.3", "2.0", "0.0", "1234.57", "5.0"]);
    }
}
