//! [`ViewArea`]: the part of a window or texture that a camera draws in. Resolved to pixels on the main thread, before cull.

/// The part of a window, or of another target, that a camera draws in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ViewArea {
    /// The whole target.
    #[default]
    Whole,
    /// x, y, width and height in pixels from the upper left corner, independent of the size of the target.
    Pixels([u32; 4]),
    /// x, y, width and height as shares of the target, 0 to 1, from its upper left corner. Adjacent parts neither
    /// overlap nor leave a gap. Values that are out of range or not finite are clamped.
    Shares([f64; 4]),
}

impl ViewArea {
    /// Returns x, y, width and height in pixels for a target of a size; `None` stands for the whole target.
    pub fn part_px(&self, size_px: [u32; 2]) -> Option<[u32; 4]> {
        match *self {
            Self::Whole => None,
            Self::Pixels(part_px) => Some(part_px),
            Self::Shares([x, y, width, height]) => {
                let [(x, width), (y, height)] = [(x, width, size_px[0]), (y, height, size_px[1])].map(along);
                Some([x, y, width, height])
            }
        }
    }

    /// Returns width and height of the part in pixels for a target of a size; never 0.
    pub(in crate::viewer) fn image_px(&self, size_px: [u32; 2]) -> [u32; 2] {
        let of_part = self.part_px(size_px).map_or(size_px, |[_, _, width, height]| [width, height]);
        of_part.map(|side| side.max(1))
    }
}

/// Returns the first pixel of a share of a side, and its length, at least one pixel.
fn along((from, length, side_px): (f64, f64, u32)) -> (u32, u32) {
    let side_px = side_px.max(1);
    let edge = |at: f64| (at.clamp(0.0, 1.0) * f64::from(side_px)).round() as u32;
    let from_px = edge(from).min(side_px - 1);
    let to_px = edge(from.max(0.0) + length.max(0.0)).max(from_px + 1);
    (from_px, to_px - from_px)
}

impl From<[u32; 4]> for ViewArea {
    fn from(part_px: [u32; 4]) -> Self {
        Self::Pixels(part_px)
    }
}

impl From<Option<[u32; 4]>> for ViewArea {
    fn from(part_px: Option<[u32; 4]>) -> Self {
        part_px.map_or(Self::Whole, Self::Pixels)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn shares_scale_with_the_target() {
        let right = ViewArea::Shares([0.5, 0.25, 0.5, 0.5]);
        assert_eq!(right.part_px([640, 400]), Some([320, 100, 320, 200]));
        assert_eq!(right.part_px([641, 401]), Some([321, 100, 320, 201]));
        assert_eq!(right.part_px([1, 1]), Some([0, 0, 1, 1]));
        assert_eq!(right.part_px([0, 0]), Some([0, 0, 1, 1]));
        assert_eq!(ViewArea::Whole.part_px([640, 400]), None);
        assert_eq!(ViewArea::from([1, 2, 3, 4]).part_px([640, 400]), Some([1, 2, 3, 4]));
        assert_eq!(ViewArea::from([1, 2, 0, 4]).image_px([640, 400]), [1, 4]);
        for nonsense in [[f64::NAN; 4], [-3.0, 7.0, f64::INFINITY, -1.0], [f64::NEG_INFINITY; 4]] {
            let [x, y, width, height] = ViewArea::Shares(nonsense).part_px([64, 32]).unwrap();
            assert!(x + width <= 64 && y + height <= 32 && width > 0 && height > 0, "{nonsense:?}");
        }
    }

    proptest! {
        #[test]
        fn adjacent_parts_cover_every_pixel_once(
            cuts in proptest::collection::vec(0.02..0.98f64, 1..5),
            side_px in 200..5000u32,
        ) {
            let mut edges = cuts;
            edges.extend([0.0, 1.0]);
            edges.sort_by(f64::total_cmp);
            edges.dedup_by(|a, b| *a - *b < 0.01);
            if let Some(last) = edges.last_mut() {
                *last = 1.0;
            }
            let mut next_px = 0;
            for pair in edges.windows(2) {
                let part = ViewArea::Shares([pair[0], 0.0, pair[1] - pair[0], 1.0]).part_px([side_px, 9]).unwrap();
                prop_assert_eq!((part[0], part[1], part[3]), (next_px, 0, 9));
                next_px += part[2];
            }
            prop_assert_eq!(next_px, side_px);
        }
    }
}
