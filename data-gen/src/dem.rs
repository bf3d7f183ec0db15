//! Elevation rasters: GeoTIFF, HGT, terrain-RGB PNG and EXR, placed on the earth.

use std::io::{BufReader, Read as _};
use std::path::Path;

use tiff::decoder::DecodingResult;

use crate::placement::{GeoTransform, Placement};
use crate::projection::Crs;
use crate::{ElevationSource, GenError, geotiff};

/// Most samples of one raster.
const MAX_SAMPLES: usize = 1 << 30;
/// Samples that a byte of an EXR can hold at most: deflate packs 1,032 bytes into one.
const MOST_COMPRESSED: u64 = 1032;

/// One elevation file in memory.
pub struct Raster {
    width: usize,
    height: usize,
    /// Metres, north row first; NaN where unknown.
    samples: Vec<f32>,
    placement: Placement,
}

impl Raster {
    /// Reads a file; the format is told by its magic bytes, HGT by its name.
    pub fn read(path: &Path) -> Result<Self, GenError> {
        Self::read_in(path, None)
    }

    /// As [`Raster::read`], in the reference system that is given where the file names none of its own.
    pub fn read_in(path: &Path, given: Option<Crs>) -> Result<Self, GenError> {
        GenError::if_not_regular(path)?;
        let mut magic = [0u8; 8];
        let mut file = std::fs::File::open(path).map_err(GenError::file(path))?;
        let got = file.read(&mut magic).map_err(GenError::file(path))?;
        let is_hgt = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("hgt"));
        let mut raster = match &magic[..got] {
            _ if is_hgt => hgt(path)?,
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff(path, given)?,
            [0x89, b'P', b'N', b'G', ..] => terrain_rgb(path, given)?,
            [0x76, 0x2f, 0x31, 0x01, ..] => exr(path, given)?,
            _ => return Err(GenError::invalid(path, "neither GeoTIFF, HGT, PNG nor EXR")),
        };
        // -32768 is the void of SRTM whether the file says so or not; nothing on earth is beyond 12 km.
        for h in raster.samples.iter_mut().filter(|h| h.abs() > 12_000.0) {
            *h = f32::NAN;
        }
        if !raster.samples.iter().any(|h| h.is_finite()) {
            return Err(GenError::invalid(path, "no sample has a height"));
        }
        raster.placement = raster.placement.turned(raster.bounds());
        Ok(raster)
    }

    /// The same place, its longitudes a turn further east.
    pub(crate) fn turn_east(&mut self) {
        self.placement = self.placement.turned_east();
    }

    /// Width and height in samples.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Lowest and highest sample, metres.
    pub fn range_m(&self) -> [f32; 2] {
        let finite = self.samples.iter().filter(|h| h.is_finite());
        finite.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], h| [a.min(*h), b.max(*h)])
    }

    /// West, south, east, north in radians, of the outermost samples.
    pub fn bounds(&self) -> [f64; 4] {
        let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        let (w, h) = (self.width as f64, self.height as f64);
        for i in 0..=16 {
            let t = f64::from(i) / 16.0;
            let (c, r) = (0.5 + t * (w - 1.0), 0.5 + t * (h - 1.0));
            for (column, row) in [(c, 0.5), (c, h - 0.5), (0.5, r), (w - 0.5, r)] {
                let [lon, lat] = self.placement.place(column, row);
                b = [b[0].min(lon), b[1].min(lat), b[2].max(lon), b[3].max(lat)];
            }
        }
        b
    }
}

/// A place by a raster's sample centres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Among {
    /// Column and row, sample centres integral, of the nearest place between the outermost of them.
    pub nearest_px: [f64; 2],
    /// From there to the place, columns and rows; 0 along an axis on which it lies between the centres.
    pub beyond_px: [f64; 2],
}

impl Among {
    /// Half a pixel outside belongs to the outermost sample's area; a hair more is rounding.
    pub fn is_owned(&self) -> bool {
        self.beyond_px.iter().all(|b| b.abs() <= 0.501)
    }
}

impl Raster {
    /// Where a place in radians lies by the sample centres.
    pub(crate) fn among(&self, longitude: f64, latitude: f64) -> Option<Among> {
        let [c, r] = self.placement.pixel(longitude, latitude)?;
        let at = [c - 0.5, r - 0.5];
        let last = [self.width as f64 - 1.0, self.height as f64 - 1.0];
        let nearest_px = [0, 1].map(|k| at[k].clamp(0.0, last[k]));
        // A hair outside is rounding.
        let beyond_px = [0, 1].map(|k| at[k] - nearest_px[k]).map(|b: f64| if b.abs() < 1e-3 { 0.0 } else { b });
        Some(Among { nearest_px, beyond_px })
    }

