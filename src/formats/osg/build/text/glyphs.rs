//! The letters of the built-in typeface in a few textures, each made when a text needs it and then kept.

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::sync::{Arc, OnceLock};

use ab_glyph::{Font as _, GlyphId, OutlinedGlyph, PxScale, point};
use glam::DVec2;

use crate::scene::{Font, Texture, coverage_texture};

/// The side of the square that letters are designed in, texels.
const EM_PX: f32 = 64.0;
/// Empty texels around a letter: half of them are drawn, so that its edge stays soft.
const GAP_PX: usize = 8;
/// Letters begin at multiples of this number of texels, so that four mip levels mix no neighbours.
const GRID_PX: usize = 16;
const WIDTH_PX: usize = 1024;
/// The side of the square that is covered, so large that four mip levels leave two texels of it.
const COVERED_PX: usize = 2 * GRID_PX;
/// The characters of each texture: those of western Europe, and other alphabets.
const PAGES: [&[RangeInclusive<u32>]; 2] = [
    &[
        0x20..=0x7e,
        0xa0..=0xff,
        0x2010..=0x2026,
        0x2030..=0x203a,
        0x20ac..=0x20ac,
        0x2122..=0x2122,
        REPLACEMENT..=REPLACEMENT,
    ],
    &[0x100..=0x17f, 0x218..=0x21b, 0x370..=0x3ff, 0x400..=0x4ff],
];
/// The character whose letter, a box, is drawn for characters that are not in a texture.
const REPLACEMENT: u32 = 0xfffd;

/// A letter. Lengths in units of the square, from the base line at the letter's left, y upwards.
#[derive(Debug)]
pub(super) struct Letter {
    id: GlyphId,
    /// The index of its texture.
    pub page: usize,
    pub advance: f64,
    /// The corners of the box around it; `None` for white space.
    pub ink: Option<[DVec2; 2]>,
    /// The corners of the rectangle that is drawn: lower left, upper right.
    pub corners: [DVec2; 2],
    /// Their texture coordinates.
    pub uvs: [[f32; 2]; 2],
}

/// A texture with its letters.
pub(super) struct LetterPage {
    letters: HashMap<char, Letter>,
    /// The texture coordinates of a texel whose coverage is full.
    pub covered_uv: [f32; 2],
    pub texture: Arc<Texture>,
}

fn font() -> &'static Font {
    static FONT: OnceLock<Font> = OnceLock::new();
    FONT.get_or_init(Font::default)
}

/// Returns a texture.
pub(super) fn page(index: usize) -> &'static LetterPage {
    static MADE: [OnceLock<LetterPage>; PAGES.len()] = [const { OnceLock::new() }; PAGES.len()];
    MADE[index].get_or_init(|| new_page(index))
}

/// Returns the letter of a character and true, or the box and false if no texture has it; `None` if the typeface has no box.
pub(super) fn letter(character: char) -> Option<(&'static Letter, bool)> {
    let code = u32::from(character);
    let index = PAGES.iter().position(|ranges| ranges.iter().any(|range| range.contains(&code)));
    let known = index.and_then(|index| page(index).letters.get(&character));
    let other = || page(0).letters.get(&char::REPLACEMENT_CHARACTER).map(|letter| (letter, false));
    known.map(|letter| (letter, true)).or_else(other)
}

/// Returns how much a letter moves towards the one before it.
pub(super) fn kern(before: &Letter, letter: &Letter) -> f64 {
    let face = &font().0;
    f64::from(face.kern_unscaled(before.id, letter.id) / face.units_per_em().unwrap_or(1.0))
}

/// The rectangle of a letter in a texture.
struct Place {
    character: char,
    id: GlyphId,
    outline: Option<OutlinedGlyph>,
    at: [usize; 2],
}

impl Place {
    /// Returns the texels of its cell, the gap included.
    fn size(&self) -> [usize; 2] {
        let Some(outline) = &self.outline else { return [0; 2] };
        let bounds = outline.px_bounds();
        [bounds.width(), bounds.height()].map(|side| (side as usize + GAP_PX).next_multiple_of(GRID_PX))
    }
}

