//! Summary of a terrain service, for `terrane info` of a layer.json: what the file names. No tile is read. Blocking.

use std::sync::Arc;

use super::info::{BoundsInfo, Info, LevelInfo};
use super::tree::read_companions;
use crate::fetch::{IoError, Source, encoding, printable};
use crate::formats::ignored::Notes;
use crate::formats::options::ReadOptions;
use crate::formats::terrain::{Layer, read_layers};
use crate::math::WGS84;

/// Summarizes a layer.json and the layers below it. Tiles that only the metadata of other tiles names are not counted.
pub(super) fn inspect_terrain(
    uri: &Arc<str>,
    bytes: &[u8],
    options: &ReadOptions,
    from: &Source,
) -> Result<Info, IoError> {
    let bytes = encoding::gunzip(uri, bytes.to_vec(), &options.limits)?;
    let mut info = Info { format: "quantized-mesh terrain".to_owned(), ..Info::default() };
    info.bytes = bytes.len() as u64;
    let companions = read_companions(from, uri, &bytes, None, &mut options.clone(), &mut info.bytes);
    companions.iter().filter_map(|(_, read)| read.as_ref().err()).for_each(|error| info.fail(error));
    let notes = Notes::default();
    let layers = read_layers(uri, &bytes, &companions, options, &notes)?;
    for layer in &layers {
        info.add_layer(layer);
    }
    if let Some(layer) = layers.first() {
        info.version = layer.version.clone().unwrap_or_default();
        info.bounds.region = layer.bounds.map(Vec::from);
        info.describe("tiling", layer.projection());
    }
    let templates: Vec<String> = layers.iter().map(Layer::template).collect();
    info.describe("layers", templates.join(", "));
    if let Some(levels) = layers.iter().find_map(Layer::metadata_levels) {
        info.describe(
            "named",
            format!("tiles of every level that {levels} divides name those below in their metadata"),
        );
    }
    let credits: Vec<&str> = layers.iter().filter_map(|layer| layer.attribution.as_deref()).collect();
    info.attribution = (!credits.is_empty()).then(|| credits.join("; "));
    info.ignored = notes.into_ignored().iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
    Ok(info)
}

impl Info {
    fn add_layer(&mut self, layer: &Layer) {
        for (level, count) in (0..).zip(layer.tile_counts()) {
            if self.levels.len() <= level as usize {
                self.levels.push(LevelInfo { level, ..LevelInfo::default() });
            }
            let known = &mut self.levels[level as usize];
            (known.tiles, known.contents) = (known.tiles + count, known.contents + count);
            (self.tiles, self.contents) = (self.tiles + count, self.contents + count);
        }
        self.extensions.extend(layer.extensions.iter().map(|name| printable(name).into_owned()));
        self.bounds = BoundsInfo { radius_m: WGS84.semi_major_m, ..BoundsInfo::default() };
    }
}
