//! Worlds from a seed: tiles that are computed alone, edges, errors, and the files of a set.

use serde_json::Value;
use terrane::fetch::Limits;
use terrane::formats::{Verified, verify};
use terrane::math::{Geodetic, MOON};
use terrane_data_gen::{
    ArchiveFormat, Color, ContentKind, GenArgs, Outcome, OutputArgs, Sharding, TileKey, Tiling, World, WorldArgs,
    WorldPreset, WorldSet, execute, run,
};

use crate::files::{each_tile, files_below, region, tileset};

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
        assert!(file("exr") == tile.file("exr").unwrap() && file("jpg") == tile.file("jpg").unwrap(), "{key:?}");
    }
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
        // Coarser levels have no rivers.
        let (x, y) = (8 << 5, 11 << 5);
        let wide = set.heights_m(tile(9, x, y));
        for (i, j) in [(3, 50), (17, 9), (40, 33), (60, 21)] {
            let narrow = set.heights_m(tile(15, x * 64 + i, y * 64 + j));
            assert_eq!(vertex(&narrow, 0, 0), vertex(&wide, i.into(), j.into()), "{preset:?} {i} {j}");
        }
    }
}

/// Returns the largest distance of the triangles of a tile from the vertices of a level that is `finer` levels finer, in those
/// tiles of it whose numbers `chosen` gives, and the earth's arc above the triangles.
fn error_m(set: &WorldSet, key: TileKey, finer: u32, chosen: [u32; 2]) -> f64 {
    let coarse = set.heights_m(key);
    let step = 1i64 << finer;
    let [x, y] = chosen.map(|k| k % (1 << finer));
    let fine = set.heights_m(tile(key.level + finer, (key.x << finer) + x, (key.y << finer) + y));
    let mut worst = 0.0f32;
    for (row, column) in (0..=64).flat_map(|row| (0..=64).map(move |column| (row, column))) {
        let at = |tile: u32, k: i64| i64::from(tile) * 64 + k;
        let (i, j) = ((at(x, column) / step).min(63), (at(y, row) / step).min(63));
        let share = |k: i64, cell: i64| (k - cell * step) as f32 / step as f32;
        let (u, v) = (share(at(x, column), i), share(at(y, row), j));
        let corner = |di: i64, dj: i64| vertex(&coarse, i + di, j + dj);
        let (sw, ne) = (corner(0, 0), corner(1, 1));
        let surface = match u >= v {
            true => sw + u * (corner(1, 0) - sw) + v * (ne - corner(1, 0)),
            false => sw + v * (corner(0, 1) - sw) + u * (ne - corner(0, 1)),
        };
        worst = worst.max((surface - vertex(&fine, column, row)).abs());
    }
    f64::from(worst)
}

/// Errors are bounds, and bounds that are near what some tiles need.
#[test]
fn errors_of_levels_are_never_less_than_measured_and_not_far_above() {
    for (k, preset) in WorldPreset::ALL.into_iter().enumerate() {
        let set = WorldSet::globe(World::new(preset, 3), 20);
        let errors_m = set.level_errors_m();
        assert!(errors_m.windows(2).all(|pair| pair[0] >= 1.04 * pair[1]), "{errors_m:?}");
        let levels = match k % 2 {
            _ if kit::long_tests() => [0, 1, 4, 7, 10, 12, 15].as_slice(),
            0 => &[0, 10],
            _ => &[1, 15],
        };
        for &level in levels {
            // Flat triangles lie below the arc of the earth.
            let side = 6_371_000.0 * std::f64::consts::PI / f64::from(64u32 << level);
            let bulge_m = (1.0 + 4.0) * side * side / 8.0 / 6_371_000.0;
            let places = [([0.53, 0.71], 2), ([0.514, 0.757], 3)];
            let chosen_ones = [[1, 0], [2, 3]];
            let number = if kit::long_tests() { 2 } else { 1 };
            let mut worst = 0.0f64;
            for (place, finer) in &places[..number] {
                let [x, y] = place.map(|share| (share * f64::from(1u32 << level)) as u32);
                for chosen in chosen_ones.into_iter().take(number) {
                    worst = worst.max(error_m(&set, tile(level, x, y), *finer, chosen));
                }
            }
            let declared_m = errors_m[level as usize];
            assert!(worst + bulge_m <= declared_m, "{preset:?} {level}: {worst} m, {errors_m:?}");
            // The few tiles here are a large part of coarse levels, and a small one of others.
            if level < 2 {
                assert!(declared_m < 3.0 * (worst + bulge_m), "{preset:?} {level}: {worst} m, {errors_m:?}");
            }
        }
    }
}

