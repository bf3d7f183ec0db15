//! Grids of Surfer and SAGA, and images of NASA's PDS.

use std::fs;

use terrane_data_gen::Raster;

use super::{at, check_bounds, error, usual};

/// The samples of 3 x 2 places from the south, of which one is blank.
const SAMPLES: [f64; 6] = [1.0, 2.0, 3.0, 11.5, 1.701_41e38, 13.0];

/// Returns the bytes of grids of Surfer: text, version 6 and version 7.
pub fn surfer() -> [Vec<u8>; 3] {
    let text = format!("DSAA\r\n3 2\r\n7 8\r\n45 45.25\r\n1 13\r\n{}\r\n", SAMPLES.map(|s| s.to_string()).join(" "));
    let doubles = |numbers: &[f64]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
    let mut six = b"DSBB".to_vec();
    six.extend([3u16, 2].into_iter().flat_map(u16::to_le_bytes));
    six.extend(doubles(&[7.0, 8.0, 45.0, 45.25, 1.0, 13.0]));
    six.extend(SAMPLES.into_iter().flat_map(|s| (s as f32).to_le_bytes()));
    let mut seven = b"DSRB\x04\0\0\0\x01\0\0\0GRID\x48\0\0\0".to_vec();
    seven.extend([2u32, 3].into_iter().flat_map(u32::to_le_bytes));
    seven.extend(doubles(&[7.0, 45.0, 0.5, 0.25, 1.0, 13.0, 0.0, 1.701_41e38]));
    seven.extend(b"DATA\x30\0\0\0");
    seven.extend(doubles(&SAMPLES));
    [text.into_bytes(), six, seven]
}

#[test]
fn grids_of_surfer_begin_in_the_south() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.grd");
    for bytes in surfer() {
        fs::write(&path, &bytes).unwrap();
        let raster = Raster::read(&path).unwrap();
        assert_eq!(raster.range_m().unwrap(), [1.0, 13.0]);
        check_bounds(&raster, [7.0, 45.0, 8.0, 45.25]);
        assert_eq!([at(&raster, 7.0, 45.0), at(&raster, 8.0, 45.0), at(&raster, 7.0, 45.25)], [1.0, 3.0, 11.5]);
        assert!(at(&raster, 7.5, 45.25).is_nan());
        for cut in 4..bytes.len() - 6 {
            fs::write(&path, &bytes[..cut]).unwrap();
            error(&path, &usual());
        }
    }
    let [text, _, seven] = surfer();
    let turned = [&seven[..76], &8.0f64.to_le_bytes(), &seven[84..]].concat();
    let words = String::from_utf8(text).unwrap();
    for (bytes, why) in [
        (turned, "a rotated grid"),
        (words.replace("3 2", "3 -2").into_bytes(), "3 x -2 samples"),
        (words.replace("3 2", "30000 20000").into_bytes(), "bytes for 30000 x 20000 samples"),
        (words.replace("7 8", "8 7").into_bytes(), "its first sample is at 8"),
        (words.replace("11.5", "high").into_bytes(), "a sample is `high`"),
    ] {
        fs::write(&path, bytes).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
}

#[test]
fn grids_of_saga_are_placed_by_their_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.sdat");
    let samples = [10i16, 20, 30, 110, -9999, 130];
    fs::write(&path, samples.map(i16::to_be_bytes).concat()).unwrap();
    let header = "NAME\t= b\nUNIT\t= ft\nDATAFILE_OFFSET\t= 0\nDATAFORMAT\t= SHORTINT\nBYTEORDER_BIG\t= TRUE\nPOSITION_XMIN\t= 7.25\n\
                  POSITION_YMIN\t= 45.25\nCELLCOUNT_X\t= 3\nCELLCOUNT_Y\t= 2\nCELLSIZE\t= 0.5\nZ_FACTOR\t= 10.0\n\
                  NODATA_VALUE\t= -9999.0\nTOPTOBOTTOM\t= FALSE\n";
    let beside = path.with_extension("sgrd");
    fs::write(&beside, header).unwrap();
    let raster = Raster::read(&path).unwrap();
    check_bounds(&raster, [7.25, 45.25, 8.25, 45.75]);
    assert!((at(&raster, 8.25, 45.25) - 91.44).abs() < 1e-3 && at(&raster, 7.75, 45.75).is_nan());
    fs::write(&beside, header.replace("TOPTOBOTTOM\t= FALSE", "TOPTOBOTTOM\t= TRUE")).unwrap();
    assert!((at(&Raster::read(&path).unwrap(), 8.25, 45.75) - 91.44).abs() < 1e-3);
    for (changed, why) in [
        (header.replace("CELLCOUNT_X\t= 3", "CELLCOUNT_X\t= 4"), "12 bytes for 4 x 2 samples"),
        (header.replace("SHORTINT", "BIT"), "samples of the format BIT"),
        (header.replace("CELLSIZE", "SIZE"), "no CELLSIZE in the header"),
        (header.replace("= ft", "= K"), "heights in units of `K`"),
    ] {
        fs::write(&beside, changed).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
    fs::remove_file(beside).unwrap();
    assert!(error(&path, &usual()).contains("nor plain samples with a .hdr, .sgrd, .lbl or .xml file"));
}

