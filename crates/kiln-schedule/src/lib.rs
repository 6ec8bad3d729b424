//! A pure, synchronous scheduler of jobs, tasks and leases.
