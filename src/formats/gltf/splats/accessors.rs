//! Splats whose values are accessors.

use gltf::accessor::Dimensions;

use super::{Found, HARMONIC_0};
use crate::fetch::IoError;
use crate::formats::gltf::accessors::{Buffers, Elements};
use crate::formats::gltf::context::Context;
use crate::scene::Splat;

/// Reads the splats of a primitive; `None` if a buffer is missing.
///
/// Scales are lengths. The draft of 2025 had their logarithms: a list with a negative scale has them.
pub(super) fn read(
    context: &Context<'_>,
    buffers: &Buffers<'_>,
    primitive: &gltf::Primitive<'_>,
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
    let degree = (1..=3u8).rev().find(|degree| own(&format!("SH_DEGREE_{degree}_COEF_0")).is_some()).unwrap_or(0);
    let mut found = Found { degree, ..Found::default() };
    found.splats.reserve_exact(count);
    for i in 0..count {
        let alpha = |of: &Elements<'_>| if of.components > 3 { of.value(i, 3) } else { 1.0 };
        let [r, g, b] = match (&harmonic, &color) {
            (Some(harmonic), _) => harmonic.vector::<3>(i).map(|c| 0.5 + HARMONIC_0 * c),
            (None, Some(color)) => color.vector::<3>(i),
            (None, None) => [0.0; 3],
        };
        let a = opacity.as_ref().map_or_else(|| color.as_ref().map_or(1.0, alpha), |opacity| opacity.value(i, 0));
        let scale = scale.vector::<3>(i).map(|s| if is_logarithm { s.exp() } else { s });
        found.add(Splat::new(position.vector(i), scale, rotation.vector(i), [r, g, b, a]));
    }
    Ok(Some(found))
}
