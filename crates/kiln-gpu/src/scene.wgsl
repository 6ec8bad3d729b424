// A scene, and a ray on its way into an instance: what every traversal shares. The generated prelude gives ANY_HIT, COUNT_VISITS, the
// scene's bindings and
//     fn geometry(word: u32) -> vec4<u32>

const NO_INSTANCE: u32 = 0xffffffffu;
const LANES: u32 = 64u;

// Records are counted in words of 16 bytes; size asserts in node.rs.
const NODE_WORDS: u32 = 5u;
const LEAST_DIRECTION: f32 = 1e-18f;

// What is known of a scene but its geometry. Keep in sync with `SceneInfo` in traverse.rs.
struct SceneInfo {
    // Nothing stops a ray.
    is_empty: u32,
    // 0, but no compiler knows.
    zero: u32,
    // First word of the tree over foliage, where there is any.
    foliage_words: u32,
    padding: u32,
}

// This lane of the workgroup; entry points set it first.
var<private> lane: u32;
// Nodes, triangles and instances that were visited, where COUNT_VISITS.
var<private> visits: vec3<u32>;

struct SlabRay {
    origin: vec3<f32>,
    inverse: vec3<f32>,
    // A bit for each axis along which it goes down: in the order (slot ^ octant), near children come first.
    octant: u32,
}

fn slab_ray(origin: vec3<f32>, direction: vec3<f32>) -> SlabRay {
    let is_down = direction < vec3(0f);
    let least = select(vec3(LEAST_DIRECTION), vec3(-LEAST_DIRECTION), is_down);
    let safe = select(direction, least, abs(direction) < vec3(LEAST_DIRECTION));
    let bits = select(vec3(0u), vec3(1u, 2u, 4u), is_down);
    return SlabRay(origin, 1f / safe, bits.x | bits.y | bits.z);
}

fn turned(row: vec4<f32>, v: vec3<f32>) -> f32 {
    return row.x * v.x + row.y * v.y + row.z * v.z;
}

// A ray in the space of an instance.
struct ObjectRay {
    slab: SlabRay,
    sheared: ShearedRay,
    // Where the mesh starts (two words), the instance, 0.
    links: vec4<u32>,
}

// `first_word` is that of the instance's record.
fn object_ray(first_word: u32, origin: vec3<f32>, direction: vec3<f32>) -> ObjectRay {
    let x = bitcast<vec4<f32>>(geometry(first_word));
    let y = bitcast<vec4<f32>>(geometry(first_word + 1u));
    let z = bitcast<vec4<f32>>(geometry(first_word + 2u));
    let o = vec3(turned(x, origin) + x.w, turned(y, origin) + y.w, turned(z, origin) + z.w);
    let d = vec3(turned(x, direction), turned(y, direction), turned(z, direction));
    return ObjectRay(slab_ray(o, d), sheared_ray(d), geometry(first_word + 3u));
}
