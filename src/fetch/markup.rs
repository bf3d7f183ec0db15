//! HTML and XML: pages that servers and login portals send with status 200 instead of the content, and attributions.

use super::{IoError, path_of};

/// Fails with [`IoError::Markup`] if the bytes begin like an HTML or XML document. Terrain tiles begin with a number, whose
/// first byte may be that of `<`.
pub(crate) fn refuse_markup(uri: &str, bytes: &[u8]) -> Result<(), IoError> {
    /// The number of bytes that must be text.
    const LOOKED_AT: usize = 88;
    let start = &bytes[..bytes.len().min(LOOKED_AT)];
    let is_text = |byte: &u8| !byte.is_ascii_control() || byte.is_ascii_whitespace();
    match text_and_first_byte(bytes).1 {
        Some(b'<') if start.iter().all(is_text) => Err(match model_of_xml(uri, start) {
            Some(what) => IoError::unsupported(uri, what),
            None => IoError::Markup { uri: uri.to_owned() },
        }),
        _ => Ok(()),
    }
}

/// Returns what a model in XML is, by its name; `None` for other names and for HTML, which a server sends instead of the file.
fn model_of_xml(uri: &str, start: &[u8]) -> Option<&'static str> {
    const MODELS: [(&str, &str); 4] = [
        (".osgx", "OpenSceneGraph's XML (.osgx; osgconv converts it to .osgb)"),
        (".dae", "a COLLADA model (.dae)"),
        (".x3d", "an X3D model (.x3d)"),
        (".kml", "a KML document (.kml)"),
    ];
    let start = String::from_utf8_lossy(start).to_ascii_lowercase();
    if start.contains("<html") || start.contains("<!doctype html") {
        return None;
    }
    let name = path_of(uri).to_ascii_lowercase();
    MODELS.iter().find(|(extension, _)| name.ends_with(extension)).map(|(_, what)| *what)
}

/// Returns true for the text that stands for a file of Git LFS where the file was not downloaded.
pub(crate) fn is_lfs_pointer(bytes: &[u8]) -> bool {
    bytes.starts_with(b"version https://git-lfs.github.com/spec/")
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
            c if c.is_control() => {}
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
    use super::{plain_text, refuse_markup};

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
            assert_eq!(refuse_markup("u", bytes).is_err(), is_markup, "{bytes:?}");
        }
    }

    #[test]
    fn attributions_become_plain_text() {
        let html = "<a href=\"https://x\"><img src=\"logo.png\" alt=\"X\"></a>\n  &copy; 2026 <b>Survey &amp;</b> Sons";
        assert_eq!(plain_text(html), "© 2026 Survey & Sons");
        assert_eq!(plain_text("an < unclosed tag"), "an");
        assert_eq!(plain_text(&"ä".repeat(9_000)).chars().count(), 500);
        assert_eq!(plain_text("a\x1b]0;t\x07 <b>b</b>\u{9b}"), "a]0;t b");
    }

    #[test]
    fn models_in_xml_are_named() {
        let reason = |uri: &str, text: &str| refuse_markup(uri, text.as_bytes()).unwrap_err().to_string();
        let xml = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Scene>";
        assert!(reason("https://h/b.OSGX?x=1", xml).contains("OpenSceneGraph's XML (.osgx"));
        assert!(reason("b.dae", xml).contains("COLLADA"));
        assert!(reason("b.osgx", "<!DOCTYPE html><html>").contains("a web page"));
        assert!(reason("b.glb", xml).contains("a web page"));
    }
}
