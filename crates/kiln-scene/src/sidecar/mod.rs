//! The sidecar `LEVEL.kiln.toml`: what a level's author says about it beside the glTF.
//!
//! ```toml
//! half_distances_m = [2.0, 300.0]   # one to four
//! blend = [0.03, 0.97]              # weight of each in a colour
//!
//! [[class]]                         # the first rule that matches wins
//! match = "far_*"                   # glob on the name of node, mesh or material
//! class = "distant"                 # opaque, distant, ignored, tree, shrub, decorator
//! max_samples_per_face = 4
//! occludes = true                   # in place of what class and material say
//! receives = true
//! # transmittance_per_crossing = 0.5 (tree)
//! # density_per_m = 0.3              (shrub; derived from its mesh if absent)
//!
//! [[lod]]                           # lower levels of detail, where the glTF has no MSFT_lod
//! node = "*_lod0"                   # name of the full-detail node; at most one `*`
//! levels = ["*_lod1", "*_lod2"]     # `*` stands for what it stands for in `node`
//!
//! [[region]]                        # a box in which moving objects are lit by one model
//! id = "hall"
//! min_m = [0.0, 0.0, 0.0]           # world space, metres
//! max_m = [8.0, 4.0, 12.0]
//! # valid = "base64…"               # 512 bits; found if absent
//!
//! [[edge]]                          # where regions meet; derived if there is none
//! regions = ["hall", "door"]
//! area_m2 = 3.2                     # both derived from the boxes if absent
//! center_m = [8.0, 1.0, 3.0]
//!
//! [region_models]                   # how their models are found
//! smoothing = 0.1
//!
//! [gates]                           # a bake that misses one ends with exit code 4
//! max_rmse = 0.006
//! max_invalid_fraction = 0.05
//! max_bake_secs = 600.0
//! ```
//!
//! It is read strictly: a key that Kiln doesn't know is an error that names the nearest one it knows.

mod boundary;
mod regions;
mod table;
mod write;

use crate::{SceneError, classes::parse_class};
use globset::{Glob, GlobMatcher};
use kiln_core::{Class, MAX_CHANNELS, Regions};
use table::{Entry, Table};

pub use write::region_tables;

/// Channels of a bake whose half-distances are found from the level's size.
const AUTOMATIC_CHANNELS: usize = 2;

const KEYS: [&str; 8] = ["half_distances_m", "blend", "class", "lod", "region", "edge", "region_models", "gates"];
const CLASS_KEYS: [&str; 7] =
    ["match", "class", "transmittance_per_crossing", "density_per_m", "max_samples_per_face", "occludes", "receives"];
const LOD_KEYS: [&str; 2] = ["node", "levels"];
const GATE_KEYS: [&str; 3] = ["max_rmse", "max_invalid_fraction", "max_bake_secs"];

/// Keys of features that nothing computes yet.
const LATER: [&str; 6] = ["field", "fields", "decal", "decals", "texture", "textures"];

/// A sidecar's text and the name it goes by in messages.
#[derive(Clone, Copy, Debug)]
pub struct SidecarText<'a> {
    /// File name.
    pub name: &'a str,
    /// TOML.
    pub text: &'a str,
}

/// A sidecar, read and checked.
#[derive(Clone, Debug, Default)]
pub struct Sidecar {
    /// Half-distances, metres: one to four, finite and positive.
    pub half_distances_m: Option<Vec<f64>>,
    /// Weight of each half-distance, none negative, with a positive sum.
    pub blend: Option<Vec<f64>>,
    /// Class rules, in order.
    pub classes: Vec<ClassRule>,
    /// Links to lower levels of detail, in order.
    pub lods: Vec<LodRule>,
    /// Visibility regions. Unlike a level's, they are in world space: metres as in the glTF.
    pub regions: Regions,
    /// Quality gates.
    pub gates: Gates,
}

/// What a bake must keep to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gates {
    /// Greatest estimated RMSE of any half-distance.
    pub max_rmse: Option<f64>,
    /// Greatest fraction of samples that may be invalid.
    pub max_invalid_fraction: Option<f64>,
    /// Longest time, seconds.
    pub max_bake_secs: Option<f64>,
}

