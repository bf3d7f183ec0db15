//! Sources lose nothing and nothing is invented: voids, masks, sparse files, colour models, and detail of imagery.

use std::fs;
use std::path::{Path, PathBuf};

use image::Rgb;
use serde_json::Value;

use crate::files::{each_tile, from_dem, region, tile_heights, tileset};
use crate::tiffs::{COMPRESSION, Image, PHOTOMETRIC, Values, tiff};
use terrane_data_gen::{Color, ContentKind, GenArgs, Raster, TileArgs, Triangles, Voids, run};

/// The north-western corner and the size of a pixel of elevation in degrees.
const CORNER: [f64; 2] = [7.0, 46.0];
const PIXEL: [f64; 2] = [0.001; 2];
/// The number of samples along a side of elevation.
const SIDE: usize = 65;

fn floats(height: impl Fn(usize, usize) -> f32, side: usize) -> Vec<u8> {
    (0..side * side).flat_map(|k| height(k % side, k / side).to_le_bytes()).collect()
}

/// Returns elevation as 32-bit floats.
fn elevation(height: impl Fn(usize, usize) -> f32) -> Image {
    let image = Image::new([SIDE as u16; 2], 32, 1, floats(height, SIDE));
    image.with(339, Values::Short(vec![3])).at(CORNER, PIXEL)
}

fn slope(i: usize, j: usize) -> f32 {
    300.0 + 4.0 * i as f32 + 2.0 * j as f32
}

/// Returns the options for a set of one level from a file of elevation.
fn args(folder: &Path, name: &str, elevation: Vec<Image>) -> GenArgs {
    GenArgs { levels: Some(1), ..from_dem(folder, name, &tiff(elevation)) }
}

/// The number of samples without data in 65 x 65, row by row.
fn voids(args: &GenArgs) -> usize {
    run(args).unwrap().cut_samples as usize
}

#[test]
fn missing_blocks_masks_and_nodata_are_voids() {
    let folder = tempfile::tempdir().unwrap();
    // Tiles of 16 x 16: the last column and row of five hold one sample each.
    let tile = |at: usize| -> Vec<u8> {
        let [x, y] = [at % 5 * 16, at / 5 * 16];
        (0..256).flat_map(|k| slope(x + k % 16, y + k / 16).to_le_bytes()).collect()
    };
    let sparse = |missing: &[usize]| {
        let mut image = elevation(slope).with(322, Values::Short(vec![16])).with(323, Values::Short(vec![16]));
        image.blocks = (0..25).map(|at| if missing.contains(&at) { Vec::new() } else { tile(at) }).collect();
        image
    };
    assert_eq!(voids(&args(folder.path(), "whole.tif", vec![sparse(&[]).nodata("-9999")])), 0);
    let holes = args(folder.path(), "sparse.tif", vec![sparse(&[6, 24]).nodata("-9999")]);
    assert_eq!(voids(&holes), 257);
    // Without a nodata value the samples are 0, as GDAL reads them.
    let zero = args(folder.path(), "zero.tif", vec![sparse(&[6])]);
    let summary = run(&zero).unwrap();
    assert_eq!((summary.cut_samples, summary.min_height_m), (0, 0.0));

    let of_mask = |value: u8| {
        let mask = (0..SIDE * SIDE).map(|k| if k % SIDE < 20 { 0 } else { value }).collect();
        let mask = Image::new([SIDE as u16; 2], 8, 1, mask).with(254, Values::Long(vec![4]));
        mask.with(PHOTOMETRIC, Values::Short(vec![4]))
    };
    assert_eq!(voids(&args(folder.path(), "masked.tif", vec![elevation(slope), of_mask(255)])), 20 * 65);
    let beside = args(folder.path(), "beside.tif", vec![elevation(slope)]);
    fs::write(folder.path().join("beside.tif.msk"), tiff(vec![of_mask(1)])).unwrap();
    assert_eq!(voids(&beside), 20 * 65);

    let hole = |i: usize, j: usize| if i > 30 && j > 40 { -77.25 } else { slope(i, j) };
    let undeclared = args(folder.path(), "undeclared.tif", vec![elevation(hole)]);
    assert_eq!(run(&undeclared).unwrap().min_height_m, -77.25);
    let given = GenArgs { nodata: Some(-77.25), overwrite: true, ..undeclared };
    assert_eq!(voids(&given), 34 * 24);
    for text in ["nan", "-nan", "-1.#QNAN", "NaN"] {
        let nan = |i: usize, j: usize| if i > 30 && j > 40 { f32::NAN } else { slope(i, j) };
        let path = args(folder.path(), "nan.tif", vec![elevation(nan).nodata(text)]);
        assert_eq!(voids(&GenArgs { overwrite: true, ..path }), 34 * 24, "{text}");
    }
}

