//! Errors at the corners of height tiles: tiles around a corner declare the same, also in other tilesets.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::Value;
use terrane_data_gen::{
    Color, GenArgs, OutputArgs, TileKey, Tiling, Voids, World, WorldArgs, WorldPreset, WorldSet, run,
};

use crate::files::{each_tile, files_below};
use crate::tiffs::{Image, Values, tiff};

/// Level, x and y.
type Key = [u32; 3];

/// A tile as a tileset describes it: its geometric error, and those at its corners.
struct Described {
    error_m: f64,
    corners_m: [f64; 4],
}

fn key_of(tile: &Value) -> Option<Key> {
    let content = tile.get("content").unwrap_or(&tile["contents"][0]);
    let name = content["uri"].as_str().filter(|uri| !uri.ends_with(".json"))?;
    let numbers: Vec<u32> = name.split(['/', '.']).filter_map(|part| part.parse().ok()).collect();
    Some(numbers.try_into().unwrap())
}

fn numbers<const N: usize>(list: &Value) -> [f64; N] {
    let numbers: Vec<f64> = list.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect();
    numbers.try_into().unwrap()
}

/// Checks all tilesets of a set. Returns the number of tiles, and that of external tilesets.
fn check(set: &Path, is_round: bool) -> (usize, usize) {
    let mut tiles: BTreeMap<Key, Described> = BTreeMap::new();
    let mut roots = Vec::new();
    let is_tileset = |name: &str| name.ends_with("json") && !name.starts_with('.');
    for (_, bytes) in files_below(set).into_iter().filter(|(name, _)| is_tileset(name)) {
        let tileset: Value = serde_json::from_slice(&bytes).unwrap();
        if let Some(above) = tileset.pointer("/asset/extras/terrane/above_errors_m") {
            let above: Vec<[f64; 4]> = above.as_array().unwrap().iter().map(numbers).collect();
            roots.push((key_of(&tileset["root"]).unwrap(), above));
        }
        each_tile(&tileset["root"], None, &mut |tile, _| {
            let Some(key) = key_of(tile) else { return };
            let corners_m = numbers(&tile["extras"]["terrane"]["corner_errors_m"]);
            let described = Described { error_m: tile["geometricError"].as_f64().unwrap(), corners_m };
            assert!(tiles.insert(key, described).is_none(), "{key:?} is in two tilesets");
        });
    }
    for (&[level, x, y], tile) in &tiles {
        let side = 1u32 << level;
        for (corner, [east, north]) in [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().enumerate() {
            let mut largest = 0.0f64;
            for [dx, dy] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                let (east_of, Some(ay)) = (x + east + side - dx, (y + north).checked_sub(dy)) else { continue };
                let is_inside = (side..2 * side).contains(&east_of);
                let around = tiles.get(&[level, east_of % side, ay]).filter(|_| is_inside || is_round);
                largest = largest.max(around.map_or(0.0, |tile| tile.error_m));
            }
            let declared = tile.corners_m[corner];
            assert!(
                (largest..largest + 0.001_01).contains(&declared),
                "{level}/{x}/{y} {corner}: {declared} {largest}"
            );
        }
        // Nowhere is the error of the level above less than 1.25 times as large.
        if let Some(above) = level.checked_sub(1).and_then(|up| tiles.get(&[up, x / 2, y / 2])) {
            assert!(above.error_m >= 1.249 * tile.error_m, "{level}/{x}/{y}");
        }
    }
    for ([level, x, y], above) in &roots {
        assert_eq!(above.len(), (*level as usize).min(6));
        for (up, errors_m) in (1..).zip(above) {
            let coarser = &tiles[&[level - up, x >> up, y >> up]].corners_m;
            let [low, high] = [f64::min, f64::max].map(|pick| coarser.iter().copied().reduce(pick).unwrap());
            assert!(errors_m.iter().all(|error_m| (low..=high).contains(error_m)), "{errors_m:?} {coarser:?}");
            // The corners at which both meet.
            for (corner, [east, north]) in [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().enumerate() {
                let is_common =
                    |at: u32, end: u32| (at + end).is_multiple_of(1 << up) && (at + end) >> up == (at >> up) + end;
                if is_common(*x, east) && is_common(*y, north) {
                    assert_eq!(errors_m[corner], coarser[corner], "{level}/{x}/{y} {up} {corner}");
                }
            }
        }
    }
    (tiles.len(), roots.len())
}

/// Writes a rough file of elevation.
fn elevation(folder: &Path, name: &str, [west, north]: [f64; 2], side: u16, roughness: f32) -> std::path::PathBuf {
    let height = |k: u32| ((k * 31 % 97) as f32 * roughness + (k / u32::from(side)) as f32).to_le_bytes();
    let heights = (0..u32::from(side).pow(2)).flat_map(height).collect();
    let image = Image::new([side; 2], 32, 1, heights).with(339, Values::Short(vec![3])).at([west, north], [1e-4; 2]);
    let path = folder.join(name);
    fs::write(&path, tiff(vec![image])).unwrap();
    path
}

/// The file in the middle lies across the corner of four blocks of the finest layer.
#[test]
fn tiles_of_several_blocks_agree_at_their_corners() {
    let folder = tempfile::tempdir().unwrap();
    let dem = vec![
        elevation(folder.path(), "a.tif", [7.0, 46.0], 40, 1.0),
        elevation(folder.path(), "b.tif", [7.4, 46.4], 40, 0.1),
        elevation(folder.path(), "c.tif", [7.19, 46.21], 200, 0.5),
    ];
    let args = GenArgs {
        dem,
        levels: Some(7),
        color: Color::None,
        voids: Voids::Cut,
        jobs: Some(2),
        ..GenArgs::new(folder.path().join("set"))
    };
    let summary = run(&args).unwrap();
    let (tiles, external) = check(&args.out, false);
    assert_eq!(tiles as u64, summary.tiles);
    assert_eq!(external, 6, "a block at each corner, and four around the middle");
}

#[test]
fn tiles_of_worlds_agree_at_their_corners_also_around_the_globe() {
    let folder = tempfile::tempdir().unwrap();
    for globe in [false, true] {
        let args = GenArgs {
            world: WorldArgs { world: Some(WorldPreset::Alps), globe, ..WorldArgs::default() },
            size: 20_000.0,
            levels: Some(4),
            color: Color::None,
            ..GenArgs::new(folder.path().join(format!("globe-{globe}")))
        };
        run(&args).unwrap();
        assert_eq!(check(&args.out, globe), (85, 64));
    }
}

/// The table of a subtree has the same numbers as explicit tilesets.
#[test]
fn subtrees_have_the_errors_at_corners() {
    let folder = tempfile::tempdir().unwrap();
    let corners = |tiling: Tiling, name: &str| {
        let args = GenArgs {
            world: WorldArgs { world: Some(WorldPreset::Canyon), ..WorldArgs::default() },
            size: 20_000.0,
            levels: Some(3),
            color: Color::None,
            output: OutputArgs { tiling, ..OutputArgs::default() },
            ..GenArgs::new(folder.path().join(name))
        };
        run(&args).unwrap();
        args.out
    };
    let explicit: Value =
        serde_json::from_slice(&fs::read(corners(Tiling::Explicit, "a").join("tileset.json")).unwrap()).unwrap();
    let mut expected = Vec::new();
    each_tile(&explicit["root"], None, &mut |tile, _| {
        expected.extend(numbers::<4>(&tile["extras"]["terrane"]["corner_errors_m"]).map(|error_m| error_m as f32));
    });
    let bytes = fs::read(corners(Tiling::Implicit, "b").join("subtrees/0/0/0.subtree")).unwrap();
    let mut found = corners_of_subtree(&bytes);
    assert_eq!(found.len(), 4 * 21);
    // The orders of tiles differ.
    found.sort_by(f32::total_cmp);
    expected.sort_by(f32::total_cmp);
    assert_eq!(found, expected);
}

/// Returns the errors at the corners of the tiles of a subtree.
fn corners_of_subtree(bytes: &[u8]) -> Vec<f32> {
    let length = u64::from_le_bytes(bytes[8..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[24..24 + length]).unwrap();
    let view = json["propertyTables"][0]["properties"]["cornerErrors"]["values"].as_u64().unwrap() as usize;
    let number = |name: &str| json["bufferViews"][view][name].as_u64().unwrap() as usize;
    let values = &bytes[24 + length..][number("byteOffset")..][..number("byteLength")];
    values.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

/// Tilesets and subtrees that a server computes alone have the same bytes, whichever is asked for first.
#[test]
fn tilesets_that_are_computed_alone_agree_at_their_corners() {
    let folder = tempfile::tempdir().unwrap();
    let set = |levels: u32| WorldSet::globe(World::new(WorldPreset::Alps, 3), levels);
    let (first, second) = (set(4), set(4));
    let roots: Vec<TileKey> =
        std::iter::once(TileKey::ROOT).chain((0..64).map(|k| TileKey { level: 3, x: k % 8, y: k / 8 })).collect();
    let texts: Vec<String> = roots.iter().map(|root| first.tileset(*root).unwrap()).collect();
    for (root, text) in roots.iter().zip(&texts).rev() {
        assert!(second.tileset(*root).as_ref() == Some(text), "{root:?}");
        let path = folder.path().join(first.tileset_path(*root).unwrap());
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    assert_eq!(check(folder.path(), true), (85, 64));
    let mut expected = Vec::new();
    for text in &texts {
        let json: Value = serde_json::from_str(text).unwrap();
        each_tile(&json["root"], None, &mut |tile, _| {
            let corners_m = &tile["extras"]["terrane"]["corner_errors_m"];
            if corners_m.is_array() {
                expected.extend(numbers::<4>(corners_m).map(|error_m| error_m as f32));
            }
        });
    }
    let mut found = corners_of_subtree(&set(4).subtree(TileKey::ROOT).unwrap().1);
    found.sort_by(f32::total_cmp);
    expected.sort_by(f32::total_cmp);
    assert_eq!(found, expected);
    // Neighbours far below the root, on both sides of an edge of coarse tiles.
    let set = set(22);
    let mut corners: BTreeMap<Key, f64> = BTreeMap::new();
    for x in [131_071, 131_072] {
        let json: Value = serde_json::from_str(&set.tileset(TileKey { level: 18, x, y: 180_224 }).unwrap()).unwrap();
        each_tile(&json["root"], None, &mut |tile, _| {
            let Some([level, x, y]) = key_of(tile) else { return };
            let own = numbers::<4>(&tile["extras"]["terrane"]["corner_errors_m"]);
            for ([east, north], error_m) in [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().zip(own) {
                let known = *corners.entry([level, x + east, y + north]).or_insert(error_m);
                assert_eq!(known, error_m, "{level}/{x}/{y}");
            }
        });
    }
}
