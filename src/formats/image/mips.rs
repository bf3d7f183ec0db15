//! Mip levels of RGBA8 images: colours are averaged as light, other values as they are. Decode threads.

use std::sync::OnceLock;

use crate::math::color::{linear_from_srgb, srgb_from_linear};

/// How the texels of an image are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::formats) enum MipFilter {
    /// Colours in sRGB, averaged in linear light.
    Srgb,
    /// Values that are linear already: normals, roughness, shares.
    Linear,
}

/// Returns all mip levels, box filtered.
pub(in crate::formats) fn mips(width: u32, height: u32, level_0: Vec<u8>, filter: MipFilter) -> Vec<Vec<u8>> {
    let halve = match filter {
        MipFilter::Srgb => halve_srgb,
        MipFilter::Linear => halve_linear,
    };
    let (mut w, mut h) = (width as usize, height as usize);
    let mut levels = vec![level_0];
    while w > 1 || h > 1 {
        let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
        let mut next = Vec::with_capacity(nw * nh);
        let above = levels.last().map_or(&[][..], Vec::as_slice);
        if w > 1 && h > 1 {
            for rows in above.chunks_exact(2 * w * 4) {
                let (upper, lower) = rows.split_at(w * 4);
                halve(upper, lower, &mut next);
            }
        } else {
            // A row or a column: the filter reads the same two pixels twice.
            halve(above, above, &mut next);
        }
        levels.push(next.into_flattened());
        (w, h) = (nw, nh);
    }
    levels
}

/// Appends the average of two rows of linear values, which has half their width. The last pixel of an odd width is ignored.
fn halve_linear(upper: &[u8], lower: &[u8], into: &mut Vec<[u8; 4]>) {
    let (upper, lower) = (upper.as_chunks::<8>().0, lower.as_chunks::<8>().0);
    for i in 0..upper.len().min(lower.len()) {
        let (a, b) = (&upper[i], &lower[i]);
        let mut texel = [0; 4];
        for c in 0..4 {
            let sum = u32::from(a[c]) + u32::from(a[c + 4]) + u32::from(b[c]) + u32::from(b[c + 4]);
            texel[c] = ((sum + 2) / 4) as u8;
        }
        into.push(texel);
    }
}

/// Appends the average of two rows of sRGB colours, as [`halve_linear`]. Alpha is linear.
fn halve_srgb(upper: &[u8], lower: &[u8], into: &mut Vec<[u8; 4]>) {
    let (to_linear, to_srgb) = srgb_tables();
    let (upper, lower) = (upper.as_chunks::<8>().0, lower.as_chunks::<8>().0);
    // Plain loops, because iterators and closures are slow in the builds of tests.
    for i in 0..upper.len().min(lower.len()) {
        let (a, b) = (&upper[i], &lower[i]);
        let mut texel = [0; 4];
        for c in 0..3 {
            let upper = to_linear[a[c] as usize] + to_linear[a[c + 4] as usize];
            let lower = to_linear[b[c] as usize] + to_linear[b[c + 4] as usize];
            // The sum of four 16-bit values has 18 bits; the table is indexed by the upper 12.
            texel[c] = to_srgb[((upper + lower) >> 6) as usize & 4095];
        }
        texel[3] = ((a[3] as u32 + a[7] as u32 + b[3] as u32 + b[7] as u32 + 2) / 4) as u8;
        into.push(texel);
    }
}

/// Tables from sRGB to linear and back.
type Tables = (Box<[u32; 256]>, Box<[u8; 4096]>);

/// Returns tables from 8-bit sRGB to 16-bit linear, and from 12-bit linear to 8-bit sRGB (IEC 61966-2-1).
fn srgb_tables() -> &'static Tables {
    static TABLES: OnceLock<Tables> = OnceLock::new();
    TABLES.get_or_init(|| {
        let mut linear = Box::new([0u32; 256]);
        for (i, l) in linear.iter_mut().enumerate() {
            *l = (linear_from_srgb(i as f64 / 255.0) * 65535.0).round() as u32;
        }
        let mut srgb = Box::new([0u8; 4096]);
        for (i, s) in srgb.iter_mut().enumerate() {
            *s = (srgb_from_linear(i as f64 / 4095.0) * 255.0).round() as u8;
        }
        (linear, srgb)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each texel is the mean, in linear light, of two by two pixels, or of two pixels of a row or column.
    #[test]
    fn texels_are_means_in_linear_light() {
        let linear = crate::math::color::linear_from_srgb8;
        for (w, h) in [(6u32, 4u32), (7, 5), (1, 9), (8, 1), (2, 3), (3, 2), (1, 1)] {
            let pixels: Vec<u8> = (0..w * h * 4).map(|i| (i * 89 + i * i * 7) as u8).collect();
            let levels = mips(w, h, pixels.clone(), MipFilter::Srgb);
            assert_eq!(levels.len() as u32, 32 - w.max(h).leading_zeros());
            let Some(half) = levels.get(1) else { continue };
            let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
            assert_eq!(half.len() as u32, nw * nh * 4);
            for (x, y, c) in (0..nw * nh * 4).map(|k| (k / 4 % nw, k / 4 / nw, k % 4)) {
                let at = |x: u32, y: u32| pixels[((y.min(h - 1) * w + x.min(w - 1)) * 4 + c) as usize];
                let of = [at(2 * x, 2 * y), at(2 * x + 1, 2 * y), at(2 * x, 2 * y + 1), at(2 * x + 1, 2 * y + 1)];
                let got = half[((y * nw + x) * 4 + c) as usize];
                if c == 3 {
                    let mean = of.map(f64::from).iter().sum::<f64>() / 4.0;
                    assert!((f64::from(got) - mean).abs() <= 0.5, "{w} x {h}: {got} of {of:?}");
                } else {
                    let mean = of.map(linear).iter().sum::<f64>() / 4.0;
                    // The table back to sRGB has 4,096 steps.
                    let slack = 1.0 / 4096.0;
                    let (low, high) = (linear(got.saturating_sub(1)) - slack, linear(got.saturating_add(1)) + slack);
                    assert!((low..=high).contains(&mean), "{w} x {h}: {got} of {of:?}");
                }
            }
        }
    }

    /// Regression: normal maps were averaged as colours, so that the mean of two opposite slopes leaned to one side.
    #[test]
    fn linear_values_are_averaged_as_they_are() {
        let slopes = [[64, 128, 238, 0], [192, 128, 238, 255]].concat();
        for (w, h) in [(2, 1), (2, 2), (4, 3)] {
            let levels = mips(w, h, slopes.repeat((w * h / 2) as usize), MipFilter::Linear);
            assert_eq!(levels[1][..4], [128, 128, 238, 128], "{w} x {h}");
        }
    }

    #[test]
    fn mips_keep_a_flat_colour() {
        let levels = mips(5, 3, [200, 100, 50, 255].repeat(15), MipFilter::Srgb);
        assert_eq!(levels.len(), 3);
        for level in &levels {
            for p in level.chunks_exact(4) {
                assert!(p[0].abs_diff(200) <= 1 && p[1].abs_diff(100) <= 1 && p[2].abs_diff(50) <= 2, "{p:?}");
            }
        }
    }
}
