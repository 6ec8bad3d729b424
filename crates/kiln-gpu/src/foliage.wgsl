// The way of a ray through foliage; foliage.rs says how. What it meets is told to attenuate.wgsl or expected.wgsl, which have
//     var<private> ray_end: f32              how far the ray goes
//     fn walk_from() -> f32                  what it meets up to here does not count
//     fn walk_to() -> f32                    nor what is beyond here
//     fn is_walk_over() -> bool
//     fn meet_face(t: f32, depth: u32)
//     fn meet_fog(near: f32, far: f32, rate: vec2<u32>)

// Set in the last word of a record of fog, beside the upper half of its rate, and in that of a group, beside the number of its shrubs.
const FOG_BIT: u32 = 0x80000000u;
const GROUP_BIT: u32 = 0x40000000u;
// Records of shrubs: steps of their lattice, metres; steps of a quaternion's components; floats of 12 bits, see kiln-trace's
// foliage/shrub.rs: keep in sync.
const STEP_M: f32 = 1f / 256f;
const PER_CODE: f32 = 0.70710678118654752f / 511f;
const LEAST_HALF: u32 = 0x3c800000u;
const LEAST_RATE: u32 = 0x3a800000u;
// Slack of squares of radii and of the way to a center, as in kiln-trace's foliage/groups.rs.
const RADIUS_SLACK: f32 = 1.0078125f;
const WAY_SLACK: f32 = 1f / 17179869184f;
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

// Floats of 12 bits.
fn large_float(codes: vec3<u32>, least: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>((codes << vec3(15u)) + vec3(least));
}

// The conjugate of a packed quaternion: x, y, z, w.
fn turn_back(word: u32) -> vec4<f32> {
    let others = vec3<f32>(vec3<i32>((vec3(word) >> vec3(0u, 10u, 20u)) & vec3(0x3ffu)) - vec3(511)) * PER_CODE;
    let rest = sqrt(max(1f - dot(others, others), 0f));
    var turn = vec4(others, rest);
    switch word >> 30u {
        case 0u: { turn = vec4(rest, others); }
        case 1u: { turn = vec4(others.x, rest, others.yz); }
        case 2u: { turn = vec4(others.xy, rest, others.z); }
        default: {}
    }
    return vec4(-turn.xyz, turn.w);
}

// A vector turned by a unit quaternion.
fn turned_by(turn: vec4<f32>, v: vec3<f32>) -> vec3<f32> {
    let twice = 2f * cross(turn.xyz, v);
    return v + turn.w * twice + cross(turn.xyz, twice);
}

// Takes a ray through the shrubs of a group; each that its sphere says nothing against is unpacked.
fn cross_group(origin: vec3<f32>, direction: vec3<f32>, base: vec3<i32>, first_word: u32, count: u32) {
    for (var at = first_word; at < first_word + count; at++) {
        let words = geometry(at);
        let steps = vec3(words.x & 0xffffu, words.x >> 16u, words.y & 0xffffu);
        let half = large_float(vec3(words.y >> 16u, words.z, words.z >> 12u) & vec3(0xfffu), LEAST_HALF);
        let center = vec3<f32>(base + vec3<i32>(steps)) * STEP_M - origin;
        let t = clamp(dot(center, direction), 0f, ray_end);
        let away = center - t * direction;
        if dot(away, away) <= dot(half, half) * RADIUS_SLACK + t * t * WAY_SLACK {
            let turn = turn_back(words.w);
            let per_m = large_float(vec3((words.y >> 28u) | ((words.z >> 24u) << 4u)), LEAST_RATE).x;
            let ray = slab_ray(turned_by(turn, -center), turned_by(turn, direction));
            cross_fog(ray, -half, half, vec2(u32(per_m * 16777216f), 0u));
        }
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
        let last = geometry(first_word + 4u);
        if (last.w & (FOG_BIT | GROUP_BIT)) == GROUP_BIT {
            let links = geometry(first_word + 3u);
            cross_group(origin, direction, bitcast<vec3<i32>>(links.xyz), links.w, last.w & 0xffu);
            group = vec2(0u);
            continue;
        }
        let object = object_ray(first_word, origin, direction);
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
