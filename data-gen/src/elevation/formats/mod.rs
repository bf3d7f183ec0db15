//! Readers of elevation files: GeoTIFF, HGT, DTED, USGS DEM, PNG, EXR, JPEG 2000, netCDF, Erdas Imagine, grids of Surfer, cubes of
//! ISIS, ASCII grids, points in text files, plain samples with a header, virtual rasters, PMTiles, MBTiles and folders of web tiles.
//!
//! Files are opened before a run begins; the threads of the run read blocks of them, several at the same time.

mod ascii_grid;
mod dted;
mod erdas;
mod exr;
mod hgt;
mod jpeg2000;
mod netcdf;
mod plain;
mod png;
mod tiff;
mod usgs_dem;
mod virtual_raster;
mod web_tiles;
mod xyz;

use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;

use super::context::SourceContext;
use crate::GenError;
use crate::georeference::{Crs, Placement};
use crate::jpeg2000::is_jpeg2000;
use crate::store::{BlockGrid, BlockReader, first_bytes, is_remote};
use crate::virtual_raster::is_virtual;
use crate::web_tiles::is_archive;
pub(crate) use png::rows as png_rows;

/// Largest number of samples of a file that is decoded as a whole, where its reader has no smaller limit.
const MAX_SAMPLES: usize = 1 << 36;
/// Largest number of samples that one byte of a compressed file can hold: deflate packs at most 1,032 bytes into one.
const MAX_SAMPLES_PER_BYTE: u64 = 1032;
/// The bytes at a text's start that tell whether it is an ASCII grid.
const MAX_WORD_BYTES: u64 = 64;

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
    /// variable in netCDF, a number from 1 in GeoTIFF, Erdas Imagine and JPEG 2000.
    pub channel: Option<String>,
    /// A value of samples without data, beside the one that a file declares.
    pub nodata: Option<f64>,
    /// Metres for each step of grey PNGs, and for each unit of EXR files; a factor of the heights of other rasters. 1 by default, but
    /// in grey PNGs.
    pub height_scale: Option<f64>,
    /// Metres that are added to the scaled values.
    pub height_offset: f64,
    /// The meaning of the colours of RGB PNGs.
    pub encoding: HeightEncoding,
}

impl RasterOptions {
    /// Returns a sample of a format without a unit in metres, NaN for the nodata value.
    fn height_m(&self, sample: f32) -> f32 {
        if self.nodata.is_some_and(|nodata| nodata as f32 == sample) { f32::NAN } else { self.scaled_m(sample) }
    }

    /// Returns a height with the factor and the offset of the options.
    fn scaled_m(&self, height_m: f32) -> f32 {
        match (self.height_scale, self.height_offset) {
            (None, 0.0) => height_m,
            (scale, offset) => (f64::from(height_m) * scale.unwrap_or(1.0) + offset) as f32,
        }
    }
}

/// An elevation file whose header was read.
pub(super) struct Opened {
    pub grid: BlockGrid,
    /// Decodes heights in metres, as bits; NaN where they are unknown.
    pub reader: Box<dyn BlockReader>,
    pub placement: Placement,
}

/// Returns the bits of heights.
fn height_bits(heights: Vec<f32>) -> Vec<u32> {
    heights.into_iter().map(f32::to_bits).collect()
}

/// Opens an elevation file or a folder of web tiles, and reads its header. The format is recognised by the first bytes, HGT by
/// the extension of its name, and plain samples by the header beside them.
pub(super) fn open(path: &Path, options: &RasterOptions, context: &Arc<SourceContext>) -> Result<Opened, GenError> {
    open_at(path, options, context, 0)
}

