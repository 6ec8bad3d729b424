//! EXT_mesh_gpu_instancing: many placements of a node's mesh, from accessors.

use crate::{SceneError, accessor::Accessor, document::Document, json::Item, limits};
use glam::{DAffine3, DQuat, DVec3};

pub(crate) const EXTENSION: &str = "EXT_mesh_gpu_instancing";

/// The instances of one node.
pub(crate) struct GpuInstances {
    /// How many.
    pub(crate) count: usize,
    translations: Option<Vec<[f32; 3]>>,
    rotations: Option<Vec<[f32; 4]>>,
    scales: Option<Vec<[f32; 3]>>,
}

/// Translation, rotation and scale of one instance, relative to its node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placing {
    pub(crate) translation: DVec3,
    pub(crate) rotation: DQuat,
    pub(crate) scale: DVec3,
}

impl Placing {
    pub(crate) fn affine(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

impl GpuInstances {
    /// Reads the instances of a node, if it has the extension; at most `most` of them.
    pub(crate) fn read<'d>(document: &'d Document<'_>, node: &Item<'d>, most: u64) -> Result<Option<Self>, SceneError> {
        let Some(extension) = node.extension(EXTENSION) else { return Ok(None) };
        let attributes = extension.require("attributes")?;
        let mut count = None;
        for key in attributes.object()?.keys() {
            let Some(reference) = attributes.get(key) else { continue };
            let accessor = Accessor::open(document, &reference)?;
            accessor.expect_count(*count.get_or_insert(accessor.count), "another attribute of the instances")?;
        }
        let count = count.ok_or_else(|| attributes.invalid("it has no attributes, so no number of instances"))?;
        if count as u64 > most {
            let advice = "split the level";
            return Err(node.too_big("instances of meshes", count as u64, limits::INSTANCES, advice));
        }
        let open = |key| attributes.get(key).map(|reference| Accessor::open(document, &reference)).transpose();
        Ok(Some(Self {
            count,
            translations: open("TRANSLATION")?.map(|accessor| accessor.vectors()).transpose()?,
            rotations: open("ROTATION")?.map(|accessor| accessor.vectors()).transpose()?,
            scales: open("SCALE")?.map(|accessor| accessor.vectors()).transpose()?,
        }))
    }

    /// Where an instance stands relative to its node; nothing if that is not finite or has a zero rotation.
    pub(crate) fn placing(&self, index: usize) -> Option<Placing> {
        let vector = |values: &Option<Vec<[f32; 3]>>, default| {
            values.as_ref().map_or(default, |values| DVec3::from(values[index].map(f64::from)))
        };
        let rotation = match &self.rotations {
            Some(rotations) => DQuat::from_array(rotations[index].map(f64::from)),
            None => DQuat::IDENTITY,
        };
        let placing = Placing {
            translation: vector(&self.translations, DVec3::ZERO),
            rotation: unit(rotation)?,
            scale: vector(&self.scales, DVec3::ONE),
        };
        (placing.translation.is_finite() && placing.scale.is_finite()).then_some(placing)
    }
}

/// The rotation of a quaternion of any length but zero.
pub(crate) fn unit(rotation: DQuat) -> Option<DQuat> {
    let length = rotation.length();
    if (length - 1.0).abs() < 1e-12 {
        return Some(rotation);
    }
    (length.is_finite() && length > 0.0).then(|| rotation / length)
}
