// The value of a ray whose closest hit is known, whatever it goes through before.

fn unhindered_value(kernel: Kernel, hit: ClosestHit) -> vec4<u32> {
    if hit.rank == MISS_RANK {
        return kernel.open;
    }
    return hit_value(kernel, hit.t);
}
