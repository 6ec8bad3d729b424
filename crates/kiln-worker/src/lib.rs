//! A worker: leases tasks, runs them and streams results back.
