//! Detection of HTML and XML pages that servers and login portals send with status 200 instead of the content.

use super::IoError;

/// Fails with [`IoError::Markup`] if the bytes begin like an HTML or XML document. No content format does.
pub(crate) fn refuse_markup(uri: &str, bytes: &[u8]) -> Result<(), IoError> {
    match text_and_first_byte(bytes).1 {
        Some(b'<') => Err(IoError::Markup { uri: uri.to_owned() }),
        _ => Ok(()),
    }
}

/// Returns the text without its UTF-8 byte order mark, and its first byte that is not white space.
pub(crate) fn text_and_first_byte(bytes: &[u8]) -> (&[u8], Option<u8>) {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    (text, text.iter().find(|b| !b.is_ascii_whitespace()).copied())
}
