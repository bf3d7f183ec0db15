//! The options of the encodings of one tile: triangles, compression, texture.

use image::codecs::png::PngEncoder;
use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use crate::pyramid::QUANTUM_M;
use crate::{Color, ContentKind, GenArgs};

const JPEG_QUALITY: u8 = 85;
/// The steps of heights in metres. With finer ones the heights of the earth would not fit into the numbers of packed tiles.
const HEIGHT_STEPS_M: std::ops::RangeInclusive<f64> = 0.002..=100.0;

/// The triangles of mesh tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Triangles {
    /// Few triangles where the terrain is flat. The declared error includes their distance from the grid.
    #[default]
    Tin,
    /// Two triangles for each of 64 x 64 cells.
    Grid,
}

/// The file format of textures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum TextureFormat {
    /// JPEG of quality 85.
    #[default]
    Jpeg,
    /// PNG, without loss.
    Png,
    /// WebP, without loss. In glb files it needs EXT_texture_webp.
    Webp,
}

impl TextureFormat {
    /// Returns the extension of the file name.
    pub(crate) fn extension(self) -> &'static str {
        match self {
            Self::Jpeg => "jpg",
            Self::Png => "png",
            Self::Webp => "webp",
        }
    }

    /// Encodes a square of RGB texels, northern row first. On failure returns the reason.
    pub(crate) fn encode(self, texels: &[u8], side: u16) -> Result<Vec<u8>, String> {
        let mut file = Vec::new();
        let (width, rgb) = (u32::from(side), ExtendedColorType::Rgb8);
        match self {
            Self::Jpeg => {
                let mut encoder = Encoder::new(&mut file, JPEG_QUALITY);
                encoder.set_sampling_factor(SamplingFactor::F_2_2);
                encoder.encode(texels, side, side, ColorType::Rgb).map_err(|e| e.to_string())
            }
            Self::Png => PngEncoder::new(&mut file).write_image(texels, width, width, rgb).map_err(|e| e.to_string()),
            Self::Webp => {
                let encoder = WebPEncoder::new_lossless(&mut file);
                encoder.write_image(texels, width, width, rgb).map_err(|e| e.to_string())
            }
        }?;
        Ok(file)
    }
}

/// The encodings of tiles.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct TileArgs {
    /// Triangles of mesh tiles; not for the meshes on the borders of height sets, which are grids
    #[arg(long = "mesh", value_name = "TRIANGLES", value_enum, default_value_t)]
    pub triangles: Triangles,
    /// Write meshes without EXT_meshopt_compression, for clients that do not support it
    #[arg(long)]
    pub no_meshopt: bool,
    /// Round the heights of --dem to steps of this many metres, 0.002 to 100 (default 1/128): coarser ones take fewer bytes
    #[arg(long, value_name = "M")]
    pub height_step: Option<f64>,
    /// Write normal maps of all samples into meshes of few triangles, which are then shaded like those of all triangles
    #[arg(long)]
    pub normal_maps: bool,
    /// File format of textures
    #[arg(long, value_enum, default_value_t)]
    pub texture: TextureFormat,
}

impl TileArgs {
    /// Returns the step in metres that heights are rounded to.
    pub(crate) fn step_m(&self) -> f64 {
        self.height_step.unwrap_or(QUANTUM_M)
    }

    /// Checks options that have no effect together with others.
    pub(crate) fn check(&self, args: &GenArgs) -> Result<(), String> {
        if args.content == ContentKind::Height && self.triangles != Triangles::default() {
            return Err("--mesh has no effect without --content mesh or quantized-mesh".to_owned());
        }
        if self.normal_maps && args.content != ContentKind::Mesh {
            return Err("--normal-maps has no effect without --content mesh".to_owned());
        }
        if self.normal_maps && self.triangles == Triangles::Grid {
            return Err("--normal-maps has no effect with --mesh grid, whose vertices have all normals".to_owned());
        }
        if args.float_vertices && self.no_meshopt {
            return Err("--no-meshopt has no effect with --float-vertices".to_owned());
        }
        if let Some(step_m) = self.height_step {
            if args.dem.is_empty() {
                return Err("--height-step has no effect without --dem".to_owned());
            }
            if args.content == ContentKind::QuantizedMesh {
                return Err("--height-step is not supported with --content quantized-mesh, whose tiles have own steps"
                    .to_owned());
            }
            if !HEIGHT_STEPS_M.contains(&step_m) {
                let (least, most) = (HEIGHT_STEPS_M.start(), HEIGHT_STEPS_M.end());
                return Err(format!("--height-step must be {least} to {most} m"));
            }
        }
        if args.color == Color::None && self.texture != TextureFormat::default() {
            return Err("--texture has no effect with --color none".to_owned());
        }
        Ok(())
    }
}
