//! Readers of elevation files: GeoTIFF, HGT, terrain-RGB PNG and EXR.

use std::io::{BufReader, Read as _};
use std::path::Path;

use tiff::decoder::DecodingResult;

use super::raster::Raster;
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement, geotiff};

/// Largest number of samples in one raster.
const MAX_SAMPLES: usize = 1 << 30;
/// Largest number of samples that one byte of an EXR can hold: deflate packs at most 1,032 bytes into one.
const MAX_SAMPLES_PER_BYTE: u64 = 1032;

impl Raster {
    /// Reads an elevation file. Its format is recognised by its first bytes, HGT by the extension of its name.
    pub fn read(path: &Path) -> Result<Self, GenError> {
        Self::read_in(path, None)
    }

    /// Like [`Raster::read`]; `given` is the reference system of files that do not name their own.
    pub fn read_in(path: &Path, given: Option<Crs>) -> Result<Self, GenError> {
        GenError::if_not_regular(path)?;
        let mut magic = [0u8; 8];
        let mut file = std::fs::File::open(path).map_err(GenError::file(path))?;
        let got = file.read(&mut magic).map_err(GenError::file(path))?;
        let is_hgt = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("hgt"));
        let raster = match &magic[..got] {
            _ if is_hgt => hgt(path)?,
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff(path, given)?,
            [0x89, b'P', b'N', b'G', ..] => terrain_rgb(path, given)?,
            [0x76, 0x2f, 0x31, 0x01, ..] => exr(path, given)?,
            _ => return Err(GenError::invalid(path, "neither GeoTIFF, HGT, PNG nor EXR")),
        };
        if raster.has_heights() { Ok(raster) } else { Err(GenError::invalid(path, "no sample has a height")) }
    }
}

fn tiff(path: &Path, given: Option<Crs>) -> Result<Raster, GenError> {
    let t = geotiff::read(path)?;
    if t.channels != 1 {
        return Err(GenError::invalid(path, format!("TIFF with {} channels; elevation has one channel", t.channels)));
    }
    let placement = Placement::of_tiff(path, &t, given)?;
    let [factor, offset] = t.factor_and_offset_m().map_err(|reason| GenError::invalid(path, reason))?;
    let mut samples: Vec<f32> = match t.samples {
        DecodingResult::U8(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::U16(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::U32(v) => v.into_iter().map(|x| x as f32).collect(),
        DecodingResult::I8(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::I16(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::I32(v) => v.into_iter().map(|x| x as f32).collect(),
        DecodingResult::F32(v) => v,
        DecodingResult::F64(v) => v.into_iter().map(|x| x as f32).collect(),
        _ => return Err(GenError::invalid(path, "TIFF: unsupported sample format")),
    };
    let nodata = t.nodata.map(|n| n as f32);
    for h in &mut samples {
        // -32768 marks missing data in SRTM. In feet it would become a depth above the limit for impossible heights.
        let is_void = nodata == Some(*h) || *h == f32::from(i16::MIN);
        *h = if is_void { f32::NAN } else { (f64::from(*h) * factor + offset) as f32 };
    }
    // PNG and EXR files have a default position; a TIFF must have a georeference.
    let placement = placement
        .ok_or_else(|| GenError::invalid(path, "no georeference: neither GeoTIFF tags nor a world file beside it"))?;
    Ok(Raster::new([t.width, t.height], samples, placement))
}

/// Reads an SRTM tile: big-endian int16 over one degree, with samples on the edges. Its name gives the south-west corner.
fn hgt(path: &Path) -> Result<Raster, GenError> {
    let bytes = std::fs::read(path).map_err(GenError::file(path))?;
    let side = match bytes.len() {
        // Some distributors append a few bytes to the samples.
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
    Ok(Raster::new([side, side], samples, placement))
}

/// Reads Mapbox Terrain-RGB: `h = -10000 + (R * 65536 + G * 256 + B) / 10`. PNGs that are not 8-bit RGB or RGBA hold
/// something else and are refused.
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
    let placement = Placement::of_image(path, [width, height], given)?;
    Ok(Raster::new([width, height], samples, placement))
}

/// Returns the bits of a sample (of a palette index, if there is a palette) and the colour type from the IHDR chunk,
/// which is always the first. `None` if the file is too short. The decoder reports the format after its conversion, so
/// the chunk is read here.
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

/// Reads the channel Y of an EXR in metres; without one the channel R, without both the first channel.
fn exr(path: &Path, given: Option<Crs>) -> Result<Raster, GenError> {
    use exr::prelude::{ReadChannels as _, ReadLayers as _};
    let bad = |e: String| GenError::invalid(path, format!("EXR: {e}"));
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let chunks = exr::block::read(BufReader::new(file), false).map_err(|e| bad(e.to_string()))?;
    // The decoder allocates memory for the size in the headers, so the size is checked first.
    let file_bytes = std::fs::metadata(path).map_err(GenError::file(path))?.len();
    let max_samples = file_bytes.saturating_mul(MAX_SAMPLES_PER_BYTE).max(1 << 20).min(MAX_SAMPLES as u64);
    for header in chunks.headers() {
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        let channels = header.channels.list.len();
        if width.saturating_mul(height).saturating_mul(channels) as u64 > max_samples {
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
    let placement = Placement::of_image(path, [width, height], given)?;
    Ok(Raster::new([width, height], samples, placement))
}
