//! The source of a bake.

use crate::{
    field::{FieldError, at_most, digest, required, text},
    limits, v1,
};
use kiln_core::{BakeSettings, SourceFile, SourceManifest};

impl From<&SourceManifest> for v1::BakeSource {
    fn from(source: &SourceManifest) -> Self {
        Self {
            files: source.files.iter().map(Into::into).collect(),
            sidecar: source.sidecar.as_ref().map(Into::into),
            settings: Some((&source.settings).into()),
        }
    }
}

impl TryFrom<v1::BakeSource> for SourceManifest {
    type Error = FieldError;

    fn try_from(source: v1::BakeSource) -> Result<Self, FieldError> {
        at_most("files", source.files.len(), limits::SOURCE_FILES)?;
        if source.files.is_empty() {
            return Err(FieldError::new("files", "is empty; the level file comes first"));
        }
        let files = source.files.into_iter().enumerate();
        let files = files.map(|(i, file)| SourceFile::try_from(file).map_err(|e| e.within(&format!("files[{i}]"))));
        let sidecar = source.sidecar.map(SourceFile::try_from).transpose().map_err(|e| e.within("sidecar"))?;
        let settings = source.settings.unwrap_or_default();
        Ok(Self {
            files: files.collect::<Result<_, _>>()?,
            sidecar,
            settings: BakeSettings::try_from(settings).map_err(|e| e.within("settings"))?,
        })
    }
}

impl From<&SourceFile> for v1::SourceFile {
    fn from(file: &SourceFile) -> Self {
        Self { path: file.path.clone(), digest: file.digest.0.to_vec() }
    }
}

impl TryFrom<v1::SourceFile> for SourceFile {
    type Error = FieldError;

    fn try_from(file: v1::SourceFile) -> Result<Self, FieldError> {
        let digest = digest("digest", &file.digest)?;
        text("path", &file.path, limits::PATH_BYTES)?;
        let outside = file.path.starts_with('/') || file.path.split('/').any(|part| part == "..");
        if file.path.is_empty() || outside {
            let problem = format!("is {:?}; it must be relative and stay in the level's folder", file.path);
            return Err(FieldError::new("path", problem));
        }
        Ok(Self { path: file.path, digest })
    }
}

/// The source of a submission.
pub(crate) fn source(source: Option<v1::BakeSource>) -> Result<SourceManifest, FieldError> {
    required("source", source)?.try_into().map_err(|e: FieldError| e.within("source"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::Digest;

    #[test]
    fn a_source_and_back() {
        let file = |path: &str| SourceFile { path: path.into(), digest: Digest::of(path.as_bytes()) };
        let source = SourceManifest {
            files: vec![file("level.gltf"), file("bin/a..b.bin")],
            sidecar: Some(file("level.kiln.toml")),
            settings: BakeSettings { seed: 7, ..Default::default() },
        };
        assert_eq!(SourceManifest::try_from(v1::BakeSource::from(&source)), Ok(source));
    }

    #[test]
    fn paths_stay_in_the_folder() {
        for path in ["", "/etc/passwd", "..", "a/../../b", "a\0b"] {
            let file = v1::SourceFile { path: path.into(), digest: vec![0; 32] };
            let source = v1::BakeSource { files: vec![file], ..Default::default() };
            assert_eq!(SourceManifest::try_from(source).unwrap_err().field, "files[0].path", "{path:?}");
        }
    }

    #[test]
    fn absent_settings_are_the_defaults() {
        let file = v1::SourceFile { path: "a.glb".into(), digest: vec![0; 32] };
        let source = v1::BakeSource { files: vec![file], ..Default::default() };
        assert_eq!(SourceManifest::try_from(source).unwrap().settings, BakeSettings::default());
    }
}
