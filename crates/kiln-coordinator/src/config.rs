//! What a coordinator may be told.

use std::{path::Path, time::Duration};

/// What to do with bakes that an earlier coordinator of the same folder did not finish.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Unfinished {
    /// They go on: a farm.
    #[default]
    Resume,
    /// They stay as they are, and are listed, until they are submitted again under the same request id: a process
    /// for one bake, which must not do other work.
    Leave,
}

/// Settings of a coordinator.
#[derive(Clone, Debug)]
pub struct Config {
    /// The scheduler's policy.
    pub scheduler: kiln_schedule::Config,
    /// Time between the heartbeats that workers are asked for.
    pub heartbeat_interval: Duration,
    /// Shortest time between two progress events of one stage.
    pub progress_interval: Duration,
    /// Events kept for each bake, so that a watcher can go on where it was.
    pub events_kept: usize,
    /// Ended bakes that are remembered.
    pub ended_bakes_kept: usize,
    /// What to do with bakes left by an earlier coordinator.
    pub unfinished: Unfinished,
    /// Size that the packs of the store are brought down to whenever no bake is active; `None` keeps everything.
    pub store_max_bytes: Option<u64>,
    /// The token that every call must carry, but for health and reflection. `None` admits everyone, which
    /// [`crate::listen`] allows on loopback addresses only.
    pub token: Option<Token>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            scheduler: kiln_schedule::Config::default(),
            heartbeat_interval: Duration::from_secs(3),
            progress_interval: Duration::from_millis(100),
            events_kept: 1024,
            ended_bakes_kept: 10_000,
            unfinished: Unfinished::default(),
            store_max_bytes: None,
            token: None,
        }
    }
}

/// A secret that callers must know. Never shown.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// A token that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// The file cannot be read.
    #[error("cannot read the token from {}: {source}", .path.display())]
    Unreadable {
        /// The file.
        path: std::path::PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The text is no token.
    #[error("a token has 16 to 4096 visible ASCII characters on one line; make one with `openssl rand -hex 32`")]
    Weak,
}

impl Token {
    /// A token from a text: 16 to 4,096 visible ASCII characters; space around them is dropped.
    pub fn new(text: &str) -> Result<Self, TokenError> {
        let text = text.trim();
        if !(16..=4096).contains(&text.len()) || !text.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(TokenError::Weak);
        }
        Ok(Self(text.to_owned()))
    }

    /// A token from a file that holds nothing else.
    pub fn from_file(path: &Path) -> Result<Self, TokenError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| TokenError::Unreadable { path: path.to_owned(), source })?;
        Self::new(&text)
    }

    /// The secret, for a client's [`kiln_proto::client::Bearer`].
    pub fn secret(&self) -> &str {
        &self.0
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(…)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_checked_and_never_shown() {
        assert!(Token::new("short").is_err());
        assert!(Token::new("sixteen characters with spaces").is_err());
        let token = Token::new("0123456789abcdef\n").unwrap();
        assert_eq!(token.secret(), "0123456789abcdef");
        assert!(!format!("{token:?}").contains("0123"));
        assert!(matches!(Token::from_file(Path::new("/nonexistent/token")), Err(TokenError::Unreadable { .. })));
    }
}
