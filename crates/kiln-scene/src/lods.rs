//! Lower levels of detail: nodes that are drawn in place of others.
//!
//! Three things make a node a lower level of another: its index in the other's MSFT_lod, a rule `[[lod]]` of the sidecar, and
//! `extras.kiln.lod_of`, which an export leaves where a rule said so. All that is below such a node belongs to it. A level of a
//! level is one of the full detail.
//!
//! A node of MSFT_lod that the hierarchy does not place stands where the full node does: under the same parent, with its own
//! transform.

use crate::{
    SceneError,
    document::{Document, name_of},
    findings::{Finding, Findings},
    json::List,
    sidecar::LodRule,
};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// The links of a document.
#[derive(Debug, Default)]
pub(crate) struct Lods {
    full_of: BTreeMap<usize, usize>,
    levels_of: BTreeMap<usize, Vec<usize>>,
}

impl Lods {
    /// Finds the links; a node that is a level of two has the first.
    pub(crate) fn find(
        document: &Document<'_>,
        rules: &[LodRule],
        findings: &mut Findings,
    ) -> Result<Self, SceneError> {
        let nodes = document.list("nodes")?;
        let mut links = Vec::new();
        for (full, node) in nodes.iter().enumerate() {
            if let Some(extension) = node.extension("MSFT_lod") {
                for id in extension.list("ids")?.iter() {
                    links.push((full, nodes.resolve(&id)?.0));
                }
            }
        }
        for (level, node) in nodes.iter().enumerate() {
            if let Some(full) = node.get("extras").and_then(|extras| extras.get("kiln")?.get("lod_of")) {
                links.push((nodes.resolve(&full)?.0, level));
            }
        }
        links.extend(of_rules(&nodes, rules, findings));
        let mut direct = BTreeMap::new();
        for (full, level) in links {
            let known = *direct.entry(level).or_insert(full);
            let name = || nodes.get(level).map_or_else(String::new, |node| name_of(&node, "node", level));
            findings.add(Finding::SharedLods, &name(), u64::from(known != full));
        }
        let mut lods = Self::default();
        for &level in direct.keys() {
            let Some(full) = top(&direct, level) else {
                let node = nodes.get(level);
                return Err(node.map_or_else(
                    || document.root().invalid(format!("node {level} is a level of detail of itself")),
                    |node| node.invalid("it is a level of detail of itself"),
                ));
            };
            lods.full_of.insert(level, full);
            lods.levels_of.entry(full).or_default().push(level);
        }
        Ok(lods)
    }

    /// The full-detail node that a node is a level of.
    pub(crate) fn full_of(&self, node: usize) -> Option<usize> {
        self.full_of.get(&node).copied()
    }

    /// The levels of a full-detail node.
    pub(crate) fn levels_of(&self, node: usize) -> &[usize] {
        self.levels_of.get(&node).map_or(&[], Vec::as_slice)
    }

    /// The nodes that have levels.
    pub(crate) fn full_nodes(&self) -> impl Iterator<Item = usize> + '_ {
        self.levels_of.keys().copied()
    }
}

/// The full-detail node above a level; nothing if the links lead round in a circle.
fn top(direct: &BTreeMap<usize, usize>, level: usize) -> Option<usize> {
    let mut seen = BTreeSet::from([level]);
    let mut at = level;
    while let Some(full) = direct.get(&at) {
        if !seen.insert(*full) {
            return None;
        }
        at = *full;
    }
    Some(at)
}

/// Links that the sidecar's rules make, by name: the nearest node of the hierarchy does not matter, names do.
fn of_rules(nodes: &List<'_>, rules: &[LodRule], findings: &mut Findings) -> Vec<(usize, usize)> {
    if rules.is_empty() {
        return Vec::new();
    }
    let mut by_name: HashMap<String, Vec<usize>> = HashMap::new();
    for (index, node) in nodes.iter().enumerate() {
        by_name.entry(name_of(&node, "node", index)).or_default().push(index);
    }
    let mut links = Vec::new();
    for rule in rules {
        let before = links.len();
        for (full, node) in nodes.iter().enumerate() {
            let name = name_of(&node, "node", full);
            let Some(levels) = rule.levels_of(&name) else { continue };
            // Of nodes with the same name the first has the first level of that name, and so on.
            let place = by_name[&name].iter().position(|index| *index == full).unwrap_or(0);
            for level in &levels {
                match by_name.get(level).and_then(|found| found.get(place)) {
                    Some(&level) if level != full => links.push((full, level)),
                    _ => findings.add(Finding::MissingLods, level, 1),
                }
            }
        }
        findings.add(Finding::UnusedLodRule, &rule.node, u64::from(links.len() == before));
    }
    links
}

#[cfg(test)]
mod tests {
    use crate::{
        fixture::{Files, Fixture, export_all, some_values},
        read_baked,
    };
    use glam::DVec3;
    use kiln_core::{BakeSettings, Class, Gets, Level};
    use serde_json::json;

    /// A square at a node, and a second mesh for its levels.
    fn fixture() -> (Fixture, usize) {
        let mut fixture = Fixture::square();
        let primitive = fixture.square_primitive();
        let low = fixture.mesh("low", &json!([primitive]));
        (fixture, low)
    }

    fn import(fixture: &Fixture) -> Level {
        fixture.import().unwrap().level
    }

