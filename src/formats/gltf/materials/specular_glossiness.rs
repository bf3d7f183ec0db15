//! KHR_materials_pbrSpecularGlossiness, converted to the metallic-roughness model.
//!
//! The conversion is the one that Khronos gives with the extension. A quadratic equation for the metallic share follows from
//! the diffuse and the specular brightness, since a dielectric reflects 0.04 of the light. Where the result depends on maps,
//! they are converted texel by texel.

use std::sync::OnceLock;

use super::texture_ref::TextureRef;
use crate::formats::ignored::Notes;
use crate::formats::image::{MipFilter, mips};
use crate::math::color::{linear_from_srgb8, srgb_from_linear};
use crate::scene::{TexelFormat, Texture};

/// The share of light that a dielectric surface reflects.
const DIELECTRIC: f32 = 0.04;

/// The factors and maps of a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct SpecularGlossiness {
    /// Linear RGBA.
    diffuse: [f32; 4],
    /// Linear RGB.
    specular: [f32; 3],
    glossiness: f32,
    pub(super) diffuse_map: Option<TextureRef>,
    /// Specular colour in RGB, sRGB; glossiness in alpha, linear.
    pub(super) map: Option<TextureRef>,
}

/// The textures of both maps, and the bits of the factors.
pub(super) type Key = ([Option<usize>; 2], [u32; 7]);

/// The factors of the metallic-roughness model. Linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Converted {
    pub base_color: [f32; 4],
    pub metallic: f32,
    pub roughness: f32,
}

impl SpecularGlossiness {
    /// Reads a material. A map with other texture coordinates than the diffuse one is noted and left out.
    ///
    /// White, the default of the specular colour, leaves no light to the diffuse colour. A material with a diffuse colour and
    /// without another specular one is taken for a dielectric, which is noted.
    pub(super) fn new(material: &gltf::material::PbrSpecularGlossiness<'_>, notes: &Notes) -> Self {
        let diffuse_map = material.diffuse_texture().map(|info| TextureRef::new(&info));
        let mut map = material.specular_glossiness_texture().map(|info| TextureRef::new(&info));
        let (diffuse, mut specular) = (material.diffuse_factor(), material.specular_factor());
        if map.is_none() && specular == [1.0; 3] && diffuse[..3].iter().any(|part| *part > 0.0) {
            notes.add("glTF material: white specular colour (drawn as a dielectric)");
            specular = [DIELECTRIC; 3];
        }
        if let (Some(own), Some(diffuse)) = (&map, &diffuse_map)
            && !own.has_coordinates_of(diffuse)
        {
            notes.add("glTF material: map with other texture coordinates than the base colour");
            map = None;
        }
        Self { diffuse, specular, glossiness: material.glossiness_factor(), diffuse_map, map }
    }

    /// Returns the texture whose coordinates both maps use.
    pub(super) fn texture(&self) -> Option<TextureRef> {
        self.diffuse_map.or(self.map)
    }

    /// Returns a value that is equal for materials whose maps are converted equally.
    pub(super) fn key(&self) -> Key {
        let [r, g, b, _] = self.diffuse;
        let [sr, sg, sb] = self.specular;
        (
            [self.diffuse_map, self.map].map(|map| Some(map?.texture)),
            [r, g, b, sr, sg, sb, self.glossiness].map(f32::to_bits),
        )
    }

    /// Returns true if the metallic share or the roughness depends on a map, so that the maps must be converted.
    pub(super) fn needs_converted_maps(&self) -> bool {
        self.map.is_some() || self.diffuse_map.is_some() && !is_dielectric(brightness(self.specular))
    }

    /// Converts the factors, which the texels of a diffuse map multiply.
    pub(super) fn converted(&self) -> Converted {
        convert(self.diffuse, self.specular, self.glossiness)
    }

    /// Returns the opacity, which the alpha of the base colour map multiplies.
    pub(super) fn alpha(&self) -> f32 {
        self.diffuse[3]
    }

