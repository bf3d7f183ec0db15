//! Files that GDAL 3.6 wrote: JPEG 2000 and USGS DEM; and warped virtual rasters, with the values that GDAL reads from them.

use std::fs;

use super::{at, check_bounds, error, usual};
use crate::sources::tile_archives::terrarium;
use crate::tiffs::{Image, tiff};
use terrane_data_gen::{HeightEncoding, Raster, RasterOptions};

/// 12 x 10 signed samples of `-300 + 37 x - 11 y²`: placed by GeoJP2 in UTM, by GMLJP2 in degrees, and without boxes.
pub const JPEG_2000: [&[u8]; 3] = [include_bytes!("geo.jp2"), include_bytes!("gml.jp2"), include_bytes!("raw.j2k")];
/// Small images: RGB, RGB with opacity in 16 bits, and a palette.
pub const JPEG_2000_COLORS: [&[u8]; 3] =
    [include_bytes!("rgb.jp2"), include_bytes!("rgba16.jp2"), include_bytes!("palette.jp2")];
/// 5 x 6 heights in UTM.
pub const USGS_DEM: &[u8] = include_bytes!("small.dem");

#[test]
fn jpeg_2000_is_placed_by_its_boxes() {
    let folder = tempfile::tempdir().unwrap();
    let [geo, gml, raw] = JPEG_2000;
    let path = folder.path().join("a.jp2");
    fs::write(&path, gml).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([12, 10], [-1191.0, 107.0]));
    check_bounds(&raster, [7.005, 46.405, 7.115, 46.495]);
    for (column, row) in [(0, 0), (11, 0), (5, 4), (0, 9), (11, 9)] {
        let found = at(&raster, 7.005 + 0.01 * f64::from(column), 46.495 - 0.01 * f64::from(row));
        assert!((found - (-300 + 37 * column - 11 * row * row) as f32).abs() < 0.01, "{found} at {column}, {row}");
    }
    fs::write(&path, geo).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!(raster.range_m().unwrap(), [-1191.0, 107.0]);
    // The middle of the first pixel, 500015 5199985, as PROJ converts it.
    assert!((raster.bounds()[3].to_degrees() - 46.953_394).abs() < 1e-5, "{:?}", raster.bounds().map(f64::to_degrees));
    assert!((at(&raster, 9.000_197_1, 46.953_393_9) + 300.0).abs() < 1.0);
    // Without boxes, a world file says where it is; without that, an error says what is missing.
    fs::write(&path, raw).unwrap();
    assert!(error(&path, &usual()).contains("no georeference: neither GeoJP2, GMLJP2, nor a world file"));
    fs::write(path.with_extension("wld"), "0.01\n0\n0\n-0.01\n7.005\n46.495\n").unwrap();
    check_bounds(&Raster::read(&path).unwrap(), [7.005, 46.405, 7.115, 46.495]);
    let voids = RasterOptions { nodata: Some(107.0), ..usual() };
    assert_eq!(Raster::read_in(&path, &voids).unwrap().range_m().unwrap(), [-1191.0, 96.0]);
    // A huge size in the header is refused before anything is allocated.
    let mut huge = raw.to_vec();
    huge[8..16].fill(0x7f);
    fs::write(&path, huge).unwrap();
    assert!(error(&path, &usual()).contains("samples are decoded at once"));
    let two = RasterOptions { channel: Some("2".to_owned()), ..usual() };
    fs::write(&path, raw).unwrap();
    assert!(error(&path, &two).contains("--channel 2: the file has components 1 to 1"));
}

#[test]
fn usgs_dem_has_profiles_from_the_south() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.dem");
    let lines: Vec<u8> = USGS_DEM.chunks(1024).flat_map(|record| [record, b"\r\n"].concat()).collect();
    for bytes in [USGS_DEM, &lines] {
        fs::write(&path, bytes).unwrap();
        let raster = Raster::read(&path).unwrap();
        assert_eq!((raster.size(), raster.range_m().unwrap()), ([5, 6], [425.0, 848.0]));
        // 500000 5200000, as PROJ converts it: the north-western height. GDAL moves profiles to whole steps, 10 m to the south.
        assert!((at(&raster, 9.0, 46.953_529) - 700.0).abs() < 1.0, "{}", at(&raster, 9.0, 46.953_529));
    }
    for (bytes, why) in [
        (USGS_DEM[..3000].to_vec(), "profile 3 of 5 has no"),
        (
            [&USGS_DEM[..1024 + 12], b"  -146", &USGS_DEM[1024 + 18..]].concat(),
            "profile 1 of 5 has no number of heights",
        ),
        ([&USGS_DEM[..156], b"     2", &USGS_DEM[162..]].concat(), "a reference system that is not supported"),
        ([&USGS_DEM[..1024 + 150], b"  high", &USGS_DEM[1024 + 156..]].concat(), "height 2 of profile 1 is no number"),
    ] {
        fs::write(&path, bytes).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
}

/// Returns the file of [`warped`]: `1000 + 37 x + 11 y²`, and one sample without data.
pub fn source() -> Vec<u8> {
    let value = |k: u16| if k == 4 * 12 + 7 { 0 } else { 1000 + 37 * (k % 12) + 11 * (k / 12) * (k / 12) };
    tiff(vec![
        Image::new([12, 10], 16, 1, (0..120).flat_map(|k| value(k).to_le_bytes()).collect())
            .at([7.5, 46.5], [0.001; 2]),
    ])
}

