//! Which class each primitive of each node falls into, and what that means for its faces.
//!
//! The first rule of the sidecar that matches the name of the node, the mesh or the material decides; where none
//! does, `extras.kiln.class` of the node, of the mesh or of the material, in this order; else it is `opaque`.

use crate::{SceneError, json::Item, material::Material, sidecar::ClassRule};
use kiln_core::{Class, Density, FaceGroup, Foliage, FoliageMode, OpticalDepth};

/// Samples per face of a distant object whose rule sets none.
const DISTANT_SAMPLES_PER_FACE: u32 = 4;

/// What each face of a tree keeps whose rule says nothing (Sloan et al. 2013, section 2.1).
const TRANSMITTANCE_PER_CROSSING: f64 = 0.5;

const CLASSES: [(&str, Class); 7] = [
    ("opaque", Class::Opaque),
    ("distant", Class::Distant),
    ("ignored", Class::Ignored),
    ("tree", Class::Tree),
    ("shrub", Class::Shrub),
    ("decorator", Class::Decorator),
    ("instanced", Class::Instanced),
];

/// Classes of the design that nothing computes yet.
const LATER: [&str; 1] = ["dynamic"];

/// Finds a class by its name; the error says what is wrong and what to do.
pub(crate) fn parse_class(name: &str) -> Result<Class, (String, String)> {
    if let Some((_, class)) = CLASSES.iter().find(|(known, _)| *known == name) {
        return Ok(*class);
    }
    if LATER.contains(&name) {
        let advice = "use \"opaque\" or \"ignored\" until it is";
        return Err((format!("the class {name:?} is not supported yet"), advice.to_owned()));
    }
    let names: Vec<_> = CLASSES.iter().map(|(name, _)| *name).collect();
    let nearest = crate::sidecar::nearest(name, &names);
    Err((format!("there is no class {name:?}"), format!("did you mean {nearest:?}? There are {}", names.join(", "))))
}

/// The class that an object of the document gives itself.
pub(crate) fn class_from_extras(item: &Item<'_>) -> Result<Option<Class>, SceneError> {
    let Some(class) = item.get("extras").and_then(|e| e.get("kiln")?.get("class")) else { return Ok(None) };
    let advice = "use opaque, distant, instanced, ignored, tree, shrub or decorator";
    parse_class(class.string()?).map(Some).map_err(|(problem, _)| class.invalid_with(problem, advice))
}

/// The names and extras by which a primitive of a node is classified.
pub(crate) struct Subject<'a> {
    pub(crate) node: &'a str,
    pub(crate) mesh: &'a str,
    pub(crate) material: &'a Material,
    /// There is a mask, and what it is, if it is the same everywhere.
    pub(crate) mask: Option<Option<bool>>,
    /// The class from the node's extras, else from the mesh's.
    pub(crate) extras: Option<Class>,
}

/// What the faces of a subject are to the bake, and the index of the rule that says so.
pub(crate) fn classify(
    rules: &[ClassRule],
    mode: FoliageMode,
    subject: &Subject<'_>,
) -> (Class, FaceGroup, Option<usize>) {
    let names = [subject.node, subject.mesh, &subject.material.name];
    let rule = rules.iter().position(|rule| names.iter().any(|name| !name.is_empty() && rule.matches(name)));
    let from_rule = rule.map(|index| &rules[index]);
    let class = from_rule.map(|rule| rule.class).or(subject.extras).or(subject.material.class).unwrap_or_default();
    let default_cap = (class == Class::Distant).then_some(DISTANT_SAMPLES_PER_FACE);
    let foliage = if mode == FoliageMode::Geometry { None } else { foliage(class, from_rule, subject.mask.is_some()) };
    let stops = foliage.is_none() && class != Class::Decorator && !subject.material.transparent;
    let mut group = FaceGroup {
        class,
        double_sided: subject.material.double_sided,
        occludes: from_rule.and_then(|rule| rule.occludes).unwrap_or(stops),
        foliage,
        cutout: None,
        receives: from_rule.and_then(|rule| rule.receives).unwrap_or(true),
        max_samples_per_face: from_rule.and_then(|rule| rule.max_samples_per_face).or(default_cap),
    };
    if let Some(all) = subject.mask {
        cut_out(&mut group, all);
    }
    let inert = class == Class::Ignored || !(group.occludes || group.foliage.is_some() || group.receives);
    (if inert { Class::Ignored } else { class }, group, rule)
}

