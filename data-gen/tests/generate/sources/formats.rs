//! Elevation in zip files, web tiles, grey PNGs, named channels and ASCII grids, and lists of files.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, WritableImage,
};
use terrane_data_gen::{GenArgs, HeightEncoding, Raster, RasterOptions, run};

use crate::files::{PLACE, SIDE, heights, region, tiff_int16, tileset};

fn read(path: &Path, options: RasterOptions) -> Raster {
    Raster::read_in(path, &options).unwrap()
}

fn error(path: &Path, options: RasterOptions) -> String {
    let error = Raster::read_in(path, &options).err().unwrap().to_string();
    assert!(error.contains(&*path.to_string_lossy()) && error.lines().count() == 1, "{error}");
    error
}

fn usual() -> RasterOptions {
    RasterOptions::default()
}

/// The public copies of SRTM are stored like this.
#[test]
fn gzipped_hgt_is_placed_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("N42E001.hgt.gz");
    let samples: Vec<u8> = (0..1201 * 1201i32).flat_map(|k| ((k % 1201) as i16).to_be_bytes()).collect();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&samples).unwrap();
    let whole = gzip.finish().unwrap();
    fs::write(&path, &whole).unwrap();
    let raster = read(&path, usual());
    let bounds = raster.bounds().map(f64::to_degrees);
    assert!(bounds.iter().zip([1.0, 42.0, 2.0, 43.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{bounds:?}");
    assert_eq!(raster.range_m().unwrap(), [0.0, 1200.0]);
    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0xff;
    for bytes in [&whole[..whole.len() / 2], &whole[..3], &damaged] {
        fs::write(&path, bytes).unwrap();
        let found = Raster::read(&path).and_then(|raster| raster.range_m());
        assert!(found.unwrap_err().to_string().contains("N42E001.hgt.gz"));
    }
}

#[test]
fn zipped_hgt_is_placed_by_the_name_of_its_member_or_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let bytes: Vec<u8> = (0..1201 * 1201).flat_map(|k: i32| ((k % 1201) as i16).to_be_bytes()).collect();
    let zip = |name: &str, member: &str| {
        let path = folder.path().join(name);
        let mut zip = zip::ZipWriter::new(fs::File::create(&path).unwrap());
        zip.start_file("readme.txt", zip::write::SimpleFileOptions::default()).unwrap();
        zip.start_file(member, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&bytes).unwrap();
        zip.finish().unwrap();
        path
    };
    for (name, member) in [("srtm.zip", "below/N42E001.hgt"), ("N42E001.SRTMGL3.hgt.zip", "data.HGT")] {
        let raster = read(&zip(name, member), usual());
        assert_eq!((raster.size(), raster.range_m().unwrap()), ([1201; 2], [0.0, 1200.0]));
        let expected = [1.0, 42.0, 2.0, 43.0f64].map(f64::to_radians);
        assert!(raster.bounds().iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{name}");
    }
    assert!(error(&zip("a.zip", "N42E001.txt"), usual()).contains("no HGT file in it"));
    assert!(error(&zip("b.zip", "data.hgt"), usual()).contains("the name is not like N42E001"));
    let cut = folder.path().join("cut.zip");
    let whole = fs::read(zip("N42E002.zip", "N42E002.hgt")).unwrap();
    fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    error(&cut, usual());
}

/// Returns a PNG of one height in Terrarium's encoding.
fn terrarium(path: &Path, height_m: f64, side: u32) {
    let value = ((height_m + 32768.0) * 256.0).round() as u32;
    let pixel = image::Rgb([(value >> 16) as u8, (value >> 8) as u8, value as u8]);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbImage::from_pixel(side, side, pixel).save(path).unwrap();
}

#[test]
fn web_tiles_are_placed_by_their_path() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    let tile = |zoom: u32, x: u32, y: u32| set.join(format!("{zoom}/{x}/{y}.png"));
    // The finest zoom level counts. One of its four tiles is missing.
    terrarium(&tile(3, 4, 2), -50.0, 8);
    for (x, y, height_m) in [(9, 5, 100.0), (10, 5, 200.5), (9, 6, 300.0)] {
        terrarium(&tile(4, x, y), height_m, 8);
    }
    let options = RasterOptions { encoding: HeightEncoding::Terrarium, ..usual() };
    let raster = read(&set, options.clone());
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([16, 16], [100.0, 300.0]));
    // Tile 9 of 16 begins at 22.5 degrees east; 8 samples a tile lie 2.8125 degrees apart.
    let [west, south, east, north] = raster.bounds().map(f64::to_degrees);
    assert!((west - 22.5 - 0.5 * 2.8125).abs() < 1e-9 && (east - 67.5 + 0.5 * 2.8125).abs() < 1e-9, "{west} {east}");
    let latitude = |row: f64| (std::f64::consts::PI * (1.0 - row / 8.0)).sinh().atan().to_degrees();
    let half = 0.5 / 8.0;
    assert!((north - latitude(5.0 + half)).abs() < 1e-9 && (south - latitude(7.0 - half)).abs() < 1e-9);
    let one = read(&tile(4, 10, 5), options.clone());
    assert_eq!((one.size(), one.range_m().unwrap()), ([8, 8], [200.5, 200.5]));
    assert!((one.bounds()[0].to_degrees() - 45.0 - 0.5 * 2.8125).abs() < 1e-9);
    // In the default encoding the same bytes are heights of 834 km, which count as missing.
    assert!(error(&tile(4, 10, 5), usual()).contains("no sample has a height"));
    terrarium(&tile(4, 10, 6), 400.0, 16);
    let reason = read(&set, options).range_m().unwrap_err().to_string();
    assert!(reason.contains("10/6.png: 16 x 16 pixels, but other tiles have 8 x 8"), "{reason}");
}

