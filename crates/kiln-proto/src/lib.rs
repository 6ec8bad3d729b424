//! Kiln's gRPC types and their conversions to domain types.
