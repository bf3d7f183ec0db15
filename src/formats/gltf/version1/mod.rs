//! glTF 1.0, and 0.8 as far as it is the same: the JSON of an equal glTF 2.0, which the reader then parses.
//!
//! Objects of glTF 1.0 have ids, and those of 2.0 indices ([`Objects`](objects::Objects)). [`geometry`] moves strides from
//! accessors to buffer views and renames attributes, [`nodes`] gives each node one mesh, and [`materials`] rewrites WebGL
//! techniques and KHR_materials_common. Tile sets of 2016 to 2018 contain such files. Decode threads.

mod document;
mod geometry;
mod materials;
mod nodes;
mod objects;

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::{Value, json};

use super::glb::Chunks;
use crate::fetch::{IoError, Limits};
use crate::formats::ignored::Notes;
use crate::formats::lenient::{Text, valid_or_default};
use document::Document;
use objects::Ids;

/// Extensions that glTF 2.0 replaces.
const REPLACED: [&str; 2] = ["KHR_binary_glTF", "KHR_materials_common"];

/// Extensions that compress geometry. A glTF 1.0 does not say which extensions it requires.
const COMPRESSIONS: [&str; 4] =
    ["EXT_meshopt_compression", "EXT_quantized_attributes", "KHR_draco_mesh_compression", "Open3DGC-compression"];

/// Returns the JSON of a glTF 2.0 that is equal to this glTF 1.0. Returns `None` if it is no glTF 1.0 or 0.8. The caller has
/// checked the size of the JSON, and checks that of the result; it is larger by a constant factor at most.
pub(super) fn upgraded(
    uri: &str,
    chunks: &Chunks<'_>,
    limits: &Limits,
    notes: &Notes,
) -> Result<Option<Vec<u8>>, IoError> {
    let Some(version) = old_version(&chunks.json) else { return Ok(None) };
    let invalid = |e: serde_json::Error| IoError::invalid(uri, format!("glTF {version} JSON: {e}"));
    let mut document: Document = serde_json::from_slice(&chunks.json).map_err(invalid)?;
    if let Some(body) = chunks.binary {
        document.use_binary_body(body.len());
    }
    let upgrade = Upgrade { uri, version: &version, document: &document, limits, notes };
    serde_json::to_vec(&upgrade.document()?).map(Some).map_err(invalid)
}

/// Returns the version of a glTF before 2.0; `1.0` if the objects of a glTF without a version have ids. Returns `None` for
/// other JSON.
fn old_version(json: &[u8]) -> Option<String> {
    #[derive(Deserialize)]
    struct Head {
        /// glTF 0.8 may have its version here.
        #[serde(default)]
        version: Text,
        #[serde(default, deserialize_with = "valid_or_default")]
        asset: Asset,
    }
    #[derive(Default, Deserialize)]
    struct Asset {
        #[serde(default)]
        version: Text,
    }
    #[derive(Deserialize)]
    struct WithIds {
        accessors: Option<BTreeMap<String, IgnoredAny>>,
        meshes: Option<BTreeMap<String, IgnoredAny>>,
    }
    let Head { version, asset } = serde_json::from_slice(json).ok()?;
    match asset.version.0.or(version.0) {
        Some(version) => {
            let major = version.split('.').next();
            matches!(major, Some("0" | "1")).then_some(version)
        }
        None => {
            let WithIds { accessors, meshes } = serde_json::from_slice(json).ok()?;
            (accessors.is_some() || meshes.is_some()).then(|| "1.0".to_owned())
        }
    }
}

/// The conversion of one document.
struct Upgrade<'a> {
    uri: &'a str,
    version: &'a str,
    document: &'a Document,
    limits: &'a Limits,
    notes: &'a Notes,
}

