//! Ray tracing for Kiln: the Tracer contract, ray generation, BVHs and the CPU tracer.
