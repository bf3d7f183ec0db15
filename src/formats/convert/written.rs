//! Counts the contents of a set that was written, level by level, as its files list them.

use std::path::Path;

use serde_json::Value;

use super::report::ConvertError;

/// Returns the number of contents on each level of the set in a folder. The level of a content is the number of contents
/// above it.
pub(super) fn levels_of(folder: &Path) -> Result<Vec<u64>, ConvertError> {
    let mut levels = Vec::new();
    let mut files = vec![("tileset.json".to_owned(), 0)];
    while let Some((name, level)) = files.pop() {
        let path = folder.join(&name);
        let failed = |reason| ConvertError::Write { path: path.clone(), reason };
        let bytes = std::fs::read(&path).map_err(failed)?;
        let tileset: Value = serde_json::from_slice(&bytes).map_err(|error| failed(error.into()))?;
        let above = name.rfind('/').map_or("", |end| &name[..=end]);
        let mut tiles = vec![(&tileset["root"], level)];
        while let Some((tile, mut level)) = tiles.pop() {
            let uri = tile["content"]["uri"].as_str();
            if let Some(external) = uri.filter(|uri| uri.ends_with(".json")) {
                files.push((format!("{above}{external}"), level));
            } else if uri.is_some() {
                if levels.len() <= level {
                    levels.resize(level + 1, 0);
                }
                levels[level] += 1;
                level += 1;
            }
            tiles.extend(tile["children"].as_array().into_iter().flatten().map(|child| (child, level)));
        }
    }
    Ok(levels)
}
