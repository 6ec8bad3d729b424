//! What queries cost: nanoseconds each, and bytes a region. For `kiln bench regions` and `examples/query_cost.rs`.

use crate::{
    Kernel, MovingObject, Pack, PackError, SectionKind, TemporalBlend, ao_linear, ao_quadratic,
    format::HARMONICS,
    write::{EdgeData, MetaData, ModelData, ModelForms, PackData, RegionData, RegionsData, RemapData},
};
use alloc::{format, vec::Vec};
use core::{array, hint::black_box};
use std::time::Instant;

/// What queries of a pack with so many regions cost. Nanoseconds are means over points all over the regions, in an order
/// that no cache foresees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QueryCost {
    /// Number of regions.
    pub regions: u32,
    /// Bytes of a model in full form.
    pub full_bytes: usize,
    /// Bytes of a model in the engine's form.
    pub engine_bytes: usize,
    /// Bytes of a region besides its model: box, id, neighbours, boundaries.
    pub region_bytes: f64,
    /// Opening the pack, milliseconds: all that is checked once.
    pub open_ms: f64,
    /// Nine coefficients of one channel, and AO for a normal from them.
    pub full_ns: f64,
    /// Four coefficients of the blend, and AO for a normal from them.
    pub engine_ns: f64,
    /// The same from models that were decoded to floats before.
    pub decoded_ns: f64,
    /// Finding the region of a point from a good hint.
    pub hinted_lookup_ns: f64,
    /// Finding it without a hint.
    pub lookup_ns: f64,
    /// All that a moving object takes in a frame: region, model, blend.
    pub object_ns: f64,
}

/// A level of cubic rooms of 4 m in a cube, `side` to an edge, for measurements.
pub fn rooms(side: u32) -> PackData<'static> {
    let channels = 2;
    let mut data = PackData::new(MetaData {
        level_digest: [0; 32],
        version: env!("CARGO_PKG_VERSION").into(),
        origin: [0.0; 3],
        kernel: Kernel::Obscurance,
        half_distances: Vec::from([2.0, 300.0]),
        blend: Vec::from([0.03, 0.97]),
        remap: RemapData::None,
    });
    let place = |index: u32| [index % side, index / side % side, index / (side * side)];
    let count = side * side * side;
    let corner = |index: u32| place(index).map(|i| i as f32 * 4.0);
    let region = |index| RegionData {
        id: format!("room {index}"),
        min: corner(index),
        max: corner(index).map(|x| x + 4.0),
        model: index,
    };
    let model = |index: u32| {
        let wave = |i: u32| libm::sinf((index * 31 + i * 7) as f32) * 0.05;
        let parameters =
            |k: u32| array::from_fn(|p| wave(k * 7 + p as u32) + if p == 0 && k.is_multiple_of(9) { 2.0 } else { 0.0 });
        let coefficients = (0..(channels * HARMONICS) as u32).map(parameters).collect();
        ModelData { region: index, center: corner(index).map(|x| x + 2.0), coefficients }
    };
    let beside = |index: u32| {
        let steps = [1, side, side * side].into_iter().zip(place(index));
        steps.filter(move |(_, i)| i + 1 < side).map(move |(step, _)| [index, index + step])
    };
    let edge = |regions| EdgeData { regions, area_m2: 16.0, center: corner(regions[1]) };
    data.regions = RegionsData {
        regions: (0..count).map(region).collect(),
        edges: (0..count).flat_map(beside).map(edge).collect(),
        models: (0..count).map(model).collect(),
        forms: ModelForms { full: true, engine: true },
    };
    data
}

