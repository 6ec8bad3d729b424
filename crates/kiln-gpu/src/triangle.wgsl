// The watertight triangle test and the tie rule. Keep in sync with triangle.rs here, and with kiln-trace's triangle.rs
// and cpu.rs, whose arithmetic this is.

const NO_PRIMITIVE: u32 = 0xffffffffu;
const TWO_SIDED_BIT: u32 = 0x80000000u;
// The corners are in the order of the other winding.
const FLIPPED_BIT: u32 = 0x40000000u;
// Set in the rank of a back-face hit, so that front faces come first.
const BACK_BIT: u32 = 0x80000000u;
// The rank of no hit: after every front face, before every back face.
const MISS_RANK: u32 = 0x7fffffffu;

const TRIANGLE_WORDS: u32 = 3u;

struct ClosestHit {
    t: f32,
    // Instance, with BACK_BIT.
    rank: u32,
    primitive: u32,
}

struct ShearedRay {
    axes: vec3<u32>,
    shear: vec3<f32>,
    origin: vec3<f32>,
}

// Keeps a product from being fused with a later sum: it must be rounded before the bits can be had.
fn rounded(product: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(product) ^ vec3(scene.zero));
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

// A corner relative to the ray: x and y across it, z along it in units of the direction.
fn relative(ray: ShearedRay, corner: vec3<u32>) -> vec3<f32> {
    let at = bitcast<vec3<f32>>(corner);
    let turned = vec3(component(at, ray.axes.x), component(at, ray.axes.y), component(at, ray.axes.z)) - ray.origin;
    let along = turned.z * ray.shear;
    let across = turned.xy - rounded(along).xy;
    return vec3(across, along.z);
}

// The tie rule: at equal distances front faces come first, then the lowest instance, then the lowest face.
fn closer(hit: ClosestHit, t: f32, is_counter_clockwise: bool, primitive: u32, instance: u32) -> ClosestHit {
    let is_front = is_counter_clockwise == ((primitive & FLIPPED_BIT) == 0u);
    let is_back = !is_front && (primitive & TWO_SIDED_BIT) == 0u;
    let rank = instance | select(0u, BACK_BIT, is_back);
    let face = primitive & ~(TWO_SIDED_BIT | FLIPPED_BIT);
    let precedes = rank < hit.rank || (rank == hit.rank && face < hit.primitive);
    if t < hit.t || (t == hit.t && precedes) {
        return ClosestHit(t, rank, face);
    }
    return hit;
}

fn intersect(ray: ShearedRay, first_word: u32, instance: u32, closest: ClosestHit) -> ClosestHit {
    let first = geometry(first_word);
    let a = relative(ray, first.xyz);
    let b = relative(ray, geometry(first_word + 1u).xyz);
    let c = relative(ray, geometry(first_word + 2u).xyz);
    // The edge functions.
    let uvw = rounded(vec3(c.x, a.x, b.x) * vec3(b.y, c.y, a.y)) - rounded(vec3(c.y, a.y, b.y) * vec3(b.x, c.x, a.x));
    let determinant = uvw.x + uvw.y + uvw.z;
    let is_inside = min(min(uvw.x, uvw.y), uvw.z) >= 0f || max(max(uvw.x, uvw.y), uvw.z) <= 0f;
    let t = (uvw.x * a.z + uvw.y * b.z + uvw.z * c.z) / determinant;
    if is_inside && determinant != 0f && t > 0f && t <= closest.t {
        return closer(closest, t, determinant > 0f, first.w, instance);
    }
    return closest;
}
