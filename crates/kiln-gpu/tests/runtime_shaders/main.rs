//! The runtime's shaders give what its Rust gives, function by function, on a software Vulkan driver. The test is here and
//! not in `kiln-runtime` since wgpu is.

mod gpu;

use gpu::{Case, evaluate};
use kiln_runtime::{
    Kernel, Pack, Region, TemporalBlend, TreeModel, ao_linear, ao_quadratic, dequantise, dither, quantise,
    quantise_nearest, remap_curve, remap_gamma, tree_ao,
    write::{MetaData, ModelData, ModelForms, PackData, RegionData, RegionsData, RemapData, TreeModelData, write},
};

/// Numbers from a sequence that fills ranges evenly, the same on each run.
struct Numbers(u32);

impl Numbers {
    /// From 0 to 1.
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        (word >> 8) as f32 / (1 << 24) as f32
    }

    fn within(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    fn array<const N: usize>(&mut self, low: f32, high: f32) -> [f32; N] {
        std::array::from_fn(|_| self.within(low, high))
    }

    fn direction(&mut self) -> [f32; 3] {
        let [z, turn] = [self.within(-1.0, 1.0), self.within(0.0, std::f32::consts::TAU)];
        let radius = (1.0 - z * z).max(0.0).sqrt();
        [radius * turn.cos(), radius * turn.sin(), z]
    }
}

/// A pack of models and trees at random.
fn pack(numbers: &mut Numbers, count: u32) -> Vec<u8> {
    let meta = MetaData {
        level_digest: [0; 32],
        version: String::new(),
        origin: [0.0; 3],
        kernel: Kernel::Obscurance,
        half_distances: vec![2.0, 300.0],
        blend: vec![0.03, 0.97],
        remap: RemapData::None,
    };
    let mut data = PackData::new(meta);
    let region = |numbers: &mut Numbers, model| {
        let (min, size): ([f32; 3], [f32; 3]) = (numbers.array(-50.0, 50.0), numbers.array(0.5, 20.0));
        RegionData { id: String::new(), min, max: std::array::from_fn(|i| min[i] + size[i]), model }
    };
    let model = |numbers: &mut Numbers, region: &RegionData, index| ModelData {
        region: index,
        center: std::array::from_fn(|i| numbers.within(region.min[i], region.max[i])),
        coefficients: (0..18)
            .map(|_| numbers.array(-0.2, 0.2))
            .map(|[mean, s @ ..]: [f32; 7]| {
                let [a, b, c, d, e, f] = s;
                [mean * 6.0 + 0.5, a, b, c, d, e, f]
            })
            .collect(),
    };
    let regions: Vec<RegionData> = (0..count).map(|index| region(numbers, index)).collect();
    let models = (0..).zip(&regions).map(|(index, region)| model(numbers, region, index)).collect();
    let forms = ModelForms { full: true, engine: true };
    data.regions = RegionsData { regions, edges: Vec::new(), models, forms };
    data.tree_models = (0..count)
        .map(|mesh| TreeModelData {
            mesh,
            center: numbers.array(-2.0, 2.0),
            // A billboard has no extent along one axis.
            half_extent: numbers.array(-0.5, 3.0).map(|half| half.max(0.0)),
            blocks: Vec::new(),
        })
        .collect();
    write(&data).expect("the data can be written")
}

fn float(bits: u32) -> f32 {
    f32::from_bits(bits)
}

/// Within some rounding errors of numbers of the size `scale`.
fn near(what: &str, bits: &[u32], expected: &[f32], scale: f32) {
    for (bits, expected) in bits.iter().zip(expected) {
        let error = (float(*bits) - expected).abs();
        assert!(error <= 2e-6 * scale, "{what}: {} in place of {expected}", float(*bits));
    }
}

const COUNT: u32 = 500;

/// A point in or around a region's box, every eighth at the model's centre.
fn point(numbers: &mut Numbers, region: &Region, center: [f32; 3], index: u32) -> [f32; 3] {
    if index.is_multiple_of(8) {
        center
    } else {
        region.clamp(numbers.array(-80.0, 80.0)).map(|x| x + numbers.within(-1.0, 1.0))
    }
}

#[test]
fn models_of_regions() {
    let mut numbers = Numbers(1);
    let bytes = pack(&mut numbers, COUNT);
    let pack = Pack::new(&bytes).expect("it is a pack");
    let (mut cases, mut expected) = (Vec::new(), Vec::new());
    for index in 0..COUNT {
        let region = pack.region(index).expect("it is there");
        let (engine, full) =
            (pack.engine_model(index).expect("it is there"), pack.full_model(index).expect("it is there"));
        let (point, normal) = (point(&mut numbers, &region, full.center(), index), numbers.direction());
        let words: Vec<u32> =
            engine.bytes().chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        let place = |case: Case| case.floats(&point).floats(&region.min).floats(&region.max).floats(&normal);
        cases.push(place(Case::new(0).words(&words)));
        let channel = (index % 2) as usize;
        let parameters: Vec<f32> = (0..7).flat_map(|p| (0..9).map(move |k| full.parameter(p, channel, k))).collect();
        cases.push(place(Case::new(1).floats(&full.center()).floats(&parameters)));
        let linear = pack.engine_at(index, point).expect("it is there");
        let quadratic = pack.full_at(index, point, channel).expect("it is there");
        expected.push((linear, ao_linear(linear, normal), quadratic, ao_quadratic(quadratic, normal)));
    }
    for (results, (linear, linear_ao, quadratic, quadratic_ao)) in evaluate(cases).chunks_exact(2).zip(expected) {
        near("linear coefficients", &results[0], &linear, 8.0);
        near("AO from them", &results[0][4..], &[linear_ao], 8.0);
        near("quadratic coefficients", &results[1], &quadratic, 8.0);
        near("AO from them", &results[1][9..], &[quadratic_ao], 8.0);
    }
}

