//! Erdas Imagine.

use std::fs;

use terrane_data_gen::{Raster, RasterOptions};

use super::{at, check_bounds, error, usual};

/// Writes the tree of a file: entries and their contents.
struct Tree(Vec<u8>);

impl Tree {
    fn add(&mut self, bytes: &[u8]) -> u32 {
        let at = self.0.len() as u32;
        self.0.extend(bytes);
        at
    }

    /// Adds an entry whose next sibling and first child were added before.
    fn entry(&mut self, name: &str, kind: &str, content: &[u8], next: u32, child: u32) -> u32 {
        let data = self.add(content);
        let mut bytes: Vec<u8> = longs(&[next, 0, 0, child, data, content.len() as u32]);
        for (text, length) in [(name, 64), (kind, 32)] {
            let mut field = text.as_bytes().to_vec();
            field.resize(length, 0);
            bytes.extend(field);
        }
        bytes.extend([0; 8]);
        self.add(&bytes)
    }
}

fn longs(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.to_le_bytes()).collect()
}

fn doubles(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.to_le_bytes()).collect()
}

fn text(text: &str) -> Vec<u8> {
    [longs(&[text.len() as u32 + 1, 0]), text.as_bytes().to_vec(), vec![0]].concat()
}

/// Returns a compressed block: the lowest value, the number of runs, where values begin, the bits of each.
fn packed(low: i32, runs: u32, values_at: u32, bits: u8, rest: &[u8]) -> Vec<u8> {
    [longs(&[low as u32, runs, values_at]), vec![bits], rest.to_vec()].concat()
}

/// Returns a file of 7 x 6 samples in blocks of 4 x 4: one plain, one of runs, one of few bits, one that was never written.
fn file(system: &[u8]) -> Vec<u8> {
    let plain: Vec<u8> = (0..16i16).flat_map(|k| (100 + k).to_le_bytes()).collect();
    // 12 times 207, then 4 times 300.
    let runs = packed(200, 2, 15, 8, &[12, 4, 7, 100]);
    // Each sample has two bits: 0, 1, 2, 3 and so on are added to the lowest value, -5 in 16 bits.
    let few = packed(65_531, u32::MAX, 0, 2, &[0b1110_0100; 4]);
    let mut tree = Tree(b"EHFA_HEADER_TAG\0".to_vec());
    tree.add(&[0; 22]);
    let mut table = Vec::new();
    for (bytes, is_valid, compression) in [(&plain, 1u8, 0u8), (&runs, 1, 1), (&few, 1, 1), (&plain, 0, 0)] {
        let at = tree.add(bytes);
        table.extend([0, 0]);
        table.extend(longs(&[at, bytes.len() as u32]));
        table.extend([is_valid, 0, compression, 0]);
    }
    let table_at = tree.0.len() as u32 + 22;
    let state = [longs(&[4, 16, 64]), vec![0, 0], longs(&[4, table_at]), table].concat();
    let blocks = tree.entry("RasterDMS", "Edms_State", &state, 0, 0);
    assert_eq!(&tree.0[table_at as usize - 8..][..4], &[4, 0, 0, 0]);
    let datum = tree.entry("Datum", "Eprj_Datum", &text("WGS 84"), 0, 0);
    let projection = tree.entry("Projection", "Eprj_ProParameters", system, blocks, datum);
    let pair = |a: f64, b: f64| [longs(&[1, 0]), doubles(&[a, b])].concat();
    let map = [text("map"), pair(7.25, 46.75), pair(10.25, 44.25), pair(0.5, 0.5)].concat();
    let map = tree.entry("Map_Info", "Eprj_MapInfo", &map, projection, 0);
    let unknown = [longs(&[1, 0, 1, 1]), vec![10, 0, 0, 0], doubles(&[-4.0])].concat();
    let unknown = tree.entry("Eimg_NonInitializedValue", "Eimg_NonInitializedValue", &unknown, map, 0);
    let layer = [longs(&[7, 6]), vec![1, 0, 6, 0], longs(&[4, 4])].concat();
    let layer = tree.entry("Layer_1", "Eimg_Layer", &layer, 0, unknown);
    let root = tree.entry("root", "root", &[], 0, layer);
    let header = tree.add(&[longs(&[1, 0, root]), vec![128, 0], longs(&[0])].concat());
    tree.0[16..20].copy_from_slice(&header.to_le_bytes());
    tree.0
}

/// Returns a file in degrees.
pub fn usual_file() -> Vec<u8> {
    file(&projection(0, 0, [0.0; 15]))
}

