//! Writes tiles of heights, and PMTiles archives of them.

use std::io::Cursor;

/// Returns a Terrarium PNG of one height.
pub fn terrarium(height_m: f64) -> Vec<u8> {
    let value = ((height_m + 32768.0) * 256.0) as u32;
    let pixel = image::Rgb([(value >> 16) as u8, (value >> 8) as u8, value as u8]);
    let mut png = Cursor::new(Vec::new());
    image::RgbImage::from_pixel(8, 8, pixel).write_to(&mut png, image::ImageFormat::Png).unwrap();
    png.into_inner()
}

/// Returns a PMTiles archive (version 3) of tiles with increasing ids, all on one zoom level.
pub fn pmtiles(zoom: u8, bounds: [f64; 4], tiles: &[(u64, Vec<u8>)]) -> Vec<u8> {
    let mut directory = Vec::new();
    let mut number = |mut n: u64| {
        while n >= 128 {
            directory.push(n as u8 | 128);
            n >>= 7;
        }
        directory.push(n as u8);
    };
    number(tiles.len() as u64);
    let mut last = 0;
    for (id, _) in tiles {
        number(id - last);
        last = *id;
    }
    tiles.iter().for_each(|_| number(1));
    tiles.iter().for_each(|(_, bytes)| number(bytes.len() as u64));
    let mut offset = 0;
    for (_, bytes) in tiles {
        number(offset + 1);
        offset += bytes.len() as u64;
    }
    let mut file = b"PMTiles\x03".to_vec();
    let (root, data) = (directory.len() as u64, 127 + directory.len() as u64);
    // The spans of the root directory, the metadata, the leaf directories and the tiles; three counts.
    for number in [127, root, data, 0, data, 0, data, offset, 0, 0, 0] {
        file.extend(number.to_le_bytes());
    }
    // Clustered; no compression of directories and tiles; PNG; zoom levels.
    file.extend([1, 1, 1, 2, zoom, zoom]);
    file.extend(bounds.iter().flat_map(|degrees| ((degrees * 1e7) as i32).to_le_bytes()));
    file.resize(127, 0);
    file.extend(directory);
    tiles.iter().for_each(|(_, bytes)| file.extend(bytes));
    file
}