/// Takes a mask into account: that there is one, or what follows where it is the same everywhere. The mask's index is not
/// known here yet.
fn cut_out(group: &mut FaceGroup, all: Option<bool>) {
    let marked = Some(0);
    match (all, group.foliage) {
        (_, Some(Foliage::Fog(_))) => group.cutout = marked,
        (Some(false), _) => (group.occludes, group.foliage) = (false, None),
        // Nothing is kept because the texture says so: it has to say it to rays.
        (Some(true), Some(Foliage::Crossing(depth))) if depth.keeps_nothing() => group.cutout = marked,
        (Some(true), _) => {}
        (None, foliage) => group.cutout = marked.filter(|_| group.occludes || foliage.is_some()),
    }
}

/// What faces of a class do to rays that they do not stop; nothing where a rule says whether they stop them. What a face of a
/// tree keeps is a guess at its holes, which is not needed where a mask says where they are.
fn foliage(class: Class, rule: Option<&ClassRule>, is_masked: bool) -> Option<Foliage> {
    let guess = if is_masked { 0.0 } else { TRANSMITTANCE_PER_CROSSING };
    let kept = rule.and_then(|rule| rule.transmittance_per_crossing).unwrap_or(guess);
    let density = rule.and_then(|rule| rule.density_per_m).map(|per_m| Density { per_m });
    match class {
        _ if rule.is_some_and(|rule| rule.occludes.is_some()) => None,
        Class::Tree => Some(Foliage::Crossing(OpticalDepth::of_transmittance(kept))),
        Class::Shrub => Some(Foliage::Fog(density)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sidecar::{Sidecar, SidecarText};

    fn rules(text: &str) -> Vec<ClassRule> {
        Sidecar::parse(SidecarText { name: "l.kiln.toml", text }).unwrap().classes
    }

    fn classify_node(
        rules: &[ClassRule],
        node: &str,
        material: &Material,
        extras: Option<Class>,
    ) -> (Class, FaceGroup) {
        let subject = Subject { node, mesh: "m", material, mask: None, extras };
        let (class, group, _) = classify(rules, FoliageMode::Expected, &subject);
        (class, group)
    }

    #[test]
    fn the_first_rule_wins_over_extras() {
        let rules = rules(
            "[[class]]\nmatch = 'far_*'\nclass = 'distant'\n[[class]]\nmatch = 'far_tree*'\nclass = 'tree'\n\
             [[class]]\nmatch = 'leaf'\nclass = 'decorator'\nmax_samples_per_face = 2\n",
        );
        let plain = Material::default();
        let leaf = Material { name: "leaf".to_owned(), ..Material::default() };
        let (class, group) = classify_node(&rules, "far_tree_1", &leaf, Some(Class::Shrub));
        assert_eq!((class, group.max_samples_per_face), (Class::Distant, Some(4)));
        let (class, group) = classify_node(&rules, "near", &leaf, Some(Class::Shrub));
        assert_eq!((class, group.max_samples_per_face), (Class::Decorator, Some(2)));
        assert_eq!(classify_node(&rules, "near", &plain, Some(Class::Shrub)).0, Class::Shrub);
        let own = Material { class: Some(Class::Ignored), ..Material::default() };
        assert_eq!(classify_node(&rules, "near", &own, None).0, Class::Ignored);
        assert_eq!(classify_node(&rules, "near", &plain, None).0, Class::Opaque);
    }

    #[test]
    fn foliage_lets_rays_through() {
        let rules = rules(
            "[[class]]\nmatch = 'oak'\nclass = 'tree'\ntransmittance_per_crossing = 0.25\n[[class]]\nmatch = 'trunk'\n\
             class = 'tree'\noccludes = true\n[[class]]\nmatch = 'bush'\nclass = 'shrub'\ndensity_per_m = 0.5\n\
             [[class]]\nmatch = 'ghost'\nclass = 'shrub'\noccludes = false\nreceives = false\n",
        );
        let of = |node: &str, extras| classify_node(&rules, node, &Material::default(), extras).1;
        let what = |group: FaceGroup| (group.occludes, group.foliage);
        assert_eq!(what(of("oak", None)), (false, Some(Foliage::Crossing(OpticalDepth(2 << 16)))));
        assert_eq!(what(of("n", Some(Class::Tree))), (false, Some(Foliage::Crossing(OpticalDepth(1 << 16)))));
        assert_eq!(what(of("trunk", None)), (true, None));
        assert_eq!(what(of("bush", None)), (false, Some(Foliage::Fog(Some(Density { per_m: 0.5 })))));
        assert_eq!(what(of("n", Some(Class::Shrub))), (false, Some(Foliage::Fog(None))));
        assert_eq!(what(of("n", Some(Class::Decorator))), (false, None));
        assert_eq!(classify_node(&rules, "ghost", &Material::default(), None).0, Class::Ignored);
        // As geometry.
        let subject = Subject { node: "oak", mesh: "m", material: &Material::default(), mask: None, extras: None };
        assert_eq!(what(classify(&rules, FoliageMode::Geometry, &subject).1), (true, None));
    }

    #[test]
    fn masks_say_where_faces_are() {
        let rules = rules(
            "[[class]]\nmatch = 'pine'\nclass = 'tree'\ntransmittance_per_crossing = 0.25\n[[class]]\nmatch = 'oak'\n\
             class = 'tree'\n[[class]]\nmatch = 'bush'\nclass = 'shrub'\n[[class]]\nmatch = 'grass'\nclass = 'decorator'\n",
        );
        let of = |node: &str, mode, all: Option<bool>| {
            let material = Material::default();
            let subject = Subject { node, mesh: "m", material: &material, mask: Some(all), extras: None };
            let group = classify(&rules, mode, &subject).1;
            (group.occludes, group.foliage, group.cutout.is_some())
        };
        let crossing = |kept| Some(Foliage::Crossing(OpticalDepth::of_transmittance(kept)));
        let fog = Some(Foliage::Fog(None));
        for (node, holes, all_opaque, all_transparent) in [
            ("wall", (true, None, true), (true, None, false), (false, None, false)),
            ("pine", (false, crossing(0.25), true), (false, crossing(0.25), false), (false, None, false)),
            ("oak", (false, crossing(0.0), true), (false, crossing(0.0), true), (false, None, false)),
            ("bush", (false, fog, true), (false, fog, true), (false, fog, true)),
            ("grass", (false, None, false), (false, None, false), (false, None, false)),
        ] {
            let found = [None, Some(true), Some(false)].map(|all| of(node, FoliageMode::Expected, all));
            assert_eq!(found, [holes, all_opaque, all_transparent], "{node}");
            let whole = node != "grass";
            let as_geometry = [None, Some(true), Some(false)].map(|all| of(node, FoliageMode::Geometry, all));
            assert_eq!(as_geometry, [(whole, None, whole), (whole, None, false), (false, None, false)], "{node}");
        }
    }

    #[test]
    fn transparency_and_overrides() {
        let glass = Material { transparent: true, double_sided: true, ..Material::default() };
        let (_, group) = classify_node(&[], "n", &glass, None);
        assert!(!group.occludes && group.receives && group.double_sided);
        let rules = rules("[[class]]\nmatch = 'n'\nclass = 'opaque'\noccludes = true\nreceives = false\n");
        let (_, group) = classify_node(&rules, "n", &glass, None);
        assert!(group.occludes && !group.receives);
        let neither = self::rules("[[class]]\nmatch = 'n'\nclass = 'opaque'\nreceives = false\n");
        assert_eq!(classify_node(&neither, "n", &glass, None).0, Class::Ignored);
    }
}
