//! Which glTF extensions a level may require. Those that change nothing of the geometry are harmless; of those
//! that do, Kiln knows a few; a level that requires any other is refused by the extension's name.

use crate::{SceneError, document::Document, json::Item};

/// Extensions that Kiln honours.
const HONOURED: [&str; 3] = ["KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "KHR_node_visibility"];

/// Extensions, or families of them, that say nothing about where triangles are.
const HARMLESS: [&str; 18] = [
    "KHR_materials_",
    "EXT_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_dds",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_animation_",
    "KHR_xmp",
    "KHR_audio",
    "KHR_interactivity",
    "KHR_physics_",
    "KHR_node_selectability",
    "KHR_node_hoverability",
    "EXT_structural_metadata",
    "EXT_mesh_features",
    "CESIUM_RTC",
    "MSFT_lod",
];

/// Refuses a level that requires what Kiln doesn't know.
pub(crate) fn check_required(document: &Document<'_>) -> Result<(), SceneError> {
    for item in document.list("extensionsRequired")?.iter() {
        let name = item.string()?;
        if !HONOURED.contains(&name) && !HARMLESS.iter().any(|harmless| name.starts_with(harmless)) {
            return Err(item.extension_error(name, advice(name)));
        }
    }
    Ok(())
}

/// Refuses a primitive whose vertices are (also) in a Draco stream: decoders return them in an order of their own,
/// so that values for each vertex would go astray.
pub(crate) fn check_primitive(primitive: &Item<'_>) -> Result<(), SceneError> {
    let name = "KHR_draco_mesh_compression";
    if primitive.extension(name).is_some() { Err(primitive.extension_error(name, advice(name))) } else { Ok(()) }
}

/// What to do about an extension that isn't supported.
pub(crate) fn advice(name: &str) -> &'static str {
    match name {
        "KHR_draco_mesh_compression" => {
            "export the level without Draco compression, or decode it with `gltf-transform copy`, and compress the \
             baked file"
        }
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "export the level without meshopt compression, or decode it with `gltf-transform copy`, and compress the \
             baked file"
        }
        _ => "export the level without it",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn check(names: &str) -> Result<(), SceneError> {
        let text = format!(r#"{{"asset":{{"version":"2.0"}},"extensionsRequired":{names}}}"#);
        let files = BTreeMap::<String, Vec<u8>>::new();
        check_required(&Document::parse("l.gltf", text.as_bytes(), &files)?)
    }

    #[test]
    fn required_extensions() {
        let good = r#"["KHR_mesh_quantization", "KHR_materials_transmission", "KHR_texture_transform"]"#;
        assert_eq!(check(good), Ok(()));
        for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_warp", "KHR_gaussian_splatting"] {
            let error = check(&format!("[{name:?}]")).unwrap_err();
            assert!(matches!(&error, SceneError::Extension { extension, .. } if extension == name), "{error}");
        }
        assert!(check("[1]").is_err());
    }
}
