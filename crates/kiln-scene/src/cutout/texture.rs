//! Which image a material's base colour comes from, how it goes on beyond its edges, and by which coordinates it is looked up.

use super::MaskProblem;
use crate::{
    SceneError, SourceFiles,
    accessor::whole_view,
    document::{Document, name_of, parse_json},
    files::{Uri, decode_data, parse_uri},
    json::Item,
};
use kiln_core::Wrap;
use std::borrow::Cow;

const NEAREST: u64 = 9728;

/// A texture as a material refers to it.
pub(super) struct Texture<'d> {
    /// Index of the image.
    pub(super) image: usize,
    /// Its file, its name, or `image N`.
    pub(super) image_name: String,
    item: Item<'d>,
    pub(super) wrap: [Wrap; 2],
    /// Seen near by, texels have edges.
    pub(super) is_nearest: bool,
    /// N of TEXCOORD_N.
    pub(super) set: u64,
    pub(super) transform: UvTransform,
}

impl<'d> Texture<'d> {
    /// From a material's texture info.
    pub(super) fn read(document: &'d Document<'_>, info: &Item<'d>) -> Result<Self, SceneError> {
        let (_, texture) = document.list("textures")?.resolve(&info.require("index")?)?;
        let source = source_of(&texture).ok_or_else(|| texture.invalid("source is missing"))?;
        let (image, item) = document.list("images")?.resolve(&source)?;
        let sampler = texture.get("sampler").map(|sampler| document.list("samplers")?.resolve(&sampler)).transpose()?;
        let sampler = sampler.map(|(_, sampler)| sampler);
        let wrap =
            |key| sampler.as_ref().and_then(|sampler| sampler.get(key)).map_or(Ok(Wrap::Repeat), |item| wrap(&item));
        let filter = sampler.as_ref().and_then(|sampler| sampler.get("magFilter"));
        let own = info.get("texCoord").map_or(Ok(0), |set| set.integer())?;
        let extension = info.extension("KHR_texture_transform");
        let other = extension.as_ref().and_then(|extension| extension.get("texCoord"));
        Ok(Self {
            image,
            image_name: image_name(&item, image),
            item,
            wrap: [wrap("wrapS")?, wrap("wrapT")?],
            is_nearest: filter.map_or(Ok(0), |filter| filter.integer())? == NEAREST,
            set: other.map_or(Ok(own), |set| set.integer())?,
            transform: extension.map_or(Ok(UvTransform::NONE), |extension| UvTransform::read(&extension))?,
        })
    }

    /// The bytes of the image.
    pub(super) fn bytes<'f>(
        &self,
        document: &'f Document<'_>,
        files: &'f dyn SourceFiles,
    ) -> Result<Cow<'f, [u8]>, MaskProblem>
    where
        'd: 'f,
    {
        if let Some(uri) = self.item.get("uri") {
            return match parse_uri(&uri) {
                Ok(Uri::Data(rest)) => decode_data(rest).map(Cow::Owned).map_err(|_| MaskProblem::Undecodable),
                Ok(Uri::File(path)) => files.read(&path).ok_or(MaskProblem::MissingImage),
                Err(_) => Err(MaskProblem::MissingImage),
            };
        }
        let view = self.item.get("bufferView").ok_or(MaskProblem::Malformed)?;
        whole_view(document, &view).map(Cow::Borrowed).map_err(|_| MaskProblem::Malformed)
    }
}

/// The reference of a texture to its image. Formats of extensions come last: where there is another image, it is for those who
/// don't know them.
fn source_of<'d>(texture: &Item<'d>) -> Option<Item<'d>> {
    let of_extension = || {
        let names = ["EXT_texture_webp", "KHR_texture_basisu", "MSFT_texture_dds"];
        names.into_iter().find_map(|name| texture.extension(name)?.get("source"))
    };
    texture.get("source").or_else(of_extension)
}

fn wrap(item: &Item<'_>) -> Result<Wrap, SceneError> {
    match item.integer()? {
        10497 => Ok(Wrap::Repeat),
        33648 => Ok(Wrap::Mirrored),
        33071 => Ok(Wrap::Clamp),
        other => Err(item.invalid(format!("{other} is not a way to wrap a texture"))),
    }
}

/// The file of an image, shortened if that is long; else its name.
fn image_name(item: &Item<'_>, index: usize) -> String {
    const LONGEST: usize = 80;
    let uri = item.get("uri").and_then(|uri| uri.string().ok());
    match uri.filter(|uri| !uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"))) {
        Some(uri) => uri.chars().take(LONGEST).collect(),
        None => name_of(item, "image", index),
    }
}

/// What becomes of texture coordinates (KHR_texture_transform).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UvTransform {
    offset: [f64; 2],
    /// Radians, counter-clockwise where v points down.
    rotation: f64,
    scale: [f64; 2],
}

impl UvTransform {
    pub(crate) const NONE: Self = Self { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2] };

    fn read(item: &Item<'_>) -> Result<Self, SceneError> {
        let pair = |key, default| item.get(key).map_or(Ok(default), |value| value.numbers::<2>());
        let rotation = item.get("rotation").map_or(Ok(0.0), |value| value.number())?;
        Ok(Self { offset: pair("offset", [0.0; 2])?, rotation, scale: pair("scale", [1.0; 2])? })
    }

    /// Scaled, turned and moved, in this order. The sense of rotation is that of the extension's text and of the viewers and
    /// its test model, not that of the matrix in it, which turns the other way (glTF issue 1563). What is not finite is 0.
    pub(crate) fn apply(&self, uv: [f32; 2]) -> [f32; 2] {
        let [u, v] = [0, 1].map(|axis| f64::from(uv[axis]) * self.scale[axis]);
        let (sin, cos) = self.rotation.sin_cos();
        let turned = [cos * u + sin * v, cos * v - sin * u];
        [0, 1].map(|axis| {
            let moved = (turned[axis] + self.offset[axis]) as f32;
            if moved.is_finite() { moved + 0.0 } else { 0.0 }
        })
    }
}

/// Paths of the images that alpha-tested materials of a level look at, relative to its folder, each once. Other images are
/// not read; what is wrong with one of these is found when it is.
pub(crate) fn mask_files(level_name: &str, level_bytes: &[u8]) -> Result<Vec<String>, SceneError> {
    let (root, _) = parse_json(level_name, level_bytes)?;
    let root = Item::root(level_name, &root);
    let mut paths: Vec<String> = Vec::new();
    for material in root.list("materials")?.iter() {
        if let Some(path) = mask_file(&root, &material)
            && !paths.contains(&path)
        {
            paths.push(path);
        }
    }
    Ok(paths)
}

fn mask_file(root: &Item<'_>, material: &Item<'_>) -> Option<String> {
    if material.get("alphaMode")?.string().ok()? != "MASK" {
        return None;
    }
    let index = material.get("pbrMetallicRoughness")?.get("baseColorTexture")?.get("index")?;
    let (_, texture) = root.list("textures").ok()?.resolve(&index).ok()?;
    let (_, image) = root.list("images").ok()?.resolve(&source_of(&texture)?).ok()?;
    match parse_uri(&image.get("uri")?) {
        Ok(Uri::File(path)) => Some(path),
        _ => None,
    }
}
