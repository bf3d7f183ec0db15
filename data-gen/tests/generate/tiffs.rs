//! Writes TIFFs with the tags and blocks of a test's choice: sparse ones, masks, planes, palettes and JPEG.

use crate::files::geo_keys;

/// The values of a tag.
pub enum Values {
    Short(Vec<u16>),
    Long(Vec<u32>),
    Double(Vec<f64>),
    Text(String),
}

/// An image of a TIFF.
#[derive(Default)]
pub struct Image {
    pub size: [u16; 2],
    pub tags: Vec<(u16, Values)>,
    /// The bytes of its strips, or of its tiles if there is a tag TileWidth (322); empty ones are left out of the file.
    pub blocks: Vec<Vec<u8>>,
}

pub const PHOTOMETRIC: u16 = 262;
pub const COMPRESSION: u16 = 259;

impl Image {
    /// Creates an uncompressed image with a number of channels of some bits, in one strip.
    pub fn new(size: [u16; 2], bits: u16, channels: u16, strip: Vec<u8>) -> Self {
        let image = Self { size, tags: Vec::new(), blocks: vec![strip] };
        let image = image.with(256, Values::Short(vec![size[0]])).with(257, Values::Short(vec![size[1]]));
        let image = image.with(258, Values::Short(vec![bits; channels.into()]));
        let image = image.with(COMPRESSION, Values::Short(vec![1])).with(277, Values::Short(vec![channels]));
        image.with(PHOTOMETRIC, Values::Short(vec![if channels >= 3 { 2 } else { 1 }]))
    }

    /// Sets a tag.
    pub fn with(mut self, tag: u16, values: Values) -> Self {
        self.tags.retain(|(other, _)| *other != tag);
        self.tags.push((tag, values));
        self
    }

    /// Puts the north-western pixel's corner at a longitude and latitude in degrees.
    pub fn at(self, [west, north]: [f64; 2], [dx, dy]: [f64; 2]) -> Self {
        let image = self.with(33550, Values::Double(vec![dx, dy, 0.0]));
        let image = image.with(33922, Values::Double(vec![0.0, 0.0, 0.0, west, north, 0.0]));
        image.with(34735, Values::Short(geo_keys(&[[1024, 2], [1025, 1], [2048, 4326]])))
    }

    /// Sets the nodata value.
    pub fn nodata(self, value: &str) -> Self {
        self.with(42113, Values::Text(format!("{value}\0")))
    }
}

/// Returns a little-endian classic TIFF of images.
pub fn tiff(images: Vec<Image>) -> Vec<u8> {
    let mut file = b"II*\0\0\0\0\0".to_vec();
    let mut link = 4;
    for mut image in images {
        let mut offsets = Vec::new();
        let counts: Vec<u32> = image.blocks.iter().map(|block| block.len() as u32).collect();
        for block in &image.blocks {
            offsets.push(if block.is_empty() { 0 } else { file.len() as u32 });
            file.extend(block);
        }
        let is_tiled = image.tags.iter().any(|(tag, _)| *tag == 322);
        let [at, length] = if is_tiled { [324, 325] } else { [273, 279] };
        image = image.with(at, Values::Long(offsets)).with(length, Values::Long(counts));
        if !is_tiled && !image.tags.iter().any(|(tag, _)| *tag == 278) {
            let rows = image.size[1];
            image = image.with(278, Values::Short(vec![rows]));
        }
        image.tags.sort_by_key(|(tag, _)| *tag);
        let mut entries = Vec::new();
        for (tag, values) in &image.tags {
            let (kind, count, mut bytes): (u16, usize, Vec<u8>) = match values {
                Values::Short(v) => (3, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
                Values::Long(v) => (4, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
                Values::Double(v) => (12, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
                Values::Text(text) => (2, text.len(), text.clone().into_bytes()),
            };
            if bytes.len() > 4 {
                let offset = file.len() as u32;
                file.extend(&bytes);
                bytes = offset.to_le_bytes().to_vec();
            }
            bytes.resize(4, 0);
            entries.extend(tag.to_le_bytes());
            entries.extend(kind.to_le_bytes());
            entries.extend((count as u32).to_le_bytes());
            entries.extend(bytes);
        }
        let directory = file.len() as u32;
        file[link..link + 4].copy_from_slice(&directory.to_le_bytes());
        file.extend((image.tags.len() as u16).to_le_bytes());
        file.extend(entries);
        link = file.len();
        file.extend([0; 4]);
    }
    file
}
