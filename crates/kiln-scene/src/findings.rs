//! What import and export find worth saying, counted for each subject.

use crate::cutout::MaskProblem;
use kiln_core::Warning;
use std::collections::BTreeMap;

/// Subjects that get a warning of their own, for each kind of finding; the rest share one.
const SUBJECTS: usize = 12;

/// A kind of finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Finding {
    NonFiniteFaces,
    OutOfRangeFaces,
    DegenerateFaces,
    DuplicateFaces,
    InvalidNormals,
    UnreferencedVertices,
    IncompleteFaces,
    NoPositions,
    FlatInstances,
    Skins,
    MorphTargets,
    AlphaMask(MaskProblem),
    UnusedRule,
    UnusedBlend,
    NoDefaultScene,
    RelativeToCenter,
    BytesAfterEnd,
    InstancingExpanded,
    ExternalImages,
    ExtrasNotAnObject,
    SharedLods,
    MissingLods,
    UnusedLodRule,
    LodsOfNothing,
}

impl Finding {
    /// The stable identifier in reports.
    const fn code(self) -> &'static str {
        match self {
            Self::NonFiniteFaces => "non_finite_faces",
            Self::OutOfRangeFaces => "out_of_range_faces",
            Self::DegenerateFaces => "degenerate_faces",
            Self::DuplicateFaces => "duplicate_faces",
            Self::InvalidNormals => "invalid_normals",
            Self::UnreferencedVertices => "unreferenced_vertices",
            Self::IncompleteFaces => "incomplete_faces",
            Self::NoPositions => "no_positions",
            Self::FlatInstances => "flat_instances",
            Self::Skins => "skins",
            Self::MorphTargets => "morph_targets",
            Self::AlphaMask(_) => "alpha_mask",
            Self::UnusedRule => "unused_rule",
            Self::UnusedBlend => "unused_blend",
            Self::NoDefaultScene => "no_default_scene",
            Self::RelativeToCenter => "relative_to_center",
            Self::BytesAfterEnd => "bytes_after_end",
            Self::InstancingExpanded => "instancing_expanded",
            Self::ExternalImages => "external_images",
            Self::ExtrasNotAnObject => "extras_not_an_object",
            Self::SharedLods => "shared_lods",
            Self::MissingLods => "missing_lods",
            Self::UnusedLodRule => "unused_lod_rule",
            Self::LodsOfNothing => "lods_of_nothing",
        }
    }

    /// What is counted, in the singular, and what follows from it.
    const fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::NonFiniteFaces => ("face with positions that are not finite", "dropped, as --drop-bad-faces asks"),
            Self::OutOfRangeFaces => ("face with indices out of range", "dropped, as --drop-bad-faces asks"),
            Self::DegenerateFaces => ("face without area", "left out of the bake; the output keeps it"),
            Self::DuplicateFaces => ("face that repeats another", "left out of the bake; the output keeps it"),
            Self::InvalidNormals => ("normal that is zero or not finite", "the faces' own normals are used there"),
            Self::UnreferencedVertices => ("vertex that no face uses", "its value has no meaning"),
            Self::IncompleteFaces => ("corner too few or too many for whole triangles", "left out of the bake"),
            Self::NoPositions => ("primitive without POSITION", "left out of the bake"),
            Self::FlatInstances => ("instance flattened by its transform", "left out of the bake"),
            Self::Skins => ("instance with a skin", "baked where its node stands, without the skin"),
            Self::MorphTargets => ("primitive with morph targets", "baked in its base shape"),
            Self::AlphaMask(problem) => ("face with alpha mode MASK", without_holes(problem)),
            Self::UnusedRule => ("class rule", "it matches nothing, or a rule before it matches first"),
            Self::UnusedBlend => ("blend", "not used, because the half-distances were set to another number"),
            Self::NoDefaultScene => ("scene not chosen as default", "all root nodes are baked together"),
            Self::RelativeToCenter => ("CESIUM_RTC centre", "not applied: it moves the level as a whole"),
            Self::BytesAfterEnd => ("byte after the container's end", "ignored, and not in the output"),
            Self::InstancingExpanded => {
                ("EXT_mesh_gpu_instancing node", "expanded into nodes, because each instance has values of its own")
            }
            Self::ExternalImages => ("image in a file of its own", "put it at the same place beside the output"),
            Self::ExtrasNotAnObject => ("asset.extras that is no object", "kept, so that nothing is recorded there"),
            Self::SharedLods => ("node that is a level of detail of two others", "it has the values of the first"),
            Self::MissingLods => ("level of detail that a rule names", "there is no other node of that name"),
            Self::UnusedLodRule => ("lod rule", "it links no nodes"),
            Self::LodsOfNothing => (
                "level of detail whose full detail has nothing to be read",
                "left out of the bake; the output keeps it",
            ),
        }
    }
}

