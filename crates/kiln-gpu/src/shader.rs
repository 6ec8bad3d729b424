//! Shaders from their sources. WGSL has no includes: a kernel's modules are joined, after a prelude that is
//! made for the shape of the scene.

use crate::foliage::FoliageShape;
use std::fmt::Write;

/// The kernels, by entry point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Entry {
    Gather,
    Values,
    Trace,
    AnyHit,
    Visits,
    Directions,
    HitValues,
    Rounds,
}

impl Entry {
    #[cfg(test)]
    pub(crate) const ALL: [Self; 8] = [
        Self::Gather,
        Self::Values,
        Self::Trace,
        Self::AnyHit,
        Self::Visits,
        Self::Directions,
        Self::HitValues,
        Self::Rounds,
    ];

    /// The entry point's name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Gather => "gather",
            Self::Values => "ray_values",
            Self::Trace => "trace",
            Self::AnyHit => "any_hit",
            Self::Visits => "count_visits",
            Self::Directions => "directions",
            Self::HitValues => "hit_values",
            Self::Rounds => "rounds",
        }
    }

    /// Whether it reads a scene.
    pub(crate) fn is_traced(self) -> bool {
        !matches!(self, Self::Directions | Self::HitValues | Self::Rounds)
    }

    /// Whether it values rays, and so reads foliage.
    fn is_valued(self) -> bool {
        matches!(self, Self::Gather | Self::Values)
    }

    fn modules(self, shape: &SceneShape, subgroups: bool) -> Vec<&'static str> {
        const SAMPLING: &str = include_str!("sampling.wgsl");
        const KERNEL: &str = include_str!("kernel.wgsl");
        const RAYS: &str = include_str!("rays.wgsl");
        let own: &[&str] = match self {
            Self::Gather if subgroups => {
                &[SAMPLING, KERNEL, include_str!("gather.wgsl"), include_str!("reduce_subgroup.wgsl")]
            }
            Self::Gather => &[SAMPLING, KERNEL, include_str!("gather.wgsl"), include_str!("reduce.wgsl")],
            Self::Values => &[KERNEL, include_str!("values.wgsl")],
            Self::Trace => &[RAYS, include_str!("trace.wgsl")],
            Self::AnyHit => &[RAYS, include_str!("any_hit.wgsl")],
            Self::Visits => &[RAYS, include_str!("visits.wgsl")],
            Self::Directions | Self::HitValues | Self::Rounds => &[SAMPLING, KERNEL, include_str!("probe.wgsl")],
        };
        if self.is_traced() { [&self.traced_modules(shape)[..], own].concat() } else { own.to_vec() }
    }

    /// What kernels that read a scene have in common.
    fn traced_modules(self, shape: &SceneShape) -> Vec<&'static str> {
        const SCENE: [&str; 2] = [include_str!("scene.wgsl"), include_str!("triangle.wgsl")];
        const WALK: [&str; 2] = [include_str!("node.wgsl"), include_str!("stack.wgsl")];
        const VALUE: &str = include_str!("value.wgsl");
        const FOLIAGE: &str = include_str!("foliage.wgsl");
        let way = if shape.ray_queries { include_str!("ray_query.wgsl") } else { include_str!("traverse.wgsl") };
        let walk = if self.walks(shape) { &WALK[..] } else { &[] };
        let value: &[&str] = match shape.foliage {
            _ if !self.is_valued() => &[],
            FoliageShape::Nothing => &[VALUE, include_str!("no_foliage.wgsl")],
            FoliageShape::Attenuate => &[VALUE, FOLIAGE, include_str!("attenuate.wgsl")],
            FoliageShape::Expected => &[VALUE, FOLIAGE, include_str!("expected.wgsl")],
        };
        [&SCENE[..], walk, &[way], value].concat()
    }

    /// Whether it goes through a tree of our own.
    fn walks(self, shape: &SceneShape) -> bool {
        !shape.ray_queries || (self.is_valued() && shape.foliage != FoliageShape::Nothing)
    }
}

/// What of a scene its shaders are made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct SceneShape {
    /// Storage bindings that the geometry is spread over, at least 1.
    pub(crate) bindings: u32,
    /// Each binding but the last holds `2^binding_shift` words of 16 bytes.
    pub(crate) binding_shift: u32,
    /// Entries of the traversal stack; 0 with ray queries, which need none, unless there is foliage.
    pub(crate) stack_entries: u32,
    /// Whether boxes are found by hardware ray queries.
    pub(crate) ray_queries: bool,
    pub(crate) foliage: FoliageShape,
}

impl SceneShape {
    /// The binding of the acceleration structure, behind the geometry.
    pub(crate) fn structure_binding(&self) -> u32 {
        self.bindings + 1
    }
}

