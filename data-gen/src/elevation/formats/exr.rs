//! EXR files with a channel of heights.

use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use exr::image::FlatSamples;
use exr::meta::header::Header;
use exr::prelude::{ReadChannels as _, ReadLayers as _};

use super::{MAX_SAMPLES_PER_BYTE, Opened, RasterOptions};
use crate::GenError;
use crate::georeference::Placement;
use crate::store::{BlockCache, FileState, WholeReader, whole};

/// Largest number of samples of an image, which is decoded in memory.
const MAX_SAMPLES: u64 = 1 << 30;

/// An EXR file with heights.
struct ExrFile {
    path: PathBuf,
    options: RasterOptions,
    chosen: Chosen,
    size: [usize; 2],
    state: FileState,
}

/// Opens the channel that the options name; without a name the only one, or Y, or one of equal channels R, G and B.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let state = FileState::of(path)?;
    let chunks = chunks(path, state.bytes())?;
    let chosen = choose(chunks.headers(), options.channel.as_deref()).map_err(|reason| bad(path, reason))?;
    let size = chunks.headers()[chosen.part].layer_size;
    let size = [size.width(), size.height()];
    if size.contains(&0) {
        return Err(bad(path, format!("{} x {} samples", size[0], size[1])));
    }
    let placement = Placement::of_image(path, size, options.crs.clone(), cache)?.unwrap_or_default();
    let file = ExrFile { path: path.to_owned(), options: options.clone(), chosen, size, state };
    let (grid, reader) = whole(Box::new(file), size, cache);
    Ok(Opened { grid, reader, placement })
}

fn bad(path: &Path, reason: String) -> GenError {
    GenError::invalid(path, format!("EXR: {reason}"))
}

/// Opens a file and reads its headers. Sizes that its bytes cannot hold are refused, because the decoder allocates memory for
/// them.
fn chunks(path: &Path, bytes: u64) -> Result<exr::block::reader::Reader<BufReader<std::fs::File>>, GenError> {
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let chunks = exr::block::read(BufReader::new(file), false).map_err(|e| bad(path, e.to_string()))?;
    let max_samples = bytes.saturating_mul(MAX_SAMPLES_PER_BYTE).clamp(1 << 20, MAX_SAMPLES);
    for header in chunks.headers() {
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        let channels = header.channels.list.len();
        if width.saturating_mul(height).saturating_mul(channels) as u64 > max_samples {
            return Err(bad(path, format!("{width} x {height} samples of {channels} channels in {bytes} bytes")));
        }
    }
    Ok(chunks)
}

impl WholeReader for ExrFile {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        self.state.check(&self.path)?;
        let bad = |reason: String| bad(&self.path, reason);
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .all_layers()
            .all_attributes()
            .non_parallel()
            .from_chunks(chunks(&self.path, self.state.bytes())?)
            .map_err(|e| bad(e.to_string()))?;
        let Chosen { part, channel, equal } = &self.chosen;
        let layer = image.layer_data.get(*part).ok_or_else(|| bad(format!("no part {part}")))?;
        let named = |name: &str| {
            let found = layer.channel_data.list.iter().find(|other| other.name.eq(name));
            found.map(|found| &found.sample_data).ok_or_else(|| bad(format!("no channel {name}")))
        };
        let samples = named(channel)?;
        for other in *equal {
            let bits = |samples: &FlatSamples| samples.values_as_f32().map(f32::to_bits).collect::<Vec<_>>();
            if bits(named(other)?) != bits(samples) {
                let names: Vec<String> = layer.channel_data.list.iter().map(|c| c.name.to_string()).collect();
                return Err(bad(several(&names.join(", "))));
            }
        }
        let heights: Vec<u32> = samples.values_as_f32().map(|h| self.options.height_m(h).to_bits()).collect();
        if heights.len() != self.size[0] * self.size[1] {
            return Err(bad("subsampled channel".to_owned()));
        }
        call(&heights)
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

/// A channel of a file.
#[derive(Debug)]
struct Chosen {
    /// The index of its part.
    part: usize,
    channel: String,
    /// The channels of the part whose samples have to be equal to its own.
    equal: &'static [&'static str],
}

fn several(list: &str) -> String {
    format!("several channels: {list}; --channel NAME chooses the one with heights")
}

/// Chooses a channel by its name, or by its part's name, a colon and its own. The error lists the channels.
fn choose(parts: &[Header], wanted: Option<&str>) -> Result<Chosen, String> {
    let channels: Vec<(usize, String, String)> = parts
        .iter()
        .enumerate()
        .flat_map(|(k, part)| {
            let full = move |name: &str| match &part.own_attributes.layer_name {
                Some(layer) if parts.len() > 1 => format!("{layer}:{name}"),
                _ => name.to_owned(),
            };
            part.channels.list.iter().map(move |channel| (k, channel.name.to_string(), full(&channel.name.to_string())))
        })
        .collect();
    let named = |wanted: &str| {
        let by_full = channels.iter().find(|(.., full)| full == wanted);
        by_full.or_else(|| channels.iter().find(|(_, name, _)| name == wanted))
    };
    let chosen = |(part, name, _): &(usize, String, String), equal: &'static [&'static str]| {
        Ok(Chosen { part: *part, channel: name.clone(), equal })
    };
    let list = channels.iter().map(|(.., full)| full.as_str()).collect::<Vec<_>>().join(", ");
    if let Some(wanted) = wanted {
        return named(wanted)
            .map_or_else(|| Err(format!("no channel {wanted}; the file has {list}")), |c| chosen(c, &[]));
    }
    let mut others = channels.iter().filter(|(_, name, _)| name != "A");
    if let (Some(only), None) = (others.next(), others.next()) {
        return chosen(only, &[]);
    }
    if let Some(luminance) = named("Y") {
        return chosen(luminance, &[]);
    }
    match ["R", "G", "B"].map(named) {
        [Some(red), Some(green), Some(blue)] if red.0 == green.0 && red.0 == blue.0 => chosen(red, &["G", "B"]),
        _ => Err(several(&list)),
    }
}
