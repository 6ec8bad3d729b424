//! How a command ends when it does not end well: an exit code and a message that says what to do.

use std::{fmt::Display, process::ExitCode};

/// A bake failed.
pub(crate) const FAILED: Code = Code(1);
/// The command line is wrong.
pub(crate) const USAGE: Code = Code(2);
/// The input is refused.
pub(crate) const REFUSED: Code = Code(3);
/// A quality gate was missed.
pub(crate) const GATE: Code = Code(4);
/// The farm cannot be reached.
pub(crate) const UNREACHABLE: Code = Code(5);
/// Stopped by Ctrl-C.
pub(crate) const INTERRUPTED: Code = Code(130);

/// A documented exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Code(pub(crate) u8);

impl From<Code> for ExitCode {
    fn from(code: Code) -> Self {
        Self::from(code.0)
    }
}

/// Why a command did not succeed.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: Code,
    message: String,
}

impl Failure {
    pub(crate) fn new(code: Code, message: impl Display) -> Self {
        Self { code, message: message.to_string() }
    }

    /// The input is refused.
    pub(crate) fn refused(message: impl Display) -> Self {
        Self::new(REFUSED, message)
    }

    /// The command line is wrong.
    pub(crate) fn usage(message: impl Display) -> Self {
        Self::new(USAGE, message)
    }

    /// The sentence for a person.
    pub(crate) fn message(&self) -> &str {
        &self.message
    }

    #[expect(clippy::print_stderr, reason = "this is where errors are shown")]
    pub(crate) fn print(&self) {
        eprintln!("kiln: {}", self.message);
    }
}

/// Anything that goes wrong on the way fails the command; what deserves another code is turned into it where it occurs.
impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::new(FAILED, format!("{error:#}"))
    }
}
