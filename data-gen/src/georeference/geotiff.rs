//! Opens GeoTIFF (OGC 19-008) with the crate `tiff-reader`, and reads the georeference from the tags. `tiff_samples` reads
//! the samples.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tiff_reader::source::{FileSource, TiffSource};
use tiff_reader::{Ifd, OpenOptions, RasterLayout, TiffError, TiffFile};

use super::beside::{Metadata, number_of_band, unit_m};
use super::geo_keys::GeoKeys;
use super::half_float;
use super::transform::GeoTransform;
use crate::GenError;
use crate::store::{BlockCache, BlockGrid, FileState, Rect, RemoteBytes, is_remote, with_more};

/// Largest number of pixels along a side.
const MAX_SIDE: usize = 1 << 24;
/// About the number of pixels in a block of several tiles or strips.
const BLOCK_PIXELS: usize = 1 << 16;
/// The largest tile or strip that is decoded by itself, in pixels. Files with larger ones are decoded as a whole.
const MAX_BLOCK_PIXELS: usize = 1 << 22;

/// The value of SampleFormat for floats.
const FLOAT: u16 = 3;
const NEW_SUBFILE_TYPE: u16 = 254;
const MODEL_PIXEL_SCALE: u16 = 33550;
const MODEL_TIEPOINT: u16 = 33922;
const MODEL_TRANSFORMATION: u16 = 34264;
const GEO_KEY_DIRECTORY: u16 = 34735;
const GEO_DOUBLE_PARAMS: u16 = 34736;
const GEO_ASCII_PARAMS: u16 = 34737;
const GDAL_METADATA: u16 = 42112;
const GDAL_NODATA: u16 = 42113;

/// An image of an open GeoTIFF: the first one, or an overview of it. Its samples are read on request, by several threads at
/// the same time.
pub(crate) struct Tiff {
    pub(super) path: PathBuf,
    pub(super) file: Arc<TiffFile>,
    /// The number of the image in the file.
    pub(super) index: usize,
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
    /// The metadata in the file beside it.
    pub metadata: Metadata,
    cache: Arc<BlockCache>,
    /// The state of the file when it was opened; `None` for files of servers.
    state: Option<FileState>,
}

/// An image whose samples other than 0 mark pixels with data.
pub(super) struct Mask {
    pub file: Arc<TiffFile>,
    pub index: usize,
}

/// The bytes of a file on a server, for the decoder.
struct RemoteSource(RemoteBytes);

impl TiffSource for RemoteSource {
    fn len(&self) -> u64 {
        self.0.size()
    }

    fn read_exact_at(&self, offset: u64, len: usize) -> Result<Vec<u8>, TiffError> {
        self.0.read(offset, len).map_err(|e| TiffError::Io(std::io::Error::other(e), String::new()))
    }
}

impl Tiff {
    /// Opens a TIFF, which may be on a server, and reads its tags.
    pub fn open(path: &Path, cache: &Arc<BlockCache>) -> Result<Self, GenError> {
        Self::open_caching(path, 0, cache)
    }

    /// Opens a TIFF whose reader keeps decoded tiles and strips of a number of bytes. Without them a tile is decoded again for
    /// each rectangle that is read from it.
    pub fn open_caching(path: &Path, cache_bytes: usize, cache: &Arc<BlockCache>) -> Result<Self, GenError> {
        let (source, state): (Arc<dyn TiffSource>, _) = match is_remote(path) {
            true => (Arc::new(RemoteSource(RemoteBytes::open(path, cache)?)), None),
            false => {
                let state = FileState::of(path)?;
                let source = FileSource::open(path).map_err(|e| failed(path, e))?;
                (Arc::new(source), Some(state))
            }
        };
        let own = Own { path, cache, state, metadata: Metadata::beside(path, cache)? };
        let options = OpenOptions { block_cache_bytes: cache_bytes, ..OpenOptions::default() };
        let bad = |e| failed(path, e);
        let file = TiffFile::from_source_with_options(Arc::clone(&source), options).map_err(bad)?;
        let Some(integers) = half_float::as_integers(&file, &source).map_err(bad)? else {
            return Self::of_image(own, Arc::new(file), 0, false);
        };
        let file = TiffFile::from_source_with_options(integers, options).map_err(bad)?;
        Self::of_image(own, Arc::new(file), 0, true)
    }

