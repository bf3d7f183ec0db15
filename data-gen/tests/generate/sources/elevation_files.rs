//! Elevation files of each format are placed by their georeference; a broken file is one error that names the file.

use std::fs;
use std::path::Path;

use crate::files::{
    PLACE, Place, SIDE, from_dem, heights, region, set_tag, tiff_float32, tiff_int16, tiff_int16_keyed,
    tiff_int16_with_metadata, tiff_uint16, tile_heights, tileset,
};
use terrane::formats::writers::write_height_exr;
use terrane_data_gen::{GenArgs, GenError, Summary, Voids, run};

/// Generates a set, and checks the root's region against `bounds` and its corner heights against `corners_m`.
fn check_placement(args: &GenArgs, bounds: [f64; 4], corners_m: Option<[f32; 4]>) -> Summary {
    let summary = run(args).unwrap();
    let found = region(&tileset(&args.out)["root"]);
    for k in 0..4 {
        assert!((found[k] - bounds[k]).abs() < 1e-9, "{}: {found:?}, not {bounds:?}", args.out.display());
    }
    assert!(found[4] <= summary.min_height_m && found[5] >= summary.max_height_m);
    if let Some(corners_m) = corners_m {
        let tile = tile_heights(&args.out, 0, 0, 0);
        let at = |row: usize, column: usize| tile[row * crate::files::TILE_SIDE + column];
        let got = [at(1, 1), at(1, 65), at(65, 1), at(65, 65)];
        for (got, wanted) in got.iter().zip(corners_m) {
            assert!((got - wanted).abs() < 0.01, "{got}, not {wanted}");
        }
    }
    summary
}

/// Returns the heights of the corners: north-west, north-east, south-west, south-east.
fn corners(heights: &[f32], side: usize) -> [f32; 4] {
    [heights[0], heights[side - 1], heights[side * (side - 1)], heights[side * side - 1]]
}

#[test]
fn geotiffs_are_placed_by_their_tags() {
    let folder = tempfile::tempdir().unwrap();
    let h = heights();
    let expected = corners(&h, SIDE as usize);
    let inner = Place { tie_px: [10.0, 4.0], tie_deg: [-70.25, -33.5], pixel_deg: [0.0005, 0.0005], point: false };
    let point = Place { point: true, ..PLACE };
    for (k, place) in [PLACE, inner, point].into_iter().enumerate() {
        for (name, bytes) in [
            ("int16", tiff_int16(&h, Some(place), None)),
            ("uint16", tiff_uint16(&h, Some(place), None)),
            ("float32", tiff_float32(&h, Some(place), None)),
        ] {
            let args = from_dem(folder.path(), &format!("{name}-{k}.tif"), &bytes);
            let summary = check_placement(&args, place.bounds(), Some(expected));
            assert_eq!(summary.filled_samples, 0);
            assert_eq!(summary.tiles, 5);
        }
    }
}

#[test]
fn voids_are_filled_from_surroundings_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let n = SIDE as usize;
    let with = |void: f32| -> Vec<f32> {
        let mut h = heights();
        for j in 10..20 {
            for i in 5..25 {
                h[j * n + i] = void;
            }
        }
        h
    };
    let place = Some(PLACE);
    let mut filled = Vec::new();
    for (name, bytes) in [
        ("declared-int16.tif", tiff_int16(&with(-999.0), place, Some("-999"))),
        ("srtm-int16.tif", tiff_int16(&with(-32768.0), place, None)),
        ("declared-uint16.tif", tiff_uint16(&with(9999.0), place, Some("9999"))),
        ("declared-float32.tif", tiff_float32(&with(-5000.0), place, Some("-5e3"))),
        ("nan-float32.tif", tiff_float32(&with(f32::NAN), place, None)),
        ("lowest-float32.tif", tiff_float32(&with(f32::MIN), place, None)),
        ("lowest.exr", write_height_exr("test", n, with(f32::MIN)).unwrap()),
    ] {
        if name.ends_with(".exr") {
            let ([west, north], [dx, dy]) = (PLACE.tie_deg, PLACE.pixel_deg);
            let world = format!("{dx}\n0\n0\n-{dy}\n{}\n{}\n", west + 0.5 * dx, north - 0.5 * dy);
            fs::write(folder.path().join("lowest.wld"), world).unwrap();
        }
        let args = GenArgs { voids: Voids::Fill, ..from_dem(folder.path(), name, &bytes) };
        let summary = check_placement(&args, PLACE.bounds(), Some(corners(&heights(), n)));
        assert!(summary.min_height_m >= 195.0 && summary.max_height_m <= 820.0, "{name}: {summary}");
        assert!(summary.filled_samples > 1000, "{name}: {summary}");
        filled.push(summary.filled_samples);
    }
    assert!(filled.iter().all(|f| *f == filled[0]), "{filled:?}");
}

