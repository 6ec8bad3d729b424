// What the gather kernel computes before and after tracing, by itself, for tests, and whether loops come to their ends; probe.rs.

const LANES: u32 = 64u;

// Keep in sync with `ProbeParams` in probe.rs.
struct ProbeParams {
    kernel: Kernel,
    cones: Cones,
    // Samples, distances, or rounds.
    count: u32,
}

@group(0) @binding(0) var<uniform> params: ProbeParams;
// Samples as for `gather`, or distances four to a word.
@group(0) @binding(1) var<storage, read> values: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> results: array<vec4<u32>>;

// The direction and the index of each ray of each sample, cell by cell.
@compute @workgroup_size(LANES)
fn directions(@builtin(global_invocation_id) id: vec3<u32>) {
    let log2_rays = params.cones.column_bits + params.cones.row_bits + params.cones.ray_bits;
    let sample = id.x >> log2_rays;
    if sample >= params.count {
        return;
    }
    let cell = (id.x & ((1u << log2_rays) - 1u)) >> params.cones.ray_bits;
    let ray = id.x & ((1u << params.cones.ray_bits) - 1u);
    let b = values[3u * sample + 1u];
    let scramble = vec2(b.w, values[3u * sample + 2u].w);
    let normal = bitcast<vec3<f32>>(b.xyz);
    let index = index_in_cell(params.cones, values[3u * sample].w, cell, ray, scramble);
    let direction = cosine_direction(sobol_point(index, scramble), normal, orthonormal_basis(normal));
    results[id.x] = vec4(bitcast<vec3<u32>>(direction), index);
}

// The value of a hit at each distance.
@compute @workgroup_size(LANES)
fn hit_values(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < params.count {
        results[id.x] = hit_value(params.kernel, bitcast<f32>(values[id.x / 4u][id.x % 4u]));
    }
}

// So many rounds of loops within each other, of numbers that the compiler does not know: how many there were, and what came of them.
@compute @workgroup_size(LANES)
fn rounds(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x > 0u {
        return;
    }
    var done = 0u;
    var state = values[0].x;
    for (var outer = 0u; outer < params.count; outer++) {
        for (var inner = 0u; inner < values[0].y; inner++) {
            state = state * 1664525u + 1013904223u;
            state ^= state >> 15u;
            done++;
        }
    }
    results[0] = vec4(done, state, 0u, 0u);
}