/// Returns the parameters of a projection.
fn projection(number: u32, zone: u32, parameters: [f64; 15]) -> Vec<u8> {
    let sphere = [longs(&[1, 0]), text("WGS 84"), doubles(&[6_378_137.0, 6_356_752.3])].concat();
    let [exe, name] = [text(""), text("projection")];
    [vec![0, 0], longs(&[number]), exe, name, longs(&[zone, 15, 0]), doubles(&parameters), sphere].concat()
}

fn at_pixel(raster: &Raster, column: f64, row: f64) -> f32 {
    at(raster, 7.25 + 0.5 * column, 46.75 - 0.5 * row)
}

#[test]
fn blocks_of_each_kind_are_decoded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ned.img");
    let whole = usual_file();
    fs::write(&path, &whole).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([7, 6], [-5.0, 300.0]));
    check_bounds(&raster, [7.25, 44.25, 10.25, 46.75]);
    let pixel = |column: f64, row: f64| at_pixel(&raster, column, row);
    assert_eq!([pixel(0.0, 0.0), pixel(3.0, 2.0), pixel(1.0, 3.0)], [100.0, 111.0, 113.0]);
    assert_eq!([pixel(4.0, 0.0), pixel(6.0, 2.0), pixel(5.0, 3.0)], [207.0, 207.0, 300.0]);
    assert_eq!([pixel(0.0, 4.0), pixel(2.0, 5.0), pixel(3.0, 4.0)], [-5.0, -3.0, -2.0]);
    // The value without data, and the block that was never written.
    assert!(pixel(1.0, 4.0).is_nan() && pixel(5.0, 4.0).is_nan());
    let other = RasterOptions { channel: Some("2".to_owned()), ..usual() };
    assert!(error(&path, &other).contains("--channel 2: the file has bands 1 to 1"));
    for cut in (0..whole.len()).step_by(3) {
        if cut >= 15 {
            fs::write(&path, &whole[..cut]).unwrap();
            error(&path, &usual());
        }
        let mut damaged = whole.clone();
        damaged[cut] ^= 0x5a;
        fs::write(&path, damaged).unwrap();
        let _ = Raster::read(&path).and_then(|raster| raster.range_m());
    }
}

/// Files of more than 2 GB have their samples in another one.
#[test]
fn blocks_are_read_from_the_file_beside() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.img");
    let mut whole = file(&projection(0, 0, [0.0; 15]));
    // The second of two bands, in a file that was written elsewhere.
    let name = "C:\\data\\large.ige";
    let content = [text(name), longs(&[4, 0, 100, 0, 2, 1])].concat();
    let at = whole.len() as u32;
    whole.extend(&content);
    let entry = whole.windows(10).position(|w| w == b"RasterDMS\0").unwrap();
    whole[entry..][..18].copy_from_slice(b"ExternalRasterDMS\0");
    whole[entry - 8..][..8].copy_from_slice(&longs(&[at, content.len() as u32]));
    fs::write(&path, &whole).unwrap();
    assert!(error(&path, &usual()).contains("large.ige"));
    let mut samples = vec![0; 100];
    // A byte of flags for each row of blocks: the last block was never written.
    samples[24..26].copy_from_slice(&[0b11, 0b01]);
    for k in 0..8i16 {
        samples.extend((0..16).flat_map(|_| (10 * k).to_le_bytes()));
    }
    let beside = folder.path().join("large.ige");
    fs::write(&beside, &samples).unwrap();
    let raster = Raster::read(&path).unwrap();
    let pixel = |column: f64, row: f64| at_pixel(&raster, column, row);
    assert_eq!([pixel(0.0, 0.0), pixel(5.0, 1.0), pixel(2.0, 5.0)], [10.0, 30.0, 50.0]);
    assert!(pixel(5.0, 5.0).is_nan());
    fs::write(&beside, &samples[..280]).unwrap();
    assert!(error(&path, &usual()).contains("and more are needed"));
}

#[test]
fn projections_are_read_by_their_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("utm.img");
    let mut parameters = [0.0; 15];
    parameters[3] = -1.0;
    fs::write(&path, file(&projection(1, 33, parameters))).unwrap();
    // UTM's zone 33 in the south: the origin of its coordinates is at the pole.
    let [_, south, ..] = Raster::read(&path).unwrap().bounds().map(f64::to_degrees);
    assert!(south < -85.0, "{south}");
    fs::write(&path, file(&projection(27, 0, [0.0; 15]))).unwrap();
    assert!(error(&path, &usual()).contains("the projection with the number 27; --epsg CODE"));
    let given = RasterOptions { crs: Some(terrane_data_gen::Crs::Geographic), ..usual() };
    check_bounds(&Raster::read_in(&path, &given).unwrap(), [7.25, 44.25, 10.25, 46.75]);
}
