//! `--update`: changed, added and removed sources. The bytes are always those of a fresh run.

use std::fs;
use std::path::{Path, PathBuf};

use crate::files::{MANIFEST, files_below};
use crate::tiffs::{Image, Values, tiff};
use terrane_data_gen::{Color, ContentKind, GenArgs, OutputArgs, RunArgs, TileArgs, run};

/// The size of a pixel in degrees: 10 seconds.
const PIXEL: f64 = 1.0 / 360.0;

/// Writes a square of hills with a north-western corner in degrees and a side in pixels.
pub fn hills(folder: &Path, name: &str, corner: [f64; 2], side: u32, seed: u32) -> PathBuf {
    hills_of(folder, name, corner, [PIXEL; 2], side, seed)
}

/// Like [`hills`], with a size of pixels in degrees.
fn hills_of(folder: &Path, name: &str, [west, north]: [f64; 2], pixel: [f64; 2], side: u32, seed: u32) -> PathBuf {
    let height = |k: u32| {
        let (x, y) = (f64::from(k % side), f64::from(k / side));
        let wave = f64::from(seed) * 3.0;
        (500.0 + 80.0 * (x / 5.0 + wave).sin() * (y / 7.0).cos() + f64::from(k * (seed + 2) % 11)) as f32
    };
    let bytes = (0..side * side).flat_map(|k| height(k).to_le_bytes()).collect();
    let image = Image::new([side as u16; 2], 32, 1, bytes).with(339, Values::Short(vec![3])).at([west, north], pixel);
    let path = folder.join(name);
    fs::write(&path, tiff(vec![image])).unwrap();
    path
}

fn args(dem: &[&PathBuf], out: PathBuf, aligned: bool) -> GenArgs {
    let run = RunArgs { aligned, ..RunArgs::default() };
    GenArgs { dem: dem.iter().copied().cloned().collect(), color: Color::None, run, jobs: Some(2), ..GenArgs::new(out) }
}

/// Updates a set, makes a fresh one, and compares them. Returns the note of the update.
fn check(update: &GenArgs) -> String {
    let run_args = RunArgs { update: true, ..update.run.clone() };
    let made = run(&GenArgs { run: run_args, ..update.clone() }).unwrap();
    let fresh = GenArgs { out: update.out.with_file_name("fresh"), overwrite: true, ..update.clone() };
    let expected = run(&fresh).unwrap();
    let [own, other] = [&update.out, &fresh.out].map(|out| files_below(out));
    let names = |files: &std::collections::BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&own), names(&other));
    let different: Vec<&String> =
        own.iter().filter(|(name, bytes)| other[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(different.is_empty(), "{different:?}");
    let [own, other] = [&update.out, &fresh.out].map(|out| fs::read(out.join(MANIFEST)).unwrap());
    assert!(own == other, "the manifests differ");
    assert_eq!(
        (made.tiles, made.bytes, made.level_errors_m),
        (expected.tiles, expected.bytes, expected.level_errors_m)
    );
    made.notes[0].clone()
}

/// Returns the numbers of blocks that were kept and made.
fn counts(note: &str) -> [u32; 2] {
    let [kept, made, _] = all_counts(note);
    [kept, made]
}

/// Returns the same, and the number of tiles of the blocks that were made whose files were kept.
fn all_counts(note: &str) -> [u32; 3] {
    let numbers: Vec<u32> = note.split(' ').filter_map(|word| word.parse().ok()).collect();
    let [kept, _, made, tiles] = numbers.try_into().unwrap_or_else(|_| panic!("{note}"));
    [kept, made, tiles]
}

/// Sets of seven levels have 16 blocks of the finest layer; files in the corners and in the middle touch a few of them.
#[test]
fn changed_source_makes_only_the_blocks_that_it_touches_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], seed: u32| hills(folder.path(), name, corner, 8, seed);
    let south_west = at("a.tif", [7.0, 46.0], 1);
    let north_east = at("b.tif", [7.4, 46.4], 2);
    let middle = at("c.tif", [7.2, 46.2], 3);
    let set = |dem: &[&PathBuf]| GenArgs { levels: Some(7), ..args(dem, folder.path().join("set"), false) };
    let all = set(&[&south_west, &north_east, &middle]);
    run(&all).unwrap();
    let [kept, made] = counts(&check(&all));
    assert!(kept > 4 && made == 1, "nothing has changed: {kept} {made}");
    at("c.tif", [7.2, 46.2], 4);
    // Gaps continue all heights of a set, so that blocks beside them are made as well.
    let [_, made] = counts(&check(&all));
    assert!(made >= 2, "{made}");
    // The first file wins where files overlap.
    let other = at("d.tif", [7.205, 46.195], 5);
    check(&set(&[&other, &south_west, &north_east, &middle]));
    // Other options keep nothing, and the result is right; the number of levels does not matter.
    let coarse = |dem: &[&PathBuf]| GenArgs { levels: Some(4), out: folder.path().join("coarse"), ..set(dem) };
    run(&coarse(&[&south_west, &north_east, &middle])).unwrap();
    let stepped = TileArgs { height_step: Some(0.5), ..TileArgs::default() };
    let options = GenArgs { tiles: stepped.clone(), ..coarse(&[&south_west, &north_east, &middle]) };
    assert!(check(&options).contains("options"), "other options");
    let wider = at("e.tif", [7.6, 46.4], 6);
    let note = check(&GenArgs { tiles: stepped, ..coarse(&[&south_west, &north_east, &wider]) });
    assert!(note.contains("bounds") && note.contains("--aligned"), "{note}");
}

