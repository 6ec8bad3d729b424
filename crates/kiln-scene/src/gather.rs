//! Which meshes a bake needs, in which variants, and where they stand.
//!
//! A rule can match a node, so that one mesh of the document may need several variants, with other groups or
//! without ignored faces; instances with equal groups share one. Accessors are opened here, and the sizes of all
//! that will be read are checked against the limits before any of it is.

use crate::{
    SceneError, SourceFiles,
    classes::{Subject, class_from_extras, classify},
    cutout::{MaskReader, MaskTrouble, PrimitiveMask},
    document::{Document, name_of},
    extensions,
    findings::{Finding, Findings},
    json::Item,
    limits,
    material::{Material, materials},
    mesh::{Primitive, Topology},
    scene::Placement,
    sidecar::ClassRule,
};
use globset::GlobMatcher;
use kiln_core::{Attribute, Class, FaceGroup, FoliageMode, Gets, Instance, OutputSettings, TreeValues};
use std::collections::{BTreeSet, HashMap};

/// A mesh as some instances need it.
pub(crate) struct Variant<'d> {
    pub(crate) source_mesh: usize,
    pub(crate) name: String,
    /// Its primitives with triangles that are not ignored, at least one.
    pub(crate) primitives: Vec<Primitive<'d>>,
    /// Indices of the instances in [`Gathered::instances`], lower levels of detail apart.
    pub(crate) instances: Vec<usize>,
    /// Indices of the lower levels of detail that have it.
    pub(crate) lods: Vec<usize>,
}

/// What a bake needs.
pub(crate) struct Gathered<'d> {
    pub(crate) variants: Vec<Variant<'d>>,
    /// Instances, whose `mesh` is the index of a variant, in the order of the hierarchy.
    pub(crate) instances: Vec<Instance>,
    /// Faces of the class `ignored`, over all instances, before cleaning.
    pub(crate) ignored_faces: u64,
}

/// What decides how things are classified and whether they receive.
pub(crate) struct Rules<'r> {
    pub(crate) classes: &'r [ClassRule],
    /// `--only`.
    pub(crate) only: Option<GlobMatcher>,
    pub(crate) foliage: FoliageMode,
    pub(crate) trees: TreeValues,
    pub(crate) output: &'r OutputSettings,
}

/// Gathers the variants and instances of all placements.
pub(crate) fn gather<'d>(
    document: &'d Document<'_>,
    files: &dyn SourceFiles,
    placements: &[Placement],
    rules: &Rules<'_>,
    findings: &mut Findings,
) -> Result<Gathered<'d>, SceneError> {
    let mut gatherer = Gatherer {
        document,
        rules,
        materials: materials(document)?,
        masks: MaskReader::new(document, files),
        meshes: HashMap::new(),
        variant_of: HashMap::new(),
        used_rules: BTreeSet::new(),
        totals: Totals::default(),
        fulls: Vec::new(),
        gathered: Gathered { variants: Vec::new(), instances: Vec::new(), ignored_faces: 0 },
    };
    for placement in placements.iter().filter(|placement| placement.lod_of.is_none()) {
        gatherer.place(placement, None, findings)?;
    }
    gatherer.place_lods(placements, findings)?;
    for (index, rule) in rules.classes.iter().enumerate() {
        findings.add(Finding::UnusedRule, &rule.pattern, u64::from(!gatherer.used_rules.contains(&index)));
    }
    Ok(gatherer.gathered)
}

/// A mesh of the document, with its primitives that have triangles and positions.
struct SourceMesh<'d> {
    item: Item<'d>,
    name: String,
    class: Option<Class>,
    primitives: Vec<SourcePrimitive<'d>>,
}

struct SourcePrimitive<'d> {
    index: u32,
    item: Item<'d>,
    topology: Topology,
    material: Material,
    /// Where its faces are, if a texture says so, or why that cannot be told.
    mask: Option<Result<PrimitiveMask<'d>, MaskTrouble>>,
    has_color: bool,
}

#[derive(Default)]
struct Totals {
    vertices: u64,
    faces: u64,
}

/// What each primitive of a mesh is to an instance; nothing for those that are ignored.
type Groups = Vec<Option<FaceGroup>>;