/// Returns the error that a tileset which is computed alone declares of a tile.
fn declared_m(set: &WorldSet, key: TileKey) -> f64 {
    let up = key.level % 3;
    let json: Value =
        serde_json::from_str(&set.tileset(tile(key.level - up, key.x >> up, key.y >> up)).unwrap()).unwrap();
    let name = format!("{}/{}/{}.exr", key.level, key.x, key.y);
    let mut found = None;
    each_tile(&json["root"], None, &mut |tile, _| {
        if tile["content"]["uri"].as_str().is_some_and(|uri| uri.ends_with(&name)) {
            found = tile["geometricError"].as_f64();
        }
    });
    found.unwrap()
}

/// Each tile of a served planet has a separate error.
#[test]
fn errors_of_served_tiles_are_never_less_than_measured_and_differ() {
    for (k, preset) in WorldPreset::ALL.into_iter().enumerate() {
        let set = WorldSet::globe(World::new(preset, 3), 20);
        let levels = match k % 2 {
            _ if kit::long_tests() => [0, 2, 4, 6, 8, 10, 12, 15].as_slice(),
            0 => &[1, 11],
            _ => &[6],
        };
        for &level in levels {
            let side = 6_371_000.0 * std::f64::consts::PI / f64::from(64u32 << level);
            let bulge_m = (1.0 + 4.0) * side * side / 8.0 / 6_371_000.0;
            let places: &[[f64; 2]] = &[[0.53, 0.71], [0.514, 0.757], [0.21, 0.62], [0.87, 0.44], [0.66, 0.9]];
            for place in &places[..if kit::long_tests() { places.len() } else { 1 }] {
                let [x, y] = place.map(|share| (share * f64::from(1u32 << level)) as u32);
                let key = tile(level, x, y);
                let measured_m = error_m(&set, key, 2, [1, 2]).max(error_m(&set, key, 3, [5, 3])) + bulge_m;
                let declared_m = declared_m(&set, key);
                assert!(measured_m <= declared_m, "{preset:?} {key:?}: {measured_m} m, declared {declared_m} m");
            }
        }
    }
    // The sea is smoother than mountains.
    let set = WorldSet::globe(World::new(WorldPreset::Islands, 3), 20);
    let errors_m: Vec<f64> = (0..12).map(|k| declared_m(&set, tile(9, 42 * k, 10 + 40 * k))).collect();
    let [low_m, high_m] = [f64::min, f64::max].map(|pick| errors_m.iter().copied().reduce(pick).unwrap());
    assert!(low_m < 0.2 * high_m, "{errors_m:?}");
}

/// Regression: rocks at the edge of a height tile lay up to 2 m outside of its volume.
#[test]
fn trees_and_rocks_of_height_tiles_lie_in_their_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let mut args = bare(&folder.path().join("set"), WorldPreset::Moon, 2_000.0, 3);
    args.world.scatter = true;
    run(&args).unwrap();
    let found = verified(&args.out);
    assert!(found.contents > 21, "{found:?}");
    assert_eq!((found.failed, found.problems.len()), (0, 0), "{:?}", found.problems);
    let set = tileset(&args.out);
    each_tile(&set["root"], None, &mut |tile, parent| {
        let own: Vec<f64> =
            tile["extras"]["terrane"]["region"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let volume = region(tile);
        assert!(volume[0] < own[0] && volume[1] < own[1] && volume[2] > own[2] && volume[3] > own[3], "{volume:?}");
        let Some(parent) = parent else { return };
        let outer = region(parent);
        assert!(outer[0] <= volume[0] && outer[1] <= volume[1] && outer[2] >= volume[2] && outer[3] >= volume[3]);
    });
}

/// Coarse levels of small pieces of land are fine enough for their images, however flat the land is.
#[test]
fn errors_of_levels_are_at_least_a_texel() {
    let set = WorldSet::square(World::new(WorldPreset::Islands, 1), [0.1484, 0.2006], 600.0, 5);
    for (level, error_m) in set.level_errors_m().iter().enumerate() {
        let texel_m = 600.0 / f64::from(256u32 << level);
        assert!((0.999 * texel_m..40.0 * texel_m).contains(error_m), "{level}: {error_m} m, texels of {texel_m} m");
    }
}