/// The whole source of a kernel. `shape` is not looked at by kernels that read no scene; `subgroups` says whether the
/// kernel may use them.
pub(crate) fn source(entry: Entry, shape: &SceneShape, subgroups: bool) -> String {
    let mut text = if entry.is_traced() { prelude(entry, shape) } else { String::new() };
    for module in entry.modules(shape, subgroups) {
        text.push_str(module);
        text.push('\n');
    }
    text
}

/// Declares the kernel's switches, the scene's bindings, and `geometry`, which makes one array of them.
fn prelude(entry: Entry, shape: &SceneShape) -> String {
    let mut text = traversal_prelude(entry, shape);
    let _ = write!(
        text,
        "const ANY_HIT: bool = {};\nconst COUNT_VISITS: bool = {};\n\
         @group(1) @binding(0) var<uniform> scene: SceneInfo;\n",
        entry == Entry::AnyHit,
        entry == Entry::Visits,
    );
    let array = |i: u32| format!("@group(1) @binding({}) var<storage, read> geometry_{i}: array<vec4<u32>>;\n", i + 1);
    text.extend((0..shape.bindings).map(array));
    text.push_str("fn geometry(word: u32) -> vec4<u32> {\n");
    if shape.bindings == 1 {
        text.push_str("    return geometry_0[word];\n}\n");
        return text;
    }
    let (shift, mask) = (shape.binding_shift, (1u64 << shape.binding_shift) - 1);
    let _ = writeln!(text, "    switch word >> {shift}u {{");
    for i in 0..shape.bindings {
        let case = if i + 1 < shape.bindings { format!("case {i}u:") } else { "default".to_owned() };
        let _ = writeln!(text, "        {case} {{ return geometry_{i}[word & {mask}u]; }}");
    }
    text.push_str("    }\n}\n");
    text
}

/// Declares what one way of traversal needs. A directive comes before all else.
fn traversal_prelude(entry: Entry, shape: &SceneShape) -> String {
    let mut text = String::new();
    if shape.ray_queries {
        let binding = shape.structure_binding();
        let _ = writeln!(text, "enable wgpu_ray_query;");
        let _ = writeln!(text, "@group(1) @binding({binding}) var boxes: acceleration_structure;");
    }
    if entry.walks(shape) {
        let _ = writeln!(text, "const STACK_ENTRIES: u32 = {}u;", shape.stack_entries);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use wgpu::naga;

    fn check(entry: Entry, shape: &SceneShape, subgroups: bool) {
        use naga::valid::{Capabilities, ShaderStages, SubgroupOperationSet, ValidationFlags, Validator};
        let text = source(entry, shape, subgroups);
        let module = naga::front::wgsl::parse_str(&text)
            .unwrap_or_else(|error| panic!("{}: {}", entry.name(), error.emit_to_string(&text)));
        let mut capabilities = if subgroups { Capabilities::SUBGROUP } else { Capabilities::empty() };
        capabilities.set(Capabilities::RAY_QUERY, shape.ray_queries);
        Validator::new(ValidationFlags::all(), capabilities)
            .subgroup_stages(ShaderStages::COMPUTE)
            .subgroup_operations(SubgroupOperationSet::all())
            .validate(&module)
            .unwrap_or_else(|error| panic!("{}: {}", entry.name(), error.emit_to_string(&text)));
        let point = module.entry_points.iter().find(|point| point.name == entry.name()).expect("an entry point");
        assert_eq!(point.workgroup_size, [crate::gather::LANES, 1, 1]);
    }

    #[test]
    fn every_shader_is_valid() {
        let sizes = [(1, 31, 4, false), (2, 23, 12, false), (8, 27, 40, false), (1, 31, 8, true), (3, 20, 16, true)];
        for entry in Entry::ALL {
            for (bindings, binding_shift, stack_entries, ray_queries) in sizes {
                for foliage in [FoliageShape::Nothing, FoliageShape::Attenuate, FoliageShape::Expected] {
                    let needs_stack = !ray_queries || foliage != FoliageShape::Nothing;
                    let stack_entries = if needs_stack { stack_entries } else { 0 };
                    let shape = SceneShape { bindings, binding_shift, stack_entries, ray_queries, foliage };
                    [false, true].into_iter().for_each(|subgroups| check(entry, &shape, subgroups));
                }
            }
        }
    }

    /// Kernels of scenes without foliage have nothing of it.
    #[test]
    fn foliage_is_compiled_where_there_is_any() {
        let shape =
            |foliage| SceneShape { bindings: 1, binding_shift: 31, stack_entries: 4, ray_queries: false, foliage };
        for entry in Entry::ALL {
            let text = |foliage| source(entry, &shape(foliage), false);
            assert!(!text(FoliageShape::Nothing).contains("walk_foliage"), "{}", entry.name());
            let is_valued = text(FoliageShape::Expected).contains("walk_foliage");
            assert_eq!(is_valued, matches!(entry, Entry::Gather | Entry::Values), "{}", entry.name());
        }
    }
}
