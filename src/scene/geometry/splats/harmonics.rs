//! [`SplatHarmonics`]: the spherical harmonics by which the colours of splats change with the direction, as plain CPU data.
//! Filled by decode workers on any thread, read by the draw thread when it uploads a page.

/// The highest degree.
pub(crate) const MAX_SPLAT_DEGREE: u8 = 3;
/// The number of coefficients of a splat up to the highest degree, those of degree 0 included.
const MAX_COEFFICIENTS: usize = 16;
/// The byte of a coefficient that is 0.
const ZERO: u8 = 128;
/// The largest number of steps of a coefficient.
const MAX_STEPS: f32 = 127.0;

/// Spherical harmonics of degrees 1 to 3 for each splat of a [`Splats`](super::Splats): 16, 32 or 52 bytes a splat.
///
/// A coefficient is a byte, and a splat has a step of its own: the error is at most 1/254 of its largest coefficient. The
/// colour of a splat for an eye is that of its degree 0 plus the sum of coefficients and harmonics, at least 0. The harmonics
/// are real ones with the Condon-Shortley phase, of the direction from the eye to the splat in the drawable's frame
/// (KHR_gaussian_splatting).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatHarmonics {
    degree: u8,
    is_linear: bool,
    /// For each splat its step (f32), and then three bytes for each coefficient, which are added to the colour or multiplied
    /// by a harmonic.
    words: Vec<u32>,
}

impl SplatHarmonics {
    /// Returns harmonics of no splat yet, up to a degree of at most 3. With `is_linear` they are added to linear colours, and
    /// otherwise to colours as displayed (sRGB).
    pub fn new(degree: u8, is_linear: bool) -> Self {
        Self { degree: degree.min(MAX_SPLAT_DEGREE), is_linear, words: Vec::new() }
    }

    /// Returns the number of coefficients of a splat above degree 0.
    pub const fn coefficients_of(degree: u8) -> usize {
        degree as usize * (degree as usize + 2)
    }

    /// Returns the number of words of a splat.
    pub(crate) const fn words_of(degree: u8) -> usize {
        match degree {
            0 => 0,
            degree => 1 + (3 * (1 + Self::coefficients_of(degree))).div_ceil(4),
        }
    }

    /// Makes room for a number of further splats.
    pub fn reserve(&mut self, splats: usize) {
        self.words.reserve_exact(splats.saturating_mul(Self::words_of(self.degree)));
    }

    /// Adds the harmonics of the next splat. `color` is the splat's colour of degree 0, of which [`Splat`](super::Splat) has
    /// the part from 0 to 1. The coefficients are ordered by degree and then from -degree to degree; missing ones are 0. A
    /// number that is not finite counts as 0.
    pub fn push(&mut self, color: [f32; 3], coefficients: &[[f32; 3]]) {
        if self.degree == 0 {
            return;
        }
        let finite = |value: f32| if value.is_finite() { value } else { 0.0 };
        let count = 1 + Self::coefficients_of(self.degree);
        let mut values = [[0.0f32; 3]; MAX_COEFFICIENTS];
        values[0] = color.map(|c| finite(c - c.clamp(0.0, 1.0)));
        for (value, coefficient) in values[1..count].iter_mut().zip(coefficients) {
            *value = coefficient.map(finite);
        }
        let largest = values.as_flattened().iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
        let step = largest / MAX_STEPS;
        let mut bytes = [ZERO; 3 * MAX_COEFFICIENTS];
        if step > 0.0 {
            for (byte, value) in bytes.iter_mut().zip(values.as_flattened()) {
                *byte = (f32::from(ZERO) + (value / step).round()) as u8;
            }
        }
        self.words.push(step.to_bits());
        let words = bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word));
        self.words.extend(words.take(Self::words_of(self.degree) - 1));
    }

    /// Adds those of a splat of others of the same degree.
    pub(super) fn push_copy(&mut self, of: &Self, number: usize) {
        self.words.extend_from_slice(of.of_splat(number));
    }

    /// Returns the words of a splat; none without harmonics.
    fn of_splat(&self, number: usize) -> &[u32] {
        let words = Self::words_of(self.degree);
        self.words.get(number * words..(number + 1) * words).unwrap_or_default()
    }

    /// Returns what is added to the colour of a splat, and then its coefficients in the order of [`Self::push`].
    pub fn values(&self, number: usize) -> impl Iterator<Item = [f32; 3]> {
        let words = self.of_splat(number);
        let step = words.first().map_or(0.0, |bits| f32::from_bits(*bits));
        let bytes = words.iter().skip(1).flat_map(|word| word.to_le_bytes());
        let mut values = bytes.map(move |byte| (f32::from(byte) - f32::from(ZERO)) * step);
        let count = if words.is_empty() { 0 } else { 1 + Self::coefficients_of(self.degree) };
        (0..count).map(move |_| std::array::from_fn(|_| values.next().unwrap_or(0.0)))
    }

    /// Returns the degree, 0 to 3. Harmonics of degree 0 are none.
    pub fn degree(&self) -> u8 {
        self.degree
    }

    /// Returns true if they are added to linear colours, false for colours as displayed.
    pub fn is_linear(&self) -> bool {
        self.is_linear
    }

    /// Returns the number of splats; 0 for degree 0.
    pub(super) fn count(&self) -> usize {
        self.words.len() / Self::words_of(self.degree).max(1)
    }

    /// Returns the words of all splats, as the GPU reads them.
    pub(crate) fn words(&self) -> &[u32] {
        &self.words
    }

    /// Returns the bytes that they take.
    pub(crate) fn size_bytes(&self) -> u64 {
        size_of_val(&self.words[..]) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_kept_within_half_a_step() {
        for degree in 1..=3u8 {
            let mut harmonics = SplatHarmonics::new(degree, false);
            let count = SplatHarmonics::coefficients_of(degree);
            let coefficients: Vec<[f32; 3]> =
                (0..count).map(|n| [0, 1, 2].map(|k| ((n * 3 + k) as f32 * 0.7).sin() * 1.5)).collect();
            harmonics.push([0.5; 3], &[]);
            harmonics.push([1.25, 0.5, -0.5], &coefficients);
            harmonics.push([f32::NAN; 3], &[[f32::INFINITY; 3], [1e-40; 3]]);
            let bytes = [16, 32, 52][usize::from(degree) - 1];
            assert_eq!((harmonics.count(), harmonics.size_bytes()), (3, 3 * bytes));
            assert!(harmonics.values(0).all(|value| value == [0.0; 3]));
            let values: Vec<_> = harmonics.values(1).collect();
            assert_eq!(values.len(), 1 + count);
            let expected = std::iter::once([0.25, 0.0, -0.5]).chain(coefficients.iter().copied());
            for (value, expected) in values.iter().flatten().zip(expected.flatten()) {
                assert!((value - expected).abs() <= 1.5 / 254.0 + 1e-6, "{value}, expected {expected}");
            }
            assert!(harmonics.values(2).flatten().all(|value| value.abs() < 1e-38));
            assert_eq!(harmonics.values(3).count(), 0);
        }
        let mut none = SplatHarmonics::new(0, false);
        none.push([2.0; 3], &[[1.0; 3]]);
        assert_eq!((none.count(), none.size_bytes(), none.values(0).count()), (0, 0, 0));
        assert_eq!(SplatHarmonics::new(9, true).degree(), 3);
    }
}