fn new_page(index: usize) -> LetterPage {
    let face = &font().0;
    let em = face.units_per_em().unwrap_or(1.0);
    let scale = PxScale::from(EM_PX * face.height_unscaled() / em);
    let characters = PAGES[index].iter().flat_map(|range| range.clone()).filter_map(char::from_u32);
    let places = characters.filter_map(|character| {
        let id = face.glyph_id(character);
        let is_known = id != GlyphId::default() || character == char::REPLACEMENT_CHARACTER;
        let outline = face.outline_glyph(id.with_scale_and_position(scale, point(0.0, 0.0)));
        is_known.then_some(Place { character, id, outline, at: [0; 2] })
    });
    let mut places: Vec<Place> = places.collect();
    // High ones first, so that a row has letters of about one height.
    places.sort_by_key(|place| (std::cmp::Reverse(place.size()[1]), place.character));
    let ([mut x, mut y], mut row) = ([0; 2], 0);
    for place in &mut places {
        let [width, height] = place.size();
        if x + width > WIDTH_PX {
            (x, y, row) = (0, y + row, 0);
        }
        place.at = [x, y];
        (x, row) = (x + width, row.max(height));
    }
    // A square that is covered, for what is behind letters.
    if x + COVERED_PX > WIDTH_PX {
        (x, y, row) = (0, y + row, 0);
    }
    let height_px = y + row.max(COVERED_PX);
    let mut coverage = vec![0.0f32; WIDTH_PX * height_px];
    for row in coverage.chunks_exact_mut(WIDTH_PX).skip(y).take(COVERED_PX) {
        row[x..x + COVERED_PX].fill(1.0);
    }
    let middle = |at: usize, size: usize| (at + COVERED_PX / 2) as f32 / size as f32;
    let covered_uv = [middle(x, WIDTH_PX), middle(y, height_px)];
    let mut letters = HashMap::with_capacity(places.len());
    for Place { character, id, outline, at: [left, top] } in places {
        let advance = f64::from(face.h_advance_unscaled(id) / em);
        let mut letter = Letter { id, page: index, advance, ink: None, corners: [DVec2::ZERO; 2], uvs: [[0.0; 2]; 2] };
        if let Some(outline) = outline {
            let half = GAP_PX / 2;
            outline.draw(|x, y, covered| {
                let [x, y] = [left + half + x as usize, top + half + y as usize];
                if let Some(texel) = coverage.get_mut(y * WIDTH_PX + x) {
                    *texel = covered;
                }
            });
            let bounds = outline.px_bounds();
            let corner = |x: f32, y: f32| DVec2::new(x.into(), (-y).into()) / f64::from(EM_PX);
            let ink = [corner(bounds.min.x, bounds.max.y), corner(bounds.max.x, bounds.min.y)];
            let margin = DVec2::splat(half as f64 / f64::from(EM_PX));
            let [width, height] = [bounds.width(), bounds.height()].map(|side| side as usize + GAP_PX);
            let uv = |x: usize, y: usize| [x as f32 / WIDTH_PX as f32, y as f32 / height_px as f32];
            letter.ink = Some(ink);
            letter.corners = [ink[0] - margin, ink[1] + margin];
            letter.uvs = [uv(left, top + height), uv(left + width, top)];
        }
        letters.insert(character, letter);
    }
    let texture = coverage_texture(WIDTH_PX as u32, height_px as u32, coverage);
    LetterPage { letters, covered_uv, texture: Arc::new(texture) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_have_their_texels_to_themselves() {
        let [a, space, unknown] = ['A', ' ', '\u{4e2d}'].map(|character| letter(character).unwrap());
        assert!(a.1 && space.1 && !unknown.1 && space.0.ink.is_none() && unknown.0.ink.is_some());
        // A capital is about 0.7 units high and stands on the base line.
        let [low, high] = a.0.ink.unwrap();
        assert!(low.y.abs() < 0.02 && (0.6..0.8).contains(&high.y) && (0.4..0.9).contains(&a.0.advance), "{a:?}");
        assert!(kern(a.0, letter('V').unwrap().0) <= 0.0);
        let first = page(0);
        assert!(first.texture.height <= 1024, "{}", first.texture.height);
        let texels = &first.texture.mips[0];
        let mut covered = 0u64;
        for letter in first.letters.values().filter(|letter| letter.ink.is_some()) {
            let scale = [WIDTH_PX as f32, first.texture.height as f32];
            let [[left, bottom], [right, top]] =
                letter.uvs.map(|uv| [0, 1].map(|axis| (uv[axis] * scale[axis]).round() as usize));
            for y in top..bottom {
                covered += (left..right).map(|x| u64::from(texels[(y * WIDTH_PX + x) * 4 + 3])).sum::<u64>();
            }
        }
        let [u, v] = first.covered_uv;
        let [x, y] = [(u * WIDTH_PX as f32) as usize, (v * first.texture.height as f32) as usize];
        assert_eq!(texels[(y * WIDTH_PX + x) * 4 + 3], 255);
        covered += (COVERED_PX * COVERED_PX * 255) as u64;
        // Nothing else lies outside of the rectangles, and nothing in two of them.
        assert_eq!(covered, texels.iter().skip(3).step_by(4).map(|alpha| u64::from(*alpha)).sum::<u64>());
        assert_eq!((letter('Ω').unwrap().0.page, letter('Ж').unwrap().0.page), (1, 1));
    }
}
