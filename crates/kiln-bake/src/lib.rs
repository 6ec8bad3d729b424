//! Surface samples and per-face moments: pure functions over a Tracer.
