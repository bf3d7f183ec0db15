//! The sets that are flown over where none is given: heights, meshes, and meshes in tilesets within tilesets, in a
//! temporary folder.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use terrane_data_gen::{ContentKind, GenArgs};

/// Every so many levels a tileset of its own begins.
const NESTED_LEVELS: u32 = 2;

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
        nest(&sets.folder.join("mesh")).context("tilesets within tilesets")?;
        Ok(sets)
    }

    /// The set of a seed.
    pub fn of(&self, seed: u64) -> String {
        let name = ["mesh", "height", "height", "mesh/nested.json"][(seed % 4) as usize];
        self.folder.join(name).display().to_string()
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
