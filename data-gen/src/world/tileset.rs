//! Describes the tiles of a world: one tileset of 3D Tiles for each subtree of three levels, so that each can be written
//! without the others, or one tileset with implicit tiling and its subtree files.

use std::f64::consts::PI;

use serde_json::{Value, json};

use super::form::Described;
use super::points::sin_cos;
use super::scatter::WIDEST_M;
use super::tiles::WorldSet;
use crate::output::{
    CornerErrors, Entry, SUBTREE_LEVELS, SUBTREES, TileErrors, descendants, is_round, subtree, subtree_name,
    tile_class, undrawn_error_m,
};
use crate::pyramid::{CELLS, QUANTUM_M};
use crate::{Extent, GenError, TileKey, body};

/// The number of levels in a tileset.
pub(super) const LEVELS_PER_TILESET: u32 = 3;

/// Returns the error of a tile in metres.
type ErrorOf<'a> = dyn Fn(TileKey) -> Result<f64, GenError> + Sync + 'a;

/// The values that tilesets declare.
pub(super) struct Descriptions<'a> {
    /// Describes a tile.
    pub of: &'a (dyn Fn(TileKey) -> Described + Sync),
    /// The errors of levels in metres, root first. Readers refine and morph height tiles by them that have no errors of their
    /// own.
    pub level_errors_m: &'a [f64],
    /// The errors of height tiles; `None` if those of the tiles around a tile are not known.
    pub errors: Option<TileErrors<&'a ErrorOf<'a>>>,
}

