//! Readers of elevation files: GeoTIFF, HGT, PNG, EXR, ASCII grids and folders of web tiles.

mod ascii_grid;
mod exr;
mod hgt;
mod png;
mod web_tiles;

use std::io::Read as _;
use std::path::Path;

use super::raster::Raster;
use crate::GenError;
use crate::georeference::{Crs, Placement, geotiff};
pub(crate) use web_tiles::is_folder_of_tiles;

/// Largest number of samples in one raster.
const MAX_SAMPLES: usize = 1 << 30;

/// The meaning of the colours of a PNG with elevation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum HeightEncoding {
    /// Mapbox Terrain-RGB: `-10000 + (R * 65536 + G * 256 + B) / 10` metres.
    #[default]
    TerrainRgb,
    /// Terrarium: `R * 256 + G + B / 256 - 32768` metres.
    Terrarium,
}

/// The properties of elevation files that the files do not name themselves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RasterOptions {
    /// The reference system of files that do not name their own.
    pub crs: Option<Crs>,
    /// The channel with heights: a name in EXR files (after the part's name and a colon, if the file has several parts), a
    /// number from 1 in GeoTIFF.
    pub channel: Option<String>,
    /// A value of samples without data, beside the one that a file declares.
    pub nodata: Option<f64>,
    /// Metres for each step of grey PNGs, and for each unit of EXR files; 1 in EXR files by default.
    pub height_scale: Option<f64>,
    /// Metres that are added to the scaled values of grey PNGs and EXR files.
    pub height_offset: f64,
    /// The meaning of the colours of RGB PNGs.
    pub encoding: HeightEncoding,
}

impl RasterOptions {
    /// Returns a sample of a format without a unit in metres, NaN for the nodata value.
    fn height_m(&self, sample: f32) -> f32 {
        if self.nodata.is_some_and(|nodata| nodata as f32 == sample) {
            return f32::NAN;
        }
        match (self.height_scale, self.height_offset) {
            (None, 0.0) => sample,
            (scale, offset) => (f64::from(sample) * scale.unwrap_or(1.0) + offset) as f32,
        }
    }
}

impl Raster {
    /// Reads an elevation file. Its format is recognised by its first bytes, HGT by the extension of its name.
    pub fn read(path: &Path) -> Result<Self, GenError> {
        Self::read_in(path, &RasterOptions::default())
    }

    /// Like [`Raster::read`], with what the file does not say itself. Reads a folder of web tiles as well.
    pub fn read_in(path: &Path, options: &RasterOptions) -> Result<Self, GenError> {
        let raster = if path.is_dir() && is_folder_of_tiles(path) {
            web_tiles::read(path, options)?
        } else {
            read_file(path, options)?
        };
        if raster.has_heights() { Ok(raster) } else { Err(GenError::invalid(path, "no sample has a height")) }
    }
}

fn read_file(path: &Path, options: &RasterOptions) -> Result<Raster, GenError> {
    GenError::if_not_regular(path)?;
    let mut magic = [0u8; 8];
    let mut file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let got = file.read(&mut magic).map_err(GenError::file(path))?;
    let is_hgt = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("hgt"));
    match &magic[..got] {
        _ if is_hgt => hgt::read(path),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff(path, options),
        [0x89, b'P', b'N', b'G', ..] => png::read(path, options),
        [0x76, 0x2f, 0x31, 0x01, ..] => exr::read(path, options),
        [b'P', b'K', 3, 4, ..] => hgt::read_zip(path),
        [n, c, ..] if n.eq_ignore_ascii_case(&b'n') && c.eq_ignore_ascii_case(&b'c') => ascii_grid::read(path, options),
        _ => Err(GenError::invalid(path, "neither GeoTIFF, HGT (or a zip file of one), PNG, EXR nor an ASCII grid")),
    }
}

fn tiff(path: &Path, options: &RasterOptions) -> Result<Raster, GenError> {
    let t = geotiff::Tiff::open(path)?;
    let channel = match (&options.channel, t.channels()) {
        (None, 1) => 1,
        (None, count) => {
            let reason = format!("TIFF with {count} channels; elevation has one channel, --channel N chooses it");
            return Err(GenError::invalid(path, reason));
        }
        (Some(name), count) => {
            let number = name.parse().ok().filter(|n| (1..=count).contains(n));
            number.ok_or_else(|| {
                GenError::invalid(path, format!("--channel {name}: the TIFF has channels 1 to {count}"))
            })?
        }
    };
    // PNG and EXR files have a default position; a TIFF must have a georeference.
    let placement = Placement::of_tiff(path, &t, options.crs.clone())?
        .ok_or_else(|| GenError::invalid(path, "no georeference: neither GeoTIFF tags nor a world file beside it"))?;
    let samples = t.heights(path, channel - 1, options.nodata)?;
    Ok(Raster::new([t.width, t.height], samples, placement))
}
