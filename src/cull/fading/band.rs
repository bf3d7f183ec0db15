//! Dither bands: the part of the screen's pixels in which a level of detail is drawn while it fades.

/// A range of values of the dither pattern: leaves are drawn in pixels whose value, 0 to 254, is at least `from` and
/// less than `to`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FadeBand {
    /// The first value.
    pub from: u8,
    /// One past the last value.
    pub to: u8,
}

/// The share of all pixels; other shares are fractions of it.
pub(in crate::cull) const WHOLE: u16 = u16::MAX;

impl Default for FadeBand {
    fn default() -> Self {
        Self::FULL
    }
}

impl FadeBand {
    /// The band of every pixel.
    pub const FULL: Self = Self { from: 0, to: u8::MAX };

    /// Returns true if every pixel is drawn.
    pub fn is_full(self) -> bool {
        self == Self::FULL
    }

    /// Returns true if no pixel is drawn.
    pub fn is_empty(self) -> bool {
        self.from >= self.to
    }

    /// Splits the band into a first part, as large as the share, and the rest.
    pub(in crate::cull) fn split(self, share: u16) -> (Self, Self) {
        let width = u32::from(self.to.saturating_sub(self.from));
        let first = (width * u32::from(share) + u32::from(WHOLE) / 2) / u32::from(WHOLE);
        let middle = self.from + first as u8;
        (Self { to: middle, ..self }, Self { from: middle, ..self })
    }
}

/// The fade of everything below a tile or a Lod. One word, since tile walks copy it for every tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cull) struct Fade(u32);

impl Fade {
    /// Nothing fades.
    pub const NONE: Self = Self::new(FadeBand::FULL, false, false);

    /// Creates a fade. `is_covered`: content of a tile above is drawn in the same pixels (under ADD refinement), so that
    /// arriving content fades in over it. `is_leaving`: the subtree fades out, so that nothing is requested for it.
    pub const fn new(band: FadeBand, is_covered: bool, is_leaving: bool) -> Self {
        Self(band.from as u32 | (band.to as u32) << 8 | (is_covered as u32) << 16 | (is_leaving as u32) << 24)
    }

    /// Returns the dither band.
    pub fn band(self) -> FadeBand {
        FadeBand { from: self.0 as u8, to: (self.0 >> 8) as u8 }
    }

    /// Returns true if every pixel is drawn.
    pub fn is_whole(self) -> bool {
        self.0 as u16 == Self::NONE.0 as u16
    }

    /// Returns true if content above is drawn in the same pixels.
    pub fn is_covered(self) -> bool {
        self.0 & 1 << 16 != 0
    }

    /// Returns true if the subtree fades out.
    pub fn is_leaving(self) -> bool {
        self.0 & 1 << 24 != 0
    }

    /// Returns the same fade in another band.
    pub fn with_band(self, band: FadeBand) -> Self {
        Self::new(band, self.is_covered(), self.is_leaving())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn parts_of_a_band_cover_each_value_once(shares in prop::collection::vec(any::<u16>(), 1..6)) {
            let mut band = FadeBand::FULL;
            let mut drawn = [0; 255];
            let mut draw = |band: FadeBand| (band.from..band.to).for_each(|value| drawn[usize::from(value)] += 1);
            for share in shares {
                let (children, own) = band.split(share);
                draw(own);
                band = children;
            }
            draw(band);
            prop_assert_eq!(drawn, [1; 255]);
        }
    }

    #[test]
    fn the_ends_of_a_fade_are_whole() {
        let band = FadeBand { from: 20, to: 90 };
        assert_eq!(band.split(0), (FadeBand { from: 20, to: 20 }, band));
        assert_eq!(band.split(WHOLE), (band, FadeBand { from: 90, to: 90 }));
        assert!(band.split(0).0.is_empty() && FadeBand::FULL.is_full());
    }
}
