// Closest hits of given rays, one for each invocation; trace.rs.

const LANES: u32 = 64u;

// Keep in sync with `TraceParams` in trace.rs.
struct TraceParams {
    ray_count: u32,
}

@group(0) @binding(0) var<uniform> params: TraceParams;
// Origin and greatest distance, direction and nothing.
@group(0) @binding(1) var<storage, read> rays: array<vec4<f32>>;
// Distance's bits, instance with BACK_BIT or MISS_RANK, face, 0.
@group(0) @binding(2) var<storage, read_write> hits: array<vec4<u32>>;

@compute @workgroup_size(LANES)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.ray_count {
        return;
    }
    let a = rays[2u * id.x];
    let b = rays[2u * id.x + 1u];
    let hit = closest_hit(a.xyz, b.xyz, a.w);
    hits[id.x] = vec4(bitcast<u32>(hit.t), hit.rank, hit.primitive, 0u);
}
