// Joined to kiln_runtime.wgsl: one invocation evaluates one case.

const ARGUMENTS = 95u;
const RESULTS = 16u;

@group(0) @binding(0) var<storage, read> arguments: array<u32>;
@group(0) @binding(1) var<storage, read_write> results: array<u32>;

var<private> next: u32;
var<private> out: u32;

fn take_word() -> u32 {
    next++;
    return arguments[next - 1u];
}

fn take() -> f32 {
    return bitcast<f32>(take_word());
}

fn take_three() -> vec3<f32> {
    let x = take();
    let y = take();
    return vec3<f32>(x, y, take());
}

fn take_four() -> vec4<f32> {
    let xyz = take_three();
    return vec4<f32>(xyz, take());
}

fn take_nine() -> KilnQuadratic {
    let low = take_four();
    let high = take_four();
    return KilnQuadratic(low, high, take());
}

fn put_word(word: u32) {
    results[out] = word;
    out++;
}

fn put(value: f32) {
    put_word(bitcast<u32>(value));
}

fn put_four(value: vec4<f32>) {
    put(value.x);
    put(value.y);
    put(value.z);
    put(value.w);
}

fn engine_form() {
    var words: array<u32, 17>;
    for (var i = 0u; i < 17u; i++) {
        words[i] = take_word();
    }
    let point = take_three();
    let low = take_three();
    let high = take_three();
    let coefficients = kiln_linear_at(kiln_linear_model(words), kiln_clamp(point, low, high));
    put_four(coefficients);
    put(kiln_ao_linear(coefficients, take_three()));
}

fn full_form() {
    let middle = take_three();
    let mean = take_nine();
    let x_above = take_nine();
    let x_below = take_nine();
    let y_above = take_nine();
    let y_below = take_nine();
    let z_above = take_nine();
    let z_below = take_nine();
    let model = KilnQuadraticModel(middle, mean, x_above, x_below, y_above, y_below, z_above, z_below);
    let point = take_three();
    let low = take_three();
    let high = take_three();
    let coefficients = kiln_quadratic_at(model, kiln_clamp(point, low, high));
    put_four(coefficients.low);
    put_four(coefficients.high);
    put(coefficients.last);
    put(kiln_ao_quadratic(coefficients, take_three()));
}

fn tree() {
    let position = take_three();
    let middle = take_three();
    let half_extent = take_three();
    let place = kiln_tree_place(position, middle, half_extent);
    put_four(vec4<f32>(place, 0.0));
    let local = take();
    put(kiln_tree_ao(local, take_four(), place));
}

fn blend() {
    let channels = take_four();
    put(kiln_blend(channels, take_four()));
}

fn temporal() {
    let dt_secs = take();
    let weight = kiln_temporal_weight(dt_secs, take());
    put(weight);
    let previous = take_four();
    put_four(kiln_temporal_blend(previous, take_four(), weight));
}

fn remap() {
    let ao = take();
    put(kiln_remap_gamma(ao, take()));
    let count = take_word();
    var points: array<vec4<f32>, 16>;
    for (var i = 0u; i < 16u; i++) {
        let x = take();
        points[i] = vec4<f32>(x, take(), 0.0, 0.0);
    }
    put(kiln_remap_curve(ao, points, count));
}

fn quantised() {
    let ao = take();
    let x = take_word();
    let y = take_word();
    let dither = kiln_dither(x, y, take_word());
    put_word(dither);
    let steps = kiln_quantise(ao, dither);
    put_word(steps);
    put_word(kiln_quantise(ao, 0x80000000u));
    put(kiln_dequantise(steps));
}

@compute @workgroup_size(64)
fn evaluate(@builtin(global_invocation_id) id: vec3<u32>) {
    next = id.x * (1u + ARGUMENTS);
    out = id.x * RESULTS;
    if next >= arrayLength(&arguments) {
        return;
    }
    switch take_word() {
        case 0u: { engine_form(); }
        case 1u: { full_form(); }
        case 2u: { tree(); }
        case 3u: { blend(); }
        case 4u: { temporal(); }
        case 5u: { remap(); }
        default: { quantised(); }
    }
}