/// Regression: feet were read as metres.
#[test]
fn heights_in_feet_are_converted_to_metres() {
    let folder = tempfile::tempdir().unwrap();
    let mut h = heights();
    h[500] = -32768.0;
    let (foot, us_foot) = (0.3048, 1200.0 / 3937.0);
    // Keys: VerticalUnits 4099 and Vertical 4096. ProjLinearUnits 3076 applies to the plane only.
    for (k, (more, metres)) in [
        (vec![[4099, 9001]], 1.0),
        (vec![[4099, 9002]], foot),
        (vec![[4099, 1033]], 0.01),
        (vec![[4096, 5754]], 0.304_800_749_1),
        (vec![[4096, 5703], [4099, 9003]], us_foot),
        (vec![[4096, 6360]], us_foot),
        (vec![[4096, 8228]], foot),
        (vec![[4096, 6360], [4099, 9001]], 1.0),
        (vec![[4096, 5773]], 1.0),
        (vec![[3076, 9002]], 1.0),
        (vec![[3076, 9001], [4096, 32767], [4099, 9002]], foot),
        (vec![[4096, 0], [4099, 0]], 1.0),
    ]
    .into_iter()
    .enumerate()
    {
        let args = from_dem(folder.path(), &format!("{k}.tif"), &tiff_int16_keyed(&h, Some(PLACE), &more));
        let args = GenArgs { voids: Voids::Fill, ..args };
        let expected = corners(&h, SIDE as usize).map(|h| (f64::from(h) * metres) as f32);
        let summary = check_placement(&args, PLACE.bounds(), Some(expected));
        assert!(summary.min_height_m > 190.0 * metres, "{more:?}: a void became a depth, {summary}");
    }
    for (more, why) in [
        (vec![[4099, 9014]], "EPSG:9014"),
        (vec![[4096, 5703], [4099, 32767]], "EPSG:32767"),
        (vec![[4096, 32767]], "without a unit"),
    ] {
        let args = from_dem(folder.path(), "other.tif", &tiff_int16_keyed(&h, Some(PLACE), &more));
        let error = refused(&args, &args.dem[0], why);
        assert!(matches!(error, GenError::Invalid { .. }), "{error:?}");
    }
}

/// Regression: depths were read as heights, so that the sea became mountains.
#[test]
fn depths_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for system in [5336, 5612, 5614, 5706, 5715, 5831, 5861, 5867, 5873, 6357, 6359, 8051, 8053, 9287, 10379, 10678] {
        for more in [vec![[4096, system]], vec![[4096, system], [4099, 9001]]] {
            let args = from_dem(folder.path(), "depths.tif", &tiff_int16_keyed(&heights(), Some(PLACE), &more));
            refused(&args, &args.dem[0], &format!("depths in EPSG:{system}; only heights"));
        }
    }
}