    /// Reads the tags of an image.
    fn of_image(own: Own<'_>, file: Arc<TiffFile>, index: usize, is_half: bool) -> Result<Self, GenError> {
        let Own { path, cache, state, metadata } = own;
        let bad = |e: TiffError| failed(path, e);
        let ifd = file.ifd(index).map_err(bad)?;
        let mut layout = ifd.raster_layout().map_err(bad)?;
        if is_half {
            layout.sample_format = FLOAT;
        }
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
        let keys = keys(ifd);
        let nodata = text(GDAL_NODATA).trim_matches(|c: char| c == '\0' || c.is_whitespace());
        let nodata =
            if nodata.contains("#IND") || nodata.contains("#QNAN") { Some(f64::NAN) } else { nodata.parse().ok() };
        let nodata = metadata.nodata().or(nodata);
        let (transform, gdal) = (transform(ifd, &keys), text(GDAL_METADATA).to_owned());
        let mask = mask(path, &file, [width, height], cache)?;
        let (path, cache) = (path.to_owned(), Arc::clone(cache));
        Ok(Self {
            path,
            layout,
            mask,
            missing,
            width,
            height,
            transform,
            keys,
            nodata,
            gdal,
            metadata,
            cache,
            state,
            file,
            index,
        })
    }

    /// Returns the transform and the keys of a TIFF in the bytes of another file, such as the box of GeoJP2. The error is the
    /// reason.
    pub(super) fn embedded(bytes: &[u8]) -> Result<(Option<GeoTransform>, GeoKeys), String> {
        let file = TiffFile::from_bytes(bytes.to_vec()).map_err(|e| e.to_string())?;
        let ifd = file.ifd(0).map_err(|e| e.to_string())?;
        let keys = keys(ifd);
        Ok((transform(ifd, &keys), keys))
    }

    /// Returns the overviews, largest first: images of the file that say so, or those of the file beside it with the extension
    /// `ovr`. Those with other channels are left out, and those without a mask if the image has one.
    pub fn overviews(&self) -> Result<Vec<Self>, GenError> {
        let is_overview = |ifd: &Ifd| {
            let kind = ifd.tag(NEW_SUBFILE_TYPE).and_then(|tag| tag.value.as_u32()).unwrap_or(0);
            // Bit 0 marks an image of a lower resolution, bit 2 a mask.
            kind & 5 == 1
        };
        let own = self.file.ifds().iter().enumerate().filter(|(_, ifd)| is_overview(ifd));
        let mut images: Vec<(Arc<TiffFile>, usize)> = own.map(|(index, _)| (self.file.clone(), index)).collect();
        if images.is_empty()
            && let Some(beside) = beside(&self.path, "ovr", &self.cache)?
        {
            let is_mask =
                |ifd: &Ifd| ifd.tag(NEW_SUBFILE_TYPE).and_then(|tag| tag.value.as_u32()).unwrap_or(0) & 4 != 0;
            let found = beside.ifds().iter().enumerate().filter(|(_, ifd)| !is_mask(ifd));
            images = found.map(|(index, _)| (beside.clone(), index)).collect();
        }
        let like = |l: &RasterLayout| (l.samples_per_pixel, l.bits_per_sample, l.sample_format);
        let open = |(file, index): (Arc<TiffFile>, usize)| {
            let is_half = self.is_half() && Arc::ptr_eq(&file, &self.file);
            let own = Own { path: &self.path, cache: &self.cache, state: self.state, metadata: self.metadata.clone() };
            let image = Self::of_image(own, file, index, is_half).ok()?;
            if self.mask.is_some() && image.mask.is_none() {
                return None;
            }
            let [own, full] = [[image.width, image.height], [self.width, self.height]];
            let is_smaller = own[0] <= full[0] && own[1] <= full[1] && own != full;
            let is_like = like(&image.layout) == like(&self.layout) && is_smaller;
            let (transform, keys, gdal) = (self.transform, self.keys.clone(), self.gdal.clone());
            is_like.then_some(Self { transform, keys, gdal, nodata: self.nodata, ..image })
        };
        let mut overviews: Vec<Self> = images.into_iter().filter_map(open).collect();
        overviews.sort_by_key(|image| std::cmp::Reverse(image.width * image.height));
        Ok(overviews)
    }

    /// Returns the images of the file that are neither overviews nor masks.
    pub(super) fn images(&self) -> Result<Vec<Self>, GenError> {
        let kind = |ifd: &Ifd| ifd.tag(NEW_SUBFILE_TYPE).and_then(|tag| tag.value.as_u32()).unwrap_or(0);
        let images = self.file.ifds().iter().enumerate().filter(|(_, ifd)| kind(ifd) & 5 == 0);
        let open = |(index, _)| {
            let own = Own { path: &self.path, cache: &self.cache, state: self.state, metadata: self.metadata.clone() };
            Self::of_image(own, self.file.clone(), index, self.is_half())
        };
        images.map(open).collect()
    }

