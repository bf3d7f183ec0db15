//! [`Layer`]: a layer.json, and the layers that it is laid over. Decode threads.

use std::sync::Arc;

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::availability::{Availability, MAX_LEVEL, RangeJson};
use super::tiling::{Rectangle, Tiling};
use crate::fetch::markup::{plain_text, refuse_markup};
use crate::fetch::{IoError, Limits, encoding, shown};
use crate::formats::ignored::Notes;
use crate::formats::implicit::{TileCoordinates, UriTemplate};
use crate::formats::lenient::{Number, Numbers, Text, texts};
use crate::formats::options::{Fetched, ReadOptions};

/// The maximum number of layers: a loader asks for further files a limited number of times.
const MAX_LAYERS: usize = crate::formats::options::MAX_DEPENDENCY_ROUNDS + 1;
/// The finest level of a layer that names neither its tiles nor a level.
const USUAL_MAX_ZOOM: u32 = 18;
/// The extensions of tiles that are asked for, by their names in layer.json.
const EXTENSIONS: [&str; 3] = ["octvertexnormals", "watermask", "metadata"];

/// layer.json as serde reads it.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct LayerJson {
    #[serde(default, deserialize_with = "texts")]
    tiles: Vec<String>,
    #[serde(default)]
    version: Text,
    #[serde(default)]
    format: Text,
    #[serde(default)]
    scheme: Text,
    #[serde(default)]
    projection: Text,
    #[serde(default)]
    attribution: Text,
    #[serde(default)]
    parent_url: Text,
    /// West, south, east and north, degrees.
    bounds: Option<Numbers>,
    #[serde(rename = "minzoom")]
    min_zoom: Option<Number>,
    #[serde(rename = "maxzoom")]
    max_zoom: Option<Number>,
    available: Option<Vec<Vec<RangeJson>>>,
    metadata_availability: Option<u32>,
    #[serde(default, deserialize_with = "texts")]
    extensions: Vec<String>,
}

/// A service of terrain tiles.
#[derive(Debug)]
pub(in crate::formats) struct Layer {
    pub(super) tiling: Tiling,
    /// Equal services; each tile belongs to one of them.
    templates: Vec<UriTemplate>,
    /// Rows are counted from the north in URLs.
    counts_from_north: bool,
    /// The tiles that layer.json names. With `metadata_levels` those of level 0.
    pub(super) available: Availability,
    /// Tiles of the levels that this number divides name the tiles below them in their metadata.
    pub(super) metadata_levels: Option<u32>,
    /// The version of the data.
    pub version: Option<String>,
    /// The credit that the service asks for, as plain text.
    pub attribution: Option<String>,
    /// The extensions that the tiles have.
    pub extensions: Vec<String>,
    /// West, south, east and north of the data, radians.
    pub bounds: Option<[f64; 4]>,
}

/// Returns true for the JSON of a terrain service.
pub(in crate::formats) fn is_layer_text(text: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Probe {
        tiles: Option<IgnoredAny>,
        tilejson: Option<IgnoredAny>,
        format: Option<IgnoredAny>,
        asset: Option<IgnoredAny>,
        root: Option<IgnoredAny>,
    }
    // Other files are large, and few name one of these.
    const NAMES: [&str; 3] = ["\"tiles\"", "\"tilejson\"", "\"format\""];
    if !std::str::from_utf8(text).is_ok_and(|text| NAMES.iter().any(|name| text.contains(name))) {
        return false;
    }
    let Ok(Probe { tiles, tilejson, format, asset, root }) = serde_json::from_slice::<Probe>(text) else {
        return false;
    };
    (tiles.is_some() || tilejson.is_some() || format.is_some()) && asset.is_none() && root.is_none()
}

/// Returns true for the bytes of a layer.json, whatever its name.
pub(in crate::formats) fn is_layer(uri: &str, bytes: &[u8], limits: &Limits) -> bool {
    let is_text = |bytes: &[u8]| {
        let (text, first) = crate::fetch::markup::text_and_first_byte(bytes);
        first == Some(b'{') && is_layer_text(text)
    };
    if bytes.starts_with(&[0x1f, 0x8b]) {
        return encoding::gunzip(uri, bytes.to_vec(), limits).is_ok_and(|bytes| is_text(&bytes));
    }
    is_text(bytes)
}

