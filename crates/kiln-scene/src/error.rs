//! Why a level is refused: always the file, the place in it, what is wrong and what to do.

/// What a caller should make of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// The input is refused (exit code 3).
    Refused,
    /// A setting has a value that it can't have (exit code 2).
    Usage,
    /// The caller passed what doesn't belong together: a defect of Kiln or a damaged artefact (exit code 1).
    Internal,
}

/// An error of import, export or of reading a baked file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SceneError {
    /// The container or its JSON can't be read.
    #[error("{file} can't be read as glTF 2.0: {problem}; {advice}")]
    Malformed {
        /// The file.
        file: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        advice: &'static str,
    },
    /// Something in the document is against the format, or can't be baked.
    #[error("{file}: {place}: {problem}; {advice}")]
    Invalid {
        /// The file.
        file: String,
        /// Where in the document, such as `meshes[3].primitives[0].indices (accessor 7)`.
        place: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        advice: &'static str,
    },
    /// The document can't be read without an extension that Kiln doesn't support.
    #[error("{file}: {place}: needs the glTF extension {extension}, which is not supported; {advice}")]
    Extension {
        /// The file.
        file: String,
        /// Where the extension is used or required.
        place: String,
        /// The extension's name.
        extension: String,
        /// What to do.
        advice: &'static str,
    },
    /// A URI that leads outside the level's folder, or is none that can be read.
    #[error(
        "{file}: {place}: the URI {uri:?} {problem}; put the file into the level's folder and refer to it by a \
         relative path"
    )]
    Path {
        /// The file.
        file: String,
        /// Where the URI stands.
        place: String,
        /// The URI, shortened if long.
        uri: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A file that the level refers to is not there.
    #[error("{file}: {place}: the file {path:?} is missing; put it beside the level or export the level as .glb")]
    MissingFile {
        /// The file that refers to it.
        file: String,
        /// Where it refers to it.
        place: String,
        /// The missing file.
        path: String,
    },
    /// More of something than Kiln takes.
    #[error("{file}: {place}: {found} {what}, which is more than the limit of {limit}; {advice}")]
    TooBig {
        /// The file.
        file: String,
        /// Where.
        place: String,
        /// What there is too much of.
        what: &'static str,
        /// How much there is.
        found: u64,
        /// How much there may be.
        limit: u64,
        /// What to do.
        advice: &'static str,
    },
    /// The sidecar is wrong.
    #[error("{file}:{line}: {problem}; {advice}")]
    Sidecar {
        /// The sidecar's name.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        problem: String,
        /// What to do.
        advice: String,
    },
    /// A setting has a value that it can't have.
    #[error("{setting}: {problem}")]
    Setting {
        /// The option as a person writes it, such as `--rays`.
        setting: &'static str,
        /// What is wrong, and what it may be.
        problem: String,
    },
    /// COLOR_0 is to be written where one exists, and nothing says what to do with it.
    #[error(
        "{file}: {place}: mesh {mesh:?} has a COLOR_0 already; say --color multiply or --color replace, or write \
         --attribute ao alone"
    )]
    ColorExists {
        /// The file.
        file: String,
        /// The attribute.
        place: String,
        /// Name of the mesh.
        mesh: String,
    },
    /// The values to export don't belong to the level, or the level doesn't belong to the file.
    #[error("instance {instance} of the level: {problem}; its artefacts are damaged or of another level: bake again")]
    Mismatch {
        /// Index of the instance.
        instance: usize,
        /// What doesn't fit.
        problem: String,
    },
}

impl SceneError {
    /// What a caller should make of it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Setting { .. } => ErrorKind::Usage,
            Self::Mismatch { .. } => ErrorKind::Internal,
            _ => ErrorKind::Refused,
        }
    }
}
