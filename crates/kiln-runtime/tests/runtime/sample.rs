//! Data for packs: a fixed piece of everything, and anything at random.

use kiln_runtime::{
    Kernel,
    format::HARMONICS,
    write::{
        EdgeData, MetaData, ModelData, ModelForms, PackData, RegionData, RegionsData, RemapData, ScalarData,
        TreeBlockData, TreeInstanceData, TreeModelData, ValueData, VertexSetData,
    },
};
use proptest::{collection::vec, option, prelude::*};
use std::{borrow::Cow, collections::BTreeMap};

/// Some of everything, with two channels.
pub(crate) fn all() -> PackData<'static> {
    let mut data = PackData::new(meta(2));
    data.meta.remap = RemapData::Curve(vec![[0.0, 0.1], [0.5, 0.4], [1.0, 1.0]]);
    let set = |node, gpu_instance, primitives: &[u32], values| VertexSetData {
        node,
        gpu_instance,
        primitives: primitives.to_vec(),
        values,
    };
    data.vertex_sets = vec![
        set(7, None, &[0, 2], ValueData::F32(Cow::Owned(vec![0.0, 0.25, 0.5, 0.75, 1.0, 0.125]))),
        set(3, Some(1), &[0], ValueData::normalised(&[0.0, 1.0, 0.5, 0.25])),
        set(3, Some(0), &[0], ValueData::normalised(&[1.0, 0.0])),
    ];
    data.tree_models = vec![TreeModelData {
        mesh: 4,
        center: [0.0, 2.0, 0.0],
        half_extent: [1.0, 2.0, 0.5],
        blocks: vec![TreeBlockData { primitives: vec![0, 1], values: ValueData::normalised(&[0.5, 0.75, 1.0, 0.25]) }],
    }];
    let tree = |node| TreeInstanceData {
        node,
        gpu_instance: None,
        model: 0,
        numbers: vec![[0.8, 0.1, -0.1, 0.0], [0.5, 0.0, 0.25, 0.125]],
        blend: [0.51, 0.0, 0.24, 0.12],
    };
    data.tree_instances = vec![tree(12), tree(11)];
    data.scalars = vec![ScalarData { node: 20, gpu_instance: Some(5), values: vec![0.9, 0.4] }];
    data.regions = house();
    data
}

/// Three rooms in a row along x, 4 × 3 × 4 m each, the third absorbed by the second; one around all of them.
pub(crate) fn house() -> RegionsData {
    let room = |name: &str, x: f32, model| RegionData {
        id: name.to_owned(),
        min: [x, 0.0, 0.0],
        max: [x + 4.0, 3.0, 4.0],
        model,
    };
    let outside = RegionData { id: "outside".to_owned(), min: [-10.0, -1.0, -10.0], max: [20.0, 9.0, 14.0], model: 2 };
    let edge = |a, b, x| EdgeData { regions: [a, b], area_m2: 2.0, center: [x, 1.0, 2.0] };
    RegionsData {
        regions: vec![room("hall", 0.0, 0), room("kitchen", 4.0, 1), room("larder", 8.0, 1), outside],
        edges: vec![edge(0, 1, 4.0), edge(1, 2, 8.0), edge(0, 3, 0.0), edge(1, 3, 6.0), edge(2, 3, 12.0)],
        models: vec![model(0, [2.0, 1.5, 2.0], 0.6), model(1, [6.0, 1.5, 2.0], 0.4), model(3, [5.0, 4.0, 2.0], 0.9)],
        forms: ModelForms { full: true, engine: true },
    }
}

/// AO about `ao` for all normals, brightest at the centre and falling to all sides; both channels alike, but for a sign.
pub(crate) fn model(region: u32, center: [f32; 3], ao: f32) -> ModelData {
    let coefficient = |index: usize| {
        let constant = if index.is_multiple_of(HARMONICS) {
            (4.0 * std::f32::consts::PI).sqrt() * ao
        } else {
            0.01 * index as f32
        };
        [constant, -0.1, 0.1, -0.15, 0.15, -0.2, 0.2]
    };
    ModelData { region, center, coefficients: (0..2 * HARMONICS).map(coefficient).collect() }
}

/// What every pack has, with some channels.
pub(crate) fn meta(channels: usize) -> MetaData {
    MetaData {
        level_digest: std::array::from_fn(|i| i as u8),
        version: "1.2.3".to_owned(),
        origin: [1024.0, -2048.0, 0.5],
        kernel: Kernel::Obscurance,
        half_distances: [2.0, 300.0, 1.0, 5000.0][..channels].to_vec(),
        blend: if channels == 2 { vec![0.03, 0.97] } else { vec![1.0; channels] },
        remap: RemapData::None,
    }
}

/// Anything that can be written.
pub(crate) fn any_data() -> impl Strategy<Value = PackData<'static>> {
    (1usize..=4).prop_flat_map(|channels| {
        (any_meta(channels), any_sets(channels), any_trees(channels), any_scalars(channels), any_regions(channels))
            .prop_map(|(meta, vertex_sets, (tree_models, tree_instances), scalars, regions)| PackData {
                meta,
                vertex_sets,
                tree_models,
                tree_instances,
                scalars,
                regions,
            })
    })
}

