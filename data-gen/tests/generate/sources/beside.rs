//! Files beside a raster: metadata, world files, reference systems and masks, on disks and on servers.

use std::fs;
use std::path::{Path, PathBuf};

use kit::server::{Reply, Server};
use terrane_data_gen::{ElevationSource as _, GenArgs, Raster, RasterOptions, run, utm_to_geodetic};

use crate::files::from_dem;
use crate::tiffs::{COMPRESSION, Image, PHOTOMETRIC, Values, tiff};

const SIDE: u16 = 20;
/// A system that is not the usual one for coordinates like these.
const PRJ: &str = "EPSG:32633";
const WORLD: &str = "30\n0\n0\n-30\n500000\n5100000\n";

/// Returns metadata as GDAL writes it; `band` is the content of the element of the first band.
fn metadata(band: &str) -> String {
    format!(
        "<PAMDataset>\n  <SRS dataAxisToSRSAxisMapping=\"1,2\">PROJCS[&quot;WGS 84 / UTM zone 33N&quot;,AUTHORITY[&quot;\
         EPSG&quot;,&quot;32633&quot;]]</SRS>\n  <GeoTransform> 4.99985e+05, 3.0e+01, 0.0e+00, 5.100015e+06, 0.0e+00, \
         -3.0e+01</GeoTransform>\n  <PAMRasterBand band=\"1\">{band}</PAMRasterBand>\n</PAMDataset>\n"
    )
}

/// Returns elevation without a place: 1 m and more, to the south-east.
fn elevation() -> Image {
    let samples = (1..=SIDE * SIDE).flat_map(u16::to_le_bytes).collect();
    Image::new([SIDE; 2], 16, 1, samples)
}

/// Returns a mask that hides the first column.
fn mask() -> Vec<u8> {
    let hidden = |k: u16| if k.is_multiple_of(SIDE) { 0 } else { 255 };
    tiff(vec![Image::new([SIDE; 2], 8, 1, (0..SIDE * SIDE).map(hidden).collect())])
}

/// Fails unless the north-western sample has its place, and the samples of the first column no height if `is_masked`.
fn lies(path: &Path, options: &RasterOptions, is_masked: bool) {
    let raster = Raster::read_in(path, options).unwrap();
    let at = |column: f64, row: f64| {
        let [x, y] = utm_to_geodetic(33, true, 500_000.0 + 30.0 * column, 5_100_000.0 - 30.0 * row);
        raster.height_m(x, y).unwrap()
    };
    assert_eq!(at(0.0, 0.0).is_none(), is_masked, "{}", path.display());
    for (column, row) in [(1.0, 0.0), (7.0, 3.0), (19.0, 19.0)] {
        let found = at(column, row).unwrap();
        assert!((found - (1.0 + column + 20.0 * row)).abs() < 0.01, "{}: {found}", path.display());
    }
}

#[test]
fn metadata_and_world_files_place_files_on_disks() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        fs::write(folder.path().join(name), bytes).unwrap();
        folder.path().join(name)
    };
    let usual = RasterOptions::default();
    let placed = write("placed.tif", &tiff(vec![elevation()]));
    write("placed.tif.aux.xml", metadata("").as_bytes());
    lies(&placed, &usual, false);
    // GDAL's PNG driver writes the place of elevation like this.
    let png = folder.path().join("grey.png");
    let samples = (1..=SIDE * SIDE).collect::<Vec<u16>>();
    let image = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(SIDE.into(), SIDE.into(), samples).unwrap();
    image.save(&png).unwrap();
    write("grey.png.aux.xml", metadata("<NoDataValue>1.0E+00</NoDataValue>").as_bytes());
    let scaled = RasterOptions { height_scale: Some(1.0), ..usual.clone() };
    let raster = Raster::read_in(&png, &scaled).unwrap();
    assert_eq!(raster.range_m().unwrap(), [2.0, 400.0]);
    // Names in capitals.
    let capitals = write("OLD.TIF", &tiff(vec![elevation()]));
    write("OLD.TFW", WORLD.as_bytes());
    write("OLD.PRJ", PRJ.as_bytes());
    lies(&capitals, &usual, false);
    write("OLD.TIF.msk", &mask());
    lies(&capitals, &usual, true);
    write("OLD.TIF.msk", b"II*\0 but no mask");
    let error = Raster::read(&capitals).err().unwrap().to_string();
    assert!(error.contains("OLD.TIF.msk: TIFF"), "{error}");
}

