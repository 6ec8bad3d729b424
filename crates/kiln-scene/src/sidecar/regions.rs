//! Visibility regions, their edges and how their models are found.

use super::{
    boundary::{boundaries, boundary},
    nearest,
    table::{Entry, Table},
};
use crate::{SceneError, limits};
use base64::{Engine, engine::general_purpose::STANDARD};
use kiln_core::{Bounds, CANDIDATES, CandidateBits, Region, RegionEdge, RegionSettings, Regions};
use std::collections::{BTreeMap, HashMap};

/// Regions of a level, at most.
const MOST_REGIONS: usize = 1_000_000;

/// Pairs of boxes that are looked at for edges, at most: more than so many regions have, unless they lie in heaps.
const MOST_PAIRS: usize = 32_000_000;

const REGION_KEYS: [&str; 4] = ["id", "min_m", "max_m", "valid"];
const EDGE_KEYS: [&str; 3] = ["regions", "area_m2", "center_m"];
const MODEL_KEYS: [&str; 6] =
    ["rays_per_point", "smoothing", "sweeps", "min_points", "min_volume_m3", "back_face_limit"];

/// Directions of a point, at most: as many as tracers take at once.
const MOST_RAYS: u32 = 1 << 15;

/// Sweeps of smoothing, at most.
const MOST_SWEEPS: u32 = 10_000;

/// Reads all that a sidecar says of regions, in world space, metres.
pub(super) fn regions(root: &Table<'_>) -> Result<Regions, SceneError> {
    let settings = root
        .get("region_models")
        .map_or(Ok(RegionSettings::default()), |entry| settings(&entry.table("[region_models]")?))?;
    let regions = root.get("region").map_or(Ok(Vec::new()), |entry| boxes(&entry))?;
    let edges = match (root.get("edge"), root.get("region")) {
        (Some(entry), _) => edges(&entry, &regions)?,
        (None, Some(entry)) => boundaries(&regions, MOST_PAIRS).map_err(|_| {
            let problem = format!("the boxes of {} regions meet in too many pairs", regions.len());
            entry.error(problem, "name those that count by [[edge]] tables, or give boxes that overlap less")
        })?,
        (None, None) => Vec::new(),
    };
    Ok(Regions { regions, edges, settings })
}

fn boxes(entry: &Entry<'_>) -> Result<Vec<Region>, SceneError> {
    let tables = entry.tables("[[region]]")?;
    if tables.len() > MOST_REGIONS {
        let problem = format!("{} regions are more than the limit of {MOST_REGIONS}", tables.len());
        return Err(entry.error(problem, "make them larger, or split the level"));
    }
    let mut known = HashMap::with_capacity(tables.len());
    let read = |(index, table): (usize, &Table<'_>)| {
        let region = region(table)?;
        match known.insert(region.id.clone(), index) {
            Some(first) => {
                let problem = format!("the regions {first} and {index} (from 0) are both called {:?}", region.id);
                Err(table.require("id")?.error(problem, "rename one"))
            }
            None => Ok(region),
        }
    };
    tables.iter().enumerate().map(read).collect()
}

fn region(table: &Table<'_>) -> Result<Region, SceneError> {
    table.check_keys(&REGION_KEYS, &[])?;
    let id = table.require("id")?;
    if id.string()?.is_empty() {
        return Err(id.error("the region's id is empty", "name it"));
    }
    let (low, high) = (table.require("min_m")?, table.require("max_m")?);
    let bounds = Bounds { min: low.point(limits::COORDINATE_M)?, max: high.point(limits::COORDINATE_M)? };
    if !bounds.min.cmplt(bounds.max).all() {
        let problem = format!("the region {:?} ends at {} but begins at {}", id.string()?, bounds.max, bounds.min);
        return Err(high.error(problem, "give a box whose max_m is greater than its min_m along each axis"));
    }
    let valid = table.get("valid").map(|entry| candidates(&entry)).transpose()?;
    Ok(Region { id: id.string()?.to_owned(), bounds, valid })
}

