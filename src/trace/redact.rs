//! Removal of secrets from URLs before they are written to a file or passed to a subscriber.

use std::borrow::Cow;

/// Returns a URL without user name, password and query, which may contain keys and tokens. Other texts are unchanged.
pub(super) fn without_secrets(uri: &str) -> Cow<'_, str> {
    let Some(start) = uri.find("://").map(|at| at + 3) else { return Cow::Borrowed(uri) };
    let path = uri.split(['?', '#']).next().unwrap_or(uri);
    // Skip slashes before the host, as HTTP clients do.
    let host = path.len() - path.get(start..).unwrap_or("").trim_start_matches(['/', '\\', '\t', '\n', '\r']).len();
    let end = path[host..].find(['/', '\\']).map_or(path.len(), |at| host + at);
    match path[host..end].rfind('@') {
        Some(at) => Cow::Owned(format!("{}{}", &path[..host], &path[host + at + 1..])),
        None if path.len() == uri.len() => Cow::Borrowed(uri),
        None => Cow::Owned(path.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_in_urls_are_removed() {
        for (uri, written) in [
            ("https://tiles.example/a/b.glb?key=secret", "https://tiles.example/a/b.glb"),
            ("https://me:pass@tiles.example:80/a@b.glb?secret", "https://tiles.example:80/a@b.glb"),
            ("HTTP://me@tiles.example", "HTTP://tiles.example"),
            ("http:///me:pass@h/a", "http:///h/a"),
            ("http://h/a#secret", "http://h/a"),
            ("/data/is it?/b.glb", "/data/is it?/b.glb"),
            ("cull", "cull"),
        ] {
            assert_eq!(without_secrets(uri), written);
        }
    }
}
