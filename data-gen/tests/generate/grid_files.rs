//! Writes grids of PROJ: datum shifts as NTv2, and channels over longitude and latitude as GeoTIFF.

use crate::tiffs::{Image, Values, tiff};

/// Returns an NTv2 grid of one shift in seconds, north and east, over degrees: west, south, east and north.
pub fn ntv2(shift: [f32; 2], [west, south, east, north]: [f64; 4], is_little: bool) -> Vec<u8> {
    let mut file = Vec::new();
    let int = |n: u32| if is_little { n.to_le_bytes() } else { n.to_be_bytes() };
    let double = |n: f64| if is_little { n.to_le_bytes() } else { n.to_be_bytes() };
    let single = |n: f32| if is_little { n.to_le_bytes() } else { n.to_be_bytes() };
    let mut record = |key: &str, value: &[u8]| {
        file.extend(format!("{key:8}").bytes());
        file.extend(value);
        file.resize(file.len().next_multiple_of(16), 0);
    };
    for (key, n) in [("NUM_OREC", 11), ("NUM_SREC", 11), ("NUM_FILE", 1)] {
        record(key, &int(n));
    }
    for (key, text) in
        [("GS_TYPE", "SECONDS "), ("VERSION", "TEST    "), ("SYSTEM_F", "DHDN    "), ("SYSTEM_T", "ETRS89  ")]
    {
        record(key, text.as_bytes());
    }
    for key in ["MAJOR_F", "MINOR_F", "MAJOR_T", "MINOR_T"] {
        record(key, &double(6_377_000.0));
    }
    for (key, text) in
        [("SUB_NAME", "A       "), ("PARENT", "NONE    "), ("CREATED", "        "), ("UPDATED", "        ")]
    {
        record(key, text.as_bytes());
    }
    let seconds = [south, north, -east, -west, 1.0, 1.0].map(|degrees| degrees * 3600.0);
    for (key, n) in ["S_LAT", "N_LAT", "E_LONG", "W_LONG", "LAT_INC", "LONG_INC"].into_iter().zip(seconds) {
        record(key, &double(n));
    }
    let points = ((east - west + 1.0) * (north - south + 1.0)) as u32;
    record("GS_COUNT", &int(points));
    for _ in 0..points {
        for n in [shift[0], -shift[1], 0.0, 0.0] {
            file.extend(single(n));
        }
    }
    file.extend(b"END     \0\0\0\0\0\0\0\0");
    file
}

/// Returns a GeoTIFF of PROJ with channels of one value each, over degrees: west, south, east and north.
pub fn grid_tiff(channels: &[(f32, &str)], [west, south, east, north]: [f64; 4], items: &str) -> Vec<u8> {
    let [columns, rows] = [east - west + 1.0, north - south + 1.0].map(|n| n as u16);
    let point: Vec<u8> = channels.iter().flat_map(|(value, _)| value.to_le_bytes()).collect();
    let count = channels.len() as u16;
    let image = Image::new([columns, rows], 32, count, point.repeat(usize::from(columns) * usize::from(rows)));
    let described = channels
        .iter()
        .enumerate()
        .map(|(k, (_, name))| format!("<Item name=\"DESCRIPTION\" sample=\"{k}\" role=\"description\">{name}</Item>"));
    let xml = format!("<GDALMetadata>{}{items}</GDALMetadata>\0", described.collect::<String>());
    let image = image.at([west - 0.5, north + 0.5], [1.0; 2]).with(339, Values::Short(vec![3; channels.len()]));
    tiff(vec![image.with(262, Values::Short(vec![1])).with(42112, Values::Text(xml))])
}