/// Returns the layer.json of the layer below and, as far as `known` has them, of those below that.
pub(in crate::formats) fn parent_files(
    base: &str,
    text: &[u8],
    known: &[Fetched],
    options: &ReadOptions,
) -> Vec<Arc<str>> {
    let mut files: Vec<Arc<str>> = Vec::new();
    let mut next = parent_of(base, text, options);
    while let Some(uri) = next.filter(|uri| !files.contains(uri) && files.len() + 1 < MAX_LAYERS) {
        next = file(known, &uri, options).ok().and_then(|text| parent_of(&uri, &text, &unmoved(options)));
        files.push(uri);
    }
    files
}

/// Returns the layer.json that another one names as its parent, if that is allowed.
fn parent_of(base: &str, text: &[u8], options: &ReadOptions) -> Option<Arc<str>> {
    #[derive(Deserialize)]
    #[serde(rename_all = "camelCase")]
    struct Probe {
        #[serde(default)]
        parent_url: Text,
    }
    // The decoder returns the error.
    options.limits.check_json("", text).ok()?;
    let Probe { parent_url } = serde_json::from_slice(text).ok()?;
    let parent_url = parent_url.0.filter(|url| !url.is_empty())?;
    let (uri, _) = options.resolve(base, &file_in(&parent_url)).ok()?;
    Some(uri)
}

/// Returns the reference of the layer.json in a folder. Services name the folder.
fn file_in(parent_url: &str) -> String {
    let (path, query) = parent_url.split_once('?').map_or((parent_url, None), |(path, query)| (path, Some(query)));
    let query = query.map_or(String::new(), |query| format!("?{query}"));
    match path.ends_with(".json") {
        true => parent_url.to_owned(),
        false => format!("{}/layer.json{query}", path.trim_end_matches('/')),
    }
}

/// Returns the options for references in a file that no redirect moved.
fn unmoved(options: &ReadOptions) -> ReadOptions {
    ReadOptions { base: None, ..options.clone() }
}

fn file(known: &[Fetched], uri: &str, options: &ReadOptions) -> Result<Vec<u8>, IoError> {
    let found = known.iter().find(|(fetched, _)| **fetched == *uri);
    let bytes = found.map_or_else(|| Err(IoError::NotFound { uri: uri.to_owned() }), |(_, read)| read.clone())?;
    encoding::gunzip(uri, bytes, &options.limits)
}

