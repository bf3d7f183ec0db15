//! The letters of a text in lines, as osgText lays them out, and their mesh.

use std::sync::Arc;

use glam::{DVec2, DVec3};

use super::glyphs::{self, Letter};
use crate::fetch::{IoError, about_to_allocate};
use crate::formats::osg::build::Builder;
use crate::formats::osg::text::{BOX_FILLED, BOX_OUTLINE, CROSS, LETTERS_ALONE, TextObject};
use crate::math::color::linear_rgba;
use crate::scene::{AlphaMode, ContentKey, Drawable, Geometry, Material, Mesh, MeshVertex, Topology};

/// The lengths of letters and lines that are drawn, so that floats hold the positions of all letters of a file.
const MIN_LENGTH: f64 = 1e-12;
const MAX_LENGTH: f64 = 1e12;

/// The letters of a text around its position. Lengths in units of the text.
struct Lines {
    /// The letters, each with its position on the base line.
    letters: Vec<(&'static Letter, DVec2)>,
    /// The point of the text at which its position lies.
    pivot: DVec2,
    /// Width and height of the square that letters are designed in.
    unit: DVec2,
    /// The corners of the box around all letters.
    ink: [DVec2; 2],
    lacks_letters: bool,
}

/// A part of a text that is shown in one line.
struct Line<'a> {
    characters: &'a [char],
    width: f64,
}

/// Returns the letter of a character: a space for one that moves on without a letter.
fn letter(character: char) -> Option<(&'static Letter, bool)> {
    match character {
        '\t' => glyphs::letter(' '),
        _ if character.is_control() => None,
        _ => glyphs::letter(character),
    }
}

/// Returns the lines of a text. `unit` is the width of the square that letters are designed in.
fn lines<'a>(characters: &'a [char], unit: f64, max_width: f64) -> Vec<Line<'a>> {
    let mut lines = Vec::new();
    let mut rest = characters;
    while !rest.is_empty() {
        let (mut width, mut before): (f64, Option<&Letter>) = (0.0, None);
        // The number of characters in the line, and the last character at which it may be broken, with the width up to there.
        let (mut count, mut space) = (0, None);
        let mut is_full = false;
        for (at, character) in rest.iter().enumerate() {
            if *character == '\n' {
                break;
            }
            if *character == ' ' && at > 0 && rest[at - 1] != ' ' {
                space = Some((at, width));
            }
            if let Some((letter, _)) = letter(*character) {
                let moved = width + before.map_or(0.0, |before| glyphs::kern(before, letter)) * unit;
                let ink = letter.ink.map_or(0.0, |[low, high]| high.x - low.x) * unit;
                if max_width > 0.0 && moved + ink > max_width {
                    is_full = true;
                    break;
                }
                width = moved + letter.advance * unit;
                before = Some(letter);
            }
            count = at + 1;
            if *character == '-' {
                space = Some((count, width));
            }
        }
        if let Some((at, width_there)) = space.filter(|_| is_full) {
            (count, width) = (at, width_there);
        }
        lines.push(Line { characters: &rest[..count], width });
        // A letter that is wider than the line is left out, as in OSG.
        rest = &rest[if is_full && count == 0 { 1 } else { count }..];
        let spaces = rest.iter().take_while(|character| **character == ' ').count();
        rest = &rest[spaces..];
        rest = rest.strip_prefix(&['\n']).unwrap_or(rest);
    }
    lines
}

impl Lines {
    fn new(text: &TextObject) -> Option<Self> {
        let is_valid = |length: f64| (MIN_LENGTH..MAX_LENGTH).contains(&length);
        let unit = DVec2::new(text.height / text.aspect, text.height);
        let pitch = text.height * (1.0 + text.line_spacing.max(0.0));
        if ![unit.x, unit.y, pitch].into_iter().all(is_valid) {
            return None;
        }
        let characters: Vec<char> = text.text.chars().collect();
        let lines = lines(&characters, unit.x, text.max_width);
        // By their numbers: left, centre and right come in threes.
        let column = match text.alignment {
            3..=5 | 10 | 13 => 0.5,
            6..=8 | 11 | 14 => 1.0,
            _ => 0.0,
        };
        let mut all =
            Self { letters: Vec::new(), pivot: DVec2::ZERO, unit, ink: [DVec2::ZERO; 2], lacks_letters: false };
        let (mut low, mut high) = (DVec2::ZERO, DVec2::ZERO);
        for (number, line) in lines.iter().enumerate() {
            let mut at = DVec2::new(-column * line.width, -(number as f64) * pitch);
            let mut before: Option<&Letter> = None;
            for (letter, is_own) in line.characters.iter().filter_map(|character| letter(*character)) {
                all.lacks_letters |= !is_own;
                at.x += before.map_or(0.0, |before| glyphs::kern(before, letter)) * unit.x;
                if let Some([bottom_left, top_right]) = letter.ink {
                    (low, high) = (low.min(at + bottom_left * unit), high.max(at + top_right * unit));
                    all.letters.push((letter, at));
                }
                at.x += letter.advance * unit.x;
                before = Some(letter);
            }
        }
        all.ink = [low, high];
        let last_base = -pitch * (lines.len().max(1) - 1) as f64;
        all.pivot = DVec2::new(
            low.x + column * (high.x - low.x),
            match text.alignment {
                0 | 3 | 6 => high.y,
                1 | 4 | 7 => 0.5 * (low.y + high.y),
                2 | 5 | 8 => low.y,
                12..=14 => last_base,
                _ => 0.0,
            },
        );
        Some(all)
    }

