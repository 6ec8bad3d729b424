//! BLAKE3 digests: the names of artefacts and the keys of tasks.

use serde::{Deserialize, Serialize};
use std::{fmt, str::FromStr};

/// A BLAKE3 digest of 32 bytes. Shown as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Default)]
pub struct Digest(pub [u8; 32]);

impl Digest {
    /// Digest of the bytes of an artefact.
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }

    /// The first eight hexadecimal digits, for messages.
    pub fn short(&self) -> String {
        self.to_string()[..8].to_owned()
    }

    /// The digest as bytes, for protocols and indexes.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// A digest from exactly 32 bytes.
    pub fn from_slice(bytes: &[u8]) -> Result<Self, ParseDigestError> {
        bytes.try_into().map(Self).map_err(|_| ParseDigestError { found: format!("{} bytes", bytes.len()) })
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Digest({})", self.short())
    }
}

/// A text or byte string that is no digest.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("a digest is 32 bytes, written as 64 hexadecimal digits; found {found}")]
pub struct ParseDigestError {
    /// What stood in the digest's place.
    pub found: String,
}

impl FromStr for Digest {
    type Err = ParseDigestError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || ParseDigestError { found: format!("{text:?}") };
        if text.len() != 64 || !text.is_ascii() {
            return Err(error());
        }
        let mut bytes = [0; 32];
        for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().chunks_exact(2)) {
            let pair = std::str::from_utf8(pair).map_err(|_| error())?;
            *byte = u8::from_str_radix(pair, 16).map_err(|_| error())?;
        }
        Ok(Self(bytes))
    }
}

/// Builds a digest over typed fields. Every field is preceded by its length, so that no two sequences of
/// fields have the same bytes; the domain keeps keys of different kinds apart.
pub struct DigestBuilder(blake3::Hasher);

impl DigestBuilder {
    /// A builder for keys of the given domain, such as `"kiln trace family"`.
    pub fn new(domain: &str) -> Self {
        let mut builder = Self(blake3::Hasher::new());
        builder.bytes(domain.as_bytes());
        builder
    }

    /// Adds a byte string.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.update(&(bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    /// Adds a text.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.bytes(text.as_bytes())
    }

    /// Adds an integer.
    pub fn integer(&mut self, value: u64) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Adds the bits of a float; the two zeros count as one.
    pub fn float(&mut self, value: f64) -> &mut Self {
        self.integer((value + 0.0).to_bits())
    }

    /// Adds another digest.
    pub fn digest(&mut self, digest: &Digest) -> &mut Self {
        self.bytes(&digest.0)
    }

    /// Adds any value by its artefact encoding.
    pub fn value<T: Serialize>(&mut self, value: &T) -> &mut Self {
        let bytes = crate::codec::encode(value);
        self.bytes(&bytes)
    }

    /// The digest of all that was added.
    pub fn finish(&self) -> Digest {
        Digest(*self.0.finalize().as_bytes())
    }
}

/// A digest of bytes that arrive in parts: equal to [`Digest::of`] over all of them.
#[derive(Clone, Debug, Default)]
pub struct DigestStream(blake3::Hasher);

impl DigestStream {
    /// Adds the next bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The digest of all bytes so far.
    pub fn finish(&self) -> Digest {
        Digest(*self.0.finalize().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_back() {
        let digest = Digest::of(b"kiln");
        assert_eq!(digest.to_string().parse::<Digest>(), Ok(digest));
        assert!("xyz".parse::<Digest>().is_err());
        assert!("é".repeat(32).parse::<Digest>().is_err());
    }

    #[test]
    fn parts_give_the_digest_of_the_whole() {
        let bytes: Vec<u8> = (0..100_000u32).map(|i| (i.wrapping_mul(i) >> 3) as u8).collect();
        let mut stream = DigestStream::default();
        bytes.chunks(777).for_each(|part| stream.update(part));
        assert_eq!(stream.finish(), Digest::of(&bytes));
    }

    #[test]
    fn fields_do_not_run_together() {
        let one = DigestBuilder::new("a").text("bc").text("d").finish();
        let two = DigestBuilder::new("a").text("b").text("cd").finish();
        assert_ne!(one, two);
        assert_eq!(DigestBuilder::new("z").float(0.0).finish(), DigestBuilder::new("z").float(-0.0).finish());
    }
}