struct Gatherer<'d, 'b, 'r> {
    document: &'d Document<'b>,
    rules: &'r Rules<'r>,
    materials: Vec<Material>,
    masks: MaskReader<'d, 'b, 'r>,
    meshes: HashMap<usize, SourceMesh<'d>>,
    variant_of: HashMap<(usize, Groups), usize>,
    used_rules: BTreeSet<usize>,
    totals: Totals,
    /// For each instance the nodes at or above it that have lower levels of detail.
    fulls: Vec<Vec<usize>>,
    gathered: Gathered<'d>,
}

impl<'d> Gatherer<'d, '_, '_> {
    /// Places the lower levels of detail, now that all that they stand for is there.
    fn place_lods(&mut self, placements: &[Placement], findings: &mut Findings) -> Result<(), SceneError> {
        let levels = || placements.iter().filter(|placement| placement.lod_of.is_some());
        let mut instances_of: HashMap<usize, Vec<u32>> = HashMap::new();
        let mut paired_of: HashMap<(usize, Option<u32>), Vec<u32>> = HashMap::new();
        for (index, fulls) in self.fulls.iter().enumerate() {
            let gpu_instance = self.gathered.instances[index].gpu_instance;
            for full in fulls {
                instances_of.entry(*full).or_default().push(index as u32);
                paired_of.entry((*full, gpu_instance)).or_default().push(index as u32);
            }
        }
        let mut count_at: HashMap<usize, usize> = HashMap::new();
        levels().for_each(|placement| *count_at.entry(placement.node).or_default() += 1);
        for placement in levels() {
            let Some(full) = placement.lod_of else { continue };
            let of_node = instances_of.get(&full);
            // As many instances of EXT_mesh_gpu_instancing as the full detail has: each stands for one of them.
            let is_many = placement.gpu_instance.is_some() && Some(count_at[&placement.node]) == of_node.map(Vec::len);
            let found = if is_many { paired_of.get(&(full, placement.gpu_instance)) } else { of_node };
            let lod_of = found.cloned().unwrap_or_default();
            self.place(placement, Some(lod_of), findings)?;
        }
        Ok(())
    }

    /// What a lower level of detail gets: what the full detail does, of whose instances those are left that it is read from.
    fn lod(&self, instance: &mut Instance, lod_of: Vec<u32>) -> bool {
        let full = |index: &u32| &self.gathered.instances[*index as usize];
        let receiving: Vec<u32> = lod_of.into_iter().filter(|index| full(index).receives).collect();
        let gets = |gets: Gets| receiving.iter().any(|index| full(index).gets == gets);
        let order = [Gets::GlobalTraced, Gets::Global, Gets::Vertices, Gets::Scalar];
        let Some(found) = order.into_iter().find(|kind| gets(*kind)) else { return false };
        instance.gets = found;
        instance.lod_of = receiving.iter().copied().filter(|index| full(index).gets == found).collect();
        true
    }

    /// `lod_of` has the instances of the full detail if it is a lower level.
    fn place(
        &mut self,
        placement: &Placement,
        lod_of: Option<Vec<u32>>,
        findings: &mut Findings,
    ) -> Result<(), SceneError> {
        let nodes = self.document.list("nodes")?;
        let Some(node) = nodes.get(placement.node) else { return Ok(()) };
        let node_name = name_of(&node, "node", placement.node);
        if !self.meshes.contains_key(&placement.mesh) {
            let mesh = self.read_mesh(placement.mesh, findings)?;
            self.meshes.insert(placement.mesh, mesh);
        }
        let groups = self.classify(&node, &node_name, placement.mesh)?;
        if groups.iter().all(Option::is_none) {
            return Ok(());
        }
        let mut instance = Instance {
            name: placement.gpu_instance.map_or_else(|| node_name.clone(), |i| format!("{node_name}[{i}]")),
            mesh: 0,
            node: placement.node as u32,
            gpu_instance: placement.gpu_instance,
            world_from_object: placement.world_from_object,
            receives: groups.iter().flatten().any(|group| group.receives)
                && (lod_of.is_some() || self.is_wanted(&node_name, placement.mesh)),
            gets: gets(self.rules, &groups),
            fog: None,
            lod_of: Vec::new(),
        };
        if let Some(lod_of) = lod_of
            && !(instance.receives && self.lod(&mut instance, lod_of))
        {
            findings.add(Finding::LodsOfNothing, &node_name, 1);
            return Ok(());
        }
        if instance.is_flat() {
            findings.add(Finding::FlatInstances, &node_name, 1);
            return Ok(());
        }
        findings.add(Finding::Skins, &node_name, u64::from(node.get("skin").is_some()));
        if instance.receives {
            self.check_color(placement.mesh, &groups)?;
        }
        let variant = self.variant(placement.mesh, groups, findings)?;
        instance.mesh = variant as u32;
        if instance.is_lod() {
            self.gathered.variants[variant].lods.push(self.gathered.instances.len());
        } else {
            self.gathered.variants[variant].instances.push(self.gathered.instances.len());
        }
        self.gathered.instances.push(instance);
        self.fulls.push(placement.fulls.clone());
        Ok(())
    }

