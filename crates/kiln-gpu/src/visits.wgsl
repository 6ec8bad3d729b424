// What the closest hits of given rays cost; visits.rs.

// Nodes, triangles, instances, 0.
@group(0) @binding(2) var<storage, read_write> counts: array<vec4<u32>>;

@compute @workgroup_size(LANES)
fn count_visits(@builtin(local_invocation_index) local: u32, @builtin(global_invocation_id) id: vec3<u32>) {
    lane = local;
    if id.x < params.ray_count {
        visits = vec3(0u);
        let hit = traced(id.x);
        counts[id.x] = vec4(visits, select(1u, 0u, hit.rank == MISS_RANK));
    }
}
