// The reduction of a gather kernel through the workgroup's memory, for every adapter; gather.rs.

@compute @workgroup_size(LANES)
fn gather(@builtin(local_invocation_index) local: u32, @builtin(workgroup_id) workgroup: vec3<u32>) {
    lane = local;
    let own = gathered(local, workgroup.xy);
    lane_values[local] = own.values;
    lane_counts[local] = own.counts;
    workgroupBarrier();
    if is_first(local, workgroup.x) {
        give_out(local, workgroup.xy, 1u);
    }
}