fn any_meta(channels: usize) -> impl Strategy<Value = MetaData> {
    let remap = prop_oneof![
        Just(RemapData::None),
        (0.1..5.0f32).prop_map(RemapData::Gamma),
        vec(0.0..1.0f32, 1..9).prop_map(|outputs| {
            RemapData::Curve(outputs.iter().enumerate().map(|(i, output)| [i as f32 / 8.0, *output]).collect())
        }),
    ];
    let kernel = prop_oneof![Just(Kernel::Obscurance), Just(Kernel::Occlusion), Just(Kernel::Other)];
    let lists = (vec(0.1..1e4f32, channels), vec(0.0..1.0f32, channels));
    (any::<[u8; 32]>(), ".{0,12}", any::<[i32; 3]>(), kernel, lists, remap).prop_map(
        |(level_digest, version, origin, kernel, (half_distances, mut blend), remap)| {
            blend[0] += 0.5;
            let origin = origin.map(f64::from);
            MetaData { level_digest, version, origin, kernel, half_distances, blend, remap }
        },
    )
}

fn any_values(channels: usize) -> impl Strategy<Value = ValueData<'static>> {
    (vec(0.0..=1.0f32, 0..20), any::<bool>()).prop_map(move |(mut values, is_f32)| {
        values.truncate(values.len() / channels * channels);
        if is_f32 { ValueData::F32(Cow::Owned(values)) } else { ValueData::normalised(&values) }
    })
}

/// Nodes and instances that come once each.
fn any_keys() -> impl Strategy<Value = Vec<(u32, Option<u32>)>> {
    vec((0u32..50, option::of(0u32..9)), 0..8).prop_map(|mut keys| {
        keys.sort_unstable();
        keys.dedup();
        keys.reverse();
        keys
    })
}

fn any_sets(channels: usize) -> impl Strategy<Value = Vec<VertexSetData<'static>>> {
    (any_keys(), vec(any_values(channels), 8)).prop_map(|(keys, values)| {
        let set =
            |((node, gpu_instance), values)| VertexSetData { node, gpu_instance, primitives: vec![node, 99], values };
        keys.into_iter().zip(values).map(set).collect()
    })
}

type Trees = (Vec<TreeModelData<'static>>, Vec<TreeInstanceData>);

fn any_trees(channels: usize) -> impl Strategy<Value = Trees> {
    let block = (vec(any::<u32>(), 0..3), any_values(channels));
    let block = block.prop_map(|(primitives, values)| TreeBlockData { primitives, values });
    let model = (any::<u32>(), any::<[i8; 3]>(), any::<[u8; 3]>(), vec(block, 0..3));
    let model = model.prop_map(|(mesh, center, half, blocks)| TreeModelData {
        mesh,
        center: center.map(f32::from),
        half_extent: half.map(f32::from),
        blocks,
    });
    let numbers = vec(vec([-1.0..1.0f32, -1.0..1.0, -1.0..1.0, -1.0..1.0], channels + 1), 8);
    (vec(model, 1..4), any_keys(), numbers).prop_map(|(models, keys, numbers)| {
        let count = models.len() as u32;
        let tree = |((node, gpu_instance), mut numbers): (_, Vec<[f32; 4]>)| {
            let blend = numbers.pop().expect("one for the blend");
            TreeInstanceData { node, gpu_instance, model: node % count, numbers, blend }
        };
        (models, keys.into_iter().zip(numbers).map(tree).collect())
    })
}

fn any_scalars(channels: usize) -> impl Strategy<Value = Vec<ScalarData>> {
    (any_keys(), vec(vec(0.0..=1.0f32, channels), 8)).prop_map(|(keys, values)| {
        keys.into_iter()
            .zip(values)
            .map(|((node, gpu_instance), values)| ScalarData { node, gpu_instance, values })
            .collect()
    })
}

fn any_regions(channels: usize) -> impl Strategy<Value = RegionsData> {
    let boxes = vec((".{0,8}", [-50.0..50.0f32, -50.0..50.0, -50.0..50.0], [0.1..20.0f32, 0.1..20.0, 0.1..20.0]), 1..7);
    let parameter = || -4.0..4.0f32;
    let parameters = move || [(); 7].map(|()| parameter());
    let models = vec(([parameter(), parameter(), parameter()], vec(parameters(), channels * HARMONICS)), 1..5);
    let forms = prop_oneof![Just((true, true)), Just((true, false)), Just((false, true))];
    (boxes, models, vec((0u32..7, 0u32..7), 0..8), forms).prop_map(|(boxes, models, pairs, (full, engine))| {
        let (count, model_count) = (boxes.len() as u32, models.len() as u32);
        let region = |(i, (id, min, size)): (u32, (String, [f32; 3], [f32; 3]))| {
            let max = std::array::from_fn(|axis| min[axis] + size[axis]);
            RegionData { id, min, max, model: i % model_count }
        };
        let once: BTreeMap<[u32; 2], ()> = pairs
            .into_iter()
            .map(|(a, b)| ([a.min(b) % count, a.max(b) % count], ()))
            .filter(|([a, b], ())| a < b)
            .collect();
        let edge = |regions| EdgeData { regions, area_m2: 0.5, center: [1.0, 2.0, 3.0] };
        let model = |(center, coefficients)| ModelData { region: 0, center, coefficients };
        RegionsData {
            regions: (0..).zip(boxes).map(region).collect(),
            edges: once.into_keys().map(edge).collect(),
            models: models.into_iter().map(model).collect(),
            forms: ModelForms { full, engine },
        }
    })
}