/// Returns true on a round island.
fn is_land(i: usize, j: usize) -> bool {
    let [x, y] = [i, j].map(|c| c as f64 - 64.0);
    x.hypot(y) < 40.3
}

fn island(folder: &Path, name: &str) -> GenArgs {
    let side = 129;
    let height = |i: usize, j: usize| if is_land(i, j) { 200.0 + i as f32 } else { -9999.0 };
    let image = Image::new([side as u16; 2], 32, 1, floats(height, side)).with(339, Values::Short(vec![3]));
    let image = image.at(CORNER, PIXEL).nodata("-9999");
    GenArgs { levels: None, ..from_dem(folder, name, &tiff(vec![image])) }
}

/// The vertices of a glb's mesh in the frame of the earth, and its triangles.
fn triangles(folder: &Path, uri: &str, ecef_from_tile: glam::DMat4) -> Vec<[glam::DVec3; 3]> {
    let bytes = fs::read(folder.join(uri)).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let data = &bytes[28 + length..];
    let bytes_of = |accessor: &Value| {
        let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let at = (view["byteOffset"].as_u64().unwrap_or(0) + accessor["byteOffset"].as_u64().unwrap_or(0)) as usize;
        (&data[at..], accessor["count"].as_u64().unwrap() as usize, view["byteStride"].as_u64().unwrap_or(0) as usize)
    };
    let primitive = &json["meshes"][0]["primitives"][0];
    let (positions, _, stride) = bytes_of(&primitive["attributes"]["POSITION"]);
    let float = |at: usize| f64::from(f32::from_le_bytes(positions[at..at + 4].try_into().unwrap()));
    let stride = stride.max(12);
    // glTF's y axis points up.
    let vertex = |k: usize| {
        let [x, y, z] = [0, 4, 8].map(|c| float(k * stride + c));
        ecef_from_tile.transform_point3(glam::DVec3::new(x, -z, y))
    };
    let (indices, count, _) = bytes_of(&primitive["indices"]);
    let index = |k: usize| usize::from(u16::from_le_bytes([indices[2 * k], indices[2 * k + 1]]));
    (0..count / 3).map(|t| [0, 1, 2].map(|c| vertex(index(3 * t + c)))).collect()
}

#[test]
fn land_ends_where_the_data_ends() {
    let folder = tempfile::tempdir().unwrap();
    // Each sample is a vertex.
    let tiles = TileArgs { triangles: Triangles::Grid, ..TileArgs::default() };
    let args =
        GenArgs { content: ContentKind::Mesh, float_vertices: true, tiles, ..island(folder.path(), "island.tif") };
    let summary = run(&args).unwrap();
    let sea = (0..129 * 129).filter(|k| !is_land(k % 129, k / 129)).count();
    assert_eq!((summary.cut_samples, summary.levels, summary.tiles), (sea as u64, 2, 5));
    assert_eq!((summary.min_height_m, summary.max_height_m), (224.0, 304.0));
    let set = tileset(&args.out);
    let matrix = |tile: &Value| {
        let numbers: Vec<f64> = serde_json::from_value(tile["transform"].clone()).unwrap();
        glam::DMat4::from_cols_slice(&numbers)
    };
    let root = matrix(&set["root"]);
    let mut is_covered = vec![false; 129 * 129];
    for child in set["root"]["children"].as_array().unwrap() {
        let uri = child["content"]["uri"].as_str().unwrap();
        for corners in triangles(&args.out, uri, root * matrix(child)) {
            for corner in corners {
                let place = terrane::math::WGS84.geodetic(corner);
                let i = (place.longitude.to_degrees() - CORNER[0]) / PIXEL[0] - 0.5;
                let j = (CORNER[1] - place.latitude.to_degrees()) / PIXEL[1] - 0.5;
                assert!((i - i.round()).abs() < 0.01 && (j - j.round()).abs() < 0.01, "{i} {j}");
                let (i, j) = (i.round() as usize, j.round() as usize);
                assert!(is_land(i, j), "a corner at {i} {j}, where there is no data");
                is_covered[j * 129 + i] = true;
            }
        }
    }
    let lost = (0..129 * 129).filter(|k| is_land(k % 129, k / 129) && !is_covered[*k]).count();
    assert!(lost < 10, "{lost} samples have no triangle");
}

