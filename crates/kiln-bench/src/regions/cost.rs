//! What a query costs an engine: of the runtime, on levels of rooms made by code.

use crate::BenchError;
use kiln_runtime::{
    cost::{QueryCost, query_cost, rooms},
    write::write,
};
use std::fmt::Write;

/// Rooms to an edge of each level.
const SIDES: [u32; 3] = [4, 16, 32];

/// Points of each measurement.
const POINTS: u32 = 65_536;

/// The table.
pub(super) fn table() -> Result<String, BenchError> {
    let failed = |reason: String| BenchError::Failed { step: "cost of queries", reason };
    let mut table = String::from(
        "\nWhat a query costs, ns on one thread, points in random order, AO for one normal included; and bytes:\n\n\
         | regions | full form, one channel | engine form | engine form, decoded before | region, from a hint | region, without | \
         all for a moving object | a model, full | a model, engine | a region | opening, ms |\n\
         |---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for side in SIDES {
        let bytes = write(&rooms(side)).map_err(|error| failed(error.to_string()))?;
        let cost = query_cost(&bytes, POINTS).map_err(|error| failed(error.to_string()))?;
        let QueryCost { regions, full_ns, engine_ns, decoded_ns, hinted_lookup_ns, lookup_ns, object_ns, .. } = cost;
        let QueryCost { full_bytes, engine_bytes, region_bytes, open_ms, .. } = cost;
        // Writing to a string does not fail.
        let _ = writeln!(
            table,
            "| {regions} | {full_ns:.1} | {engine_ns:.1} | {decoded_ns:.1} | {hinted_lookup_ns:.1} | {lookup_ns:.0} | \
             {object_ns:.0} | {full_bytes} | {engine_bytes} | {region_bytes:.0} | {open_ms:.2} |"
        );
    }
    Ok(table)
}
