//! layer.json: the description of a terrain set, with the ranges of tiles of each level.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::METADATA_LEVELS;
use crate::pyramid::TileKey;
use crate::{Extent, GenArgs};

/// Returns the text of layer.json. `extent` is the rectangle of the source, `tiles` are the tiles of each level. With
/// `has_water` these have masks of water.
pub(super) fn layer_json(args: &GenArgs, extent: &Extent, tiles: &[Vec<TileKey>], has_water: bool) -> String {
    let wrapped = |longitude: f64| if longitude > 180.0 { longitude - 360.0 } else { longitude };
    let [west, east] = [extent.west, extent.east].map(f64::to_degrees).map(wrapped);
    let bounds = [west, extent.south.to_degrees(), east, extent.north.to_degrees()];
    let mut extensions = vec!["octvertexnormals"];
    extensions.extend(has_water.then_some("watermask"));
    extensions.extend(args.output.tile_availability.then_some("metadata"));
    let mut layer = json!({
        "tilejson": "2.1.0", "version": "1.0.0", "name": "terrain", "format": "quantized-mesh-1.0", "scheme": "tms",
        "projection": "EPSG:4326", "tiles": ["{z}/{x}/{y}.terrain"], "bounds": bounds,
        "minzoom": 0, "maxzoom": tiles.len().saturating_sub(1), "extensions": extensions,
        "available": tiles.iter().map(|keys| ranges(keys)).collect::<Vec<_>>(),
    });
    if args.output.tile_availability {
        layer["metadataAvailability"] = METADATA_LEVELS.into();
        layer["available"] = tiles.iter().take(1).map(|keys| ranges(keys)).collect();
    }
    if let Some(text) = &args.output.attribution {
        layer["attribution"] = text.as_str().into();
    }
    layer.to_string()
}

/// Returns the JSON of a tile's metadata: the tiles of the levels below it.
pub(super) fn metadata_json(below: &[Vec<TileKey>]) -> String {
    json!({ "available": below.iter().map(|keys| ranges(keys)).collect::<Vec<_>>() }).to_string()
}

/// Returns rectangles of columns and rows that contain each tile of a level once.
fn ranges(keys: &[TileKey]) -> Vec<Value> {
    let mut places: Vec<[u32; 2]> = keys.iter().map(|key| [key.y, key.x]).collect();
    places.sort_unstable();
    // The first row of each open rectangle by its columns. It is open while each row has exactly this run of columns.
    let mut open: BTreeMap<[u32; 2], u32> = BTreeMap::new();
    let mut done: Vec<[u32; 4]> = Vec::new();
    let mut last_row = None;
    for row in places.chunk_by(|a, b| a[0] == b[0]) {
        let y = row[0][0];
        let runs: Vec<[u32; 2]> =
            row.chunk_by(|a, b| a[1] + 1 == b[1]).map(|run| [run[0][1], run[run.len() - 1][1]]).collect();
        let follows = last_row.is_some_and(|last| last + 1 == y);
        open.retain(|columns, first| {
            let stays = follows && runs.contains(columns);
            if !stays {
                done.push([*first, columns[0], columns[1], last_row.unwrap_or(y)]);
            }
            stays
        });
        for run in runs {
            open.entry(run).or_insert(y);
        }
        last_row = Some(y);
    }
    done.extend(open.into_iter().map(|(columns, first)| [first, columns[0], columns[1], last_row.unwrap_or(first)]));
    done.sort_unstable();
    let range =
        |[first, west, east, last]: [u32; 4]| json!({ "startX": west, "startY": first, "endX": east, "endY": last });
    done.into_iter().map(range).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_contain_each_tile_once() {
        let picture = ["##.##", "##.##", ".....", "#####", "#.###", "#.###"];
        let keys: Vec<TileKey> = (0..6u32)
            .flat_map(|y| (0..5u32).map(move |x| TileKey { level: 4, x, y }))
            .filter(|key| picture[key.y as usize].as_bytes()[key.x as usize] == b'#')
            .collect();
        let found = ranges(&keys);
        assert_eq!(found.len(), 5);
        let number = |range: &Value, name: &str| range[name].as_u64().unwrap() as u32;
        let mut covered: Vec<TileKey> = Vec::new();
        for range in &found {
            for y in number(range, "startY")..=number(range, "endY") {
                covered.extend((number(range, "startX")..=number(range, "endX")).map(|x| TileKey { level: 4, x, y }));
            }
        }
        covered.sort();
        let mut keys = keys;
        keys.sort();
        assert_eq!(covered, keys);
        assert!(ranges(&[]).is_empty());
    }
}
