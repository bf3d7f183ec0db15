//! Summary of the document of a map server, for `terrane info` of a raster overlay, and a check of its images. Blocking.

use std::sync::Arc;

use super::info::{BoundsInfo, Info, LevelInfo};
use super::report::too_many;
use super::verified::Verified;
use crate::fetch::{IoError, Limits, Source};
use crate::formats::decode_image;
use crate::formats::overlay::{DocumentImages, DocumentInfo, check_image};
use crate::math::WGS84;

/// Summarizes a document of `bytes` bytes.
pub(super) fn inspect_overlay(
    uri: &Arc<str>,
    bytes: usize,
    document: Result<DocumentInfo, String>,
) -> Result<Info, IoError> {
    let DocumentInfo { format, tiles, layers, .. } = document.map_err(|reason| IoError::invalid(uri, reason))?;
    let mut info = Info { format: format.to_owned(), bytes: bytes as u64, ..Info::default() };
    for (level, count) in (0..).zip(tiles.level_counts()) {
        info.levels.push(LevelInfo { level, tiles: count, contents: count, bytes: 0 });
        (info.tiles, info.contents) = (info.tiles + count, info.contents + count);
    }
    info.describe("tiling", tiles.projection());
    if let Some([width, height]) = tiles.finest_tile_px() {
        info.describe("images", format!("{width} x {height} pixels"));
    }
    if !layers.is_empty() {
        info.describe("layers", layers.join(", "));
    }
    info.bounds = BoundsInfo { center: [0.0; 3], radius_m: WGS84.semi_major_m, region: tiles.region().map(Vec::from) };
    info.attribution = tiles.credit.as_deref().map(str::to_owned);
    Ok(info)
}

/// Reads and decodes the images of a document. Those that are missing are counted: maps have holes.
pub(super) fn verify_overlay(
    uri: &Arc<str>,
    bytes: &[u8],
    document: Result<DocumentInfo, String>,
    (from, limits): (&Source, &Limits),
    progress: &mut dyn FnMut(&Verified),
) -> Result<Verified, IoError> {
    let document = document.map_err(|reason| IoError::invalid(uri, reason))?;
    let images = DocumentImages::new(uri, bytes, document.is_wmts)?;
    if images.count() > limits.max_elements as u64 {
        return Err(too_many(uri, limits.max_elements as u64));
    }
    let mut verified = Verified { bytes: bytes.len() as u64, ..Verified::default() };
    for (image, size_px) in images.uris() {
        let read = image.and_then(|image| {
            let bytes = from.read(&image)?;
            verified.bytes += bytes.len() as u64;
            check_image(&image, &bytes, size_px, limits)?;
            decode_image(&image, &bytes, limits)
        });
        match read {
            Err(IoError::NotFound { .. }) => {
                *verified.ignored.entry("overlay: image that is missing".to_owned()).or_default() += 1;
                continue;
            }
            Err(error) => verified.fail(&error),
            Ok(_) => {}
        }
        verified.contents += 1;
        progress(&verified);
    }
    Ok(verified)
}
