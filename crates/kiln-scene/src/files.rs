//! The files of a source, and the URIs by which they refer to one another. Only files in or below the level's
//! folder are ever named; nothing here touches a disk.

use crate::{SceneError, json::Item};
use base64::{
    Engine,
    alphabet::STANDARD,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use percent_encoding::percent_decode_str;
use std::{borrow::Cow, collections::BTreeMap};

/// Files of a source, by path relative to the level's folder, with forward slashes.
pub trait SourceFiles: Sync {
    /// The bytes of a file, or nothing if there is none.
    fn read(&self, path: &str) -> Option<Cow<'_, [u8]>>;
}

impl SourceFiles for BTreeMap<String, Vec<u8>> {
    fn read(&self, path: &str) -> Option<Cow<'_, [u8]>> {
        self.get(path).map(|bytes| Cow::Borrowed(&bytes[..]))
    }
}

/// What a URI of a buffer or an image is.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Uri<'a> {
    /// The bytes stand in the URI itself.
    Data(&'a str),
    /// A file in or below the level's folder, by its path from there.
    File(String),
}

/// Reads a URI, and refuses all that leads outside the level's folder.
pub(crate) fn parse_uri<'a>(item: &Item<'a>) -> Result<Uri<'a>, SceneError> {
    let uri = item.string()?;
    if uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:")) {
        return Ok(Uri::Data(&uri[5..]));
    }
    relative_path(uri).map(Uri::File).map_err(|problem| item.path_error(uri, problem))
}

/// A relative URI as a normal path below the level's folder.
fn relative_path(uri: &str) -> Result<String, &'static str> {
    let path = percent_decode_str(uri).decode_utf8().map_err(|_| "is not UTF-8")?;
    if path.contains('\\') {
        return Err("has backslashes");
    }
    if path.starts_with('/') {
        return Err("is an absolute path");
    }
    if path.split('/').next().is_some_and(|first| first.contains(':')) {
        return Err("has a scheme or a drive");
    }
    if path.chars().any(char::is_control) {
        return Err("has control characters");
    }
    let mut segments = Vec::new();
    for segment in path.split('/') {
        match segment {
            "" | "." => {}
            ".." => {
                segments.pop().ok_or("leaves the level's folder")?;
            }
            name => segments.push(name),
        }
    }
    if segments.is_empty() { Err("names no file") } else { Ok(segments.join("/")) }
}

/// The bytes of a data URI, of which `rest` is all after `data:`.
pub(crate) fn decode_data(rest: &str) -> Result<Vec<u8>, &'static str> {
    let (kind, data) = rest.split_once(',').ok_or("is a data URI without a comma")?;
    let data: Cow<'_, [u8]> = percent_decode_str(data).into();
    if !kind.ends_with(";base64") {
        return Ok(data.into_owned());
    }
    let config = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    GeneralPurpose::new(&STANDARD, config).decode(data).map_err(|_| "is not valid base64")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_in_the_folder() {
        assert_eq!(relative_path("a.bin").as_deref(), Ok("a.bin"));
        assert_eq!(relative_path("./a%20b//c.bin").as_deref(), Ok("a b/c.bin"));
        assert_eq!(relative_path("x/../c.bin").as_deref(), Ok("c.bin"));
        for bad in [
            "../a.bin",
            "x/../../a.bin",
            "%2e%2e/a.bin",
            "/etc/passwd",
            "%2Fetc/passwd",
            "C:/a.bin",
            "file:///a",
            "",
            "http://host/a.bin",
            "..\\a.bin",
            "%5c%5chost/a",
            "a%00.bin",
            "%ff",
            "//host/share",
            ".",
            "x/..",
        ] {
            assert!(relative_path(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn data_uris() {
        assert_eq!(decode_data("application/octet-stream;base64,AAEC").unwrap(), [0, 1, 2]);
        assert_eq!(decode_data(";base64,AAE").unwrap(), [0, 1]);
        assert_eq!(decode_data(";base64,AAE=").unwrap(), [0, 1]);
        assert_eq!(decode_data("text/plain,a%20b").unwrap(), b"a b");
        assert!(decode_data(";base64,A!").is_err());
        assert!(decode_data("nothing").is_err());
    }
}