/// A rule that gives a class to what it matches.
#[derive(Clone, Debug)]
pub struct ClassRule {
    /// The glob, as written.
    pub pattern: String,
    matcher: GlobMatcher,
    /// The class.
    pub class: Class,
    /// Part of the light that passes each surface of a tree, 0 to 1.
    pub transmittance_per_crossing: Option<f64>,
    /// Density of a shrub's fog, 1/m.
    pub density_per_m: Option<f64>,
    /// A cap on the samples per face, even.
    pub max_samples_per_face: Option<u32>,
    /// Whether faces stop rays, in place of what class and material say.
    pub occludes: Option<bool>,
    /// Whether faces get samples and their vertices values, in place of what the class says.
    pub receives: Option<bool>,
}

/// A rule that links nodes to their lower levels of detail.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LodRule {
    /// Name of the full-detail node, with at most one `*`.
    pub node: String,
    /// Names of its levels, in which `*` stands for what it stands for in `node`.
    pub levels: Vec<String>,
}

impl LodRule {
    /// The names of a node's levels, if the rule is about it.
    pub(crate) fn levels_of(&self, name: &str) -> Option<Vec<String>> {
        let part = match self.node.split_once('*') {
            Some((before, after)) => name.strip_prefix(before)?.strip_suffix(after)?,
            None if name == self.node => "",
            None => return None,
        };
        Some(self.levels.iter().map(|level| level.replacen('*', part, 1)).collect())
    }
}

impl ClassRule {
    /// Whether the rule's glob matches a name; `*` also matches slashes.
    pub fn matches(&self, name: &str) -> bool {
        self.matcher.is_match(name)
    }
}

impl Sidecar {
    /// Reads a sidecar, strictly.
    pub fn parse(source: SidecarText<'_>) -> Result<Self, SceneError> {
        let parsed = table::parse(source)?;
        let root = Table::root(source, &parsed);
        root.check_keys(&KEYS, &LATER)?;
        let half_distances_m = root.get("half_distances_m").map(|entry| half_distances(&entry)).transpose()?;
        let channels = half_distances_m.as_ref().map_or(AUTOMATIC_CHANNELS, Vec::len);
        let blend = root.get("blend").map(|entry| blend(&entry, channels)).transpose()?;
        let classes = root
            .get("class")
            .map_or(Ok(Vec::new()), |entry| entry.tables("[[class]]")?.iter().map(class_rule).collect())?;
        let lods =
            root.get("lod").map_or(Ok(Vec::new()), |entry| entry.tables("[[lod]]")?.iter().map(lod_rule).collect())?;
        let gates = root.get("gates").map_or(Ok(Gates::default()), |entry| gates(&entry.table("[gates]")?))?;
        let regions = regions::regions(&root)?;
        Ok(Self { half_distances_m, blend, classes, lods, regions, gates })
    }
}

fn half_distances(entry: &Entry<'_>) -> Result<Vec<f64>, SceneError> {
    let values = entry.numbers()?;
    if values.is_empty() || values.len() > MAX_CHANNELS {
        return Err(entry.error(format!("{} half-distances", values.len()), "give one to four"));
    }
    if let Some(value) = values.iter().find(|value| !(value.is_finite() && **value > 0.0)) {
        return Err(entry.error(format!("a half-distance of {value} m"), "give positive lengths in metres"));
    }
    Ok(values)
}

fn blend(entry: &Entry<'_>, channels: usize) -> Result<Vec<f64>, SceneError> {
    let values = entry.numbers()?;
    if values.len() != channels {
        let problem = format!("blend has {} weights for {channels} half-distances", values.len());
        return Err(entry.error(problem, "give one for each"));
    }
    let good = values.iter().all(|value| value.is_finite() && *value >= 0.0) && values.iter().sum::<f64>() > 0.0;
    if good { Ok(values) } else { Err(entry.error("a blend weight is negative or none is positive", "correct them")) }
}

