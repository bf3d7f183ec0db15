//! Fuzzes the readers of elevation and colour files: each input gives a raster or an error that names the file, never a
//! panic.

use std::path::Path;

use crate::files::{PLACE, heights, tiff_float32, tiff_int16};
use crate::sources::rasters;
use crate::sources::tile_archives::{pmtiles, terrarium};
use crate::tiffs::{COMPRESSION, Image, PHOTOMETRIC, Values, tiff};
use kit::fuzz::Parser;
use terrane::fetch::DECODER_PANICKED;
use terrane::formats::writers::write_height_exr;
use terrane_data_gen::{
    ElevationSource as _, Extent, GenArgs, GenError, HeightEncoding, Raster, RasterOptions, predict,
};

/// The largest raster whose blocks are read.
const MAX_SAMPLES: usize = 1 << 20;

/// Heights in the colours of [`terrarium`].
pub(super) fn terrarium_options() -> RasterOptions {
    RasterOptions { encoding: HeightEncoding::Terrarium, ..RasterOptions::default() }
}

pub(super) fn read(path: &Path, options: &RasterOptions) {
    match Raster::read_in(path, options) {
        Ok(raster) => {
            let [width, height] = raster.size();
            assert!(width * height > 0);
            assert!(raster.bounds().iter().all(|b| !b.is_nan()), "{:?}", raster.bounds());
            // Tiles may lie anywhere on the earth, with years of blocks between them.
            if width.saturating_mul(height) > MAX_SAMPLES {
                return;
            }
            // Blocks behind the first one may be broken.
            match raster.range_m() {
                Ok(range) => assert!(range.iter().all(|h| h.is_finite())),
                Err(error) => names_the_file(path, &error),
            }
            let everything = Extent { west: -10.0, south: -2.0, east: 10.0, north: 2.0 };
            if let Err(error) = raster.samples_in(&everything, &mut |_| ()) {
                names_the_file(path, &error);
            }
        }
        Err(error) => names_the_file(path, &error),
    }
}

/// The error may be that of a file beside it, with another extension.
pub(super) fn names_the_file(path: &Path, error: &GenError) {
    let text = error.to_string();
    assert!(text.contains(path.with_extension("").to_str().unwrap()), "{text}");
    assert!(!text.ends_with(DECODER_PANICKED), "{text}");
}

fn raster(name: &'static str, file: &str, world: bool, seeds: &[Vec<u8>]) -> Parser {
    let options = if file.ends_with("tiles") { terrarium_options() } else { RasterOptions::default() };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(file);
    if world {
        std::fs::write(path.with_extension("wld"), "0.001\n0\n0\n-0.001\n7.5\n46.5\n").unwrap();
    }
    Parser::new(name, seeds, move |bytes| {
        let _ = &folder;
        std::fs::write(&path, bytes).unwrap();
        read(&path, &options);
    })
}

fn geotiff() -> Parser {
    let seeds = [tiff_float32(&heights(), Some(PLACE), Some("-9999")), tiff_int16(&heights(), Some(PLACE), None)];
    raster("geotiff", "a.tif", false, &seeds)
}

fn elevation_png() -> Parser {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_fn(16, 16, |x, y| image::Rgb([1, 200 + x as u8, y as u8]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    raster("elevation-png", "a.png", true, &[png.into_inner()])
}

pub(super) fn exr() -> Vec<u8> {
    write_height_exr("t", 16, (0..256).map(|h| h as f32).collect()).unwrap()
}

fn elevation_exr() -> Parser {
    raster("elevation-exr", "a.exr", true, &[exr()])
}

fn ascii_grid() -> Parser {
    let header = "ncols 3\nnrows 2\nxllcorner 7\nyllcorner 45\ncellsize 0.5\nNODATA_value -1\n";
    raster("ascii-grid", "a.asc", false, &[format!("{header}1 2 3\n4 -1 6.5\n").into_bytes()])
}

fn netcdf() -> Parser {
    raster("netcdf", "a.nc", false, &rasters::netcdf::files())
}

fn erdas() -> Parser {
    raster("erdas", "a.img", false, &[rasters::erdas::usual_file()])
}

fn jpeg2000() -> Parser {
    raster("jpeg-2000", "a.jp2", true, &rasters::gdal::JPEG_2000.map(<[u8]>::to_vec))
}

fn isis() -> Parser {
    let cube = |is_tiled| rasters::planetary::cube(is_tiled, rasters::planetary::LATITUDES);
    raster("isis", "a.cub", false, &[cube(true), cube(false)])
}

/// Fuzzes the label; the samples beside it are few.
fn pds4() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.img");
    std::fs::write(&path, [7; 246]).unwrap();
    Parser::new("pds4", [rasters::planetary::label().into_bytes()], move |bytes| {
        std::fs::write(folder.path().join("a.xml"), bytes).unwrap();
        if let Ok(raster) = Raster::read(&path) {
            let _ = raster.range_m();
        }
    })
}

fn usgs_dem() -> Parser {
    raster("usgs-dem", "a.dem", false, &[rasters::gdal::USGS_DEM.to_vec()])
}

/// Fuzzes the document; the file that it resamples is small.
fn warped_raster() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.tif"), rasters::gdal::source()).unwrap();
    let path = folder.path().join("a.vrt");
    let seeds = ["Cubic", "Bilinear"].map(|resampling| rasters::gdal::warped(resampling).into_bytes());
    Parser::new("warped-raster", seeds, move |bytes| {
        std::fs::write(&path, bytes).unwrap();
        // Errors may be those of the source.
        if let Ok(raster) = Raster::read(&path)
            && raster.size().iter().product::<usize>() <= MAX_SAMPLES
        {
            let _ = (raster.range_m(), &folder);
        }
    })
}

