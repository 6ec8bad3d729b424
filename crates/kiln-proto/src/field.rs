//! Checks of single fields, and the error that names the field at fault.

use crate::limits;
use kiln_core::Digest;

/// A field of a message that is not what it must be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct FieldError {
    /// Path of the field, such as `source.files[3].path`.
    pub field: String,
    /// What is wrong, and what it must be.
    pub problem: String,
}

impl FieldError {
    /// An error about the named field.
    pub fn new(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { field: field.into(), problem: problem.into() }
    }

    /// The same error as seen from the message that holds `parent`.
    #[must_use]
    pub fn within(self, parent: &str) -> Self {
        Self { field: format!("{parent}.{}", self.field), problem: self.problem }
    }
}

/// A digest from a field of bytes.
pub fn digest(field: &str, bytes: &[u8]) -> Result<Digest, FieldError> {
    Digest::from_slice(bytes).map_err(|e| FieldError::new(field, e.to_string()))
}

/// Digests from a repeated field of bytes, at most `most`.
pub(crate) fn digests(field: &str, list: &[Vec<u8>], most: usize) -> Result<Vec<Digest>, FieldError> {
    at_most(field, list.len(), most)?;
    list.iter().enumerate().map(|(i, bytes)| digest(&format!("{field}[{i}]"), bytes)).collect()
}

/// The value of a message field that must be set.
pub fn required<T>(field: &str, value: Option<T>) -> Result<T, FieldError> {
    value.ok_or_else(|| FieldError::new(field, "is missing"))
}

/// Refuses too many entries.
pub(crate) fn at_most(field: &str, count: usize, most: usize) -> Result<(), FieldError> {
    if count > most {
        return Err(FieldError::new(field, format!("has {count} entries; at most {most} are taken")));
    }
    Ok(())
}

/// Refuses a float outside of the range; NaN is outside of every range.
pub(crate) fn in_range(field: &str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<f64, FieldError> {
    if range.contains(&value) {
        return Ok(value);
    }
    Err(FieldError::new(field, format!("is {value}; it must be from {} to {}", range.start(), range.end())))
}

/// Refuses a float that is not finite and greater than zero.
pub(crate) fn positive(field: &str, value: f64) -> Result<f64, FieldError> {
    if value > 0.0 && value.is_finite() {
        return Ok(value);
    }
    Err(FieldError::new(field, format!("is {value}; it must be finite and greater than 0")))
}

/// Refuses an id that is empty, too long, or holds anything but visible ASCII.
pub(crate) fn id<'a>(field: &str, value: &'a str) -> Result<&'a str, FieldError> {
    if value.is_empty() || value.len() > limits::ID_BYTES || !value.bytes().all(|b| b.is_ascii_graphic()) {
        let problem = format!("must have 1 to {} visible ASCII characters", limits::ID_BYTES);
        return Err(FieldError::new(field, problem));
    }
    Ok(value)
}

/// Refuses a text that is too long or holds control characters.
pub(crate) fn text<'a>(field: &str, value: &'a str, most: usize) -> Result<&'a str, FieldError> {
    if value.len() > most || value.chars().any(char::is_control) {
        return Err(FieldError::new(field, format!("must have at most {most} bytes and no control characters")));
    }
    Ok(value)
}