/// Measures a pack that has models in both forms at `points` points, some tens of thousands.
///
/// # Errors
/// [`PackError`] of a pack that is none, or has no models in one of the forms.
pub fn query_cost(bytes: &[u8], points: u32) -> Result<QueryCost, PackError> {
    let start = Instant::now();
    let pack = Pack::new(bytes)?;
    let open_ms = start.elapsed().as_secs_f64() * 1e3;
    for kind in [SectionKind::Regions, SectionKind::ModelsFull, SectionKind::ModelsEngine] {
        if pack.count(kind) == 0 {
            return Err(PackError::Missing { kind });
        }
    }
    let queries = queries(&pack, points);
    let normal = black_box([0.6, 0.64, 0.48]);
    let decoded: Vec<_> = (0..pack.model_count()).filter_map(|i| Some(pack.engine_model(i)?.decode())).collect();
    let size = |kind| pack.records(kind).0.len() as f64;
    let around = [SectionKind::Regions, SectionKind::RegionNeighbours, SectionKind::RegionEdges, SectionKind::Strings];
    let mut object = MovingObject::new();
    let blend = TemporalBlend::default();
    Ok(QueryCost {
        regions: pack.region_count(),
        full_bytes: pack.records(SectionKind::ModelsFull).1,
        engine_bytes: pack.records(SectionKind::ModelsEngine).1,
        region_bytes: around.map(size).into_iter().sum::<f64>() / f64::from(pack.region_count()),
        open_ms,
        full_ns: time(&queries, |q| pack.full_at(q.region, q.point, 0).map_or(0.0, |c| ao_quadratic(c, normal))),
        engine_ns: time(&queries, |q| pack.engine_at(q.region, q.point).map_or(0.0, |c| ao_linear(c, normal))),
        decoded_ns: time(&queries, |q| {
            decoded.get(q.model as usize).map_or(0.0, |model| ao_linear(model.at(q.point), normal))
        }),
        hinted_lookup_ns: time(&queries, |q| pack.region_at(q.point, Some(q.region)).map_or(0.0, |hit| hit.distance_m)),
        lookup_ns: time(&queries[..queries.len().min(1000)], |q| {
            pack.region_at(q.point, None).map_or(0.0, |hit| hit.distance_m)
        }),
        object_ns: time(&queries, |q| {
            object = MovingObject::resume(Some(q.region), object.coefficients());
            object.update(&pack, q.point, 0.016, blend).map_or(0.0, |c| ao_linear(c, normal))
        }),
    })
}

/// A point and the region it is in.
struct Query {
    point: [f32; 3],
    region: u32,
    model: u32,
}

fn queries(pack: &Pack<'_>, count: u32) -> Vec<Query> {
    let mut word = 1u32;
    let mut roll = || {
        word = word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        word >> 8
    };
    let query = |_| {
        let index = roll() % pack.region_count().max(1);
        let region = pack.region(index)?;
        let point = array::from_fn(|i| {
            let fraction = roll() as f32 / (1 << 24) as f32;
            region.min[i] + (region.max[i] - region.min[i]) * fraction
        });
        Some(Query { point, region: index, model: region.model })
    };
    (0..count).filter_map(query).collect()
}

/// Nanoseconds of a query, the best of five rounds.
fn time(queries: &[Query], mut run: impl FnMut(&Query) -> f32) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..5 {
        let start = Instant::now();
        let sum: f32 = queries.iter().map(&mut run).sum();
        black_box(sum);
        best = best.min(start.elapsed().as_nanos() as f64 / queries.len().max(1) as f64);
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write::write;

    #[test]
    fn all_is_measured() {
        let bytes = write(&rooms(3)).unwrap();
        let cost = query_cost(&bytes, 50).unwrap();
        assert_eq!((cost.regions, cost.full_bytes, cost.engine_bytes), (27, 520, 68));
        let times =
            [cost.full_ns, cost.engine_ns, cost.decoded_ns, cost.hinted_lookup_ns, cost.lookup_ns, cost.object_ns];
        assert!(times.iter().all(|ns| ns.is_finite()) && cost.region_bytes > 72.0);
        assert!(query_cost(b"glTF", 1).is_err());
    }
}
