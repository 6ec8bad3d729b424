//! What a peer may send. Checked before anything is allocated for it; both ends know the same numbers, so that a
//! message that is too large is refused where it is made.

/// Most bytes of a chunk of an upload or download.
pub const CHUNK_BYTES: usize = 1 << 20;

/// Most bytes of a message that is neither a chunk nor part of a worker's session.
pub const MESSAGE_BYTES: usize = 4 << 20;

/// Most bytes of a message that carries a chunk.
pub const CHUNK_MESSAGE_BYTES: usize = CHUNK_BYTES + (64 << 10);

/// Most bytes of a message of a worker's session: a lease may list thousands of tasks.
pub const SESSION_MESSAGE_BYTES: usize = 32 << 20;

/// Bytes of tasks after which a coordinator sends the rest of a lease on its own; well under
/// [`SESSION_MESSAGE_BYTES`].
pub const LEASE_BYTES: usize = 16 << 20;

/// Most digests, ranges or entries in a request about artefacts.
pub const ARTEFACTS: usize = 16_384;

/// Most bytes of one artefact.
pub const ARTEFACT_BYTES: u64 = 4 << 30;

/// Most files of a source.
pub const SOURCE_FILES: usize = 16_384;

/// Most bytes of a path in a source.
pub const PATH_BYTES: usize = 4096;

/// Most inputs of a task, such as the moments of an instance's pieces.
pub const INPUTS: usize = kiln_core::MAX_INPUTS;

/// Most bytes of a request id, upload id or worker id.
pub const ID_BYTES: usize = 128;

/// Most bytes of a name for people.
pub const NAME_BYTES: usize = 256;

/// Most bytes of what a worker says about a failure; longer texts are cut.
pub const FAILURE_TEXT_BYTES: usize = 64 << 10;

/// Most entries in a page of a list.
pub const PAGE: u32 = 1000;

/// Cuts a text for people to at most `bytes` bytes, at a character's end.
pub fn cut(text: &str, bytes: usize) -> &str {
    if text.len() <= bytes {
        return text;
    }
    let end = (0..=bytes).rev().find(|&end| text.is_char_boundary(end));
    &text[..end.unwrap_or(0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cut_keeps_characters_whole() {
        assert_eq!(cut("abc", 3), "abc");
        assert_eq!(cut("abc", 2), "ab");
        assert_eq!(cut("aé", 2), "a");
        assert_eq!(cut("é", 0), "");
    }
}
