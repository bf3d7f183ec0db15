//! The conversion of errors of callbacks to errors of the viewer.

use terrane::viewer::ViewerError;

/// Converts an error of a callback to one of the viewer.
pub fn into_viewer_error(error: anyhow::Error) -> ViewerError {
    match error.downcast::<ViewerError>() {
        Ok(error) => error,
        Err(error) => ViewerError::Application(error.into()),
    }
}
