//! Alpha-tested materials (glTF 2.0, section 3.9.4, `alphaMode: MASK`): from a material to the mask that rays look at.
//!
//! The path of the data is [`texture`] (which image, how it is wrapped, which coordinates) → [`image`] (bytes to alpha) →
//! [`threshold`] (alpha to a bit for each texel). COLOR_0 is not looked at: its alpha counts as 1. Nothing here refuses a
//! level: where there is no mask to be had, a [`MaskTrouble`] says why, and the faces have no holes.

mod image;
#[cfg(test)]
mod tests;
mod texture;
mod threshold;

pub(crate) use texture::{UvTransform, mask_files};

use crate::{SourceFiles, accessor::Accessor, document::Document, json::Item, limits};
use image::Picture;
use kiln_core::{Mask, Wrap};
use std::{collections::HashMap, sync::Arc};
use texture::Texture;

/// Why a material's texture is not looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum MaskProblem {
    /// The document doesn't describe it as glTF demands.
    Malformed,
    /// There is no such file in the level's folder.
    MissingImage,
    /// It is neither PNG nor JPEG.
    Format,
    /// The image is damaged.
    Undecodable,
    /// More pixels than Kiln takes.
    TooLarge,
    /// The primitive has no texture coordinates that could be used.
    NoCoordinates,
}

/// A problem, and the image that it is about, if it is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct MaskTrouble {
    pub(crate) problem: MaskProblem,
    pub(crate) image: Option<String>,
}

impl MaskTrouble {
    /// What a warning names.
    pub(crate) fn subject(&self, material: &str) -> String {
        self.image.as_ref().map_or_else(|| material.to_owned(), |image| format!("{material} (image {image:?})"))
    }
}

impl From<MaskProblem> for MaskTrouble {
    fn from(problem: MaskProblem) -> Self {
        Self { problem, image: None }
    }
}

/// The mask of a material.
#[derive(Clone, Debug)]
pub(crate) struct MaterialMask {
    pub(crate) mask: Arc<Mask>,
    /// What all of it is, if it is the same everywhere; texture coordinates have no say then.
    pub(crate) all: Option<bool>,
    set: u64,
    transform: UvTransform,
    image: Option<String>,
}

/// The mask of a primitive.
#[derive(Clone)]
pub(crate) struct PrimitiveMask<'d> {
    pub(crate) mask: Arc<Mask>,
    /// What all of it is, if it is the same everywhere.
    pub(crate) all: Option<bool>,
    /// Texture coordinates of the vertices, and what becomes of them; none where they have no say.
    pub(crate) coordinates: Option<(Accessor<'d>, UvTransform)>,
}

/// Reads masks, each material's once; materials that look the same at the same image share one.
pub(crate) struct MaskReader<'d, 'b, 'r> {
    document: &'d Document<'b>,
    files: &'r dyn SourceFiles,
    of_material: HashMap<usize, Result<MaterialMask, MaskTrouble>>,
    known: HashMap<Appearance, (Arc<Mask>, Option<bool>)>,
    pixels: u64,
}

/// What a mask depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Appearance {
    image: usize,
    wrap: [Wrap; 2],
    is_nearest: bool,
    factor: u64,
    cutoff: u64,
}

impl<'d, 'b, 'r> MaskReader<'d, 'b, 'r> {
    pub(crate) fn new(document: &'d Document<'b>, files: &'r dyn SourceFiles) -> Self {
        Self { document, files, of_material: HashMap::new(), known: HashMap::new(), pixels: 0 }
    }