    /// Returns the corners of the box around a text relative to the position; `None` if it has none.
    fn bounding_box(&self, text: &TextObject) -> Option<[DVec2; 2]> {
        let margin = text.box_margin;
        if !text.draws(BOX_FILLED | BOX_OUTLINE) || self.letters.is_empty() || margin.abs() >= MAX_LENGTH {
            return None;
        }
        let offsets = text.backdrop.offsets().map(|offset| offset * self.unit);
        let shadow = offsets.fold([DVec2::ZERO; 2], |[low, high], offset| [low.min(offset), high.max(offset)]);
        let [low, high] = self.ink;
        let corners = [low + shadow[0] - margin, high + shadow[1] + margin];
        corners.iter().all(|corner| corner.is_finite()).then(|| corners.map(|corner| corner - self.pivot))
    }

    /// Returns the ends of the lines around and in a text, in pairs, relative to the position.
    fn line_ends(&self, text: &TextObject) -> Vec<DVec2> {
        let mut ends = Vec::new();
        if let Some([low, high]) = self.bounding_box(text).filter(|_| text.draws(BOX_OUTLINE)) {
            let corners = [low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)];
            ends.extend((0..4).flat_map(|at| [corners[at], corners[(at + 1) % 4]]));
        }
        if text.draws(CROSS) {
            let arm = 0.5 * self.unit.y;
            ends.extend([DVec2::NEG_X, DVec2::X, DVec2::NEG_Y, DVec2::Y].map(|direction| arm * direction));
        }
        ends
    }

    /// Returns the corners of a letter's rectangle relative to the position.
    fn corners(&self, letter: &Letter, at: DVec2) -> [DVec2; 2] {
        letter.corners.map(|corner| at + corner * self.unit - self.pivot)
    }
}

/// Returns how far a text reaches from its position.
pub(super) fn reach(text: &TextObject) -> f64 {
    let Some(lines) = Lines::new(text) else { return 0.0 };
    let corners = lines.letters.iter().flat_map(|(letter, at)| {
        let [low, high] = lines.corners(letter, *at);
        [low, high, DVec2::new(low.x, high.y), DVec2::new(high.x, low.y)]
    });
    let corners = corners.chain(
        lines
            .bounding_box(text)
            .into_iter()
            .flat_map(|[low, high]| [low, high, DVec2::new(low.x, high.y), DVec2::new(high.x, low.y)]),
    );
    let corners = corners.chain(lines.line_ends(text));
    let backdrop = text.backdrop.offsets().map(|offset| (offset * lines.unit).length()).fold(0.0, f64::max);
    corners.map(DVec2::length).fold(0.0, f64::max) + backdrop
}