    /// Between sample centres; where some of the four are unknown, the known ones by their weights.
    pub(crate) fn bilinear_m(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy, weight) in
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
        {
            let (i, j) = ((x0 as usize + dx).min(self.width - 1), (y0 as usize + dy).min(self.height - 1));
            let sample = f64::from(*self.samples.get(j * self.width + i)?);
            if weight > 0.0 && sample.is_finite() {
                sum += weight * sample;
                weights += weight;
            }
        }
        (weights > 1e-6).then(|| sum / weights)
    }

    /// A column's step east and a row's step north at the centre, radians; `None` for a raster that lies on its side.
    pub(crate) fn steps(&self) -> Option<[f64; 2]> {
        let (c, r) = (0.5 * self.width as f64, 0.5 * self.height as f64);
        let step = |[dc, dr]: [f64; 2]| {
            let ([a, b], [x, y]) = (self.placement.place(c - dc, r - dr), self.placement.place(c + dc, r + dr));
            [x - a, y - b]
        };
        let (column, row) = (step([0.5, 0.0]), step([0.0, 0.5]));
        (column[0].abs() > column[1].abs() && row[1].abs() > row[0].abs()).then_some([column[0], row[1]])
    }
}

impl ElevationSource for Raster {
    fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64> {
        let among = self.among(longitude, latitude).filter(Among::is_owned)?;
        self.bilinear_m(among.nearest_px)
    }
}

