//! Tests whole tile sets: equal bytes with any number of threads, equal bits where tiles meet, content, and bad files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use terrane_data_gen::{ContentKind, GenArgs, GenError, Raster, TileArgs, Triangles, run};
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

/// Returns the content of all files below a folder by their paths.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let (mut found, mut open) = (BTreeMap::new(), vec![folder.to_path_buf()]);
    while let Some(at) = open.pop() {
        for entry in std::fs::read_dir(at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_path_buf(), std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn small(out: impl Into<PathBuf>) -> GenArgs {
    GenArgs { levels: Some(3), size: 5_000.0, ..GenArgs::new(out) }
}

#[test]
fn bytes_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    for content in [ContentKind::Height, ContentKind::Mesh] {
        let sets = [1, 4].map(|jobs| {
            let out = folder.path().join(format!("{content:?}-{jobs}"));
            let summary = run(&GenArgs { jobs: Some(jobs), content, ..small(&out) }).unwrap();
            assert_eq!((summary.tiles, summary.levels), (21, 3));
            let files = files(&out);
            assert_eq!(
                summary.bytes,
                files.values().map(|f| f.len() as u64).sum::<u64>(),
                "the summary counts the bytes of all files"
            );
            files
        });
        assert!(sets[0] == sets[1], "{content:?}");
    }
    let other = folder.path().join("other");
    run(&GenArgs { seed: 2, ..small(&other) }).unwrap();
    assert!(files(&other) != files(&folder.path().join("Height-1")), "another seed gives another set");
}

#[test]
fn float_vertices_are_written_only_with_the_option() {
    let folder = tempfile::tempdir().unwrap();
    let sets = [false, true].map(|float_vertices| {
        let out = folder.path().join(float_vertices.to_string());
        let tiles = TileArgs { triangles: Triangles::Grid, no_meshopt: !float_vertices, ..TileArgs::default() };
        let summary = run(&GenArgs { content: ContentKind::Mesh, float_vertices, tiles, ..small(&out) }).unwrap();
        (files(&out), summary.bytes)
    });
    for ((files, _), quantized) in sets.iter().zip([true, false]) {
        for (path, bytes) in files.iter().filter(|(path, _)| path.extension().is_some_and(|e| e == "glb")) {
            let wanted = b"\"extensionsRequired\":[\"KHR_mesh_quantization\"]";
            let is_there = bytes.windows(wanted.len()).any(|w| w == wanted);
            assert_eq!(is_there, quantized, "{}", path.display());
        }
    }
    // Quantized vertices save 16 bytes each: 33 x 33 vertices and those of the skirts.
    let saved = sets[1].1 - sets[0].1;
    assert!(saved > 21 * (1_217 * 16 - 400), "{saved}");
}

#[test]
fn an_existing_set_is_replaced_only_with_the_option() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("precious.txt"), "mine").unwrap();
    std::fs::write(out.join("tileset.json"), "{}").unwrap();
    let args = GenArgs { levels: Some(1), ..small(&out) };
    assert!(matches!(run(&args), Err(GenError::Exists(path)) if path == out));
    assert_eq!(files(&out).len(), 2, "nothing was changed");
    run(&GenArgs { overwrite: true, ..args }).unwrap();
    assert!(out.join("tileset.json").is_file() && !out.join("precious.txt").exists());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary folder is left");
}

/// Visits every tile of a tileset with its parent's error, parents first.
fn tiles(tile: &Value, parent_error: f64, visit: &mut impl FnMut(&Value, f64)) {
    visit(tile, parent_error);
    for child in tile["children"].as_array().into_iter().flatten() {
        tiles(child, tile["geometricError"].as_f64().unwrap(), visit);
    }
}

fn tileset(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("tileset.json")).unwrap()).unwrap()
}

/// Reads the heights of a tile with their border, north row first.
fn heights(path: &Path) -> (usize, Vec<f32>) {
    let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
    let side = image.layer_data.size.width();
    let samples: Vec<f32> = image.layer_data.channel_data.list[0].sample_data.values_as_f32().collect();
    assert_eq!(samples.len(), side * side);
    (side, samples)
}

#[test]
fn errors_decrease_and_shared_edges_have_equal_bits() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    run(&small(&out)).unwrap();
    let json = tileset(&out);
    let mut seen = 0;
    tiles(&json["root"], json["geometricError"].as_f64().unwrap(), &mut |tile, parent_error| {
        let error = tile["geometricError"].as_f64().unwrap();
        assert!(error <= parent_error, "{error} below {parent_error}");
        assert!((error == 0.0) == tile["children"].is_null(), "only leaves have the error 0");
        seen += 1;
    });
    assert_eq!(seen, 21);
    let tile = |x: usize, y: usize| heights(&out.join(format!("2/{x}/{y}.exr")));
    for y in 0..4 {
        for x in 0..3 {
            let ((side, west), (_, east)) = (tile(x, y), tile(x + 1, y));
            // Around each tile is a border of one sample. The last inner column of one tile is the first of the next.
            let column = |h: &[f32], c: usize| (1..side - 1).map(|r| h[r * side + c].to_bits()).collect::<Vec<_>>();
            assert_eq!(column(&west, side - 2), column(&east, 1));
            assert_eq!(column(&west, side - 1), column(&east, 2), "the border is the neighbour's second column");
            let ((_, a), (_, b)) = (tile(y, x), tile(y, x + 1));
            let row = |h: &[f32], r: usize| {
                h[r * side + 1..(r + 1) * side - 1].iter().map(|v| v.to_bits()).collect::<Vec<_>>()
            };
            assert_eq!(row(&a, 1), row(&b, side - 2), "north edge of one tile and south edge of the next");
        }
    }
    // A coarse tile is an exact subset of the finer ones.
    let ((side, coarse), (_, fine)) = (heights(&out.join("1/0/0.exr")), tile(0, 0));
    for j in 0..=32 {
        for i in 0..=32 {
            let from_south = |step: usize, h: &[f32]| h[(side - 2 - step * j) * side + 1 + step * i].to_bits();
            assert_eq!(from_south(1, &coarse), from_south(2, &fine));
        }
    }
}

