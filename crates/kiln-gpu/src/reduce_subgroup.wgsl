// The reduction of a gather kernel by subgroups; gather.rs. Integers: the sums are those of reduce.wgsl.

@compute @workgroup_size(LANES)
fn gather(
    @builtin(local_invocation_index) local: u32,
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(num_subgroups) subgroup_count: u32,
    @builtin(subgroup_size) subgroup_size: u32,
    @builtin(subgroup_invocation_id) invocation: u32,
) {
    // Places follow the lanes of subgroups, so that neighbours in a cone can shuffle. Where subgroups do not share the
    // workgroup evenly, places are as without subgroups, and nothing is shuffled.
    let is_even = subgroup_count * subgroup_size == LANES;
    let place = select(local, subgroup * subgroup_size + invocation, is_even);
    lane = place;
    let own = gathered(place, workgroup.xy);
    var values = own.values;
    var counts = own.counts;
    // A subgroup has a power of two lanes, as has a sample in a cone.
    let width = select(1u, min(1u << params.cones.ray_bits, subgroup_size), is_even);
    for (var step = 1u; step < width; step *= 2u) {
        values += subgroupShuffleXor(values, step);
        counts += subgroupShuffleXor(counts, step);
    }
    if (place & (width - 1u)) == 0u {
        lane_values[place] = values;
        lane_counts[place] = counts;
    }
    workgroupBarrier();
    if is_first(place, workgroup.x) {
        give_out(place, workgroup.xy, width);
    }
}
