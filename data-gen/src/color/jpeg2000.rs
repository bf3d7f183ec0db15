//! JPEG 2000 with colours, such as those of Sentinel-2. A thread of the run decodes the image as a whole.

use std::path::Path;
use std::sync::Arc;

use hayro_jpeg2000::ComponentData;

use super::levels::{Level, Opened};
use crate::GenError;
use crate::georeference::{Crs, Metadata};
use crate::jpeg2000::Jpeg2000;
use crate::store::{BlockCache, PixelImage, WholeReader, whole};

/// The largest number of samples of all components, which are decoded at once and take 4 bytes each: those of the colours of a
/// tile of Sentinel-2 (10,980 x 10,980).
const MAX_SAMPLES: u64 = 3 * 11_000 * 11_000;
/// The most bits of a sample, and the most columns or rows with one sample of a component.
const MAX_BITS: u8 = 16;
const MAX_SPACING: u8 = 4;

/// A file with colours.
struct Colors {
    file: Jpeg2000,
    /// The samples of the components where there are no data.
    nodata: Option<Vec<f32>>,
}

/// Opens a file and reads its boxes. `given` is the reference system of files that do not name their own.
pub(super) fn open(path: &Path, given: Option<Crs>, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let file = Jpeg2000::open(path, MAX_SAMPLES)?;
    for component in &file.header.components {
        let is_read = !component.is_signed
            && component.bits <= MAX_BITS
            && component.spacing.iter().all(|spacing| (1..=MAX_SPACING).contains(spacing));
        if !is_read {
            let (bits, [wider, higher]) = (component.bits, component.spacing);
            let kind = if component.is_signed { "signed" } else { "unsigned" };
            let reason =
                format!("{kind} samples of {bits} bits, one in {wider} x {higher} pixels, which are no colours");
            return Err(file.bad(&reason));
        }
    }
    let metadata = Metadata::beside(path, cache)?;
    let placement = file.placement(given, &metadata, cache)?.unwrap_or_default();
    let bands = 1..=file.header.components.len();
    let nodata = bands.map(|band| metadata.nodata_of(band).map(|nodata| nodata as f32)).collect();
    let size = file.header.size;
    let (grid, reader) = whole(Box::new(Colors { file, nodata }), size, cache);
    Ok(Opened { levels: vec![Level::finest(PixelImage::new(grid, reader, cache))], placement })
}

/// Returns the pixel of the components of a colour, 0..=255 each: grey, RGB or CMYK.
fn rgb(color: &[u8]) -> [u8; 3] {
    match *color {
        [red, green, blue] => [red, green, blue],
        [cyan, magenta, yellow, black] => {
            let mixed = |ink: u8| ((255 - u32::from(ink)) * (255 - u32::from(black)) / 255) as u8;
            [mixed(cyan), mixed(magenta), mixed(yellow)]
        }
        _ => [color.first().copied().unwrap_or_default(); 3],
    }
}

impl WholeReader for Colors {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let width = self.file.header.size[0];
        self.file.decode(true, |decoded, has_opacity| {
            let components = decoded.components();
            let colors = components.len() - usize::from(has_opacity && components.len() > 1);
            if ![1, 3, 4].contains(&colors) {
                let reason = format!("{colors} components are no colours; gdal_translate -b chooses three of them");
                return Err(self.file.bad(&reason));
            }
            let scales: Vec<f32> = components.iter().map(scale).collect();
            let mut pixels = Vec::with_capacity(width);
            for row in 0..self.file.header.size[1] {
                pixels.clear();
                for at in row * width..(row + 1) * width {
                    let sample = |k: usize| components[k].samples()[at];
                    let byte = |k: usize| (sample(k) * scales[k]).round().clamp(0.0, 255.0) as u8;
                    let is_unknown = self.nodata.as_ref().is_some_and(|nodata| {
                        nodata.len() >= colors && (0..colors).all(|k| sample(k).round() == nodata[k])
                    });
                    let mut own = [0; 4];
                    own[..colors].iter_mut().enumerate().for_each(|(k, own)| *own = byte(k));
                    let [red, green, blue] = rgb(&own[..colors]);
                    let opacity = if colors < components.len() { byte(colors) } else { 255 };
                    let pixel = if is_unknown { [0; 4] } else { [red, green, blue, opacity] };
                    pixels.push(u32::from_ne_bytes(pixel));
                }
                call(&pixels)?;
            }
            Ok(())
        })
    }

    fn path(&self) -> &Path {
        self.file.path()
    }
}