impl Descriptions<'_> {
    /// Returns the errors at the corners of a height tile, if they are known.
    fn corner_errors_m(&self, key: TileKey) -> Option<CornerErrors> {
        self.errors.as_ref()?.corners(key).ok()
    }
}

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

    /// Calls with the descriptions of tiles that are computed alone, which need the errors of some tiles. Tiles of the level `end`
    /// stand for external tilesets, and have a bound of the errors there.
    fn alone<R>(&self, needed: &[TileKey], end: u32, call: impl FnOnce(&Descriptions<'_>) -> R) -> R {
        let of = |key: TileKey| match key.level == end && !self.has_meshes() {
            true => Described { geometric_error_m: self.bound_m(key), heights_m: self.bounds_m(key) },
            false => self.expected(key),
        };
        if self.has_meshes() {
            return call(&Descriptions { of: &of, level_errors_m: self.level_errors_m(), errors: None });
        }
        self.estimate(needed);
        let error_m = |key: TileKey| Ok(self.estimated_error_m(key));
        let is_round = is_round(&self.extent(TileKey::ROOT));
        let errors = TileErrors { error_m: &error_m as &ErrorOf<'_>, first_level: 0, is_round };
        call(&Descriptions { of: &of, level_errors_m: &self.level_bounds_m(), errors: Some(errors) })
    }

    /// Returns the tiles of some levels at and below a tile, and those next to them.
    fn around(&self, root: TileKey, levels: u32) -> Vec<TileKey> {
        let is_round = is_round(&self.extent(TileKey::ROOT));
        let of_level = |down: u32| {
            let (level, count) = (root.level + down, 1i64 << down);
            let side = 1i64 << level;
            let beside = move |first: u32| (i64::from(first) << down) - 1..=(i64::from(first) << down) + count;
            let keys = beside(root.y).flat_map(move |y| beside(root.x).map(move |x| (x, y)));
            let keys = keys.map(move |(x, y)| (if is_round { x.rem_euclid(side) } else { x }, y));
            let keys = keys.filter(move |(x, y)| (0..side).contains(x) && (0..side).contains(y));
            keys.map(move |(x, y)| TileKey { level, x: x as u32, y: y as u32 })
        };
        (0..levels).flat_map(of_level).filter(|key| self.contains(*key)).collect()
    }

    /// Returns the tileset whose root is a tile. `None` if the tile is not the root of a tileset. It is computed alone: its
    /// errors are estimates, and its volumes wider than in the tilesets that a run writes, which measures all tiles.
    pub fn tileset(&self, key: TileKey) -> Option<String> {
        self.tileset_path(key)?;
        let (needed, end) = (self.around(key, LEVELS_PER_TILESET), key.level + LEVELS_PER_TILESET);
        self.alone(&needed, end, |described| self.tileset_by(key, described))
    }

    /// Like [`Self::tileset`], with descriptions of the tiles.
    pub(super) fn tileset_by(&self, key: TileKey, described: &Descriptions<'_>) -> Option<String> {
        self.tileset_path(key)?;
        let up = if key.level == 0 { "" } else { "../../" };
        let root = self.tile_json(key, key.level + LEVELS_PER_TILESET, up, described);
        Some(self.tileset_of(key, root, described).to_string())
    }

    /// Returns the tileset around a root tile.
    fn tileset_of(&self, key: TileKey, mut root: Value, described: &Descriptions<'_>) -> Value {
        let (level, errors_m) = (key.level, described.level_errors_m);
        let mut asset = json!({ "version": "1.1", "generator": "terrane" });
        if self.form.mesh.is_none() {
            asset["extras"] = json!({ "terrane": {
                "format": 1, "content": "height", "layout": "wgs84", "side": CELLS + 1, "border": 1,
                "quantum_m": QUANTUM_M, "level": level, "level_errors_m": errors_m,
            } });
            if let Some(Ok(above)) = described.errors.as_ref().filter(|_| level > 0).map(|errors| errors.above(key)) {
                asset["extras"]["terrane"]["above_errors_m"] = json!(above);
            }
        }
        let error_m = root["geometricError"].as_f64().unwrap_or_default();
        root["refine"] = "REPLACE".into();
        let mut set_error_m = 2.0 * error_m;
        if level == 0 {
            set_error_m = set_error_m.max(undrawn_error_m(&self.world().ellipsoid, &self.extent(TileKey::ROOT)));
        }
        let mut tileset = json!({ "asset": asset, "geometricError": set_error_m, "root": root });
        body::declare(&self.world().ellipsoid, &mut tileset);
        tileset
    }

    /// Returns the tileset of implicit tiling. The trees and rocks of tiles are a second content. It is computed alone, as
    /// [`Self::tileset`].
    pub fn implicit_tileset(&self) -> String {
        self.alone(&[], u32::MAX, |described| self.implicit_tileset_by(described))
    }

    /// Like [`Self::implicit_tileset`], with descriptions of the tiles.
    pub(super) fn implicit_tileset_by(&self, described: &Descriptions<'_>) -> String {
        let Described { geometric_error_m, heights_m: [low_m, high_m] } = (described.of)(TileKey::ROOT);
        let template = |extension: &str| format!("{{level}}/{{x}}/{{y}}.{extension}");
        let content = |extension: &str| json!({ "uri": template(extension) });
        let mut tile = json!({
            "boundingVolume": { "region": self.region(TileKey::ROOT, [low_m, high_m], 0.0) },
            "geometricError": geometric_error_m,
            "implicitTiling": {
                "subdivisionScheme": "QUADTREE", "subtreeLevels": SUBTREE_LEVELS, "availableLevels": self.levels(),
                "subtrees": { "uri": SUBTREES },
            },
        });
        if let Some(imagery) = self.form.imagery() {
            tile["extras"] = json!({ "terrane": { "imagery": template(imagery) } });
        }
        // Some clients read `contents` of several only.
        match self.has_instances() {
            true => tile["contents"] = json!([content(self.form.surface()), content(self.form.scatter())]),
            false => tile["content"] = content(self.form.surface()),
        }
        let mut tileset = self.tileset_of(TileKey::ROOT, tile, described);
        tileset["schema"] = json!({ "id": "terrane", "classes": { "tile": tile_class(described.errors.is_some()) } });
        tileset.to_string()
    }

    /// Returns the region of a tile, wider by some metres on all sides: west, south, east and north in radians, lowest and
    /// highest height in metres.
    fn region(&self, key: TileKey, [low_m, high_m]: [f64; 2], margin_m: f64) -> [f64; 6] {
        let e = self.extent(key);
        let dy = margin_m / self.world().radius_m();
        let dx = dy / sin_cos(e.south.abs().max(e.north.abs())).1.max(0.01);
        [
            (e.west - dx).max(-PI).min(e.west),
            (e.south - dy).max(-0.5 * PI),
            (e.east + dx).min(PI).max(e.east),
            (e.north + dy).min(0.5 * PI),
            low_m,
            high_m,
        ]
    }

    /// Returns the name and the bytes of the subtree file whose root is a tile. `None` if the tile is not the root of one. It
    /// is computed alone, as [`Self::tileset`].
    pub fn subtree(&self, root: TileKey) -> Option<(String, Vec<u8>)> {
        let is_root = self.contains(root) && root.level.is_multiple_of(SUBTREE_LEVELS);
        is_root.then(|| {
            self.alone(&self.around(root, SUBTREE_LEVELS), u32::MAX, |described| self.subtree_by(root, described))
        })?
    }

    /// Like [`Self::subtree`], with descriptions of the tiles.
    pub(super) fn subtree_by(&self, root: TileKey, described: &Descriptions<'_>) -> Option<(String, Vec<u8>)> {
        if !self.contains(root) || !root.level.is_multiple_of(SUBTREE_LEVELS) {
            return None;
        }
        let entry = |key: TileKey| {
            let Described { geometric_error_m, heights_m } = (described.of)(key);
            let contents = if self.has_scatter(key.level) { 0b11 } else { 0b01 };
            Entry { key, contents, geometric_error_m, heights_m, corner_errors_m: described.corner_errors_m(key) }
        };
        let tiles: Vec<Option<Entry>> = (0..SUBTREE_LEVELS)
            .flat_map(|level| descendants(root, level))
            .map(|key| self.contains(key).then(|| entry(key)))
            .collect();
        let has_child: Vec<bool> = descendants(root, SUBTREE_LEVELS).map(|child| self.contains(child)).collect();
        let contents = if self.has_instances() { 2 } else { 1 };
        Some((subtree_name(root), subtree(&tiles, &has_child, contents)))
    }

    /// Returns a tile and its descendants on the levels before `end`. Their children there are external tilesets.
    fn tile_json(&self, key: TileKey, end: u32, up: &str, described: &Descriptions<'_>) -> Value {
        let Described { geometric_error_m, heights_m } = (described.of)(key);
        // Trees and rocks at an edge reach over it.
        let margin_m = if self.has_instances() { WIDEST_M } else { 0.0 };
        let region = self.region(key, heights_m, margin_m);
        let mut tile = json!({ "boundingVolume": { "region": region }, "geometricError": geometric_error_m });
        if key.level == end {
            let path = self.tileset_path(key).unwrap_or_default();
            tile["content"] = json!({ "uri": format!("{up}{path}") });
            return tile;
        }
        let name = format!("{up}{}/{}/{}", key.level, key.x, key.y);
        let content = |extension: &str| json!({ "uri": format!("{name}.{extension}") });
        match self.has_scatter(key.level) {
            true => tile["contents"] = json!([content(self.form.surface()), content(self.form.scatter())]),
            false => tile["content"] = content(self.form.surface()),
        }
        if let Some(imagery) = self.form.imagery() {
            tile["extras"] = json!({ "terrane": { "imagery": format!("{name}.{imagery}") } });
        }
        if margin_m > 0.0 && !self.has_meshes() {
            // Height tiles are placed by their regions, unless they name another one.
            let Extent { west, south, east, north } = self.extent(key);
            tile["extras"]["terrane"]["region"] = json!([west, south, east, north]);
        }
        if let Some(corner_errors_m) = described.corner_errors_m(key) {
            tile["extras"]["terrane"]["corner_errors_m"] = json!(corner_errors_m);
        }
        if key.level + 1 < self.levels() {
            let children = key.children().map(|child| self.tile_json(child, end, up, described));
            tile["children"] = children.to_vec().into();
        }
        tile
    }
}
