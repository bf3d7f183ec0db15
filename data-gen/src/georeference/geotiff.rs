//! Opens GeoTIFF (OGC 19-008) with the crate `tiff-reader`, and reads the georeference from the tags. `tiff_samples` reads
//! the samples.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tiff_reader::source::{FileSource, TiffSource};
use tiff_reader::{Ifd, OpenOptions, RasterLayout, TiffFile};

use super::geo_keys::{FOOT_M, GeoKeys, US_SURVEY_FOOT_M};
use super::transform::GeoTransform;
use crate::GenError;
use crate::store::{BlockGrid, FileState, Rect};

/// Largest number of pixels along a side.
const MAX_SIDE: usize = 1 << 24;
/// About the number of pixels in a block of several tiles or strips.
const BLOCK_PIXELS: usize = 1 << 16;
/// The largest tile or strip that is decoded by itself, in pixels. Files with larger ones are decoded as a whole.
const MAX_BLOCK_PIXELS: usize = 1 << 22;

const NEW_SUBFILE_TYPE: u16 = 254;
const MODEL_PIXEL_SCALE: u16 = 33550;
const MODEL_TIEPOINT: u16 = 33922;
const MODEL_TRANSFORMATION: u16 = 34264;
const GEO_KEY_DIRECTORY: u16 = 34735;
const GEO_DOUBLE_PARAMS: u16 = 34736;
const GDAL_METADATA: u16 = 42112;
const GDAL_NODATA: u16 = 42113;

/// An open GeoTIFF. Its samples are read on request, by several threads at the same time.
pub(crate) struct Tiff {
    pub(super) path: PathBuf,
    pub(super) file: TiffFile,
    pub(super) layout: RasterLayout,
    /// The mask: a further image of the file, or the file beside it with the extension `msk`.
    pub(super) mask: Option<Mask>,
    pub(super) missing: MissingBlocks,
    pub width: usize,
    pub height: usize,
    pub transform: Option<GeoTransform>,
    pub keys: GeoKeys,
    pub(super) nodata: Option<f64>,
    /// GDAL's metadata about the samples, XML.
    gdal: String,
    /// The state of the file when it was opened; `None` for files of servers.
    state: Option<FileState>,
}

/// An image whose samples other than 0 mark pixels with data.
pub(super) struct Mask {
    /// The file beside the image; `None` if the mask is an image of the same file.
    pub beside: Option<TiffFile>,
    pub index: usize,
}

impl Tiff {
    /// Opens a TIFF and reads its tags.
    pub fn open(path: &Path) -> Result<Self, GenError> {
        Self::open_caching(path, 0)
    }

    /// Opens a TIFF whose reader keeps decoded tiles and strips of a number of bytes. Without them a tile is decoded again for
    /// each rectangle that is read from it.
    pub fn open_caching(path: &Path, cache_bytes: usize) -> Result<Self, GenError> {
        let state = FileState::of(path)?;
        let source = FileSource::open(path).map_err(|e| GenError::invalid(path, format!("TIFF: {e}")))?;
        let beside = mask_beside(path);
        Self::of_source(path, Arc::new(source), beside, Some(state), cache_bytes)
    }