    fn read_mesh(&mut self, index: usize, findings: &mut Findings) -> Result<SourceMesh<'d>, SceneError> {
        let missing = || self.document.root().invalid(format!("there is no mesh {index}"));
        let item = self.document.list("meshes")?.get(index).ok_or_else(missing)?;
        let name = name_of(&item, "mesh", index);
        let mut primitives = Vec::new();
        for (index, primitive) in item.list("primitives")?.iter().enumerate() {
            let Some(topology) = Topology::of(&primitive)? else { continue };
            let attributes = primitive.require("attributes")?;
            attributes.object()?;
            extensions::check_primitive(&primitive)?;
            if attributes.get("POSITION").is_none() {
                findings.add(Finding::NoPositions, &name, 1);
                continue;
            }
            findings.add(Finding::MorphTargets, &name, u64::from(primitive.list("targets")?.len() > 0));
            let material = self.material(&primitive)?;
            primitives.push(SourcePrimitive {
                index: index as u32,
                topology,
                mask: material.masked.map(|material| self.masks.of_primitive(&primitive, material)),
                material,
                has_color: attributes.get("COLOR_0").is_some(),
                item: primitive,
            });
        }
        Ok(SourceMesh { class: class_from_extras(&item)?, item, name, primitives })
    }

    fn material(&self, primitive: &Item<'_>) -> Result<Material, SceneError> {
        let Some(reference) = primitive.get("material") else { return Ok(Material::default()) };
        let (index, _) = self.document.list("materials")?.resolve(&reference)?;
        Ok(self.materials[index].clone())
    }

    fn classify(&mut self, node: &Item<'_>, node_name: &str, mesh: usize) -> Result<Groups, SceneError> {
        let mesh = &self.meshes[&mesh];
        let extras = class_from_extras(node)?.or(mesh.class);
        let mut groups = Vec::with_capacity(mesh.primitives.len());
        for primitive in &mesh.primitives {
            let mask = primitive.mask.as_ref().and_then(|mask| mask.as_ref().ok());
            let subject = Subject {
                node: node_name,
                mesh: &mesh.name,
                material: &primitive.material,
                mask: mask.map(|mask| mask.all),
                extras,
            };
            let (class, group, rule) = classify(self.rules.classes, self.rules.foliage, &subject);
            self.used_rules.extend(rule);
            if class == Class::Ignored {
                self.gathered.ignored_faces += stated_face_count(self.document, primitive);
            }
            groups.push((class != Class::Ignored).then_some(group));
        }
        Ok(groups)
    }

    /// Whether `--only` includes the node, the mesh or one of its materials.
    fn is_wanted(&self, node_name: &str, mesh: usize) -> bool {
        let Some(only) = &self.rules.only else { return true };
        let mesh = &self.meshes[&mesh];
        let materials = mesh.primitives.iter().map(|primitive| primitive.material.name.as_str());
        materials.chain([node_name, mesh.name.as_str()]).any(|name| only.is_match(name))
    }

    /// Refuses a COLOR_0 that would have to be changed, where nothing says how.
    fn check_color(&self, mesh: usize, groups: &Groups) -> Result<(), SceneError> {
        if self.rules.output.attribute == Attribute::Ao || self.rules.output.color.is_some() {
            return Ok(());
        }
        let mesh = &self.meshes[&mesh];
        let receives = groups.iter().map(|group| group.as_ref().is_some_and(|group| group.receives));
        match mesh.primitives.iter().zip(receives).find(|(primitive, receives)| *receives && primitive.has_color) {
            None => Ok(()),
            Some((primitive, _)) => Err(SceneError::ColorExists {
                file: primitive.item.file().to_owned(),
                place: format!("{}.attributes.COLOR_0", primitive.item.place()),
                mesh: mesh.name.clone(),
            }),
        }
    }

    fn variant(&mut self, mesh: usize, groups: Groups, findings: &mut Findings) -> Result<usize, SceneError> {
        let key = (mesh, groups);
        if let Some(&variant) = self.variant_of.get(&key) {
            return Ok(variant);
        }
        let source = &self.meshes[&mesh];
        let mut primitives = Vec::new();
        for (primitive, group) in source.primitives.iter().zip(&key.1) {
            let Some(group) = group else { continue };
            let mut opened =
                Primitive::open(self.document, &primitive.item, primitive.index, primitive.topology, group.clone())?;
            match &primitive.mask {
                Some(Ok(mask)) if group.cutout.is_some() => opened.mask = Some(mask.clone()),
                Some(Err(trouble)) => {
                    let subject = trouble.subject(&primitive.material.name);
                    findings.add(Finding::AlphaMask(trouble.problem), &subject, opened.face_count() as u64);
                }
                _ => {}
            }
            primitives.push(opened);
        }
        self.totals.check(&source.item, &primitives)?;
        let variant = Variant {
            source_mesh: mesh,
            name: source.name.clone(),
            primitives,
            instances: Vec::new(),
            lods: Vec::new(),
        };
        self.gathered.variants.push(variant);
        self.variant_of.insert(key, self.gathered.variants.len() - 1);
        Ok(self.gathered.variants.len() - 1)
    }
}

