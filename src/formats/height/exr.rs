//! Decodes the heights of an EXR file.

use std::borrow::Cow;
use std::io::Cursor;

use ::exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read as exr_read};

use crate::fetch::{IoError, Limits, about_to_allocate};

/// Decodes `stride * stride` heights in metres, southern row first, each row from west to east.
pub(super) fn decode_heights(uri: &str, bytes: &[u8], stride: usize, limits: &Limits) -> Result<Vec<f32>, IoError> {
    let bad = |reason: String| IoError::invalid(uri, reason);
    // The size is checked before decoding, so that a wrong size allocates no memory.
    let meta = ::exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false)
        .map_err(|e| bad(format!("EXR header: {e}")))?;
    for header in &meta.headers {
        let size = header.layer_size;
        if size.width() != stride || size.height() != stride {
            return Err(bad(format!(
                "EXR of {} x {} samples, {stride} x {stride} expected",
                size.width(),
                size.height()
            )));
        }
        if header.channels.list.len() > 8 || (stride * stride * 32) as u64 > limits.max_image_bytes {
            return Err(bad("EXR with too many channels".to_owned()));
        }
        about_to_allocate((stride * stride * 32) as u64).map_err(|error| error.at(uri))?;
    }
    let image = exr_read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|e| bad(format!("EXR: {e}")))?;
    let channels = &image.layer_data.channel_data.list;
    let channel = channels
        .iter()
        .find(|c| c.name.eq("Y"))
        .or_else(|| channels.first().filter(|_| channels.len() == 1))
        .ok_or_else(|| bad("EXR without a channel Y".to_owned()))?;
    let samples: Cow<'_, [f32]> = match &channel.sample_data {
        FlatSamples::F32(samples) => samples.into(),
        other => other.values_as_f32().collect(),
    };
    if samples.len() != stride * stride {
        return Err(bad(format!("EXR with {} samples, {} expected", samples.len(), stride * stride)));
    }
    if !samples.iter().all(|h| h.is_finite() && h.abs() < 1e6) {
        return Err(bad("EXR with a height that is not finite".to_owned()));
    }
    // Images begin with the northern row, tiles with the southern one.
    let mut heights = Vec::with_capacity(samples.len());
    samples.chunks_exact(stride).rev().for_each(|row| heights.extend_from_slice(row));
    Ok(heights)
}
