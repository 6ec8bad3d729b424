// The value of a ray in a scene without foliage; foliage.rs has the others.

fn ray_value(kernel: Kernel, origin: vec3<f32>, direction: vec3<f32>, hit: ClosestHit) -> vec4<u32> {
    return unhindered_value(kernel, hit);
}