#[test]
fn tiles_without_data_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    // Data in the south-west only.
    let side = 257;
    let height = |i: usize, j: usize| if i < 80 && j > 180 { 500.0 } else { -9999.0 };
    let image = Image::new([side as u16; 2], 32, 1, floats(height, side)).with(339, Values::Short(vec![3]));
    let dem = tiff(vec![image.at(CORNER, PIXEL).nodata("-9999")]);
    let args = GenArgs { levels: None, ..from_dem(folder.path(), "corner.tif", &dem) };
    let summary = run(&args).unwrap();
    assert_eq!((summary.levels, summary.tiles), (3, 1 + 1 + 4));
    let set = tileset(&args.out);
    let mut uris = Vec::new();
    each_tile(&set["root"], None, &mut |tile, _| uris.push(tile["content"]["uri"].as_str().unwrap().to_owned()));
    assert_eq!(uris, ["0/0/0.glb", "1/0/0.glb", "2/0/0.exr", "2/1/0.glb", "2/0/1.glb", "2/1/1.glb"]);
    assert!(uris.iter().all(|uri| args.out.join(uri).is_file()));
    let source = args.out.to_string_lossy();
    let verified = terrane::formats::verify(&source, &terrane::fetch::Limits::default(), &mut |_| ()).unwrap();
    assert_eq!((verified.contents, verified.failed, verified.ignored.len()), (6, 0, 0), "{verified:?}");
    // Height tiles are placed by their region, so the frames of the meshes above them must cancel.
    let matrix = |tile: &Value| {
        let numbers: Vec<f64> = serde_json::from_value(tile["transform"].clone()).unwrap();
        glam::DMat4::from_cols_slice(&numbers)
    };
    let (root, middle) = (&set["root"], &set["root"]["children"][0]);
    let product = matrix(root) * matrix(middle) * matrix(&middle["children"][0]);
    let far = glam::DVec3::new(4.3e6, 5e5, 4.6e6);
    assert!(product.transform_point3(far).distance(far) < 1e-6, "{product}");

    let filled = run(&GenArgs { voids: Voids::Fill, overwrite: true, ..args.clone() }).unwrap();
    assert_eq!((filled.tiles, filled.cut_samples, filled.filled_samples), (21, 0, summary.cut_samples));
    let sea = GenArgs { voids: Voids::Sea, overwrite: true, ..args };
    let summary = run(&sea).unwrap();
    assert_eq!((summary.tiles, summary.min_height_m, summary.max_height_m), (21, 0.0, 500.0));
    assert!(tile_heights(&sea.out, 2, 3, 3).iter().all(|h| *h == 0.0));
}

