//! Worlds from a seed: tiles that are computed alone, edges, errors, and the files of a set.

use serde_json::Value;
use terrane_data_gen::{GenArgs, TileKey, World, WorldArgs, WorldPreset, WorldSet, run};

const SIDE: usize = 67;

fn tile(level: u32, x: u32, y: u32) -> TileKey {
    TileKey { level, x, y }
}

/// Returns a vertex of a tile, counted from the west and from the south.
fn vertex(heights: &[f32], column: i64, row: i64) -> f32 {
    heights[(65 - row) as usize * SIDE + (column + 1) as usize]
}

#[test]
fn tile_computed_alone_has_the_bytes_of_the_set() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let world = WorldArgs { world: Some(WorldPreset::Islands), ..WorldArgs::default() };
    let args = GenArgs { world, seed: 5, size: 40_000.0, levels: Some(3), ..GenArgs::new(&out) };
    let summary = run(&args).unwrap();
    assert_eq!((summary.tiles, summary.levels), (21, 3));
    assert!(summary.min_height_m < summary.max_height_m, "{summary:?}");
    let world = World::new(WorldPreset::Islands, 5);
    let center = world.place(40_000.0);
    let set = WorldSet::square(world, center, 40_000.0, 3);
    for key in [tile(0, 0, 0), tile(1, 1, 0), tile(2, 3, 2)] {
        let tile = set.tile(key).unwrap();
        let file = |end: &str| std::fs::read(out.join(format!("{}/{}/{}.{end}", key.level, key.x, key.y))).unwrap();
        assert!(file("exr") == tile.exr && file("jpg") == tile.jpeg, "{key:?}");
    }
    let written = std::fs::read_to_string(out.join("tileset.json")).unwrap();
    assert_eq!(Some(written), set.tileset(tile(0, 0, 0)));
    let other = WorldSet::square(World::new(WorldPreset::Islands, 6), center, 40_000.0, 3);
    assert!(set.heights_m(tile(1, 0, 0)) != other.heights_m(tile(1, 0, 0)), "another seed makes another world");
}

#[test]
fn edges_of_all_levels_and_across_the_antimeridian_have_equal_bits() {
    for preset in WorldPreset::ALL {
        let set = WorldSet::globe(World::new(preset, 3), 22);
        let (x, y) = (1_234, 2_301);
        let west = set.heights_m(tile(12, x, y));
        let [east, north] = [set.heights_m(tile(12, x + 1, y)), set.heights_m(tile(12, x, y + 1))];
        let finer = set.heights_m(tile(13, 2 * x, 2 * y));
        let (last, first) = (set.heights_m(tile(9, 511, 170)), set.heights_m(tile(9, 0, 170)));
        for k in 0..=64 {
            assert_eq!(vertex(&west, 64, k), vertex(&east, 0, k), "{preset:?}");
            assert_eq!(vertex(&west, 65, k), vertex(&east, 1, k), "{preset:?}: the border is the neighbour's sample");
            assert_eq!(vertex(&west, k, 64), vertex(&north, k, 0), "{preset:?}");
            assert_eq!(vertex(&west, k / 2, k / 4), vertex(&finer, k / 2 * 2, k / 4 * 2), "{preset:?}");
            // The sines of -180 and of 180 degrees differ in their last bits.
            assert!((vertex(&last, 64, k) - vertex(&first, 0, k)).abs() < 0.02, "{preset:?}");
        }
    }
}

/// Parts of the relief are left out where a whole row has none of them.
#[test]
fn height_does_not_depend_on_the_other_positions_of_its_row() {
    for preset in WorldPreset::ALL {
        let set = WorldSet::globe(World::new(preset, 3), 22);
        let wide = set.heights_m(tile(4, 8, 11));
        for (i, j) in [(3, 50), (17, 9), (40, 33), (60, 21)] {
            let narrow = set.heights_m(tile(10, 8 * 64 + i, 11 * 64 + j));
            assert_eq!(vertex(&narrow, 0, 0), vertex(&wide, i.into(), j.into()), "{preset:?} {i} {j}");
        }
    }
}

