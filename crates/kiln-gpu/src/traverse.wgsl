// Traversal of both levels; traverse.rs says how.

// Tests the triangles of the given leaves of a node. `leaves` is the node's second word.
fn visit_leaves(
    slab: SlabRay, sheared: ShearedRay, leaves: vec4<u32>, hit_leaves: u32, triangle_words: u32, instance: u32,
    closest: ClosestHit
) -> ClosestHit {
    var hit = closest;
    var waiting = hit_leaves;
    var at = 0u;
    var left = 0u;
    // One flat loop, so that lanes with leaves of different length stay together.
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
            // A slot that is not used has no triangles.
            if left == 0u {
                continue;
            }
        }
        if COUNT_VISITS {
            visits.y++;
        }
        hit = intersect(slab, sheared, at, instance, hit);
        at += TRIANGLE_WORDS;
        left--;
    }
    return hit;
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
    var triangle_words = 0u;
    var slab = slab_ray(origin, direction);
    var sheared: ShearedRay;
    var depth = 0u;
    var group = ROOT;
    loop {
        if (group.y & 0xffu) == 0u {
            if depth == base && instance != NO_INSTANCE {
                instance = NO_INSTANCE;
                base = 0u;
                node_words = 0u;
                slab = slab_ray(origin, direction);
            }
            if depth == 0u {
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
            if COUNT_VISITS {
                visits.x++;
            }
            let head = geometry(first_word);
            let links = geometry(first_word + 1u);
            let hits = entered(slab, head, first_word, 0f, hit.t);
            let nodes = head.w >> 24u;
            let is_top = instance == NO_INSTANCE;
            let children = select(nodes, links.y, is_top);
            group = vec2(links.x, in_order(hits & children, slab.octant) | (children << 8u) | (nodes << 16u));
            let leaves = select(hits & ~nodes, 0u, is_top);
            if leaves != 0u {
                hit = visit_leaves(slab, sheared, links, leaves, triangle_words, instance, hit);
                if ANY_HIT && hit.rank != MISS_RANK {
                    break;
                }
            }
        } else {
            if COUNT_VISITS {
                visits.z++;
            }
            let object = object_ray(first_word, origin, direction);
            slab = object.slab;
            sheared = object.sheared;
            node_words = object.links.x;
            triangle_words = object.links.y;
            instance = object.links.z;
            base = depth;
            group = ROOT;
        }
    }
    return hit;
}
