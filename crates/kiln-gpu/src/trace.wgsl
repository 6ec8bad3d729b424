// Closest hits of given rays; trace.rs.

// Distance's bits, instance with BACK_BIT or MISS_RANK, face, 0.
@group(0) @binding(2) var<storage, read_write> hits: array<vec4<u32>>;

@compute @workgroup_size(LANES)
fn trace(@builtin(local_invocation_index) local: u32, @builtin(global_invocation_id) id: vec3<u32>) {
    lane = local;
    if id.x < params.ray_count {
        let hit = traced(id.x);
        hits[id.x] = vec4(bitcast<u32>(hit.t), hit.rank, hit.primitive, 0u);
    }
}
