//! DTED, plain samples with a header, points in text files, and virtual rasters.

use std::fs;
use std::path::{Path, PathBuf};

use kit::skip;
use terrane_data_gen::{ElevationSource as _, GenArgs, Raster, RasterOptions, run};

use crate::files::{PLACE, Place, SIDE, heights, tiff_int16};
use crate::tiffs::{Image, PHOTOMETRIC, Values, tiff};

fn usual() -> RasterOptions {
    RasterOptions::default()
}

fn error(path: &Path, options: &RasterOptions) -> String {
    let error = Raster::read_in(path, options).and_then(|raster| raster.range_m()).err().unwrap().to_string();
    assert_eq!(error.lines().count(), 1, "{error}");
    error
}

/// Returns the height at the middle of a pixel of a raster over degrees.
fn at(raster: &Raster, longitude: f64, latitude: f64) -> f32 {
    raster.height_m(longitude.to_radians(), latitude.to_radians()).unwrap().map_or(f32::NAN, |height_m| height_m as f32)
}

/// Returns a DTED file whose height `k` of profile `p` is `100 p + k - 150`, with an unknown one.
fn dted(profiles: usize, rows: usize, label: &str) -> Vec<u8> {
    let mut bytes = label.as_bytes().to_vec();
    bytes.resize(3428, b' ');
    for p in 0..profiles {
        bytes.extend([0xaa, 0, 0, p as u8, 0, p as u8, 0, 0]);
        for k in 0..rows {
            let height = 100 * p as i16 + k as i16 - 150;
            let sample = if (p, k) == (1, 2) { -32767 } else { height };
            bytes.extend((sample.unsigned_abs() | if sample < 0 { 0x8000 } else { 0 }).to_be_bytes());
        }
        bytes.extend([0; 4]);
    }
    bytes
}

/// Returns the user header label of a file at 7.5 degrees west and 46.25 degrees north, with steps of 30 seconds.
fn label(profiles: usize, rows: usize) -> String {
    let start = "UHL10073000W0461500N03000300";
    format!("{start:<47}{profiles:04}{rows:04}")
}

#[test]
fn dted_is_placed_by_its_label() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w007.dt1");
    let whole = dted(4, 5, &label(4, 5));
    // Labels of a tape may come first.
    for before in [String::new(), format!("{:<80}", "VOL1"), format!("{:<80}{:<80}", "VOL1", "HDR1")] {
        fs::write(&path, [before.as_bytes(), &whole].concat()).unwrap();
        let raster = Raster::read(&path).unwrap();
        assert_eq!((raster.size(), raster.range_m().unwrap()), ([4, 5], [-150.0, 154.0]));
        let step = 30.0 / 3600.0;
        let expected = [-7.5, 46.25, -7.5 + 3.0 * step, 46.25 + 4.0 * step];
        assert!(raster.bounds().iter().zip(expected).all(|(a, b)| (a.to_degrees() - b).abs() < 1e-9));
        assert_eq!(at(&raster, -7.5, 46.25), -150.0, "the first height is in the south-west");
        assert_eq!(at(&raster, -7.5 + 2.0 * step, 46.25 + 3.0 * step), 53.0);
    }
    for (bytes, why) in [
        (dted(4, 5, &label(4, 6)), "profiles of 6 heights"),
        (dted(4, 5, &label(4, 5).replace("0073000W", "0073000X")), "its longitude is `0073000X`"),
        (dted(4, 5, &label(0, 5)), "its number of profiles is `0000`"),
        (b"HDR1".to_vec(), "no user header label"),
    ] {
        fs::write(&path, bytes).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why) && error.contains("w007.dt1"), "{error}, not {why}");
    }
}

/// Returns 2 bands of 3 x 2 samples of a type in an order; the second band is 1000 higher.
fn bands(interleave: &str, sample: impl Fn(f64) -> Vec<u8>) -> Vec<u8> {
    let at = |band: usize, row: usize, column: usize| sample((1000 * band + 10 * row + column) as f64);
    let mut bytes = Vec::new();
    let order = |f: &mut dyn FnMut(usize, usize, usize)| match interleave {
        "bil" => (0..2).for_each(|r| (0..2).for_each(|b| (0..3).for_each(|c| f(b, r, c)))),
        "bip" => (0..2).for_each(|r| (0..3).for_each(|c| (0..2).for_each(|b| f(b, r, c)))),
        _ => (0..2).for_each(|b| (0..2).for_each(|r| (0..3).for_each(|c| f(b, r, c)))),
    };
    order(&mut |b, r, c| bytes.extend(at(b, r, c)));
    bytes
}

