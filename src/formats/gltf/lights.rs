//! KHR_lights_punctual: the lights of a glTF, which shine on that glTF alone.
//!
//! glTF gives lux and candela. Sunlight of colour 1 is 100,000 lux ([`Environment::SUN_LUX`]), so that lamps and sun have
//! their true ratio: under the exposure of a sunny day, most lamps are too weak to be seen.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use glam::{DAffine3, DVec3};
use serde::Deserialize;
use serde_json::Value;

use super::context::Context;
use crate::scene::{Environment, LocalLights};
use crate::state::Light;

const EXTENSION: &str = "KHR_lights_punctual";
/// The maximum brightness in lux or candela; brighter lights are invalid. Lighthouses have some million candela.
const MAX_INTENSITY: f64 = 1e12;
/// Angles that were rounded to single precision may be larger than a right angle by this, radians.
const ANGLE_TOLERANCE: f64 = 1e-6;

#[derive(Deserialize)]
struct LightJson {
    #[serde(rename = "type")]
    kind: String,
    color: Option<[f64; 3]>,
    /// Lux for directional lights, otherwise candela.
    intensity: Option<f64>,
    /// Metres.
    range: Option<f64>,
    spot: Option<SpotJson>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
struct SpotJson {
    inner_cone_angle: Option<f64>,
    outer_cone_angle: Option<f64>,
}

/// The lights that nodes refer to, and those of the nodes so far.
pub(super) struct Lights<'a> {
    context: &'a Context<'a>,
    /// The lights of the document in the frame of a node, `None` for invalid ones.
    definitions: Vec<Option<Light>>,
    placed: Vec<Light>,
}

impl<'a> Lights<'a> {
    /// Reads the lights of a document. Invalid ones are noted and do not shine.
    pub fn new(context: &'a Context<'a>, document: &gltf::Document) -> Self {
        let list = document.extension_value(EXTENSION).and_then(|extension| extension.get("lights")?.as_array());
        let definitions: Vec<Option<Light>> = list.into_iter().flatten().map(in_node).collect();
        definitions.iter().filter(|light| light.is_none()).for_each(|_| context.notes.add("glTF: invalid light"));
        Self { context, definitions, placed: Vec::new() }
    }

    /// Adds the light of a node, if it has one. `root_from_node` returns the node's transform to the frame of the glTF.
    pub fn add(&mut self, node: &gltf::Node<'_>, root_from_node: impl FnOnce() -> Option<DAffine3>) {
        let Some(extension) = node.extension_value(EXTENSION) else { return };
        let index = extension.get("light").and_then(Value::as_u64).and_then(|index| usize::try_from(index).ok());
        match index.and_then(|index| self.definitions.get(index)) {
            None => self.context.notes.add("glTF: light that does not exist"),
            Some(None) => {}
            Some(Some(_)) if self.placed.len() >= LocalLights::MAX => {
                self.context.notes.add("glTF: lights beyond the first 16 of a glTF");
            }
            Some(Some(light)) => match root_from_node().and_then(|map| moved(light, &map)) {
                Some(light) => self.placed.push(light),
                None => self.context.notes.add("glTF: light of a node without extent"),
            },
        }
    }

    /// Returns the lights of all nodes in the frame of the glTF.
    pub fn into_placed(self) -> Vec<Light> {
        self.placed
    }
}

/// Reads a light. It shines along the z axis of its node, towards negative z. Returns `None` if a value is invalid.
fn in_node(json: &Value) -> Option<Light> {
    let LightJson { kind, color, intensity, range, spot } = LightJson::deserialize(json).ok()?;
    let intensity = intensity.unwrap_or(1.0);
    let brightness = color.unwrap_or([1.0; 3]).map(|part| part * intensity);
    let is_valid = |value: &f64| (0.0..=MAX_INTENSITY).contains(value);
    if !is_valid(&intensity) || !brightness.iter().all(is_valid) {
        return None;
    }
    let color = brightness.map(|part| part as f32 / Environment::SUN_LUX);
    let range_m = range.map_or(f32::INFINITY, |range| range as f32);
    if range_m.is_nan() || range_m < f32::MIN_POSITIVE {
        return None;
    }
    let light = Light { diffuse: color, specular: color, range_m, direction: [0.0, 0.0, -1.0], ..Light::default() };
    let at_node = Light { position: [0.0, 0.0, 0.0, 1.0], attenuation: [0.0, 0.0, 1.0], ..light };
    match kind.as_str() {
        "directional" => Some(Light { position: [0.0, 0.0, 1.0, 0.0], ..light }),
        "point" => Some(at_node),
        "spot" => {
            let spot = spot.unwrap_or_default();
            let (inner, outer) = (spot.inner_cone_angle.unwrap_or(0.0), spot.outer_cone_angle.unwrap_or(FRAC_PI_4));
            let is_valid = inner >= 0.0 && outer > 0.0 && outer <= FRAC_PI_2 + ANGLE_TOLERANCE;
            let spot_cutoff = (outer as f32).min(std::f32::consts::FRAC_PI_2);
            let spot_inner_cutoff = (inner as f32).min(spot_cutoff);
            is_valid.then_some(Light { spot_cutoff, spot_inner_cutoff, ..at_node })
        }
        _ => None,
    }
}

/// Returns a light of a node in another frame; `None` if its position or direction is lost. Scales change neither brightness
/// nor range.
fn moved(light: &Light, to_from: &DAffine3) -> Option<Light> {
    let turned = |direction: DVec3| to_from.transform_vector3(direction).try_normalize();
    let [x, y, z, w] = light.position;
    let position = match w == 0.0 {
        true => turned(DVec3::new(x, y, z))?.extend(0.0),
        false => to_from.translation.extend(1.0),
    };
    let is_spot = light.spot_cutoff <= std::f32::consts::FRAC_PI_2;
    let direction = turned(DVec3::from_array(light.direction)).or((!is_spot).then_some(DVec3::NEG_Z))?;
    position.is_finite().then_some(Light { position: position.to_array(), direction: direction.to_array(), ..*light })
}
