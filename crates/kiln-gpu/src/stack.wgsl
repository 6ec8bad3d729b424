// The stack of a walk through a tree; traverse.rs says how. The generated prelude gives STACK_ENTRIES.

// Entries of each lane's stack that lie in the workgroup's memory; the others are private.
const SHARED_ENTRIES: u32 = min(STACK_ENTRIES, 8u);
const SPILL_ENTRIES: u32 = max(STACK_ENTRIES, SHARED_ENTRIES + 1u) - SHARED_ENTRIES;

// A group without nodes but one, the first of its level.
const ROOT: vec2<u32> = vec2(0u, 0xff0001u);

var<workgroup> shared_stack: array<vec2<u32>, SHARED_ENTRIES * LANES>;
// Private, not local: a local would be cleared for every ray.
var<private> spilled_stack: array<vec2<u32>, SPILL_ENTRIES>;

fn push(depth: u32, group: vec2<u32>) {
    if STACK_ENTRIES <= SHARED_ENTRIES || depth < SHARED_ENTRIES {
        shared_stack[depth * LANES + lane] = group;
    } else {
        spilled_stack[depth - SHARED_ENTRIES] = group;
    }
}

fn popped(depth: u32) -> vec2<u32> {
    if STACK_ENTRIES <= SHARED_ENTRIES || depth < SHARED_ENTRIES {
        return shared_stack[depth * LANES + lane];
    }
    return spilled_stack[depth - SHARED_ENTRIES];
}
