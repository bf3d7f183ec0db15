//! The JSON of a tileset as serde reads it.

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::extras::Extras;
use crate::fetch::IoError;
use crate::fetch::markup::refuse_markup;
use crate::formats::height::{SetExtras, TileExtras};

/// Supported extensions that a tileset may require, including those that do not affect drawing.
const KNOWN_EXTENSIONS: &[&str] = &["3DTILES_content_gltf"];

#[derive(Deserialize)]
pub(crate) struct TilesetJson {
    pub asset: AssetJson,
    #[serde(rename = "extensionsRequired", default)]
    pub extensions_required: Vec<String>,
    #[serde(rename = "extensionsUsed", default)]
    pub extensions_used: Vec<String>,

    pub root: TileJson,
}

#[derive(Deserialize)]
pub(crate) struct AssetJson {
    pub version: String,
    #[serde(default)]
    pub extras: Extras<SetExtras>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct TileJson {
    pub bounding_volume: VolumeJson,
    #[serde(default)]
    pub viewer_request_volume: Option<VolumeJson>,
    pub geometric_error: f64,
    #[serde(default)]
    pub refine: Option<String>,
    #[serde(default)]
    pub transform: Option<Vec<f64>>,
    #[serde(default)]
    pub content: Option<ContentJson>,
    #[serde(default)]
    pub contents: Vec<ContentJson>,
    #[serde(default)]
    pub children: Vec<TileJson>,
    #[serde(default)]
    implicit_tiling: Option<IgnoredAny>,
    #[serde(default)]
    extensions: Option<TileExtensions>,
    #[serde(default)]
    pub extras: Extras<TileExtras>,
}

impl TileJson {
    /// Returns true for implicit tiling by the 1.1 property or by the 1.0 extension.
    pub fn has_implicit_tiling(&self) -> bool {
        let by_extension = self.extensions.as_ref().is_some_and(|e| e.implicit_tiling.is_some());
        self.implicit_tiling.is_some() || by_extension
    }
}

#[derive(Deserialize)]
struct TileExtensions {
    #[serde(rename = "3DTILES_implicit_tiling", default)]
    implicit_tiling: Option<IgnoredAny>,
}

#[derive(Deserialize)]
pub(crate) struct VolumeJson {
    #[serde(rename = "box", default)]
    pub oriented_box: Option<Vec<f64>>,
    #[serde(default)]
    pub region: Option<Vec<f64>>,
    #[serde(default)]
    pub sphere: Option<Vec<f64>>,
}

#[derive(Deserialize)]
pub(crate) struct ContentJson {
    #[serde(default)]
    uri: Option<String>,
    #[serde(default)]
    url: Option<String>,
}

impl ContentJson {
    /// Returns the reference, under its name in 1.1 or in 1.0.
    pub fn uri(&self) -> Option<&str> {
        self.uri.as_deref().or(self.url.as_deref())
    }
}

/// Returns the error for text that is no tileset JSON. Names NaN and Infinity, which other languages write and JSON does
/// not have.
fn invalid_json(uri: &str, bytes: &[u8], error: &serde_json::Error) -> IoError {
    let line = bytes.split(|b| *b == b'\n').nth(error.line().saturating_sub(1)).unwrap_or_default();
    let rest = line.get(error.column().saturating_sub(1)..).unwrap_or_default();
    let rest = rest.strip_prefix(b"-").unwrap_or(rest);
    let word = ["NaN", "Infinity"].into_iter().find(|word| rest.starts_with(word.as_bytes()));
    IoError::invalid(
        uri,
        match word {
            Some(word) => {
                let (line, column) = (error.line(), error.column());
                format!("tileset JSON: {word} at line {line} column {column} is not a number in JSON")
            }
            None => format!("tileset JSON: {error}"),
        },
    )
}

/// Parses the JSON of a tileset, with or without a UTF-8 byte order mark. The depth is limited by serde_json (128).
pub(crate) fn parse(uri: &str, bytes: &[u8]) -> Result<TilesetJson, IoError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    refuse_markup(uri, bytes)?;
    let tileset: TilesetJson = serde_json::from_slice(bytes).map_err(|error| invalid_json(uri, bytes, &error))?;
    if !matches!(tileset.asset.version.as_str(), "0.0" | "1.0" | "1.1") {
        return Err(IoError::unsupported(uri, format!("3D Tiles version {}", tileset.asset.version)));
    }
    for name in &tileset.extensions_required {
        if !KNOWN_EXTENSIONS.contains(&name.as_str()) {
            return Err(IoError::unsupported(uri, format!("required extension {name}")));
        }
    }
    Ok(tileset)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        parse("set/tileset.json", text.as_bytes()).err().expect("not a tileset").to_string()
    }

    #[test]
    fn what_is_no_tileset_is_named() {
        let nan = error("{\"asset\": {\"version\": \"1.1\"},\n\"geometricError\": NaN}");
        assert!(nan.contains("NaN at line 2 column 19 is not a number in JSON"), "{nan}");
        let infinity = error("{\"geometricError\": -Infinity}");
        assert!(infinity.contains("Infinity at line 1"), "{infinity}");
        let page = error("<html><body>Index of /set</body></html>");
        assert!(page.contains("a web page instead of content"), "{page}");
        assert!(error("[").contains("tileset JSON: "));
    }
}