/// Buffers that tiles of one thread share do not change what is computed.
#[test]
fn tile_does_not_depend_on_those_made_before() {
    for preset in [WorldPreset::Canyon, WorldPreset::Ice, WorldPreset::Islands] {
        let make = || WorldSet::globe(World::new(preset, 3), 16);
        let (x, y) = (8 << 4, 11 << 4);
        let used = make();
        for other in [tile(13, x, y), tile(13, x + 1, y), tile(3, 1, 4)] {
            used.tile(other).unwrap();
        }
        assert!(
            used.tile(tile(13, x + 1, y + 1)).unwrap() == make().tile(tile(13, x + 1, y + 1)).unwrap(),
            "{preset:?}"
        );
    }
}

/// The steps of a tile are reported in order, for measurements.
#[test]
fn steps_of_a_tile_are_reported_in_order() {
    use terrane_data_gen::TileStep::{Colors, Drainage, HeightFile, Heights, Image, Scatter};
    let set = WorldSet::square(World::new(WorldPreset::Alps, 1), [0.14, 0.82], 2_000.0, 3);
    let mut steps = Vec::new();
    let made = set.tile_in_steps(tile(2, 1, 1), &mut |step| steps.push(step)).unwrap();
    assert_eq!(steps, [Drainage, Heights, Colors, Image, HeightFile, Scatter]);
    assert!(made == set.tile(tile(2, 1, 1)).unwrap());
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
    let moon = GenArgs {
        world: WorldArgs { world: Some(WorldPreset::Moon), ..WorldArgs::default() },
        ..GenArgs::new(folder.path().join("out"))
    };
    let merge = GenArgs { sharding: Sharding { merge: true, ..Sharding::default() }, ..moon.clone() };
    assert!(run(&merge).unwrap_err().to_string().contains("no shards"));
    let vesta = OutputArgs { body: Some("286300x278600x223200".parse().unwrap()), ..OutputArgs::default() };
    let wide = GenArgs { output: vesta, size: 300_000.0, ..moon };
    assert!(run(&wide).unwrap_err().to_string().contains("--size"));
    use terrane_data_gen::ContentKind::Height;
    assert!(refused(WorldArgs { globe: true, ..WorldArgs::default() }, Height).contains("--world"));
    assert!(!folder.path().join("out").exists());
}

/// Returns the JSON and the translations of the instances of a glb.
fn instances(glb: &[u8]) -> (Value, Vec<[f64; 3]>) {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let binary = &glb[(28 + length).min(glb.len())..];
    let mut places = Vec::new();
    for node in json["nodes"].as_array().into_iter().flatten() {
        let attributes = &node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
        let Some(index) = attributes["TRANSLATION"].as_u64() else { continue };
        let accessor = &json["accessors"][index as usize];
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap() as usize;
        let bytes = &binary[start..start + 12 * accessor["count"].as_u64().unwrap() as usize];
        let float = |bytes: &[u8]| f64::from(f32::from_le_bytes(bytes.try_into().unwrap()));
        places.extend(bytes.chunks(12).map(|v| [float(&v[..4]), float(&v[4..8]), float(&v[8..])]));
    }
    (json, places)
}

#[test]
fn trees_and_rocks_depend_on_the_biome() {
    let counts = |preset| {
        let world = World::new(preset, 1);
        let center = world.place(40_000.0);
        let set = WorldSet::square(world, center, 40_000.0, 6).with_scatter();
        assert!(!set.has_scatter(3) && set.has_scatter(4) && set.has_scatter(5), "cells of 78 m, 39 m and 20 m");
        let of = |key| set.scatter_counts(key);
        let keys = (0..16).step_by(5).flat_map(|x| (0..16).step_by(5).map(move |y| tile(4, x, y)));
        let [conifers, broadleaf, rocks, shrubs, stones] =
            keys.map(of).fold([0; 5], |a, b| std::array::from_fn(|k| a[k] + b[k]));
        assert_eq!([shrubs, stones], [0; 2], "cells of 39 m are too large for them");
        [conifers, broadleaf, rocks]
    };
    let [conifers, broadleaf, rocks] = counts(WorldPreset::Islands);
    assert!(broadleaf > 3_000 && broadleaf > 20 * conifers && rocks > 0, "{conifers} {broadleaf} {rocks}");
    let [conifers, broadleaf, rocks] = counts(WorldPreset::Alps);
    assert!(conifers > 500 && rocks > 200, "{conifers} {broadleaf} {rocks}");
    for bare in [WorldPreset::Desert, WorldPreset::Moon, WorldPreset::Ice] {
        let [conifers, broadleaf, rocks] = counts(bare);
        assert!(conifers + broadleaf == 0 && rocks > 100, "{bare:?}: {conifers} {broadleaf} {rocks}");
    }
}

