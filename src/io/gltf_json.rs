//! What the `gltf` crate reads in single precision, or not at all, from a glTF's JSON. Decode workers.
//!
//! Transforms of nodes move tiles to their place on the earth, where an f32 has steps of half a metre.

use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};
use serde::Deserialize;

/// The JSON once more; what is not named here is skipped.
#[derive(Default, Deserialize)]
pub(super) struct Document {
    #[serde(default)]
    nodes: Vec<Place>,
    extensions: Option<Extensions>,
}

#[derive(Deserialize)]
struct Place {
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct Extensions {
    #[serde(rename = "CESIUM_RTC")]
    cesium_rtc: Option<CesiumRtc>,
}

#[derive(Deserialize)]
struct CesiumRtc {
    center: [f64; 3],
}

/// The names of extensions that a document cannot be read without; none where it is no JSON.
pub(super) fn extensions_required(json: &[u8]) -> Vec<String> {
    #[derive(Deserialize)]
    struct Required {
        #[serde(rename = "extensionsRequired", default)]
        names: Vec<String>,
    }
    serde_json::from_slice(json).map_or(Vec::new(), |required: Required| required.names)
}

impl Document {
    /// Reads it where the crate's own document is not enough.
    pub fn read(json: &[u8], root: &gltf::json::Root) -> Result<Self, serde_json::Error> {
        let is_moved = |n: &gltf::json::Node| {
            n.matrix.is_some() || n.translation.is_some() || n.rotation.is_some() || n.scale.is_some()
        };
        if root.extensions.is_none() && !root.nodes.iter().any(is_moved) {
            return Ok(Self::default());
        }
        serde_json::from_slice(json)
    }

    /// Parent from node; `None` where it is not affine and finite.
    pub fn transform(&self, node: usize) -> Option<DAffine3> {
        let Some(place) = self.nodes.get(node) else { return Some(DAffine3::IDENTITY) };
        let map = match &place.matrix {
            Some(m) => {
                let m = DMat4::from_cols_array(m);
                if m.row(3) != DVec4::W {
                    return None;
                }
                DAffine3::from_mat4(m)
            }
            None => DAffine3::from_scale_rotation_translation(
                place.scale.map_or(DVec3::ONE, DVec3::from_array),
                // Of unit length, but for how many digits were written.
                place.rotation.map_or(DQuat::IDENTITY, |q| DQuat::from_array(q).normalize()),
                place.translation.map_or(DVec3::ZERO, DVec3::from_array),
            ),
        };
        map.is_finite().then_some(map)
    }

    /// The centre of CESIUM_RTC.
    pub fn cesium_rtc(&self) -> Option<DVec3> {
        let center = DVec3::from_array(self.extensions.as_ref()?.cesium_rtc.as_ref()?.center);
        center.is_finite().then_some(center)
    }
}
