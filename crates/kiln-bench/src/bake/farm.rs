//! A coordinator and a worker on this machine, in processes of their own.

use super::kiln::{Kiln, failed, finish};
use crate::{BenchError, memory::peak_bytes_of};
use serde_json::Value;
use std::{
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

/// How long processes may take to start.
const PATIENCE: Duration = Duration::from_secs(60);

/// A process that ends when this is dropped, whatever happened.
struct Running(Child);

impl Running {
    fn start(command: &mut Command) -> Result<Self, BenchError> {
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).stdin(Stdio::null()).spawn();
        child.map(Self).map_err(|error| failed(&error.to_string()))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // An error means that it has ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A farm that is ready. The worker goes first when it is dropped.
pub(super) struct RunningFarm {
    worker: Running,
    coordinator: Running,
    address: String,
}

impl RunningFarm {
    /// Starts both on a free port of this machine, with nothing known, and waits until the worker is there.
    pub(super) fn start(kiln: &Kiln, threads: usize, data: &Path) -> Result<Self, BenchError> {
        let said = kiln.path("address");
        // What an earlier one left.
        let _ = fs::remove_file(&said);
        let mut serve = kiln.command("serve");
        serve.args(["--listen", "127.0.0.1:0"]).arg("--address-file").arg(&said);
        serve.arg("--data-dir").arg(data.join("coordinator"));
        let mut coordinator = Running::start(&mut serve)?;
        let address = wait_for("the coordinator", &mut coordinator, || {
            let text = fs::read_to_string(&said).ok().filter(|text| text.ends_with('\n'))?;
            Some(text.trim().to_owned())
        })?;
        let mut work = kiln.command("worker");
        work.args(["--coordinator", &address, "--name", "bench", "--threads", &threads.to_string()]);
        work.arg("--data-dir").arg(data.join("worker"));
        let mut worker = Running::start(&mut work)?;
        wait_for("the worker", &mut worker, || {
            let output = finish(kiln.command("ls").args(["--workers", "--json", "--coordinator", &address])).ok()?;
            let listed: Value = serde_json::from_slice(&output).ok()?;
            listed["workers"].as_array().filter(|workers| !workers.is_empty()).map(|_| ())
        })?;
        Ok(Self { worker, coordinator, address })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> &str {
        &self.address
    }

    /// Greatest resident memory so far of both, bytes.
    pub(super) fn peak_bytes(&self) -> Option<u64> {
        Some(peak_bytes_of(self.worker.0.id())? + peak_bytes_of(self.coordinator.0.id())?)
    }
}

/// Asks until there is an answer, the process is gone, or patience is at its end.
fn wait_for<T>(what: &str, process: &mut Running, mut ask: impl FnMut() -> Option<T>) -> Result<T, BenchError> {
    let began = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return Ok(answer);
        }
        if let Ok(Some(status)) = process.0.try_wait() {
            return Err(failed(&format!("{what} ended at once ({status}); start it by hand to see why")));
        }
        if began.elapsed() > PATIENCE {
            return Err(failed(&format!("{what} was not ready after {} s", PATIENCE.as_secs())));
        }
        sleep(Duration::from_millis(20));
    }
}
