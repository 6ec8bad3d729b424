//! What a query costs an engine.
