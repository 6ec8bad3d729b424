//! What a query costs an engine.

/// The table.
pub(super) fn table() -> String {
    String::new()
}