#[test]
fn aligned_set_grows_beyond_its_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], seed: u32| hills(folder.path(), name, corner, 40, seed);
    let first = at("a.tif", [7.0, 46.0], 1);
    let east = at("b.tif", [18.0, 46.3], 2);
    let far = at("c.tif", [-3.0, 51.0], 3);
    let set = |dem: &[&PathBuf]| args(dem, folder.path().join("set"), true);
    let summary = run(&set(&[&first])).unwrap();
    assert!(summary.min_height_m > 400.0 && summary.max_height_m < 600.0, "{summary:?}");
    // The root has no content, so that it has to be refined at any distance.
    let root = crate::files::tileset(&folder.path().join("set"))["root"].clone();
    assert!(root["content"].is_null() && root["geometricError"].as_f64() > Some(1e7), "{root}");
    for dem in [vec![&first, &east], vec![&first, &east, &far], vec![&far, &first]] {
        let [kept, made] = counts(&check(&set(&dem)));
        assert!(kept > 0 && made > 0, "{dem:?}: {kept} {made}");
    }
    // A changed file leaves the blocks of the other.
    at("a.tif", [7.0, 46.0], 4);
    let [kept, made] = counts(&check(&set(&[&far, &first])));
    assert!(kept > 0 && made > 0, "{kept} {made}");
}

/// Regression: all blocks were made again if the largest pixel of the sources was another one, although the finest one decides the
/// levels.
#[test]
fn aligned_set_grows_by_sources_of_other_resolutions() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], scale: [f64; 2], seed: u32| {
        hills_of(folder.path(), name, corner, scale.map(|scale| scale * PIXEL), 24, seed)
    };
    let fine = at("a.tif", [7.0, 46.0], [1.0; 2], 1);
    let coarse = at("b.tif", [18.0, 46.3], [2.7, 2.1], 2);
    let set = |dem: &[&PathBuf]| args(dem, folder.path().join("set"), true);
    run(&set(&[&fine])).unwrap();
    let [kept, made] = counts(&check(&set(&[&fine, &coarse])));
    assert!(kept > 0 && made > 0, "{kept} {made}");
    let [kept, _] = counts(&check(&set(&[&fine])));
    assert!(kept > 0, "the coarse source is removed");
}

