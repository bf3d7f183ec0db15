//! HTML and XML: pages that servers and login portals send with status 200 instead of the content, and attributions.

use super::IoError;

/// Fails with [`IoError::Markup`] if the bytes begin like an HTML or XML document. No content format does.
pub(crate) fn refuse_markup(uri: &str, bytes: &[u8]) -> Result<(), IoError> {
    match text_and_first_byte(bytes).1 {
        Some(b'<') => Err(IoError::Markup { uri: uri.to_owned() }),
        _ => Ok(()),
    }
}

/// Like [`refuse_markup`], for binary files without magic bytes, which may begin with the same byte as markup. The first bytes of
/// markup are text.
pub(crate) fn refuse_markup_text(uri: &str, bytes: &[u8]) -> Result<(), IoError> {
    const CHECKED_BYTES: usize = 12;
    let is_text = |byte: &u8| byte.is_ascii_graphic() || byte.is_ascii_whitespace();
    let start = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    match start.iter().take(CHECKED_BYTES).all(is_text) {
        true => refuse_markup(uri, bytes),
        false => Ok(()),
    }
}

/// Returns the text without its UTF-8 byte order mark, and its first byte that is not white space.
pub(crate) fn text_and_first_byte(bytes: &[u8]) -> (&[u8], Option<u8>) {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    (text, text.iter().find(|b| !b.is_ascii_whitespace()).copied())
}

/// Returns the text of a piece of HTML: without tags, with the common entities replaced, and at most 500 characters.
pub(crate) fn plain_text(html: &str) -> String {
    const MAX_CHARS: usize = 500;
    let mut text = String::new();
    let mut in_tag = false;
    for c in html.chars() {
        match c {
            '<' => in_tag = true,
            '>' => in_tag = false,
            _ if in_tag => {}
            c if c.is_whitespace() => {
                if !text.ends_with(' ') {
                    text.push(' ');
                }
            }
            c => text.push(c),
        }
    }
    for (entity, c) in
        [("&nbsp;", " "), ("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&copy;", "©"), ("&amp;", "&")]
    {
        text = text.replace(entity, c);
    }
    text.trim().chars().take(MAX_CHARS).collect()
}

#[cfg(test)]
mod tests {
    use super::{plain_text, refuse_markup_text};

    /// Regression: one of 256 terrain tiles begins with the byte of `<`.
    #[test]
    fn binary_files_may_begin_like_markup() {
        for (bytes, is_markup) in [
            (&b"<!DOCTYPE html>"[..], true),
            (b"\xef\xbb\xbf\n <html><body>x", true),
            (b"<a/>", true),
            (b"<\x80\x11\x00\xa3{AA<html>", false),
            (b"", false),
        ] {
            assert_eq!(refuse_markup_text("u", bytes).is_err(), is_markup, "{bytes:?}");
        }
    }

    #[test]
    fn attributions_become_plain_text() {
        let html = "<a href=\"https://x\"><img src=\"logo.png\" alt=\"X\"></a>\n  &copy; 2026 <b>Survey &amp;</b> Sons";
        assert_eq!(plain_text(html), "© 2026 Survey & Sons");
        assert_eq!(plain_text("an < unclosed tag"), "an");
        assert_eq!(plain_text(&"ä".repeat(9_000)).chars().count(), 500);
    }
}