#[test]
fn global_grids_from_0_to_360_equal_those_from_minus_180() {
    let folder = tempfile::tempdir().unwrap();
    let (columns, rows) = (72usize, 36usize);
    // The height of a longitude in whole pixels of 5 degrees.
    let globe = |west: i32| {
        let height = |k: usize| {
            let longitude = (west + 5 * (k % columns) as i32).rem_euclid(360);
            (longitude as f32 * 3.0 + 10.0 * (k / columns) as f32).to_le_bytes()
        };
        let image = Image::new([columns as u16, rows as u16], 32, 1, (0..columns * rows).flat_map(height).collect());
        image.with(339, Values::Short(vec![3])).at([f64::from(west), 90.0], [5.0; 2])
    };
    let sets = [("west.tif", -180), ("east.tif", 0), ("half.tif", -90)].map(|(name, west)| {
        let args = GenArgs { levels: Some(2), ..from_dem(folder.path(), name, &tiff(vec![globe(west)])) };
        let summary = run(&args).unwrap();
        assert_eq!(summary.cut_samples, 0, "{name}");
        let whole = [-180.0, -90.0, 180.0, 90.0f64].map(f64::to_radians);
        let found = region(&tileset(&args.out)["root"]);
        assert!((0..4).all(|k| (found[k] - whole[k]).abs() < 1e-9), "{name}: {found:?}");
        args.out
    });
    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let [a, b, c] = [0, 1, 2].map(|k: usize| tile_heights(&sets[k], 1, x, y));
        let apart = |b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart(&b) < 0.02 && apart(&c) < 0.02, "{x} {y}: {} {}", apart(&b), apart(&c));
    }
    // Both edges are the date line: the samples there are equal, the mean of both sides.
    let row = |x: u32, column: usize| tile_heights(&sets[1], 1, x, 0)[30 * 67 + column];
    assert_eq!(row(0, 1), row(1, 65));
}

/// Regression: heights above 12 km were taken for missing data.
#[test]
fn heights_above_twelve_kilometres_are_kept_with_a_note() {
    let folder = tempfile::tempdir().unwrap();
    let image = elevation(|i, j| 10.0 * slope(i, j) + if (i, j) == (32, 32) { 40_000.0 } else { 0.0 });
    let summary = run(&args(folder.path(), "decimetres.tif", vec![image])).unwrap();
    assert_eq!((summary.cut_samples, summary.max_height_m), (0, 10.0 * f64::from(slope(32, 32)) + 40_000.0));
    assert!(summary.notes.iter().any(|note| note.contains("unit or the scale")), "{:?}", summary.notes);
    let usual = run(&args(folder.path(), "metres.tif", vec![elevation(slope)])).unwrap();
    assert!(usual.notes.is_empty(), "{:?}", usual.notes);
}

/// The colours of the quarters of test images: north-west, north-east, south-west, south-east.
const QUARTERS: [[u8; 3]; 4] = [[250, 240, 30], [20, 230, 240], [240, 30, 220], [20, 30, 250]];

fn quarter(k: usize, side: usize) -> usize {
    usize::from(k % side >= side / 2) + 2 * usize::from(k / side >= side / 2)
}

/// Checks the quarters of the only tile; `None` for a quarter that must have the colour of the ground.
fn check_colors(folder: &Path, name: &str, imagery: Vec<Image>, expected: [Option<[u8; 3]>; 4]) {
    let path = folder.join(name);
    fs::write(&path, tiff(imagery)).unwrap();
    let plain = args(folder, &format!("{name}.dem.tif"), vec![elevation(slope)]);
    let ground = center_colors(&plain);
    let found = center_colors(&GenArgs { imagery: vec![path], overwrite: true, ..plain });
    for (k, expected) in expected.into_iter().enumerate() {
        let expected = expected.unwrap_or(ground[k]);
        let apart = (0..3).map(|c| found[k][c].abs_diff(expected[c])).max().unwrap();
        assert!(apart < 12, "{name}: quarter {k} has the colour {:?}, not {expected:?}", found[k]);
    }
}

/// Returns the colours in the middle of the quarters of the only tile.
fn center_colors(args: &GenArgs) -> [[u8; 3]; 4] {
    run(args).unwrap();
    let tile = image::open(args.out.join("0/0/0.jpg")).unwrap().into_rgb8();
    [(64, 64), (192, 64), (64, 192), (192, 192)].map(|(x, y)| tile.get_pixel(x, y).0)
}

