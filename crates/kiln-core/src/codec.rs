//! The encoding of artefacts: postcard, which is compact, has one form for each value, and never allocates
//! more than its input justifies.

use serde::{Serialize, de::DeserializeOwned};

/// An artefact's bytes are not what its kind demands.
#[derive(Debug, thiserror::Error)]
#[error("{what} cannot be decoded ({reason}); it was written by another version of Kiln, or is damaged")]
pub struct DecodeError {
    /// The kind of artefact, such as `"a level"`.
    pub what: &'static str,
    /// What the decoder found.
    pub reason: String,
}

/// Encodes a value. Plain data always encodes: a map or a sequence of unknown length would not, and none is used.
///
/// # Panics
/// If a type with a sequence of unknown length were passed, which the types of this crate never have.
pub fn encode<T: Serialize + ?Sized>(value: &T) -> Vec<u8> {
    postcard::to_stdvec(value).expect("plain data always encodes")
}

/// Decodes a value of the named kind; bytes left over are an error too.
pub fn decode<T: DeserializeOwned>(what: &'static str, bytes: &[u8]) -> Result<T, DecodeError> {
    let error = |reason: String| DecodeError { what, reason };
    let (value, rest) = postcard::take_from_bytes(bytes).map_err(|e| error(e.to_string()))?;
    if !rest.is_empty() {
        return Err(error(format!("{} bytes are left over", rest.len())));
    }
    Ok(value)
}
