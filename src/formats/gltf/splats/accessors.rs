//! Splats whose values are accessors.

use gltf::accessor::Dimensions;

use super::{Found, HARMONIC_0, SourceSplat};
use crate::fetch::IoError;
use crate::formats::gltf::accessors::{Buffers, Elements};
use crate::formats::gltf::context::Context;
use crate::scene::SplatHarmonics;

/// Reads the splats of a primitive; `None` if a buffer is missing.
///
/// Scales are lengths. The draft of 2025 had their logarithms: a list with a negative scale has them.
pub(super) fn read(
    context: &Context<'_>,
    buffers: &Buffers<'_>,
    primitive: &gltf::Primitive<'_>,
    is_linear: bool,
) -> Result<Option<Found>, IoError> {
    let named = |name: &str| primitive.attributes().find(|(semantic, _)| semantic.to_string() == name);
    // The name of the extension, kept by an underscore before it, and the name of the drafts.
    let own = |name: &str| {
        let found = named(&format!("_KHR_gaussian_splatting:{name}")).or_else(|| named(&format!("_{name}")));
        found.map(|(_, accessor)| accessor)
    };
    let missing = |name: &str| context.bad(format_args!("Gaussian splats without {name}"));
    let (_, positions) = named("POSITION").ok_or_else(|| missing("POSITION"))?;
    let count = positions.count();
    context.budget.add_vertices(count)?;
    let elements = |name: &str, accessor: Option<gltf::Accessor<'_>>, dimensions: &[Dimensions]| {
        let Some(accessor) = accessor else { return Ok(None) };
        if accessor.count() != count || !dimensions.contains(&accessor.dimensions()) {
            return Err(context.bad(format_args!("{name} of Gaussian splats has the wrong type or count")));
        }
        buffers.elements(&accessor, accessor.dimensions()).map(Some)
    };
    let required = |name: &str, dimensions| elements(name, own(name), &[dimensions])?.ok_or_else(|| missing(name));
    let position = elements("POSITION", Some(positions), &[Dimensions::Vec3])?.flatten();
    let (rotation, scale) = (required("ROTATION", Dimensions::Vec4)?, required("SCALE", Dimensions::Vec3)?);
    let opacity = elements("OPACITY", own("OPACITY"), &[Dimensions::Scalar])?;
    let harmonic = elements("SH_DEGREE_0_COEF_0", own("SH_DEGREE_0_COEF_0"), &[Dimensions::Vec3])?;
    let color = named("COLOR_0").map(|(_, accessor)| accessor);
    let color = elements("COLOR_0", color, &[Dimensions::Vec3, Dimensions::Vec4])?;
    if color.is_none() && harmonic.is_none() {
        return Err(missing("colours"));
    }
    let (Some(position), Some(rotation), Some(scale)) = (position, rotation, scale) else { return Ok(None) };
    let (opacity, harmonic, color) = (opacity.flatten(), harmonic.flatten(), color.flatten());
    if color.is_none() && harmonic.is_none() {
        return Ok(None);
    }
    let is_logarithm = (0..count).any(|i| (0..3).any(|k| scale.value(i, k) < 0.0));
    // All coefficients of a degree and of the lower ones must be there.
    let names = |degree: u8| (0..=2 * degree).map(move |n| format!("SH_DEGREE_{degree}_COEF_{n}"));
    let degree = (1..=3u8).rev().find(|degree| names(*degree).any(|name| own(&name).is_some())).unwrap_or(0);
    let mut above = Vec::with_capacity(SplatHarmonics::coefficients_of(degree));
    for name in (1..=degree).flat_map(names) {
        let Some(values) = required(&name, Dimensions::Vec3)? else { return Ok(None) };
        above.push(values);
    }
    context.budget.ask(4 * (SplatHarmonics::words_of(degree) * count) as u64)?;
    let mut found = Found::new(count, degree, is_linear);
    let mut coefficients = vec![[0.0; 3]; above.len()];
    for i in 0..count {
        let alpha = |of: &Elements<'_>| if of.components > 3 { of.value(i, 3) } else { 1.0 };
        let color_0 = match (&harmonic, &color) {
            (Some(harmonic), _) => harmonic.vector::<3>(i).map(|c| 0.5 + HARMONIC_0 * c),
            (None, Some(color)) => color.vector::<3>(i),
            (None, None) => [0.0; 3],
        };
        for (coefficient, values) in coefficients.iter_mut().zip(&above) {
            *coefficient = values.vector(i);
        }
        let splat = SourceSplat {
            position: position.vector(i),
            scale: scale.vector::<3>(i).map(|s| if is_logarithm { s.exp() } else { s }),
            rotation: rotation.vector(i),
            color: color_0,
            opacity: opacity.as_ref().map_or_else(|| color.as_ref().map_or(1.0, alpha), |opacity| opacity.value(i, 0)),
        };
        found.add(&splat, &coefficients);
    }
    Ok(Some(found))
}