    fn of_source(
        path: &Path,
        source: Arc<dyn TiffSource>,
        beside: Option<TiffFile>,
        state: Option<FileState>,
        cache_bytes: usize,
    ) -> Result<Self, GenError> {
        let bad = |e: tiff_reader::TiffError| GenError::invalid(path, format!("TIFF: {e}"));
        let options = OpenOptions { block_cache_bytes: cache_bytes, ..OpenOptions::default() };
        let file = TiffFile::from_source_with_options(source, options).map_err(bad)?;
        let ifd = file.ifd(0).map_err(bad)?;
        let layout = ifd.raster_layout().map_err(bad)?;
        let (width, height) = (layout.width, layout.height);
        if width == 0 || height == 0 || width.max(height) > MAX_SIDE {
            return Err(GenError::invalid(
                path,
                format!("TIFF: {width} x {height} pixels; 1 to 2^24 a side are supported"),
            ));
        }
        let missing = MissingBlocks::of(ifd, &layout, file.source().len());
        let missing = missing.map_err(|reason| GenError::invalid(path, format!("TIFF: {reason}")))?;
        let text = |tag: u16| ifd.tag(tag).and_then(|tag| tag.value.as_str()).unwrap_or_default();
        let directory = ifd.tag(GEO_KEY_DIRECTORY).and_then(|tag| tag.value.as_u16_slice()).unwrap_or_default();
        let keys = GeoKeys::new(directory.to_vec(), numbers(ifd, GEO_DOUBLE_PARAMS).unwrap_or_default());
        let nodata = text(GDAL_NODATA).trim_matches(|c: char| c == '\0' || c.is_whitespace());
        let nodata =
            if nodata.contains("#IND") || nodata.contains("#QNAN") { Some(f64::NAN) } else { nodata.parse().ok() };
        let (transform, gdal) = (transform(ifd, &keys), text(GDAL_METADATA).to_owned());
        let mask = mask(&file, beside, [width, height]);
        let path = path.to_owned();
        Ok(Self { path, layout, mask, missing, width, height, transform, keys, nodata, gdal, state, file })
    }

    /// Returns the number of channels.
    pub fn channels(&self) -> usize {
        self.layout.samples_per_pixel
    }

    /// Returns an error if the file was changed since it was opened.
    pub(super) fn check_unchanged(&self) -> Result<(), GenError> {
        self.state.map_or(Ok(()), |state| state.check(&self.path))
    }

    pub(super) fn bad(&self, reason: impl std::fmt::Display) -> GenError {
        GenError::invalid(&self.path, format!("TIFF: {reason}"))
    }

    /// Returns the grid of the blocks that are decoded at once: several tiles or strips if they are small. `None` if a single
    /// tile or strip is so large that the file has to be decoded as a whole, in [`Self::row_steps`].
    /// `by_rows` is true for a caller that reads rows of strips without compression alone ([`Self::heights`]).
    pub fn grid(&self, by_rows: bool) -> Option<BlockGrid> {
        let [width, mut height] = self.missing.size;
        if by_rows && self.has_plain_rows() {
            height = 1;
        }
        let size = [self.width, self.height];
        if width.min(self.width).saturating_mul(height.min(self.height)) > MAX_BLOCK_PIXELS {
            return None;
        }
        let is_strip = width >= self.width;
        let side = BLOCK_PIXELS.isqrt();
        let times = [
            if is_strip { 1 } else { (side / width).max(1) },
            match is_strip {
                true => (2 * BLOCK_PIXELS / self.width / height).max(1),
                false => (side / height).max(1),
            },
        ];
        Some(BlockGrid::new(size, [width.saturating_mul(times[0]), height.saturating_mul(times[1])]))
    }

    /// Returns the rectangles that a file is read by as a whole: whole rows, several times for a tall tile or strip, whose
    /// decoded bytes should stay in the reader's cache ([`Self::row_bytes`]).
    pub fn row_steps(&self) -> impl Iterator<Item = Rect> + use<> {
        let (width, height) = (self.width, self.height);
        let rows = (MAX_BLOCK_PIXELS / width).max(1).min(self.missing.size[1].max(1));
        (0..height).step_by(rows).map(move |row| Rect { column: 0, row, width, height: rows.min(height - row) })
    }

    /// Returns the decoded bytes of a row of tiles, or of a strip.
    pub fn row_bytes(&self) -> usize {
        let [width, height] = self.missing.size;
        let pixels = self.width.div_ceil(width).saturating_mul(width).saturating_mul(height.min(self.height));
        pixels.saturating_mul(self.channels()).saturating_mul(self.layout.bytes_per_sample)
    }

    /// Returns true if a file leaves out all tiles or strips that a rectangle of a channel touches.
    pub fn is_missing(&self, channel: usize, r: Rect) -> bool {
        let [width, height] = self.missing.size;
        let columns = r.column / width..(r.column + r.width).div_ceil(width);
        let rows = r.row / height..(r.row + r.height).div_ceil(height);
        let plane = self.plane(channel);
        !self.missing.is_missing.is_empty()
            && rows.into_iter().all(|y| columns.clone().all(|x| self.missing.has(plane, x * width, y * height)))
    }