#[test]
fn trees_and_blends() {
    let mut numbers = Numbers(2);
    let bytes = pack(&mut numbers, COUNT);
    let pack = Pack::new(&bytes).expect("it is a pack");
    let (mut cases, mut expected) = (Vec::new(), Vec::new());
    for index in 0..COUNT {
        let model: TreeModel = pack.tree_model(index).expect("it is there");
        let (position, local, y): ([f32; 3], f32, [f32; 4]) =
            (numbers.array(-4.0, 4.0), numbers.unit(), numbers.array(-0.5, 1.0));
        let case = Case::new(2).floats(&position).floats(&model.center).floats(&model.half_extent);
        cases.push(case.floats(&[local]).floats(&y));
        let [u, v, w] = model.place(position);
        let (channels, weights): ([f32; 4], [f32; 4]) = (numbers.array(0.0, 1.0), numbers.array(0.0, 0.25));
        cases.push(Case::new(3).floats(&channels).floats(&weights));
        expected
            .push(([u, v, w, 0.0, tree_ao(local, y, [u, v, w])], kiln_runtime::blend_channels(&channels, &weights)));
    }
    for (results, (tree, blend)) in evaluate(cases).chunks_exact(2).zip(expected) {
        near("a place and AO of a tree", &results[0], &tree, 2.0);
        near("a blend", &results[1], &[blend], 1.0);
    }
}

#[test]
fn temporal_blending() {
    let mut numbers = Numbers(3);
    let odd = [(0.0, 0.1), (-1.0, 0.1), (0.1, 0.0), (0.1, -1.0), (1e30, 0.1), (1e-6, 1e6), (0.1, 0.1)];
    let times = (0..COUNT).map(|_| (numbers.within(0.0, 0.3), numbers.within(0.01, 1.0)));
    let times: Vec<(f32, f32)> = odd.into_iter().chain(times).collect();
    let mut numbers = Numbers(4);
    let values: Vec<[[f32; 4]; 2]> =
        times.iter().map(|_| [numbers.array(-1.0, 4.0), numbers.array(-1.0, 4.0)]).collect();
    let case =
        |(&(dt, half), [a, b]): (&(f32, f32), &[[f32; 4]; 2])| Case::new(4).floats(&[dt, half]).floats(a).floats(b);
    let results = evaluate(times.iter().zip(&values).map(case).collect());
    for ((&(dt, half_time_secs), [previous, now]), results) in times.iter().zip(&values).zip(results) {
        let blend = TemporalBlend { half_time_secs };
        near("a weight", &results, &[blend.weight(dt)], 1.0);
        near("a blend with the last frame", &results[1..], &blend.blend(*previous, *now, dt), 5.0);
    }
}

#[test]
fn curves_over_ao() {
    let mut numbers = Numbers(5);
    let (mut cases, mut expected) = (Vec::new(), Vec::new());
    for index in 0..COUNT {
        let (ao, gamma) = (numbers.within(-0.1, 1.1), numbers.within(0.2, 4.0));
        let count = 1 + index as usize % 16;
        let mut input = numbers.within(-0.1, 0.2);
        let mut points = [[0.0; 2]; 16];
        for point in &mut points[..count] {
            *point = [input, numbers.within(-0.2, 1.2)];
            input += numbers.within(0.01, 0.15);
        }
        let case = Case::new(5).floats(&[ao, gamma]).words(&[count as u32]);
        cases.push(case.floats(points.as_flattened()));
        expected.push((remap_gamma(ao, gamma), remap_curve(ao, &points[..count])));
    }
    for (results, (gamma, curve)) in evaluate(cases).into_iter().zip(expected) {
        // A power is two functions of the driver's, each good to some 2⁻²¹.
        near("a power", &results, &[gamma], 4.0);
        near("a curve", &results[1..], &[curve], 16.0);
    }
}

/// To the bit: whole numbers, and one product that every processor rounds alike.
#[test]
fn five_bits() {
    let mut numbers = Numbers(6);
    let (mut cases, mut expected) = (Vec::new(), Vec::new());
    for index in 0..4 * COUNT {
        let ao = if index <= 31 { dequantise(index) } else { numbers.within(-0.1, 1.1) };
        let [x, y, frame] = [index * 7, index / 3, index % 64];
        cases.push(Case::new(6).floats(&[ao]).words(&[x, y, frame]));
        let dither = dither(x, y, frame);
        expected.push(([dither, quantise(ao, dither), quantise_nearest(ao)], dequantise(quantise(ao, dither))));
    }
    for (results, (whole, decoded)) in evaluate(cases).into_iter().zip(expected) {
        assert_eq!(results[..3], whole);
        near("AO of steps", &results[3..], &[decoded], 1.0);
    }
}