/// Fine levels have shrubs where it is green and stones where it is bare.
#[test]
fn shrubs_and_stones_lie_on_fine_levels() {
    let counts = |preset, place: [f64; 2]| {
        let set = WorldSet::square(World::new(preset, 1), place.map(f64::to_radians), 1_600.0, 4).with_scatter();
        let keys = (0..4).flat_map(|x| (0..4).map(move |y| tile(2, x, y)));
        keys.map(|key| set.scatter_counts(key)).fold([0; 5], |a, b| std::array::from_fn(|k| a[k] + b[k]))
    };
    let [_, _, _, shrubs, stones] = counts(WorldPreset::Moon, [8.0, 30.0]);
    assert!(shrubs == 0 && stones > 50, "{shrubs} shrubs, {stones} stones");
    let [longitude, latitude] = World::new(WorldPreset::Islands, 1).place(40_000.0).map(f64::to_degrees);
    let [_, _, _, shrubs, _] = counts(WorldPreset::Islands, [longitude, latitude]);
    assert!(shrubs > 50, "{shrubs} shrubs");
}

#[test]
fn trees_stand_on_the_ground_of_their_tile() {
    use terrane::math::WGS84;
    let world = World::new(WorldPreset::Islands, 1);
    let center = world.place(40_000.0);
    let set = WorldSet::square(world, center, 40_000.0, 6).with_scatter();
    let mut stand = 0;
    for key in [tile(4, 3, 5), tile(4, 4, 5), tile(5, 7, 10), tile(5, 21, 20)] {
        let made = set.tile(key).unwrap();
        let (json, places) = instances(made.file("glb").unwrap());
        assert_eq!(places.len(), set.scatter_counts(key).iter().sum::<usize>());
        let Some(matrix) = json["nodes"][0]["matrix"].as_array() else { continue };
        let m: Vec<f64> = matrix.iter().map(|v| v.as_f64().unwrap()).collect();
        let heights = set.heights_m(key);
        let e = set.extent(key);
        for place in places {
            // glTF has y up: its axes are x, z and -y of the earth.
            let [x, z, minus_y] =
                [0, 1, 2].map(|row| (0..3).map(|c| m[4 * c + row] * place[c]).sum::<f64>() + m[12 + row]);
            let at = WGS84.geodetic([x, -minus_y, z].into());
            let u = (at.longitude - e.west) / (e.east - e.west) * 64.0;
            let v = (at.latitude - e.south) / (e.north - e.south) * 64.0;
            assert!((-1e-3..64.001).contains(&u) && (-1e-3..64.001).contains(&v), "{key:?}: {u} {v}");
            let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(i, j)| {
                f64::from(vertex(&heights, (u.clamp(0.0, 63.99) + i) as i64, (v.clamp(0.0, 63.99) + j) as i64))
            });
            let low = corners.iter().copied().fold(f64::MAX, f64::min) - 0.5;
            let high = corners.iter().copied().fold(f64::MIN, f64::max) + 0.1;
            assert!((low..high).contains(&at.height_m), "{key:?}: {} m, not {low} to {high} m", at.height_m);
            stand += 1;
        }
    }
    assert!(stand > 1_000, "{stand}");
    let json: Value = serde_json::from_str(&set.tileset(tile(3, 1, 2)).unwrap()).unwrap();
    let fine = &json["root"]["children"][0];
    assert_eq!(fine["contents"][1]["uri"], "../../4/2/4.glb");
    assert_eq!(json["root"]["content"]["uri"], "../../3/1/2.exr", "cells of 78 m have none");
}