fn surfer() -> Parser {
    raster("surfer", "a.grd", false, &rasters::grids::surfer())
}

fn points() -> Parser {
    raster("elevation-points", "a.xyz", false, &[b"7 46 1\n7.5 46 2\n7 46.5 3\n7.5 46.5 4\n".to_vec()])
}

fn dted() -> Parser {
    let mut bytes = format!("{:<47}00030002", "UHL10073000W0461500N03000300").into_bytes();
    bytes.resize(3428, b' ');
    for profile in 0..3 {
        bytes.extend([0xaa, 0, 0, profile, 0, profile, 0, 0, 1, profile, 0x80, 7, 0, 0, 0, 0]);
    }
    raster("elevation-dted", "a.dt1", false, &[bytes])
}

/// Fuzzes the header; the samples stay.
fn plain_samples() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bil");
    std::fs::write(&path, [7; 64]).unwrap();
    let place = "ulxmap 7\nulymap 46\nxdim 0.5\nydim 0.5";
    let seeds = [
        format!("nrows 2\nncols 3\nnbits 16\nbyteorder M\nlayout BIL\n{place}\n"),
        "ENVI\nsamples = 3\nlines = 2\nbands = 1\ndata type = 4\ninterleave = bsq\n\
         map info = {Geographic Lat/Lon, 1, 1, 7, 47, 0.5, 0.5, WGS-84}\n"
            .to_owned(),
    ];
    Parser::new("plain-samples", seeds.map(String::into_bytes), move |bytes| {
        let _ = &folder;
        std::fs::write(path.with_extension("hdr"), bytes).unwrap();
        read(&path, &RasterOptions::default());
    })
}

/// Fuzzes the document; its source is a small file.
fn virtual_raster() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.tif"), tiff_int16(&heights(), Some(PLACE), None)).unwrap();
    let path = folder.path().join("a.vrt");
    let seed = r#"<VRTDataset rasterXSize="40" rasterYSize="40"><GeoTransform>7, 0.1, 0, 47, 0, -0.1</GeoTransform>
        <VRTRasterBand dataType="Int16" band="1"><NoDataValue>-1</NoDataValue><ComplexSource>
        <SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>
        <SrcRect xOff="0" yOff="0" xSize="40" ySize="40"/><DstRect xOff="1" yOff="2" xSize="20" ySize="20"/>
        <NODATA>5</NODATA><ScaleRatio>2</ScaleRatio></ComplexSource></VRTRasterBand></VRTDataset>"#;
    Parser::new("virtual-raster", &[seed.as_bytes().to_vec()], move |bytes| {
        std::fs::write(&path, bytes).unwrap();
        // Errors may be those of a source.
        if let Ok(raster) = Raster::read(&path)
            && raster.size().iter().product::<usize>() <= MAX_SAMPLES
        {
            let _ = (raster.range_m(), &folder);
        }
    })
}

fn elevation_pmtiles() -> Parser {
    let tile = terrarium(300.0);
    let tiles = [(1, tile.clone()), (4, tile)];
    let archive = pmtiles(1, [-180.0, -85.0, 180.0, 85.0], &tiles);
    raster("elevation-pmtiles", "a.pmtiles", false, &[archive])
}

