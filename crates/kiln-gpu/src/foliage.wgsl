// The way of a ray through foliage; foliage.rs says how. What it meets is told to attenuate.wgsl or expected.wgsl, which have
//     var<private> ray_end: f32              how far the ray goes
//     fn walk_from() -> f32                  what it meets up to here does not count
//     fn walk_to() -> f32                    nor what is beyond here
//     fn is_walk_over() -> bool
//     fn meet_face(t: f32, depth: u32)
//     fn meet_fog(near: f32, far: f32, rate: vec2<u32>)

// Set in the last word of a record of fog, beside the upper half of its rate.
const FOG_BIT: u32 = 0x80000000u;
// Boxes that are left this little before `walk_from` may hold what is met behind it: distances are rounded to 18 bits.
const TAKEN_SLACK: f32 = 0.999992f;
// No length counts for more, so that no product is infinite.
const MOST_LENGTH: f32 = 1e20f;
// Units of a depth.
const DEPTH_UNITS: f32 = 65536f;

// The sum of two depths, or the greatest there is.
fn saturated(a: u32, b: u32) -> u32 {
    return a + min(b, ~a);
}

// A rate of fog, lower half first, in binary logarithms for each metre.
fn per_m(rate: vec2<u32>) -> f32 {
    return f32(rate.y) * 256f + f32(rate.x) * (1f / 16777216f);
}

// 2^-x for x >= 0, and 0 where that is below 2^-64.
fn exp2_minus(x: vec4<f32>) -> vec4<f32> {
    return select(small_exp2_minus(min(x, vec4(64f))), vec4(0f), x >= vec4(64f));
}

// 1 - 2^-x for x >= 0, also where x is small.
fn one_minus_exp2_minus(x: vec4<f32>) -> vec4<f32> {
    let y = min(x, vec4(0.25f)) * 0.693147180559945f;
    let series = y * (1f - y * (0.5f - y * (1f / 6f - y * (1f / 24f - y * (1f / 120f)))));
    return select(series, 1f - exp2_minus(x), x >= vec4(0.25f));
}

fn fixed(value: vec4<f32>) -> vec4<u32> {
    return vec4<u32>(clamp(value * 65536f + 0.5f, vec4(0f), vec4(65536f)));
}

// The part of a ray that lies in a box of fog.
fn cross_fog(ray: SlabRay, low: vec3<f32>, high: vec3<f32>, rate: vec2<u32>) {
    let is_down = ray.inverse < vec3(0f);
    let enters = (select(low, high, is_down) - ray.origin) * ray.inverse;
    let leaves = (select(high, low, is_down) - ray.origin) * ray.inverse;
    let near = max(max(enters.x, enters.y), max(enters.z, 0f));
    let far = min(min(leaves.x, leaves.y), min(leaves.z, ray_end));
    if near < far {
        meet_fog(near, far, rate);
    }
}

// Tests the triangles of the given leaves of a node, as `visit_leaves` in traverse.wgsl.
fn cross_leaves(slab: SlabRay, sheared: ShearedRay, leaves: vec4<u32>, hit_leaves: u32, triangle_words: u32) {
    var waiting = hit_leaves;
    var at = 0u;
    var left = 0u;
    loop {
        if left == 0u {
            if waiting == 0u {
                break;
            }
            let slot = firstTrailingBit(waiting);
            waiting &= waiting - 1u;
            let run = select(leaves.z, leaves.w, slot >= 4u) >> (8u * (slot & 3u));
            left = (run >> 5u) & 7u;
            at = triangle_words + TRIANGLE_WORDS * (leaves.y + (run & 31u));
            if left == 0u {
                continue;
            }
        }
        let second = geometry(at + 1u);
        let meeting = meet(slab, sheared, geometry(at), second, geometry(at + 2u));
        if meeting.t > 0f && meeting.t <= ray_end {
            meet_face(meeting.t, second.w);
        }
        at += TRIANGLE_WORDS;
        left--;
    }
}

// Takes a ray through both levels, as `closest_hit` in traverse.wgsl; nothing that is met ends it.
fn walk_foliage(origin: vec3<f32>, direction: vec3<f32>) {
    // The level that is walked: a tree of the level, or all foliage.
    var is_in_tree = false;
    var base = 0u;
    var node_words = scene.foliage_words;
    var triangle_words = 0u;
    var slab = slab_ray(origin, direction);
    var sheared: ShearedRay;
    var depth = 0u;
    var group = ROOT;
    loop {
        if (group.y & 0xffu) == 0u {
            if depth == base && is_in_tree {
                is_in_tree = false;
                base = 0u;
                node_words = scene.foliage_words;
                slab = slab_ray(origin, direction);
            }
            if depth == 0u || is_walk_over() {
                break;
            }
            depth--;
            group = popped(depth);
        }
        let slot = firstTrailingBit(group.y) ^ slab.octant;
        group.y &= group.y - 1u;
        let record = group.x + countOneBits((group.y >> 8u) & ((1u << slot) - 1u));
        let is_node = ((group.y >> (16u + slot)) & 1u) != 0u;
        if (group.y & 0xffu) != 0u {
            push(depth, group);
            depth++;
        }
        let first_word = node_words + NODE_WORDS * record;
        if is_node {
            let head = geometry(first_word);
            let links = geometry(first_word + 1u);
            let hits = entered(slab, head, first_word, walk_from() * TAKEN_SLACK, walk_to());
            let nodes = head.w >> 24u;
            let children = select(links.y, nodes, is_in_tree);
            group = vec2(links.x, in_order(hits & children, slab.octant) | (children << 8u) | (nodes << 16u));
            let leaves = select(0u, hits & ~nodes, is_in_tree);
            if leaves != 0u {
                cross_leaves(slab, sheared, links, leaves, triangle_words);
            }
            continue;
        }
        let object = object_ray(first_word, origin, direction);
        let last = geometry(first_word + 4u);
        if (last.w & FOG_BIT) != 0u {
            let rate = vec2(object.links.w, last.w & ~FOG_BIT);
            cross_fog(object.slab, bitcast<vec3<f32>>(object.links.xyz), bitcast<vec3<f32>>(last.xyz), rate);
            group = vec2(0u);
        } else {
            slab = object.slab;
            sheared = object.sheared;
            node_words = object.links.x;
            triangle_words = object.links.y;
            is_in_tree = true;
            base = depth;
            group = ROOT;
        }
    }
}