fn tiff(path: &Path, given: Option<Crs>) -> Result<Raster, GenError> {
    let t = geotiff::read(path)?;
    if t.channels != 1 {
        return Err(GenError::invalid(path, format!("TIFF with {} channels is no elevation", t.channels)));
    }
    let placement = Placement::of_tiff(path, &t, given)?;
    let [factor, offset] = t.metres().map_err(|reason| GenError::invalid(path, reason))?;
    let mut samples: Vec<f32> = match t.samples {
        DecodingResult::U8(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::U16(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::U32(v) => v.into_iter().map(|x| x as f32).collect(),
        DecodingResult::I8(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::I16(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::I32(v) => v.into_iter().map(|x| x as f32).collect(),
        DecodingResult::F32(v) => v,
        DecodingResult::F64(v) => v.into_iter().map(|x| x as f32).collect(),
        _ => return Err(GenError::invalid(path, "TIFF: sample format that is not read")),
    };
    let nodata = t.nodata.map(|n| n as f32);
    for h in &mut samples {
        // SRTM's void before it is feet, which would make a depth of it that there might be.
        let is_void = nodata == Some(*h) || *h == f32::from(i16::MIN);
        *h = if is_void { f32::NAN } else { (f64::from(*h) * factor + offset) as f32 };
    }
    // A TIFF is expected to know its place; pictures and EXR are not.
    let placement = placement
        .ok_or_else(|| GenError::invalid(path, "no georeference: neither GeoTIFF tags nor a world file beside it"))?;
    Ok(Raster { width: t.width, height: t.height, samples, placement })
}

/// SRTM tiles: big-endian int16, one degree, named by their south-west corner, samples on the edges.
fn hgt(path: &Path) -> Result<Raster, GenError> {
    let bytes = std::fs::read(path).map_err(GenError::file(path))?;
    let side = match bytes.len() {
        // Some distributors append a few bytes.
        n if (1201 * 1201 * 2..1202 * 1202 * 2).contains(&n) => 1201,
        n if (3601 * 3601 * 2..3602 * 3602 * 2).contains(&n) => 3601,
        n => return Err(GenError::invalid(path, format!("HGT of {n} bytes: neither 1201 nor 3601 samples a side"))),
    };
    let name = path.file_stem().and_then(|s| s.to_str()).unwrap_or("").to_ascii_uppercase();
    let corner = || -> Option<[f64; 2]> {
        let (ns, rest) = name.split_at_checked(1)?;
        let (lat, rest) = rest.split_at_checked(2)?;
        let (ew, lon) = rest.split_at_checked(1)?;
        let (lat, lon): (f64, f64) = (lat.parse().ok()?, lon.get(..3)?.parse().ok()?);
        let sign = |c: &str, plus: &str, minus: &str| match c {
            _ if c == plus => Some(1.0),
            _ if c == minus => Some(-1.0),
            _ => None,
        };
        Some([lon * sign(ew, "E", "W")?, lat * sign(ns, "N", "S")?])
    };
    let [west, south] = corner().ok_or_else(|| GenError::invalid(path, "HGT: the name is not like N42E001"))?;
    let pixel = 1.0 / (side - 1) as f64;
    let samples = bytes
        .chunks_exact(2)
        .take(side * side)
        .map(|b| match i16::from_be_bytes([b[0], b[1]]) {
            i16::MIN => f32::NAN,
            h => f32::from(h),
        })
        .collect();
    let origin = [west - 0.5 * pixel, south + 1.0 + 0.5 * pixel];
    let transform = GeoTransform { origin, dx: [pixel, 0.0], dy: [0.0, -pixel] };
    let placement = Placement::new(transform, Crs::Geographic);
    Ok(Raster { width: side, height: side, samples, placement })
}

/// Mapbox Terrain-RGB: `h = -10000 + (R * 65536 + G * 256 + B) / 10`, in 8-bit RGB or RGBA; other PNGs are something
/// else.
fn terrain_rgb(path: &Path, given: Option<Crs>) -> Result<Raster, GenError> {
    if let Some((bits, color)) = png_kind(path)?
        && !matches!((bits, color), (8, "RGB" | "RGBA"))
    {
        let reason =
            format!("PNG of {bits}-bit {color}: heights are read from terrain-RGB, which is 8-bit RGB or RGBA");
        return Err(GenError::invalid(path, reason));
    }
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let reader = image::ImageReader::with_format(BufReader::new(file), image::ImageFormat::Png);
    let image = reader.decode().map_err(|e| GenError::invalid(path, format!("PNG: {e}")))?.into_rgba8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let samples = image
        .pixels()
        .map(|p| match p.0 {
            [.., 0] => f32::NAN,
            [r, g, b, _] => (-10_000.0 + 0.1 * (f64::from(r) * 65536.0 + f64::from(g) * 256.0 + f64::from(b))) as f32,
        })
        .collect();
    let placement = Placement::of_picture(path, [width, height], given)?;
    Ok(Raster { width, height, samples, placement })
}

/// Bits of a sample (of an index, with a palette) and the colour type, from the IHDR chunk, which is always the first;
/// `None` where the file ends before them. The decoder tells what it makes of them, not what is there.
fn png_kind(path: &Path) -> Result<Option<(u8, &'static str)>, GenError> {
    let mut header = Vec::new();
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    file.take(26).read_to_end(&mut header).map_err(GenError::file(path))?;
    let Some(&[bits, color]) = header.get(24..26) else { return Ok(None) };
    let color = match color {
        0 => "grey",
        2 => "RGB",
        3 => "palette",
        4 => "grey with alpha",
        6 => "RGBA",
        _ => "unknown colour type",
    };
    Ok(Some((bits, color)))
}

/// An EXR's channel Y, or its R, or its only one; metres.
fn exr(path: &Path, given: Option<Crs>) -> Result<Raster, GenError> {
    use exr::prelude::{ReadChannels as _, ReadLayers as _};
    let bad = |e: String| GenError::invalid(path, format!("EXR: {e}"));
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let chunks = exr::block::read(BufReader::new(file), false).map_err(|e| bad(e.to_string()))?;
    // The headers first: the decoder takes memory for whatever size they say.
    let file_bytes = std::fs::metadata(path).map_err(GenError::file(path))?.len();
    let believed = file_bytes.saturating_mul(MOST_COMPRESSED).max(1 << 20).min(MAX_SAMPLES as u64);
    for header in chunks.headers() {
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        let channels = header.channels.list.len();
        if width.saturating_mul(height).saturating_mul(channels) as u64 > believed {
            return Err(bad(format!("{width} x {height} samples of {channels} channels in {file_bytes} bytes")));
        }
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_chunks(chunks)
        .map_err(|e| bad(e.to_string()))?;
    let (width, height) = (image.layer_data.size.width(), image.layer_data.size.height());
    if width == 0 || height == 0 || width.saturating_mul(height) > MAX_SAMPLES {
        return Err(bad(format!("{width} x {height} samples")));
    }
    let channels = &image.layer_data.channel_data.list;
    let named = |name: &str| channels.iter().find(|c| c.name.eq(name));
    let channel = named("Y").or_else(|| named("R")).or_else(|| channels.first());
    let channel = channel.ok_or_else(|| bad("no channel".to_owned()))?;
    let samples: Vec<f32> = channel.sample_data.values_as_f32().collect();
    if samples.len() != width * height {
        return Err(bad("subsampled channel".to_owned()));
    }
    let placement = Placement::of_picture(path, [width, height], given)?;
    Ok(Raster { width, height, samples, placement })
}
