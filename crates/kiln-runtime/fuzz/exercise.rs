//! What the fuzzer, and the tests over its corpus, do with bytes: open them as a pack and call everything there is.

use kiln_runtime::{
    MovingObject, Pack, PackError, Region, SectionKind, TemporalBlend, Values, ao_linear, ao_quadratic, quantise,
    tree_ao,
};

/// Calls at most of what looks at all regions.
const SEARCHES: u32 = 64;

/// Opens bytes as a pack and calls every accessor; gives a sum over what they gave, so that none is optimised away.
pub(crate) fn exercise(bytes: &[u8]) -> Result<f64, PackError> {
    let pack = Pack::new(bytes)?;
    let mut sum = meta(&pack) + vertices(&pack) + trees(&pack) + regions(&pack);
    for size in pack.sizes() {
        sum += size.bytes as f64 + f64::from(size.count) + f64::from(size.number);
    }
    for kind in SectionKind::ALL {
        let (bytes, stride) = pack.records(kind);
        assert_eq!(bytes.len(), stride * pack.count(kind));
    }
    Ok(sum + (pack.size_bytes() + usize::from(pack.minor_version())) as f64)
}

fn unit(ao: f32) -> f64 {
    assert!((0.0..=1.0).contains(&ao), "AO is {ao}");
    f64::from(ao)
}

fn meta(pack: &Pack<'_>) -> f64 {
    let meta = pack.meta();
    let weights: f32 = meta.blend().iter().sum();
    assert!((weights - 1.0).abs() < 1e-5 && meta.blend().len() == meta.channels());
    assert!(meta.half_distances().iter().all(|distance| *distance > 0.0));
    let curve: f64 = [-1.0, 0.0, 0.3, 1.0, f32::NAN].into_iter().map(|ao| unit(meta.remap().apply(ao))).sum();
    curve + f64::from(meta.local(meta.origin())[0]) + (meta.version().len() + meta.level_digest().len()) as f64
}

fn sum_of(values: Values<'_>, channels: usize) -> f64 {
    let mut sum = values.bytes().len() as f64;
    let count = values.vertex_count();
    for vertex in [0, 1, count / 2, count.saturating_sub(1)] {
        sum += (0..channels).filter_map(|channel| values.get(vertex, channel)).map(unit).sum::<f64>();
    }
    assert!(values.get(count, 0).is_none() && values.get(0, channels).is_none());
    sum
}

fn vertices(pack: &Pack<'_>) -> f64 {
    let mut sum = 0.0;
    for index in 0..pack.count(SectionKind::VertexSets) as u32 {
        let set = pack.vertex_set_at(index).expect("it is counted");
        let found = pack.vertex_set(set.node, set.gpu_instance, set.primitive).expect("it is there");
        assert_eq!(found.values.bytes().as_ptr(), set.values.bytes().as_ptr());
        sum += sum_of(set.values, pack.channels());
    }
    sum
}

fn trees(pack: &Pack<'_>) -> f64 {
    let (mut sum, channels) = (0.0, pack.channels());
    for index in 0..pack.count(SectionKind::TreeInstances) as u32 {
        let tree = pack.tree_instance_at(index).expect("it is counted");
        let model = pack.tree_model(tree.model).expect("it was checked");
        let place = model.place([0.5, f32::MAX, f32::NAN]);
        sum += (0..channels)
            .filter_map(|channel| tree.numbers(channel))
            .map(|y| unit(tree_ao(0.5, y, place)))
            .sum::<f64>();
        sum += unit(tree_ao(f32::NAN, tree.blend(), place));
        assert!(pack.tree_instance(tree.node, tree.gpu_instance).is_some() && tree.numbers(channels).is_none());
    }
    for index in 0..pack.count(SectionKind::TreeModels) as u32 {
        let model = pack.tree_model(index).expect("it is counted");
        // Models may share blocks, so all blocks of all models could be more work than the pack's size allows.
        for block in 0..model.block_count().min(SEARCHES) {
            let block = pack.tree_block(&model, block).expect("it was checked");
            sum += sum_of(block.values, channels) + f64::from(block.primitive);
        }
        assert!(pack.tree_block(&model, model.block_count()).is_none());
    }
    for index in 0..pack.count(SectionKind::Scalars) as u32 {
        let scalar = pack.scalar_at(index).expect("it is counted");
        sum += (0..channels).filter_map(|channel| scalar.ao(channel)).map(unit).sum::<f64>();
        sum += unit(scalar.blend(pack.meta().blend()));
        assert!(pack.scalar(scalar.node, scalar.gpu_instance).is_some());
    }
    sum
}

fn regions(pack: &Pack<'_>) -> f64 {
    let mut sum = 0.0;
    let mut object = MovingObject::new();
    for index in 0..pack.region_count() {
        let region = pack.region(index).expect("it is counted");
        sum += pack.region_id(index).expect("it was checked").len() as f64;
        for point in [region.min, region.max, [0.0; 3], [f32::MAX, -f32::MAX, 1.0], [f32::NAN; 3]] {
            sum += models(pack, index, &region, point);
        }
        if index < SEARCHES {
            sum += pack.neighbours(&region).map(f64::from).sum::<f64>();
            let hit = pack.region_at(region.min, Some(index)).expect("there are regions");
            let found = pack.region(hit.region).expect("it is a region");
            assert!(found.contains(region.min) && hit.distance_m == 0.0 && found.volume() <= region.volume());
            object.update(pack, region.max, 0.016, TemporalBlend::default());
            sum += pack.region_at([3e38, -1.0, 0.0], Some(u32::MAX)).map_or(0.0, |hit| f64::from(hit.region));
            assert!(pack.region_with_id(pack.region_id(index).expect("it was checked")).is_some());
        }
    }
    for index in 0..pack.count(SectionKind::RegionEdges) as u32 {
        let edge = pack.region_edge(index).expect("it is counted");
        assert!(edge.regions.iter().all(|region| *region < pack.region_count()));
    }
    sum
}

fn models(pack: &Pack<'_>, index: u32, region: &Region, point: [f32; 3]) -> f64 {
    assert!(region.contains(region.clamp(point)) && region.volume() >= 0.0);
    let mut sum = 0.0;
    if let Some(coefficients) = pack.engine_at(index, point) {
        let ao = ao_linear(coefficients, [0.0, 1.0, 0.0]);
        sum += unit(ao) + f64::from(quantise(ao, 7));
    }
    for channel in 0..pack.channels() {
        if let Some(coefficients) = pack.full_at(index, point, channel) {
            sum += unit(ao_quadratic(coefficients, [0.6, 0.0, 0.8]));
        }
    }
    if let Some(model) = pack.engine_model(region.model) {
        sum += f64::from(model.decode().parameters[6][3]) + f64::from(model.bytes()[0]);
    }
    if let Some(model) = pack.full_model(region.model) {
        assert!(model.region() < pack.region_count());
        sum += f64::from(model.parameter(6, 0, 8)) + f64::from(model.parameter(7, 9, 99));
    }
    sum
}
