//! The JSON of a tileset as serde reads it: `null` means absent, and unusual members spoil only their tile.

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;

use super::extras::Extras;
use crate::fetch::markup::refuse_markup;
use crate::fetch::{IoError, Limits};
use crate::formats::embedded::is_data_uri;
use crate::formats::height::{SetExtras, TileExtras};
use crate::formats::implicit::ImplicitTilingJson;
use crate::formats::lenient::{
    Number, Numbers, Text, from_json, object, objects, optional_object, texts, valid_or_default,
};
use crate::formats::tile::{Body, ELLIPSOID};

/// Supported extensions that a tileset may require, including those that do not affect drawing.
const KNOWN_EXTENSIONS: &[&str] = &[
    "3DTILES_content_gltf",
    "3DTILES_implicit_tiling",
    "3DTILES_multiple_contents",
    "3DTILES_metadata",
    "3DTILES_bounding_volume_S2",
    "3DTILES_batch_table_hierarchy",
    "3DTILES_draco_point_compression",
    "MAXAR_content_3tz",
];

#[derive(Deserialize)]
pub(crate) struct TilesetJson {
    #[serde(default, deserialize_with = "object")]
    pub asset: AssetJson,
    /// The error where nothing of the set is drawn.
    #[serde(rename = "geometricError")]
    pub geometric_error: Option<Number>,
    #[serde(rename = "extensionsRequired", default, deserialize_with = "texts")]
    pub extensions_required: Vec<String>,
    #[serde(rename = "extensionsUsed", default, deserialize_with = "texts")]
    pub extensions_used: Vec<String>,
    schema: Option<Value>,
    #[serde(rename = "schemaUri", default)]
    schema_uri: Text,
    metadata: Option<Value>,
    groups: Option<Value>,
    #[serde(default, deserialize_with = "optional_object")]
    extensions: Option<TilesetExtensions>,
    #[serde(deserialize_with = "object")]
    pub root: TileJson,
}

impl TilesetJson {
    /// Returns the schema of the metadata and the reference to its file, by the 1.1 properties or by the 1.0 extension.
    pub fn schema(&self) -> (Option<&Value>, Option<&str>) {
        let by_extension = self.metadata_extension();
        let schema = self.schema.as_ref().or_else(|| by_extension?.schema.as_ref());
        (schema, self.schema_uri.0.as_deref().or_else(|| by_extension?.schema_uri.0.as_deref()))
    }

    /// Returns the metadata of the tileset.
    pub fn metadata(&self) -> Option<&Value> {
        self.metadata.as_ref().or_else(|| {
            let extension = self.metadata_extension()?;
            extension.metadata.as_ref().or(extension.tileset.as_ref())
        })
    }

    /// Returns the groups that contents may belong to: the name of each, and its metadata. Groups of 1.1 have no name.
    pub fn groups(&self) -> Vec<(Option<String>, &Value)> {
        match self.groups.as_ref().or_else(|| self.metadata_extension()?.groups.as_ref()) {
            Some(Value::Array(groups)) => groups.iter().map(|group| (None, group)).collect(),
            Some(Value::Object(groups)) => groups.iter().map(|(name, group)| (Some(name.clone()), group)).collect(),
            _ => Vec::new(),
        }
    }

    /// Returns true if an extension is read. 3DTILES_ellipsoid is if its radii are valid.
    pub fn reads(&self, extension: &str) -> bool {
        KNOWN_EXTENSIONS.contains(&extension) || extension == ELLIPSOID && matches!(self.body(), Some(Ok(_)))
    }

    /// Returns the body that the set declares by 3DTILES_ellipsoid, or the reason why its radii are invalid.
    pub fn body(&self) -> Option<Result<Body, String>> {
        Some(self.extensions.as_ref()?.ellipsoid.as_ref()?.body())
    }

    fn metadata_extension(&self) -> Option<&MetadataExtension> {
        self.extensions.as_ref()?.metadata.as_ref()
    }
}

#[derive(Default, Deserialize)]
struct TilesetExtensions {
    #[serde(rename = "3DTILES_metadata", default, deserialize_with = "optional_object")]
    metadata: Option<MetadataExtension>,
    #[serde(rename = "3DTILES_ellipsoid", default, deserialize_with = "optional_object")]
    ellipsoid: Option<EllipsoidExtension>,
}

#[derive(Default, Deserialize)]
struct EllipsoidExtension {
    /// A name or a URI.
    #[serde(default)]
    body: Text,
    /// Along x, y and z, metres.
    #[serde(default)]
    radii: Numbers,
}

impl EllipsoidExtension {
    fn body(&self) -> Result<Body, String> {
        let Numbers(radii) = &self.radii;
        let radii_m: [f64; 3] =
            radii.as_slice().try_into().map_err(|_| format!("{ELLIPSOID}: {} radii, expected 3", radii.len()))?;
        Body::new(self.body.0.clone(), radii_m).map_err(|error| format!("{ELLIPSOID}: {error}"))
    }
}

