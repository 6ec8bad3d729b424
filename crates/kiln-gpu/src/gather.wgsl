// Gathers the rays of samples; gather.rs says how. The entry point is in reduce.wgsl or reduce_subgroup.wgsl.

const CONE_LANES: u32 = 32u;
const CONES_PER_WORKGROUP: u32 = 2u;
const SUMS_WORDS: u32 = 6u;

// Keep in sync with `GatherParams` in gather.rs.
struct GatherParams {
    kernel: Kernel,
    cones: Cones,
    t_max: f32,
    sample_count: u32,
    // Cells of one workgroup, and the first slice of cells of this dispatch.
    cells_per_slice: u32,
    first_slice: u32,
}

@group(0) @binding(0) var<uniform> params: GatherParams;
// Origin and first index, normal and scramble 0, geometric normal and scramble 1.
@group(0) @binding(1) var<storage, read> samples: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

var<workgroup> lane_values: array<vec4<u32>, LANES>;
var<workgroup> lane_counts: array<u32, LANES>;

struct LaneSums {
    values: vec4<u32>,
    // Rays in the low half, back faces in the high half.
    counts: u32,
}

// The sample of a lane's place in its workgroup.
fn sample_at(place: u32, workgroup: u32) -> u32 {
    let in_cone = (place % CONE_LANES) >> params.cones.ray_bits;
    return workgroup * (CONE_LANES >> params.cones.ray_bits) + in_cone;
}

// The rays of one lane.
fn gathered(place: u32, workgroup: vec2<u32>) -> LaneSums {
    var values = vec4(0u);
    var counts = 0u;
    let sample = sample_at(place, workgroup.x);
    if sample >= params.sample_count {
        return LaneSums(values, counts);
    }
    let ray = place & ((1u << params.cones.ray_bits) - 1u);
    let a = samples[3u * sample];
    let b = samples[3u * sample + 1u];
    let c = samples[3u * sample + 2u];
    let origin = bitcast<vec3<f32>>(a.xyz);
    let normal = bitcast<vec3<f32>>(b.xyz);
    let geometric = bitcast<vec3<f32>>(c.xyz);
    let scramble = vec2(b.w, c.w);
    let basis = orthonormal_basis(normal);
    let cell_count = 1u << (params.cones.column_bits + params.cones.row_bits);
    let first = (params.first_slice + workgroup.y) * params.cells_per_slice;
    let end = min(first + params.cells_per_slice, cell_count);
    for (var cell = first + place / CONE_LANES; cell < end; cell += CONES_PER_WORKGROUP) {
        let index = index_in_cell(params.cones, a.w, cell, ray, scramble);
        let direction = cosine_direction(sobol_point(index, scramble), normal, basis);
        if direction.x * geometric.x + direction.y * geometric.y + direction.z * geometric.z <= 0f {
            continue;
        }
        let hit = closest_hit(origin, direction, params.t_max);
        values += ray_value(params.kernel, origin, direction, hit);
        counts += select(0x00001u, 0x10001u, hit.rank > MISS_RANK);
    }
    return LaneSums(values, counts);
}

// Adds up the sums in the workgroup's memory of every `stride`th lane of a sample, of both cones, and gives them out.
// The place is that of the sample's first lane.
fn give_out(place: u32, workgroup: vec2<u32>, stride: u32) {
    let rays_per_cell = 1u << params.cones.ray_bits;
    var values = vec4(0u);
    var counts = 0u;
    for (var other = 0u; other < CONES_PER_WORKGROUP * rays_per_cell; other += stride) {
        let at = place + (other & (rays_per_cell - 1u)) + CONE_LANES * (other >> params.cones.ray_bits);
        values += lane_values[at];
        counts += lane_counts[at];
    }
    let at = SUMS_WORDS * (workgroup.y * params.sample_count + sample_at(place, workgroup.x));
    sums[at] = values.x;
    sums[at + 1u] = values.y;
    sums[at + 2u] = values.z;
    sums[at + 3u] = values.w;
    sums[at + 4u] = counts & 0xffffu;
    sums[at + 5u] = counts >> 16u;
}

// Whether a place is the first of a sample.
fn is_first(place: u32, workgroup: u32) -> bool {
    let is_first_ray = (place & ((1u << params.cones.ray_bits) - 1u)) == 0u;
    return is_first_ray && place < CONE_LANES && sample_at(place, workgroup) < params.sample_count;
}