#[test]
fn natural_colours_are_kept_in_aligned_sets() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], seed: u32| hills(folder.path(), name, corner, 12, seed);
    let (first, second) = (at("a.tif", [7.0, 46.0], 1), at("b.tif", [20.0, 46.3], 2));
    let set = |dem: &[&PathBuf]| GenArgs { color: Color::Natural, ..args(dem, folder.path().join("set"), true) };
    run(&set(&[&first])).unwrap();
    let [kept, made] = counts(&check(&set(&[&first, &second])));
    assert!(kept > 0 && made > 0, "{kept} {made}");
}

#[test]
fn update_without_a_set_makes_one() {
    let folder = tempfile::tempdir().unwrap();
    let dem = hills(folder.path(), "a.tif", [7.0, 46.0], 8, 1);
    let mut args = args(&[&dem], folder.path().join("set"), false);
    args.run.update = true;
    let first = run(&args).unwrap();
    assert!(args.out.join("tileset.json").is_file());
    // A set of one block keeps its tiles if nothing has changed.
    let second = run(&args).unwrap();
    assert_eq!(all_counts(&second.notes[0]), [0, 1, first.tiles as u32]);
    assert_eq!(second.tiles, first.tiles);
    fs::remove_file(args.out.join("manifest.zip")).unwrap();
    let third = run(&args).unwrap();
    assert!(third.notes[0].contains("no manifest") && third.tiles == first.tiles, "{:?}", third.notes);
}

/// Files are compressed when the set is complete. Those that are kept are not compressed twice.
#[test]
fn compressed_set_is_updated() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], seed: u32| hills(folder.path(), name, corner, 8, seed);
    let (south_west, north_east) = (at("a.tif", [7.0, 46.0], 1), at("b.tif", [7.4, 46.4], 2));
    let set = |dem: &[&PathBuf]| {
        let output = OutputArgs { gzip: true, ..OutputArgs::default() };
        let args = args(dem, folder.path().join("set"), false);
        GenArgs { levels: Some(7), content: ContentKind::Mesh, output, ..args }
    };
    let all = set(&[&south_west, &north_east]);
    run(&all).unwrap();
    let [kept, made, tiles] = all_counts(&check(&all));
    assert!(kept >= 2 && made == 1 && tiles > 2, "nothing has changed: {kept} {made} {tiles}");
    at("b.tif", [7.4, 46.4], 4);
    check(&all);
}

/// Writes an image of one colour with a north-western corner in degrees and a side in pixels of 10 seconds.
fn photo(folder: &Path, name: &str, [west, north]: [f64; 2], side: u16, color: [u8; 3]) -> PathBuf {
    let bytes = color.repeat(usize::from(side) * usize::from(side));
    let image = Image::new([side; 2], 8, 3, bytes).at([west, north], [PIXEL; 2]);
    let path = folder.join(name);
    fs::write(&path, tiff(vec![image])).unwrap();
    path
}