#[test]
fn grey_pngs_need_a_height_scale() {
    let folder = tempfile::tempdir().unwrap();
    let wide = folder.path().join("wide.png");
    image::ImageBuffer::from_fn(4, 4, |x, y| image::Luma([(1000 * x + y) as u16])).save(&wide).unwrap();
    let narrow = folder.path().join("narrow.png");
    image::GrayImage::from_fn(4, 4, |x, y| image::Luma([(10 * x + y) as u8])).save(&narrow).unwrap();
    assert!(error(&wide, usual()).contains("--height-scale"));
    let options = RasterOptions { height_scale: Some(0.1), height_offset: -500.0, ..usual() };
    assert_eq!(read(&wide, options).range_m().unwrap(), [-500.0, -199.7]);
    let options = RasterOptions { height_scale: Some(2.0), nodata: Some(33.0), ..usual() };
    assert_eq!(read(&narrow, options).range_m().unwrap(), [0.0, 64.0]);
}

fn exr(path: &Path, channels: &[(&str, f32)]) {
    let samples = |value: f32| FlatSamples::F32((0..16).map(|k| value + k as f32).collect());
    let list: SmallVec<_> = channels.iter().map(|(name, value)| AnyChannel::new(*name, samples(*value))).collect();
    let layer = Layer::new((4, 4), LayerAttributes::default(), Encoding::UNCOMPRESSED, AnyChannels::sort(list));
    Image::from_layer(layer).write().to_file(path).unwrap();
}

/// Regression: an EXR with several channels was read by its first one.
#[test]
fn exr_channels_are_chosen_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let low = |options: RasterOptions| read(&path, options).range_m().unwrap()[0];
    let named = |name: &str| RasterOptions { channel: Some(name.to_owned()), ..usual() };
    exr(&path, &[("depth", 10.0), ("height", 500.0)]);
    let reason = error(&path, usual());
    assert!(reason.contains("several channels: depth, height; --channel NAME"), "{reason}");
    assert_eq!([low(named("height")), low(named("depth"))], [500.0, 10.0]);
    assert!(error(&path, named("Z")).contains("no channel Z; the file has depth, height"));
    exr(&path, &[("elevation", 7.0), ("A", 1.0)]);
    assert_eq!(low(usual()), 7.0);
    exr(&path, &[("Y", 8.0), ("Z", 1.0)]);
    assert_eq!(low(usual()), 8.0);
    exr(&path, &[("R", 9.0), ("G", 9.0), ("B", 9.0), ("A", 1.0)]);
    assert_eq!(low(usual()), 9.0);
    assert_eq!(low(RasterOptions { height_scale: Some(10.0), height_offset: 1.0, ..usual() }), 91.0);
    exr(&path, &[("R", 9.0), ("G", 9.0), ("B", 9.5)]);
    assert!(error(&path, usual()).contains("several channels: B, G, R"));
}

