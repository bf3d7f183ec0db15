//! Describes the tiles of a world: one tileset of 3D Tiles for each subtree of three levels, so that each can be written without the
//! others, or one tileset with implicit tiling and its subtree files.

use serde_json::{Value, json};

use super::tiles::WorldSet;
use crate::TileKey;
use crate::output::{Entry, SUBTREE_LEVELS, SUBTREES, descendants, subtree, subtree_name, tile_class};
use crate::pyramid::{CELLS, QUANTUM_M};

/// The number of levels in a tileset.
pub(super) const LEVELS_PER_TILESET: u32 = 3;

impl WorldSet {
    /// Returns the path of the tileset whose root is a tile, relative to the folder of the set. `None` if the tile is not
    /// the root of a tileset.
    pub fn tileset_path(&self, key: TileKey) -> Option<String> {
        let is_root = self.contains(key) && key.level.is_multiple_of(LEVELS_PER_TILESET);
        is_root.then(|| match key.level {
            0 => "tileset.json".to_owned(),
            level => format!("{level}/{}/{}.json", key.x, key.y),
        })
    }

    /// Returns the tileset whose root is a tile. `None` if the tile is not the root of a tileset.
    pub fn tileset(&self, key: TileKey) -> Option<String> {
        self.tileset_path(key)?;
        let up = if key.level == 0 { "" } else { "../../" };
        Some(self.tileset_of(key.level, self.tile_json(key, key.level + LEVELS_PER_TILESET, up)).to_string())
    }

    /// Returns the tileset around a root tile of a level.
    fn tileset_of(&self, level: u32, mut root: Value) -> Value {
        let errors_m = self.level_errors_m();
        let extras = json!({ "terrane": {
            "format": 1, "content": "height", "layout": "wgs84", "side": CELLS + 1, "border": 1,
            "quantum_m": QUANTUM_M, "level": level, "level_errors_m": errors_m,
        } });
        root["refine"] = "REPLACE".into();
        json!({
            "asset": { "version": "1.1", "generator": "terrane", "extras": extras },
            "geometricError": 2.0 * errors_m[level as usize],
            "root": root,
        })
    }

    /// Returns the tileset of implicit tiling. The trees and rocks of tiles are a second content.
    pub fn implicit_tileset(&self) -> String {
        let root = TileKey { level: 0, x: 0, y: 0 };
        let e = self.extent(root);
        let [low_m, high_m] = self.bounds_m(root);
        let template = |extension: &str| json!({ "uri": format!("{{level}}/{{x}}/{{y}}.{extension}") });
        let mut tile = json!({
            "boundingVolume": { "region": [e.west, e.south, e.east, e.north, low_m, high_m] },
            "geometricError": self.level_errors_m()[0],
            "implicitTiling": {
                "subdivisionScheme": "QUADTREE", "subtreeLevels": SUBTREE_LEVELS, "availableLevels": self.levels(),
                "subtrees": { "uri": SUBTREES },
            },
            "contents": [template(self.heights_extension())],
            "extras": { "terrane": { "imagery": "{level}/{x}/{y}.jpg" } },
        });
        if self.has_instances() {
            tile["contents"] = json!([template(self.heights_extension()), template("glb")]);
        }
        let mut tileset = self.tileset_of(0, tile);
        tileset["schema"] = json!({ "id": "terrane", "classes": { "tile": tile_class() } });
        tileset.to_string()
    }

    /// Returns the name and the bytes of the subtree file whose root is a tile. `None` if the tile is not the root of one.
    pub fn subtree(&self, root: TileKey) -> Option<(String, Vec<u8>)> {
        if !self.contains(root) || !root.level.is_multiple_of(SUBTREE_LEVELS) {
            return None;
        }
        let errors_m = self.level_errors_m();
        let tiles: Vec<Option<Entry>> = (0..SUBTREE_LEVELS)
            .flat_map(|level| descendants(root, level))
            .map(|key| {
                self.contains(key).then(|| Entry {
                    key,
                    contents: if self.has_scatter(key.level) { 0b11 } else { 0b01 },
                    geometric_error_m: errors_m[key.level as usize],
                    heights_m: self.bounds_m(key),
                })
            })
            .collect();
        let has_child: Vec<bool> = descendants(root, SUBTREE_LEVELS).map(|child| self.contains(child)).collect();
        let contents = if self.has_instances() { 2 } else { 1 };
        Some((subtree_name(root), subtree(&tiles, &has_child, contents)))
    }

    /// Returns a tile and its descendants on the levels before `end`. Their children there are external tilesets.
    fn tile_json(&self, key: TileKey, end: u32, up: &str) -> Value {
        let e = self.extent(key);
        let error_m = self.level_errors_m()[key.level as usize];
        let [low_m, high_m] = self.bounds_m(key);
        let region = [e.west, e.south, e.east, e.north, low_m, high_m];
        let mut tile = json!({ "boundingVolume": { "region": region }, "geometricError": error_m });
        if key.level == end {
            let path = self.tileset_path(key).unwrap_or_default();
            tile["content"] = json!({ "uri": format!("{up}{path}") });
            return tile;
        }
        let name = format!("{up}{}/{}/{}", key.level, key.x, key.y);
        let heights = json!({ "uri": format!("{name}.{}", self.heights_extension()) });
        match self.has_scatter(key.level) {
            true => tile["contents"] = json!([heights, { "uri": format!("{name}.glb") }]),
            false => tile["content"] = heights,
        }
        tile["extras"] = json!({ "terrane": { "imagery": format!("{name}.jpg") } });
        if key.level + 1 < self.levels() {
            let children = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| TileKey {
                level: key.level + 1,
                x: 2 * key.x + dx,
                y: 2 * key.y + dy,
            });
            tile["children"] = children.map(|child| self.tile_json(child, end, up)).to_vec().into();
        }
        tile
    }
}