/// Base64 of the bits, least significant first in each byte.
fn candidates(entry: &Entry<'_>) -> Result<CandidateBits, SceneError> {
    const ADVICE: &str = "give base64 of 64 bytes: bit x + 8y + 64z, least significant first";
    let bytes = STANDARD.decode(entry.string()?).map_err(|error| {
        let problem = format!("the validity bits are no base64: {error}");
        entry.error(problem, ADVICE)
    })?;
    if bytes.len() != CANDIDATES / 8 {
        return Err(entry.error(format!("the validity bits are {} bytes", bytes.len()), ADVICE));
    }
    let mut bits = CandidateBits::default();
    for (word, bytes) in bits.0.iter_mut().zip(bytes.as_chunks().0) {
        *word = u64::from_le_bytes(*bytes);
    }
    Ok(bits)
}

fn edges(entry: &Entry<'_>, regions: &[Region]) -> Result<Vec<RegionEdge>, SceneError> {
    let index_of: HashMap<&str, u32> = (0u32..).zip(regions).map(|(i, region)| (region.id.as_str(), i)).collect();
    let mut edges = BTreeMap::new();
    for table in entry.tables("[[edge]]")? {
        table.check_keys(&EDGE_KEYS, &[])?;
        let ends = table.require("regions")?;
        let pair = pair(&ends, &index_of)?;
        let edge = edge(&table, &ends, pair, regions)?;
        if edges.insert(pair, edge).is_some() {
            let [a, b] = pair.map(|index| &regions[index as usize].id);
            return Err(ends.error(format!("the edge between {a:?} and {b:?} is there twice"), "remove one"));
        }
    }
    Ok(edges.into_values().collect())
}

/// Indices of the two regions that an edge names, the lower first.
fn pair(ends: &Entry<'_>, index_of: &HashMap<&str, u32>) -> Result<[u32; 2], SceneError> {
    let names = ends.strings()?;
    let &[first, second] = names.as_slice() else {
        return Err(ends.error(format!("an edge joins {} regions", names.len()), "give the ids of two"));
    };
    let find = |name: &str| {
        index_of.get(name).copied().ok_or_else(|| {
            let mut ids: Vec<&str> = index_of.keys().copied().collect();
            ids.sort_unstable();
            let advice = match nearest(name, &ids) {
                "" => "add it as a [[region]]".to_owned(),
                near => format!("did you mean {near:?}?"),
            };
            ends.error(format!("there is no region {name:?}"), &advice)
        })
    };
    let (a, b) = (find(first)?, find(second)?);
    if a == b {
        return Err(ends.error(format!("an edge joins {first:?} to itself"), "give the ids of two regions"));
    }
    Ok([a.min(b), a.max(b)])
}

fn edge(table: &Table<'_>, ends: &Entry<'_>, pair: [u32; 2], regions: &[Region]) -> Result<RegionEdge, SceneError> {
    match (table.get("area_m2"), table.get("center_m")) {
        (Some(area), Some(center)) => {
            let area_m2 = area.number_within(0.0, f64::MAX)?;
            if area_m2 <= 0.0 {
                return Err(area.error("the edge has no area", "give a positive one, or remove the edge"));
            }
            Ok(RegionEdge { regions: pair, area_m2, center: center.point(limits::COORDINATE_M)? })
        }
        (None, None) => boundary(regions, pair).ok_or_else(|| {
            let [a, b] = pair.map(|index| &regions[index as usize].id);
            let problem = format!("the boxes of {a:?} and {b:?} share no area");
            ends.error(problem, "say where they meet by area_m2 and center_m, or remove the edge")
        }),
        (Some(given), None) => Err(given.error("the edge has an area_m2 but no center_m", "give both or neither")),
        (None, Some(given)) => Err(given.error("the edge has a center_m but no area_m2", "give both or neither")),
    }
}