#[test]
fn errors_are_at_least_those_against_two_finer_levels() {
    for preset in WorldPreset::ALL {
        let set = WorldSet::globe(World::new(preset, 3), 20);
        let errors_m = set.level_errors_m();
        assert!(errors_m.windows(2).all(|pair| pair[0] >= 1.5 * pair[1]), "{errors_m:?}");
        for (level, place) in [(6, [0.53, 0.71]), (11, [0.514, 0.757]), (15, [0.5141, 0.7571])] {
            let at = |share: f64| (share * f64::from(1u32 << level)) as u32;
            let key = tile(level, at(place[0]), at(place[1]));
            let coarse = set.heights_m(key);
            for finer in [1, 2] {
                let fine = set.heights_m(tile(level + finer, key.x << finer, key.y << finer));
                let step = 1i64 << finer;
                for (row, column) in (0..=64).flat_map(|row| (0..=64).map(move |column| (row, column))) {
                    let (i, j) = (column / step, row / step);
                    let share = |k: i64| (k % step) as f32 / step as f32;
                    let (u, v) = (share(column), share(row));
                    let corner = |di: i64, dj: i64| vertex(&coarse, i + di, j + dj);
                    let (sw, ne) = (corner(0, 0), corner(1, 1));
                    let surface = match u >= v {
                        true => sw + u * (corner(1, 0) - sw) + v * (ne - corner(1, 0)),
                        false => sw + v * (corner(0, 1) - sw) + u * (ne - corner(0, 1)),
                    };
                    let error = f64::from((surface - vertex(&fine, column, row)).abs());
                    assert!(error <= errors_m[level as usize], "{preset:?} {key:?}: {error} m, {errors_m:?}");
                }
            }
        }
    }
}

/// Returns all tiles of a JSON tree.
fn tiles(tile: &Value) -> Vec<&Value> {
    let below = tile["children"].as_array().into_iter().flatten().flat_map(tiles);
    std::iter::once(tile).chain(below).collect()
}

#[test]
fn tilesets_refer_to_external_ones_and_contain_their_tiles() {
    let set = WorldSet::globe(World::new(WorldPreset::Alps, 1), 22);
    assert_eq!(set.tileset(tile(1, 0, 0)), None, "not the root of a tileset");
    for key in [tile(0, 0, 0), tile(3, 5, 6), tile(21, 1_100_000, 1_500_000)] {
        let json: Value = serde_json::from_str(&set.tileset(key).unwrap()).unwrap();
        assert_eq!(json["asset"]["extras"]["terrane"]["level"], key.level);
        let tiles = tiles(&json["root"]);
        let external = tiles.iter().filter(|t| t["content"]["uri"].as_str().unwrap().ends_with(".json")).count();
        assert_eq!((tiles.len(), external), if key.level == 21 { (1, 0) } else { (85, 64) });
        let heights = set.heights_m(key);
        let region: Vec<f64> =
            json["root"]["boundingVolume"]["region"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!(heights.iter().all(|h| (region[4]..=region[5]).contains(&f64::from(*h))), "{key:?}");
    }
}

#[test]
fn options_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |world: WorldArgs, content| {
        run(&GenArgs { world, content, ..GenArgs::new(folder.path().join("out")) }).unwrap_err().to_string()
    };
    use terrane_data_gen::ContentKind::{Height, Mesh};
    let world = Some(WorldPreset::Moon);
    assert!(refused(WorldArgs { world, ..WorldArgs::default() }, Mesh).contains("--content mesh"));
    assert!(refused(WorldArgs { globe: true, ..WorldArgs::default() }, Height).contains("--world"));
    assert!(!folder.path().join("out").exists());
}