/// Regression: the scale, offset and unit in GDAL's metadata were ignored.
#[test]
fn scaled_samples_are_converted_to_metres() {
    let folder = tempfile::tempdir().unwrap();
    let mut h = heights();
    h[500] = -9999.0;
    let item = |role: &str, value: &str| format!(r#"<Item name="X" sample="0" role="{role}">{value}</Item>"#);
    let of_other = r#"<Item name="SCALE" sample="1" role="scale">7</Item><Item name="DATE">2020</Item>"#;
    let foot = 0.3048;
    for (k, (items, keys, [factor, offset])) in [
        (vec![item("scale", "0.1"), item("offset", "-20.5")], vec![], [0.1, -20.5]),
        (vec![of_other.to_owned(), item("scale", "2"), item("unittype", "m")], vec![], [2.0, 0.0]),
        (vec![item("offset", "100"), item("unittype", "ft")], vec![], [foot, 100.0 * foot]),
        (vec![item("unittype", "US survey foot")], vec![], [1200.0 / 3937.0, 0.0]),
        // The unit in the GeoKeys takes precedence.
        (vec![item("unittype", "ft")], vec![[4099, 9001]], [1.0, 0.0]),
        (vec![item("scale", "0.5")], vec![[4096, 5703], [4099, 9002]], [0.5 * foot, 0.0]),
        (vec![of_other.to_owned()], vec![], [1.0, 0.0]),
    ]
    .into_iter()
    .enumerate()
    {
        let metadata = format!("<GDALMetadata>{}</GDALMetadata>", items.concat());
        let args =
            from_dem(folder.path(), &format!("{k}.tif"), &tiff_int16_with_metadata(&h, &metadata, "-9999", &keys));
        let args = GenArgs { voids: Voids::Fill, ..args };
        let expected = corners(&h, SIDE as usize).map(|h| (f64::from(h) * factor + offset) as f32);
        let summary = check_placement(&args, PLACE.bounds(), Some(expected));
        assert!(summary.min_height_m > 190.0 * factor + offset, "{metadata}: a void became a depth, {summary}");
    }
    for (role, value) in [("scale", "big"), ("offset", "inf"), ("unittype", "degC")] {
        let tiff = tiff_int16_with_metadata(&h, &item(role, value), "-9999", &[]);
        let args = from_dem(folder.path(), "other.tif", &tiff);
        refused(&args, &args.dem[0], &format!("`{value}`, which is not supported"));
    }
}

/// Regression: files of other bodies were taken for the earth.
#[test]
fn positions_on_two_bodies_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let on = |name: &str, axis: u16| {
        let keys = [[2056, 32767], [2057, axis]];
        from_dem(folder.path(), name, &tiff_int16_keyed(&heights(), Some(PLACE), &keys))
    };
    check_placement(&on("earth.tif", 0), PLACE.bounds(), None);
    let moon = on("moon.tif", 1);
    refused(&moon, &moon.dem[0], "an ellipsoid of 1737400 m in a system of another one");
}

#[test]
fn srtm_hgt_is_placed_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let height = |i: i16, j: i16| if (i, j) == (600, 600) { i16::MIN } else { 100 + i / 2 + j / 3 };
    let bytes: Vec<u8> = (0..1201).flat_map(|j| (0..1201).flat_map(move |i| height(i, j).to_be_bytes())).collect();
    let expected = [height(0, 0), height(1200, 0), height(0, 1200), height(1200, 1200)].map(f32::from);
    for (name, [west, south]) in [("N42E001.hgt", [1.0, 42.0f64]), ("s09w070.HGT", [-70.0, -9.0])] {
        let args = GenArgs { voids: Voids::Fill, ..from_dem(folder.path(), name, &bytes) };
        check_placement(&args, [west, south, west + 1.0, south + 1.0].map(f64::to_radians), Some(expected));
    }
}

