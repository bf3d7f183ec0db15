//! Properties that the crate `gltf` reads in single precision or not at all.
//!
//! Transforms of nodes contain positions on the earth, where an f32 has steps of half a metre.

use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};
use serde::Deserialize;

/// A second parse of the JSON, limited to these properties.
#[derive(Default, Deserialize)]
pub(super) struct DoublePrecision {
    #[serde(default)]
    nodes: Vec<NodeTransform>,
    extensions: Option<Extensions>,
}

#[derive(Deserialize)]
struct NodeTransform {
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

/// Returns the extensions that a document requires; none if it is not JSON.
pub(super) fn extensions_required(json: &[u8]) -> Vec<String> {
    #[derive(Deserialize)]
    struct Required {
        #[serde(rename = "extensionsRequired", default)]
        names: Vec<String>,
    }
    serde_json::from_slice(json).map_or(Vec::new(), |required: Required| required.names)
}

impl DoublePrecision {
    /// Parses the JSON if the crate's document lacks precision: with transforms, or with extensions.
    pub fn read(json: &[u8], root: &gltf::json::Root) -> Result<Self, serde_json::Error> {
        let is_moved = |n: &gltf::json::Node| {
            n.matrix.is_some() || n.translation.is_some() || n.rotation.is_some() || n.scale.is_some()
        };
        if root.extensions.is_none() && !root.nodes.iter().any(is_moved) {
            return Ok(Self::default());
        }
        serde_json::from_slice(json)
    }

    /// Returns the transform from a node to its parent. Returns `None` if it is not affine and finite.
    pub fn transform(&self, node: usize) -> Option<DAffine3> {
        let Some(own) = self.nodes.get(node) else { return Some(DAffine3::IDENTITY) };
        let map = match &own.matrix {
            Some(m) => {
                let m = DMat4::from_cols_array(m);
                if m.row(3) != DVec4::W {
                    return None;
                }
                DAffine3::from_mat4(m)
            }
            None => DAffine3::from_scale_rotation_translation(
                own.scale.map_or(DVec3::ONE, DVec3::from_array),
                // The written digits make the length deviate from 1.
                own.rotation.map_or(DQuat::IDENTITY, unit_rotation),
                own.translation.map_or(DVec3::ZERO, DVec3::from_array),
            ),
        };
        map.is_finite().then_some(map)
    }

    /// Returns the centre of the extension CESIUM_RTC.
    pub fn cesium_rtc(&self) -> Option<DVec3> {
        let center = DVec3::from_array(self.extensions.as_ref()?.cesium_rtc.as_ref()?.center);
        center.is_finite().then_some(center)
    }
}

/// Returns a rotation of length 1: no rotation for four zeros, which some exporters write for it.
fn unit_rotation(numbers: [f64; 4]) -> DQuat {
    match numbers == [0.0; 4] {
        true => DQuat::IDENTITY,
        false => DQuat::from_array(numbers).normalize(),
    }
}
