// Traversal of both levels by hardware ray queries; ray_query.rs says how. The generated prelude gives the acceleration structure, `boxes`.

// A hit is reported this little further than it is, so that what ties with it is still proposed. Keep in sync with ray_query.rs.
const REPORT_SLACK: f32 = 1.000030517578125f;
// No distance is greater.
const MOST_REACH: f32 = 3e38f;
// Boxes of one word of a mesh's table.
const RUNS_PER_WORD: u32 = 4u;

// How far boxes are of interest where the best hit is at `t`, for a direction whose unit is 1/`unit` of the ray's.
fn reach(t: f32, unit: f32) -> f32 {
    return min(t * unit * REPORT_SLACK, MOST_REACH);
}

// Tests the triangles of a box.
fn visit_box(object: ObjectRay, index: u32, closest: ClosestHit) -> ClosestHit {
    let run = geometry(object.links.x + index / RUNS_PER_WORD)[index % RUNS_PER_WORD];
    var hit = closest;
    var at = object.links.y + TRIANGLE_WORDS * (run >> 3u);
    for (var left = run & 7u; left > 0u; left--) {
        if COUNT_VISITS {
            visits.y++;
        }
        hit = intersect(object.slab, object.sheared, at, object.links.z, hit);
        at += TRIANGLE_WORDS;
    }
    return hit;
}

fn closest_hit(origin: vec3<f32>, direction: vec3<f32>, t_max: f32) -> ClosestHit {
    var hit = ClosestHit(t_max, MISS_RANK, NO_PRIMITIVE);
    let length = max(max(abs(direction.x), abs(direction.y)), abs(direction.z));
    // A ray without a direction, or one that is not a number, meets nothing.
    if scene.is_empty != 0u || !(length > 0f) {
        return hit;
    }
    // The hardware's ray has a length between 1 and 2 along its greatest axis: a power of two changes no bit.
    let exponent = clamp(bitcast<u32>(length) >> 23u, 1u, 253u);
    let unit = bitcast<f32>(exponent << 23u);
    let scaled = direction * bitcast<f32>((254u - exponent) << 23u);
    var query: ray_query;
    rayQueryInitialize(&query, boxes, RayDesc(RAY_FLAG_NONE, 0xffu, 0f, reach(t_max, unit), origin, scaled));
    var instance = NO_INSTANCE;
    var object: ObjectRay;
    var is_reported = false;
    while rayQueryProceed(&query) {
        let candidate = rayQueryGetCandidateIntersection(&query);
        if COUNT_VISITS {
            visits.x++;
        }
        if candidate.instance_custom_data != instance {
            instance = candidate.instance_custom_data;
            object = object_ray(NODE_WORDS * instance, origin, direction);
            if COUNT_VISITS {
                visits.z++;
            }
        }
        hit = visit_box(object, candidate.primitive_index, hit);
        if ANY_HIT && hit.rank != MISS_RANK {
            break;
        }
        // The first only; ray_query.rs says why.
        if !is_reported && hit.rank != MISS_RANK {
            rayQueryGenerateIntersection(&query, reach(hit.t, unit));
            is_reported = true;
        }
    }
    return hit;
}
