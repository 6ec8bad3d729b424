//! What is written is read: everything, whatever it is.

use crate::{exercise::exercise, sample};
use kiln_runtime::{
    Pack, Remap, SectionKind, Values,
    format::HARMONICS,
    half,
    write::{MetaData, PackData, RegionsData, RemapData, ValueData, WriteError, write},
};
use proptest::prelude::*;

fn check_meta(pack: &Pack<'_>, data: &MetaData) {
    let meta = pack.meta();
    assert_eq!((meta.level_digest(), meta.version()), (&data.level_digest, data.version.as_str()));
    assert_eq!((meta.origin(), meta.half_distances()), (data.origin, data.half_distances.as_slice()));
    assert_eq!(meta.kernel(), data.kernel);
    let sum: f32 = data.blend.iter().sum();
    for (weight, given) in meta.blend().iter().zip(&data.blend) {
        assert!((weight - given / sum).abs() < 1e-6);
    }
    match (&data.remap, meta.remap()) {
        (RemapData::None, Remap::None) => {}
        (RemapData::Gamma(given), Remap::Gamma(gamma)) => assert_eq!(*given, gamma),
        (RemapData::Curve(points), Remap::Curve(curve)) => {
            let read: Vec<[f32; 2]> = (0..curve.len()).map_while(|index| curve.point(index)).collect();
            assert_eq!((&read, curve.point(curve.len())), (points, None));
            for ao in [0.0, 0.1, 0.3, 0.77, 1.0] {
                assert_eq!(meta.remap().apply(ao), kiln_runtime::remap_curve(ao, points));
            }
        }
        (given, read) => panic!("{given:?} became {read:?}"),
    }
}

fn check_values(read: Values<'_>, given: &ValueData<'_>, channels: usize) {
    assert_eq!(read.vertex_count() * channels, given.len());
    for index in 0..given.len() {
        let value = read.get(index / channels, index % channels).unwrap();
        match given {
            ValueData::F32(values) => assert_eq!(value, values[index]),
            ValueData::U16(values) => assert_eq!(value, f32::from(values[index]) / 65535.0),
        }
    }
}

fn check_static(pack: &Pack<'_>, data: &PackData<'_>) {
    for set in &data.vertex_sets {
        for &primitive in &set.primitives {
            let found = pack.vertex_set(set.node, set.gpu_instance, primitive).unwrap();
            check_values(found.values, &set.values, pack.channels());
        }
    }
    assert!(pack.vertex_set(1000, None, 0).is_none());
    for (index, given) in (0..).zip(&data.tree_models) {
        let model = pack.tree_model(index).unwrap();
        assert_eq!((model.mesh, model.center, model.half_extent), (given.mesh, given.center, given.half_extent));
        let blocks: Vec<_> =
            given.blocks.iter().flat_map(|b| b.primitives.iter().map(move |p| (*p, &b.values))).collect();
        assert_eq!(model.block_count() as usize, blocks.len());
        for (index, (primitive, values)) in (0..).zip(blocks) {
            let block = pack.tree_block(&model, index).unwrap();
            assert_eq!(block.primitive, primitive);
            check_values(block.values, values, pack.channels());
        }
    }
    for given in &data.tree_instances {
        let tree = pack.tree_instance(given.node, given.gpu_instance).unwrap();
        assert_eq!((tree.model, tree.blend()), (given.model, given.blend));
        assert!((0..pack.channels()).all(|channel| tree.numbers(channel) == Some(given.numbers[channel])));
    }
    for given in &data.scalars {
        let scalar = pack.scalar(given.node, given.gpu_instance).unwrap();
        assert!((0..pack.channels()).all(|channel| scalar.ao(channel) == Some(given.values[channel])));
    }
}

fn check_regions(pack: &Pack<'_>, data: &RegionsData, weights: &[f32]) {
    assert_eq!(pack.region_count() as usize, data.regions.len());
    for (index, given) in (0..).zip(&data.regions) {
        let region = pack.region(index).unwrap();
        assert_eq!((region.min, region.max, region.model), (given.min, given.max, given.model));
        assert_eq!(pack.region_id(index), Some(given.id.as_str()));
        let beside = |edge: &kiln_runtime::write::EdgeData| match edge.regions {
            [a, b] if a == index => Some(b),
            [a, b] if b == index => Some(a),
            _ => None,
        };
        let mut neighbours: Vec<u32> = data.edges.iter().filter_map(beside).collect();
        neighbours.sort_unstable();
        let mut read: Vec<u32> = pack.neighbours(&region).collect();
        read.sort_unstable();
        assert_eq!(read, neighbours);
    }
    for (index, given) in (0..).zip(&data.edges) {
        let edge = pack.region_edge(index).unwrap();
        assert_eq!((edge.regions, edge.area_m2, edge.center), (given.regions, given.area_m2, given.center));
    }
    let sum: f32 = weights.iter().sum();
    for (index, given) in (0..).zip(&data.models) {
        assert_eq!(pack.full_model(index).is_some(), data.forms.full);
        assert_eq!(pack.engine_model(index).is_some(), data.forms.engine);
        for (i, parameters) in given.coefficients.iter().enumerate() {
            let Some(model) = pack.full_model(index) else { break };
            let read: Vec<f32> = (0..7).map(|p| model.parameter(p, i / HARMONICS, i % HARMONICS)).collect();
            assert_eq!(
                (read.as_slice(), model.center(), model.region()),
                (&parameters[..], given.center, given.region)
            );
        }
        for (p, harmonic) in (0..7).flat_map(|p| (0..4).map(move |harmonic| (p, harmonic))) {
            let Some(model) = pack.engine_model(index) else { break };
            let channels = given.coefficients.chunks_exact(HARMONICS).zip(weights);
            let blend: f32 = channels.map(|(c, weight)| c[harmonic][p] * weight / sum).sum();
            let error = (model.decode().parameters[p][harmonic] - blend).abs();
            assert!(error <= blend.abs() / 2048.0 + 1e-6, "{error} of {blend}");
        }
    }
}

