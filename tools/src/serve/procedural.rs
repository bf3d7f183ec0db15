//! A planet that is made while it is served: tilesets and tiles are computed when they are requested. Called on the threads
//! of connections.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use terrane_data_gen::{GenArgs, GenError, TileKey, Tiling, World, WorldPreset, WorldSet, WorldTile};

use super::args::ServeArgs;

/// The number of levels of a served planet. Cells of the finest level are about 0.15 m high and 0.3 m wide.
const LEVELS: u32 = 22;
/// The number of tiles that are kept: clients request the image soon after the heights.
const KEPT: usize = 64;

/// A planet, and the tiles that were made last.
pub(super) struct Procedural {
    set: WorldSet,
    tiling: Tiling,
    /// Written and read by the threads of connections.
    kept: Mutex<VecDeque<(TileKey, Arc<WorldTile>)>>,
}

impl Procedural {
    pub(super) fn new(preset: WorldPreset, args: &ServeArgs) -> Self {
        let form = GenArgs { content: args.content, ..GenArgs::new("") };
        let set = WorldSet::globe(World::on(preset, args.seed, args.ellipsoid()), LEVELS).with_form_of(&form);
        let set = if args.scatter { set.with_scatter() } else { set };
        if set.has_meshes() {
            // Meshes depend on them. Measured here, they delay the start of the server instead of the first answer.
            set.level_errors_m();
        }
        Self { set, tiling: args.tiling, kept: Mutex::default() }
    }

    /// Returns the bytes of a file by its path relative to the folder of the set. `None` if the set does not have it.
    pub(super) fn file(&self, path: &str) -> Option<Result<Vec<u8>, GenError>> {
        let is_implicit = self.tiling == Tiling::Implicit;
        if path == "tileset.json" && is_implicit {
            return Some(Ok(self.set.implicit_tileset().into_bytes()));
        }
        if path == "tileset.json" {
            return self.set.tileset(TileKey { level: 0, x: 0, y: 0 }).map(|text| Ok(text.into_bytes()));
        }
        let subtree = path.strip_prefix("subtrees/").filter(|_| is_implicit);
        let (stem, extension) = subtree.unwrap_or(path).split_once('.')?;
        if (extension == "subtree") != subtree.is_some() {
            return None;
        }
        let [level, x, y] = stem.split('/').collect::<Vec<_>>().try_into().ok()?;
        let number = |text: &str| text.parse::<u32>().ok().filter(|number| number.to_string() == text);
        let key = TileKey { level: number(level)?, x: number(x)?, y: number(y)? };
        if !self.set.contains(key) {
            return None;
        }
        match extension {
            "subtree" => self.set.subtree(key).map(|(_, bytes)| Ok(bytes)),
            "json" if key.level > 0 && !is_implicit => self.set.tileset(key).map(|text| Ok(text.into_bytes())),
            _ if !self.set.has_file(key, extension) => None,
            _ => Some(self.tile(key).map(|tile| tile.file(extension).unwrap_or_default().to_vec())),
        }
    }

    /// Returns a tile that is kept, or makes it. Two threads may make the same tile, which has the same bytes.
    fn tile(&self, key: TileKey) -> Result<Arc<WorldTile>, GenError> {
        let kept = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, tile)) = kept().iter().find(|(of, _)| *of == key) {
            return Ok(tile.clone());
        }
        let tile = Arc::new(self.set.tile(key)?);
        let mut kept = kept();
        if kept.len() == KEPT {
            kept.pop_front();
        }
        kept.push_back((key, tile.clone()));
        Ok(tile)
    }
}
