//! Runs the `kiln` binary as a user would: what the process-level tests in this package share.

use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::OnceLock,
    thread::sleep,
    time::{Duration, Instant},
};

/// The binary under test, built now if it is not there or not current.
///
/// # Panics
/// If it cannot be built.
pub fn binary() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| {
        let built = Command::new(env!("CARGO"))
            .args(["build", "--locked", "--package", "kiln", "--message-format", "json"])
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .stderr(Stdio::inherit())
            .output()
            .expect("cargo runs");
        assert!(built.status.success(), "kiln does not build");
        let messages = String::from_utf8_lossy(&built.stdout);
        let executable =
            messages.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok()).find_map(|message| {
                let is_kiln = message["target"]["name"] == "kiln" && message["executable"].is_string();
                is_kiln.then(|| message["executable"].as_str().map(PathBuf::from)).flatten()
            });
        executable.expect("cargo names the executable")
    })
}

/// A folder with a data folder of its own, in which commands run.
pub struct Workplace {
    folder: tempfile::TempDir,
}

impl Workplace {
    /// An empty one, gone when dropped.
    ///
    /// # Panics
    /// If the system has no place for it.
    #[expect(clippy::new_without_default, reason = "it makes a folder")]
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a temporary folder can be made") }
    }

    /// A path in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A command with these arguments; its data folder is `data` unless the arguments name one.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(binary());
        command.args(arguments).current_dir(self.folder.path()).env("KILN_DATA_DIR", self.path("data"));
        command.env_remove("KILN_TOKEN").env_remove("KILN_COORDINATOR");
        command
    }

    /// Runs a command to its end.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("kiln starts")
    }

    /// Runs a command that must succeed, and returns what it printed.
    ///
    /// # Panics
    /// If it fails.
    pub fn succeed(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "kiln {arguments:?} failed: {errors}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// Runs a command that must end with an exit code, and returns what it said.
    ///
    /// # Panics
    /// If it ends otherwise.
    pub fn fail(&self, code: i32, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "kiln {arguments:?}: {errors}");
        errors
    }

    /// Starts a command that goes on in the background; killed when dropped.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start(&self, arguments: &[&str]) -> Background {
        self.start_with(arguments, &[])
    }

    /// As [`Workplace::start`], with environment variables.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start_with(&self, arguments: &[&str], variables: &[(&str, &str)]) -> Background {
        let mut command = self.command(arguments);
        let child = command.envs(variables.iter().copied()).stdout(Stdio::null()).stderr(Stdio::inherit()).spawn();
        Background(child.expect("kiln starts"))
    }

    /// The bytes of a file.
    ///
    /// # Panics
    /// If it cannot be read.
    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// A JSON file.
    ///
    /// # Panics
    /// If it cannot be read.
    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.read(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }
}

/// A process in the background.
pub struct Background(Child);

impl Background {
    /// SIGKILL: no chance to tidy up.
    pub fn kill(&mut self) {
        // An error means that it has ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }

    /// Whether it still runs.
    pub fn is_running(&mut self) -> bool {
        matches!(self.0.try_wait(), Ok(None))
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Asks until there is an answer.
///
/// # Panics
/// After two minutes without one.
pub fn wait_for<T>(what: &str, mut ask: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "{what} did not happen in two minutes");
        sleep(Duration::from_millis(20));
    }
}
