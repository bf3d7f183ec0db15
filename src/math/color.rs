//! Conversion between sRGB and linear colour components (IEC 61966-2-1).
//!
//! Images and settings hold sRGB values; light is added up in linear ones.

/// Returns the linear value, 0 to 1, of an sRGB component, 0 to 1.
pub fn linear_from_srgb(srgb: f64) -> f64 {
    if srgb <= 0.04045 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

/// Returns the linear value, 0 to 1, of an sRGB component of 8 bits.
pub fn linear_from_srgb8(srgb: u8) -> f64 {
    linear_from_srgb(f64::from(srgb) / 255.0)
}

/// Returns the linear colour of one in sRGB. Alpha stays as it is. Components are clamped to 0 to 1; those that are not finite
/// are 0.
pub(crate) fn linear_rgba(srgba: [f32; 4]) -> [f32; 4] {
    let part = |part: f32| if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 };
    let [red, green, blue] = [0, 1, 2].map(|i| linear_from_srgb(f64::from(part(srgba[i]))) as f32);
    [red, green, blue, part(srgba[3])]
}

/// Returns the sRGB component, 0 to 1, of a linear value, 0 to 1.
pub fn srgb_from_linear(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trips_through_linear() {
        for byte in 0..=u8::MAX {
            let srgb = srgb_from_linear(linear_from_srgb8(byte));
            assert_eq!((srgb * 255.0).round() as u8, byte);
        }
        assert_eq!((linear_from_srgb(0.0), linear_from_srgb(1.0)), (0.0, 1.0));
        assert!((linear_from_srgb(0.5) - 0.214_041).abs() < 1e-6);
    }
}