#[test]
fn height_images_are_placed_by_their_world_file() {
    let folder = tempfile::tempdir().unwrap();
    let h = heights();
    let rgb = image::RgbImage::from_fn(SIDE, SIDE, |x, y| {
        let v = ((h[(y * SIDE + x) as usize] + 10_000.0) * 10.0).round() as u32;
        image::Rgb([(v >> 16) as u8, (v >> 8) as u8, v as u8])
    });
    let mut png = std::io::Cursor::new(Vec::new());
    rgb.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let exr = write_height_exr("test", SIDE as usize, h.clone()).unwrap();
    let (west, north, pixel) = (7.0, 46.0, 0.001);
    let world = format!("{pixel}\n0\n0\n-{pixel}\n{west}\n{north}\n");
    let last = pixel * f64::from(SIDE - 1);
    let bounds = [west, north - last, west + last, north].map(f64::to_radians);
    for (name, world_name, bytes) in [("rgb.png", "rgb.pgw", png.into_inner()), ("heights.exr", "heights.wld", exr)] {
        fs::write(folder.path().join(world_name), &world).unwrap();
        let args = from_dem(folder.path(), name, &bytes);
        check_placement(&args, bounds, Some(corners(&h, SIDE as usize)));
        // Without it the set lies at the default position, and the heights are the same.
        let args = from_dem(folder.path(), &format!("free-{name}"), &bytes);
        assert!((run(&args).unwrap().min_height_m - 200.0).abs() < 0.1);
    }
}

/// Regression: any PNG was read as terrain-RGB; a 16-bit grey one became heights around 100 km below the ground.
#[test]
fn pngs_other_than_terrain_rgb_are_refused() {
    use image::ExtendedColorType as Color;
    let folder = tempfile::tempdir().unwrap();
    let png = |color: Color, bytes: usize| {
        let mut png = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut png);
        let samples: Vec<u8> = (0..bytes).map(|k| [1, 140][k % 2]).collect();
        image::ImageEncoder::write_image(encoder, &samples, 8, 8, color).unwrap();
        png
    };
    // 2 x 2 pixels of a palette with two colours.
    let palette = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x02\0\0\0\x02\x08\x03\0\0\0\x45\x68\xfd\x16".to_vec();
    for (name, bytes, why) in [
        ("grey.png", png(Color::L8, 64), "8-bit grey:"),
        ("grey-alpha.png", png(Color::La8, 128), "8-bit grey with alpha:"),
        ("grey16.png", png(Color::L16, 128), "16-bit grey:"),
        ("rgb16.png", png(Color::Rgb16, 384), "16-bit RGB:"),
        ("rgba16.png", png(Color::Rgba16, 512), "16-bit RGBA:"),
        ("palette.png", palette, "8-bit palette:"),
    ] {
        let args = from_dem(folder.path(), name, &bytes);
        let error = refused(&args, &args.dem[0], why);
        assert!(matches!(error, GenError::Invalid { .. }), "{error:?}");
    }
    for (name, bytes) in [("rgb.png", png(Color::Rgb8, 192)), ("rgba.png", png(Color::Rgba8, 256))] {
        run(&from_dem(folder.path(), name, &bytes)).unwrap();
    }
}

/// Files that lie wholly beyond 180 degrees are moved onto the earth. Regression: they covered nothing.
#[test]
fn longitudes_beyond_180_degrees_wrap_around() {
    let folder = tempfile::tempdir().unwrap();
    let h = heights();
    let (wide, [_, dy]) = (0.001 * f64::from(SIDE - 1), PLACE.pixel_deg);
    let low = 46.5 - dy * f64::from(SIDE - 1);
    for (name, west, expected) in [
        ("190.tif", 190.0, -170.0),
        ("-190.tif", -190.0, 170.0),
        ("180.tif", 180.0, -180.0),
        ("to-180.tif", 180.0 - wide, 180.0 - wide),
        ("359.tif", 359.0, -1.0),
    ] {
        let place = Place { tie_deg: [west, 46.5], point: true, ..PLACE };
        let bounds = [expected, low, expected + wide, 46.5].map(f64::to_radians);
        let args = from_dem(folder.path(), name, &tiff_int16(&h, Some(place), None));
        check_placement(&args, bounds, Some(corners(&h, SIDE as usize)));
        // An image of the whole world may span 0 to 360 degrees.
        let imagery = folder.path().join("world.png");
        image::RgbImage::from_pixel(8, 4, image::Rgb([250, 10, 10])).save(&imagery).unwrap();
        fs::write(imagery.with_extension("pgw"), "45\n0\n0\n-45\n22.5\n67.5\n").unwrap();
        run(&GenArgs { imagery: vec![imagery], overwrite: true, ..args }).unwrap();
    }
    for (name, west) in [("far.tif", 3600.0), ("far-too.tif", -3600.0)] {
        let place = Place { tie_deg: [west, 46.5], ..PLACE };
        let args = from_dem(folder.path(), name, &tiff_int16(&h, Some(place), None));
        refused(&args, &args.dem[0], "outside of the earth's coordinates");
    }
}

