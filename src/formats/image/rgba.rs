//! Expansion of RGB to RGBA with a reused buffer.

use std::cell::RefCell;

/// The maximum size of the buffer that a thread keeps for its next image.
const MAX_KEPT_BYTES: usize = 4 << 20;

/// Decodes an image of three bytes per pixel, `bytes` long, and returns it with an opaque alpha channel.
pub(super) fn decode_rgb<E>(bytes: usize, read: impl FnOnce(&mut [u8]) -> Result<(), E>) -> Result<Vec<u8>, E> {
    thread_local! {
        static READ: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    }
    READ.with_borrow_mut(|rgb| {
        if rgb.len() < bytes {
            rgb.resize(bytes, 0);
        }
        let pixels = read(&mut rgb[..bytes]).map(|()| with_alpha(&rgb[..bytes]));
        if rgb.len() > MAX_KEPT_BYTES {
            *rgb = Vec::new();
        }
        pixels
    })
}

/// Converts RGB to RGBA, four pixels at a time. The loops are plain, because iterators are slow in the builds of tests.
fn with_alpha(rgb: &[u8]) -> Vec<u8> {
    let (threes, rest) = rgb.as_chunks::<12>();
    let mut fours = vec![[255; 16]; threes.len()];
    for i in 0..threes.len() {
        let [r0, g0, b0, r1, g1, b1, r2, g2, b2, r3, g3, b3] = threes[i];
        fours[i] = [r0, g0, b0, 255, r1, g1, b1, 255, r2, g2, b2, 255, r3, g3, b3, 255];
    }
    let mut out = fours.into_flattened();
    for &[r, g, b] in rest.as_chunks::<3>().0 {
        out.extend([r, g, b, 255]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rgb_becomes_opaque_rgba() {
        for pixels in [0usize, 1, 3, 4, 5, 8, 11] {
            let rgb: Vec<u8> = (0..3 * pixels).map(|i| i as u8).collect();
            let expected: Vec<u8> = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
            assert_eq!(with_alpha(&rgb), expected);
            let read = |into: &mut [u8]| {
                into.copy_from_slice(&rgb);
                Ok::<_, ()>(())
            };
            assert_eq!(decode_rgb(rgb.len(), |_| Err("cut")), Err("cut"));
            assert_eq!(decode_rgb(rgb.len(), read), Ok(expected));
        }
    }
}
