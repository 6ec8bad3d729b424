//! Rich errors of RPCs: `google.rpc.ErrorInfo` with a stable reason, `BadRequest` with the field at fault,
//! `RetryInfo` where waiting helps.

use crate::FieldError;
use std::time::Duration;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, FieldViolation, StatusExt};

/// Domain of the reasons in `ErrorInfo`.
pub const DOMAIN: &str = "kiln";

/// Reason of an error about a field.
pub const INVALID_FIELD: &str = "INVALID_FIELD";

/// Reason of the error when files of a submission have not been uploaded.
pub const SOURCE_MISSING: &str = "SOURCE_MISSING";

/// Reason of the error when a bake is not known.
pub const BAKE_NOT_FOUND: &str = "BAKE_NOT_FOUND";

/// Reason of the error when a request id was used for something else.
pub const REQUEST_ID_REUSED: &str = "REQUEST_ID_REUSED";

/// Reason of the error when the coordinator is stopping.
pub const STOPPING: &str = "STOPPING";

/// An error with a stable reason in capitals, such as `BAKE_NOT_FOUND`.
pub fn error(code: Code, reason: &str, message: impl Into<String>) -> Status {
    let mut details = ErrorDetails::new();
    details.set_error_info(reason, DOMAIN, []);
    Status::with_error_details(code, message, details)
}

/// An error that goes away by waiting for about `delay`.
pub fn retry_later(code: Code, reason: &str, message: impl Into<String>, delay: Duration) -> Status {
    let mut details = ErrorDetails::new();
    details.set_error_info(reason, DOMAIN, []);
    details.set_retry_info(Some(delay));
    Status::with_error_details(code, message, details)
}

/// INVALID_ARGUMENT about one field.
pub fn invalid(error: &FieldError) -> Status {
    let mut details = ErrorDetails::new();
    details.set_error_info(INVALID_FIELD, DOMAIN, []);
    details.set_bad_request(vec![FieldViolation::new(&error.field, &error.problem)]);
    Status::with_error_details(Code::InvalidArgument, error.to_string(), details)
}

/// The reason of an error that Kiln made.
pub fn reason(status: &Status) -> Option<String> {
    status.get_details_error_info().filter(|info| info.domain == DOMAIN).map(|info| info.reason)
}

/// How long to wait before trying again, where the peer says so.
pub fn retry_delay(status: &Status) -> Option<Duration> {
    status.get_details_retry_info().and_then(|info| info.retry_delay)
}

/// Whether trying the same again may succeed: the connection broke, or the peer says so.
pub fn is_transient(status: &Status) -> bool {
    let broken = matches!(status.code(), Code::Unavailable | Code::Aborted | Code::Cancelled)
        || (matches!(status.code(), Code::Unknown | Code::Internal) && reason(status).is_none());
    broken || retry_delay(status).is_some()
}

impl From<FieldError> for Status {
    fn from(error: FieldError) -> Self {
        invalid(&error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_about_a_field_names_it() {
        let status = Status::from(FieldError::new("path", "is empty").within("files[2]"));
        assert_eq!(status.code(), Code::InvalidArgument);
        assert_eq!(reason(&status).as_deref(), Some(INVALID_FIELD));
        let request = status.get_details_bad_request().unwrap();
        assert_eq!(request.field_violations[0].field, "files[2].path");
        assert!(!is_transient(&status));
    }

    #[test]
    fn only_broken_connections_and_retry_info_are_transient() {
        assert!(is_transient(&Status::unavailable("gone")));
        assert!(!is_transient(&Status::out_of_range("too large")));
        let internal = error(Code::Internal, "STORE_FAILED", "the store failed");
        assert!(!is_transient(&internal));
        let busy = retry_later(Code::ResourceExhausted, "BUSY", "busy", Duration::from_millis(20));
        assert!(is_transient(&busy));
        assert_eq!(retry_delay(&busy), Some(Duration::from_millis(20)));
    }
}