#[derive(Default, Deserialize)]
struct MetadataExtension {
    schema: Option<Value>,
    #[serde(rename = "schemaUri", default)]
    schema_uri: Text,
    metadata: Option<Value>,
    /// The name of `metadata` in drafts.
    tileset: Option<Value>,
    groups: Option<Value>,
}

#[derive(Default, Deserialize)]
pub(crate) struct AssetJson {
    #[serde(default)]
    version: Text,
    /// The attribution of the set, which some writers add as glTF has it.
    #[serde(default)]
    pub copyright: Text,
    /// The up axis of glTF contents, in sets of old converters.
    #[serde(rename = "gltfUpAxis", default)]
    pub gltf_up_axis: Text,
    #[serde(default)]
    pub extras: Extras<SetExtras>,
}

impl AssetJson {
    /// Returns the version; empty if there is none.
    pub fn version(&self) -> &str {
        self.version.0.as_deref().unwrap_or_default()
    }

    /// Returns true for a version that the specification has.
    pub fn is_known(&self) -> bool {
        matches!(self.version(), "0.0" | "1.0" | "1.1")
    }
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct TileJson {
    #[serde(default, deserialize_with = "object")]
    pub bounding_volume: VolumeJson,
    #[serde(default, deserialize_with = "optional_object")]
    pub viewer_request_volume: Option<VolumeJson>,
    /// `None` where it is missing, as for tiles that have their parent's.
    pub geometric_error: Option<Number>,
    #[serde(default)]
    pub refine: Text,
    pub transform: Option<Numbers>,
    #[serde(default, deserialize_with = "optional_object")]
    pub content: Option<ContentJson>,
    #[serde(default, deserialize_with = "objects")]
    contents: Vec<ContentJson>,
    #[serde(default, deserialize_with = "objects")]
    pub children: Vec<TileJson>,
    #[serde(default, deserialize_with = "optional_object")]
    implicit_tiling: Option<ImplicitTilingJson>,
    metadata: Option<Value>,
    #[serde(default, deserialize_with = "optional_object")]
    extensions: Option<TileExtensions>,
    #[serde(default)]
    pub extras: Extras<TileExtras>,
}

impl TileJson {
    /// Returns the implicit tiling by the 1.1 property or by the 1.0 extension.
    pub fn implicit_tiling(&self) -> Option<&ImplicitTilingJson> {
        let extension = self.extensions.as_ref().and_then(|extensions| extensions.implicit_tiling.as_ref());
        self.implicit_tiling.as_ref().or(extension)
    }

    /// Returns the metadata by the 1.1 property or by the 1.0 extension.
    pub fn metadata(&self) -> Option<&Value> {
        self.metadata.as_ref().or_else(|| self.extensions.as_ref()?.metadata.as_ref())
    }

