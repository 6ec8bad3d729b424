// What given rays are worth, one ray for each lane; values.rs.

// Keep in sync with `RayParams` in rays.rs.
struct RayParams {
    ray_count: u32,
    // Words by themselves: a vector would be moved.
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
    kernel: Kernel,
}

@group(0) @binding(0) var<uniform> params: RayParams;
// Origin and greatest distance, direction and nothing.
@group(0) @binding(1) var<storage, read> rays: array<vec4<f32>>;
// Value in each channel; the first with BACK_BIT where the closest hit is a back face.
@group(0) @binding(2) var<storage, read_write> values: array<vec4<u32>>;

@compute @workgroup_size(LANES)
fn ray_values(@builtin(local_invocation_index) local: u32, @builtin(global_invocation_id) id: vec3<u32>) {
    lane = local;
    if id.x < params.ray_count {
        let a = rays[2u * id.x];
        let b = rays[2u * id.x + 1u];
        let hit = closest_hit(a.xyz, b.xyz, a.w);
        let value = ray_value(params.kernel, a.xyz, b.xyz, hit);
        let back = select(0u, BACK_BIT, hit.rank > MISS_RANK);
        values[id.x] = vec4(value.x | back, value.yzw);
    }
}