    /// Returns the plane of tiles or strips that holds a channel.
    pub(super) fn plane(&self, channel: usize) -> usize {
        if self.layout.planar_configuration == 2 { channel } else { 0 }
    }

    /// Returns true if the file has a value for samples without data.
    pub fn has_nodata(&self) -> bool {
        self.nodata.is_some()
    }

    /// Returns the factor and the offset that convert samples to heights in metres. The error is the reason.
    pub(super) fn factor_and_offset_m(&self) -> Result<[f64; 2], String> {
        let number = |role: &str, usual: f64| match gdal_item(&self.gdal, role) {
            None => Ok(usual),
            Some(text) => text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| format!("{role} `{text}`")),
        };
        let unit = match (self.keys.height_unit_m()?, gdal_item(&self.gdal, "unittype")) {
            (Some(metres), _) => Ok(metres),
            (None, None | Some("" | "m" | "metre" | "metres" | "meter" | "meters")) => Ok(1.0),
            (None, Some("ft" | "foot" | "feet")) => Ok(FOOT_M),
            (None, Some("km" | "kilometre" | "kilometres" | "kilometer" | "kilometers")) => Ok(1000.0),
            (None, Some("cm" | "centimetre" | "centimetres" | "centimeter" | "centimeters")) => Ok(0.01),
            (None, Some("US survey foot" | "US survey feet" | "ftUS" | "us-ft" | "sfoot")) => Ok(US_SURVEY_FOOT_M),
            (None, Some(other)) => Err(format!("heights in units of `{other}`")),
        };
        let (scale, offset) = (number("scale", 1.0), number("offset", 0.0));
        let unsupported = |what: String| format!("GDAL's metadata: {what}, which is not supported");
        let [scale, offset, unit] = [scale, offset, unit].map(|n| n.map_err(unsupported));
        let unit = unit?;
        Ok([scale? * unit, offset? * unit])
    }
}

/// The blocks (tiles or strips) that a sparse file leaves out.
pub(super) struct MissingBlocks {
    /// The width and height of a block in pixels.
    size: [usize; 2],
    across: usize,
    /// The number of blocks of a plane.
    plane: usize,
    /// By planes, row-major from the north-west; empty if no block is missing.
    is_missing: Vec<bool>,
}

impl MissingBlocks {
    /// Finds the blocks in the tags. The error is the reason, if there are too few or if one lies beyond the end of the file.
    fn of(ifd: &Ifd, layout: &RasterLayout, file_bytes: u64) -> Result<Self, String> {
        let size = match (ifd.tile_width(), ifd.tile_height()) {
            (Some(width), Some(height)) => [width as usize, height as usize],
            _ => [layout.width, layout.height.min(ifd.rows_per_strip() as usize)],
        };
        let size = size.map(|s| s.max(1));
        let (across, down) = (layout.width.div_ceil(size[0]), layout.height.div_ceil(size[1]));
        let (offsets, counts) = match ifd.is_tiled() {
            true => (ifd.tile_offsets(), ifd.tile_byte_counts()),
            false => (ifd.strip_offsets(), ifd.strip_byte_counts()),
        };
        let (offsets, counts) = (offsets.unwrap_or_default(), counts.unwrap_or_default());
        let planes = if layout.planar_configuration == 2 { layout.samples_per_pixel } else { 1 };
        let wanted = across.saturating_mul(down).saturating_mul(planes);
        if offsets.len() < wanted || counts.len() < wanted {
            let (found, kind) = (offsets.len().min(counts.len()), if ifd.is_tiled() { "tiles" } else { "strips" });
            return Err(format!("{found} {kind}, but {} x {} pixels need {wanted}", layout.width, layout.height));
        }
        let blocks = || offsets.iter().zip(&counts).take(wanted);
        let end = blocks().map(|(offset, bytes)| if *bytes == 0 { 0 } else { offset.saturating_add(*bytes) }).max();
        if end.is_some_and(|end| end > file_bytes) {
            return Err(format!("samples up to byte {}, but the file has {file_bytes}", end.unwrap_or(0)));
        }
        let mut is_missing: Vec<bool> = blocks().map(|(offset, bytes)| *offset == 0 || *bytes == 0).collect();
        if !is_missing.contains(&true) {
            is_missing.clear();
        }
        Ok(Self { size, across, plane: across * down, is_missing })
    }