    /// Converts maps in RGBA8 to a base colour map, and a map with roughness in green and metallic in blue. The smaller of the
    /// maps is enlarged. A map that is missing is white.
    pub(super) fn converted_maps(&self, diffuse: Option<&Texture>, map: Option<&Texture>) -> [Texture; 2] {
        let sampling = diffuse.or(map).map(|of| of.sampling).unwrap_or_default();
        let [width, height] = converted_size(diffuse, map);
        let [diffuse, map] = [diffuse, map].map(|of| of.map(|of| Texels::new(of, width, height)));
        let texels = width as usize * height as usize;
        let (mut base_color, mut metallic_roughness) = (Vec::with_capacity(4 * texels), Vec::with_capacity(4 * texels));
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let texel = |of: &Option<Texels<'_>>| of.as_ref().map_or([1.0; 4], |of| of.at(x, y));
            let ([r, g, b, alpha], [sr, sg, sb, gloss]) = (texel(&diffuse), texel(&map));
            let [fr, fg, fb, _] = self.diffuse;
            let specular = [self.specular[0] * sr, self.specular[1] * sg, self.specular[2] * sb];
            let converted = convert([fr * r, fg * g, fb * b, alpha], specular, self.glossiness * gloss);
            let [r, g, b, alpha] = converted.base_color;
            base_color.extend([srgb8(r), srgb8(g), srgb8(b), unorm8(alpha)]);
            metallic_roughness.extend([255, unorm8(converted.roughness), unorm8(converted.metallic), 255]);
        }
        let kept = if sampling.mip.is_some() { usize::MAX } else { 1 };
        [(base_color, MipFilter::Srgb), (metallic_roughness, MipFilter::Linear)].map(|(pixels, filter)| {
            let mips = mips(width, height, pixels, filter).into_iter().take(kept).collect();
            Texture { width, height, format: TexelFormat::Rgba8, mips, sampling }
        })
    }
}

/// Returns width and height of the converted maps: the larger ones of both maps. A wide and a high map are small, and their
/// converted maps are not.
pub(super) fn converted_size(diffuse: Option<&Texture>, map: Option<&Texture>) -> [u32; 2] {
    let largest = |of: fn(&Texture) -> u32| diffuse.into_iter().chain(map).map(of).max().unwrap_or(1);
    [largest(|of| of.width), largest(|of| of.height)]
}

/// Converts a linear diffuse and specular colour. The alpha of the diffuse colour stays.
fn convert([r, g, b, alpha]: [f32; 4], specular: [f32; 3], glossiness: f32) -> Converted {
    let diffuse = [r, g, b];
    let not_reflected = 1.0 - specular.into_iter().fold(0.0, f32::max);
    let not_reflected_share = not_reflected / (1.0 - DIELECTRIC);
    let metallic = metallic_share(brightness(diffuse) * not_reflected_share, brightness(specular));
    let dielectric = 1.0 - metallic;
    let part = |i: usize| {
        let from_diffuse = diffuse[i] * not_reflected_share / dielectric.max(1e-6);
        let from_specular = (specular[i] - DIELECTRIC * dielectric) / metallic.max(1e-6);
        // The more metal there is, the more precise is the colour from the specular part.
        let share = metallic * metallic;
        (from_diffuse + (from_specular - from_diffuse) * share).clamp(0.0, 1.0)
    };
    let base_color = [part(0), part(1), part(2), alpha];
    Converted { base_color, metallic, roughness: (1.0 - glossiness).clamp(0.0, 1.0) }
}

/// Returns true if the brightness of a specular colour is no more than a dielectric surface reflects, but for rounding.
fn is_dielectric(specular: f32) -> bool {
    specular <= DIELECTRIC * 1.0001
}

/// Returns the metallic share of a surface by its diffuse and specular brightness.
fn metallic_share(diffuse: f32, specular: f32) -> f32 {
    if is_dielectric(specular) {
        return 0.0;
    }
    // The share m solves 0.04 m^2 + b m + 0.04 - specular = 0.
    let b = diffuse + specular - 2.0 * DIELECTRIC;
    let discriminant = b * b - 4.0 * DIELECTRIC * (DIELECTRIC - specular);
    ((discriminant.max(0.0).sqrt() - b) / (2.0 * DIELECTRIC)).clamp(0.0, 1.0)
}