/// Returns an image over the elevation whose pixels are made from the colours of the quarters.
fn colored(bits: u16, channels: u16, bytes: impl Fn([u8; 3], usize) -> Vec<u8>) -> Image {
    let pixels = (0..64 * 64).flat_map(|k| bytes(QUARTERS[quarter(k, 64)], k)).collect();
    Image::new([64; 2], bits, channels, pixels).at(CORNER, [PIXEL[0] * 65.0 / 64.0; 2])
}

#[test]
fn each_colour_model_of_tiff_has_its_colours() {
    let folder = tempfile::tempdir().unwrap();
    let check = |name: &str, image: Image| check_colors(folder.path(), name, vec![image], QUARTERS.map(Some));
    check("rgb.tif", colored(8, 3, |color, _| color.to_vec()));
    let wide = |color: [u8; 3], _| color.iter().flat_map(|c| (u16::from(*c) * 257).to_le_bytes()).collect();
    check("rgb16.tif", colored(16, 3, wide));
    let cmyk = |[r, g, b]: [u8; 3], _| vec![255 - r, 255 - g, 255 - b, 0];
    check("cmyk.tif", colored(8, 4, cmyk).with(PHOTOMETRIC, Values::Short(vec![5])));
    let palette = |channel: usize| {
        let mut map = QUARTERS.map(|color| u16::from(color[channel]) * 257).to_vec();
        map.resize(256, 0);
        map
    };
    let map = [0, 1, 2].map(palette).concat();
    let indices = colored(8, 1, |_, k| vec![quarter(k, 64) as u8]);
    check("palette.tif", indices.with(PHOTOMETRIC, Values::Short(vec![3])).with(320, Values::Short(map)));
    // Red, green and blue in separate planes.
    let mut planes = colored(8, 3, |color, _| color.to_vec()).with(284, Values::Short(vec![2]));
    planes.blocks = (0..3).map(|c| planes.blocks[0].iter().skip(c).step_by(3).copied().collect()).collect();
    check("planes.tif", planes);
    // YCbCr, in a JPEG and without compression.
    let picture = image::RgbImage::from_fn(64, 64, |x, y| Rgb(QUARTERS[quarter((64 * y + x) as usize, 64)]));
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 95).encode_image(&picture).unwrap();
    let ycbcr = |image: Image| image.with(PHOTOMETRIC, Values::Short(vec![6])).with(530, Values::Short(vec![1, 1]));
    let mut compressed = ycbcr(colored(8, 3, |color, _| color.to_vec())).with(COMPRESSION, Values::Short(vec![7]));
    compressed.blocks = vec![jpeg];
    check("jpeg.tif", compressed);
    let converted = |[r, g, b]: [u8; 3], _| {
        let [r, g, b] = [r, g, b].map(f64::from);
        let y = 0.299 * r + 0.587 * g + 0.114 * b;
        [y, 128.0 + (b - y) / 1.772, 128.0 + (r - y) / 1.402].map(|v| v.round().clamp(0.0, 255.0) as u8).to_vec()
    };
    check("ycbcr.tif", ycbcr(colored(8, 3, converted)));
    let light = |_: [u8; 3], k: usize| vec![[10, 90, 160, 240][quarter(k, 64)]];
    let grey = [10, 90, 160, 240].map(|v| Some([v; 3]));
    check_colors(folder.path(), "grey.tif", vec![colored(8, 1, light)], grey);
    let dark = colored(8, 1, light).with(PHOTOMETRIC, Values::Short(vec![0]));
    check_colors(folder.path(), "white-is-0.tif", vec![dark], grey.map(|c| c.map(|c| c.map(|v| 255 - v))));
}

