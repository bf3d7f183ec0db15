//! Texts of errors with their causes. HTTP thread.

/// Formats an error with its causes in one line, without the URL, which may contain a token.
pub(super) fn error_chain_without_url(error: reqwest::Error) -> String {
    error_chain(&error.without_url())
}

/// Formats an error with its causes in one line.
pub(in crate::fetch) fn error_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(e) = source {
        text.push_str(": ");
        text.push_str(&e.to_string());
        source = e.source();
    }
    text
}
