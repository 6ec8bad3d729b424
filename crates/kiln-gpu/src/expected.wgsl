// What a ray is worth that ends wherever it is absorbed: events in the order of their distances, some at a time; foliage.rs.

// Changes no result; docs/gpu.md says why so many.
const MOST_EVENTS: u32 = 16u;
// Where no more than 2^-SPENT of the visibility is left, the rest of the way changes nothing.
const SPENT: f32 = 32f;

// Bits of the distance, depth that is lost there, change of the rate in two halves; by distance, no two at the same. Private, not
// local: a local would be cleared for every ray.
var<private> events: array<vec4<u32>, MOST_EVENTS>;
var<private> event_count: u32;
var<private> ray_end: f32;
// Events up to here have been taken.
var<private> taken_to: f32;
// Events beyond here do not fit any more.
var<private> room_to: f32;

fn walk_from() -> f32 {
    return max(taken_to, 0f);
}

fn walk_to() -> f32 {
    return room_to;
}

fn is_walk_over() -> bool {
    return false;
}

// The sum of numbers of 64 bits.
fn wide_sum(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.x + b.x;
    return vec2(low, a.y + b.y + select(0u, 1u, low < a.x));
}

fn wide_minus(a: vec2<u32>) -> vec2<u32> {
    return wide_sum(~a, vec2(1u, 0u));
}

// Takes note of an event if it is the turn of its distance; the farthest one gives way where there is no room.
fn add_event(t: f32, depth: u32, rate: vec2<u32>) {
    if !(t > taken_to && t <= room_to) {
        return;
    }
    // Without the sign of a zero: bits are in the order of distances.
    let bits = bitcast<u32>(t) & 0x7fffffffu;
    var place = event_count;
    while place > 0u && events[place - 1u].x > bits {
        place--;
    }
    if place > 0u && events[place - 1u].x == bits {
        let there = events[place - 1u];
        events[place - 1u] = vec4(bits, saturated(there.y, depth), wide_sum(there.zw, rate));
        return;
    }
    event_count = min(event_count + 1u, MOST_EVENTS);
    for (var at = event_count - 1u; at > place; at--) {
        events[at] = events[at - 1u];
    }
    events[place] = vec4(bits, depth, rate);
    if event_count == MOST_EVENTS {
        room_to = bitcast<f32>(events[MOST_EVENTS - 1u].x);
    }
}

fn meet_face(t: f32, depth: u32) {
    add_event(t, depth, vec2(0u));
}

fn meet_fog(near: f32, far: f32, rate: vec2<u32>) {
    add_event(near, 0u, rate);
    // What ends with the ray needs no end.
    if far < ray_end {
        add_event(far, 0u, wide_minus(rate));
    }
}

// How far a ray has come, and what it has brought.
struct Way {
    // For each channel.
    sum: vec4<f32>,
    from_t: f32,
    crossed: u32,
    in_fog: f32,
    // Of the fog from here on.
    rate: vec2<u32>,
}

fn lost_on(way: Way) -> f32 {
    return f32(way.crossed) / DEPTH_UNITS + way.in_fog;
}

// Goes on to a distance that is no nearer. `rates` is that of the kernel.
fn gone(way: Way, to: f32, rates: vec4<f32>) -> Way {
    var next = way;
    let length = min(to - way.from_t, MOST_LENGTH);
    if length > 0f {
        let fog = per_m(way.rate);
        let both = rates + vec4(fog);
        // Channels without a rate gain nothing on the way.
        let share = select(rates / select(vec4(1f), both, rates > vec4(0f)), vec4(0f), rates <= vec4(0f));
        let kept = exp2_minus(vec4(lost_on(way)) + rates * min(way.from_t, MOST_LENGTH));
        next.sum += share * kept * one_minus_exp2_minus(both * length);
        next.in_fog += fog * length;
        next.from_t = to;
    }
    return next;
}

// Takes the ray past the events of the list.
fn gone_past(way: Way, rates: vec4<f32>) -> Way {
    var next = way;
    for (var at = 0u; at < event_count; at++) {
        let event = events[at];
        next = gone(next, bitcast<f32>(event.x), rates);
        next.crossed = saturated(next.crossed, event.y);
        next.rate = wide_sum(next.rate, event.zw);
    }
    return next;
}

// Whether what is left changes no channel's value.
fn is_spent(kernel: Kernel, way: Way, rates: vec4<f32>) -> bool {
    let lost = vec4(lost_on(way)) + rates * min(way.from_t, MOST_LENGTH);
    return all(select(lost, vec4(SPENT), kernel.open == vec4(0u)) >= vec4(SPENT));
}

fn ray_value(kernel: Kernel, origin: vec3<f32>, direction: vec3<f32>, hit: ClosestHit) -> vec4<u32> {
    ray_end = hit.t;
    // Before all distances.
    taken_to = -1f;
    let rates = select(vec4(0f), kernel.rates, kernel.hit_mask != vec4(0u));
    var way = Way(vec4(0f), 0f, 0u, 0f, vec2(0u));
    loop {
        event_count = 0u;
        room_to = ray_end;
        walk_foliage(origin, direction);
        if event_count == 0u {
            break;
        }
        way = gone_past(way, rates);
        taken_to = bitcast<f32>(events[event_count - 1u].x);
        if event_count < MOST_EVENTS || is_spent(kernel, way, rates) {
            break;
        }
    }
    if taken_to < 0f {
        return unhindered_value(kernel, hit);
    }
    way = gone(way, ray_end, rates);
    if hit.rank == MISS_RANK {
        way.sum += exp2_minus(vec4(lost_on(way)) + rates * min(ray_end, MOST_LENGTH));
    }
    return select(fixed(way.sum), vec4(0u), kernel.open == vec4(0u));
}
