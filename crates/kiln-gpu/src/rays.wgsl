// What kernels over given rays share, one ray for each lane; rays.rs.

// Keep in sync with `RayParams` in rays.rs.
struct RayParams {
    ray_count: u32,
}

@group(0) @binding(0) var<uniform> params: RayParams;
// Origin and greatest distance, direction and nothing.
@group(0) @binding(1) var<storage, read> rays: array<vec4<f32>>;

fn traced(ray: u32) -> ClosestHit {
    let a = rays[2u * ray];
    let b = rays[2u * ray + 1u];
    return closest_hit(a.xyz, b.xyz, a.w);
}