#[test]
fn several_files_are_one_set() {
    let folder = tempfile::tempdir().unwrap();
    let east = Place { tie_deg: [PLACE.tie_deg[0] + 0.03, PLACE.tie_deg[1]], ..PLACE };
    let low = vec![100.0f32; (SIDE * SIDE) as usize];
    let high = vec![700.0f32; (SIDE * SIDE) as usize];
    let mut args = from_dem(folder.path(), "west.tif", &tiff_int16(&low, Some(PLACE), None));
    args.dem.extend(from_dem(folder.path(), "east.tif", &tiff_int16(&high, Some(east), None)).dem);
    let [west, south, _, north] = PLACE.bounds();
    let summary = check_placement(&args, [west, south, east.bounds()[2], north], Some([100.0, 700.0, 100.0, 700.0]));
    assert_eq!((summary.min_height_m, summary.max_height_m), (100.0, 700.0));
    // The first file wins where both have samples: 0.04 of 0.069 degrees are the western file's.
    let tile = tile_heights(&args.out, 0, 0, 0);
    let row = &tile[30 * crate::files::TILE_SIDE..31 * crate::files::TILE_SIDE];
    let low = row[1..66].iter().filter(|h| **h == 100.0).count();
    assert!((36..=38).contains(&low), "{low}");
}

/// Regression: between the outermost samples of neighbours, each file's sample was repeated for half a pixel.
#[test]
fn files_cut_from_one_file_give_the_same_set() {
    let folder = tempfile::tempdir().unwrap();
    let (n, pixel, h) = (SIDE as usize, 0.001, heights());
    let part = |name: &str, first: [usize; 2], side: usize| {
        let samples = (0..side * side).map(|k| h[(first[1] + k / side) * n + first[0] + k % side]).collect();
        let (west, north) = (7.0 + pixel * first[0] as f64, 46.0 - pixel * first[1] as f64);
        fs::write(
            folder.path().join(name).with_extension("wld"),
            format!("{pixel}\n0\n0\n-{pixel}\n{west}\n{north}\n"),
        )
        .unwrap();
        from_dem(folder.path(), name, &write_height_exr("test", side, samples).unwrap())
    };
    let whole = part("whole.exr", [0, 0], n);
    let mut parts = part("south-east.exr", [n / 2, n / 2], n / 2);
    for (name, first) in [("a.exr", [0, n / 2]), ("b.exr", [n / 2, 0]), ("c.exr", [0, 0])] {
        parts.dem.extend(part(name, first, n / 2).dem);
    }
    run(&whole).unwrap();
    assert_eq!(run(&parts).unwrap().filled_samples, 0);
    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let pairs = tile_heights(&whole.out, 1, x, y).into_iter().zip(tile_heights(&parts.out, 1, x, y));
        // Rounding may differ by one quantum.
        let apart = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 0.01, "{apart} m");
    }
}