/// Reads a layer.json and the layers below it, the upper ones first. Layers below that cannot be read are noted: the others
/// are drawn without them.
pub(in crate::formats) fn read_layers(
    uri: &str,
    text: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Vec<Layer>, IoError> {
    let (first, mut parent) = Layer::parse(uri, text, options, notes)?;
    let (mut layers, mut seen) = (vec![first], vec![Arc::<str>::from(uri)]);
    let below = unmoved(options);
    let mut base = (uri.to_owned(), options.clone());
    while let Some(reference) = parent.take() {
        let read = base.1.resolve(&base.0, &file_in(&reference)).and_then(|(uri, _)| {
            if seen.contains(&uri) {
                return Err(IoError::unsupported(&uri, "a layer below itself"));
            }
            if seen.len() >= MAX_LAYERS {
                return Err(IoError::unsupported(&uri, format!("more than {MAX_LAYERS} layers")));
            }
            let bytes = file(companions, &uri, options)?;
            let (layer, parent) = Layer::parse(&uri, &bytes, &below, notes)?;
            if layer.tiling != layers[0].tiling {
                return Err(IoError::unsupported(&uri, "a layer below one of another projection"));
            }
            seen.push(uri.clone());
            Ok((uri, layer, parent))
        });
        match read {
            Ok((uri, layer, next)) => {
                layers.push(layer);
                (base, parent) = ((uri.to_string(), below.clone()), next);
            }
            Err(error) => {
                notes.add_missing("layer.json: a parent layer that cannot be read", &error);
                notes.add(format!("layer.json: parent layer: {}", error.reason()));
            }
        }
    }
    Ok(layers)
}

impl Layer {
    /// Parses a layer.json. Returns the reference of its parent too.
    fn parse(uri: &str, text: &[u8], options: &ReadOptions, notes: &Notes) -> Result<(Self, Option<String>), IoError> {
        let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
        refuse_markup(uri, text)?;
        options.limits.check_json(uri, text)?;
        let bad = |reason: String| IoError::invalid(uri, format!("layer.json: {reason}"));
        let json: LayerJson = serde_json::from_slice(text).map_err(|e| bad(e.to_string()))?;
        let unsupported = |what: String| Err(IoError::unsupported(uri, what));
        match json.format.0.as_deref() {
            Some(format) if format.starts_with("quantized-mesh-1.") => {}
            Some(format) => return unsupported(format!("terrain tiles of the format {format:.40}")),
            None => notes.add("layer.json: no format; quantized-mesh-1.0 is assumed"),
        }
        let tiling = match json.projection.0.as_deref() {
            None | Some("EPSG:4326") => Tiling::Geographic,
            Some("EPSG:3857") => Tiling::Mercator,
            Some(other) => return unsupported(format!("terrain in the projection {other:.40}")),
        };
        let counts_from_north = match json.scheme.0.as_deref() {
            None | Some("tms") => false,
            Some("slippyMap") => true,
            Some(other) => return unsupported(format!("terrain tiles of the scheme {other:.40}")),
        };
        if json.tiles.is_empty() {
            return Err(bad("tiles has no template".to_owned()));
        }
        let version = json.version.0;
        let resolve = |template: &String| {
            let template = template.replace("{version}", version.as_deref().unwrap_or_default());
            UriTemplate::resolve(uri, &template, options)
        };
        let templates = json.tiles.iter().map(resolve).collect::<Result<Vec<_>, _>>()?;
        let bounds = json.bounds.as_ref().and_then(|bounds| usable_bounds(&bounds.0, notes));
        let zoom = |zoom: Option<Number>, name: &str| match zoom {
            None => Ok(None),
            Some(Number(level)) if (0.0..=f64::from(MAX_LEVEL)).contains(&level) => Ok(Some(level as u32)),
            Some(Number(level)) => Err(bad(format!("{name} is {level}, expected 0 to {MAX_LEVEL}"))),
        };
        let (min_zoom, max_zoom) = (zoom(json.min_zoom, "minzoom")?, zoom(json.max_zoom, "maxzoom")?);
        if let (Some(min), Some(max)) = (min_zoom, max_zoom)
            && min > max
        {
            return Err(bad(format!("minzoom {min} is above maxzoom {max}")));
        }
        let metadata_levels = json.metadata_availability.filter(|levels| *levels > 0);
        if json.metadata_availability.is_some() && metadata_levels.is_none() {
            notes.add("layer.json: metadataAvailability is 0");
        }
        let available = match (&json.available, metadata_levels) {
            (_, Some(_)) => Availability::roots(tiling),
            (Some(ranges), None) => listed(ranges, tiling, max_zoom, notes).map_err(bad)?,
            (None, None) => {
                notes.add("layer.json: neither available nor metadataAvailability; tiles up to maxzoom are tried");
                let over = bounds.map(|[west, south, east, north]| Rectangle { west, south, east, north });
                let levels = min_zoom.unwrap_or(0)..=max_zoom.unwrap_or(USUAL_MAX_ZOOM);
                Availability::over(over.as_ref(), levels, tiling)
            }
        };
        for name in json.extensions.iter().filter(|name| !EXTENSIONS.contains(&name.as_str())) {
            notes.add(format!("layer.json: extension {name}"));
        }
        let attribution = json.attribution.0.map(|html| plain_text(&html)).filter(|text| !text.is_empty());
        let layer = Self {
            tiling,
            templates,
            counts_from_north,
            available,
            metadata_levels,
            version,
            attribution,
            extensions: json.extensions,
            bounds,
        };
        Ok((layer, json.parent_url.0.filter(|url| !url.is_empty())))
    }

    /// Returns the URI of a tile, and the URI at which it is looked for if that has none.
    pub(super) fn tile_uri(&self, tile: TileCoordinates) -> (Arc<str>, Option<Arc<str>>) {
        let TileCoordinates { level, x, y, .. } = tile;
        let template =
            &self.templates[((u64::from(x) + u64::from(y) + u64::from(level)) % self.templates.len() as u64) as usize];
        let row = if self.counts_from_north { ((1u64 << level) - 1) as u32 - y } else { y };
        // The placeholder {z} is the level.
        let named = TileCoordinates { level, x, y: row, z: level };
        (template.fill(named), template.fill_fallback(named))
    }

    /// Returns the name of the projection.
    pub(in crate::formats) fn projection(&self) -> &'static str {
        match self.tiling {
            Tiling::Mercator => "EPSG:3857 (Web Mercator)",
            _ => "EPSG:4326 (geographic)",
        }
    }

    /// Returns the address of a tile of the first level, without secrets.
    pub(in crate::formats) fn template(&self) -> String {
        let (uri, _) = self.tile_uri(TileCoordinates { level: 0, x: 0, y: 0, z: 0 });
        shown(&uri).into_owned()
    }

    /// Returns the interval of the levels whose tiles name others in their metadata.
    pub(in crate::formats) fn metadata_levels(&self) -> Option<u32> {
        self.metadata_levels
    }

    /// Returns the number of tiles that layer.json names, by level.
    pub(in crate::formats) fn tile_counts(&self) -> Vec<u64> {
        self.available.counts()
    }

    /// Returns the bytes of memory.
    pub(super) fn size_bytes(&self) -> u64 {
        let templates: u64 = self.templates.iter().map(UriTemplate::size_bytes).sum();
        size_of::<Self>() as u64 + templates + self.available.size_bytes()
    }
}