#[test]
fn ascii_grids_and_channels_of_tiffs() {
    let folder = tempfile::tempdir().unwrap();
    let grid = folder.path().join("a.asc");
    let samples: Vec<String> = heights().iter().map(f32::to_string).collect();
    let header = format!("ncols {SIDE}\nnrows {SIDE}\nxllcorner 7\nyllcorner 46\ncellsize 0.001\n");
    fs::write(&grid, header.clone() + &samples.join(" ")).unwrap();
    let raster = read(&grid, usual());
    let expected = [7.0005, 46.0005, 7.0395, 46.0395f64].map(f64::to_radians);
    assert!(raster.bounds().iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{:?}", raster.bounds());
    assert_eq!(raster.range_m().unwrap()[0], 200.0);
    fs::write(&grid, header + &samples[1..].join(" ")).unwrap();
    assert!(error(&grid, usual()).contains("1599 samples for 40 x 40"));

    let two = (0..16 * 16).flat_map(|k: u16| [k.to_le_bytes(), (k + 1000).to_le_bytes()].concat()).collect();
    let two = crate::tiffs::Image::new([16; 2], 16, 2, two).at([7.0, 46.0], [0.001; 2]);
    let path = folder.path().join("two.tif");
    fs::write(&path, crate::tiffs::tiff(vec![two])).unwrap();
    assert!(error(&path, usual()).contains("2 channels; elevation has one channel, --channel N"));
    let channel = |n: &str| RasterOptions { channel: Some(n.to_owned()), ..usual() };
    assert_eq!(read(&path, channel("2")).range_m().unwrap(), [1000.0, 1255.0]);
    assert!(error(&path, channel("3")).contains("channels 1 to 2"));
}

#[test]
fn folders_patterns_and_lists_name_files() {
    let folder = tempfile::tempdir().unwrap();
    let below = folder.path().join("below");
    fs::create_dir(&below).unwrap();
    let dx = 0.04;
    for (k, name) in ["a1.tif", "a2.tif", "b.tif"].into_iter().enumerate() {
        let place = crate::files::Place { tie_deg: [PLACE.tie_deg[0] + dx * k as f64, PLACE.tie_deg[1]], ..PLACE };
        fs::write(below.join(name), tiff_int16(&heights(), Some(place), None)).unwrap();
    }
    fs::write(below.join("notes.md"), "not elevation").unwrap();
    let list = folder.path().join("list.txt");
    fs::write(&list, "below/b.tif\n\n below/a2.tif \n").unwrap();
    // West and east of the set in widths of a file, from the western file.
    let span = |dem: &Path| {
        let args = GenArgs { dem: vec![dem.to_owned()], levels: Some(1), overwrite: true, ..out(folder.path()) };
        run(&args).unwrap();
        let found = region(&tileset(&args.out)["root"]);
        [found[0], found[2]].map(|l| ((l.to_degrees() - PLACE.tie_deg[0]) / dx).round() as i32)
    };
    assert_eq!(span(&below), [0, 3]);
    assert_eq!(span(&below.join("a?.tif")), [0, 2]);
    assert_eq!(span(&below.join("*2.tif")), [1, 2]);
    assert_eq!(span(&list), [1, 3]);
    // A text file may have the samples themselves.
    let grid = folder.path().join("grid.txt");
    for text in [
        "ncols 2\nnrows 2\nxllcorner 7.48\nyllcorner 46\ncellsize 0.04\n1 2 3 4",
        "7.5 46 1\n7.54 46 2\n7.5 46.04 3\n7.54 46.04 4",
    ] {
        fs::write(&grid, text).unwrap();
        assert_eq!(span(&grid), [0, 1]);
    }
    for (dem, why) in [(below.join("c*.tif"), "no file matches"), (below.join("none.tif"), "none.tif")] {
        let error = run(&GenArgs { dem: vec![dem], overwrite: true, ..out(folder.path()) }).unwrap_err().to_string();
        assert!(error.contains(why), "{error}");
    }
    // A set is not replaced if a file of the list lies in it.
    let set = out(folder.path()).out;
    fs::copy(below.join("b.tif"), set.join("b.tif")).unwrap();
    fs::write(&list, set.join("b.tif").to_string_lossy().as_bytes()).unwrap();
    let error = run(&GenArgs { dem: vec![list], overwrite: true, ..out(folder.path()) }).unwrap_err().to_string();
    assert!(error.contains("--overwrite would remove") && set.join("b.tif").is_file(), "{error}");
}

fn out(folder: &Path) -> GenArgs {
    GenArgs::new(PathBuf::from(folder).join("set"))
}
