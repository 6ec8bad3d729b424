// The watertight triangle test, the distance of a hit and the tie rule. Keep in sync with triangle.rs here, which says how, and
// with kiln-trace's triangle.rs and alone.rs.

const NO_PRIMITIVE: u32 = 0xffffffffu;
const TWO_SIDED_BIT: u32 = 0x80000000u;
// The corners are in the order of the other winding.
const FLIPPED_BIT: u32 = 0x40000000u;
// Set in the rank of a back-face hit, so that front faces come first.
const BACK_BIT: u32 = 0x80000000u;
// The rank of no hit: after every front face, before every back face.
const MISS_RANK: u32 = 0x7fffffffu;

const TRIANGLE_WORDS: u32 = 3u;

// Widens the far distance of a triangle's own box, as kiln-trace's ray.rs; less than what other boxes are widened by.
const WIDEN: f32 = 1.0000006f;
// A little before the box is near enough, since what is entered up to 8e-6 behind a hit is visited: so the rounding of the
// box's distance does not take the place of the plane's, which is better.
const NARROW: f32 = 0.9999995f;

struct ClosestHit {
    t: f32,
    // Instance, with BACK_BIT.
    rank: u32,
    primitive: u32,
}

struct ShearedRay {
    axes: vec3<u32>,
    // What x and y are sheared by for each unit along z.
    shear: vec2<f32>,
    direction: vec3<f32>,
}

// Keeps a product from being fused with a later sum: it must be rounded before the bits can be had.
fn rounded(product: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(product) ^ vec3(scene.zero));
}

fn component(v: vec3<f32>, axis: u32) -> f32 {
    return select(select(v.x, v.y, axis == 1u), v.z, axis == 2u);
}

fn sheared_ray(direction: vec3<f32>) -> ShearedRay {
    let size = abs(direction);
    let z = select(select(2u, 1u, size.y > size.z), 0u, size.x > size.y && size.x > size.z);
    let next = select(z + 1u, 0u, z == 2u);
    let last = select(z - 1u, 2u, z == 0u);
    let along = component(direction, z);
    // A negative z mirrors; turning the axes back keeps the winding.
    let x = select(next, last, along < 0f);
    let y = select(last, next, along < 0f);
    let shear = vec2(component(direction, x) / along, component(direction, y) / along);
    return ShearedRay(vec3(x, y, z), shear, direction);
}

// Where a corner is across the ray; `corner` is relative to the ray's origin.
fn across(ray: ShearedRay, corner: vec3<f32>) -> vec2<f32> {
    let along = vec3(component(corner, ray.axes.z) * ray.shear, 0f);
    return vec2(component(corner, ray.axes.x), component(corner, ray.axes.y)) - rounded(along).xy;
}

// Where the ray meets the plane of the triangle with these corners, kept within the triangle's own box, or below 0 where it passes
// by that; `a_from_origin` is the first of them, relative to the ray's origin.
fn plane_distance(
    slab: SlabRay, direction: vec3<f32>, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>, a_from_origin: vec3<f32>
) -> f32 {
    let scaled_normal = cross(b - a, c - a);
    let scale = max(max(abs(scaled_normal.x), abs(scaled_normal.y)), abs(scaled_normal.z));
    // 1 along its greatest axis, so that in planes of the axes the distance is one division, whatever the triangle.
    let normal = scaled_normal / scale;
    let slope = dot(normal, direction);
    let is_down = slab.inverse < vec3(0f);
    let least = min(min(a, b), c);
    let greatest = max(max(a, b), c);
    let enters = (select(least, greatest, is_down) - slab.origin) * slab.inverse;
    let leaves = (select(greatest, least, is_down) - slab.origin) * slab.inverse;
    let near = max(max(enters.x, enters.y), enters.z);
    let far = min(min(leaves.x, leaves.y), leaves.z) * WIDEN;
    // What rounding took off the corner relative to the origin, exactly (Knuth's two-sum).
    let origin_part = rounded(a_from_origin - a);
    let lost = (a - rounded(a_from_origin - origin_part)) - (slab.origin + origin_part);
    let quotient = dot(normal, a_from_origin) / slope;
    // A ray in the plane, to rounding, has no distance but that of the box.
    let distance = select(quotient + dot(normal, lost) / slope, near, slope == 0f || scale == 0f);
    // As on the CPU, nothing is hit whose box the ray does not enter: the tree would not have come here.
    return select(-1f, coarse(max(min(distance, far), near * NARROW)), near <= far);
}

// A distance to 18 bits, so that faces that coincide tie although distances are rounded; it keeps their order.
fn coarse(t: f32) -> f32 {
    return bitcast<f32>((bitcast<u32>(t) + 32u) & 0xffffffc0u);
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

// Where the line of a ray goes through a triangle.
struct Meeting {
    // Not above 0 if it does not, or behind the ray.
    t: f32,
    is_counter_clockwise: bool,
}

fn meet(slab: SlabRay, sheared: ShearedRay, a_word: vec4<u32>, b_word: vec4<u32>, c_word: vec4<u32>) -> Meeting {
    let a = bitcast<vec3<f32>>(a_word.xyz);
    let b = bitcast<vec3<f32>>(b_word.xyz);
    let c = bitcast<vec3<f32>>(c_word.xyz);
    let a_from_origin = rounded(a - slab.origin);
    let p = across(sheared, a_from_origin);
    let q = across(sheared, b - slab.origin);
    let r = across(sheared, c - slab.origin);
    // The edge functions.
    let uvw = rounded(vec3(r.x, p.x, q.x) * vec3(q.y, r.y, p.y)) - rounded(vec3(r.y, p.y, q.y) * vec3(q.x, r.x, p.x));
    let determinant = uvw.x + uvw.y + uvw.z;
    let is_inside = min(min(uvw.x, uvw.y), uvw.z) >= 0f || max(max(uvw.x, uvw.y), uvw.z) <= 0f;
    if is_inside && determinant != 0f {
        return Meeting(plane_distance(slab, sheared.direction, a, b, c, a_from_origin), determinant > 0f);
    }
    return Meeting(-1f, false);
}

fn intersect(
    slab: SlabRay, sheared: ShearedRay, first_word: u32, instance: u32, closest: ClosestHit
) -> ClosestHit {
    let first = geometry(first_word);
    let meeting = meet(slab, sheared, first, geometry(first_word + 1u), geometry(first_word + 2u));
    if meeting.t > 0f && meeting.t <= closest.t {
        return closer(closest, meeting.t, meeting.is_counter_clockwise, first.w, instance);
    }
    return closest;
}