#[test]
fn pixels_without_data_show_the_ground() {
    let folder = tempfile::tempdir().unwrap();
    let [_, rest @ ..] = QUARTERS.map(Some);
    let expected = [None, rest[0], rest[1], rest[2]];
    let black = |color: [u8; 3], k: usize| if quarter(k, 64) == 0 { [0; 3] } else { color };
    let nodata = colored(8, 3, |color, k| black(color, k).to_vec()).nodata("0");
    check_colors(folder.path(), "nodata.tif", vec![nodata], expected);
    let with_alpha = |color: [u8; 3], k: usize| {
        let [r, g, b] = color;
        vec![r, g, b, if quarter(k, 64) == 0 { 0 } else { 255 }]
    };
    let alpha = colored(8, 4, with_alpha).with(338, Values::Short(vec![2]));
    check_colors(folder.path(), "alpha.tif", vec![alpha], expected);
    let mask = (0..64 * 64).map(|k| if quarter(k, 64) == 0 { 0 } else { 255 }).collect();
    let mask = Image::new([64; 2], 8, 1, mask).with(254, Values::Long(vec![4]));
    let mask = mask.with(PHOTOMETRIC, Values::Short(vec![4]));
    check_colors(folder.path(), "mask.tif", vec![colored(8, 3, |color, _| color.to_vec()), mask], expected);
    // Two tiles of 32 x 64 in the west are not whole quarters, so the tiles are 32 x 32.
    let mut sparse = colored(8, 3, |color, _| color.to_vec());
    sparse = sparse.with(322, Values::Short(vec![32])).with(323, Values::Short(vec![32]));
    sparse.blocks = (0..4).map(|k| if k == 0 { Vec::new() } else { QUARTERS[k].repeat(32 * 32) }).collect();
    check_colors(folder.path(), "sparse.tif", vec![sparse], expected);
}

/// Regression: an image of 4096 pixels over elevation of 65 samples became one tile of 256 pixels.
#[test]
fn imagery_finer_than_the_elevation_adds_levels() {
    let folder = tempfile::tempdir().unwrap();
    let dem = args(folder.path(), "dem.tif", vec![elevation(slope)]);
    let side = 1024u32;
    // Columns of two pixels are black and white in turn.
    let picture = image::GrayImage::from_fn(side, 8, |x, _| image::Luma([if x / 2 % 2 == 0 { 0 } else { 255 }]));
    let path = folder.path().join("fine.png");
    picture.save(&path).unwrap();
    let wide = PIXEL[0] * 64.0;
    let (dx, west, north) = (wide / f64::from(side), CORNER[0] + 0.5 * PIXEL[0], CORNER[1] - 0.5 * PIXEL[1]);
    let world = format!("{dx}\n0\n0\n-{}\n{}\n{}\n", wide / 8.0, west + 0.5 * dx, north - wide / 16.0);
    fs::write(path.with_extension("pgw"), world).unwrap();
    let args = GenArgs { levels: None, imagery: vec![path], ..dem };
    let summary = run(&args).unwrap();
    assert_eq!((summary.levels, summary.notes.len()), (3, 0));
    let luma = |file: PathBuf, x: u32| image::open(file).unwrap().into_luma8().get_pixel(x, 128).0[0];
    let fine: Vec<u8> = (100..108).map(|x| luma(args.out.join("2/1/2.jpg"), x)).collect();
    assert!(
        fine.iter().filter(|v| **v < 60).count() >= 3 && fine.iter().filter(|v| **v > 195).count() >= 3,
        "{fine:?}"
    );
    // A texel of the root is the average of four pixels.
    let coarse: Vec<u8> = (100..108).map(|x| luma(args.out.join("0/0/0.jpg"), x)).collect();
    assert!(coarse.iter().all(|v| v.abs_diff(128) < 40), "{coarse:?}");
    let few = run(&GenArgs { levels: Some(1), overwrite: true, ..args }).unwrap();
    assert!(few.notes[0].contains("detail for 3 levels; 1 are written"), "{:?}", few.notes);
}

#[test]
fn sets_without_colour_have_no_images() {
    let folder = tempfile::tempdir().unwrap();
    let dem = args(folder.path(), "dem.tif", vec![elevation(slope)]);
    let plain = GenArgs { color: Color::None, ..dem.clone() };
    run(&plain).unwrap();
    let names: Vec<String> = crate::files::files_below(&plain.out).into_keys().collect();
    assert_eq!(names, ["0/0/0.exr", "tileset.json"]);
    assert!(tileset(&plain.out)["root"]["extras"]["terrane"]["imagery"].is_null());
    let meshes = GenArgs { color: Color::None, content: ContentKind::Mesh, overwrite: true, ..dem.clone() };
    run(&meshes).unwrap();
    let glb = fs::read(meshes.out.join("0/0/0.glb")).unwrap();
    assert!(!glb.windows(6).any(|bytes| bytes == b"images"));
    let both = GenArgs { imagery: vec![folder.path().join("a.png")], overwrite: true, ..plain };
    assert!(run(&both).unwrap_err().to_string().contains("--imagery has no effect with --color none"));
}

