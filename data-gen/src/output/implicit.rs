//! Describes a set by implicit tiling: subtree files with availability, and each tile's error and heights as metadata, so that
//! volumes and errors are those of an explicit set.
//!
//! Blocks leave a list of their tiles in the journal. Subtrees begin at other levels than blocks, so each is put together from
//! the lists of several blocks.

use std::cell::RefCell;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;

use lru::LruCache;
use serde_json::{Value, json};

use super::corner_errors::{CornerErrors, TileErrors};
use super::journal::Journal;
use super::set_files::write_whole;
use crate::GenError;
use crate::pyramid::{Plan, TileKey};

/// Levels of a subtree file.
pub(crate) const SUBTREE_LEVELS: u32 = 5;
/// The lists of blocks in memory: more than the blocks that a subtree has tiles of.
const MAX_LISTS: usize = 2048;
/// The template of subtree files.
pub(crate) const SUBTREES: &str = "subtrees/{level}/{x}/{y}.subtree";

/// A tile with data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Entry {
    pub key: TileKey,
    /// Bit n is set if the tile has the content n of the set.
    pub contents: u32,
    pub geometric_error_m: f64,
    /// The lowest and the highest height of its volume in metres.
    pub heights_m: [f64; 2],
    /// The errors at its corners, which height tiles have. Lists of blocks lack them.
    pub corner_errors_m: Option<CornerErrors>,
}

/// Returns the list of a block as text.
pub(super) fn list(entries: &[Entry]) -> String {
    let row = |e: &Entry| {
        let [error, low, high] = [e.geometric_error_m, e.heights_m[0], e.heights_m[1]].map(f64::to_bits);
        json!([e.key.level, e.key.x, e.key.y, e.contents, error, low, high])
    };
    Value::from(entries.iter().map(row).collect::<Vec<_>>()).to_string()
}

/// Reads the text of [`list`], ordered by key; `None` if it is not one.
fn entries(text: &str) -> Option<Vec<Entry>> {
    let rows: Vec<[u64; 7]> = serde_json::from_str(text).ok()?;
    let mut entries = rows
        .into_iter()
        .map(|[level, x, y, contents, error, low, high]| {
            let [level, x, y, contents] = [level, x, y, contents].map(|c| u32::try_from(c).ok());
            let [geometric_error_m, low_m, high_m] = [error, low, high].map(f64::from_bits);
            let key = TileKey { level: level?, x: x?, y: y? };
            let heights_m = [low_m, high_m];
            Some(Entry { key, contents: contents?, geometric_error_m, heights_m, corner_errors_m: None })
        })
        .collect::<Option<Vec<_>>>()?;
    entries.sort_by_key(|entry| entry.key);
    Some(entries)
}

/// Writes the subtree files of a set.
pub(super) struct Subtrees<'a> {
    plan: &'a Plan,
    journal: &'a Journal,
    folder: &'a Path,
    levels: u32,
    /// The number of contents that a tile may have.
    contents: usize,
    /// Whether a set of height tiles goes around the globe; `None` for other sets.
    is_round: Option<bool>,
    /// The tiles of the root's block.
    root: Arc<Vec<Entry>>,
    lists: RefCell<LruCache<TileKey, Arc<Vec<Entry>>>>,
}

impl<'a> Subtrees<'a> {
    pub fn new(
        plan: &'a Plan,
        journal: &'a Journal,
        folder: &'a Path,
        (levels, contents): (u32, usize),
        is_round: Option<bool>,
        mut root: Vec<Entry>,
    ) -> Self {
        root.sort_by_key(|entry| entry.key);
        let capacity = NonZeroUsize::new(MAX_LISTS).unwrap_or(NonZeroUsize::MIN);
        let lists = RefCell::new(LruCache::new(capacity));
        Self { plan, journal, folder, levels, contents, is_round, root: Arc::new(root), lists }
    }

