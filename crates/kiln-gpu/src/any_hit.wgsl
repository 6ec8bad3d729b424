// Whether given rays hit anything; any_hit.rs.

// A bit for each ray.
@group(0) @binding(2) var<storage, read_write> blocked: array<u32>;

var<workgroup> blocked_lanes: array<atomic<u32>, 2>;

@compute @workgroup_size(LANES)
fn any_hit(@builtin(local_invocation_index) local: u32, @builtin(workgroup_id) workgroup: vec3<u32>) {
    lane = local;
    if local < 2u {
        atomicStore(&blocked_lanes[local], 0u);
    }
    workgroupBarrier();
    let ray = LANES * workgroup.x + local;
    if ray < params.ray_count {
        if traced(ray).rank != MISS_RANK {
            atomicOr(&blocked_lanes[local / 32u], 1u << (local % 32u));
        }
    }
    workgroupBarrier();
    if local < 2u {
        blocked[2u * workgroup.x + local] = atomicLoad(&blocked_lanes[local]);
    }
}