/// Returns bounds in radians from degrees: west, south, east and north. `None` for bounds that are not on the earth.
fn usable_bounds(degrees: &[f64], notes: &Notes) -> Option<[f64; 4]> {
    let degrees: Option<[f64; 4]> = degrees.try_into().ok();
    let usable = degrees.filter(|[west, south, east, north]| {
        west.abs() <= 180.0 && east.abs() <= 180.0 && south.abs() <= 90.0 && north.abs() <= 90.0 && south < north
    });
    if usable.is_none() {
        notes.add("layer.json: invalid bounds");
    }
    usable.map(|bounds| bounds.map(f64::to_radians))
}

/// Returns the tiles that the ranges of a layer list. The error is the reason why they are invalid.
fn listed(
    ranges: &[Vec<RangeJson>],
    tiling: Tiling,
    max_zoom: Option<u32>,
    notes: &Notes,
) -> Result<Availability, String> {
    let (available, faults) =
        Availability::of_ranges(ranges, 0, tiling).map_err(|reason| format!("available: {reason}"))?;
    let counts = available.counts();
    let last = counts.iter().rposition(|count| *count > 0).map(|last| last as u32);
    if last.is_none() {
        notes.add("layer.json: available has no tiles");
    }
    let is_beyond = max_zoom.is_some_and(|max| last.is_some_and(|last| last > max));
    for (is_so, note) in [
        (faults.is_outside, "layer.json: available has tiles that a level lacks"),
        (faults.is_orphaned, "layer.json: available has tiles without a parent"),
        (is_beyond, "layer.json: available has tiles beyond maxzoom"),
    ] {
        if is_so {
            notes.add(note);
        }
    }
    Ok(available)
}

#[cfg(test)]
mod tests {
    use super::*;

    const URL: &str = "https://h/t/layer.json?key=1";

    fn options() -> ReadOptions {
        ReadOptions::for_root(URL, Limits::default())
    }

    fn parse(json: &str) -> Result<(Layer, Vec<String>), String> {
        let notes = Notes::default();
        let layer = Layer::parse(URL, json.as_bytes(), &options(), &notes).map_err(|e| e.to_string())?.0;
        Ok((layer, notes.into_ignored().iter().map(|(kind, _)| kind.to_owned()).collect()))
    }

    fn tile(level: u32, x: u32, y: u32) -> TileCoordinates {
        TileCoordinates { level, x, y, z: 0 }
    }

