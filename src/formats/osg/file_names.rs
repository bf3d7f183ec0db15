//! Names of files as OpenSceneGraph writes them. Decode threads.

/// Returns the name of a file as a part of a URI.
pub(super) fn escaped(name: &str) -> String {
    let mut text = String::with_capacity(name.len());
    for c in name.chars() {
        match c {
            '\\' => text.push('/'),
            '%' => text.push_str("%25"),
            '#' => text.push_str("%23"),
            '?' => text.push_str("%3F"),
            c => text.push(c),
        }
    }
    text
}
