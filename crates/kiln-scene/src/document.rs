//! A glTF document in memory: its JSON as it stands, and the bytes of its buffers. Nothing is validated but what
//! Kiln reads; all else is left for the output as it is.

use crate::{
    SceneError, SourceFiles,
    files::{Uri, decode_data, parse_uri},
    glb::{Glb, OtherChunk, is_glb},
    json::{EXPORT_AGAIN, Item, List},
    limits,
};
use serde_json::Value;
use std::borrow::Cow;

/// Where the bytes of a buffer come from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Bytes<'a> {
    /// The container's binary chunk.
    Chunk(&'a [u8]),
    /// A file of its own, or a data URI.
    Uri(Cow<'a, [u8]>),
    /// No bytes: only an extension would say what stands in it.
    None,
}

impl Bytes<'_> {
    pub(crate) fn get(&self) -> Option<&[u8]> {
        match self {
            Self::Chunk(bytes) => Some(bytes),
            Self::Uri(bytes) => Some(bytes),
            Self::None => None,
        }
    }
}

/// A buffer: its bytes, and how many of them count.
pub(crate) struct Buffer<'a> {
    /// All bytes, at least `byte_length` of them.
    pub(crate) bytes: Bytes<'a>,
    /// The stated length.
    pub(crate) byte_length: usize,
}

/// A document with its buffers.
pub(crate) struct Document<'a> {
    file: &'a str,
    pub(crate) root: Value,
    pub(crate) buffers: Vec<Buffer<'a>>,
    /// The binary chunk, even where no buffer refers to it.
    pub(crate) chunk: Option<&'a [u8]>,
    /// Chunks that glTF doesn't define.
    pub(crate) other_chunks: Vec<OtherChunk<'a>>,
    /// Bytes after the container's end.
    pub(crate) bytes_after_end: usize,
}

/// Paths of the buffers that a level file refers to, relative to its folder, each once, in order.
pub fn external_files(level_name: &str, level_bytes: &[u8]) -> Result<Vec<String>, SceneError> {
    let (root, _) = parse_json(level_name, level_bytes)?;
    let mut paths: Vec<String> = Vec::new();
    for buffer in Item::root(level_name, &root).list("buffers")?.iter() {
        let Some(uri) = buffer.get("uri") else { continue };
        if let Uri::File(path) = parse_uri(&uri)?
            && !paths.contains(&path)
        {
            paths.push(path);
        }
    }
    Ok(paths)
}

/// The level file itself.
pub(crate) fn read_level<'a>(name: &str, files: &'a dyn SourceFiles) -> Result<Cow<'a, [u8]>, SceneError> {
    let missing = || SceneError::Malformed {
        file: name.to_owned(),
        problem: "the file is not there".to_owned(),
        advice: "check the path",
    };
    files.read(name).ok_or_else(missing)
}

impl<'a> Document<'a> {
    /// Parses the level file and reads all its buffers.
    pub(crate) fn parse(file: &'a str, bytes: &'a [u8], files: &'a dyn SourceFiles) -> Result<Self, SceneError> {
        let (root, glb) = parse_json(file, bytes)?;
        let document = Item::root(file, &root);
        check_version(&document)?;
        let chunk = glb.as_ref().and_then(|glb| glb.bin);
        let list = document.list("buffers")?;
        let buffers = list.iter().enumerate().map(|(i, item)| read_buffer(&item, chunk.filter(|_| i == 0), files));
        let buffers = buffers.collect::<Result<_, _>>()?;
        let (other_chunks, bytes_after_end) = glb.map_or((Vec::new(), 0), |glb| (glb.other, glb.bytes_after_end));
        Ok(Self { file, root, buffers, chunk, other_chunks, bytes_after_end })
    }

    pub(crate) fn root(&self) -> Item<'_> {
        Item::root(self.file, &self.root)
    }

    /// One of the document's top-level arrays.
    pub(crate) fn list(&self, key: &str) -> Result<List<'_>, SceneError> {
        self.root().list(key)
    }
}

/// A name, or `kind N` where there is none.
pub(crate) fn name_of(item: &Item<'_>, kind: &str, index: usize) -> String {
    let name = item.get("name").and_then(|name| name.string().ok()).filter(|name| !name.is_empty());
    name.map_or_else(|| format!("{kind} {index}"), str::to_owned)
}