    #[test]
    fn templates_are_filled_by_their_scheme() {
        let tiles = r#""tiles":["{z}/{x}/{y}.terrain?v={version}","https://b.h/{z}.{x}.{y}"],"version":"1.2.0""#;
        let (tms, notes) = parse(&format!(
            r#"{{{tiles},"format":"quantized-mesh-1.0","available":[[{{"startX":0,"startY":0,"endX":1,"endY":0}}]]}}"#
        ))
        .unwrap();
        assert_eq!(notes, Vec::<String>::new());
        assert_eq!(&*tms.tile_uri(tile(3, 5, 2)).0, "https://h/t/3/5/2.terrain?v=1.2.0&key=1");
        assert_eq!(&*tms.tile_uri(tile(3, 6, 2)).0, "https://b.h/3.6.2");
        let (slippy, _) = parse(&format!(r#"{{{tiles},"scheme":"slippyMap","projection":"EPSG:3857"}}"#)).unwrap();
        assert_eq!(&*slippy.tile_uri(tile(3, 5, 2)).0, "https://h/t/3/5/5.terrain?v=1.2.0&key=1");
        assert_eq!(slippy.tiling, Tiling::Mercator);
    }

    #[test]
    fn contradictions_are_errors_or_notes() {
        for (json, reason) in [
            ("{", "layer.json: EOF"),
            (r#"{"format":"quantized-mesh-1.0"}"#, "tiles has no template"),
            (r#"{"tiles":[]}"#, "tiles has no template"),
            (r#"{"tiles":["a"],"format":"heightmap-1.0"}"#, "heightmap-1.0"),
            (r#"{"tiles":["a"],"projection":"EPSG:25832"}"#, "EPSG:25832"),
            (r#"{"tiles":["a"],"scheme":"other"}"#, "scheme other"),
            (r#"{"tiles":["a"],"minzoom":9,"maxzoom":3}"#, "minzoom 9 is above maxzoom 3"),
            (r#"{"tiles":["a"],"maxzoom":-1}"#, "maxzoom is -1"),
            (r#"{"tiles":["a"],"available":[[{"startX":1,"startY":0,"endX":0,"endY":0}]]}"#, "available: level 0"),
            (r#"{"tiles":["ftp://h/a"]}"#, "ftp"),
            ("<html>", "a web page"),
        ] {
            let error = parse(json).err().unwrap_or_else(|| panic!("{json}"));
            assert!(error.contains(reason) && error.contains("https://h/t/layer.json"), "{json}: {error}");
        }
        let noted =
            |members: &str| parse(&format!(r#"{{"tiles":["a"],"format":"quantized-mesh-1.0",{members}}}"#)).unwrap().1;
        for (members, note) in [
            (r#""available":[[]]"#, "no tiles"),
            (r#""available":[[{"startX":0,"startY":0,"endX":7,"endY":0}]]"#, "tiles that a level lacks"),
            (r#""available":[[],[{"startX":0,"startY":0,"endX":0,"endY":0}]]"#, "without a parent"),
            (
                r#""maxzoom":0,"available":[[{"startX":0,"startY":0,"endX":1,"endY":0}],[{"startX":0,"startY":0,"endX":0,"endY":0}]]"#,
                "beyond maxzoom",
            ),
            (r#""bounds":[0,90,10,-90]"#, "invalid bounds"),
            (r#""extensions":["sparkle"]"#, "extension sparkle"),
            (r#""maxzoom":3"#, "tiles up to maxzoom are tried"),
        ] {
            let notes = noted(members);
            assert!(notes.iter().any(|found| found.contains(note)), "{members}: {notes:?}");
        }
    }

    #[test]
    fn layers_have_parents() {
        let layer = |parent: &str, projection: &str| {
            format!(
                r#"{{"tiles":["{{z}}/{{x}}/{{y}}.terrain"],"format":"quantized-mesh-1.0","projection":"{projection}","parentUrl":"{parent}","metadataAvailability":10}}"#
            )
        };
        let read = |files: &[(&str, String)]| {
            let known: Vec<Fetched> =
                files[1..].iter().map(|(uri, text)| (Arc::from(*uri), Ok(text.clone().into_bytes()))).collect();
            let text = files[0].1.as_bytes();
            let (notes, options) = (Notes::default(), options());
            let layers = read_layers(URL, text, &known, &options, &notes).unwrap();
            let uris: Vec<String> = layers.iter().map(|layer| layer.tile_uri(tile(0, 0, 0)).0.to_string()).collect();
            (parent_files(URL, text, &known, &options), uris, notes.into_ignored().iter().count())
        };
        let (top, base) = ("https://h/t/layer.json?key=1", "https://h/base/layer.json?key=1");
        let geographic = "EPSG:4326";
        let (files, uris, notes) = read(&[(top, layer("../base", geographic)), (base, layer("", geographic))]);
        assert_eq!((files.len(), &*files[0], notes), (1, base, 0));
        assert_eq!(uris, ["https://h/t/0/0/0.terrain?key=1", "https://h/base/0/0/0.terrain?key=1"]);
        // A cycle, another projection, and a missing file.
        let (files, uris, notes) = read(&[(top, layer("../base/", geographic)), (base, layer("../base", geographic))]);
        assert_eq!((files.len(), uris.len(), notes), (1, 2, 2));
        let (_, uris, notes) = read(&[(top, layer("../base", geographic)), (base, layer("", "EPSG:3857"))]);
        assert_eq!((uris.len(), notes), (1, 2));
        let (files, uris, notes) = read(&[(top, layer("../base", geographic))]);
        assert_eq!((files.len(), uris.len(), notes), (1, 1, 2));
    }

    #[test]
    fn layers_are_told_from_other_json() {
        for (text, is) in [
            (r#"{"tiles":["a"]}"#, true),
            (r#"{"tilejson":"2.1.0","format":"quantized-mesh-1.0"}"#, true),
            (r#"{"asset":{"version":"2.0"},"extras":{"tiles":1}}"#, false),
            (r#"{"asset":{"version":"1.1"},"root":{},"tiles":[]}"#, false),
            (r#"{"a":1}"#, false),
            ("[", false),
        ] {
            assert_eq!(is_layer(URL, text.as_bytes(), &Limits::default()), is, "{text}");
        }
    }
}
