// Gathers the rays of samples; gather.rs says how.

const CONE_LANES: u32 = 32u;
const CONES_PER_WORKGROUP: u32 = 2u;
const LANES: u32 = 64u;
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
// Rays in the low half, back faces in the high half.
var<workgroup> lane_counts: array<u32, LANES>;

@compute @workgroup_size(LANES)
fn gather(@builtin(local_invocation_index) local: u32, @builtin(workgroup_id) workgroup: vec3<u32>) {
    let lane = local % CONE_LANES;
    let cone = local / CONE_LANES;
    let rays_per_cell = 1u << params.cones.ray_bits;
    let samples_per_cone = CONE_LANES >> params.cones.ray_bits;
    let sample = workgroup.x * samples_per_cone + (lane >> params.cones.ray_bits);
    let ray = lane & (rays_per_cell - 1u);

    var values = vec4(0u);
    var counts = 0u;
    if sample < params.sample_count {
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
        for (var cell = first + cone; cell < end; cell += CONES_PER_WORKGROUP) {
            let index = index_in_cell(params.cones, a.w, cell, ray, scramble);
            let direction = cosine_direction(sobol_point(index, scramble), normal, basis);
            if direction.x * geometric.x + direction.y * geometric.y + direction.z * geometric.z <= 0f {
                continue;
            }
            let hit = closest_hit(origin, direction, params.t_max);
            if hit.rank == MISS_RANK {
                values += params.kernel.open;
            } else {
                values += hit_value(params.kernel, hit.t);
            }
            counts += select(0x00001u, 0x10001u, hit.rank > MISS_RANK);
        }
    }
    lane_values[local] = values;
    lane_counts[local] = counts;
    workgroupBarrier();

    // The first lane of each sample adds up the others: its rays of this cone and of the next.
    if ray != 0u || cone != 0u || sample >= params.sample_count {
        return;
    }
    for (var other = 1u; other < CONES_PER_WORKGROUP * rays_per_cell; other++) {
        let from_lane = local + (other & (rays_per_cell - 1u)) + CONE_LANES * (other >> params.cones.ray_bits);
        values += lane_values[from_lane];
        counts += lane_counts[from_lane];
    }
    let at = SUMS_WORDS * (workgroup.y * params.sample_count + sample);
    sums[at] = values.x;
    sums[at + 1u] = values.y;
    sums[at + 2u] = values.z;
    sums[at + 3u] = values.w;
    sums[at + 4u] = counts & 0xffffu;
    sums[at + 5u] = counts >> 16u;
}