    /// Writes the file of a subtree and those below it, and returns their size in bytes.
    pub fn write(&self, root: TileKey) -> Result<u64, GenError> {
        let last = SUBTREE_LEVELS.min(self.levels - root.level);
        let mut tiles = Vec::new();
        for level in 0..SUBTREE_LEVELS {
            for key in descendants(root, level) {
                tiles.push(if level < last { self.described(key)? } else { None });
            }
        }
        let mut children = Vec::new();
        for child in descendants(root, SUBTREE_LEVELS) {
            let is_there = child.level < self.levels && self.entry(child)?.is_some();
            children.push(is_there.then_some(child));
        }
        let has_child: Vec<bool> = children.iter().map(Option::is_some).collect();
        let bytes = subtree(&tiles, &has_child, self.contents);
        let path = self.folder.join(subtree_name(root));
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(GenError::file(folder))?;
        }
        let mut written = write_whole(&path, &bytes)?;
        for child in children.into_iter().flatten() {
            written += self.write(child)?;
        }
        Ok(written)
    }

    /// Returns a tile with the errors at its corners, if it has data.
    fn described(&self, key: TileKey) -> Result<Option<Entry>, GenError> {
        let Some(entry) = self.entry(key)? else { return Ok(None) };
        let Some(is_round) = self.is_round else { return Ok(Some(entry)) };
        let error_m = |key| Ok(self.entry(key)?.map_or(0.0, |entry| entry.geometric_error_m));
        let corner_errors_m = TileErrors { error_m, first_level: 0, is_round }.corners(key)?;
        Ok(Some(Entry { corner_errors_m: Some(corner_errors_m), ..entry }))
    }

    /// Returns a tile, if it has data.
    fn entry(&self, key: TileKey) -> Result<Option<Entry>, GenError> {
        let Some(block) = self.plan.block_of(key) else { return Ok(None) };
        let list = self.list_of(block)?;
        Ok(list.binary_search_by_key(&key, |entry| entry.key).ok().map(|at| list[at]))
    }

    fn list_of(&self, block: TileKey) -> Result<Arc<Vec<Entry>>, GenError> {
        if block.level == 0 {
            return Ok(self.root.clone());
        }
        if let Some(known) = self.lists.borrow_mut().get(&block) {
            return Ok(known.clone());
        }
        // Blocks without data were not made, or have an empty list.
        let list = match self.journal.load(block)? {
            None => Vec::new(),
            Some(record) => {
                let text = record.tree;
                let reason = || GenError::invalid(self.folder, format!("the journal of block {block:?} is damaged"));
                if text.is_empty() { Vec::new() } else { entries(&text).ok_or_else(reason)? }
            }
        };
        let list = Arc::new(list);
        self.lists.borrow_mut().put(block, list.clone());
        Ok(list)
    }
}

/// Returns the name of a subtree file.
pub(crate) fn subtree_name(root: TileKey) -> String {
    format!("subtrees/{}/{}/{}.subtree", root.level, root.x, root.y)
}

/// Returns the tiles that are some levels below another one, in Morton order.
pub(crate) fn descendants(root: TileKey, level: u32) -> impl Iterator<Item = TileKey> {
    (0..1u64 << (2 * level)).map(move |morton| below(root, level, morton))
}

/// Returns the tile below another one with a Morton index among those of its level.
fn below(root: TileKey, level: u32, morton: u64) -> TileKey {
    let bits = |first: u32| (0..level).map(|bit| ((morton >> (2 * bit + first)) as u32 & 1) << bit).sum::<u32>();
    TileKey { level: root.level + level, x: (root.x << level) + bits(0), y: (root.y << level) + bits(1) }
}