impl Upgrade<'_> {
    fn document(&self) -> Result<Value, IoError> {
        let document = self.document;
        let extensions = self.extensions_used()?;
        self.note_unused();
        let meshes = self.meshes()?;
        let (accessors, views) = self.accessors_and_views()?;
        let mut upgraded = json!({
            "asset": { "version": "2.0" },
            "extensionsUsed": extensions,
            "accessors": accessors,
            "bufferViews": views,
            "buffers": self.buffers(),
            "meshes": meshes,
            "nodes": self.nodes()?,
            "scenes": self.scenes()?,
            "materials": self.materials(),
            "textures": self.textures(),
            "images": self.images()?,
            "samplers": self.samplers(),
            "extensions": { "KHR_techniques_webgl": self.techniques() },
        });
        if let Some(scene) = self.found(&document.scenes.ids, &document.scene, "scene") {
            upgraded["scene"] = scene.into();
        }
        if let Some(rtc) = &document.extensions.cesium_rtc {
            upgraded["extensions"]["CESIUM_RTC"] = rtc.clone();
        }
        Ok(upgraded)
    }

    /// Returns the extensions that the upgraded document uses.
    fn extensions_used(&self) -> Result<Vec<&str>, IoError> {
        let used = self.document.extensions_used.iter().map(String::as_str);
        let used: Vec<&str> = used.filter(|name| !REPLACED.contains(name)).collect();
        match used.iter().find(|name| COMPRESSIONS.contains(name)) {
            Some(name) => Err(IoError::unsupported(self.uri, format!("glTF {} extension {name}", self.version))),
            None => Ok(used),
        }
    }

    /// Notes what is left out. Animations and cameras have the kinds of glTF 2.0.
    fn note_unused(&self) {
        let Document { animations, cameras, skins, lights, extensions, .. } = self.document;
        let lights = !lights.is_empty() || !extensions.materials_common.lights.is_empty();
        for (is_used, kind) in [
            (!animations.is_empty(), "glTF: animations (drawn at rest)"),
            (!cameras.is_empty(), "glTF: cameras"),
            (!skins.is_empty(), "glTF 1.0: skins (drawn at rest)"),
            (lights, "glTF 1.0: lights of KHR_materials_common"),
        ] {
            if is_used {
                self.notes.add(kind);
            }
        }
    }

    /// Returns the index that replaces an id. Fails if there is no such object.
    fn index(&self, ids: &Ids, id: &Text, kind: &str, user: &str) -> Result<usize, IoError> {
        ids.get(id).ok_or_else(|| {
            let id = id.0.as_deref().unwrap_or_default();
            self.bad(format_args!("{user} refers to {kind} {id:?}, which does not exist"))
        })
    }

    /// Returns the index that replaces an id; `None` without an id. Notes an id of no object.
    fn found(&self, ids: &Ids, id: &Text, kind: &'static str) -> Option<usize> {
        let found = ids.get(id);
        if found.is_none() && id.0.is_some() {
            self.notes.add(format!("glTF 1.0: reference to a {kind} that does not exist"));
        }
        found
    }

    fn bad(&self, reason: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.uri, format!("glTF {}: {reason}", self.version))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_recognized() {
        for (json, version) in [
            (r#"{"asset":{"version":"1.0"}}"#, Some("1.0")),
            (r#"{"asset":{"version":1}}"#, Some("1")),
            (r#"{"asset":{"version":0.8}}"#, Some("0.8")),
            (r#"{"version":0.8}"#, Some("0.8")),
            (r#"{"asset":{"version":"1.0.1"},"meshes":[]}"#, Some("1.0.1")),
            (r#"{"meshes":{}}"#, Some("1.0")),
            (r#"{"accessors":{"a":{}},"asset":null}"#, Some("1.0")),
            (r#"{"asset":{"version":"2.0"},"meshes":{}}"#, None),
            (r#"{"asset":{"version":"10.0"}}"#, None),
            (r#"{"asset":{"version":[1]}}"#, None),
            (r#"{"meshes":[]}"#, None),
            (r#"{"meshes":null}"#, None),
            ("{}", None),
            ("[]", None),
            ("{", None),
        ] {
            assert_eq!(old_version(json.as_bytes()).as_deref(), version, "{json}");
        }
    }
}