/// What follows from a mask that cannot be had.
const fn without_holes(problem: MaskProblem) -> &'static str {
    match problem {
        MaskProblem::Malformed => "baked without holes: its texture is not as glTF demands; export the level again",
        MaskProblem::MissingImage => {
            "baked without holes: its image is not in the level's folder; put it there, or embed it"
        }
        MaskProblem::Format => "baked without holes: its image is neither PNG nor JPEG; save it as PNG",
        MaskProblem::Undecodable => "baked without holes: its image is damaged; save it again as PNG",
        MaskProblem::TooLarge => {
            "baked without holes: its image has more than 8192 × 8192 pixels, or all such images of the level have more \
             than 8 times that; scale them down"
        }
        MaskProblem::NoCoordinates => {
            "baked without holes: a primitive has no texture coordinates for it that fit its vertices; unwrap the mesh and \
             export it with them"
        }
    }
}

/// Findings, counted.
#[derive(Default)]
pub(crate) struct Findings(BTreeMap<Finding, BTreeMap<String, u64>>);

impl Findings {
    /// Counts something found in a subject; a count of zero is nothing.
    pub(crate) fn add(&mut self, finding: Finding, subject: &str, count: u64) {
        if count > 0 {
            *self.0.entry(finding).or_default().entry(subject.to_owned()).or_default() += count;
        }
    }

    /// One warning for each finding and subject, the greatest counts first; subjects beyond a dozen share one.
    pub(crate) fn into_warnings(self) -> Vec<Warning> {
        self.0.into_iter().flat_map(|(finding, subjects)| warnings_of(finding, subjects)).collect()
    }
}

fn warnings_of(finding: Finding, subjects: BTreeMap<String, u64>) -> Vec<Warning> {
    let mut sorted: Vec<(String, u64)> = subjects.into_iter().collect();
    sorted.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let rest = sorted.split_off(sorted.len().min(SUBJECTS));
    if !rest.is_empty() {
        sorted.push((format!("{} others", rest.len()), rest.iter().map(|(_, count)| count).sum()));
    }
    let (noun, consequence) = finding.words();
    let warning = |(subject, count): (String, u64)| Warning {
        code: finding.code().to_owned(),
        message: format!("{count} × {noun}: {consequence}"),
        subject,
        count,
    };
    sorted.into_iter().map(warning).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_kept_whole() {
        let mut findings = Findings::default();
        for mesh in 0..40 {
            findings.add(Finding::DegenerateFaces, &format!("mesh {mesh}"), mesh);
            findings.add(Finding::DegenerateFaces, &format!("mesh {mesh}"), 1);
        }
        findings.add(Finding::Skins, "none", 0);
        let warnings = findings.into_warnings();
        assert_eq!(warnings.len(), SUBJECTS + 1);
        assert_eq!(warnings.iter().map(|warning| warning.count).sum::<u64>(), (1..=40).sum::<u64>());
        assert_eq!((warnings[0].subject.as_str(), warnings[0].count), ("mesh 39", 40));
        assert_eq!(warnings[12].subject, "28 others");
        assert_eq!(warnings[0].code, "degenerate_faces");
    }
}
