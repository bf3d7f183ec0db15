//! Entries of the index: what is known of each file of a set.

use crate::pyramid::TileKey;

/// The bytes of an entry.
pub(super) const ENTRY_BYTES: usize = 40;
/// The finest level that a key has room for.
const MAX_LEVEL: u32 = 25;

/// The kind of a file; the number is its code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Kind {
    Tileset = 0,
    Heights = 1,
    Glb = 3,
    Json = 4,
    Jpeg = 5,
    Png = 6,
    Webp = 7,
    Subtree = 8,
    /// The trees and rocks of a mesh.
    Scatter = 9,
}

impl Kind {
    /// Returns the kind of the files of tiles with an extension.
    pub fn of_extension(extension: &str) -> Option<Self> {
        Some(match extension {
            "heights" => Self::Heights,
            "glb" => Self::Glb,
            "json" => Self::Json,
            "jpg" => Self::Jpeg,
            "png" => Self::Png,
            "webp" => Self::Webp,
            "subtree" => Self::Subtree,
            "scatter.glb" => Self::Scatter,
            _ => return None,
        })
    }
}

/// A file of a set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Entry {
    /// Sorts by level, place on the Morton curve, and kind.
    pub key: u64,
    pub offset: u64,
    pub size: u32,
    pub checksum: u32,
    /// The geometric error of the tile in metres; 0 for files that are no content.
    pub error_m: f64,
    /// The lowest and the highest height of the tile in metres, skirts excluded; 0 as well.
    pub range_m: [f32; 2],
}

/// Returns the key of a file of a tile.
pub(super) fn key_of(tile: TileKey, kind: Kind) -> u64 {
    u64::from(tile.level) << 59 | tile.morton() << 8 | kind as u64
}

/// Returns the level of a key.
pub(super) fn level_of(key: u64) -> u32 {
    (key >> 59) as u32
}

/// Returns the key of a file by its name in the folder of a set; `None` if it has no place in a packed set.
pub(super) fn key_of_name(name: &str) -> Option<u64> {
    if name == "tileset.json" {
        return Some(Kind::Tileset as u64);
    }
    let path = name.strip_prefix("subtrees/").unwrap_or(name);
    let (stem, extension) = path.rsplit_once('.')?;
    let kind = Kind::of_extension(extension).filter(|kind| (*kind == Kind::Subtree) == (path != name))?;
    let mut numbers = stem.split('/').map(|number| number.parse::<u32>().ok());
    let [level, x, y] = [numbers.next()??, numbers.next()??, numbers.next()??];
    (numbers.next().is_none() && level <= MAX_LEVEL).then(|| key_of(TileKey { level, x, y }, kind))
}

impl Entry {
    pub fn to_bytes(self) -> [u8; ENTRY_BYTES] {
        let mut out = [0; ENTRY_BYTES];
        let mut at = 0;
        let mut put = |bytes: &[u8]| {
            out[at..at + bytes.len()].copy_from_slice(bytes);
            at += bytes.len();
        };
        put(&self.key.to_le_bytes());
        put(&self.offset.to_le_bytes());
        put(&self.size.to_le_bytes());
        put(&self.checksum.to_le_bytes());
        put(&self.error_m.to_le_bytes());
        self.range_m.iter().for_each(|height_m| put(&height_m.to_le_bytes()));
        out
    }

    pub fn from_bytes(bytes: &[u8; ENTRY_BYTES]) -> Self {
        let (words, _) = bytes.as_chunks::<4>();
        let word = |at: usize| u32::from_le_bytes(words[at]);
        let long = |at: usize| u64::from(word(at)) | u64::from(word(at + 1)) << 32;
        Self {
            key: long(0),
            offset: long(2),
            size: word(4),
            checksum: word(5),
            error_m: f64::from_bits(long(6)),
            range_m: [8, 9].map(|at| f32::from_bits(word(at))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_read_back_and_names_have_keys() {
        let entry = Entry { key: 1 << 60, offset: 1 << 33, size: 7, checksum: 9, error_m: 0.3, range_m: [-2.5, 8e3] };
        assert_eq!(Entry::from_bytes(&entry.to_bytes()), entry);
        let key = |level: u64, morton: u64, kind: u64| Some(level << 59 | morton << 8 | kind);
        for (name, expected) in [
            ("tileset.json", Some(0)),
            ("0/0/0.heights", key(0, 0, 1)),
            ("2/1/3.glb", key(2, 0b1011, 3)),
            ("3/7/0.json", key(3, 0b010101, 4)),
            ("subtrees/5/0/1.subtree", key(5, 2, 8)),
            ("subtrees/5/0/1.json", None),
            ("1/0/0.exr", None),
            ("layer.json", None),
        ] {
            assert_eq!(key_of_name(name), expected, "{name}");
        }
    }
}
