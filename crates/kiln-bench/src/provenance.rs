//! Where and when a measurement was made: what every dated result carries.

use serde::Serialize;
use std::{
    fs,
    process::Command,
    time::{SystemTime, UNIX_EPOCH},
};

/// The machine, the code and the date.
#[derive(Clone, Debug, Serialize)]
pub struct Provenance {
    /// The command line.
    pub command: String,
    /// Date of the start in UTC, `YYYY-MM-DD`.
    pub date: String,
    /// Version of Kiln.
    pub version: &'static str,
    /// Commit of the repository that the command was run in; with `+` if files differ from it.
    pub commit: Option<String>,
    /// Model of the processor.
    pub processor: Option<String>,
    /// Threads that the measurement could use.
    pub threads: usize,
    /// Main memory, GiB.
    pub memory_gib: Option<f64>,
}

impl Provenance {
    /// Of this process, now.
    pub fn now() -> Self {
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let command: Vec<String> = std::env::args().map(|arg| file_name(&arg)).collect();
        Self {
            command: command.join(" "),
            date: date(seconds / 86_400),
            version: env!("CARGO_PKG_VERSION"),
            commit: commit(),
            processor: field("/proc/cpuinfo", "model name"),
            threads: rayon::current_num_threads(),
            memory_gib: field("/proc/meminfo", "MemTotal").and_then(|text| gib(&text)),
        }
    }

    /// One sentence for the head of a table.
    pub fn sentence(&self) -> String {
        let processor = self.processor.as_deref().unwrap_or("unknown processor");
        let memory = self.memory_gib.map_or(String::new(), |gib| format!(", {gib:.0} GiB"));
        let commit = self.commit.as_deref().unwrap_or("unknown");
        format!("{processor}, {} threads{memory}; Kiln {}, commit {commit}; {}", self.threads, self.version, self.date)
    }
}

/// An argument without the folders of a path, which say nothing to others.
fn file_name(argument: &str) -> String {
    argument.rsplit('/').next().unwrap_or(argument).to_owned()
}

/// The value of the first `name: value` line of a file of the system; nothing where there is no such file.
fn field(path: &str, name: &str) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    let line = text.lines().find(|line| line.starts_with(name))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

fn gib(kib: &str) -> Option<f64> {
    kib.split_whitespace().next()?.parse::<f64>().ok().map(|kib| kib / (1024.0 * 1024.0))
}

fn commit() -> Option<String> {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let head = git(&["rev-parse", "--short=10", "HEAD"])?;
    let is_changed = git(&["status", "--porcelain"]).is_some_and(|text| !text.is_empty());
    Some(if is_changed { format!("{head}+") } else { head })
}

/// Civil date of a day since 1970-01-01 in the Gregorian calendar, from the lengths of years and months.
fn date(mut day: u64) -> String {
    let is_leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let mut year = 1970;
    while day >= 365 + u64::from(is_leap(year)) {
        day -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(is_leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 1;
    for length in lengths {
        if day < length {
            break;
        }
        day -= length;
        month += 1;
    }
    format!("{year:04}-{month:02}-{:02}", day + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates() {
        for (day, expected) in
            [(0, "1970-01-01"), (58, "1970-02-28"), (59, "1970-03-01"), (11_016, "2000-02-29"), (20_780, "2026-11-23")]
        {
            assert_eq!(date(day), expected);
        }
    }

    #[test]
    fn arguments_lose_their_folders() {
        assert_eq!(file_name("/a/b/duck.glb:0.1,15"), "duck.glb:0.1,15");
        assert_eq!(file_name("--quick"), "--quick");
    }
}
