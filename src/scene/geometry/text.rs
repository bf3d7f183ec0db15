//! Text as a drawable: a texture of the glyphs on a rectangle, for labels and overlays; OSG's `osgText`. Any thread; not
//! frame-time code.

use std::sync::Arc;

use ab_glyph::{Font as _, FontArc, Glyph, PxScale, ScaleFont, point};
use glam::DVec3;

use super::drawable::Drawable;
use super::material::{AlphaMode, Material};
use super::mesh::Mesh;
use super::texture::Texture;

/// The height of a line in texels, unless the texture would be too large.
const LINE_PX: f32 = 48.0;
/// The largest side of the texture in texels.
const MAX_PX: f32 = 4096.0;

/// A typeface.
#[derive(Clone, Debug)]
pub struct Font(pub(crate) FontArc);

impl Default for Font {
    /// Returns Ubuntu Light, which is part of the program.
    fn default() -> Self {
        let bytes = epaint_default_fonts::UBUNTU_LIGHT;
        Self(FontArc::try_from_slice(bytes).expect("the built-in font is valid"))
    }
}

impl Font {
    /// Reads a TrueType or OpenType font; `None` if the bytes are not a font.
    pub fn from_bytes(bytes: Vec<u8>) -> Option<Self> {
        FontArc::try_from_vec(bytes).ok().map(Self)
    }

    /// Returns glyphs with their positions in texels from the upper left, and the size of the texture around them.
    fn layout(&self, text: &str, line_px: f32) -> (Vec<Glyph>, [f32; 2]) {
        let font = self.0.as_scaled(PxScale::from(line_px));
        let line_height = font.height() + font.line_gap();
        let (mut glyphs, mut width) = (Vec::new(), 0.0f32);
        let mut lines = 0.0;
        for line in text.lines() {
            let (mut x, mut last) = (0.0, None);
            for character in line.chars().filter(|c| !c.is_control()) {
                let id = font.glyph_id(character);
                x += last.map_or(0.0, |last| font.kern(last, id));
                glyphs.push(id.with_scale_and_position(line_px, point(x, lines * line_height + font.ascent())));
                x += font.h_advance(id);
                last = Some(id);
            }
            width = width.max(x);
            lines += 1.0;
        }
        (glyphs, [width.max(1.0), (lines * line_height).max(1.0)])
    }
}

impl Drawable {
    /// Creates lines of text in the x-y plane, facing +z: the lower left corner is at the origin, a line is `height_m` high.
    /// The material is blended and unlit. Empty text is an invisible rectangle.
    pub fn text(font: &Font, text: &str, height_m: f64, color: [f32; 4]) -> Self {
        let (mut glyphs, mut size) = font.layout(text, LINE_PX);
        let too_large = (size[0].max(size[1]) / MAX_PX).max(1.0);
        let line_px = LINE_PX / too_large;
        if too_large > 1.0 {
            (glyphs, size) = font.layout(text, line_px);
        }
        let [width, height] = size.map(|s| (s.ceil() as u32).clamp(1, MAX_PX as u32));
        let mut coverage = vec![0.0f32; width as usize * height as usize];
        for glyph in glyphs {
            let Some(outline) = font.0.outline_glyph(glyph) else { continue };
            let corner = outline.px_bounds().min;
            outline.draw(|x, y, covered| {
                let (x, y) = (corner.x as i64 + i64::from(x), corner.y as i64 + i64::from(y));
                if (0..i64::from(width)).contains(&x) && (0..i64::from(height)).contains(&y) {
                    let texel = &mut coverage[y as usize * width as usize + x as usize];
                    *texel = texel.max(covered);
                }
            });
        }
        let metres = height_m / f64::from(line_px);
        let (right, up) = (f64::from(width) * metres * DVec3::X, f64::from(height) * metres * DVec3::Y);
        let material = Material {
            base_color: color,
            texture: Some(Arc::new(coverage_texture(width, height, coverage))),
            alpha: AlphaMode::Blend,
            double_sided: true,
            unlit: true,
            ..Material::default()
        };
        Self::new(Mesh::rectangle(DVec3::ZERO, right, up).into(), material)
    }
}

/// Returns a white texture whose alpha is the coverage, with its mip levels.
pub(crate) fn coverage_texture(width: u32, height: u32, coverage: Vec<f32>) -> Texture {
    let mut mips = Vec::new();
    let (mut w, mut h, mut level) = (width as usize, height as usize, coverage);
    loop {
        mips.push(level.iter().flat_map(|c| [255, 255, 255, (c.clamp(0.0, 1.0) * 255.0).round() as u8]).collect());
        if w == 1 && h == 1 {
            return Texture::rgba8(width, height, mips);
        }
        let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
        let at = |x: usize, y: usize| level[y.min(h - 1) * w + x.min(w - 1)];
        let mean = |x: usize, y: usize| {
            0.25 * (at(2 * x, 2 * y) + at(2 * x + 1, 2 * y) + at(2 * x, 2 * y + 1) + at(2 * x + 1, 2 * y + 1))
        };
        let next = (0..nw * nh).map(|i| mean(i % nw, i / nw)).collect();
        (w, h, level) = (nw, nh, next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Geometry;

    fn inked(drawable: &Drawable) -> f64 {
        let texture = drawable.material.texture.as_ref().expect("a texture");
        assert_eq!(texture.mips.len(), 32 - texture.width.max(texture.height).leading_zeros() as usize);
        let dark = texture.mips[0].chunks_exact(4).filter(|p| p[3] > 127).count();
        dark as f64 / f64::from(texture.width * texture.height)
    }

    #[test]
    fn letters_cover_pixels_and_lines_add_height() {
        let font = Font::default();
        let text = |t: &str| Drawable::text(&font, t, 2.0, [1.0; 4]);
        let one = text("Terrane 123");
        assert!((0.05..0.5).contains(&inked(&one)), "{}", inked(&one));
        assert!(inked(&text("")) == 0.0 && inked(&text("\n\t\r")) == 0.0);
        let size = |d: &Drawable| match &d.geometry {
            Geometry::Mesh(mesh) => 2.0 * mesh.bounds.half_size(),
            _ => DVec3::ZERO,
        };
        assert!((size(&one).y - 2.0).abs() < 0.6, "{}", size(&one).y);
        let two = size(&text("Terrane 123\nand more"));
        assert!((two.y / size(&one).y - 2.0).abs() < 0.1);
        assert!(size(&text(&"wide ".repeat(2_000))).x > 1_000.0, "beyond the largest texture");
        assert!(Font::from_bytes(vec![1, 2, 3]).is_none());
    }
}