#[test]
fn metadata_stands_above_the_tags() {
    let folder = tempfile::tempdir().unwrap();
    let image = elevation().at([8.0, 46.0], [0.001; 2]).nodata("5");
    let args = from_dem(folder.path(), "dem.tif", &tiff(vec![image]));
    let range = || Raster::read(&args.dem[0]).unwrap().range_m().unwrap();
    assert_eq!(range(), [1.0, 400.0]);
    let beside = folder.path().join("dem.tif.aux.xml");
    let band = "<NoDataValue>1</NoDataValue><Scale>0.5</Scale><Offset>3</Offset><UnitType>km</UnitType>";
    fs::write(&beside, format!("<PAMDataset><PAMRasterBand band=\"1\">{band}</PAMRasterBand></PAMDataset>")).unwrap();
    assert_eq!(Raster::read(&args.dem[0]).unwrap().range_m().unwrap()[0], 4000.0);
    fs::write(&beside, "<PAMDataset><GeoTransform>1, 2</GeoTransform></PAMDataset>").unwrap();
    let error = run(&args).unwrap_err().to_string();
    assert!(error.contains("dem.tif.aux.xml: GeoTransform has 2 numbers, expected 6"), "{error}");
}

/// Regression: files beside a TIFF on a server were not looked for.
#[test]
fn files_beside_a_file_on_a_server_are_read() {
    let file = tiff(vec![elevation()]);
    let serve = |files: Vec<(&'static str, Vec<u8>)>, otherwise: fn() -> Reply| {
        let file = file.clone();
        Server::start(move |request| {
            let found = files.iter().find(|(name, _)| *name == request.path()).map(|(_, bytes)| bytes);
            match found.or((request.path() == "/a.tif").then_some(&file)) {
                Some(bytes) => Reply::ok(bytes.clone()).with("ETag", "\"1\"").ranged(request),
                None => otherwise(),
            }
        })
    };
    let text = |text: &str| text.as_bytes().to_vec();
    let missing: [fn() -> Reply; 3] = [
        || Reply::new(404, ""),
        // Object stores that do not list, and servers that answer with a page.
        || Reply::new(403, ""),
        || Reply::ok(b"<!DOCTYPE html><html><body>Home</body></html>".to_vec()).with("Content-Type", "text/html"),
    ];
    for otherwise in missing {
        let world = vec![("/a.tfw", text(WORLD)), ("/a.prj", text(PRJ))];
        let masked = [world.clone(), vec![("/a.tif.msk", mask())]].concat();
        for (files, is_masked) in
            [(world, false), (masked, true), (vec![("/a.tif.aux.xml", text(&metadata("")))], false)]
        {
            let server = serve(files, otherwise);
            lies(&PathBuf::from(format!("{}/a.tif?key=1.5", server.url)), &RasterOptions::default(), is_masked);
        }
    }
    // A server that fails says nothing about the file.
    let failing = serve(vec![], || Reply::new(503, ""));
    let error = Raster::read(&PathBuf::from(format!("{}/a.tif", failing.url))).err().unwrap().to_string();
    assert!(error.contains("503"), "{error}");
}

/// Coarse tiles take averages where the overviews have no mask.
#[test]
fn overviews_without_the_mask_of_the_image_are_not_used() {
    let folder = tempfile::tempdir().unwrap();
    let pixel = |side: u16, color: [u8; 3]| {
        let image = Image::new([side; 2], 8, 3, color.repeat(usize::from(side) * usize::from(side)));
        image.with(COMPRESSION, Values::Short(vec![1])).with(PHOTOMETRIC, Values::Short(vec![2]))
    };
    let full = pixel(512, [10, 200, 20]).at([8.0, 46.0], [0.001; 2]);
    // An overview in another colour, which shows that it is used.
    let overview = pixel(256, [250, 10, 10]).with(254, Values::Long(vec![1]));
    let dem = Image::new([65; 2], 16, 1, [1, 1].repeat(65 * 65)).at([8.0, 46.0], [0.008; 2]);
    let args = from_dem(folder.path(), "dem.tif", &tiff(vec![dem]));
    let imagery = folder.path().join("image.tif");
    fs::write(&imagery, tiff(vec![full, overview])).unwrap();
    let args = GenArgs { imagery: vec![imagery.clone()], levels: Some(1), overwrite: true, ..args };
    let color = || {
        run(&args).unwrap();
        image::open(args.out.join("0/0/0.jpg")).unwrap().into_rgb8().get_pixel(128, 128).0
    };
    // 512 pixels on 256 texels.
    let is_red = |c: [u8; 3]| c[0] > 150 && c[1] < 60;
    assert!(is_red(color()));
    let opaque = tiff(vec![Image::new([512; 2], 8, 1, vec![255; 512 * 512])]);
    fs::write(folder.path().join("image.tif.msk"), opaque).unwrap();
    let after = color();
    assert!(after[1] > 150 && after[0] < 60, "{after:?}");
}
