//! Text operations on URIs: kind, server, percent encoding, and how they and other text of outside data are printed. They parse
//! leniently.
//!
//! A URI is an absolute file path, an http(s) URL, or `s3://`, `gs://` or `az://` with a bucket and a key.

use std::borrow::Cow;

/// Returns true for http and https URLs.
pub fn is_http(uri: &str) -> bool {
    starts_with_any(uri, &["http://", "https://"])
}

/// Returns true for objects in an object store: `s3://`, `gs://` (Google) and `az://` (Azure).
pub fn is_store(uri: &str) -> bool {
    starts_with_any(uri, &["s3://", "gs://", "az://"])
}

/// Returns true for everything that is not a local file.
pub fn is_remote(uri: &str) -> bool {
    is_http(uri) || is_store(uri)
}

fn starts_with_any(uri: &str, prefixes: &[&str]) -> bool {
    prefixes.iter().any(|prefix| uri.get(..prefix.len()).is_some_and(|p| p.eq_ignore_ascii_case(prefix)))
}

/// Returns scheme, host and port of a URL, or scheme and bucket of an object.
pub(crate) fn server(uri: &str) -> &str {
    let start = uri.find("://").map_or(0, |at| at + 3);
    let rest = uri.get(start..).unwrap_or("");
    let end = rest.find(['/', '?', '#']).map_or(uri.len(), |at| start + at);
    uri.get(..end).unwrap_or(uri)
}

/// Returns a text of outside data for a terminal or a line of a log: control characters, which move the cursor or begin a new
/// line, become U+FFFD.
pub fn printable(text: &str) -> Cow<'_, str> {
    match text.contains(char::is_control) {
        true => Cow::Owned(text.replace(char::is_control, "\u{fffd}")),
        false => Cow::Borrowed(text),
    }
}

/// Returns a URI for errors, logs and reports. User name, password and query values of a URL are omitted.
pub fn shown(uri: &str) -> Cow<'_, str> {
    if !is_remote(uri) {
        return printable(uri);
    }
    let (path, query) = uri.split_once('?').map_or((uri, None), |(path, query)| (path, Some(query)));
    let query = query.and_then(|query| query.split('#').next());
    let start = path.find("://").map_or(0, |at| at + 3);
    // Skip slashes before the host, as HTTP clients do.
    let start = path.len() - path[start..].trim_start_matches(['/', '\\', '\t', '\n', '\r']).len();
    let ends: &[char] = if is_http(uri) { &['/', '\\', '#'] } else { &['/', '#'] };
    let end = path[start..].find(ends).map_or(path.len(), |at| start + at);
    let user = path[start..end].rfind('@');
    if query.is_none() && user.is_none() {
        return Cow::Borrowed(uri);
    }
    let mut text = path[..start].to_owned();
    text.push_str(&path[user.map_or(start, |at| start + at + 1)..]);
    for (i, pair) in query.into_iter().flat_map(|q| q.split('&')).enumerate() {
        text.push(if i == 0 { '?' } else { '&' });
        // A parameter without a name may itself be a token.
        let name = pair.split_once('=').map_or("", |(name, _)| name);
        text.push_str(name);
        text.push_str(if name.is_empty() { "..." } else { "=..." });
    }
    Cow::Owned(text)
}

/// Returns a URL without query and fragment. A local path is returned unchanged, since `?` and `#` are allowed in file
/// names.
pub(crate) fn path_of(uri: &str) -> &str {
    if is_remote(uri) { uri.split(['?', '#']).next().unwrap_or(uri) } else { uri }
}

/// Decodes `%41` and the like (RFC 3986, 2.1). Returns `None` for a broken escape and for bytes that are not UTF-8.
pub(crate) fn percent_decode(text: &str) -> Option<String> {
    if !text.contains('%') {
        return Some(text.to_owned());
    }
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(b) = rest.next() {
        if b == b'%' {
            let high = char::from(rest.next()?).to_digit(16)?;
            let low = char::from(rest.next()?).to_digit(16)?;
            bytes.push((high * 16 + low) as u8);
        } else {
            bytes.push(b);
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_not_shown() {
        for (uri, text) in [
            ("/data/a?b=c", "/data/a?b=c"),
            ("https://h/a.glb", "https://h/a.glb"),
            ("https://h/a.glb?key=1&v=2#f", "https://h/a.glb?key=...&v=..."),
            ("https://h/a.glb?secret", "https://h/a.glb?..."),
            ("HTTP://me:pass@h:80/a@b", "HTTP://h:80/a@b"),
            ("http://me@h", "http://h"),
            ("http:///me:pass@h/a", "http:///h/a"),
            ("http://h\\a@b/c", "http://h\\a@b/c"),
            ("https://h/a.glb?secret#=f", "https://h/a.glb?..."),
        ] {
            assert_eq!(shown(uri), text);
        }
    }

    #[test]
    fn servers_differ_by_scheme_name_and_port() {
        assert_eq!(server("https://a.example:8080/tiles/x.glb?token=/"), "https://a.example:8080");
        assert_eq!(server("http://a.example"), "http://a.example");
        assert_eq!(server("http://a.example?x#y"), "http://a.example");
        assert_eq!(server("gs://bucket/key"), "gs://bucket");
        assert_eq!(server("odd"), "odd");
        for (uri, is_there) in
            [("http://a:80/x", true), ("http://a:80", true), ("http://a:80?x", true), ("http://a:8080/x", false)]
        {
            assert_eq!(server(uri) == "http://a:80", is_there, "{uri}");
        }
    }

    #[test]
    fn control_characters_are_not_printed() {
        assert_eq!(printable("a\x1b[2J\nb\u{9b}"), "a\u{fffd}[2J\u{fffd}b\u{fffd}");
        assert_eq!(printable("naïve ✓ -->"), "naïve ✓ -->");
    }
}
