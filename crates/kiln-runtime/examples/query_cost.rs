//! Prints what queries cost: `cargo run --release -p kiln-runtime --example query_cost [PACK]`. Without a pack, of levels of
//! 64, 4,096 and 32,768 rooms.
#![expect(clippy::print_stdout, reason = "this is its purpose")]

use kiln_runtime::{
    cost::{query_cost, rooms},
    write::write,
};
use std::error::Error;

/// Points that are asked for in each round.
const POINTS: u32 = 100_000;

fn main() -> Result<(), Box<dyn Error>> {
    println!(
        "| regions | pack, MB | opened in, ms | bytes of a model, full | engine | of a region besides | full, ns | engine, ns | decoded, ns | look-up from a hint, ns | without, ns | object, ns |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let given = std::env::args().nth(1);
    let packs = match given {
        Some(path) => vec![std::fs::read(path)?],
        None => [4, 16, 32].map(|side| write(&rooms(side))).into_iter().collect::<Result<_, _>>()?,
    };
    for bytes in packs {
        let cost = query_cost(&bytes, POINTS)?;
        print!("| {} | {:.2} | {:.2} ", cost.regions, bytes.len() as f64 / 1e6, cost.open_ms);
        print!("| {} | {} | {:.0} ", cost.full_bytes, cost.engine_bytes, cost.region_bytes);
        let times =
            [cost.full_ns, cost.engine_ns, cost.decoded_ns, cost.hinted_lookup_ns, cost.lookup_ns, cost.object_ns];
        times.iter().for_each(|ns| print!("| {ns:.1} "));
        println!("|");
    }
    Ok(())
}