/// Regression: a peak between the samples of the finest level was lost by hundreds of metres, and no error was declared.
#[test]
fn peaks_of_rasters_of_any_size_are_kept_within_the_declared_error() {
    let folder = tempfile::tempdir().unwrap();
    for side in [66usize, 83, 100, 127, 130] {
        let is_peak = |i: usize, j: usize| i % 9 == 4 && j % 7 == 3;
        let height = |i: usize, j: usize| 100.0 + if is_peak(i, j) { 50.0 * (i % 11) as f32 + 400.0 } else { 0.0 };
        let image = Image::new([side as u16; 2], 32, 1, floats(height, side)).with(339, Values::Short(vec![3]));
        let dem = tiff(vec![image.at(CORNER, PIXEL)]);
        let args = GenArgs { levels: None, ..from_dem(folder.path(), &format!("{side}.tif"), &dem) };
        let summary = run(&args).unwrap();
        let raster = Raster::read(&args.dem[0]).unwrap();
        assert_eq!([summary.min_height_m, summary.max_height_m], raster.range_m().unwrap().map(f64::from), "{side}");
        // Each sample lies within the declared error of the triangles of its leaf.
        let tiles = 1u32 << (summary.levels - 1);
        let set = tileset(&args.out);
        let mut declared = vec![f64::NAN; (tiles * tiles) as usize];
        each_tile(&set["root"], None, &mut |tile, _| {
            let parts: Vec<u32> =
                tile["content"]["uri"].as_str().unwrap().split(['/', '.']).filter_map(|p| p.parse().ok()).collect();
            if let [level, x, y] = parts[..]
                && level + 1 == summary.levels
            {
                declared[(y * tiles + x) as usize] = tile["geometricError"].as_f64().unwrap();
            }
        });
        let leaves: Vec<Vec<f32>> =
            (0..tiles * tiles).map(|k| tile_heights(&args.out, summary.levels - 1, k % tiles, k / tiles)).collect();
        let mut largest = 0.0f64;
        for (i, j) in (0..side * side).map(|k| (k % side, k / side)) {
            let cells = f64::from(64 * tiles);
            // Columns from the west and rows from the south, in cells of the finest level.
            let x = i as f64 / (side - 1) as f64 * cells;
            let y = (side - 1 - j) as f64 / (side - 1) as f64 * cells;
            let (ci, cj) = ((x as usize).min(64 * tiles as usize - 1), (y as usize).min(64 * tiles as usize - 1));
            let leaf = (cj / 64) * tiles as usize + ci / 64;
            let at = |di: usize, dj: usize| f64::from(leaves[leaf][(65 - cj % 64 - dj) * 67 + 1 + ci % 64 + di]);
            let (u, v) = (x - ci as f64, y - cj as f64);
            let surface = if u >= v {
                at(0, 0) + u * (at(1, 0) - at(0, 0)) + v * (at(1, 1) - at(1, 0))
            } else {
                at(0, 0) + v * (at(0, 1) - at(0, 0)) + u * (at(1, 1) - at(0, 1))
            };
            let error = (surface - f64::from(height(i, j))).abs();
            assert!(error <= declared[leaf] + 0.01, "{side}: {error} m at {i} {j}, {} m declared", declared[leaf]);
            largest = largest.max(error);
        }
        let last = *summary.level_errors_m.last().unwrap();
        assert!(last >= largest - 0.01 && last < largest + 1.0, "{side}: {last} declared, {largest} measured");
    }
    // Rasters of the right size have no error.
    let exact = args(folder.path(), "exact.tif", vec![elevation(slope)]);
    assert_eq!(run(&exact).unwrap().level_errors_m, [0.0]);
}