    /// Returns the contents by the 1.1 properties or by the 1.0 extension.
    pub fn contents(&self) -> impl Iterator<Item = &ContentJson> {
        let several = self.extensions.as_ref().and_then(|extensions| extensions.multiple_contents.as_ref());
        let several = several.into_iter().flat_map(|several| several.contents.iter().chain(&several.content));
        self.content.iter().chain(&self.contents).chain(several)
    }
}

#[derive(Default, Deserialize)]
struct TileExtensions {
    #[serde(rename = "3DTILES_implicit_tiling", default, deserialize_with = "optional_object")]
    implicit_tiling: Option<ImplicitTilingJson>,
    #[serde(rename = "3DTILES_multiple_contents", default, deserialize_with = "optional_object")]
    multiple_contents: Option<MultipleContentsJson>,
    #[serde(rename = "3DTILES_metadata")]
    metadata: Option<Value>,
}

#[derive(Default, Deserialize)]
struct MultipleContentsJson {
    #[serde(default, deserialize_with = "objects")]
    contents: Vec<ContentJson>,
    /// The name of `contents` in drafts.
    #[serde(default, deserialize_with = "objects")]
    content: Vec<ContentJson>,
}

#[derive(Default, Deserialize)]
pub(crate) struct VolumeJson {
    #[serde(rename = "box")]
    pub oriented_box: Option<Numbers>,
    pub region: Option<Numbers>,
    pub sphere: Option<Numbers>,
    #[serde(default, deserialize_with = "optional_object")]
    extensions: Option<VolumeExtensions>,
}

impl VolumeJson {
    /// Returns the S2 cell by the extension `3DTILES_bounding_volume_S2`.
    pub fn s2(&self) -> Option<&S2Json> {
        self.extensions.as_ref()?.s2.as_ref()
    }
}

#[derive(Default, Deserialize)]
struct VolumeExtensions {
    #[serde(rename = "3DTILES_bounding_volume_S2", default, deserialize_with = "optional_object")]
    s2: Option<S2Json>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct S2Json {
    #[serde(default)]
    pub token: Text,
    pub minimum_height: Option<Number>,
    pub maximum_height: Option<Number>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct ContentJson {
    #[serde(default)]
    uri: Text,
    #[serde(default)]
    url: Text,
    /// In a box, since few tiles have it.
    #[serde(default, deserialize_with = "optional_object")]
    pub bounding_volume: Option<Box<VolumeJson>>,
    metadata: Option<Value>,
    group: Option<Value>,
    #[serde(default, deserialize_with = "valid_or_default")]
    extensions: ContentExtensions,
}

#[derive(Default, Deserialize)]
struct ContentExtensions {
    /// The metadata, and the name of the group.
    #[serde(rename = "3DTILES_metadata")]
    metadata: Option<Value>,
}

impl ContentJson {
    /// Returns the reference, under its name in 1.1 or in 1.0.
    pub fn uri(&self) -> Option<&str> {
        self.uri.0.as_deref().or(self.url.0.as_deref())
    }

    /// Returns the metadata by the 1.1 property or by the 1.0 extension.
    pub fn metadata(&self) -> Option<&Value> {
        self.metadata.as_ref().or_else(|| self.extension().filter(|extension| extension.get("class").is_some()))
    }

    /// Returns the index of the group in 1.1, or its name in 1.0.
    pub fn group(&self) -> Option<&Value> {
        self.group.as_ref().or_else(|| self.extension()?.get("group"))
    }

    fn extension(&self) -> Option<&Value> {
        self.extensions.metadata.as_ref()
    }
}

/// Returns the reference to the file with a tileset's schema; `None` for other JSON, and if the schema is not in a separate
/// file.
pub(in crate::formats) fn schema_reference(text: &[u8], limits: &Limits) -> Option<String> {
    #[derive(Deserialize)]
    struct Probe {
        schema: Option<IgnoredAny>,
        #[serde(rename = "schemaUri", default)]
        schema_uri: Text,
        #[serde(default, deserialize_with = "optional_object")]
        extensions: Option<TilesetExtensions>,
    }
    // Tilesets may be large, and few have one.
    if !std::str::from_utf8(text).is_ok_and(|text| text.contains("\"schemaUri\"")) {
        return None;
    }
    // The decoder returns the error.
    limits.check_json("", text).ok()?;
    let Probe { schema, schema_uri, extensions } = serde_json::from_slice(text).ok()?;
    let by_extension = extensions.and_then(|extensions| extensions.metadata);
    if schema.is_some() || by_extension.as_ref().is_some_and(|metadata| metadata.schema.is_some()) {
        return None;
    }
    schema_uri.0.or_else(|| by_extension?.schema_uri.0).filter(|reference| !is_data_uri(reference))
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
pub(crate) fn parse(uri: &str, bytes: &[u8], limits: &Limits) -> Result<TilesetJson, IoError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    refuse_markup(uri, bytes)?;
    // Names in another encoding, which some writers use, are replaced.
    let text = String::from_utf8_lossy(bytes);
    let bytes = text.as_bytes();
    limits.check_json(uri, bytes)?;
    let tileset: TilesetJson = from_json(bytes).map_err(|error| invalid_json(uri, bytes, &error))?;
    let version = tileset.asset.version();
    // Other versions below 2 differ in what they add.
    let may_be_read = version.is_empty() || version == "1" || version.starts_with("0.") || version.starts_with("1.");
    if !may_be_read {
        return Err(IoError::unsupported(uri, format!("3D Tiles version {version:?}")));
    }
    for name in &tileset.extensions_required {
        if let (Some(Err(reason)), ELLIPSOID) = (tileset.body(), name.as_str()) {
            return Err(IoError::invalid(uri, reason));
        }
        if !tileset.reads(name) {
            return Err(IoError::unsupported(uri, format!("required extension {name}")));
        }
    }
    Ok(tileset)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        parse("set/tileset.json", text.as_bytes(), &Limits::default()).err().expect("not a tileset").to_string()
    }

    #[test]
    fn objects_are_no_larger_than_the_limit_of_parsed_json_counts() {
        use gltf::json::{Accessor, Buffer, Image, Material, Node, Skin, buffer, mesh};

        use crate::fetch::JSON_OBJECT_BYTES;

        let tileset = [size_of::<TileJson>(), size_of::<ContentJson>(), size_of::<VolumeJson>()];
        let gltf = [size_of::<Accessor>(), size_of::<Buffer>(), size_of::<buffer::View>(), size_of::<Image>()];
        let more = [size_of::<Material>(), size_of::<Node>(), size_of::<mesh::Primitive>(), size_of::<Skin>()];
        let largest = tileset.into_iter().chain(gltf).chain(more).max().unwrap() as u64;
        assert!(2 * largest <= JSON_OBJECT_BYTES, "{largest} {tileset:?} {gltf:?} {more:?}");
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
        let version = error(r#"{"asset":{"version":"2.0"},"geometricError":1,"root":{}}"#);
        assert!(version.contains("3D Tiles version \"2.0\" is not supported"), "{version}");
    }

    /// Regression: these refused the set.
    #[test]
    fn missing_and_unknown_versions_are_read() {
        for asset in ["", r#""asset":{},"#, r#""asset":null,"#, r#""asset":7,"#, r#""asset":{"version":"1.2"},"#] {
            let text = format!(r#"{{{asset}"geometricError":1,"root":{{}}}}"#);
            let tileset = parse("set/tileset.json", text.as_bytes(), &Limits::default()).unwrap();
            assert!(!tileset.asset.is_known(), "{asset}");
        }
    }
}
