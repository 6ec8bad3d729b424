//! What materials say about rays: which sides of a face count, and whether it stops light.

use crate::{
    SceneError,
    classes::class_from_extras,
    document::{Document, name_of},
    json::Item,
};
use kiln_core::Class;

/// A material, as far as the bake is concerned.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Material {
    /// Name, or `material N`; empty for faces without a material.
    pub(crate) name: String,
    /// Both sides are seen.
    pub(crate) double_sided: bool,
    /// Light comes through (alphaMode BLEND, or KHR_materials_transmission): it doesn't occlude.
    pub(crate) transparent: bool,
    /// Its index, if a texture decides where the face is (alphaMode MASK).
    pub(crate) masked: Option<usize>,
    /// A class from the material's extras.
    pub(crate) class: Option<Class>,
}

/// All materials of a document.
pub(crate) fn materials(document: &Document<'_>) -> Result<Vec<Material>, SceneError> {
    document.list("materials")?.iter().enumerate().map(|(index, item)| read(&item, index)).collect()
}

fn read(item: &Item<'_>, index: usize) -> Result<Material, SceneError> {
    let mode = item.get("alphaMode");
    let mode = match &mode {
        None => "OPAQUE",
        Some(mode) => mode.string()?,
    };
    let factor = item.extension("KHR_materials_transmission").and_then(|e| e.get("transmissionFactor"));
    let transmission = factor.map_or(Ok(0.0), |factor| factor.number())?;
    Ok(Material {
        name: name_of(item, "material", index),
        double_sided: item.get("doubleSided").map_or(Ok(false), |value| value.boolean())?,
        transparent: mode == "BLEND" || transmission > 0.0,
        masked: (mode == "MASK").then_some(index),
        class: class_from_extras(item)?,
    })
}
