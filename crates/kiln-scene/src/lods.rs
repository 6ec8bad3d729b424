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
