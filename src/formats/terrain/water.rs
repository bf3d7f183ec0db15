//! [`Water`]: which parts of a terrain tile are water, and how they look. Plain values; decode threads.

use std::sync::Arc;

use crate::formats::image::{MipFilter, mips};
use crate::math::color::srgb_from_linear;
use crate::scene::{MetallicRoughness, Texture};

/// Cells along a side of a mask.
const SIDE: usize = 256;
/// The roughness of water: the waves that are smaller than a pixel.
const ROUGHNESS: f32 = 0.2;
/// The colour of deep water from above without what it mirrors, linear.
const DEEP: [f32; 4] = [0.008, 0.03, 0.05, 1.0];

/// The water of a tile, as the extension `watermask` has it: 0 is land, 255 is water.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Water {
    /// The same everywhere.
    Uniform(u8),
    /// A value for each of 256 x 256 cells, from the north-west corner along the northern edge.
    Cells(Box<[u8]>),
}

impl Water {
    /// Reads a mask; `None` for one with another number of bytes than 1 or 65,536.
    pub fn of_mask(mask: &[u8]) -> Option<Self> {
        match mask {
            [value] => Some(Self::Uniform(*value)),
            _ if mask.len() == SIDE * SIDE => Some(Self::of_cells(mask.into())),
            _ => None,
        }
    }

    fn of_cells(cells: Box<[u8]>) -> Self {
        match cells.iter().all(|cell| *cell == cells[0]) {
            true => Self::Uniform(cells[0]),
            false => Self::Cells(cells),
        }
    }

    /// Returns the water of a part of the tile: west, south, east and north as shares of its sides.
    pub fn part(&self, [west, south, east, north]: [f64; 4]) -> Self {
        let Self::Cells(cells) = self else { return self.clone() };
        let at = |from: f64, to: f64, index: usize| {
            let share = from + (to - from) * (index as f64 + 0.5) / SIDE as f64;
            ((share * SIDE as f64) as usize).min(SIDE - 1)
        };
        let cell = |row: usize, column: usize| cells[at(1.0 - north, 1.0 - south, row) * SIDE + at(west, east, column)];
        Self::of_cells((0..SIDE * SIDE).map(|i| cell(i / SIDE, i % SIDE)).collect())
    }

    /// Returns the colour of the tile, linear, and a map of it where there is water beside land, whose colour is `ground`.
    pub fn color(&self, ground: [f32; 4]) -> ([f32; 4], Option<Arc<Texture>>) {
        let mixed = |water: u8| {
            let share = f32::from(water) / 255.0;
            [0, 1, 2, 3].map(|i| ground[i] * (1.0 - share) + DEEP[i] * share)
        };
        let cells = match self {
            Self::Uniform(water) => return (mixed(*water), None),
            Self::Cells(cells) => cells,
        };
        let texels: Vec<[u8; 4]> = (0..=255)
            .map(|water| {
                let [red, green, blue, _] = mixed(water);
                let [red, green, blue] =
                    [red, green, blue].map(|part| (255.0 * srgb_from_linear(f64::from(part))).round() as u8);
                [red, green, blue, 255]
            })
            .collect();
        let texels = cells.iter().flat_map(|cell| texels[usize::from(*cell)]).collect();
        let side = SIDE as u32;
        ([1.0; 4], Some(Arc::new(Texture::rgba8(side, side, mips(side, side, texels, MipFilter::Srgb)))))
    }

    /// Returns the reflection of the tile: water is smooth, land is rough. Land has the same model, so that tiles with and
    /// without water look alike at their edge.
    pub fn reflection(&self) -> MetallicRoughness {
        let roughness = |water: u8| {
            let share = f32::from(water) / 255.0;
            share * ROUGHNESS + (1.0 - share)
        };
        match self {
            Self::Uniform(water) => MetallicRoughness { roughness: roughness(*water), ..MetallicRoughness::default() },
            Self::Cells(cells) => {
                // Occlusion, roughness, metallic.
                let texel = |water: &u8| [255, (255.0 * roughness(*water)).round() as u8, 0, 255];
                let texels = cells.iter().flat_map(texel).collect();
                let side = SIDE as u32;
                let map = Texture::rgba8(side, side, mips(side, side, texels, MipFilter::Linear));
                MetallicRoughness { occlusion_roughness_metallic: Some(Arc::new(map)), ..MetallicRoughness::default() }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a mask whose north-eastern quarter is water.
    fn quarter() -> Water {
        let cell = |i: usize| if i / SIDE < SIDE / 2 && i % SIDE >= SIDE / 2 { 255 } else { 0 };
        Water::of_mask(&(0..SIDE * SIDE).map(cell).collect::<Vec<u8>>()).unwrap()
    }

    #[test]
    fn parts_have_their_own_cells() {
        assert_eq!(quarter().part([0.5, 0.5, 1.0, 1.0]), Water::Uniform(255));
        assert_eq!(quarter().part([0.0, 0.0, 0.5, 0.5]), Water::Uniform(0));
        let Water::Cells(half) = quarter().part([0.5, 0.25, 1.0, 0.75]) else { panic!("land and water") };
        assert!(half.iter().enumerate().all(|(i, cell)| (*cell > 0) == (i / SIDE < SIDE / 2)));
        assert_eq!(Water::of_mask(&[7; 100]), None);
    }

    /// Regression: water had the colour of the ground, so that coasts were hardly seen.
    #[test]
    fn water_is_dark_and_land_keeps_its_color() {
        let ground = [0.4, 0.4, 0.4, 1.0];
        assert_eq!((Water::Uniform(255).color(ground).0, Water::Uniform(0).color(ground).0), (DEEP, ground));
        let (factor, map) = quarter().color(ground);
        let map = map.unwrap();
        let at = |row: usize, column: usize| map.mips[0][4 * (row * SIDE + column)];
        assert_eq!((factor, at(10, 50), at(200, 200)), ([1.0; 4], 170, 170));
        assert!(at(10, 200) < 30);
    }

    #[test]
    fn water_is_smooth_and_land_is_rough() {
        assert_eq!(Water::Uniform(255).reflection().roughness, ROUGHNESS);
        let reflection = quarter().reflection();
        let map = reflection.occlusion_roughness_metallic.unwrap();
        let at = |row: usize, column: usize| &map.mips[0][4 * (row * SIDE + column)..][..3];
        assert_eq!(
            (at(10, 200), at(10, 50), at(200, 200)),
            (&[255, 51, 0][..], &[255, 255, 0][..], &[255, 255, 0][..])
        );
        assert_eq!((reflection.roughness, reflection.metallic), (1.0, 0.0));
    }
}
