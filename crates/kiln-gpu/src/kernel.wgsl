// The value of a ray that hits. Keep in sync with kiln-trace's kernel.rs.

// Fixed-point value of an open ray.
const ONE: u32 = 65536u;

// A kernel. Keep in sync with `Kernel` in kernel.rs.
struct Kernel {
    // 1/d of each channel, per metre.
    rates: vec4<f32>,
    // Value of a ray without a hit: ONE for channels that are used, else 0.
    open: vec4<u32>,
    // All bits for channels of obscurance, none for occlusion, where a hit counts as 0.
    hit_mask: vec4<u32>,
}

// 2^-x for 0 <= x <= 126.
fn small_exp2_minus(x: vec4<f32>) -> vec4<f32> {
    let whole = floor(x + vec4(0.5f));
    let y = (whole - x) * 0.693147180559945f;
    let p = 1f + y * (1f + y * (0.5f + y * (1f / 6f + y * (1f / 24f + y * (1f / 120f + y * (1f / 720f))))));
    let scale = bitcast<vec4<f32>>((vec4(127u) - vec4<u32>(whole)) << vec4(23u));
    return p * scale;
}

// round(65536 (1 - 2^-x)) for x >= 0; from x = 24 on it is ONE.
fn fixed_obscurance(distance: vec4<f32>) -> vec4<u32> {
    return vec4<u32>((1f - small_exp2_minus(min(distance, vec4(24f)))) * 65536f + 0.5f);
}

fn hit_value(kernel: Kernel, t: f32) -> vec4<u32> {
    return fixed_obscurance(t * kernel.rates) & kernel.hit_mask;
}