impl Builder<'_> {
    /// Makes the drawables of a text relative to its position: one for each texture that has letters of it.
    pub(in super::super) fn text_drawables(&mut self, text: &TextObject) -> Result<Vec<Drawable>, IoError> {
        let lines = Lines::new(text).filter(|_| text.position.is_finite() && text.rotation.is_finite());
        let Some(lines) = lines else {
            self.note("OpenSceneGraph: a text without a place or a size (not drawn)");
            return Ok(Vec::new());
        };
        if lines.lacks_letters {
            self.note("OpenSceneGraph: letters that the typeface lacks (drawn as boxes)");
        }
        let limit = self.source.options.limits.max_elements;
        let offsets = text.backdrop.offsets();
        let more = lines.letters.len().saturating_mul(4 * (offsets.clone().count() + 1));
        self.vertices = self.count(self.vertices, more, "vertices of an OpenSceneGraph file", limit)?;
        about_to_allocate(2 * (size_of::<MeshVertex>() * more) as u64).map_err(|error| error.at(self.source.uri))?;
        let [nx, ny, nz] = (text.rotation * DVec3::Z).to_array().map(|part| (part * 127.0).round() as i8);
        let packed = |color: [f32; 4]| linear_rgba(color).map(|part| (part * 255.0).round() as u8);
        let mut backdrop_color = text.backdrop.color;
        backdrop_color[3] *= text.color[3];
        let backdrops = offsets.map(|offset| (offset * lines.unit, packed(backdrop_color)));
        let mut pages: Vec<(usize, Vec<MeshVertex>)> = Vec::new();
        let rectangle = |[low, high]: [DVec2; 2], [low_uv, high_uv]: [[f32; 2]; 2], color| {
            let vertex = |x: f64, y: f64, uv: [f32; 2]| {
                let position = (text.rotation * DVec3::new(x, y, 0.0)).as_vec3().to_array();
                MeshVertex { position, uv, normal: [nx, ny, nz, 0], color }
            };
            [
                vertex(low.x, low.y, low_uv),
                vertex(high.x, low.y, [high_uv[0], low_uv[1]]),
                vertex(high.x, high.y, high_uv),
                vertex(low.x, high.y, [low_uv[0], high_uv[1]]),
            ]
        };
        if let Some(corners) = lines.bounding_box(text).filter(|_| text.draws(BOX_FILLED)) {
            // In the mesh of the letters, so that it is behind them.
            let page = lines.letters.first().map_or(0, |(letter, _)| letter.page);
            let uvs = [glyphs::page(page).covered_uv; 2];
            pages.push((page, rectangle(corners, uvs, packed(text.box_color)).to_vec()));
        }
        let letters = if text.draws(LETTERS_ALONE) { lines.letters.as_slice() } else { &[] };
        // Letters that are drawn later cover those before, so that none lies below the backdrop of its neighbour.
        for (offset, color) in backdrops.chain([(DVec2::ZERO, packed(text.color))]) {
            for (letter, at) in letters {
                let known = pages.iter().position(|(page, _)| *page == letter.page);
                let known = known.unwrap_or_else(|| {
                    pages.push((letter.page, Vec::new()));
                    pages.len() - 1
                });
                pages[known].1.extend(rectangle(lines.corners(letter, *at + offset), letter.uvs, color));
            }
        }
        let mut drawables: Vec<Drawable> = pages
            .into_iter()
            .map(|(page, vertices)| self.drawable_of_letters(page, vertices))
            .collect::<Result<_, IoError>>()?;
        let ends = lines.line_ends(text).into_iter().map(|end| MeshVertex {
            position: (text.rotation * end.extend(0.0)).as_vec3().to_array(),
            uv: [0.0; 2],
            normal: [nx, ny, nz, 0],
            color: [255; 4],
        });
        let ends: Vec<MeshVertex> = ends.collect();
        if !ends.is_empty() {
            let indices: Vec<u32> = (0..ends.len() as u32).collect();
            let mesh = Mesh::new(ends, indices, Topology::Lines);
            let material = Material { alpha: AlphaMode::Blend, unlit: true, ..Material::default() };
            drawables.push(Drawable::new(Geometry::Mesh(Arc::new(mesh)), material));
        }
        Ok(drawables)
    }

    fn drawable_of_letters(&self, page: usize, vertices: Vec<MeshVertex>) -> Result<Drawable, IoError> {
        let letters = glyphs::page(page);
        let (texture, shared) = match &self.source.options.sharing {
            Some(sharing) => {
                let key = ContentKey::of(&[b"letters of texts", &page.to_le_bytes()]);
                sharing.image(key, || Ok::<_, IoError>(letters.texture.clone()))?
            }
            None => (letters.texture.clone(), None),
        };
        let indices = (0..vertices.len() as u32).step_by(4).flat_map(|i| [i, i + 1, i + 2, i, i + 2, i + 3]);
        let mesh = Mesh::new(vertices, indices.collect::<Vec<u32>>(), Topology::Triangles);
        let material = Material {
            texture: Some(texture),
            alpha: AlphaMode::Blend,
            double_sided: true,
            unlit: true,
            ..Material::default()
        };
        let mut drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), material);
        drawable.shared.texture = shared;
        Ok(drawable)
    }
}