    /// Returns true if the block of a pixel is missing in a plane.
    pub fn has(&self, plane: usize, column: usize, row: usize) -> bool {
        let block = || plane * self.plane + row / self.size[1] * self.across + column / self.size[0];
        !self.is_missing.is_empty() && self.is_missing.get(block()) == Some(&true)
    }
}

/// Opens the mask beside an image.
fn mask_beside(path: &Path) -> Option<TiffFile> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".msk");
    let beside = Path::new(&beside);
    beside.is_file().then(|| TiffFile::open(beside).ok()).flatten()
}

/// Finds the mask of an image of a size: an image of the file that says so, or the file beside it.
fn mask(file: &TiffFile, beside: Option<TiffFile>, size: [usize; 2]) -> Option<Mask> {
    let is_mask = |ifd: &Ifd| {
        let kind = ifd.tag(NEW_SUBFILE_TYPE).and_then(|tag| tag.value.as_u32()).unwrap_or(0);
        // Bit 2 marks a mask, bit 0 an image of a lower resolution.
        kind & 5 == 4 && is_image_of(ifd, size)
    };
    if let Some(index) = file.ifds().iter().position(is_mask) {
        return Some(Mask { beside: None, index });
    }
    let beside = beside?;
    let is_mask = beside.ifd(0).is_ok_and(|ifd| is_image_of(ifd, size));
    is_mask.then_some(Mask { beside: Some(beside), index: 0 })
}

/// Returns true if an image has a size and samples of one byte at most.
fn is_image_of(ifd: &Ifd, size: [usize; 2]) -> bool {
    ifd.raster_layout().is_ok_and(|layout| [layout.width, layout.height] == size && layout.bytes_per_sample == 1)
}

/// Returns the value of a role ("scale", "offset", "unittype") of the first band in GDAL's metadata.
fn gdal_item<'a>(xml: &'a str, role: &str) -> Option<&'a str> {
    let items = xml.split("<Item ").skip(1).filter_map(|item| item.split('<').next()?.split_once('>'));
    let mut found = items.filter(|(attributes, _)| {
        attributes.contains(&format!("role=\"{role}\""))
            && (attributes.contains("sample=\"0\"") || !attributes.contains("sample="))
    });
    found.next().map(|(_, value)| value.trim())
}

/// Returns the numbers of a tag.
fn numbers(ifd: &Ifd, tag: u16) -> Option<Vec<f64>> {
    ifd.tag(tag)?.value.as_f64_vec()
}

/// Returns the transform in the tags ModelPixelScale and ModelTiepoint, or in ModelTransformation.
fn transform(ifd: &Ifd, keys: &GeoKeys) -> Option<GeoTransform> {
    let [scale, tie, matrix] = [MODEL_PIXEL_SCALE, MODEL_TIEPOINT, MODEL_TRANSFORMATION].map(|tag| numbers(ifd, tag));
    let mut transform = match (scale.as_deref(), tie.as_deref(), matrix.as_deref()) {
        (Some([sx, sy, ..]), Some([i, j, _, x, y, ..]), _) => {
            GeoTransform { origin: [x - i * sx, y + j * sy], dx: [*sx, 0.0], dy: [0.0, -sy] }
        }
        (_, _, Some(m)) if m.len() >= 8 => GeoTransform { origin: [m[3], m[7]], dx: [m[0], m[4]], dy: [m[1], m[5]] },
        _ => return None,
    };
    // GTRasterType: with 1 (area) the reference is a pixel's corner, with 2 (point) its centre.
    if keys.number(1025) == Some(2) {
        transform.origin[0] -= 0.5 * (transform.dx[0] + transform.dy[0]);
        transform.origin[1] -= 0.5 * (transform.dx[1] + transform.dy[1]);
    }
    Some(transform)
}