/// West and north edge and pixel size of the GeoTIFFs of these tests, in degrees.
const PLACE: ([f64; 2], f64) = ([7.0, 46.5], 0.001);
const SIDE: usize = 100;

/// Returns a height that all sample formats can represent.
fn height(column: usize, row: usize) -> f64 {
    (100 + 10 * column + row) as f64
}

fn write_tiff<C>(path: &Path, convert: impl Fn(f64) -> C::Inner)
where
    C: colortype::ColorType,
    [C::Inner]: tiff::encoder::TiffValue,
{
    write_tiff_at::<C>(PLACE, path, convert);
}

fn write_tiff_at<C>(([west, north], pixel): ([f64; 2], f64), path: &Path, convert: impl Fn(f64) -> C::Inner)
where
    C: colortype::ColorType,
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut encoder = TiffEncoder::new(std::fs::File::create(path).unwrap()).unwrap();
    let mut image = encoder.new_image::<C>(SIDE as u32, SIDE as u32).unwrap();
    let tags = image.encoder();
    tags.write_tag(Tag::ModelPixelScaleTag, &[pixel, pixel, 0.0][..]).unwrap();
    tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, west, north, 0.0][..]).unwrap();
    // Version 1.1.0 and three keys: geographic coordinates, pixels are areas, EPSG:4326.
    let keys: [u16; 16] = [1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326];
    tags.write_tag(Tag::GeoKeyDirectoryTag, &keys[..]).unwrap();
    tags.write_tag(Tag::GdalNodata, "1000").unwrap();
    let samples: Vec<C::Inner> = (0..SIDE * SIDE).map(|k| convert(height(k % SIDE, k / SIDE))).collect();
    image.write_data(&samples).unwrap();
}

#[test]
fn bad_files_give_one_error_and_leave_no_output() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    write_tiff::<colortype::GrayI16>(&file("good.tif"), |h| h as i16);
    let good = std::fs::read(file("good.tif")).unwrap();
    std::fs::write(file("cut.tif"), &good[..good.len() / 2]).unwrap();
    std::fs::write(file("empty.tif"), b"").unwrap();
    std::fs::write(file("text.tif"), b"elevation, honestly").unwrap();
    std::fs::write(file("N00E000.hgt"), b"short").unwrap();
    std::fs::write(file("nowhere.hgt"), vec![0; 1201 * 1201 * 2]).unwrap();
    let nan = terrane::formats::writers::write_height_exr("t", 4, vec![f32::NAN; 16]).unwrap();
    std::fs::write(file("nan.exr"), nan).unwrap();
    image::RgbImage::new(4, 4).save(file("photo.jpg")).unwrap();
    image::RgbImage::new(4, 4).save(file("far.png")).unwrap();
    std::fs::write(file("far.pgw"), "1\n0\n0\n-1\n500\n80\n").unwrap();
    for name in
        ["missing.tif", "cut.tif", "empty.tif", "text.tif", "N00E000.hgt", "nowhere.hgt", "nan.exr", "photo.jpg"]
    {
        let out = folder.path().join("out");
        let error = run(&GenArgs { dem: vec![file(name)], ..GenArgs::new(&out) }).unwrap_err();
        assert!(matches!(&error, GenError::File { path, .. } | GenError::Invalid { path, .. } if *path == file(name)));
        let text = error.to_string();
        assert!(text.contains(name) && text.len() > name.len() + 4 && text.lines().count() == 1, "{text}");
        assert!(!out.exists(), "{name} left an output");
    }
    for (args, what) in [
        (GenArgs { levels: Some(0), ..small(file("a")) }, "--levels"),
        (GenArgs { levels: Some(99), ..small(file("a")) }, "--levels"),
        (GenArgs { size: f64::NAN, ..small(file("a")) }, "--size"),
        (GenArgs { size: -1.0, ..small(file("a")) }, "--size"),
    ] {
        let text = run(&args).unwrap_err().to_string();
        assert!(text.contains(what), "{text}");
    }
}

/// Changes bytes at random offsets of a GeoTIFF. Reading gives an error or a raster, never a panic.
#[test]
fn changed_tiffs_do_not_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.tif");
    write_tiff::<colortype::GrayI16>(&path, |h| h as i16);
    let good = std::fs::read(&path).unwrap();
    let mut state = 1u64;
    let mut next = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let (mut read, mut refused) = (0, 0);
    for _ in 0..400 {
        let mut bytes = good.clone();
        for _ in 0..1 + next(4) {
            // Half of the changes hit the header, half the directory at the end.
            let at = if next(2) == 0 { next(64) } else { good.len() - 1 - next(400) };
            bytes[at] = next(256) as u8;
        }
        std::fs::write(&path, &bytes).unwrap();
        match Raster::read(&path) {
            Ok(_) => read += 1,
            Err(_) => refused += 1,
        }
    }
    assert!(read > 0 && refused > 0, "{read} {refused}");
}