/// Like [`open`], for a file that a virtual raster may name. `depth` is the number of virtual rasters around it.
fn open_at(
    path: &Path,
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    depth: usize,
) -> Result<Opened, GenError> {
    if is_archive(path, &context.cache)? {
        return web_tiles::open(path, options, &context.cache);
    }
    let magic = first_bytes(path, &context.cache)?;
    if is_remote(path) && !is_tiff(&magic) {
        return Err(GenError::invalid(
            path,
            "neither GeoTIFF nor PMTiles; files of other formats are read from disks only",
        ));
    }
    let is_hgt = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("hgt"));
    match &magic[..] {
        [] => Err(GenError::invalid(path, "the file is empty")),
        _ if is_hgt => hgt::open(path),
        _ if is_tiff(&magic) => tiff::open(path, options, context),
        [0x89, b'P', b'N', b'G', ..] => png::open(path, options, &context.cache),
        [0x76, 0x2f, 0x31, 0x01, ..] => exr::open(path, options, &context.cache),
        [0x1f, 0x8b, ..] => hgt::open_gzip(path, &context.cache),
        [b'P', b'K', 3, 4, ..] => hgt::open_zip(path, &context.cache),
        _ if dted::is_dted(&magic) => dted::open(path),
        _ if is_jpeg2000(&magic) => jpeg2000::open(path, options, &context.cache),
        _ if is_virtual(path, &magic) => virtual_raster::open(path, options, context, depth),
        _ if ascii_grid::is_ascii_grid(&magic) => ascii_grid::open(path, options, &context.cache),
        [b'C', b'D', b'F', 1 | 2 | 5, ..] | [0x89, b'H', b'D', b'F', ..] => netcdf::open(path, options, context),
        [b'E', b'H', b'F', b'A', ..] => erdas::open(path, options, &context.cache),
        _ if plain::is_surfer(&magic) => plain::open_surfer(path, options, &context.cache),
        _ if plain::is_isis(&magic) => plain::open_isis(path, options, &context.cache),
        _ if let Some(format) = converted_first(&magic) => Err(GenError::invalid(path, format)),
        _ if usgs_dem::is_usgs_dem(path)? => usgs_dem::open(path, options),
        _ if xyz::is_xyz(path)? => xyz::open(path, options, &context.cache),
        _ => plain::open(path, options, &context.cache)?.ok_or_else(|| {
            let formats = "neither GeoTIFF, HGT (or a zip or gzip file of one), DTED, USGS DEM, PNG, EXR, JPEG 2000, netCDF, Erdas \
                           Imagine, PMTiles, MBTiles, VRT, an ASCII grid, a grid of Surfer, a cube of ISIS, XYZ, nor plain samples \
                           with a .hdr, .sgrd, .lbl or .xml file beside them";
            GenError::invalid(path, formats)
        }),
    }
}

/// Returns true for a text file with elevation, which is no list of files.
pub(super) fn is_text_raster(path: &Path) -> Result<bool, GenError> {
    let mut magic = Vec::new();
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    file.take(MAX_WORD_BYTES).read_to_end(&mut magic).map_err(GenError::file(path))?;
    Ok(ascii_grid::is_ascii_grid(&magic) || xyz::is_xyz(path)?)
}

/// Opens an overview of a TIFF ([`tiff::open_overview`]), or those of the files of a virtual raster; `None` for other formats.
pub(super) fn open_overview(
    path: &Path,
    factors: [f64; 2],
    options: &RasterOptions,
    context: &Arc<SourceContext>,
    placement: &Placement,
) -> Result<Option<Opened>, GenError> {
    if is_archive(path, &context.cache)? {
        return Ok(None);
    }
    let magic = first_bytes(path, &context.cache)?;
    match &magic[..] {
        magic if is_tiff(magic) => tiff::open_overview(path, factors, options, context, placement),
        magic if is_virtual(path, magic) => virtual_raster::open_overview(path, factors, options, context, placement),
        _ => Ok(None),
    }
}

/// Returns a word about a format that is not read, by a file's first bytes.
fn converted_first(magic: &[u8]) -> Option<String> {
    let name = match magic {
        [b'P', b'D', b'S', b'_', ..] | [b'C', b'C', b'S', b'D', ..] | [b'<', b'?', b'x', b'm', b'l', ..] => {
            return Some(
                "a label, as that of NASA's PDS; name the file of its samples, beside which the label is".to_owned(),
            );
        }
        [b'L', b'A', b'S', b'F', ..] => {
            return Some("points of a laser scan (LAS); pdal makes a raster of them".to_owned());
        }
        [0x0e, 0x03, 0x13, 0x01, ..] => "HDF of version 4",
        [b'G', b'R', b'I', b'B', ..] => "GRIB",
        [b'G', b'R', b'I', b'D', b'1', ..] => "a binary grid of Esri",
        [b'm', b's', b'i', b'd', ..] => "MrSID",
        [b'N', b'I', b'T', b'F', ..] | [b'N', b'S', b'I', b'F', ..] => "NITF",
        [b'S', b'I', b'M', b'P', b'L', b'E', b' ', ..] => "FITS",
        [b'P', b'C', b'I', b'D', b'S', b'K', ..] => "PCIDSK",
        _ => return None,
    };
    Some(format!("{name}; gdal_translate writes it as GeoTIFF"))
}

/// Returns true if a file begins like a TIFF.
fn is_tiff(magic: &[u8]) -> bool {
    matches!(magic, [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..])
}
