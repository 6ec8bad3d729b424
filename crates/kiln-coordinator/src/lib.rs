//! The coordinator: gRPC services over the scheduler and the store.
