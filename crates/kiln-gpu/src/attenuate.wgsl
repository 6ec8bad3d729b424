// What a ray loses where its value is multiplied by what is kept on the whole way: one sum, in any order. foliage.rs.

// Above this, half a unit of a ray's value is more than what is kept.
const ALL_LOST: u32 = 1114112u;
const MOST_DEPTH: f32 = 4e9f;

var<private> ray_end: f32;
// The depth of all that was met.
var<private> lost: u32;

fn walk_from() -> f32 {
    return 0f;
}

fn walk_to() -> f32 {
    return ray_end;
}

fn is_walk_over() -> bool {
    return lost > ALL_LOST;
}

fn meet_face(t: f32, depth: u32) {
    lost = saturated(lost, depth);
}

fn meet_fog(near: f32, far: f32, rate: vec2<u32>) {
    let depth = min(far - near, MOST_LENGTH) * per_m(rate) * DEPTH_UNITS + 0.5f;
    lost = saturated(lost, u32(min(depth, MOST_DEPTH)));
}

fn ray_value(kernel: Kernel, origin: vec3<f32>, direction: vec3<f32>, hit: ClosestHit) -> vec4<u32> {
    ray_end = hit.t;
    lost = 0u;
    walk_foliage(origin, direction);
    let value = unhindered_value(kernel, hit);
    if lost == 0u {
        return value;
    }
    return fixed(vec4<f32>(value) * (1f / 65536f) * exp2_minus(vec4(f32(lost) / DEPTH_UNITS)));
}
