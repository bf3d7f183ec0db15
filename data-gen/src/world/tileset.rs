//! Describes the tiles of a world as 3D Tiles JSON: one tileset for each subtree of three levels, so that each can be written
//! without the others.

use serde_json::{Value, json};

use super::tiles::WorldSet;
use crate::TileKey;
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
        let errors_m = self.level_errors_m();
        let root_error_m = errors_m[key.level as usize];
        let extras = json!({ "terrane": {
            "format": 1, "content": "height", "layout": "wgs84", "side": CELLS + 1, "border": 1,
            "quantum_m": QUANTUM_M, "level": key.level, "level_errors_m": errors_m,
        } });
        let mut root = self.tile_json(key, key.level + LEVELS_PER_TILESET, up);
        root["refine"] = "REPLACE".into();
        let tileset = json!({
            "asset": { "version": "1.1", "generator": "terrane", "extras": extras },
            "geometricError": 2.0 * root_error_m,
            "root": root,
        });
        Some(tileset.to_string())
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
        let heights = json!({ "uri": format!("{name}.exr") });
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
