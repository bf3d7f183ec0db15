//! Gaussian splats: ellipsoids of colour that fade from their centres, as plain CPU data. Filled by decode workers on any
//! thread, read once by the draw thread when it uploads a page.

use glam::{Quat, Vec3};

use crate::math::Aabb;

/// The number of standard deviations at which a splat ends.
pub(crate) const SPLAT_SIGMAS: f32 = 3.0;

/// A splat of [`Splats`], as the GPU reads it (36 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Splat {
    /// The centre, metres in the drawable's frame.
    pub position: [f32; 3],
    /// The standard deviation along each axis of the splat, metres.
    pub scale: [f32; 3],
    /// The rotation from the axes of the splat to the drawable's frame: a unit quaternion x, y, z, w as snorm16.
    pub rotation: [i16; 4],
    /// The colour as displayed (sRGB) and the opacity of the centre, as unorm8.
    pub color: [u8; 4],
}

impl Splat {
    /// Returns a splat; `None` if a number is not finite, a scale is negative or the rotation has no length. Colour and opacity
    /// are clamped to 0 to 1.
    pub fn new(position: [f32; 3], scale: [f32; 3], rotation: [f32; 4], color: [f32; 4]) -> Option<Self> {
        let rotation = Quat::from_array(rotation);
        let is_finite = Vec3::from_array(position).is_finite()
            && scale.iter().all(|s| s.is_finite() && *s >= 0.0)
            && rotation.length_squared().is_normal()
            && color.iter().all(|c| c.is_finite());
        is_finite.then(|| Self {
            position,
            scale,
            rotation: rotation.normalize().to_array().map(|q| (q.clamp(-1.0, 1.0) * 32767.0).round() as i16),
            color: color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8),
        })
    }
}

/// A cloud of splats, which are drawn from back to front.
///
/// They are not lit, cast no shadow and write no depth, and intersections ignore them. The material's base colour is a factor
/// of their colour and opacity; the rest of the material has no effect but [`AlphaMode::Blend`](super::AlphaMode::Blend),
/// which it should have.
#[derive(Clone, Debug, PartialEq)]
pub struct Splats {
    list: Vec<Splat>,
    bounds: Aabb,
    harmonics: u8,
}

impl Splats {
    /// Returns a cloud. `harmonics` is the degree of the spherical harmonics that its source had, which change colours with
    /// the direction; degree 0 alone is drawn.
    pub fn new(list: Vec<Splat>, harmonics: u8) -> Self {
        let mut bounds = Aabb::EMPTY;
        for splat in &list {
            let center = Vec3::from_array(splat.position).as_dvec3();
            let reach = f64::from(splat.scale.iter().fold(0.0f32, |most, s| most.max(*s))) * f64::from(SPLAT_SIGMAS);
            bounds = bounds.union(&Aabb { min: center - reach, max: center + reach });
        }
        Self { list, bounds, harmonics }
    }

    /// Returns the splats.
    pub fn list(&self) -> &[Splat] {
        &self.list
    }

    /// Returns the box around all splats up to three standard deviations.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Returns the degree of the spherical harmonics of the source, 0 to 3.
    pub fn harmonics(&self) -> u8 {
        self.harmonics
    }

    /// Returns the bytes of CPU memory that the splats take.
    pub fn size_bytes(&self) -> u64 {
        size_of_val(&self.list[..]) as u64
    }
}
