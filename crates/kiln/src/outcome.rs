//! What comes of a bake that has ended: its summary, its file, its report, and what is printed.

use crate::{
    args::Common,
    failure::{FAILED, Failure, INTERRUPTED},
    half_distances::channel_names,
    progress::{client_failure, stages},
    report::{CacheCounts, Output, Run, coarse_total, report, warning_lines},
};
use anyhow::Context;
use kiln_core::{BakeSettings, Baked, Digest, codec};
use kiln_proto::{client::Farm, v1};
use kiln_worker::tasks::BvhCounts;
use std::{collections::BTreeMap, fs, path::Path};

/// A bake that succeeded.
#[derive(Clone)]
pub(crate) struct Outcome {
    /// Its last state.
    pub(crate) bake: v1::Bake,
    /// What export said.
    pub(crate) baked: Baked,
}

impl Outcome {
    /// Reads the summary of a bake that has ended; one that ended badly is a failure.
    pub(crate) async fn of(farm: &Farm, bake: v1::Bake) -> Result<Self, Failure> {
        let Some(result) = &bake.result else { return Err(ended_badly(&bake)) };
        let digest = Digest::from_slice(&result.baked).map_err(anyhow::Error::from)?;
        let bytes = farm.download(digest).await.map_err(client_failure)?;
        let baked = codec::decode("a bake's summary", &bytes).map_err(anyhow::Error::from)?;
        Ok(Self { bake, baked })
    }

    /// Downloads the baked file, and the pack if there is one or it is asked for, beside the file where no place is given.
    pub(crate) async fn save(&self, farm: &Farm, path: &Path, pack: Option<&Path>) -> Result<Vec<Output>, Failure> {
        let mut outputs = vec![save(farm, self.baked.file, path).await?];
        let beside = self.baked.pack.as_ref().map(|_| path.with_extension("kiln"));
        if let Some(pack) = pack.or(beside.as_deref()) {
            outputs.push(self.save_pack(farm, pack).await?);
        }
        Ok(outputs)
    }

    /// Downloads the pack.
    pub(crate) async fn save_pack(&self, farm: &Farm, path: &Path) -> Result<Output, Failure> {
        let Some(pack) = &self.baked.pack else {
            return Err(Failure::new(FAILED, "the bake made no pack; submit it with --pack"));
        };
        save(farm, pack.digest, path).await
    }

    /// The report as JSON.
    pub(crate) fn report(
        &self,
        settings: &BakeSettings,
        seconds: f64,
        outputs: &[Output],
        bvhs: Option<BvhCounts>,
    ) -> serde_json::Value {
        let lane = self.bake.lane.clone().unwrap_or_default();
        let run = Run {
            settings,
            backend: serde_json::json!({
                "trace": lane.trace,
                "traced_in": self.baked.summary.trace_lanes,
                "solve": lane.solve,
            }),
            stages: &stages(&self.bake),
            seconds,
            cache: self.cache(),
            bvhs,
            rays_traced: self.bake.stages.iter().map(|stage| stage.rays_traced).sum(),
            answered_from_store: self.bake.result.as_ref().is_some_and(|r| r.answered_from_store),
            outputs,
            pack: self.baked.pack.as_ref(),
        };
        report(&self.baked.summary, &run)
    }

    fn cache(&self) -> BTreeMap<String, CacheCounts> {
        let count =
            |s: &v1::StageProgress| CacheCounts { hits: s.cache_hits, misses: s.done.saturating_sub(s.cache_hits) };
        let name = |s: &v1::StageProgress| kiln_core::TaskKind::try_from(s.kind()).map(|k| k.name().to_owned());
        self.bake.stages.iter().filter_map(|s| Some((name(s).ok()?, count(s)))).collect()
    }

    /// Writes the report where it is wanted, and prints it, or the result for a person. A report of many instances takes a
    /// while to make: it is not made for nothing.
    #[expect(clippy::print_stdout, reason = "this is the command's output")]
    pub(crate) fn tell(
        &self,
        report: impl FnOnce(&Self) -> serde_json::Value,
        path: Option<&Path>,
        outputs: &[Output],
        seconds: f64,
        common: &Common,
    ) -> Result<(), Failure> {
        let report = (path.is_some() || common.json).then(|| report(self));
        if let Some((report, path)) = report.as_ref().zip(path) {
            write_whole(path, serde_json::to_string_pretty(report).map_err(anyhow::Error::from)?.as_bytes())?;
        }
        match report.filter(|_| common.json) {
            Some(report) => println!("{report}"),
            None => self.print(outputs, seconds),
        }
        Ok(())
    }

    /// Prints the result for a person.
    #[expect(clippy::print_stdout, reason = "this is the command's output")]
    fn print(&self, outputs: &[Output], seconds: f64) {
        let summary = &self.baked.summary;
        for line in warning_lines(&summary.warnings) {
            println!("{line}");
        }
        let rays = summary.trace.rays as f64 / 1e6;
        println!(
            "{} faces, {} vertices, {} samples ({} invalid), {rays:.1} Mrays in {seconds:.1} s{}",
            summary.counts.faces,
            summary.counts.vertices,
            summary.trace.samples,
            summary.trace.invalid,
            if self.bake.result.as_ref().is_some_and(|r| r.answered_from_store) { " (known from before)" } else { "" }
        );
        for (name, error) in channel_names(&summary.sampling.kernel).iter().zip(&summary.error) {
            println!(
                "half-distance {name}: estimated RMSE {:.4}, p99 {:.4}, max {:.3}",
                error.rmse, error.p99, error.max
            );
        }
        let (coarse, share) = coarse_total(summary);
        if coarse.count > 0 {
            println!(
                "too coarse for its shadows: {} faces ({:.2} % of the area that can be seen); `kiln bake --residual` and \
                 `kiln view --overlay residual` show where",
                coarse.count,
                100.0 * share
            );
        }
        for output in outputs {
            println!("wrote {} ({} bytes)", output.path, output.bytes);
        }
        if let Some(file) = outputs.first() {
            println!(
                "`_AO` does not show in ordinary viewers: `kiln view {} -o picture.png` makes a picture",
                file.path
            );
        }
    }
}

/// Downloads a file and puts it in its place whole or not at all.
async fn save(farm: &Farm, digest: Digest, path: &Path) -> Result<Output, Failure> {
    let bytes = farm.download(digest).await.map_err(client_failure)?;
    write_whole(path, &bytes)?;
    Ok(Output { path: path.display().to_string(), digest, bytes: bytes.len() as u64 })
}

/// Writes to a file beside the path first, so that a crash leaves the old file or the new one.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let context = || format!("{} cannot be written; check the folder and its permissions", path.display());
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.tmp", std::process::id()));
    let beside = path.with_file_name(name);
    fs::write(&beside, bytes).with_context(context)?;
    let renamed = fs::rename(&beside, path).with_context(context);
    if renamed.is_err() {
        let _ = fs::remove_file(&beside);
    }
    Ok(renamed?)
}

fn ended_badly(bake: &v1::Bake) -> Failure {
    if bake.state() == v1::BakeState::Cancelled {
        return Failure::new(INTERRUPTED, format!("bake {} was cancelled", bake.bake_id));
    }
    let failure = bake.failure.clone().unwrap_or_default();
    if failure.kind() == v1::FailureKind::InputRefused {
        return Failure::refused(failure.message);
    }
    let attempts: String = failure.attempts.iter().map(|a| format!("\n  {}: {}", a.worker, a.message)).collect();
    Failure::new(FAILED, format!("{}{attempts}", failure.message))
}
