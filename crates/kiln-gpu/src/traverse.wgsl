// Two-level traversal and the watertight triangle test.
// Keep in sync with kiln-trace's traverse.rs, triangle.rs and cpu.rs; traverse.rs here says where this differs.
// The generated prelude gives STACK_ENTRIES, the scene's bindings and
//     fn geometry(word: u32) -> vec4<u32>

const LEAF_BIT: u32 = 0x80000000u;
const NO_CHILD: u32 = 0xffffffffu;
const NO_PRIMITIVE: u32 = 0xffffffffu;
const NO_INSTANCE: u32 = 0xffffffffu;
const TWO_SIDED_BIT: u32 = 0x80000000u;
// Set in the rank of a back-face hit, so that front faces come first.
const BACK_BIT: u32 = 0x80000000u;
// The rank of no hit: after every front face, before every back face.
const MISS_RANK: u32 = 0x7fffffffu;

// Records are counted in words of 16 bytes; size asserts in traverse.rs.
const NODE_WORDS: u32 = 7u;
const BLOCK_WORDS: u32 = 10u;
const INSTANCE_WORDS: u32 = 4u;

const WIDEN: f32 = 1.0000006f;
const LEAST_DIRECTION: f32 = 1e-18f;

// What is known of a scene but its geometry. Keep in sync with `SceneInfo` in traverse.rs.
struct SceneInfo {
    // First word of the instance table.
    instance_words: u32,
    // Nothing stops a ray.
    is_empty: u32,
    // 0, but no compiler knows.
    zero: u32,
    padding: u32,
}

struct ClosestHit {
    t: f32,
    // Instance, with BACK_BIT.
    rank: u32,
    primitive: u32,
}

struct SlabRay {
    origin: vec3<f32>,
    inverse: vec3<f32>,
    // Word of a node's near and far plane of each axis.
    near: vec3<u32>,
    far: vec3<u32>,
}

struct ShearedRay {
    axes: vec3<u32>,
    shear: vec3<f32>,
    origin: vec3<f32>,
}

struct Corner {
    x: vec4<f32>,
    y: vec4<f32>,
    z: vec4<f32>,
}

// Child reference and the bits of its distance. Private, not local: a local would be cleared for every ray.
var<private> stack: array<vec2<u32>, STACK_ENTRIES>;

fn plane(word: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(geometry(word));
}

// Keeps a product from being fused with a later sum: it must be rounded before the bits can be had.
fn rounded(product: vec4<f32>) -> vec4<f32> {
    return bitcast<vec4<f32>>(bitcast<vec4<u32>>(product) ^ vec4(scene.zero));
}

fn slab_ray(origin: vec3<f32>, direction: vec3<f32>) -> SlabRay {
    let least = select(vec3(LEAST_DIRECTION), vec3(-LEAST_DIRECTION), direction < vec3(0f));
    let safe = select(direction, least, abs(direction) < vec3(LEAST_DIRECTION));
    let axes = vec3(0u, 1u, 2u);
    let near = select(axes, axes + 3u, safe < vec3(0f));
    return SlabRay(origin, 1f / safe, near, 3u + 2u * axes - near);
}

// Sort keys of the children that are entered before `t_max`: the distance's bits (it is not negative), the lowest two
// replaced by the slot. NO_CHILD for the others.
fn enter(ray: SlabRay, first_word: u32, children: vec4<u32>, t_max: f32) -> vec4<u32> {
    let near_x = (plane(first_word + ray.near.x) - ray.origin.x) * ray.inverse.x;
    let near_y = (plane(first_word + ray.near.y) - ray.origin.y) * ray.inverse.y;
    let near_z = (plane(first_word + ray.near.z) - ray.origin.z) * ray.inverse.z;
    let far_x = (plane(first_word + ray.far.x) - ray.origin.x) * ray.inverse.x;
    let far_y = (plane(first_word + ray.far.y) - ray.origin.y) * ray.inverse.y;
    let far_z = (plane(first_word + ray.far.z) - ray.origin.z) * ray.inverse.z;
    let near = max(max(near_x, near_y), max(near_z, vec4(0f)));
    let far = min(min(far_x, far_y), min(far_z, vec4(t_max)));
    let is_entered = (near <= far * WIDEN) & (children != vec4(NO_CHILD));
    let key = (bitcast<vec4<u32>>(near) & vec4(0x7ffffffcu)) | vec4(0u, 1u, 2u, 3u);
    return select(vec4(NO_CHILD), key, is_entered);
}

// Sorts four keys upwards with a network of five exchanges.
fn sorted(keys: vec4<u32>) -> vec4<u32> {
    let a = vec4(min(keys.xz, keys.yw), max(keys.xz, keys.yw));
    let b = vec4(min(a.xz, a.yw), max(a.xz, a.yw));
    return vec4(b.x, min(b.y, b.z), max(b.y, b.z), b.w);
}

fn component(v: vec3<f32>, axis: u32) -> f32 {
    return select(select(v.x, v.y, axis == 1u), v.z, axis == 2u);
}

fn sheared_ray(origin: vec3<f32>, direction: vec3<f32>) -> ShearedRay {
    let size = abs(direction);
    let z = select(select(2u, 1u, size.y > size.z), 0u, size.x > size.y && size.x > size.z);
    let next = select(z + 1u, 0u, z == 2u);
    let last = select(z - 1u, 2u, z == 0u);
    let along = component(direction, z);
    // A negative z mirrors; turning the axes back keeps the winding.
    let x = select(next, last, along < 0f);
    let y = select(last, next, along < 0f);
    let shear = vec3(component(direction, x) / along, component(direction, y) / along, 1f / along);
    return ShearedRay(
        vec3(x, y, z), shear, vec3(component(origin, x), component(origin, y), component(origin, z))
    );
}