/// Returns the bytes of a subtree file, from its tiles level by level in Morton order, and its child subtrees.
pub(crate) fn subtree(tiles: &[Option<Entry>], children: &[bool], contents: usize) -> Vec<u8> {
    let (mut binary, mut views) = (Vec::<u8>::new(), Vec::<Value>::new());
    let mut view = |bytes: &[u8]| {
        binary.resize(binary.len().next_multiple_of(8), 0);
        views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() }));
        binary.extend_from_slice(bytes);
        views.len() - 1
    };
    let mut availability = |bits: &[bool]| {
        let count = bits.iter().filter(|bit| **bit).count();
        if count == 0 || count == bits.len() {
            return json!({ "constant": u8::from(count > 0) });
        }
        let byte = |bits: &[bool]| bits.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit));
        let bytes: Vec<u8> = bits.chunks(8).map(byte).collect();
        json!({ "bitstream": view(&bytes), "availableCount": count })
    };
    let of_tiles = availability(&tiles.iter().map(Option::is_some).collect::<Vec<_>>());
    let of_contents: Vec<Value> = (0..contents)
        .map(|content| {
            let has = |tile: &Option<Entry>| tile.is_some_and(|entry| entry.contents >> content & 1 == 1);
            availability(&tiles.iter().map(has).collect::<Vec<_>>())
        })
        .collect();
    let of_children = availability(children);
    let there: Vec<&Entry> = tiles.iter().flatten().collect();
    let mut column = |value: fn(&Entry) -> f64| {
        let bytes: Vec<u8> = there.iter().flat_map(|entry| value(entry).to_le_bytes()).collect();
        json!({ "values": view(&bytes) })
    };
    let mut properties = json!({
        "geometricError": column(|entry| entry.geometric_error_m),
        "minimumHeight": column(|entry| entry.heights_m[0]),
        "maximumHeight": column(|entry| entry.heights_m[1]),
    });
    let corners: Vec<f32> =
        there.iter().filter_map(|entry| entry.corner_errors_m).flatten().map(|error_m| error_m as f32).collect();
    if corners.len() == 4 * there.len() {
        let bytes: Vec<u8> = corners.iter().flat_map(|error_m| error_m.to_le_bytes()).collect();
        properties["cornerErrors"] = json!({ "values": view(&bytes) });
    }
    binary.resize(binary.len().next_multiple_of(8), 0);
    let json = json!({
        "buffers": [{ "byteLength": binary.len() }], "bufferViews": views,
        "propertyTables": [{ "class": "tile", "count": there.len(), "properties": properties }], "tileMetadata": 0,
        "tileAvailability": of_tiles, "contentAvailability": of_contents, "childSubtreeAvailability": of_children,
    });
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(8), b' ');
    let mut out = b"subt".to_vec();
    out.extend(1u32.to_le_bytes());
    out.extend((text.len() as u64).to_le_bytes());
    out.extend((binary.len() as u64).to_le_bytes());
    out.extend(text);
    out.extend(binary);
    out
}

/// Returns the class of the tiles' metadata. Height tiles have the errors at their corners.
pub(crate) fn tile_class(has_corners: bool) -> Value {
    let number = |semantic: &str| json!({ "type": "SCALAR", "componentType": "FLOAT64", "semantic": semantic });
    let mut class = json!({ "properties": {
        "geometricError": number("TILE_GEOMETRIC_ERROR"),
        "minimumHeight": number("TILE_MINIMUM_HEIGHT"),
        "maximumHeight": number("TILE_MAXIMUM_HEIGHT"),
    } });
    if has_corners {
        class["properties"]["cornerErrors"] = json!({
            "type": "VEC4", "componentType": "FLOAT32", "semantic": "TERRANE_CORNER_ERRORS",
            "description": "Geometric errors at the corners in metres: south-west, south-east, north-west, north-east",
        });
    }
    class
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_back_and_tiles_are_found_by_morton_index() {
        let key = |level, x, y| TileKey { level, x, y };
        let entry = |key, contents| {
            let heights_m = [-3.7, 1e9 / 7.0];
            Entry { key, contents, geometric_error_m: 0.1, heights_m, corner_errors_m: None }
        };
        let all = vec![entry(key(3, 1, 7), 0), entry(key(2, 0, 3), 1)];
        let read = entries(&list(&all)).unwrap();
        assert_eq!(read, [all[1], all[0]]);
        assert!(entries("[[1,2]]").is_none() && entries("[").is_none());
        assert_eq!(below(key(3, 1, 7), 2, 0b0110), key(5, 4 + 0b10, 28 + 0b01));
    }
}