#[test]
fn plain_samples_are_placed_by_the_header_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bil");
    let esri = "nrows 2\nncols 3\nnbands 2\nulxmap 7.25\nulymap 46.75\nxdim 0.5\nydim 0.5\nnodata 1001\n";
    let second = RasterOptions { channel: Some("2".to_owned()), ..usual() };
    for interleave in ["bil", "bip", "bsq"] {
        for (fields, envi, bytes) in [
            ("nbits 16\nbyteorder M", (2, 1), bands(interleave, |v| (v as i16).to_be_bytes().to_vec())),
            ("nbits 16\npixeltype unsignedint", (12, 0), bands(interleave, |v| (v as u16).to_le_bytes().to_vec())),
            (
                "nbits 32\npixeltype float\nbyteorder I",
                (4, 0),
                bands(interleave, |v| (v as f32).to_le_bytes().to_vec()),
            ),
            ("nbits 64\npixeltype FLOAT\nbyteorder M", (5, 1), bands(interleave, |v| v.to_be_bytes().to_vec())),
        ] {
            fs::write(&path, &bytes).unwrap();
            let (kind, order) = envi;
            let envi = format!(
                "ENVI\nsamples = 3\nlines = 2\nbands = 2\ndata type = {kind}\ninterleave = {interleave}\nbyte order = {order}\n\
                 map info = {{Geographic Lat/Lon, 1, 1,\n 7, 47, 0.5, 0.5, WGS-84, units=Degrees}}\ndata ignore value = 1001\n"
            );
            for header in [format!("{esri}layout {interleave}\n{fields}\n"), envi] {
                fs::write(path.with_extension("hdr"), &header).unwrap();
                let raster = Raster::read_in(&path, &second).unwrap();
                assert_eq!((raster.size(), raster.range_m().unwrap()), ([3, 2], [1000.0, 1012.0]), "{header}");
                let expected = [7.25, 46.25, 8.25, 46.75];
                assert!(
                    raster.bounds().iter().zip(expected).all(|(a, b)| (a.to_degrees() - b).abs() < 1e-9),
                    "{header}"
                );
                assert_eq!([at(&raster, 7.25, 46.25), at(&raster, 8.25, 46.75)], [1010.0, 1002.0], "{header}");
                assert!(error(&path, &usual()).contains("2 bands; elevation has one channel, --channel N"));
            }
        }
    }
    // GridFloat, placed by the south-western corner.
    let float = folder.path().join("b.flt");
    fs::write(&float, [1.5f32, 2.5, -9999.0, 4.5].map(f32::to_le_bytes).concat()).unwrap();
    let header = "ncols 2\nnrows 2\nxllcorner 7\nyllcorner 46\ncellsize 0.5\nNODATA_value -9999\nbyteorder LSBFIRST\n";
    fs::write(float.with_extension("hdr"), header).unwrap();
    let raster = Raster::read(&float).unwrap();
    assert_eq!(raster.range_m().unwrap(), [1.5, 4.5]);
    assert!((raster.bounds()[3].to_degrees() - 46.75).abs() < 1e-9);
    for (header, why) in [
        (header.replace("ncols 2", "ncols 3"), "16 bytes for 3 x 2 samples"),
        (header.replace("ncols 2", "ncols 4e9").replace("nrows 2", "nrows 4e9"), "samples of 1 bands"),
        (header.replace("ncols 2", "ncols wide"), "ncols is `wide`"),
        (header.replace("xllcorner", "x"), "neither ulxmap nor xllcorner"),
        (header.replace("byteorder LSBFIRST", "nbits 12"), "samples of 12 bits"),
    ] {
        fs::write(float.with_extension("hdr"), header).unwrap();
        let error = error(&float, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
    // The header of another raster of the same name does not count.
    let fits = float.with_extension("fits");
    fs::write(&fits, b"SIMPLE  = T and more").unwrap();
    assert!(error(&fits, &usual()).contains("FITS; gdal_translate writes it as GeoTIFF"));
    fs::remove_file(float.with_extension("hdr")).unwrap();
    assert!(error(&float, &usual()).contains("nor plain samples with a .hdr, .sgrd, .lbl or .xml file beside them"));
}

#[test]
fn points_are_a_grid_in_any_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.xyz");
    // 4 x 3 points, one of which is missing.
    let places = || (0..12).filter(|k| *k != 5).map(|k| (k % 4, k / 4));
    let line = |(x, y): (i32, i32)| {
        let (east, north) = (7.0 + 0.25 * f64::from(x), 46.0 + 0.5 * f64::from(y));
        format!("{east:.3} {north:.3} {}.5", 10 * y + x)
    };
    let by_rows: Vec<String> = places().map(line).collect();
    let mut by_columns: Vec<(i32, i32)> = places().collect();
    by_columns.sort_by_key(|(x, y)| (*x, -y));
    let by_columns: Vec<String> = by_columns.into_iter().map(line).collect();
    let down: Vec<String> = by_rows.iter().rev().cloned().collect();
    for text in [
        by_rows.join("\n"),
        by_columns.join("\r\n") + "\r\n",
        "\u{feff}x;y;z\n".to_owned() + &down.join("\n").replace(' ', ";"),
        by_rows.join("\n").replace('.', ","),
        "X,Y,Z\n".to_owned() + &by_rows.join("\n").replace(' ', ","),
    ] {
        // The lines tell what the extension does not.
        let path = path.with_extension(if text.contains(',') { "csv" } else { "xyz" });
        fs::write(&path, &text).unwrap();
        let raster = Raster::read(&path).unwrap();
        assert_eq!((raster.size(), raster.range_m().unwrap()), ([4, 3], [0.5, 23.5]), "{text}");
        assert_eq!([at(&raster, 7.0, 46.0), at(&raster, 7.75, 46.5), at(&raster, 7.0, 47.0)], [0.5, 13.5, 20.5]);
        assert!(at(&raster, 7.25, 46.5).is_nan());
    }
    for (text, why) in [
        ("7 46 1\n7 47 2\n", "fewer than 2 x 2 points"),
        ("7 46 1\n8 46 2\nseven 47 3\n8 47 4", "line 3 is not `x y z`"),
        ("7 46 1\n8 46 2\n7 47 1\n8.0001 47 2\n-100 2 9\n", "5 points are not a grid"),
        ("7 46 1\n8 46 2\n7 47 1\n8 47 2\n9.4 46 9\n", "beside the grid"),
    ] {
        fs::write(&path, text).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
}

/// Returns a virtual raster of elevation with sources, over the place of two files beside each other.
fn virtual_raster(sources: &str, more: &str) -> String {
    let Place { tie_deg: [west, north], pixel_deg: [dx, dy], .. } = PLACE;
    format!(
        r#"<VRTDataset rasterXSize="{}" rasterYSize="{SIDE}"><SRS>EPSG:4326</SRS>
        <GeoTransform>{west}, {dx}, 0, {north}, 0, -{dy}</GeoTransform>
        <VRTRasterBand dataType="Int16" band="1">{more}{sources}</VRTRasterBand></VRTDataset>"#,
        2 * SIDE
    )
}

/// Returns a source that fills the columns from a number on.
fn source(file: &str, column: u32, more: &str) -> String {
    format!(
        r#"<ComplexSource><SourceFilename relativeToVRT="1">{file}</SourceFilename><SourceBand>1</SourceBand>
        <SrcRect xOff="0" yOff="0" xSize="{SIDE}" ySize="{SIDE}"/>
        <DstRect xOff="{column}" yOff="0" xSize="{SIDE}" ySize="{SIDE}"/>{more}</ComplexSource>"#
    )
}

#[test]
fn virtual_rasters_are_mosaics_of_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("all.vrt");
    let low = heights();
    let high: Vec<f32> = low.iter().map(|h| h + 1000.0).collect();
    fs::write(folder.path().join("a.tif"), tiff_int16(&low, Some(PLACE), None)).unwrap();
    // Its own place does not matter.
    fs::write(folder.path().join("b.tif"), tiff_int16(&high, Some(PLACE), None)).unwrap();
    let both = source("a.tif", 0, "") + &source("b.tif", SIDE, "");
    fs::write(&path, virtual_raster(&both, "")).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!(raster.size(), [2 * SIDE as usize, SIDE as usize]);
    let Place { tie_deg: [west, north], pixel_deg: [dx, dy], .. } = PLACE;
    let pixel = |raster: &Raster, column: u32, row: u32| {
        at(raster, west + dx * (f64::from(column) + 0.5), north - dy * (f64::from(row) + 0.5))
    };
    let of = |heights: &[f32], column: u32, row: u32| heights[(row * SIDE + column) as usize];
    for (column, row) in [(0, 0), (7, 12), (SIDE - 1, SIDE - 1)] {
        assert!((pixel(&raster, column, row) - of(&low, column, row)).abs() < 0.01);
        assert!((pixel(&raster, SIDE + column, row) - of(&high, column, row)).abs() < 0.01);
    }
    // Later sources lie on top, but where they have no data; values are scaled; nodata of the band counts.
    let nodata = of(&high, 7, 12);
    let over = source("a.tif", 0, "") + &source("b.tif", 0, &format!("<NODATA>{nodata}</NODATA>"));
    fs::write(&path, virtual_raster(&over, "")).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert!((pixel(&raster, 7, 12) - of(&low, 7, 12)).abs() < 0.01);
    assert!((pixel(&raster, 9, 9) - of(&high, 9, 9)).abs() < 0.01);
    let scaled = source("a.tif", 0, "<ScaleRatio>0.5</ScaleRatio><ScaleOffset>3</ScaleOffset>");
    fs::write(&path, virtual_raster(&scaled, "<UnitType>ft</UnitType>")).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert!((pixel(&raster, 9, 9) - 0.3048 * (0.5 * of(&low, 9, 9) + 3.0)).abs() < 0.01);
    // Samples are scaled, not the heights that a file makes of them.
    let items = |scale: f64| {
        format!("<GDALMetadata><Item name=\"SCALE\" sample=\"0\" role=\"scale\">{scale}</Item></GDALMetadata>")
    };
    let image = |scale: f64| {
        let samples = low.iter().flat_map(|h| (*h as i16).to_le_bytes()).collect();
        let image = Image::new([SIDE as u16; 2], 16, 1, samples).at([west, north], [dx, dy]);
        tiff(vec![image.with(339, Values::Short(vec![2])).with(42112, Values::Text(items(scale)))])
    };
    fs::write(folder.path().join("decimetres.tif"), image(0.1)).unwrap();
    for (more, expected) in [("<ScaleRatio>0.1</ScaleRatio><ScaleOffset>5</ScaleOffset>", 5.0), ("", 0.0)] {
        fs::write(&path, virtual_raster(&source("decimetres.tif", 0, more), "")).unwrap();
        let found = pixel(&Raster::read(&path).unwrap(), 9, 9);
        assert!((found - expected - 0.1 * of(&low, 9, 9).trunc()).abs() < 0.01, "{found}");
    }
    // A quarter of a file, at twice its size.
    let part = source("a.tif", 0, "").replacen(
        &format!(r#"xSize="{SIDE}" ySize="{SIDE}""#),
        &format!(r#"xSize="{}" ySize="{}""#, SIDE / 2, SIDE / 2),
        1,
    );
    fs::write(&path, virtual_raster(&part, "")).unwrap();
    let raster = Raster::read(&path).unwrap();
    let around = [of(&low, 4, 4), of(&low, 5, 4), of(&low, 4, 5), of(&low, 5, 5)];
    let found = pixel(&raster, 9, 9);
    assert!(around.iter().any(|h| *h <= found) && around.iter().any(|h| *h >= found), "{found} in {around:?}");
    // One inside of another.
    fs::write(folder.path().join("outer.vrt"), virtual_raster(&source("all.vrt", 0, ""), "")).unwrap();
    assert!((pixel(&Raster::read(&folder.path().join("outer.vrt")).unwrap(), 9, 9) - found).abs() < 0.01);
}

#[test]
fn virtual_rasters_that_cannot_be_read_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vrt");
    fs::write(folder.path().join("a.tif"), tiff_int16(&heights(), Some(PLACE), None)).unwrap();
    let whole = virtual_raster(&source("a.tif", 0, ""), "");
    fs::write(folder.path().join("b.vrt"), whole.replace("a.tif", "a.vrt")).unwrap();
    for (text, why) in [
        (whole.replace("a.tif", "gone.tif"), "gone.tif"),
        (whole.replace("a.tif", "a.vrt"), "more than 4 virtual rasters inside of one another"),
        (
            whole.replace("<VRTDataset ", "<VRTDataset subClass=\"VRTWarpedDataset\" "),
            "a warped raster without GDALWarpOptions",
        ),
        (whole.replace("ComplexSource", "KernelFilteredSource"), "`KernelFilteredSource` is not supported"),
        (whole.replace("<SourceBand>1", "<SourceBand>7"), "channels 1 to 1"),
        (whole.replace("EPSG:4326", "EPSG:99999"), "99999"),
        (whole.replace("rasterXSize=\"80\"", "rasterXSize=\"-80\""), "rasterXSize is -80"),
        (whole.replace("xOff=\"0\"", "xOff=\"east\""), "xOff is `east`"),
        (whole.replace("GeoTransform", "Transform"), "no georeference"),
        (whole[..whole.len() / 2].to_owned(), "VRT"),
        (whole.replace("a.tif", "b.vrt"), "or a loop of them"),
        ("<VRTDataset rasterXSize=\"8\" rasterYSize=\"8\"/>".to_owned(), "no bands"),
    ] {
        fs::write(&path, text).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
}

#[test]
fn sets_of_virtual_rasters_have_their_colours() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    fs::write(file("a.tif"), tiff_int16(&heights(), Some(PLACE), None)).unwrap();
    let both = source("a.tif", 0, "") + &source("a.tif", SIDE, "");
    fs::write(file("dem.vrt"), virtual_raster(&both, "")).unwrap();
    let Place { tie_deg: [west, north], pixel_deg: [dx, dy], .. } = PLACE;
    let rgb = |color: [u8; 3]| {
        let pixels = (0..SIDE * SIDE).flat_map(|_| color).collect();
        let image = Image::new([SIDE as u16; 2], 8, 3, pixels).at([west, north], [dx, dy]);
        tiff(vec![image.with(PHOTOMETRIC, Values::Short(vec![2]))])
    };
    fs::write(file("red.tif"), rgb([200, 10, 10])).unwrap();
    fs::write(file("blue.tif"), rgb([10, 10, 200])).unwrap();
    let band = |number: u32| {
        let sources = source("red.tif", 0, "") + &source("blue.tif", SIDE, "");
        let sources = sources.replace("<SourceBand>1", &format!("<SourceBand>{number}"));
        format!(r#"<VRTRasterBand dataType="Byte" band="{number}">{sources}</VRTRasterBand>"#)
    };
    let colors = |bands: &str| {
        let whole = virtual_raster("", "");
        let (start, _) = whole.split_once("<VRTRasterBand").unwrap();
        format!("{start}{bands}</VRTDataset>")
    };
    fs::write(file("rgb.vrt"), colors(&(band(1) + &band(2) + &band(3)))).unwrap();
    let args = |out: &str| GenArgs {
        dem: vec![file("dem.vrt")],
        imagery: vec![file("rgb.vrt")],
        levels: Some(1),
        ..GenArgs::new(file(out))
    };
    run(&args("set")).unwrap();
    let image = |set: &str| image::open(file(set).join("0/0/0.jpg")).unwrap().into_rgb8();
    let image = image("set");
    let [left, right] =
        [0.2, 0.8].map(|share| image.get_pixel((share * f64::from(image.width())) as u32, image.height() / 2).0);
    assert!(left[0] > 150 && left[2] < 60 && right[2] > 150 && right[0] < 60, "{left:?} {right:?}");
    fs::write(file("rgb.vrt"), colors(&(band(3) + &band(2) + &band(1)))).unwrap();
    let error = run(&args("other")).unwrap_err().to_string();
    assert!(error.contains("its bands are not the bands of its files in their order"), "{error}");
}

/// Files that GDAL writes of one raster give the same heights.
#[test]
fn formats_of_gdal_give_the_heights_of_the_geotiff() {
    let has_gdal =
        std::process::Command::new("gdal_translate").arg("--version").output().is_ok_and(|o| o.status.success());
    if !has_gdal {
        skip::skipped("gdal_translate is not installed");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let original = folder.path().join("original.tif");
    let place = Place { tie_deg: [7.0, 47.0], pixel_deg: [1.0 / 1200.0; 2], ..PLACE };
    fs::write(&original, tiff_int16(&heights(), Some(place), Some("-32767"))).unwrap();
    let expected = Raster::read(&original).unwrap();
    for (format, name, options) in [
        ("EHdr", "a.bil", &[][..]),
        ("ENVI", "b.raw", &["-co", "INTERLEAVE=BIP"]),
        ("XYZ", "e.xyz", &[]),
        ("VRT", "c.vrt", &[]),
        ("VRT", "d.vrt", &["-srcwin", "0", "0", "20", "20"]),
    ] {
        let path: PathBuf = folder.path().join(name);
        let done = std::process::Command::new("gdal_translate")
            .args(["-q", "-of", format])
            .args(options)
            .args([&original, &path])
            .status()
            .unwrap();
        assert!(done.success(), "{name}");
        let raster = Raster::read(&path).unwrap();
        for [column, row] in [[0.5, 0.5], [10.5, 7.5], [18.5, 19.5]] {
            let (longitude, latitude) = (7.0 + column / 1200.0, 47.0 - row / 1200.0);
            let (found, expected) = (at(&raster, longitude, latitude), at(&expected, longitude, latitude));
            assert!((found - expected).abs() < 0.02, "{name}: {found}, not {expected}");
        }
    }
}
