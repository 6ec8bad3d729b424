// Evaluation of what a Kiln pack holds, for shaders: what kiln-runtime's Rust does, function by function. Include the text,
// and call what you need; it has no bindings and no entry points. The .hlsl, .glsl and .metal beside this file are written
// from it by `cargo xtask shaders`.
//
// Points are relative to the level's origin, metres; normals are unit vectors; AO is from 0 to 1, 1 open.

// A region's model in the engine's form: linear coefficients of AO in the order 1, y, z, x; the mean at the centre, and
// slopes per metre to both sides along each axis. (model.rs) The middle is the model's centre, which is a word of HLSL.
struct KilnLinearModel {
    middle: vec3<f32>,
    mean: vec4<f32>,
    x_above: vec4<f32>,
    x_below: vec4<f32>,
    y_above: vec4<f32>,
    y_below: vec4<f32>,
    z_above: vec4<f32>,
    z_below: vec4<f32>,
}

// Nine quadratic coefficients: 1, y, z, x; xy, yz, 3z² − 1, xz; x² − y².
struct KilnQuadratic {
    low: vec4<f32>,
    high: vec4<f32>,
    last: f32,
}

// One channel of a region's full model.
struct KilnQuadraticModel {
    middle: vec3<f32>,
    mean: KilnQuadratic,
    x_above: KilnQuadratic,
    x_below: KilnQuadratic,
    y_above: KilnQuadratic,
    y_below: KilnQuadratic,
    z_above: KilnQuadratic,
    z_below: KilnQuadratic,
}

// Four half floats from two words of a pack.
fn kiln_halves(first: u32, second: u32) -> vec4<f32> {
    return vec4<f32>(unpack2x16float(first), unpack2x16float(second));
}

// A record of the section "region models (engine)", 68 bytes.
fn kiln_linear_model(words: array<u32, 17>) -> KilnLinearModel {
    return KilnLinearModel(
        vec3<f32>(bitcast<f32>(words[0]), bitcast<f32>(words[1]), bitcast<f32>(words[2])),
        kiln_halves(words[3], words[4]),
        kiln_halves(words[5], words[6]),
        kiln_halves(words[7], words[8]),
        kiln_halves(words[9], words[10]),
        kiln_halves(words[11], words[12]),
        kiln_halves(words[13], words[14]),
        kiln_halves(words[15], words[16]),
    );
}

// The point of a region's box that is nearest. Nothing bounds a model outside its box: clamp first.
fn kiln_clamp(point: vec3<f32>, low: vec3<f32>, high: vec3<f32>) -> vec3<f32> {
    return min(max(point, low), high);
}

// Coefficients at a point: a vector difference and three multiply-adds.
fn kiln_linear_at(model: KilnLinearModel, point: vec3<f32>) -> vec4<f32> {
    let offset = point - model.middle;
    return model.mean
        + offset.x * select(model.x_above, model.x_below, offset.x < 0.0)
        + offset.y * select(model.y_above, model.y_below, offset.y < 0.0)
        + offset.z * select(model.z_above, model.z_below, offset.z < 0.0);
}

fn kiln_add(sum: KilnQuadratic, factor: f32, above: KilnQuadratic, below: KilnQuadratic) -> KilnQuadratic {
    let is_below = factor < 0.0;
    return KilnQuadratic(
        sum.low + factor * select(above.low, below.low, is_below),
        sum.high + factor * select(above.high, below.high, is_below),
        sum.last + factor * select(above.last, below.last, is_below),
    );
}

// The same for a channel of the full model.
fn kiln_quadratic_at(model: KilnQuadraticModel, point: vec3<f32>) -> KilnQuadratic {
    let offset = point - model.middle;
    let with_x = kiln_add(model.mean, offset.x, model.x_above, model.x_below);
    let with_y = kiln_add(with_x, offset.y, model.y_above, model.y_below);
    return kiln_add(with_y, offset.z, model.z_above, model.z_below);
}

fn kiln_unit(value: f32) -> f32 {
    return min(max(value, 0.0), 1.0);
}

// Real spherical harmonics, with the constants of harmonics.rs.
fn kiln_linear_harmonics(normal: vec3<f32>) -> vec4<f32> {
    return vec4<f32>(0.28209479, 0.48860251 * normal.y, 0.48860251 * normal.z, 0.48860251 * normal.x);
}

fn kiln_quadratic_harmonics(normal: vec3<f32>) -> KilnQuadratic {
    let mixed = 1.0925484;
    return KilnQuadratic(
        kiln_linear_harmonics(normal),
        vec4<f32>(
            mixed * (normal.x * normal.y),
            mixed * (normal.y * normal.z),
            0.31539157 * (3.0 * (normal.z * normal.z) - 1.0),
            mixed * (normal.x * normal.z),
        ),
        0.5462742 * (normal.x * normal.x - normal.y * normal.y),
    );
}

// AO for a normal from linear coefficients.
fn kiln_ao_linear(coefficients: vec4<f32>, normal: vec3<f32>) -> f32 {
    return kiln_unit(dot(coefficients, kiln_linear_harmonics(normal)));
}