/// Checks that a run fails with one line that names `file` and contains `why`, and leaves no output. Returns the error.
fn refused(args: &GenArgs, file: &Path, why: &str) -> GenError {
    let error = run(args).unwrap_err();
    let line = error.to_string();
    assert!(line.contains(&*file.to_string_lossy()), "{line}");
    assert!(line.contains(why), "{line}, not {why}");
    assert!(!line.contains('\n'), "{line}");
    assert!(!args.out.exists());
    error
}

#[test]
fn broken_elevation_is_one_error_that_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let good = tiff_int16(&heights(), Some(PLACE), None);
    let n = (SIDE * SIDE) as usize;
    let zero_wide = |tag: u16| {
        let mut bytes = good.clone();
        set_tag(&mut bytes, tag, 0);
        bytes
    };
    let huge = {
        let mut bytes = good.clone();
        set_tag(&mut bytes, 256, u32::MAX);
        set_tag(&mut bytes, 257, u32::MAX);
        bytes
    };
    let nowhere = Place { tie_deg: [7.5, 460.0], ..PLACE };
    let flat = Place { pixel_deg: [0.0, 0.0], ..PLACE };
    for (name, bytes, why) in [
        ("not-placed.tif", tiff_int16(&heights(), None, None), "no georeference"),
        ("zero-width.tif", zero_wide(256), "TIFF"),
        ("zero-height.tif", zero_wide(257), "TIFF"),
        ("huge.tif", huge, "TIFF"),
        ("nan.tif", tiff_float32(&vec![f32::NAN; n], Some(PLACE), None), "no sample has a height"),
        ("void.tif", tiff_int16(&vec![-32768.0; n], Some(PLACE), None), "no sample has a height"),
        ("nowhere.tif", tiff_int16(&heights(), Some(nowhere), None), "outside of the earth's coordinates"),
        ("flat.tif", tiff_int16(&heights(), Some(flat), None), "outside of the earth's coordinates"),
        ("text.tif", b"ncols 40\nnrows 40\n".to_vec(), "ASCII grid: no cellsize"),
        ("words.tif", b"heights of hills".to_vec(), "neither GeoTIFF"),
        ("empty.tif", Vec::new(), "the file is empty"),
        ("N42E001.hgt", vec![0; 1000], "HGT of 1000 bytes"),
        ("somewhere.hgt", vec![0; 1201 * 1201 * 2], "the name is not like"),
        ("é€42E001.hgt", vec![0; 1201 * 1201 * 2], "the name is not like"),
    ] {
        let args = from_dem(folder.path(), name, &bytes);
        let error = refused(&args, &args.dem[0], why);
        assert!(matches!(error, GenError::Invalid { .. }), "{error:?}");
    }
    let missing = folder.path().join("missing.tif");
    let args = GenArgs { dem: vec![missing.clone()], ..GenArgs::new(folder.path().join("out")) };
    let error = refused(&args, &missing, "");
    assert!(matches!(error, GenError::File { .. }), "{error:?}");
}

/// Regression: reading a named pipe without a writer blocked forever.
#[cfg(target_os = "linux")]
#[test]
fn paths_that_are_not_regular_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let good = from_dem(folder.path(), "good.tif", &tiff_int16(&heights(), Some(PLACE), None));
    let pipe = folder.path().join("pipe");
    let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, mode).unwrap();
    for path in [Path::new("/dev/null"), &pipe] {
        refused(&GenArgs { dem: vec![path.to_owned()], ..good.clone() }, path, "is not a regular file");
        refused(&GenArgs { imagery: vec![path.to_owned()], ..good.clone() }, path, "is not a regular file");
    }
    let empty = folder.path().join("empty");
    fs::create_dir(&empty).unwrap();
    refused(&GenArgs { dem: vec![empty.clone()], ..good.clone() }, &empty, "a folder without elevation files");
    refused(&GenArgs { imagery: vec![empty.clone()], ..good.clone() }, &empty, "a folder without images");
    // The error comes before anything is generated.
    let link = folder.path().join("link");
    std::os::unix::fs::symlink("nowhere", &link).unwrap();
    refused(&GenArgs { out: link.clone(), ..good }, &link, "is a link whose target does not exist");
}