/// Returns the factor that makes samples of a component numbers of 0 to 255.
fn scale(component: &ComponentData) -> f32 {
    255.0 / ((1u32 << component.bit_depth().clamp(1, 31)) - 1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Cursor;

    /// Files of 12 x 10 pixels that GDAL 3.6 wrote. The first has `20 x + 5`, `25 y + 3` and `7 x y` modulo 256, with GeoJP2. The
    /// second has the same in 16 bits, with an opacity of 0 west of the seventh column. The third has a palette, whose index is
    /// the first number divided by 20, modulo 4.
    const FILES: [&[u8]; 3] = [
        include_bytes!("../../tests/generate/sources/rasters/rgb.jp2"),
        include_bytes!("../../tests/generate/sources/rasters/rgba16.jp2"),
        include_bytes!("../../tests/generate/sources/rasters/palette.jp2"),
    ];
    const PALETTE: [[u8; 3]; 4] = [[10, 20, 30], [200, 100, 50], [5, 250, 90], [77, 66, 55]];

    #[test]
    fn colours_are_those_that_gdal_reads() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Arc::new(BlockCache::new(1 << 20));
        for (k, bytes) in FILES.into_iter().enumerate() {
            let path = folder.path().join("a.jp2");
            std::fs::write(&path, bytes).unwrap();
            let Opened { levels, placement } = open(&path, None, &cache).unwrap();
            // The corner at 500000 5200000 in UTM, as PROJ converts it.
            let corner = placement.longitude_latitude(0.0, 0.0).map(f64::to_degrees);
            assert!((corner[0] - 9.0).abs() < 1e-9 && (corner[1] - 46.953_529).abs() < 1e-6, "{corner:?}");
            let mut cursor = Cursor::new(&levels[0].image);
            for (x, y) in (0..12).flat_map(|x| (0..10).map(move |y| (x, y))) {
                let own = [20 * x + 5, 25 * y + 3, 7 * x * y % 256].map(|c| if (x, y) == (7, 4) { 0 } else { c as u8 });
                let [r, g, b] = if k == 2 { PALETTE[usize::from(own[0] / 20 % 4)] } else { own };
                let opacity = if k == 1 && x <= 5 { 0 } else { 255 };
                let found = cursor.pixel(x, y).unwrap().to_ne_bytes();
                assert_eq!(found, [r, g, b, opacity], "{k}: {x}, {y}");
            }
        }
    }

    #[test]
    fn images_that_are_no_colours_say_why() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Arc::new(BlockCache::new(1 << 20));
        let [rgb, ..] = FILES;
        let start = rgb.windows(4).position(|bytes| bytes == [0xff, 0x4f, 0xff, 0x51]).unwrap();
        let changed = |at: usize, bytes: &[u8]| {
            let mut file = rgb.to_vec();
            file[start + at..][..bytes.len()].copy_from_slice(bytes);
            file
        };
        for (bytes, why) in [
            // Bits and sign of the first component, and its spacing; the image's width.
            (changed(42, &[0x87]), "signed samples of 8 bits"),
            (changed(42, &[23]), "unsigned samples of 24 bits"),
            (changed(43, &[9]), "one in 9 x 1 pixels"),
            (changed(8, &[0x70, 0, 0, 0]), "samples are decoded at once"),
            (rgb[..start + 60].to_vec(), "JPEG 2000"),
        ] {
            let path = folder.path().join("a.jp2");
            std::fs::write(&path, bytes).unwrap();
            let read = open(&path, None, &cache).and_then(|opened| Cursor::new(&opened.levels[0].image).pixel(0, 0));
            let error = read.unwrap_err().to_string();
            assert!(error.contains(why) && error.contains("a.jp2"), "{error}, not {why}");
        }
    }

    /// A palette of many channels would take more memory than its file tells.
    #[test]
    fn channels_of_palettes_count_as_samples() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jp2");
        let [.., palette] = FILES;
        let at = palette.windows(4).position(|bytes| bytes == b"cmap").unwrap();
        let mut channels = palette[at - 4..][..8 + 12].to_vec();
        channels[..4].copy_from_slice(&(8 + 4 * 65_536u32).to_be_bytes());
        channels.resize(8 + 4 * 65_536, 0);
        let header = palette.windows(4).position(|bytes| bytes == b"jp2h").unwrap();
        let own = u32::from_be_bytes(palette[header - 4..header].try_into().unwrap());
        let grown = own + channels.len() as u32 - 20;
        let whole =
            [&palette[..header - 4], &grown.to_be_bytes(), &palette[header..at - 4], &channels, &palette[at + 16..]]
                .concat();
        std::fs::write(&path, whole).unwrap();
        let error = Jpeg2000::open(&path, 1 << 20).err().unwrap().to_string();
        assert!(error.contains("12 x 10 pixels of 65536 components"), "{error}");
    }
}
