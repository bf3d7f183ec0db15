//! The sets that are flown over by default, in a temporary folder: heights, meshes, nested tilesets, tiles with request
//! volumes, and archives.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use terrane_data_gen::{ContentKind, GenArgs};

use super::archive_writer;

/// The number of levels in each nested tileset.
const NESTED_LEVELS: u32 = 2;

/// The first level whose tiles have a request volume.
const VOLUMES_FROM_LEVEL: u32 = 2;
/// The size of a request volume beyond its tile, in sides of the tile.
const VOLUME_SIDES: f64 = 1.5;

/// The length of a radian on the ground in metres.
const RADIAN_M: f64 = 6.4e6;

/// The set of each seed, modulo their count, as folder, tileset or archive.
const SETS: [&str; 7] = ["mesh", "height", "mesh/nested.json", "height.3tz", "mesh/volumes.json", "height", "mesh.3tz"];

/// Small sets. Dropping them removes their folder.
pub struct TileSets {
    folder: PathBuf,
}

impl TileSets {
    /// Generates the sets.
    pub fn generate() -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("terrane-stress-sets-{}", std::process::id()));
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        let sets = Self { folder };
        for (name, content) in [("height", ContentKind::Height), ("mesh", ContentKind::Mesh)] {
            let out = sets.folder.join(name);
            terrane_data_gen::run(&GenArgs {
                content,
                levels: Some(5),
                size: 40_000.0,
                overwrite: true,
                ..GenArgs::new(out)
            })?;
        }
        let mesh = sets.folder.join("mesh");
        write_nested(&mesh).context("nested tilesets")?;
        write_with_volumes(&mesh).context("request volumes")?;
        for name in ["height", "mesh"] {
            archive_writer::write(&sets.folder.join(name), &sets.folder.join(format!("{name}.3tz")))?;
        }
        Ok(sets)
    }

    /// Returns the path of the set for a seed.
    pub fn of(&self, seed: u64) -> String {
        self.folder.join(SETS[(seed % SETS.len() as u64) as usize]).display().to_string()
    }
}

impl Drop for TileSets {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Writes a copy of the tileset as `nested.json`, with its lower levels as nested tilesets.
fn write_nested(folder: &Path) -> Result<()> {
    let mut whole: Value = serde_json::from_slice(&std::fs::read(folder.join("tileset.json"))?)?;
    let asset = whole["asset"].clone();
    let mut written = 0;
    let mut root = whole["root"].take();
    nest_below(&mut root, 0, folder, &asset, &mut written)?;
    whole["root"] = root;
    std::fs::write(folder.join("nested.json"), whole.to_string())?;
    Ok(())
}

/// Moves the levels below a tile to nested tilesets.
fn nest_below(tile: &mut Value, level: u32, folder: &Path, asset: &Value, written: &mut u32) -> Result<()> {
    let Some(children) = tile.get_mut("children").and_then(Value::as_array_mut) else { return Ok(()) };
    for child in children {
        nest_below(child, level + 1, folder, asset, written)?;
        let has_children = child["children"].as_array().is_some_and(|c| !c.is_empty());
        if (level + 1).is_multiple_of(NESTED_LEVELS) && has_children {
            let name = format!("nested-{written}.json");
            *written += 1;
            let (error, volume) = (child["geometricError"].clone(), child["boundingVolume"].clone());
            let outer = json!({ "boundingVolume": volume, "geometricError": error, "content": { "uri": name } });
            let mut inner = std::mem::replace(child, outer);
            inner["refine"] = "REPLACE".into();
            let set = json!({ "asset": asset, "geometricError": error, "root": inner });
            std::fs::write(folder.join(&name), set.to_string())?;
        }
    }
    Ok(())
}

/// Writes a copy of the tileset as `volumes.json`. Its lower levels have request volumes, and the lowest of them are added
/// to their parents instead of replacing them.
fn write_with_volumes(folder: &Path) -> Result<()> {
    let mut whole: Value = serde_json::from_slice(&std::fs::read(folder.join("tileset.json"))?)?;
    bound_below(&mut whole["root"], 0)?;
    std::fs::write(folder.join("volumes.json"), whole.to_string())?;
    Ok(())
}

/// Adds request volumes to a tile and the tiles below it.
fn bound_below(tile: &mut Value, level: u32) -> Result<()> {
    tile["refine"] = if level > VOLUMES_FROM_LEVEL { "ADD" } else { "REPLACE" }.into();
    if level >= VOLUMES_FROM_LEVEL {
        let region = tile["boundingVolume"]["region"].as_array().context("no region")?;
        let [west, south, east, north, low, high] = numbers(region).context("a region without six numbers")?;
        let (across, along) = (VOLUME_SIDES * (east - west), VOLUME_SIDES * (north - south));
        let up_m = RADIAN_M * across.max(along);
        tile["viewerRequestVolume"] = json!({
            "region": [west - across, south - along, east + across, north + along, low - up_m, high + up_m]
        });
    }
    for child in tile.get_mut("children").and_then(Value::as_array_mut).into_iter().flatten() {
        bound_below(child, level + 1)?;
    }
    Ok(())
}

fn numbers(values: &[Value]) -> Option<[f64; 6]> {
    let numbers: Option<Vec<f64>> = values.iter().map(Value::as_f64).collect();
    numbers?.try_into().ok()
}