/// A SQLite database with the tables that most programs write.
fn mbtiles() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let seeds = [2, 4].map(|zoom: u32| {
        let path = folder.path().join(format!("{zoom}.mbtiles"));
        let database = rusqlite::Connection::open(&path).unwrap();
        let tables = "PRAGMA page_size = 512; CREATE TABLE metadata (name text, value text);
            INSERT INTO metadata VALUES ('format', 'png');
            CREATE TABLE map (zoom_level integer, tile_column integer, tile_row integer, tile_id text);
            CREATE TABLE images (tile_data blob, tile_id text);
            CREATE VIEW tiles AS SELECT zoom_level, tile_column, tile_row, tile_data FROM map
                JOIN images ON images.tile_id = map.tile_id;";
        database.execute_batch(tables).unwrap();
        database.execute("INSERT INTO images VALUES (?1, 'a')", [terrarium(9.0)]).unwrap();
        database.execute("INSERT INTO map VALUES (?1, 1, 1, 'a'), (?1, 2, 1, 'a')", [zoom]).unwrap();
        drop(database);
        std::fs::read(path).unwrap()
    });
    raster("mbtiles", "a.mbtiles", false, &seeds)
}

/// Returns a LERC2 blob (version 2) of 16 x 16 heights.
fn lerc2([low, high]: [f64; 2], payload: &[u8]) -> Vec<u8> {
    let mut blob = b"Lerc2 ".to_vec();
    // Version, rows, columns, valid pixels, side of a block, bytes of the blob, 32-bit floats.
    for number in [2, 16, 16, 256, 8, 62 + payload.len() as u32, 6] {
        blob.extend(number.to_le_bytes());
    }
    for number in [0.01, low, high] {
        blob.extend(f64::to_le_bytes(number));
    }
    // No mask.
    blob.extend([0; 4]);
    blob.extend(payload);
    blob
}

fn lerc() -> Parser {
    let raw: Vec<u8> = [1].into_iter().chain((0..256u16).flat_map(|h| f32::from(h).to_le_bytes())).collect();
    // Four blocks: heights of the lowest value, raw ones, one offset, and numbers of 2 bits from an offset.
    let mut blocks = vec![0, 2];
    blocks.push(0);
    blocks.extend((0..64u16).flat_map(|h| f32::from(h).to_le_bytes()));
    blocks.push(3);
    blocks.extend(7f32.to_le_bytes());
    blocks.push(1);
    blocks.extend([0; 4]);
    blocks.extend([0x82, 64]);
    blocks.extend([0x1b; 16]);
    let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut deflated, &lerc2([0.0, 255.0], &raw)).unwrap();
    let blobs = [
        (lerc2([0.0, 255.0], &raw), 0),
        (lerc2([0.0, 255.0], &blocks), 0),
        (lerc2([7.0, 7.0], &[]), 0),
        (deflated.finish().unwrap(), 1),
    ];
    let seeds = blobs.map(|(blob, deflated)| {
        let image = Image::new([16; 2], 32, 1, blob).at([7.5, 46.5], [0.001; 2]);
        let image = image.with(COMPRESSION, Values::Short(vec![34887])).with(339, Values::Short(vec![3]));
        tiff(vec![image.with(50674, Values::Long(vec![2, deflated]))])
    });
    raster("lerc", "a.tif", false, &seeds)
}

/// Tiles, planes, predictors, half floats, a palette, a mask and overviews.
fn tiff_layouts() -> Parser {
    let samples: Vec<u8> = (1..=1024u16).flat_map(u16::to_le_bytes).collect();
    let image = |bits: u16, strip: &[u8]| Image::new([32; 2], bits, 1, strip.to_vec()).at([7.5, 46.5], [0.001; 2]);
    let short = |value: u16| Values::Short(vec![value]);
    let mut tiled = image(16, &[]).with(322, short(16)).with(323, short(16)).with(COMPRESSION, short(8));
    tiled.blocks = samples
        .chunks(512)
        .map(|block| {
            let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
            std::io::Write::write_all(&mut deflated, block).unwrap();
            deflated.finish().unwrap()
        })
        .collect();
    tiled.blocks[2].clear();
    let overview = Image::new([16; 2], 16, 1, samples[..512].to_vec()).with(254, Values::Long(vec![1]));
    let mask = Image::new([32; 2], 8, 1, vec![255; 1024]).with(254, Values::Long(vec![4])).with(PHOTOMETRIC, short(4));
    // PackBits: runs of two equal bytes.
    let packed: Vec<u8> = (0..1024u16).flat_map(|k| [255, k as u8]).collect();
    let half = image(16, &samples).with(339, short(3)).with(317, short(1));
    let predicted = image(16, &samples).with(317, short(2)).nodata("7");
    let items = "<GDALMetadata><Item name=\"SCALE\" sample=\"0\" role=\"scale\">0.5</Item></GDALMetadata>\0";
    let seeds = [
        tiff(vec![tiled, overview, mask]),
        tiff(vec![image(16, &packed).with(COMPRESSION, short(32773))]),
        tiff(vec![half]),
        tiff(vec![predicted.with(42112, Values::Text(items.to_owned()))]),
        tiff(vec![image(4, &samples[..512])]),
    ];
    raster("tiff-layouts", "a.tif", false, &seeds)
}