fn class_rule(table: &Table<'_>) -> Result<ClassRule, SceneError> {
    table.check_keys(&CLASS_KEYS, &[])?;
    let pattern = table.require("match")?;
    let glob = Glob::new(pattern.string()?);
    let matcher =
        glob.map_err(|error| pattern.error(format!("{error}"), "see the glob syntax in the documentation"))?;
    let name = table.require("class")?;
    let class = parse_class(name.string()?).map_err(|(problem, advice)| name.error(problem, &advice))?;
    let transmittance = table.get("transmittance_per_crossing");
    let density = table.get("density_per_m");
    if let Some(entry) = transmittance.as_ref().filter(|_| class != Class::Tree) {
        return Err(entry.error("this key is for foliage that is crossed", "use it with the class tree"));
    }
    if let Some(entry) = density.as_ref().filter(|_| class != Class::Shrub) {
        return Err(entry.error("this key is for foliage that is fog", "use it with the class shrub"));
    }
    Ok(ClassRule {
        pattern: pattern.string()?.to_owned(),
        matcher: matcher.compile_matcher(),
        class,
        transmittance_per_crossing: transmittance.map(|entry| entry.number_within(0.0, 1.0)).transpose()?,
        density_per_m: density.map(|entry| entry.number_within(0.0, f64::MAX)).transpose()?,
        max_samples_per_face: table.get("max_samples_per_face").map(|entry| entry.samples()).transpose()?,
        occludes: table.get("occludes").map(|entry| entry.boolean()).transpose()?,
        receives: table.get("receives").map(|entry| entry.boolean()).transpose()?,
    })
}

fn lod_rule(table: &Table<'_>) -> Result<LodRule, SceneError> {
    table.check_keys(&LOD_KEYS, &[])?;
    let (node, levels) = (table.require("node")?, table.require("levels")?);
    let stars = |name: &str| name.matches('*').count();
    let (name, names) = (node.string()?, levels.strings()?);
    if name.is_empty() || stars(name) > 1 {
        return Err(node.error(format!("{name:?} is no name with at most one *"), "name the nodes of full detail"));
    }
    if names.is_empty() {
        return Err(levels.error("there are no levels", "name the nodes of lower detail"));
    }
    if let Some(level) = names.iter().find(|level| level.is_empty() || stars(level) != stars(name)) {
        let problem = format!("{level:?} has not as many * as {name:?}");
        return Err(levels.error(problem, "write a * where the names of the level and of the full detail are alike"));
    }
    Ok(LodRule { node: name.to_owned(), levels: names.into_iter().map(str::to_owned).collect() })
}

fn gates(table: &Table<'_>) -> Result<Gates, SceneError> {
    table.check_keys(&GATE_KEYS, &[])?;
    let gate = |key, most| table.get(key).map(|entry| entry.number_within(0.0, most)).transpose();
    Ok(Gates {
        max_rmse: gate("max_rmse", 1.0)?,
        max_invalid_fraction: gate("max_invalid_fraction", 1.0)?,
        max_bake_secs: gate("max_bake_secs", f64::MAX)?,
    })
}