/// What an instance gets: values at its vertices, unless it is foliage, or all of it is instanced.
fn gets(rules: &Rules<'_>, groups: &Groups) -> Gets {
    let mut classes = groups.iter().flatten().filter(|group| group.receives).map(|group| group.class);
    if rules.foliage == FoliageMode::Geometry {
        Gets::Vertices
    } else if classes.clone().all(|class| class == Class::Instanced) {
        Gets::GlobalTraced
    } else if classes.clone().any(|class| class == Class::Tree) {
        match rules.trees {
            TreeValues::Volume => Gets::Global,
            TreeValues::Traced => Gets::GlobalTraced,
        }
    } else if classes.all(|class| matches!(class, Class::Shrub | Class::Decorator)) {
        Gets::Scalar
    } else {
        Gets::Vertices
    }
}

impl Totals {
    /// Adds what a mesh will need, and refuses more than the limits.
    fn check(&mut self, mesh: &Item<'_>, primitives: &[Primitive<'_>]) -> Result<(), SceneError> {
        let blocks: HashMap<usize, u64> =
            primitives.iter().map(|primitive| (primitive.position.index, primitive.position.count as u64)).collect();
        let advice = "split the level";
        self.vertices = blocks.values().fold(self.vertices, |sum, count| sum.saturating_add(*count));
        if self.vertices > limits::VERTICES {
            return Err(mesh.too_big("vertices up to here", self.vertices, limits::VERTICES, advice));
        }
        let faces = primitives.iter().map(|primitive| primitive.face_count() as u64);
        self.faces = faces.fold(self.faces, u64::saturating_add);
        if self.faces > limits::FACES {
            return Err(mesh.too_big("faces up to here", self.faces, limits::FACES, advice));
        }
        Ok(())
    }
}

/// Number of triangles that a primitive says it has; it is ignored, so nothing else of it is looked at.
fn stated_face_count(document: &Document<'_>, primitive: &SourcePrimitive<'_>) -> u64 {
    let corners = primitive.item.get("indices").or_else(|| primitive.item.get("attributes")?.get("POSITION"));
    let count = corners.and_then(|reference| {
        let (_, accessor) = document.list("accessors").ok()?.resolve(&reference).ok()?;
        accessor.get("count")?.index().ok()
    });
    count.map_or(0, |count| primitive.topology.face_count(count) as u64)
}
