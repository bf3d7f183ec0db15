//! The sets that are flown over where none is given: heights, meshes, meshes in tilesets within tilesets, meshes that are
//! only wanted from near, and archives, in a temporary folder.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use terrane_data_gen::{ContentKind, GenArgs};

use super::archive;

/// Every so many levels a tileset of its own begins.
const NESTED_LEVELS: u32 = 2;

/// From this level on tiles have a volume from within which they are wanted: as many of their own sides around them.
const VOLUMES_FROM_LEVEL: u32 = 2;
const VOLUME_SIDES: f64 = 1.5;

/// Metres of a radian on the ground.
const RADIAN_M: f64 = 6.4e6;

/// The sets by seed, and what they come as.
const SETS: [&str; 7] = ["mesh", "height", "mesh/nested.json", "height.3tz", "mesh/volumes.json", "height", "mesh.3tz"];

/// Small sets; their folder goes with them.
pub struct Sets {
    folder: PathBuf,
}

impl Sets {
    pub fn make() -> Result<Self> {
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
        nest(&mesh).context("tilesets within tilesets")?;
        bound(&mesh).context("volumes of requests")?;
        for name in ["height", "mesh"] {
            archive::write(&sets.folder.join(name), &sets.folder.join(format!("{name}.3tz")))?;
        }
        Ok(sets)
    }

    /// The set of a seed.
    pub fn of(&self, seed: u64) -> String {
        self.folder.join(SETS[(seed % SETS.len() as u64) as usize]).display().to_string()
    }
}

impl Drop for Sets {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Writes the set in a folder once more as `nested.json`, its lower levels as tilesets of their own.
fn nest(folder: &Path) -> Result<()> {
    let mut whole: Value = serde_json::from_slice(&std::fs::read(folder.join("tileset.json"))?)?;
    let asset = whole["asset"].clone();
    let mut written = 0;
    let mut root = whole["root"].take();
    nest_below(&mut root, 0, folder, &asset, &mut written)?;
    whole["root"] = root;
    std::fs::write(folder.join("nested.json"), whole.to_string())?;
    Ok(())
}

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

/// Writes the set in a folder once more as `volumes.json`, its lower levels wanted only from near, and the lowest of them
/// added to what is above.
fn bound(folder: &Path) -> Result<()> {
    let mut whole: Value = serde_json::from_slice(&std::fs::read(folder.join("tileset.json"))?)?;
    bound_below(&mut whole["root"], 0)?;
    std::fs::write(folder.join("volumes.json"), whole.to_string())?;
    Ok(())
}

fn bound_below(tile: &mut Value, level: u32) -> Result<()> {
    tile["refine"] = if level > VOLUMES_FROM_LEVEL { "ADD" } else { "REPLACE" }.into();
    if level >= VOLUMES_FROM_LEVEL {
        let of = tile["boundingVolume"]["region"].as_array().context("a region")?;
        let [west, south, east, north, low, high] = numbers(of).context("a region of six numbers")?;
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
