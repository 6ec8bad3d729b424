// An eight-wide node with quantised boxes, and a ray's way through it. Keep in sync with node.rs.

// First word of the planes, one word for each axis.
const PLANES_WORD: u32 = 2u;

// Bound on the rounding error of a plane's distance, relative to its terms; node.rs derives it.
const BOX_ROUNDING: f32 = 1e-6f;
// What is entered this little behind a hit may tie with it: distances are rounded to 18 bits.
const HIT_SLACK: f32 = 1.000008f;
// No term of a distance is greater, so that none is infinite.
const MOST_STEP: f32 = 1e35f;
const MOST_START: f32 = 1e37f;

fn bytes(word: u32) -> vec4<f32> {
    return vec4<f32>(unpack4xU8(word));
}

fn mask_of(near: vec4<f32>, far: vec4<f32>) -> u32 {
    let bits = select(vec4(0u), vec4(1u, 2u, 4u, 8u), near <= far);
    return bits.x | bits.y | bits.z | bits.w;
}

// A bit for each slot whose box the ray enters before `t_max` and leaves after `t_min`. `head` is the node's first word.
fn entered(ray: SlabRay, head: vec4<u32>, first_word: u32, t_min: f32, t_max: f32) -> u32 {
    let x = geometry(first_word + PLANES_WORD);
    let y = geometry(first_word + PLANES_WORD + 1u);
    let z = geometry(first_word + PLANES_WORD + 2u);
    let scale = bitcast<vec3<f32>>((vec3(head.w) << vec3(23u, 15u, 7u)) & vec3(0x7f800000u));
    // The distance of a plane is start + byte * step.
    let step = clamp(ray.inverse * scale, vec3(-MOST_STEP), vec3(MOST_STEP));
    let start = clamp((bitcast<vec3<f32>>(head.xyz) - ray.origin) * ray.inverse, vec3(-MOST_START), vec3(MOST_START));
    let slack = BOX_ROUNDING * (255f * abs(step) + abs(start));
    let near = start - slack;
    let far = start + slack;
    let is_down = ray.inverse < vec3(0f);
    let near_x = select(x.xy, x.zw, is_down.x);
    let near_y = select(y.xy, y.zw, is_down.y);
    let near_z = select(z.xy, z.zw, is_down.z);
    let far_x = select(x.zw, x.xy, is_down.x);
    let far_y = select(y.zw, y.xy, is_down.y);
    let far_z = select(z.zw, z.xy, is_down.z);
    let last = vec4(t_max * HIT_SLACK);
    let near_0 = max(
        max(bytes(near_x.x) * step.x + near.x, bytes(near_y.x) * step.y + near.y),
        max(bytes(near_z.x) * step.z + near.z, vec4(t_min)),
    );
    let far_0 = min(
        min(bytes(far_x.x) * step.x + far.x, bytes(far_y.x) * step.y + far.y),
        min(bytes(far_z.x) * step.z + far.z, last),
    );
    let near_1 = max(
        max(bytes(near_x.y) * step.x + near.x, bytes(near_y.y) * step.y + near.y),
        max(bytes(near_z.y) * step.z + near.z, vec4(t_min)),
    );
    let far_1 = min(
        min(bytes(far_x.y) * step.x + far.x, bytes(far_y.y) * step.y + far.y),
        min(bytes(far_z.y) * step.z + far.z, last),
    );
    return mask_of(near_0, far_0) | (mask_of(near_1, far_1) << 4u);
}

// Moves the bit of each slot to (slot ^ octant); its own inverse.
fn in_order(mask: u32, octant: u32) -> u32 {
    let x = select(mask, ((mask & 0x55u) << 1u) | ((mask >> 1u) & 0x55u), (octant & 1u) != 0u);
    let y = select(x, ((x & 0x33u) << 2u) | ((x >> 2u) & 0x33u), (octant & 2u) != 0u);
    return select(y, ((y & 0x0fu) << 4u) | (y >> 4u), (octant & 4u) != 0u);
}
