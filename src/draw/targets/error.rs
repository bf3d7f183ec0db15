//! Errors of render targets.

/// The reason why a stage's target cannot be drawn into.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(in crate::draw) enum TargetError {
    #[error("{0}")]
    Invalid(String),
    /// A texture that could not be created; the error was reported when it was tried.
    #[error("a texture could not be created")]
    Reported,
}

impl From<String> for TargetError {
    fn from(reason: String) -> Self {
        Self::Invalid(reason)
    }
}