/// Returns the perceived brightness of a linear colour.
fn brightness([r, g, b]: [f32; 3]) -> f32 {
    (0.299 * r * r + 0.587 * g * g + 0.114 * b * b).sqrt()
}

/// Level 0 of an RGBA8 texture, sampled as an image of another size.
struct Texels<'a> {
    texture: &'a Texture,
    texels: &'a [[u8; 4]],
    /// Texels of the texture for one texel of the other size.
    step: [f32; 2],
}

impl<'a> Texels<'a> {
    fn new(texture: &'a Texture, width: u32, height: u32) -> Self {
        let texels = texture.mips.first().map_or(&[][..], |level| level.as_chunks::<4>().0);
        Self { texture, texels, step: [texture.width as f32 / width as f32, texture.height as f32 / height as f32] }
    }

    /// Returns a texel of the other size, RGB linear: the mean of the four nearest texels by their distance. Beyond the edges are
    /// the texels at the edges.
    fn at(&self, x: u32, y: u32) -> [f32; 4] {
        if self.step == [1.0; 2] {
            return self.linear(x, y);
        }
        let place = |at: u32, step: f32, size: u32| {
            let at = ((at as f32 + 0.5) * step - 0.5).clamp(0.0, (size - 1) as f32);
            let low = at as u32;
            (low, (low + 1).min(size - 1), at - low as f32)
        };
        let (x0, x1, along_x) = place(x, self.step[0], self.texture.width);
        let (y0, y1, along_y) = place(y, self.step[1], self.texture.height);
        let mixed = |a: [f32; 4], b: [f32; 4], share: f32| [0, 1, 2, 3].map(|i: usize| a[i] + (b[i] - a[i]) * share);
        let row = |y: u32| mixed(self.linear(x0, y), self.linear(x1, y), along_x);
        mixed(row(y0), row(y1), along_y)
    }

    fn linear(&self, x: u32, y: u32) -> [f32; 4] {
        let at = y as usize * self.texture.width as usize + x as usize;
        let [r, g, b, a] = self.texels.get(at).copied().unwrap_or([255; 4]);
        [linear8(r), linear8(g), linear8(b), f32::from(a) / 255.0]
    }
}

fn linear8(srgb: u8) -> f32 {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|srgb| linear_from_srgb8(srgb as u8) as f32))[usize::from(srgb)]
}

/// Returns the nearest sRGB component; dark ones, which are close together, may be off by one.
fn srgb8(linear: f32) -> u8 {
    const STEPS: usize = 1 << 14;
    static TABLE: OnceLock<Box<[u8]>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        let of = |step: usize| (srgb_from_linear(step as f64 / (STEPS - 1) as f64) * 255.0).round() as u8;
        (0..STEPS).map(of).collect()
    });
    table[(linear.clamp(0.0, 1.0) * (STEPS - 1) as f32).round() as usize]
}