fn check(data: &PackData<'_>) {
    let bytes = write(data).unwrap();
    let pack = Pack::new(&bytes).unwrap();
    assert_eq!((pack.channels(), pack.size_bytes()), (data.meta.half_distances.len(), bytes.len()));
    check_meta(&pack, &data.meta);
    check_static(&pack, data);
    check_regions(&pack, &data.regions, &data.meta.blend);
    exercise(&bytes).unwrap();
    let mut shuffled = data.clone();
    shuffled.vertex_sets.reverse();
    shuffled.tree_instances.reverse();
    shuffled.scalars.reverse();
    assert!(write(&shuffled).unwrap() == bytes, "the order of instances matters");
}

#[test]
fn some_of_everything() {
    check(&sample::all());
    check(&PackData::new(sample::meta(1)));
}

#[test]
fn sizes_add_up() {
    let bytes = write(&sample::all()).unwrap();
    let pack = Pack::new(&bytes).unwrap();
    let sizes: Vec<_> = pack.sizes().collect();
    assert_eq!(sizes.len(), SectionKind::ALL.len());
    for size in &sizes {
        let kind = size.kind.unwrap();
        assert_eq!((size.count as usize, size.number), (pack.count(kind), kind as u32), "{}", kind.name());
    }
    let sum: u64 = sizes.iter().map(|size| size.bytes).sum();
    let frame = 64 + 32 * sizes.len() as u64;
    assert!((sum + frame..=sum + frame + 15 * sizes.len() as u64).contains(&(bytes.len() as u64)));
}

#[test]
fn what_cannot_be_written_is_refused() {
    let refused = |change: &dyn Fn(&mut PackData<'static>)| {
        let mut data = sample::all();
        change(&mut data);
        write(&data).unwrap_err()
    };
    assert_eq!(refused(&|d| d.meta.half_distances.clear()), WriteError::Channels { channels: 0 });
    assert!(matches!(refused(&|d| d.meta.half_distances = vec![1.0; 5]), WriteError::Channels { channels: 5 }));
    assert!(matches!(refused(&|d| d.meta.blend.truncate(1)), WriteError::Size { found: 1, expected: 2, .. }));
    assert!(matches!(refused(&|d| d.regions.models[1].coefficients.truncate(5)), WriteError::Size { index: 1, .. }));
    assert!(matches!(refused(&|d| d.regions.models[1].coefficients[0][3] = 1e7), WriteError::Half { model: 1 }));
    assert!(matches!(refused(&|d| d.regions.models[0].coefficients[0][0] = f32::NAN), WriteError::Refused(_)));
    assert!(matches!(refused(&|d| d.regions.regions[0].model = 3), WriteError::Refused(_)));
    assert!(matches!(refused(&|d| d.regions.regions[0].max[1] = -1.0), WriteError::Refused(_)));
    assert!(matches!(refused(&|d| d.regions.edges[0].regions[1] = 4), WriteError::Refused(_)));
    assert!(matches!(refused(&|d| d.tree_instances[0].model = 1), WriteError::Refused(_)));
    assert!(matches!(refused(&|d| d.meta.blend = vec![0.0; 2]), WriteError::Refused(_)));
    assert!(matches!(refused(&|d| d.meta.half_distances[0] = -1.0), WriteError::Refused(_)));
    let twice = refused(&|d| d.scalars.push(d.scalars[0].clone())).to_string();
    assert!(twice.contains("scalars") && twice.contains("do not come after"), "{twice}");
}

#[test]
fn large_slopes_can_be_written_in_full_form_alone() {
    let mut data = sample::all();
    data.regions.models[1].coefficients[0][3] = half::LARGEST * 4.0;
    data.regions.forms.engine = false;
    check(&data);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn anything(data in sample::any_data()) {
        check(&data);
    }
}