    /// Returns a text of GDAL's metadata in the file: of the item with an attribute such as `role="scale"`, of a channel.
    pub(super) fn item(&self, attribute: &str, channel: Option<usize>) -> Option<String> {
        item_of(&self.gdal, attribute, channel)
    }

    /// Returns true for 16-bit floats.
    fn is_half(&self) -> bool {
        (self.layout.sample_format, self.layout.bits_per_sample) == (FLOAT, 16)
    }

    /// Returns true if the file has points on the earth, but no transform.
    pub fn has_control_points(&self) -> bool {
        let ifd = self.file.ifd(self.index).ok();
        self.transform.is_none() && ifd.is_some_and(|ifd| numbers(ifd, MODEL_TIEPOINT).is_some_and(|n| n.len() >= 12))
    }

    /// Returns the width and height of a tile or strip.
    pub(super) fn block_size(&self) -> [usize; 2] {
        self.missing.size
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

    /// Returns the factor and the offset that convert samples of a channel to heights in metres. The error is the reason.
    pub(super) fn factor_and_offset_m(&self, channel: usize) -> Result<[f64; 2], String> {
        let band = self.metadata.band(channel + 1).cloned().unwrap_or_default();
        let unit = band.unit.or_else(|| self.item("role=\"unittype\"", Some(channel)));
        let unit = match self.keys.height_unit_m()? {
            Some(metres) => metres,
            None => unit_m(unit.as_deref())?,
        };
        Ok(self.scale_and_offset(channel)?.map(|n| n * unit))
    }

    /// Returns the factor and the offset of a channel that the file names and that are valid: 1 and 0 for heights in metres.
    pub fn units(&self, channel: usize) -> [f64; 2] {
        self.factor_and_offset_m(channel).ok().filter(|[factor, _]| *factor != 0.0).unwrap_or([1.0, 0.0])
    }

    /// Returns the factor and the offset of a channel's samples, without a unit. The error is the reason.
    pub(super) fn scale_and_offset(&self, channel: usize) -> Result<[f64; 2], String> {
        let band = self.metadata.band(channel + 1).cloned().unwrap_or_default();
        let number = |role: &str, beside: Option<String>, usual: f64| {
            let text = beside.or_else(|| self.item(&format!("role=\"{role}\""), Some(channel)));
            number_of_band(role, text.as_deref(), usual)
        };
        Ok([number("scale", band.scale, 1.0)?, number("offset", band.offset, 0.0)?])
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
    /// Returns true if no block is missing.
    pub fn is_empty(&self) -> bool {
        self.is_missing.is_empty()
    }

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

/// Returns the error of a decoder. Errors of a server are returned as they are.
pub(super) fn failed(path: &Path, error: TiffError) -> GenError {
    match error {
        TiffError::Io(e, name) => match e.downcast::<GenError>() {
            Ok(error) => error,
            Err(e) => GenError::invalid(path, format!("TIFF: {}", TiffError::Io(e, name))),
        },
        e => {
            let reason = e.to_string();
            let known = COMPRESSIONS
                .iter()
                .find(|(code, _)| reason.contains("unsupported compression") && reason.ends_with(&format!("({code})")));
            let reason = known.map(|(_, name)| format!("samples compressed as {name} are not supported; {CONVERT}"));
            GenError::invalid(path, format!("TIFF: {}", reason.unwrap_or_else(|| e.to_string())))
        }
    }
}

/// The end of the error about a compression that is not supported.
const CONVERT: &str = "gdal_translate -co COMPRESS=DEFLATE converts the file";

/// Compressions that are not supported, by TIFF's code.
const COMPRESSIONS: [(u16, &str); 11] = [
    (2, "CCITT RLE"),
    (3, "CCITT fax 3"),
    (4, "CCITT fax 4"),
    (6, "JPEG of TIFF 6.0"),
    (33003, "JPEG 2000"),
    (33005, "JPEG 2000"),
    (34661, "JBIG"),
    (34712, "JPEG 2000"),
    (34925, "LZMA"),
    (50002, "JPEG XL"),
    (52546, "JPEG XL"),
];

/// The parts that the images of a file share.
struct Own<'a> {
    path: &'a Path,
    cache: &'a Arc<BlockCache>,
    state: Option<FileState>,
    metadata: Metadata,
}

/// Opens the TIFF beside an image with one more extension; `None` if there is none. Some servers answer with other content.
fn beside(path: &Path, extension: &str, cache: &Arc<BlockCache>) -> Result<Option<Arc<TiffFile>>, GenError> {
    let beside = with_more(path, extension);
    let source: Arc<dyn TiffSource> = if is_remote(&beside) {
        let Some(file) = RemoteBytes::open_if_present(&beside, cache)? else { return Ok(None) };
        if !matches!(file.head(), [b'I', b'I', ..] | [b'M', b'M', ..]) {
            return Ok(None);
        }
        Arc::new(RemoteSource(file))
    } else {
        if !beside.is_file() {
            return Ok(None);
        }
        Arc::new(FileSource::open(&beside).map_err(|e| failed(&beside, e))?)
    };
    let options = OpenOptions { block_cache_bytes: 0, ..OpenOptions::default() };
    let file = TiffFile::from_source_with_options(source, options).map_err(|e| failed(&beside, e))?;
    Ok(Some(Arc::new(file)))
}

/// Finds the mask of an image of a size: an image of the file that says so, or the file beside it. Overviews of that file lie
/// in it, or beside it.
fn mask(
    path: &Path,
    file: &Arc<TiffFile>,
    size: [usize; 2],
    cache: &Arc<BlockCache>,
) -> Result<Option<Mask>, GenError> {
    let is_mask = |ifd: &Ifd| {
        let kind = ifd.tag(NEW_SUBFILE_TYPE).and_then(|tag| tag.value.as_u32()).unwrap_or(0);
        // Bit 2 marks a mask. Bit 0 marks that of an overview, which has another size.
        kind & 4 == 4 && is_image_of(ifd, size)
    };
    if let Some(index) = file.ifds().iter().position(is_mask) {
        return Ok(Some(Mask { file: file.clone(), index }));
    }
    let Some(whole) = beside(path, "msk", cache)? else { return Ok(None) };
    let of_size = |file: &Arc<TiffFile>| file.ifds().iter().position(|ifd| is_image_of(ifd, size));
    if let Some(index) = of_size(&whole) {
        return Ok(Some(Mask { file: whole, index }));
    }
    let Some(smaller) = beside(path, "msk.ovr", cache)? else { return Ok(None) };
    Ok(of_size(&smaller).map(|index| Mask { file: smaller, index }))
}

/// Returns true if an image has a size and one channel of one byte at most.
fn is_image_of(ifd: &Ifd, size: [usize; 2]) -> bool {
    ifd.raster_layout().is_ok_and(|layout| {
        [layout.width, layout.height] == size && layout.bytes_per_sample == 1 && layout.samples_per_pixel == 1
    })
}

/// Returns the text of the item of GDAL's metadata with an attribute, of a channel.
fn item_of(xml: &str, attribute: &str, channel: Option<usize>) -> Option<String> {
    let items = xml.split("<Item ").skip(1).filter_map(|item| item.split('<').next()?.split_once('>'));
    let sample = channel.map(|channel| format!("sample=\"{channel}\""));
    let is_of_channel = |attributes: &str| match &sample {
        Some(sample) => attributes.contains(sample) || !attributes.contains("sample="),
        None => true,
    };
    let mut found = items.filter(|(attributes, _)| attributes.contains(attribute) && is_of_channel(attributes));
    found.next().map(|(_, value)| value.trim().to_owned())
}

/// Returns the numbers of a tag.
fn numbers(ifd: &Ifd, tag: u16) -> Option<Vec<f64>> {
    ifd.tag(tag)?.value.as_f64_vec()
}

/// Returns the keys of an image's reference system.
fn keys(ifd: &Ifd) -> GeoKeys {
    let text = ifd.tag(GEO_ASCII_PARAMS).and_then(|tag| tag.value.as_str()).unwrap_or_default();
    let directory = ifd.tag(GEO_KEY_DIRECTORY).and_then(|tag| tag.value.as_u16_slice()).unwrap_or_default();
    GeoKeys::new(directory.to_vec(), numbers(ifd, GEO_DOUBLE_PARAMS).unwrap_or_default(), text.to_owned())
}

/// Returns the transform in the tags ModelPixelScale and ModelTiepoint, or in ModelTransformation.
fn transform(ifd: &Ifd, keys: &GeoKeys) -> Option<GeoTransform> {
    let [scale, tie, matrix] = [MODEL_PIXEL_SCALE, MODEL_TIEPOINT, MODEL_TRANSFORMATION].map(|tag| numbers(ifd, tag));
    let mut transform = match (scale.as_deref(), tie.as_deref(), matrix.as_deref()) {
        (Some([sx, sy, ..]), Some([i, j, _, x, y, ..]), _) => {
            // Files with a negative scale have their north on top nevertheless, as GDAL reads them.
            let sy = sy.abs();
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