pub(crate) fn parse_json<'a>(file: &str, bytes: &'a [u8]) -> Result<(Value, Option<Glb<'a>>), SceneError> {
    let malformed = |problem: String, advice| SceneError::Malformed { file: file.to_owned(), problem, advice };
    let glb = is_glb(bytes).then(|| Glb::parse(bytes)).transpose();
    let glb = glb.map_err(|error| malformed(error.to_string(), "copy or export the file again"))?;
    let text = glb.as_ref().map_or(bytes, |glb| glb.json);
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    if text.len() as u64 > limits::JSON_BYTES {
        return Err(SceneError::TooBig {
            file: file.to_owned(),
            place: "the JSON".to_owned(),
            what: "bytes of JSON",
            found: text.len() as u64,
            limit: limits::JSON_BYTES,
            advice: "keep large data in binary buffers, or split the level",
        });
    }
    if text.iter().all(u8::is_ascii_whitespace) {
        return Err(malformed("it is empty".to_owned(), "copy or export the file again"));
    }
    if glb.is_none() && text.iter().find(|byte| !byte.is_ascii_whitespace()) != Some(&b'{') {
        let problem = "it is neither a GLB container, which starts with the bytes \"glTF\", nor JSON".to_owned();
        return Err(malformed(problem, "give a .glb or a .gltf file"));
    }
    let root: Value =
        serde_json::from_slice(text).map_err(|error| malformed(format!("JSON: {error}"), EXPORT_AGAIN))?;
    if !root.is_object() {
        return Err(malformed("its JSON is not an object".to_owned(), EXPORT_AGAIN));
    }
    Ok((root, glb))
}

/// glTF 2.x, readable by a reader of 2.0.
fn check_version(root: &Item<'_>) -> Result<(), SceneError> {
    let asset = root.require("asset")?;
    let version = asset.require("version")?;
    let wanted = asset.get("minVersion").unwrap_or_else(|| version.clone());
    let refuse = |item: &Item<'_>, text: &str| {
        Err(item.invalid_with(format!("{text:?} is not a version that can be read"), "convert the level to glTF 2.0"))
    };
    if version.string()?.split('.').next() != Some("2") {
        return refuse(&version, version.string()?);
    }
    if asset.get("minVersion").is_some() && wanted.string()? != "2.0" {
        return refuse(&wanted, wanted.string()?);
    }
    Ok(())
}

fn read_buffer<'a>(
    item: &Item<'_>,
    chunk: Option<&'a [u8]>,
    files: &'a dyn SourceFiles,
) -> Result<Buffer<'a>, SceneError> {
    let byte_length = item.require("byteLength")?.index()?;
    let bytes = match item.get("uri") {
        None => chunk.map_or(Bytes::None, Bytes::Chunk),
        Some(uri) => match parse_uri(&uri)? {
            Uri::Data(rest) => {
                let bytes = decode_data(rest).map_err(|problem| uri.invalid(format!("the URI {problem}")))?;
                Bytes::Uri(Cow::Owned(bytes))
            }
            Uri::File(path) => {
                let missing = || SceneError::MissingFile {
                    file: item.file().to_owned(),
                    place: uri.place().to_owned(),
                    path: path.clone(),
                };
                Bytes::Uri(files.read(&path).ok_or_else(missing)?)
            }
        },
    };
    if let Some(found) = bytes.get().map(<[u8]>::len).filter(|&found| found < byte_length) {
        let problem = format!("its byteLength is {byte_length}, but only {found} bytes are there: it is truncated");
        return Err(item.invalid_with(problem, "copy or export the level again"));
    }
    Ok(Buffer { bytes, byte_length })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn parse(text: &str) -> Result<(), SceneError> {
        let files: BTreeMap<String, Vec<u8>> = [("b.bin".to_owned(), vec![1, 2, 3])].into();
        Document::parse("l.gltf", text.as_bytes(), &files).map(|_| ())
    }

    #[test]
    fn buffers_are_read_and_checked() {
        let with = |buffer: &str| parse(&format!(r#"{{"asset":{{"version":"2.0"}},"buffers":[{buffer}]}}"#));
        assert_eq!(with(r#"{"uri":"b.bin","byteLength":3}"#), Ok(()));
        assert_eq!(with(r#"{"byteLength":3}"#), Ok(()));
        let message = |buffer| with(buffer).unwrap_err().to_string();
        assert!(message(r#"{"uri":"b.bin","byteLength":4}"#).contains("truncated"));
        assert!(message(r#"{"uri":"c.bin","byteLength":4}"#).contains("\"c.bin\" is missing"));
        assert!(message(r#"{"uri":"../b.bin","byteLength":3}"#).contains("leaves the level's folder"));
        assert!(message(r#"{"uri":"b.bin"}"#).contains("byteLength is missing"));
    }

    #[test]
    fn versions() {
        assert!(parse("{}").unwrap_err().to_string().contains("asset is missing"));
        assert!(parse(r#"{"asset":{"version":"1.0"}}"#).unwrap_err().to_string().contains("convert"));
        assert!(parse(r#"{"asset":{"version":"2.1","minVersion":"2.1"}}"#).is_err());
        assert_eq!(parse(r#"{"asset":{"version":"2.1","minVersion":"2.0"}}"#), Ok(()));
        assert!(parse("").unwrap_err().to_string().contains("empty"));
        assert!(parse("[]").is_err());
    }

    #[test]
    fn external_files_are_listed_once() {
        let text = r#"{"buffers":[{"uri":"a/b.bin"},{"uri":"data:,x"},{"uri":"./a/b.bin"},{"byteLength":1}]}"#;
        assert_eq!(external_files("l.gltf", text.as_bytes()).unwrap(), ["a/b.bin"]);
        let outside = br#"{"buffers":[{"uri":"file:///b.bin"}]}"#;
        assert!(matches!(external_files("l.gltf", outside), Err(SceneError::Path { .. })));
    }
}