fn corner(ray: ShearedRay, first_word: u32) -> Corner {
    let x = plane(first_word + ray.axes.x) - ray.origin.x;
    let y = plane(first_word + ray.axes.y) - ray.origin.y;
    let z = plane(first_word + ray.axes.z) - ray.origin.z;
    return Corner(x - rounded(z * ray.shear.x), y - rounded(z * ray.shear.y), z * ray.shear.z);
}

// The tie rule: at equal distances front faces come first, then the lowest instance, then the lowest face.
fn closer(hit: ClosestHit, is_hit: bool, t: f32, is_front: bool, primitive: u32, instance: u32) -> ClosestHit {
    let is_back = !is_front && (primitive & TWO_SIDED_BIT) == 0u;
    let rank = instance | select(0u, BACK_BIT, is_back);
    let face = primitive & ~TWO_SIDED_BIT;
    let precedes = rank < hit.rank || (rank == hit.rank && face < hit.primitive);
    if is_hit && (t < hit.t || (t == hit.t && precedes)) {
        return ClosestHit(t, rank, face);
    }
    return hit;
}

fn intersect(ray: ShearedRay, first_word: u32, instance: u32, closest: ClosestHit) -> ClosestHit {
    let a = corner(ray, first_word);
    let b = corner(ray, first_word + 3u);
    let c = corner(ray, first_word + 6u);
    let u = rounded(c.x * b.y) - rounded(c.y * b.x);
    let v = rounded(a.x * c.y) - rounded(a.y * c.x);
    let w = rounded(b.x * a.y) - rounded(b.y * a.x);
    let determinant = u + v + w;
    let is_inside = (min(min(u, v), w) >= vec4(0f)) | (max(max(u, v), w) <= vec4(0f));
    let t = (u * a.z + v * b.z + w * c.z) / determinant;
    let is_hit = is_inside & (determinant != vec4(0f)) & (t > vec4(0f)) & (t <= vec4(closest.t));
    if !any(is_hit) {
        return closest;
    }
    let primitives = geometry(first_word + 9u);
    let is_front = determinant > vec4(0f);
    var hit = closer(closest, is_hit.x, t.x, is_front.x, primitives.x, instance);
    hit = closer(hit, is_hit.y, t.y, is_front.y, primitives.y, instance);
    hit = closer(hit, is_hit.z, t.z, is_front.z, primitives.z, instance);
    return closer(hit, is_hit.w, t.w, is_front.w, primitives.w, instance);
}

fn closest_hit(origin: vec3<f32>, direction: vec3<f32>, t_max: f32) -> ClosestHit {
    var hit = ClosestHit(t_max, MISS_RANK, NO_PRIMITIVE);
    if scene.is_empty != 0u {
        return hit;
    }
    // The level that is walked: an instance, or all of them. Entries of the stack below `base` are of the upper one.
    var instance = NO_INSTANCE;
    var base = 0u;
    var node_words = 0u;
    var block_words = 0u;
    var slab = slab_ray(origin, direction);
    var sheared: ShearedRay;
    var depth = 0u;
    var node = 0u;
    loop {
        let first_word = node_words + NODE_WORDS * node;
        let children = geometry(first_word + 6u);
        let keys = sorted(enter(slab, first_word, children, hit.t));
        // The nearest child is next; the others wait, the farthest lowest.
        if keys.w != NO_CHILD {
            stack[depth] = vec2(children[keys.w & 3u], keys.w & ~3u);
            depth++;
        }
        if keys.z != NO_CHILD {
            stack[depth] = vec2(children[keys.z & 3u], keys.z & ~3u);
            depth++;
        }
        if keys.y != NO_CHILD {
            stack[depth] = vec2(children[keys.y & 3u], keys.y & ~3u);
            depth++;
        }
        var next = NO_CHILD;
        if keys.x != NO_CHILD {
            next = children[keys.x & 3u];
        }
        loop {
            if next == NO_CHILD {
                if depth == base {
                    if instance == NO_INSTANCE {
                        return hit;
                    }
                    instance = NO_INSTANCE;
                    base = 0u;
                    node_words = 0u;
                    slab = slab_ray(origin, direction);
                    continue;
                }
                depth--;
                let entry = stack[depth];
                if bitcast<f32>(entry.y) > hit.t * WIDEN {
                    continue;
                }
                next = entry.x;
            }
            if (next & LEAF_BIT) == 0u {
                node = next;
                break;
            }
            let leaf = next & ~LEAF_BIT;
            if instance == NO_INSTANCE {
                let at = scene.instance_words + INSTANCE_WORDS * leaf;
                let r0 = plane(at);
                let r1 = plane(at + 1u);
                let r2 = plane(at + 2u);
                let first = geometry(at + 3u);
                let o = vec3(
                    r0.x * origin.x + r0.y * origin.y + r0.z * origin.z + r0.w,
                    r1.x * origin.x + r1.y * origin.y + r1.z * origin.z + r1.w,
                    r2.x * origin.x + r2.y * origin.y + r2.z * origin.z + r2.w,
                );
                let d = vec3(
                    r0.x * direction.x + r0.y * direction.y + r0.z * direction.z,
                    r1.x * direction.x + r1.y * direction.y + r1.z * direction.z,
                    r2.x * direction.x + r2.y * direction.y + r2.z * direction.z,
                );
                slab = slab_ray(o, d);
                sheared = sheared_ray(o, d);
                instance = leaf;
                base = depth;
                node_words = first.x;
                block_words = first.y;
                node = 0u;
                break;
            }
            hit = intersect(sheared, block_words + BLOCK_WORDS * leaf, instance, hit);
            next = NO_CHILD;
        }
    }
    return hit;
}