// AO for a normal from quadratic coefficients.
fn kiln_ao_quadratic(coefficients: KilnQuadratic, normal: vec3<f32>) -> f32 {
    let basis = kiln_quadratic_harmonics(normal);
    let linear = dot(coefficients.low, basis.low);
    return kiln_unit(linear + dot(coefficients.high, basis.high) + coefficients.last * basis.last);
}

// Where a vertex of a tree is in its model's box, from -1 to 1; 0 along an axis without extent. (pack/trees.rs)
fn kiln_tree_place(position: vec3<f32>, middle: vec3<f32>, half_extent: vec3<f32>) -> vec3<f32> {
    let is_flat = half_extent <= vec3<f32>(0.0);
    let size = select(half_extent, vec3<f32>(1.0), is_flat);
    let place = clamp((position - middle) / size, vec3<f32>(-1.0), vec3<f32>(1.0));
    return select(place, vec3<f32>(0.0), is_flat);
}

// AO of a vertex of a tree from its local AO and the four numbers of the instance.
fn kiln_tree_ao(local: f32, numbers: vec4<f32>, place: vec3<f32>) -> f32 {
    return kiln_unit(local * (numbers.x + dot(numbers.yzw, place)));
}

// The blend of up to four channels, by weights whose sum is 1; weights of channels that are not there are 0.
fn kiln_blend(channels: vec4<f32>, weights: vec4<f32>) -> f32 {
    return kiln_unit(dot(channels, weights));
}

// Weight of the present after some seconds: 1 - 2^(-dt / half-time). (temporal.rs)
fn kiln_temporal_weight(dt_secs: f32, half_time_secs: f32) -> f32 {
    if !(half_time_secs > 0.0) {
        return 1.0;
    }
    if !(dt_secs > 0.0) {
        return 0.0;
    }
    // Below 2^-126 a float need not be what it should.
    return 1.0 - exp2(-min(dt_secs / half_time_secs, 64.0));
}

// What is shown now: the coefficients of the last frame drawn towards those of this one.
fn kiln_temporal_blend(previous: vec4<f32>, now: vec4<f32>, weight: f32) -> vec4<f32> {
    return previous + (now - previous) * weight;
}

// An artist's curve over AO: a power. (remap.rs)
fn kiln_remap_gamma(ao: f32, gamma: f32) -> f32 {
    return kiln_unit(pow(kiln_unit(ao), gamma));
}

// The curve's value where the segment between two points begins below `value`, else what it was.
fn kiln_segment(before: f32, value: f32, start: vec4<f32>, end: vec4<f32>, is_there: bool) -> f32 {
    let along = start.y + (end.y - start.y) * kiln_unit((value - start.x) / (end.x - start.x));
    return select(before, along, is_there && value >= start.x);
}

// Or piecewise linear through 1 to 16 points, whose inputs (x) rise and whose outputs are y. Without a loop: not all
// languages index an argument by a variable.
fn kiln_remap_curve(ao: f32, points: array<vec4<f32>, 16>, count: u32) -> f32 {
    let value = kiln_unit(ao);
    var result = points[0].y;
    result = kiln_segment(result, value, points[0], points[1], count > 1u);
    result = kiln_segment(result, value, points[1], points[2], count > 2u);
    result = kiln_segment(result, value, points[2], points[3], count > 3u);
    result = kiln_segment(result, value, points[3], points[4], count > 4u);
    result = kiln_segment(result, value, points[4], points[5], count > 5u);
    result = kiln_segment(result, value, points[5], points[6], count > 6u);
    result = kiln_segment(result, value, points[6], points[7], count > 7u);
    result = kiln_segment(result, value, points[7], points[8], count > 8u);
    result = kiln_segment(result, value, points[8], points[9], count > 9u);
    result = kiln_segment(result, value, points[9], points[10], count > 10u);
    result = kiln_segment(result, value, points[10], points[11], count > 11u);
    result = kiln_segment(result, value, points[11], points[12], count > 12u);
    result = kiln_segment(result, value, points[12], points[13], count > 13u);
    result = kiln_segment(result, value, points[13], points[14], count > 14u);
    result = kiln_segment(result, value, points[14], points[15], count > 15u);
    return kiln_unit(result);
}

// The dither of a pixel in a frame, a fraction of 2^32; frame 0 for a pattern that stands still. (quantise.rs)
fn kiln_dither(x: u32, y: u32, frame: u32) -> u32 {
    return x * 0xc13fa9a9u + y * 0x91e10da5u + frame * 0x9e3779b9u;
}

// AO in 31 steps, 0 to 31, rounded up or down by the dither. 0x80000000 gives the nearest.
fn kiln_quantise(ao: f32, dither: u32) -> u32 {
    return (u32(kiln_unit(ao) * 32505856.0 + 0.5) + (dither >> 12u)) >> 20u;
}

// AO of 0 to 31 steps.
fn kiln_dequantise(steps: u32) -> f32 {
    return f32(min(steps, 31u)) / 31.0;
}