/// Regression: the bounds of the first levels were those of a level without rivers, with the error of one with canyons.
#[test]
fn bounds_of_small_sets_contain_the_heights() {
    for preset in [WorldPreset::Canyon, WorldPreset::Mars] {
        let world = World::new(preset, 1);
        let set = WorldSet::square(world.clone(), world.place(40_000.0), 40_000.0, 3);
        let tileset: Value = serde_json::from_str(&set.tileset(tile(0, 0, 0)).unwrap()).unwrap();
        let region = tileset["root"]["boundingVolume"]["region"].as_array().unwrap();
        let [low_m, high_m] = [4, 5].map(|k| region[k].as_f64().unwrap());
        for height_m in [tile(0, 0, 0), tile(1, 0, 1), tile(1, 1, 1)].iter().flat_map(|key| set.heights_m(*key)) {
            assert!((low_m..=high_m).contains(&f64::from(height_m)), "{preset:?}: {height_m} m, {low_m} to {high_m}");
        }
    }
}

fn verified(set: &std::path::Path) -> Verified {
    verify(&set.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap()
}

fn bare(out: &std::path::Path, preset: WorldPreset, size: f64, levels: u32) -> GenArgs {
    let world = WorldArgs { world: Some(preset), ..WorldArgs::default() };
    GenArgs { world, size, levels: Some(levels), color: Color::None, ..GenArgs::new(out) }
}

/// Regression: tiles declared the error of their level, estimated from some samples: here 1,128 m where 1,311 m are measured.
#[test]
fn height_tiles_have_measured_errors() {
    let folder = tempfile::tempdir().unwrap();
    let args = GenArgs { seed: 2, ..bare(&folder.path().join("set"), WorldPreset::Islands, 80_000.0, 2) };
    let summary = run(&args).unwrap();
    let found = verified(&args.out);
    assert_eq!((found.contents, found.failed, found.problems.len()), (5, 0, 0), "{:?}", found.problems);
    let set = tileset(&args.out);
    assert!(set["geometricError"].as_f64() > Some(79_000.0), "a client that draws nothing is off by the set");
    let declared = &set["asset"]["extras"]["terrane"]["level_errors_m"];
    assert_eq!(
        declared.as_array().unwrap().iter().map(|e| e.as_f64().unwrap()).collect::<Vec<_>>(),
        summary.level_errors_m
    );
    let mut tiles = 0;
    each_tile(&set["root"], None, &mut |tile, parent| {
        tiles += 1;
        let error_m = |tile: &Value| tile["geometricError"].as_f64().unwrap();
        assert!(error_m(tile) <= summary.level_errors_m[usize::from(parent.is_some())]);
        let Some(parent) = parent else { return };
        assert!(error_m(parent) >= error_m(tile));
        let (own, outer) = (region(tile), region(parent));
        assert!(own[4] >= outer[4] && own[5] <= outer[5], "{own:?} {outer:?}");
    });
    assert_eq!(tiles, 5);
}

#[test]
fn worlds_are_made_of_shards() {
    let folder = tempfile::tempdir().unwrap();
    let kinds = [
        (ContentKind::Height, Tiling::Explicit, None),
        (ContentKind::Mesh, Tiling::Implicit, None),
        (ContentKind::Mesh, Tiling::Explicit, Some(ArchiveFormat::Packed)),
    ];
    for (k, (content, tiling, archive)) in kinds.into_iter().enumerate() {
        let extension = if archive.is_some() { ".terrane" } else { "" };
        let args = |name: &str| {
            let output = OutputArgs { tiling, archive, ..OutputArgs::default() };
            let out = folder.path().join(format!("{name}{k}{extension}"));
            GenArgs { content, output, ..bare(&out, WorldPreset::Alps, 20_000.0, 2) }
        };
        let part = |sharding: Sharding| GenArgs { jobs: Some(1), sharding, ..args("parts") };
        let shard = |text: &str| part(Sharding { shard: Some(text.parse().unwrap()), ..Sharding::default() });
        let merge = part(Sharding { merge: true, ..Sharding::default() });
        let whole = run(&args("whole")).unwrap();
        assert_eq!(run(&shard("2/3")).unwrap().tiles, 1);
        let Ok(Outcome::Plan(plan)) = execute(&part(Sharding { plan: Some(3), ..Sharding::default() })) else {
            panic!("a plan")
        };
        let plan: Value = serde_json::from_str(&plan).unwrap();
        let shards = plan["shards"].as_array().unwrap();
        assert_eq!(
            shards[1],
            serde_json::json!({
                "shard": "2/3", "complete": true, "tilesAtMost": 1, "subtrees": ["1/1/0"],
            })
        );
        assert_eq!(shards[2]["complete"], false, "{plan}");
        let error = run(&merge).unwrap_err().to_string();
        assert!(error.contains("1/3, 3/3; make them with --shard"), "{error}");
        for text in ["1/3", "3/3", "2/3"] {
            run(&shard(text)).unwrap();
        }
        let merged = run(&merge).unwrap();
        assert_eq!((merged.tiles, merged.bytes, &merged.level_errors_m), (5, whole.bytes, &whole.level_errors_m));
        assert_eq!((merged.min_height_m, merged.max_height_m), (whole.min_height_m, whole.max_height_m));
        match archive {
            Some(_) => assert!(std::fs::read(&merged.out).unwrap() == std::fs::read(&whole.out).unwrap()),
            None => assert!(files_below(&merged.out) == files_below(&whole.out)),
        }
        if tiling == Tiling::Implicit {
            // Clients of implicit tilings read one content by this name only.
            assert_eq!(tileset(&merged.out)["root"]["content"]["uri"], "{level}/{x}/{y}.glb");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2 * (k + 1), "two sets of each kind");
    }
}

/// Tilesets name the body, and tiles lie on its ellipsoid with the size that is asked for.
#[test]
fn worlds_lie_on_other_bodies() {
    let folder = tempfile::tempdir().unwrap();
    let output = OutputArgs { body: Some("moon".parse().unwrap()), ..OutputArgs::default() };
    for content in [ContentKind::Height, ContentKind::Mesh] {
        let out = folder.path().join(format!("{content:?}"));
        let mut args = GenArgs { content, output: output.clone(), ..bare(&out, WorldPreset::Moon, 2_000.0, 2) };
        args.world.scatter = content == ContentKind::Mesh;
        args.world.center = Some([8.0, 30.0]);
        run(&args).unwrap();
        let found = verified(&out);
        assert_eq!((found.failed, found.problems.len()), (0, 0), "{:?}", found.problems);
        assert!(found.contents > if content == ContentKind::Mesh { 5 } else { 4 });
        let set = tileset(&out);
        let body = &set["extensions"]["3DTILES_ellipsoid"];
        assert_eq!((&body["body"], &body["radii"][2]), (&"Moon".into(), &1_737_400.0.into()), "{set}");
        assert_eq!(set["extensionsUsed"][0], "3DTILES_ellipsoid");
        let [west, south, east, north, low_m, high_m] = region(&set["root"])[..] else { panic!("a region") };
        let margin = if content == ContentKind::Mesh { 40.0 } else { 6.0 };
        assert!(((north - south) * 1_737_400.0 - 2_000.0).abs() < margin, "{south} {north}");
        assert!(((east - west) * 1_737_400.0 * 30f64.to_radians().cos() - 2_000.0).abs() < margin, "{west} {east}");
        if content == ContentKind::Mesh {
            let glb = std::fs::read(out.join("0/0/0.glb")).unwrap();
            let (json, _) = instances(&glb);
            let matrix = json["nodes"][0]["matrix"].as_array().unwrap();
            let [x, z, minus_y] = [12, 13, 14].map(|k| matrix[k].as_f64().unwrap());
            let Geodetic { longitude, latitude, height_m } = MOON.geodetic([x, -minus_y, z].into());
            assert!((west..east).contains(&longitude) && (south..north).contains(&latitude));
            assert!((low_m..high_m).contains(&height_m), "{height_m} {low_m} {high_m}");
        }
    }
    // Craters are as large as on the earth: the noise has the size of the body.
    let slopes = |set: &WorldSet| {
        let heights_m = set.heights_m(TileKey::ROOT);
        heights_m.windows(2).map(|pair| f64::from((pair[1] - pair[0]).abs())).sum::<f64>()
    };
    let [earth, moon] = [World::new(WorldPreset::Mars, 1), World::on(WorldPreset::Mars, 1, MOON)].map(|world| {
        (0..6).map(|k| slopes(&WorldSet::square(world.clone(), [0.3 * f64::from(k), 0.2], 20_000.0, 1))).sum::<f64>()
    });
    assert!((0.5..2.0).contains(&(moon / earth)), "{moon} {earth}");
}