/// Returns a virtual raster that GDAL warped from UTM.
pub fn warped(resampling: &str) -> String {
    format!(
        r#"<VRTDataset rasterXSize="14" rasterYSize="11" subClass="VRTWarpedDataset"><SRS>EPSG:4326</SRS>
        <GeoTransform>9.0002, 3.071428571429026e-04, 0, 46.9533, 0, -2.3636363636373144e-04</GeoTransform>
        <VRTRasterBand dataType="Float32" band="1" subClass="VRTWarpedRasterBand"><NoDataValue>0</NoDataValue></VRTRasterBand>
        <GDALWarpOptions><ResampleAlg>{resampling}</ResampleAlg><Option name="INIT_DEST">NO_DATA</Option>
        <SourceDataset relativeToVRT="1">a.tif</SourceDataset><Transformer><ApproxTransformer><MaxError>0.125</MaxError>
        <BaseTransformer><GenImgProjTransformer><SrcGeoTransform>500000,30,0,5200000,0,-30</SrcGeoTransform>
        <ReprojectTransformer><ReprojectionTransformer><SourceSRS>EPSG:32632</SourceSRS><TargetSRS>EPSG:4326</TargetSRS>
        </ReprojectionTransformer></ReprojectTransformer></GenImgProjTransformer></BaseTransformer></ApproxTransformer>
        </Transformer><BandList><BandMapping src="1" dst="1"><SrcNoDataReal>0</SrcNoDataReal></BandMapping></BandList>
        </GDALWarpOptions></VRTDataset>"#
    )
}

#[test]
fn warped_virtual_rasters_have_the_values_of_gdal() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.tif"), source()).unwrap();
    let path = folder.path().join("a.vrt");
    let places = [(0, 0), (3, 2), (6, 5), (10, 8)];
    // GDAL 3.6 reads these values from it.
    for (resampling, values) in [
        ("NearestNeighbour", [1011.0, 1210.0, 1460.0, 2000.0]),
        ("Bilinear", [1023.34, 1174.74, 1482.52, 1972.43]),
        ("Cubic", [1023.34, 1172.0, 1482.52, 1970.61]),
    ] {
        fs::write(&path, warped(resampling)).unwrap();
        let raster = Raster::read(&path).unwrap();
        assert_eq!(raster.size(), [14, 11]);
        let sample = |column: i32, row: i32| {
            let (column, row) = (f64::from(column) + 0.5, f64::from(row) + 0.5);
            at(&raster, 9.0002 + column * 0.004_3 / 14.0, 46.9533 - row * 0.0026 / 11.0)
        };
        for ((column, row), value) in places.into_iter().zip(values) {
            let found = sample(column, row);
            assert!((found - value).abs() < 0.02, "{resampling}: {found}, not {value}, at {column}, {row}");
        }
        // Without data, and outside of the file.
        assert!([(8, 4), (9, 4), (13, 10)].into_iter().all(|(column, row)| sample(column, row).is_nan()));
    }
    let whole = warped("Bilinear");
    for (text, why) in [
        (warped("Lanczos"), "`ResampleAlg Lanczos` is not supported"),
        (whole.replace("<BandList>", "<Cutline>POLYGON EMPTY</Cutline><BandList>"), "`Cutline` is not supported"),
        (whole.replace("GenImgProjTransformer", "GCPTransformer"), "without GenImgProjTransformer"),
        (whole.replace("30,0,5200000", "30,5200000"), "SrcGeoTransform has not 6 numbers"),
        (whole.replace("dst=\"1\"", "dst=\"2\""), "no BandMapping of band 1"),
        (whole.replace("a.tif", "a.vrt"), "or a loop of them"),
    ] {
        fs::write(&path, text).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
}

/// Regression: rows of a folder that `mb-util` wrote were counted from the north, so that the tiles lay on the other hemisphere.
#[test]
fn folders_of_web_tiles_name_their_scheme() {
    let folder = tempfile::tempdir().unwrap();
    let column = folder.path().join("7/66");
    fs::create_dir_all(&column).unwrap();
    fs::write(column.join("44.png"), terrarium(300.0)).unwrap();
    let options = RasterOptions { encoding: HeightEncoding::Terrarium, ..usual() };
    let south = || {
        let raster = Raster::read_in(folder.path(), &options).unwrap();
        assert_eq!(raster.range_m().unwrap(), [300.0; 2]);
        raster.bounds()[1].to_degrees()
    };
    assert!((45.0..50.0).contains(&south()), "{}", south());
    for (file, text, is_tms) in [
        ("metadata.json", r#"{"name": "a", "scheme": "tms"}"#, true),
        ("metadata.json", r#"{"name": "a", "scheme": "xyz"}"#, false),
        ("metadata.json", "no JSON", false),
        ("tiles.json", r#"{"scheme": "tms"}"#, true),
    ] {
        fs::write(folder.path().join(file), text).unwrap();
        assert_eq!((-50.0..-45.0).contains(&south()), is_tms, "{file}: {text}");
    }
    fs::rename(column.join("44.png"), column.join("44@2x.png")).unwrap();
    assert!((-50.0..-45.0).contains(&south()), "{}", south());
}
