//! EXR files with a channel of heights.

use std::io::BufReader;
use std::path::Path;

use exr::image::{AnyChannel, AnyChannels, FlatSamples, Layer};
use exr::prelude::{ReadChannels as _, ReadLayers as _};

use super::super::raster::Raster;
use super::{MAX_SAMPLES, RasterOptions};
use crate::GenError;
use crate::georeference::Placement;

/// Largest number of samples that one byte of an EXR can hold: deflate packs at most 1,032 bytes into one.
const MAX_SAMPLES_PER_BYTE: u64 = 1032;

/// Reads the channel that the options name; without a name the only one, or Y, or one of equal channels R, G and B.
pub(super) fn read(path: &Path, options: &RasterOptions) -> Result<Raster, GenError> {
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
        .all_layers()
        .all_attributes()
        .from_chunks(chunks)
        .map_err(|e| bad(e.to_string()))?;
    let (layer, channel) = choose(&image.layer_data, options.channel.as_deref()).map_err(bad)?;
    let (width, height) = (layer.size.width(), layer.size.height());
    if width == 0 || height == 0 || width.saturating_mul(height) > MAX_SAMPLES {
        return Err(bad(format!("{width} x {height} samples")));
    }
    let samples: Vec<f32> = channel.sample_data.values_as_f32().map(|sample| options.height_m(sample)).collect();
    if samples.len() != width * height {
        return Err(bad("subsampled channel".to_owned()));
    }
    let placement = Placement::of_image(path, [width, height], options.crs.clone())?;
    Ok(Raster::new([width, height], samples, placement))
}

type Channel = AnyChannel<FlatSamples>;
type Part = Layer<AnyChannels<FlatSamples>>;

/// Chooses a channel by its name, or by its part's name, a colon and its own. The error lists the channels.
fn choose<'a>(parts: &'a [Part], wanted: Option<&str>) -> Result<(&'a Part, &'a Channel), String> {
    let all = || parts.iter().flat_map(|part| part.channel_data.list.iter().map(move |channel| (part, channel)));
    let full = |(part, channel): (&Part, &Channel)| match &part.attributes.layer_name {
        Some(name) if parts.len() > 1 => format!("{name}:{}", channel.name),
        _ => channel.name.to_string(),
    };
    let named = |wanted: &str| {
        let by_name = all().find(|found| full(*found) == wanted);
        by_name.or_else(|| all().find(|(_, channel)| channel.name.eq(wanted)))
    };
    let list = || all().map(full).collect::<Vec<_>>().join(", ");
    if let Some(wanted) = wanted {
        return named(wanted).ok_or_else(|| format!("no channel {wanted}; the file has {}", list()));
    }
    let mut others = all().filter(|(_, channel)| !channel.name.eq("A"));
    if let (Some(only), None) = (others.next(), others.next()) {
        return Ok(only);
    }
    if let Some(luminance) = named("Y") {
        return Ok(luminance);
    }
    let [red, green, blue] = ["R", "G", "B"].map(named);
    let values = |found: Option<(&'a Part, &'a Channel)>| found.map(|(_, c)| c.sample_data.values_as_f32());
    let are_equal = |other| match (values(red), values(other)) {
        (Some(a), Some(b)) => a.map(f32::to_bits).eq(b.map(f32::to_bits)),
        _ => false,
    };
    match red {
        Some(red) if are_equal(green) && are_equal(blue) => Ok(red),
        _ => Err(format!("several channels: {}; --channel NAME chooses the one with heights", list())),
    }
}
