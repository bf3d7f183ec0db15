//! Writes Gaussian splats as KHR_gaussian_splatting: a point for each, with accessors of floats, and rotations of 16 bits.

use serde_json::{Map, Value, json};

use crate::formats::writers::buffers::{Accuracy, Buffers, Component, Elements};
use crate::math::color::linear_from_srgb8;
use crate::scene::Splats;

/// The name of the extension.
pub(super) const GAUSSIAN_SPLATTING: &str = "KHR_gaussian_splatting";
/// The first spherical harmonic.
const HARMONIC_0: f32 = 0.282_094_8;

/// Returns the primitive of a cloud. `opacity` is a factor of all opacities.
pub(super) fn primitive(splats: &Splats, opacity: f32, buffers: &mut Buffers) -> Value {
    let (list, harmonics) = (splats.list(), splats.harmonics());
    let mut attributes = Map::new();
    attributes.insert("POSITION".into(), buffers.positions(splats.centers()).into());
    let mut add = |name: &str, kind, component, stride, bytes: &[u8]| {
        let (is_normalized, accuracy) = (component != Component::F32, Accuracy::Exact);
        let elements = Elements { kind, component, is_normalized, stride, bytes, accuracy };
        attributes.insert(format!("{GAUSSIAN_SPLATTING}:{name}"), buffers.attribute(&elements).into());
    };
    let rotations: Vec<[i16; 4]> = list.iter().map(|splat| splat.rotation).collect();
    add("ROTATION", "VEC4", Component::I16, 8, bytemuck::cast_slice(&rotations));
    let scales: Vec<[f32; 3]> = list.iter().map(|splat| splat.scale).collect();
    add("SCALE", "VEC3", Component::F32, 12, bytemuck::cast_slice(&scales));
    let opacities: Vec<f32> = list.iter().map(|splat| (opacity * f32::from(splat.color[3]) / 255.0).min(1.0)).collect();
    add("OPACITY", "SCALAR", Component::F32, 4, bytemuck::cast_slice(&opacities));
    let channel = |byte: u8| match harmonics.is_linear() {
        true => linear_from_srgb8(byte) as f32,
        false => f32::from(byte) / 255.0,
    };
    let colors = list.iter().enumerate().map(|(number, splat)| {
        let beyond = harmonics.values(number).next().unwrap_or_default();
        [0, 1, 2].map(|k| (channel(splat.color[k]) + beyond[k] - 0.5) / HARMONIC_0)
    });
    add("SH_DEGREE_0_COEF_0", "VEC3", Component::F32, 12, bytemuck::cast_slice(&colors.collect::<Vec<_>>()));
    let mut above = 0;
    for degree in 1..=harmonics.degree() {
        for n in 0..=2 * degree {
            above += 1;
            let of_splat = |number| harmonics.values(number).nth(above).unwrap_or_default();
            let values: Vec<[f32; 3]> = (0..list.len()).map(of_splat).collect();
            add(&format!("SH_DEGREE_{degree}_COEF_{n}"), "VEC3", Component::F32, 12, bytemuck::cast_slice(&values));
        }
    }
    let color_space = if harmonics.is_linear() { "lin_rec709_display" } else { "srgb_rec709_display" };
    json!({
        "attributes": attributes, "mode": 0,
        "extensions": { GAUSSIAN_SPLATTING: { "kernel": "ellipse", "colorSpace": color_space } },
    })
}