fn unorm8(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Sampling;

    fn image(width: u32, height: u32, pixels: &[[u8; 4]]) -> Texture {
        let mips = vec![pixels.as_flattened().to_vec()];
        Texture {
            width,
            height,
            format: TexelFormat::Rgba8,
            mips,
            sampling: Sampling { mip: None, ..Sampling::default() },
        }
    }

    fn plain(diffuse: [f32; 4], specular: [f32; 3], glossiness: f32) -> SpecularGlossiness {
        SpecularGlossiness { diffuse, specular, glossiness, diffuse_map: None, map: None }
    }

    /// The forward direction of the model: a metallic-roughness surface has a diffuse part of base * (1 - metallic) * 0.96, and
    /// reflects 0.04 * (1 - metallic) + base * metallic.
    #[test]
    fn gray_surfaces_are_converted_back() {
        for (base, metallic) in [(0.5_f32, 0.0), (0.2, 1.0), (0.7, 0.5), (0.9, 0.1), (0.3, 0.8)] {
            let specular = 0.04 * (1.0 - metallic) + base * metallic;
            // The extension multiplies the diffuse colour by what is not reflected.
            let diffuse = base * (1.0 - metallic) * 0.96 / (1.0 - specular);
            let got = convert([diffuse, diffuse, diffuse, 0.5], [specular; 3], 0.25);
            assert!((got.metallic - metallic).abs() < 1e-3, "{base} {metallic}: {got:?}");
            assert!((got.base_color[0] - base).abs() < 1e-3, "{base} {metallic}: {got:?}");
            assert_eq!((got.base_color[3], got.roughness), (0.5, 0.75));
        }
    }

    #[test]
    fn colours_of_metals_come_from_the_specular_part() {
        let gold = [1.0, 0.77, 0.34];
        let got = convert([0.0, 0.0, 0.0, 1.0], gold, 1.0);
        assert!((got.metallic - 1.0).abs() < 1e-5 && got.roughness == 0.0, "{got:?}");
        assert!(got.base_color.iter().zip(gold).all(|(a, b)| (a - b).abs() < 1e-4), "{got:?}");
        // Without reflection the diffuse colour stays, but for what a dielectric reflects.
        let got = convert([0.48, 0.24, 0.0, 1.0], [0.0; 3], 0.0);
        assert!((got.base_color[0] - 0.5).abs() < 1e-6 && (got.base_color[1] - 0.25).abs() < 1e-6, "{got:?}");
        assert_eq!((got.metallic, got.roughness), (0.0, 1.0));
    }

    #[test]
    fn texels_of_maps_are_converted_as_factors_are() {
        // Two texels of the diffuse map, of which the second is transparent; one of the other map.
        let model = plain([1.0, 0.5, 1.0, 0.5], [1.0, 1.0, 0.5], 0.5);
        let diffuse = image(2, 1, &[[188, 188, 188, 255], [0, 0, 0, 51]]);
        let map = image(1, 1, &[[188, 137, 255, 102]]);
        let [base_color, rest] = model.converted_maps(Some(&diffuse), Some(&map));
        assert_eq!([(base_color.width, base_color.height), (rest.width, rest.height)], [(2, 1); 2]);
        assert_eq!((base_color.mips.len(), rest.mips.len()), (1, 1));
        let linear = |srgb: u8| linear_from_srgb8(srgb) as f32;
        let specular = [linear(188), linear(137), 0.5];
        for (i, (gray, alpha)) in [(linear(188), 255), (0.0, 51)].into_iter().enumerate() {
            let expected = convert([gray, 0.5 * gray, gray, 1.0], specular, 0.5 * 0.4);
            let texel = &base_color.mips[0][4 * i..4 * i + 4];
            for (got, expected) in texel.iter().zip(expected.base_color).take(3) {
                assert!((linear(*got) - expected).abs() < 0.006, "{texel:?} {expected:?}");
            }
            assert_eq!(texel[3], alpha, "the factor of the opacity is not applied");
            let metallic = unorm8(expected.metallic);
            assert_eq!(rest.mips[0][4 * i..4 * i + 4], [255, 204, metallic, 255]);
        }
        let [base_color, rest] = model.converted_maps(None, None);
        assert_eq!((base_color.mips[0].len(), rest.mips[0][1]), (4, 128), "factors alone");
    }

    #[test]
    fn smaller_maps_are_enlarged() {
        let model = plain([1.0; 4], [0.0; 3], 1.0);
        let large = image(4, 4, &[[255; 4]; 16]);
        let small = image(2, 1, &[[0, 0, 0, 0], [0, 0, 0, 255]]);
        let [_, rest] = model.converted_maps(Some(&large), Some(&small));
        let roughness: Vec<u8> = rest.mips[0].chunks_exact(4).map(|texel| texel[1]).collect();
        assert_eq!(roughness, [255, 191, 64, 0].repeat(4));
        let mipped = Texture { sampling: Sampling::default(), ..image(2, 2, &[[0, 0, 0, 0]; 4]) };
        let levels = model.converted_maps(None, Some(&mipped)).map(|map| map.mips.len());
        assert_eq!(levels, [if Sampling::default().mip.is_some() { 2 } else { 1 }; 2]);
    }
}