#[test]
fn images_of_the_pds_are_heights_above_the_radius() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ldem.img");
    let samples = [0i16, 0, 0, 10, 20, 30, 110, -9999, 130];
    fs::write(&path, samples.map(i16::to_le_bytes).concat()).unwrap();
    let label = "CCSD3ZF0000100000001NJPL3IF0PDS200000001 = SFDU_LABEL\r\nPDS_VERSION_ID = PDS3\r\nRECORD_BYTES = 6\r\n^IMAGE = (\"LDEM.IMG\", 2)\r\nOBJECT = IMAGE\r\n  LINES = 2\r\n\
                 LINE_SAMPLES = 3 /* columns */\r\n  SAMPLE_TYPE = LSB_INTEGER\r\n  SAMPLE_BITS = 16\r\n  UNIT = METER\r\n\
                 SCALING_FACTOR = 0.5\r\n  OFFSET = 1737400.\r\n  MISSING_CONSTANT = -9999\r\nEND_OBJECT = IMAGE\r\n\
                 OBJECT = IMAGE_MAP_PROJECTION\r\n  MAP_PROJECTION_TYPE = \"SIMPLE CYLINDRICAL\"\r\n\
                 A_AXIS_RADIUS = 1737.4 <KM>\r\n  C_AXIS_RADIUS = 1737.4 <KM>\r\n  MAP_RESOLUTION = 2 <PIX/DEG>\r\n\
                 WESTERNMOST_LONGITUDE = 7 <DEG>\r\n  EASTERNMOST_LONGITUDE = 8.5 <DEG>\r\n  MINIMUM_LATITUDE = 45 <DEG>\r\n\
                 MAXIMUM_LATITUDE = 46 <DEG>\r\nEND_OBJECT = IMAGE_MAP_PROJECTION\r\nEND\r\n";
    let beside = path.with_extension("lbl");
    fs::write(&beside, label).unwrap();
    let raster = Raster::read(&path).unwrap();
    check_bounds(&raster, [7.25, 45.25, 8.25, 45.75]);
    assert_eq!([at(&raster, 7.25, 45.75), at(&raster, 8.25, 45.25)], [5.0, 65.0]);
    assert!(at(&raster, 7.75, 45.25).is_nan());
    for (changed, why) in [
        (label.replace("SIMPLE CYLINDRICAL", "POLAR STEREOGRAPHIC"), "the projection `POLAR STEREOGRAPHIC`"),
        (label.replace("LINES = 2", "LINES = 3"), "3 x 3 samples, and its edges have room for 3 x 2"),
        (label.replace("LSB_INTEGER", "VAX_REAL"), "samples of 16 bits VAX_REAL"),
        (label.replace("C_AXIS_RADIUS", "C"), "no C_AXIS_RADIUS of the IMAGE_MAP_PROJECTION"),
        (label.replace("\"LDEM.IMG\", 2", "\"LDEM.IMG\", 9"), "18 bytes for 3 x 2 samples"),
    ] {
        fs::write(&beside, changed).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
    fs::write(&beside, label).unwrap();
    assert!(error(&beside, &usual()).contains("name the file of its samples"));
}
