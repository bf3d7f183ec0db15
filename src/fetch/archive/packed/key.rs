//! Keys of files: level, index on the Morton curve, and kind, in one number that sorts by them in this order.

/// The finest level.
const MAX_LEVEL: u32 = 25;
/// The kinds of files by the ends of their names; the code of a kind is its place.
const KINDS: [&str; 10] = ["tileset", "heights", "exr", "glb", "json", "jpg", "png", "webp", "subtree", "scatter.glb"];

/// Returns the key of a file by its name inside the set: `tileset.json`, `LEVEL/X/Y.KIND` or `subtrees/LEVEL/X/Y.subtree`.
/// Returns `None` for other names, which no packed set has.
pub(in crate::fetch::archive) fn key_of(name: &str) -> Option<u64> {
    if name == "tileset.json" {
        return Some(0);
    }
    let (is_subtree, path) = match name.strip_prefix("subtrees/") {
        Some(path) => (true, path),
        None => (false, name),
    };
    let mut parts = path.split('/');
    let (level, x, last) = (parts.next()?, parts.next()?, parts.next()?);
    let (y, extension) = last.split_once('.')?;
    let kind = KINDS.iter().position(|kind| *kind == extension).filter(|kind| *kind > 0)?;
    let number = |text: &str| {
        // One name for each key: no sign and no leading zero.
        let is_plain = text.bytes().all(|b| b.is_ascii_digit()) && (text.len() == 1 || !text.starts_with('0'));
        is_plain.then(|| text.parse::<u32>().ok())?
    };
    let (level, x, y) = (number(level)?, number(x)?, number(y)?);
    let is_there = level <= MAX_LEVEL && x < 1 << level && y < 1 << level;
    (is_there && is_subtree == (extension == "subtree") && parts.next().is_none())
        .then(|| u64::from(level) << 59 | morton(x, y) << 8 | kind as u64)
}

/// Returns the index on the Morton curve: the bits of the column and of the row in turns, beginning with the column's lowest.
fn morton(x: u32, y: u32) -> u64 {
    let spread = |c: u32| (0..MAX_LEVEL).fold(0u64, |bits, k| bits | u64::from(c >> k & 1) << (2 * k));
    spread(x) | spread(y) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_file_has_one_name() {
        let key = |level: u64, morton: u64, kind: u64| Some(level << 59 | morton << 8 | kind);
        for (name, expected) in [
            ("tileset.json", Some(0)),
            ("0/0/0.heights", key(0, 0, 1)),
            ("1/1/0.exr", key(1, 1, 2)),
            ("2/1/3.glb", key(2, 0b1011, 3)),
            ("3/7/0.json", key(3, 0b010101, 4)),
            ("25/33554431/33554431.webp", key(25, (1 << 50) - 1, 7)),
            ("subtrees/5/0/1.subtree", key(5, 2, 8)),
            ("2/1/3.scatter.glb", key(2, 0b1011, 9)),
            ("26/0/0.heights", None),
            ("1/2/0.heights", None),
            ("1/0/0.tileset", None),
            ("1/0/0.subtree", None),
            ("subtrees/1/0/0.json", None),
            ("1/00/0.heights", None),
            ("1/+1/0.heights", None),
            ("1/0/0", None),
            ("1/0/0.heights/", None),
            ("1/0/0.heights.gz", None),
            ("1//0.heights", None),
            ("a.heights", None),
            ("", None),
        ] {
            assert_eq!(key_of(name), expected, "{name}");
        }
    }
}