    /// The mask of a primitive whose material, by index, has the alpha mode MASK.
    pub(crate) fn of_primitive(
        &mut self,
        primitive: &Item<'d>,
        material: usize,
    ) -> Result<PrimitiveMask<'d>, MaskTrouble> {
        if !self.of_material.contains_key(&material) {
            let read = self.of_material(material);
            self.of_material.insert(material, read);
        }
        let of_material = self.of_material[&material].clone()?;
        let coordinates = match of_material.all {
            Some(_) => None,
            None => Some((coordinates(self.document, primitive, &of_material)?, of_material.transform)),
        };
        Ok(PrimitiveMask { mask: of_material.mask, all: of_material.all, coordinates })
    }

    fn of_material(&mut self, index: usize) -> Result<MaterialMask, MaskTrouble> {
        let malformed = |_| MaskProblem::Malformed;
        let item = self.document.list("materials").map_err(malformed)?.get(index).ok_or(MaskProblem::Malformed)?;
        let number = |value: Option<Item<'_>>, default| value.map_or(Ok(default), |value| value.number());
        let cutoff = number(item.get("alphaCutoff"), 0.5).map_err(malformed)?;
        let base = item.get("pbrMetallicRoughness");
        let factor = base.as_ref().and_then(|base| base.get("baseColorFactor"));
        let factor = factor.map_or(Ok(1.0), |factor| factor.numbers::<4>().map(|color| color[3])).map_err(malformed)?;
        let factor = factor.clamp(0.0, 1.0);
        let Some(info) = base.and_then(|base| base.get("baseColorTexture")) else {
            return Ok(MaterialMask::uniform(factor >= cutoff, None));
        };
        let texture = Texture::read(self.document, &info).map_err(malformed)?;
        let image = texture.image_name.clone();
        let trouble = |problem| MaskTrouble { problem, image: Some(image.clone()) };
        let appearance = Appearance {
            image: texture.image,
            wrap: texture.wrap,
            is_nearest: texture.is_nearest,
            factor: factor.to_bits(),
            cutoff: cutoff.to_bits(),
        };
        let (mask, all) = match self.known.get(&appearance) {
            Some(known) => known.clone(),
            None => {
                let mask = self.mask(&texture, factor, cutoff).map_err(trouble)?;
                let new = (Arc::new(mask.clone()), mask.all());
                self.known.insert(appearance, new.clone());
                new
            }
        };
        Ok(MaterialMask { mask, all, set: texture.set, transform: texture.transform, image: Some(image) })
    }

    fn mask(&mut self, texture: &Texture<'d>, factor: f64, cutoff: f64) -> Result<Mask, MaskProblem> {
        let bytes = texture.bytes(self.document, self.files)?;
        let left = limits::LEVEL_PIXELS.saturating_sub(self.pixels);
        let picture = image::read(&bytes, limits::IMAGE_PIXELS.min(left))?;
        Ok(match picture {
            Picture::Opaque => Mask::uniform(factor >= cutoff),
            Picture::Alpha(alpha) => {
                self.pixels += alpha.pixels();
                threshold::mask(&alpha, texture.wrap, texture.is_nearest, factor, cutoff)
            }
        })
    }
}

impl MaterialMask {
    fn uniform(is_opaque: bool, image: Option<String>) -> Self {
        let mask = Arc::new(Mask::uniform(is_opaque));
        Self { mask, all: Some(is_opaque), set: 0, transform: UvTransform::NONE, image }
    }
}

/// The texture coordinates of a primitive.
fn coordinates<'d>(
    document: &'d Document<'_>,
    primitive: &Item<'d>,
    mask: &MaterialMask,
) -> Result<Accessor<'d>, MaskTrouble> {
    let open = || {
        let attributes = primitive.get("attributes")?;
        let coordinates = Accessor::open(document, &attributes.get(&format!("TEXCOORD_{}", mask.set))?).ok()?;
        let positions = Accessor::open(document, &attributes.get("POSITION")?).ok()?;
        let is_good = coordinates.expect_width(&[2]).is_ok() && coordinates.count == positions.count;
        // So that what is wrong with its values is found before anything depends on them.
        (is_good && coordinates.vectors::<2>().is_ok()).then_some(coordinates)
    };
    open().ok_or_else(|| MaskTrouble { problem: MaskProblem::NoCoordinates, image: mask.image.clone() })
}
