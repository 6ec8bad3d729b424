//! What a person sees while a bake runs: a bar for each stage with its rate and ETA, or plain lines.

use crate::{
    args::Common,
    failure::Failure,
    report::{PartTime, Stage},
};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use kiln_proto::{
    client::{BakeUpdate, ClientError, Watch},
    v1,
};
use std::{
    collections::BTreeMap,
    io::IsTerminal,
    time::{Duration, Instant},
};

/// Plain lines of one stage are at least this far apart.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// Shows a bake's progress on stderr.
pub(crate) struct Progress {
    bars: Option<MultiProgress>,
    stages: BTreeMap<i32, StageView>,
    is_quiet: bool,
}

struct StageView {
    bar: Option<ProgressBar>,
    last_line: Option<Instant>,
    latest: v1::StageProgress,
}

impl Progress {
    /// Bars on a terminal, lines elsewhere or with `--no-progress`; nothing for JSON and CI.
    pub(crate) fn new(common: &Common, is_ci: bool) -> Self {
        let is_quiet = is_ci || common.json;
        let with_bars = !is_quiet && !common.no_progress && std::io::stderr().is_terminal();
        let bars = with_bars.then(|| MultiProgress::with_draw_target(ProgressDrawTarget::stderr()));
        Self { bars, stages: BTreeMap::new(), is_quiet }
    }

    /// Follows a bake to its end.
    pub(crate) async fn follow(&mut self, mut watch: Watch) -> Result<v1::Bake, ClientError> {
        let mut last = None;
        while let Some(update) = watch.next().await? {
            match update {
                BakeUpdate::Snapshot(bake) => {
                    bake.stages.iter().for_each(|stage| self.stage(stage));
                    last = Some(*bake);
                }
                BakeUpdate::Progress(stage) => self.stage(&stage),
                // Warnings are printed at the end, with their counts.
                BakeUpdate::Warning(_) => {}
                BakeUpdate::AttemptFailed(attempt) => {
                    let failure = attempt.failure.unwrap_or_default();
                    self.line(&format!("{} failed: {}; trying again", failure.worker, failure.message));
                }
            }
        }
        self.finish();
        last.ok_or(ClientError::Malformed {
            action: "watch the bake",
            source: kiln_proto::FieldError::new("snapshot", "is missing"),
        })
    }

    /// A line for a person.
    #[expect(clippy::print_stderr, reason = "progress is shown on stderr")]
    pub(crate) fn line(&self, text: &str) {
        if self.is_quiet {
            return;
        }
        match &self.bars {
            Some(bars) => drop(bars.println(text)),
            None => eprintln!("{text}"),
        }
    }

    fn stage(&mut self, progress: &v1::StageProgress) {
        let bars = self.bars.as_ref();
        let view = self.stages.entry(progress.kind).or_insert_with(|| StageView {
            bar: bars.map(|bars| bars.add(bar(progress))),
            last_line: None,
            latest: v1::StageProgress::default(),
        });
        view.latest = *progress;
        if let Some(bar) = &view.bar {
            update(bar, progress);
            return;
        }
        let is_done = progress.done == progress.total;
        let is_due = view.last_line.is_none_or(|at| at.elapsed() >= LINE_INTERVAL);
        if is_done || is_due {
            view.last_line = Some(Instant::now());
            let text = describe(progress);
            self.line(&text);
        }
    }

    fn finish(&mut self) {
        for view in self.stages.values() {
            if let Some(bar) = &view.bar {
                bar.finish();
            }
        }
    }
}

/// Whether the unit of a stage is rays.
fn counts_rays(stage: &v1::StageProgress) -> bool {
    stage.rays_total > 0
}

fn bar(stage: &v1::StageProgress) -> ProgressBar {
    let template = if counts_rays(stage) {
        "{prefix:>7} {bar:32} {percent:>3} %  {msg}  {eta} left"
    } else {
        "{prefix:>7} {bar:32} {percent:>3} %  {msg}"
    };
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(1).with_style(style).with_prefix(name(stage))
}

fn update(bar: &ProgressBar, stage: &v1::StageProgress) {
    if counts_rays(stage) {
        bar.set_length(stage.rays_total);
        bar.set_position(stage.rays_done);
    } else {
        bar.set_length(stage.total);
        bar.set_position(stage.done);
    }
    bar.set_message(detail(stage));
}

fn detail(stage: &v1::StageProgress) -> String {
    let mut text = format!("{}/{} tasks", stage.done, stage.total);
    if counts_rays(stage) && stage.seconds > 0.0 {
        let rate = stage.rays_traced as f64 / stage.seconds / 1e6;
        // Rays planned are no more than a measure of the work: adaptive sampling finds out how many it takes.
        text += &format!(", {:.1} Mrays, {rate:.2} Mrays/s", stage.rays_traced as f64 / 1e6);
    }
    if stage.cache_hits > 0 {
        text += &format!(", {} from the store", stage.cache_hits);
    }
    if stage.retries > 0 {
        text += &format!(", {} tried again", stage.retries);
    }
    text
}

fn describe(stage: &v1::StageProgress) -> String {
    let left = stage.rays_total.saturating_sub(stage.rays_done) as f64;
    let rate = stage.rays_done as f64 / stage.seconds.max(1e-9);
    let eta = if counts_rays(stage) && left > 0.0 && stage.rays_done > 0 {
        format!(", {:.0} s left", left / rate)
    } else {
        String::new()
    };
    format!("{}: {}{eta}", name(stage), detail(stage))
}

fn name(stage: &v1::StageProgress) -> &'static str {
    kiln_core::TaskKind::try_from(stage.kind()).map_or("stage", kiln_core::TaskKind::name)
}

/// The stages of a finished bake, for the report.
pub(crate) fn stages(bake: &v1::Bake) -> Vec<Stage> {
    let stage = |s: &v1::StageProgress| Stage {
        name: name(s).to_owned(),
        seconds: s.seconds,
        cpu_seconds: s.cpu_seconds,
        parts: parts(s),
        items: s.total,
    };
    bake.stages.iter().map(stage).collect()
}

fn parts(stage: &v1::StageProgress) -> BTreeMap<&'static str, PartTime> {
    let all = [("loading", stage.loading), ("building", stage.building), ("tracing", stage.tracing)];
    let shown = |(name, part): (_, Option<v1::PartTime>)| {
        let v1::PartTime { seconds, cpu_seconds } = part.filter(|part| part.seconds > 0.0)?;
        Some((name, PartTime { seconds, cpu_seconds }))
    };
    all.into_iter().filter_map(shown).collect()
}

/// Turns a client's error into an exit code.
pub(crate) fn client_failure(error: ClientError) -> Failure {
    let code = if error.is_unreachable() { crate::failure::UNREACHABLE } else { crate::failure::FAILED };
    Failure::new(code, error)
}