fn settings(table: &Table<'_>) -> Result<RegionSettings, SceneError> {
    table.check_keys(&MODEL_KEYS, &[])?;
    let whole =
        |key, least, most, usual: u32| table.get(key).map_or(Ok(usual), |entry| entry.whole_within(least, most));
    let number = |key, most, usual: f64| table.get(key).map_or(Ok(usual), |entry| entry.number_within(0.0, most));
    let usual = RegionSettings::default();
    let rays_per_point = whole("rays_per_point", 1, MOST_RAYS, usual.rays_per_point)?;
    if let Some(entry) = table.get("rays_per_point").filter(|_| !rays_per_point.is_power_of_two()) {
        let problem = format!("rays_per_point is {rays_per_point}, which is no power of two");
        return Err(entry.error(problem, &format!("give {}", rays_per_point.next_power_of_two())));
    }
    Ok(RegionSettings {
        rays_per_point,
        smoothing: number("smoothing", f64::MAX, usual.smoothing)?,
        sweeps: whole("sweeps", 0, MOST_SWEEPS, usual.sweeps)?,
        min_points: whole("min_points", 0, CANDIDATES as u32, usual.min_points)?,
        min_volume_m3: number("min_volume_m3", f64::MAX, usual.min_volume_m3)?,
        back_face_limit: number("back_face_limit", 1.0, usual.back_face_limit)?,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Sidecar, SidecarText};
    use super::*;
    use glam::DVec3;

    const TWO: &str = "[[region]]\nid = 'hall'\nmin_m = [0, 0, 0]\nmax_m = [8.0, 4.0, 12.0]\n\
                       [[region]]\nid = 'door'\nmin_m = [8, 0, 2]\nmax_m = [9, 2, 4]\n";

    fn read(text: &str) -> Result<Regions, String> {
        let sidecar = Sidecar::parse(SidecarText { name: "l.kiln.toml", text });
        sidecar.map(|sidecar| sidecar.regions).map_err(|error| error.to_string())
    }

    #[test]
    fn regions_edges_and_settings() {
        let bits = STANDARD.encode([[1u8, 0, 0, 0, 0, 0, 0, 0x80].repeat(2), vec![0; 48]].concat());
        let text = format!(
            "[region_models]\nrays_per_point = 256\nsmoothing = 0\nsweeps = 3\nmin_points = 4\nmin_volume_m3 = 0.5\n\
             {TWO}valid = '{bits}'\n\
             [[edge]]\nregions = ['door', 'hall']\narea_m2 = 3.2\ncenter_m = [8, 1, 3.5]\n"
        );
        let regions = read(&text).unwrap();
        assert_eq!(regions.regions[0].id, "hall");
        assert_eq!(regions.regions[0].bounds, Bounds { min: DVec3::ZERO, max: DVec3::new(8.0, 4.0, 12.0) });
        assert_eq!(regions.regions[0].valid, None);
        let valid: Vec<usize> = regions.regions[1].valid.unwrap().iter().collect();
        assert_eq!(valid, [0, 63, 64, 127]);
        let edge = RegionEdge { regions: [0, 1], area_m2: 3.2, center: DVec3::new(8.0, 1.0, 3.5) };
        assert_eq!(regions.edges, [edge]);
        let settings = RegionSettings {
            rays_per_point: 256,
            smoothing: 0.0,
            sweeps: 3,
            min_points: 4,
            min_volume_m3: 0.5,
            ..RegionSettings::default()
        };
        assert_eq!(regions.settings, settings);
    }

    #[test]
    fn edges_are_derived_where_none_is_given() {
        let derived = RegionEdge { regions: [0, 1], area_m2: 4.0, center: DVec3::new(8.0, 1.0, 3.0) };
        assert_eq!(read(TWO).unwrap().edges, std::slice::from_ref(&derived));
        assert_eq!(read(&format!("{TWO}[[edge]]\nregions = ['hall', 'door']")).unwrap().edges, [derived]);
        assert_eq!(read("").unwrap(), Regions::default());
    }

    #[test]
    fn wrong_regions_are_refused_with_their_line() {
        let short = STANDARD.encode([0u8; 63]);
        for (text, line, word) in [
            ("[[region]]\nmin_m = [0, 0, 0]\nmax_m = [1, 1, 1]", 1, "id is missing"),
            ("[[region]]\nid = ''\nmin_m = [0, 0, 0]\nmax_m = [1, 1, 1]", 2, "empty"),
            ("[[region]]\nid = 'a'\nmin_m = [0, 0]\nmax_m = [1, 1, 1]", 3, "three numbers"),
            ("[[region]]\nid = 'a'\nmin_m = [0, 0, nan]\nmax_m = [1, 1, 1]", 3, "finite"),
            ("[[region]]\nid = 'a'\nmin_m = [0, 0, 0]\nmax_m = [1, 1, 1e300]", 4, "1000000000000000"),
            ("[[region]]\nid = 'a'\nmin_m = [0, 0, 0]\nmax_m = [1, 0, 1]", 4, "greater than its min_m"),
            ("[[region]]\nid = 'a'\nmin_m = [0, 0, 0]\nmax_m = [1, 1, 1]\nvalid = '?'", 5, "base64"),
            (&format!("[[region]]\nid = 'a'\nmin_m = [0, 0, 0]\nmax_m = [1, 1, 1]\nvalid = '{short}'"), 5, "63 bytes"),
            ("[[region]]\nid = 'a'\nmin = [0, 0, 0]", 3, "did you mean min_m?"),
            ("[region]\nid = 'a'", 1, "[[region]]"),
            (
                &format!("{TWO}[[region]]\nid = 'hall'\nmin_m = [0, 0, 0]\nmax_m = [1, 1, 1]"),
                10,
                "both called \"hall\"",
            ),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'dor']"), 10, "did you mean \"door\"?"),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'hall']"), 10, "to itself"),
            (&format!("{TWO}[[edge]]\nregions = ['hall']"), 10, "joins 1 regions"),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'door']\narea_m2 = 0\ncenter_m = [0, 0, 0]"), 11, "no area"),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'door']\narea_m2 = inf\ncenter_m = [0, 0, 0]"), 11, "area_m2"),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'door']\narea_m2 = 1"), 11, "both or neither"),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'door']\ncenter_m = [1, 1, 1]"), 11, "both or neither"),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'door']\narea = 1"), 11, "did you mean area_m2?"),
            (&format!("{TWO}[[edge]]\nregions = ['hall', 'door']\n[[edge]]\nregions = ['door', 'hall']"), 12, "twice"),
            ("[[edge]]\nregions = ['hall', 'door']", 2, "there is no region"),
            ("[region_models]\nrays_per_point = 1000", 2, "give 1024"),
            ("[region_models]\nrays = 1000", 2, "rays_per_point"),
            ("[region_models]\nmin_points = 513", 2, "512"),
            ("[region_models]\nsweeps = 1.5", 2, "whole number"),
            ("[region_models]\nsmoothing = -1", 2, "at least 0"),
            ("[region_models]\nsmoothing = nan", 2, "at least 0"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.starts_with(&format!("l.kiln.toml:{line}: ")), "{text}: {message}");
            assert!(message.contains(word), "{text}: {message}");
        }
        let far = "[[region]]\nid = 'far'\nmin_m = [20, 0, 0]\nmax_m = [21, 1, 1]\n[[edge]]\nregions = ['far', 'hall']";
        let message = read(&format!("{TWO}{far}")).unwrap_err();
        assert!(message.contains("the boxes of \"hall\" and \"far\" share no area"), "{message}");
    }
}