#[test]
fn a_file_cut_anywhere_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let h = heights();
    let exr = write_height_exr("test", SIDE as usize, h.clone()).unwrap();
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(SIDE, SIDE, image::Rgb([1, 140, 160]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    let png = png.into_inner();
    // PNG's last chunk only marks the end; decoders accept an image without it.
    let picture_end = png.len() - 12;
    for (name, whole, end) in [
        ("cut.tif", &tiff_float32(&h, Some(PLACE), None), None),
        ("cut.exr", &exr, None),
        ("cut.png", &png, Some(picture_end - 8)),
    ] {
        let end = end.unwrap_or(whole.len() - 1);
        for length in (0..60).map(|k| k * end / 60).chain([end]) {
            let args = from_dem(folder.path(), name, &whole[..length]);
            let error = refused(&args, &args.dem[0], "");
            assert!(matches!(error, GenError::Invalid { .. }), "{length}: {error:?}");
        }
    }
}

#[test]
fn bad_imagery_and_arguments_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let args = from_dem(folder.path(), "good.tif", &tiff_int16(&heights(), Some(PLACE), None));
    let path = folder.path().join("picture.tif");
    fs::write(&path, tiff_int16(&heights(), Some(PLACE), None)).unwrap();
    refused(&GenArgs { imagery: vec![path.clone()], ..args.clone() }, &path, "8 bits per channel");
    let path = folder.path().join("picture.jpg");
    fs::write(&path, b"\xff\xd8\xff\xe0 nothing").unwrap();
    refused(&GenArgs { imagery: vec![path.clone()], ..args.clone() }, &path, "");
    let path = folder.path().join("elsewhere.png");
    image::RgbImage::from_pixel(8, 8, image::Rgb([250, 10, 10])).save(&path).unwrap();
    let world = |west: f64| fs::write(path.with_extension("pgw"), format!("0.0001\n0\n0\n-0.0001\n{west}\n46.48\n"));
    world(9.0).unwrap();
    refused(&GenArgs { imagery: vec![path.clone()], ..args.clone() }, &path, "does not overlap the elevation");
    // An image far smaller than a tile is used.
    world(7.52).unwrap();
    run(&GenArgs { imagery: vec![path.clone()], overwrite: true, ..args.clone() }).unwrap();
    fs::remove_dir_all(&args.out).unwrap();
    for bad in [
        GenArgs { levels: Some(0), ..args.clone() },
        GenArgs { levels: Some(40), ..args.clone() },
        GenArgs { size: 0.0, ..args.clone() },
        GenArgs { size: f64::NAN, ..args.clone() },
    ] {
        let error = run(&bad).unwrap_err();
        assert!(matches!(error, GenError::Argument(_)) && error.to_string().contains("--"), "{error:?}");
    }
    run(&args).unwrap();
}

#[test]
fn default_levels_follow_the_detail_of_the_elevation() {
    let folder = tempfile::tempdir().unwrap();
    let levels = |side: usize, stretch: f64| {
        let exr = write_height_exr("test", side, (0..side * side).map(|k| (k % 97) as f32).collect()).unwrap();
        let world = format!("{}\n0\n0\n-0.001\n7\n46\n", 0.001 * stretch);
        fs::write(folder.path().join("detail.wld"), world).unwrap();
        let args = GenArgs { levels: None, overwrite: true, ..from_dem(folder.path(), "detail.exr", &exr) };
        run(&args).unwrap().levels
    };
    // A tile has 64 cells, so one sample more than a level holds adds a level. The shape of the samples does not matter.
    for stretch in [1.0, 1.5, 0.6] {
        assert_eq!([40, 65, 66, 129, 130].map(|side| levels(side, stretch)), [1, 1, 2, 2, 3], "{stretch}");
    }
}
