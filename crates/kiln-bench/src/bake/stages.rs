//! Where the time of a bake goes, in the rows of Table 1 of Sloan et al. 2013.

use super::report::Report;

/// Seconds that the paper gives for a level of 1.5 million vertices and 1.8 million faces on an NVIDIA K20.
pub(super) const PAPER_TOTAL_SECS: f64 = 78.0;

/// What a row is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Import,
    Plan,
    Load,
    Build,
    Trace,
    Samples,
    Solve,
    Foliage,
    Regions,
    Export,
    Other,
    Total,
}

/// A row.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Row {
    pub(super) kind: Kind,
    pub(super) what: String,
    /// In words, as some are bounds.
    pub(super) paper: &'static str,
    /// Where it is alone.
    pub(super) wall_secs: Option<f64>,
    pub(super) cpu_secs: Option<f64>,
}

/// The rows of a bake in one process.
pub(super) fn rows(report: &Report) -> Vec<Row> {
    let own = |name: &str| report.stage(name).map_or(0.0, super::report::Stage::own_cpu_seconds);
    let wall = |name: &str| report.stage(name).map(|stage| stage.seconds);
    let part = |name: &str| report.part(name);
    let stages: f64 = report.stages.iter().map(|stage| stage.cpu_seconds).sum();
    let counts = &report.level;
    let unknowns: u64 = report.solve.iter().map(|solve| solve.unknowns).sum();
    let row = |kind, what: String, paper, wall_secs: Option<f64>, cpu: f64| Row {
        kind,
        what,
        paper,
        wall_secs,
        cpu_secs: Some(cpu),
    };
    let (build, load) = (part("building"), part("loading"));
    let geometry = format!("Process geometry, {} V, {} F", millions(counts.vertices), millions(counts.faces));
    let rays = format!("Ray trace samples; {} rays in all stages", millions(report.rays.traced));
    let samples = format!("Sample mesh, {} samples: points, moments, rounds", millions(report.samples.total));
    let tracing = |name: &str| report.stage(name).map_or(0.0, |stage| stage.part("tracing").cpu_seconds);
    let beside = ["volume", "points", "regions", "read", "resample"].map(tracing);
    let (of_others, foliage) = (beside.iter().sum::<f64>(), &report.foliage);
    let trees: u64 = foliage.models.iter().map(|model| model.instances).sum();
    let volume = format!("Sparse volume for trees, {} points", millions(foliage.voxels));
    let fits = format!("Fits of {trees} trees, {} models", foliage.models.len());
    let on_instances = "Trace points on instances".to_owned();
    let lods = format!(
        "Resample geometry of levels of detail, {} V, {} F, {} points",
        millions(report.lods.vertices),
        millions(report.lods.faces),
        millions(report.lods.samples)
    );
    let numbers = format!("Read around {} shrubs and decorators", millions(foliage.scalars));
    let regions = report.regions.clone().unwrap_or_default();
    let points = format!("Ray trace regions for dynamic AO, {} points", millions(regions.points));
    let models = format!("Models of {} regions", millions(regions.regions));
    vec![
        row(Kind::Import, geometry, "2", wall("import"), own("import")),
        row(Kind::Plan, "Plan".to_owned(), "", wall("plan"), own("plan")),
        row(Kind::Load, "Load the level's meshes".to_owned(), "", Some(load.seconds), load.cpu_seconds),
        row(Kind::Samples, samples, "< 1", None, own("trace")),
        row(
            Kind::Build,
            "BVH build, trees and shrubs too".to_owned(),
            "10.5, < 1",
            Some(build.seconds),
            build.cpu_seconds,
        ),
        row(Kind::Trace, rays, "35.1", None, part("tracing").cpu_seconds - of_others),
        row(
            Kind::Solve,
            format!("Least squares solve, {} unknowns and those of levels of detail", millions(unknowns)),
            "8.6, 4.2",
            None,
            own("solve"),
        ),
        row(Kind::Foliage, volume, "0.53", None, own("volume") + tracing("volume")),
        row(Kind::Foliage, on_instances, "", None, own("points") + tracing("points")),
        row(Kind::Foliage, fits, "", None, own("fit")),
        row(Kind::Foliage, numbers, "", None, own("read") + tracing("read")),
        row(Kind::Regions, points, "9.2 for 332.7 k", None, own("regions") + tracing("regions")),
        row(Kind::Regions, models, "", None, own("model")),
        row(Kind::Foliage, lods, "5.7", None, own("resample") + tracing("resample")),
        row(Kind::Export, "Export".to_owned(), "", wall("export"), own("export")),
        row(
            Kind::Other,
            "Storing, scheduling, progress and the rest".to_owned(),
            "",
            None,
            (report.cpu_seconds - stages).max(0.0),
        ),
        row(Kind::Total, "Total".to_owned(), "78", Some(report.seconds), report.cpu_seconds),
    ]
}

/// A count, short.
pub(super) fn millions(count: u64) -> String {
    match count {
        0..10_000 => count.to_string(),
        10_000..1_000_000 => format!("{:.1} k", count as f64 / 1e3),
        _ => format!("{:.2} M", count as f64 / 1e6),
    }
}