#[test]
fn changed_imagery_makes_only_the_tiles_that_it_touches_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], seed: u32| hills(folder.path(), name, corner, 6, seed);
    let dem = [at("a.tif", [7.0, 46.0], 1), at("b.tif", [7.4, 46.4], 2), at("c.tif", [7.25, 46.25], 3)];
    let photo_at =
        |name: &str, corner: [f64; 2], side: u16, blue: u8| photo(folder.path(), name, corner, side, [200, 90, blue]);
    // Images over one of the three files and over a part of another one.
    let (south_west, middle) = (photo_at("p.tif", [7.0, 46.0], 6, 10), photo_at("q.tif", [7.25, 46.25], 2, 10));
    for (content, gzip) in [(ContentKind::Height, false), (ContentKind::Mesh, true)] {
        let output = OutputArgs { gzip, ..OutputArgs::default() };
        let set = |imagery: &[&PathBuf]| GenArgs {
            imagery: imagery.iter().copied().cloned().collect(),
            color: Color::Natural,
            levels: Some(7),
            overwrite: true,
            content,
            output: output.clone(),
            ..args(&dem.each_ref(), folder.path().join("set"), false)
        };
        photo_at("q.tif", [7.25, 46.25], 2, 10);
        run(&set(&[&south_west, &middle])).unwrap();
        photo_at("q.tif", [7.25, 46.25], 2, 240);
        let update = |imagery: &[&PathBuf]| all_counts(&check(&GenArgs { overwrite: false, ..set(imagery) }));
        let all = [vec![&south_west, &middle], vec![&south_west], vec![&middle, &south_west]];
        // Changed and removed images touch meshes as they touch height tiles, so that the first update suffices.
        let updates = if content == ContentKind::Mesh { 1 } else { all.len() };
        for imagery in all.into_iter().take(updates) {
            let [kept, made, tiles] = update(&imagery);
            assert!(kept > 0 && made > 1 && tiles > 1, "{imagery:?}: {kept} {made} {tiles}");
        }
    }
}

/// Makes sets of terrain for globes on the tiling of the whole earth.
fn terrain(dem: &[&PathBuf], out: PathBuf) -> GenArgs {
    GenArgs { content: ContentKind::QuantizedMesh, color: Color::Natural, levels: Some(11), ..args(dem, out, false) }
}

/// Returns the numbers of tiles of terrain for globes that were kept and made.
fn tile_counts(note: &str) -> [u32; 2] {
    let numbers: Vec<u32> = note.split([' ', ';']).filter_map(|word| word.parse().ok()).collect();
    numbers.try_into().unwrap_or_else(|_| panic!("{note}"))
}

#[test]
fn changed_and_added_sources_make_only_the_terrain_tiles_that_they_touch_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], seed: u32| hills(folder.path(), name, corner, 64, seed);
    let side = 64.0 * PIXEL;
    let (west, east) = (at("a.tif", [7.0, 46.0], 1), at("b.tif", [7.0 + side, 46.0], 2));
    let set = |dem: &[&PathBuf]| {
        let output = OutputArgs { gzip: true, ..OutputArgs::default() };
        GenArgs { levels: Some(12), output, ..terrain(dem, folder.path().join("set")) }
    };
    let all = set(&[&west, &east]);
    let tiles = run(&all).unwrap().tiles as u32;
    at("b.tif", [7.0 + side, 46.0], 3);
    let [kept, made] = tile_counts(&check(&all));
    assert!(kept >= 1 && made >= 12 && kept + made == tiles, "{kept} {made}");
    // The set grows: tiles on data are kept, those on its former border are not.
    let north = at("c.tif", [7.0, 46.0 + side], 4);
    let [kept, made] = tile_counts(&check(&set(&[&west, &east, &north])));
    assert!(kept >= 1 && made >= 12, "{kept} {made}");
}

/// Heights of wide gaps continue those of the whole set.
#[test]
fn terrain_beside_wide_gaps_is_made_again_if_heights_far_away_change() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, corner: [f64; 2], seed: u32| hills(folder.path(), name, corner, 40, seed);
    let (south_west, north_east) = (at("a.tif", [7.0, 46.0], 1), at("b.tif", [9.0, 47.5], 2));
    let availability = OutputArgs { tile_availability: true, ..OutputArgs::default() };
    let all = GenArgs { output: availability, ..terrain(&[&south_west, &north_east], folder.path().join("set")) };
    run(&all).unwrap();
    at("b.tif", [9.0, 47.5], 5);
    let [_, made] = tile_counts(&check(&all));
    assert!(made > 11, "{made}");
    fs::remove_file(all.out.join(MANIFEST)).unwrap();
    assert!(check(&all).contains("no manifest"));
}