    #[test]
    fn levels_stand_where_the_full_detail_does() {
        let (mut fixture, low) = fixture();
        let level = fixture.push("nodes", json!({ "name": "low", "mesh": low, "translation": [0, 0, 1] }));
        let full = &mut fixture.json["nodes"][0];
        full["extensions"] = json!({ "MSFT_lod": { "ids": [level] } });
        full["translation"] = json!([5, 0, 0]);
        let parent = fixture.push("nodes", json!({ "children": [0], "translation": [0, 7, 0] }));
        fixture.json["scenes"][0]["nodes"] = json!([parent]);
        let level = import(&fixture);
        assert_eq!(level.instances.len(), 2);
        let lod = &level.instances[1];
        assert_eq!((lod.name.as_str(), &lod.lod_of[..]), ("low", &[0][..]));
        assert_eq!(
            lod.world_from_object.translation - level.instances[0].world_from_object.translation,
            DVec3::new(-5.0, 0.0, 1.0)
        );
        assert_eq!((level.counts.instances, level.counts.lod_instances, level.counts.lod_faces), (1, 1, 2));
        // It does not count for where the level is, nor for what is drawn.
        assert_eq!(level.bounds.max.x - level.bounds.min.x, 1.0);
        let files = fixture.files();
        let drawn = read_baked("level.glb", &files).unwrap();
        assert_eq!(drawn.parts.iter().map(|part| part.node.as_str()).collect::<Vec<_>>(), ["square"]);
    }

    #[test]
    fn rules_link_nodes_of_the_scene_and_the_output_says_so() {
        let (mut fixture, low) = fixture();
        fixture.root_node(json!({ "name": "square_low", "mesh": low, "translation": [3, 0, 0] }));
        let sidecar =
            "[[lod]]\nnode = 'square'\nlevels = ['square_low', 'gone']\n[[lod]]\nnode = 'x*'\nlevels = ['*']\n";
        let import = fixture.import_with(&BakeSettings::default(), sidecar).unwrap();
        let level = &import.level;
        assert_eq!(level.instances[1].lod_of, [0]);
        let codes: Vec<&str> = level.warnings.iter().map(|warning| warning.code.as_str()).collect();
        assert_eq!(codes, ["missing_lods", "unused_lod_rule"]);
        let exported = export_all("level.glb", &fixture.files(), &import, &some_values(&import)).unwrap().glb;
        let drawn = read_baked("b.glb", &Files::from([("b.glb".to_owned(), exported)])).unwrap();
        assert_eq!(drawn.parts.len(), 1);
    }

    #[test]
    fn a_level_gets_what_the_full_detail_gets() {
        for (class, gets) in [("tree", Gets::GlobalTraced), ("shrub", Gets::Scalar), ("instanced", Gets::GlobalTraced)]
        {
            let (mut fixture, low) = fixture();
            let level = fixture.push("nodes", json!({ "name": "low", "mesh": low }));
            fixture.json["nodes"][0]["extensions"] = json!({ "MSFT_lod": { "ids": [level] } });
            fixture.json["nodes"][0]["extras"] = json!({ "kiln": { "class": class } });
            assert_eq!(import(&fixture).instances[1].gets, gets, "{class}");
        }
        let (mut fixture, low) = fixture();
        let level = fixture.push("nodes", json!({ "name": "low", "mesh": low }));
        fixture.json["nodes"][0]["extensions"] = json!({ "MSFT_lod": { "ids": [level] } });
        fixture.json["nodes"][0]["extras"] = json!({ "kiln": { "class": "ignored" } });
        let level = import(&fixture);
        assert!(level.instances.is_empty());
        assert!(level.warnings.iter().any(|warning| warning.code == "lods_of_nothing"));
        assert!(!level.counts.classes.contains_key(&Class::Opaque));
    }

    #[test]
    fn levels_of_levels_are_of_the_full_detail_and_circles_are_refused() {
        let (mut fixture, low) = fixture();
        let lowest = fixture.push("nodes", json!({ "name": "lowest", "mesh": low }));
        let lod = json!({ "MSFT_lod": { "ids": [lowest] } });
        let middle = fixture.push("nodes", json!({ "name": "middle", "mesh": low, "extensions": lod }));
        fixture.json["nodes"][0]["extensions"] = json!({ "MSFT_lod": { "ids": [middle] } });
        let level = import(&fixture);
        assert_eq!(level.instances.iter().map(|i| i.lod_of.len()).collect::<Vec<_>>(), [0, 1, 1]);
        fixture.json["nodes"][lowest]["extensions"] = json!({ "MSFT_lod": { "ids": [0] } });
        let error = fixture.import().unwrap_err().to_string();
        assert!(error.contains("level of detail of itself"), "{error}");
    }

    #[test]
    fn instances_of_one_node_have_a_level_each() {
        let (mut fixture, low) = fixture();
        let places = fixture.floats(&[[0.0f32, 0.0, 0.0], [9.0, 0.0, 0.0]]);
        let instancing = json!({ "attributes": { "TRANSLATION": places } });
        let extensions = json!({ "EXT_mesh_gpu_instancing": instancing });
        let level = fixture.push("nodes", json!({ "name": "low", "mesh": low, "extensions": extensions }));
        fixture.json["nodes"][0]["extensions"] =
            json!({ "EXT_mesh_gpu_instancing": instancing, "MSFT_lod": { "ids": [level] } });
        let level = import(&fixture);
        let lods: Vec<_> =
            level.instances.iter().filter(|i| i.is_lod()).map(|i| (i.gpu_instance, &i.lod_of[..])).collect();
        assert_eq!(lods, [(Some(0), &[0][..]), (Some(1), &[1][..])]);
    }
}