/// The candidate that is most like a word (Jaro–Winkler similarity, which a common start counts most for).
pub(crate) fn nearest<'c>(word: &str, candidates: &[&'c str]) -> &'c str {
    let likeness = |candidate: &&&str| strsim::jaro_winkler(word, candidate);
    let best = candidates.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    best.copied().unwrap_or("")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Sidecar, SceneError> {
        Sidecar::parse(SidecarText { name: "l.kiln.toml", text })
    }

    fn refusal(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    #[test]
    fn a_whole_sidecar() {
        let sidecar = parse(
            "half_distances_m = [2, 300.0]\nblend = [0.03, 0.97]\n[[class]]\nmatch = 'trees_*'\nclass = 'tree'\n\
             transmittance_per_crossing = 0.5\nmax_samples_per_face = 3\n[gates]\nmax_rmse = 0.01\nmax_bake_secs = 60\n",
        )
        .unwrap();
        assert_eq!(sidecar.half_distances_m, Some(vec![2.0, 300.0]));
        assert_eq!(sidecar.blend, Some(vec![0.03, 0.97]));
        let rule = &sidecar.classes[0];
        assert!(rule.matches("trees_a/b") && !rule.matches("tree"));
        assert_eq!((rule.class, rule.max_samples_per_face), (Class::Tree, Some(4)));
        assert_eq!(rule.transmittance_per_crossing, Some(0.5));
        assert_eq!(sidecar.gates, Gates { max_rmse: Some(0.01), max_bake_secs: Some(60.0), ..Gates::default() });
    }

    #[test]
    fn unknown_keys_name_the_nearest() {
        let message = refusal("# first\nhalf_distance_m = [2.0]\n");
        assert!(message.starts_with("l.kiln.toml:2: "), "{message}");
        assert!(message.contains("did you mean half_distances_m?"), "{message}");
        let message = refusal("[[class]]\nmatch = 'a'\nclass = 'tree'\ndensity = 3\n");
        assert!(message.starts_with("l.kiln.toml:4: ") && message.contains("density_per_m"), "{message}");
        assert!(refusal("[gates]\nmax_rms = 1").contains("max_rmse"));
        assert!(refusal("[[class]]\nmatch = 'a'\nclass = 'tre'\n").contains("\"tree\""));
    }

    #[test]
    fn later_features_are_refused_by_name() {
        for (key, known) in [("regions", "region"), ("edges", "edge")] {
            assert!(refusal(&format!("[[{key}]]\nname = 'a'\n")).contains(&format!("did you mean {known}?")));
        }
        for key in ["fields", "decals", "textures"] {
            let message = refusal(&format!("[[{key}]]\nname = 'a'\n"));
            assert!(message.contains(key) && message.contains("not supported yet"), "{message}");
        }
        assert!(refusal("[[class]]\nmatch = 'a'\nclass = 'dynamic'\n").contains("not supported yet"));
    }

    #[test]
    fn levels_have_the_part_of_the_name_that_the_star_is() {
        let lods = parse("[[lod]]\nnode = '*_lod0'\nlevels = ['*_lod1', 'low/*']\n").unwrap().lods;
        let levels = lods[0].levels_of("oak_lod0").unwrap();
        assert_eq!(levels, ["oak_lod1", "low/oak"]);
        assert!(lods[0].levels_of("oak_lod1").is_none() && lods[0].levels_of("_lod").is_none());
        let lods = parse("[[lod]]\nnode = 'oak'\nlevels = ['far oak']\n").unwrap().lods;
        assert_eq!(lods[0].levels_of("oak").unwrap(), ["far oak"]);
        assert!(lods[0].levels_of("oak2").is_none());
    }

    #[test]
    fn wrong_values_are_refused_with_their_line() {
        for (text, line, word) in [
            ("half_distances_m = []", 1, "one to four"),
            ("half_distances_m = [1, 2, 3, 4, 5]", 1, "one to four"),
            ("\nhalf_distances_m = [-1.0]", 2, "positive"),
            ("half_distances_m = [nan]", 1, "positive"),
            ("half_distances_m = 2.0", 1, "array"),
            ("half_distances_m = [1.0]\nblend = [0.5, 0.5]", 2, "2 weights for 1"),
            ("blend = [0.0, 0.0]", 1, "none is positive"),
            ("[class]\nmatch = 'a'", 1, "[[class]]"),
            ("[[class]]\nclass = 'tree'", 1, "match"),
            ("[[class]]\nmatch = '['\nclass = 'tree'", 2, "glob"),
            ("[[class]]\nmatch = 'a'\nclass = 'opaque'\ndensity_per_m = 1", 4, "foliage"),
            ("[[class]]\nmatch = 'a'\nclass = 'opaque'\noccludes = 1", 4, "true"),
            ("[[class]]\nmatch = 'a'\nclass = 'opaque'\nmax_samples_per_face = 0", 4, "65,536"),
            ("[gates]\nmax_rmse = -1", 2, "between"),
            ("[[lod]]\nnode = 'a*b*'\nlevels = ['c']", 2, "one *"),
            ("[[lod]]\nnode = 'a*'\nlevels = ['c']", 3, "as many *"),
            ("[[lod]]\nnode = 'a'\nlevels = []", 3, "no levels"),
            ("[[lod]]\nnode = 'a'\nlevels = [1]", 3, "strings"),
            ("a = \n", 1, "TOML"),
        ] {
            let message = refusal(text);
            assert!(message.starts_with(&format!("l.kiln.toml:{line}: ")), "{text}: {message}");
            assert!(message.contains(word), "{text}: {message}");
        }
    }
}
