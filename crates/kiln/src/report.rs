//! report.json: what was done, how well, and how long it took. The schema is in docs/report.md.

mod coarse;
mod skips;

pub(crate) use coarse::coarse_total;

use kiln_core::{BakeSettings, BakeSummary, ComponentMethod, Digest, ErrorEstimate, MeshSummary, PackFile, Warning};
use kiln_worker::tasks::BvhCounts;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Version of the schema.
pub(crate) const SCHEMA: u32 = 3;

/// One stage of a bake.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Stage {
    pub(crate) name: String,
    /// From the first task's start to the last one's end.
    pub(crate) seconds: f64,
    pub(crate) cpu_seconds: f64,
    /// Of this, by what the tasks did.
    pub(crate) parts: BTreeMap<&'static str, PartTime>,
    pub(crate) items: u64,
}

/// Time of a part of a stage's tasks.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct PartTime {
    /// Sum over threads.
    pub(crate) seconds: f64,
    pub(crate) cpu_seconds: f64,
}

/// Results found in the store, and not.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct CacheCounts {
    pub(crate) hits: u64,
    pub(crate) misses: u64,
}

/// A file that was written.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Output {
    pub(crate) path: String,
    pub(crate) digest: Digest,
    pub(crate) bytes: u64,
}

/// What one run adds to the result's own summary.
pub(crate) struct Run<'a> {
    pub(crate) settings: &'a BakeSettings,
    pub(crate) backend: Value,
    pub(crate) stages: &'a [Stage],
    pub(crate) seconds: f64,
    pub(crate) cache: BTreeMap<String, CacheCounts>,
    /// Where this process had its BVHs from; nothing where other processes traced.
    pub(crate) bvhs: Option<BvhCounts>,
    /// Rays that this bake traced; the others of its result were known.
    pub(crate) rays_traced: u64,
    /// The whole answer was known from an earlier bake.
    pub(crate) answered_from_store: bool,
    pub(crate) outputs: &'a [Output],
    pub(crate) pack: Option<&'a PackFile>,
}

/// The whole report.
pub(crate) fn report(summary: &BakeSummary, run: &Run<'_>) -> Value {
    let hits = run.cache.values().map(|c| c.hits).sum::<u64>();
    let misses = run.cache.values().map(|c| c.misses).sum::<u64>();
    json!({
        "schema": SCHEMA,
        "kiln": env!("CARGO_PKG_VERSION"),
        "level": {
            "digest": summary.level.to_string(),
            "meshes": summary.counts.meshes,
            "instances": summary.counts.instances,
            "vertices": summary.counts.vertices,
            "faces": summary.counts.faces,
            "unique_faces": summary.counts.unique_faces,
            "classes": summary.counts.classes,
        },
        "settings": { "requested": run.settings, "resolved": summary.sampling },
        "backend": run.backend,
        "samples": { "total": summary.trace.samples, "invalid": summary.trace.invalid },
        "rays": skips::rays(summary, run.rays_traced),
        "left_out": skips::left_out(summary),
        "stages": run.stages,
        "seconds": run.seconds,
        "cpu_seconds": kiln_worker::process_time().as_secs_f64(),
        "peak_memory_bytes": peak_memory_bytes(),
        "error_estimate": errors(&summary.error),
        "too_coarse": coarse::of_level(summary),
        "foliage": summary.foliage,
        "lods": summary.lods,
        "regions": summary.regions,
        "pack": run.pack.map(|pack| json!({ "bytes": pack.bytes, "by_kind": by_kind(pack) })),
        "solve": solves(summary),
        "meshes": meshes(summary),
        "cache": {
            "hits": hits, "misses": misses, "by_stage": run.cache, "answered_from_store": run.answered_from_store,
            "bvhs": run.bvhs.map(|b| json!({ "read": b.read, "built": b.built, "not_kept": b.not_kept })),
        },
        "warnings": summary.warnings,
        "outputs": run.outputs.iter().map(|o| json!({ "path": o.path, "digest": o.digest.to_string(), "bytes": o.bytes })).collect::<Vec<_>>(),
    })
}

/// Bytes of a pack by what they are.
fn by_kind(pack: &PackFile) -> Value {
    pack.sizes.iter().map(|(kind, bytes)| (kind.clone(), json!(bytes))).collect::<serde_json::Map<_, _>>().into()
}

/// Estimated error, one number for each half-distance.
fn errors(estimates: &[ErrorEstimate]) -> Value {
    let channel = |f: &dyn Fn(&ErrorEstimate) -> f64| estimates.iter().map(f).collect::<Vec<f64>>();
    json!({ "rmse": channel(&|e| e.rmse), "p99": channel(&|e| e.p99), "max": channel(&|e| e.max) })
}

/// One entry for each instance that was solved.
fn solves(summary: &BakeSummary) -> Vec<Value> {
    let name = |method: &ComponentMethod| serde_json::to_value(method).unwrap_or(Value::Null);
    let one = |mesh: &MeshSummary| {
        let s = &mesh.solve;
        let methods: serde_json::Map<String, Value> =
            s.methods.iter().map(|(m, n)| (name(m).as_str().unwrap_or("other").to_owned(), json!(n))).collect();
        json!({
            "node": mesh.node, "unknowns": s.unknowns, "nnz": s.nnz, "residual": s.residual,
            "iterations": s.iterations, "components": s.components, "method": methods,
        })
    };
    summary.meshes.iter().map(one).collect()
}

/// Samples and error of each instance.
fn meshes(summary: &BakeSummary) -> Vec<Value> {
    let one = |mesh: &MeshSummary| {
        json!({
            "node": mesh.node, "mesh": mesh.mesh,
            "samples": mesh.solve.trace.samples, "invalid": mesh.solve.trace.invalid,
            "visible_area_m2": mesh.solve.visible_area_m2, "error_estimate": errors(&mesh.solve.error),
            "too_coarse": coarse::of_instance(mesh),
        })
    };
    summary.meshes.iter().map(one).collect()
}

/// Greatest resident memory of this process, where the system tells (Linux).
pub(crate) fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok()? * 1024)
}

/// Warnings for a person: one line each, the most frequent first.
pub(crate) fn warning_lines(warnings: &[Warning]) -> Vec<String> {
    let mut sorted: Vec<&Warning> = warnings.iter().collect();
    sorted.sort_by(|a, b| b.count.cmp(&a.count).then(a.code.cmp(&b.code)));
    sorted.iter().map(|w| format!("warning: {}: {}", w.subject, w.message)).collect()
}