/// HGT in a gzip and a zip file. A whole file has 3 MB; the seeds end early.
fn packed_hgt() -> Parser {
    use std::io::Write as _;
    let samples: Vec<u8> = (0..3000i16).flat_map(i16::to_be_bytes).collect();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&samples).unwrap();
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file("N46E007.hgt", zip::write::SimpleFileOptions::default()).unwrap();
    zip.write_all(&samples).unwrap();
    raster("packed-hgt", "N46E007.gz", false, &[gzip.finish().unwrap(), zip.finish().unwrap().into_inner()])
}

/// Pictures that colour terrain, with the place of a world file.
fn colour_files() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let dem = folder.path().join("dem.tif");
    std::fs::write(&dem, tiff_int16(&heights(), Some(PLACE), None)).unwrap();
    let path = folder.path().join("a.img");
    std::fs::write(path.with_extension("wld"), "0.004\n0\n0\n-0.004\n7.4\n46.6\n").unwrap();
    let picture = image::RgbaImage::from_fn(64, 64, |x, y| image::Rgba([x as u8, y as u8, 9, 200 + (x % 56) as u8]));
    let picture = image::DynamicImage::ImageRgba8(picture);
    let encoded = |format: image::ImageFormat, picture: &image::DynamicImage| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    let opaque = image::DynamicImage::ImageRgb8(picture.to_rgb8());
    let mut seeds = vec![
        encoded(image::ImageFormat::Png, &picture),
        encoded(image::ImageFormat::Jpeg, &opaque),
        encoded(image::ImageFormat::WebP, &picture),
        tiff(vec![Image::new([64; 2], 8, 3, opaque.to_rgb8().into_raw()).at([7.4, 46.6], [0.004; 2])]),
    ];
    seeds.extend(rasters::gdal::JPEG_2000_COLORS.map(<[u8]>::to_vec));
    Parser::new("colour-files", seeds, move |bytes| {
        std::fs::write(&path, bytes).unwrap();
        let args = GenArgs {
            dem: vec![dem.clone()],
            imagery: vec![path.clone()],
            levels: Some(1),
            jobs: Some(1),
            ..GenArgs::new(folder.path().join("set"))
        };
        if let Err(error) = predict(&args) {
            names_the_file(&path, &error);
        }
    })
}

kit::parsers! {
    geotiff,
    elevation_png,
    elevation_exr,
    ascii_grid,
    netcdf,
    erdas,
    jpeg2000,
    isis,
    pds4,
    usgs_dem,
    warped_raster,
    surfer,
    points,
    dted,
    plain_samples,
    virtual_raster,
    elevation_pmtiles,
    mbtiles,
    lerc,
    tiff_layouts,
    packed_hgt,
    colour_files,
}

/// Regression: all places of the finest level were tried, which took years.
#[test]
fn pmtiles_without_tiles_of_their_finest_level_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pmtiles");
    std::fs::write(&path, pmtiles(24, [-180.0, -85.0, 180.0, 85.0], &[(1, terrarium(300.0))])).unwrap();
    let error = Raster::read(&path).err().unwrap().to_string();
    assert!(error.contains("a.pmtiles: PMTiles: no tile of zoom level 24"), "{error}");
}

/// Regression: the reader allocated 48 GB and the process was killed.
#[test]
fn exr_with_a_huge_size_in_its_header_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    // This writer declares the number of blocks.
    let mut exr = std::io::Cursor::new(Vec::new());
    let channels = exr::prelude::SpecificChannels::build().with_channel("Y").with_pixel_fn(|_| (1.0f32,));
    let encoding = exr::prelude::Encoding {
        compression: exr::prelude::Compression::ZIP16,
        ..exr::prelude::Encoding::UNCOMPRESSED
    };
    let image = exr::prelude::Image::from_encoded_channels((16, 16), encoding, channels);
    exr::prelude::WritableImage::write(&image).to_buffered(&mut exr).unwrap();
    let mut exr = exr.into_inner();
    let after = |exr: &[u8], name: &[u8]| exr.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    for name in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = after(&exr, name);
        exr[at + 8..at + 16].copy_from_slice(&[0xff, 0xff, 1, 0, 0xff, 0xff, 1, 0]);
    }
    std::fs::write(&path, &exr).unwrap();
    let error = Raster::read(&path).err().unwrap().to_string();
    assert!(error.contains("a.exr: EXR: "), "{error}");
    // The same with as many blocks of 16 rows as the size needs.
    let at = after(&exr, b"chunkCount\0int\0");
    exr[at..at + 4].copy_from_slice(&8192u32.to_le_bytes());
    std::fs::write(&path, exr).unwrap();
    let error = Raster::read(&path).err().unwrap().to_string();
    assert!(error.contains("131072 x 131072"), "{error}");
}
