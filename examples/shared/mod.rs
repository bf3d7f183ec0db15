//! The command line and the frame loop that the examples share:
//! `[SOURCE] [--offscreen] [--frames N] [--screenshot FILE]`.

#![allow(dead_code, reason = "each example uses a part of it")]

pub mod host;

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use terrane::viewer::{Viewer, ViewerConfig, ViewerError, WindowOptions, has_display, run_window};

/// The command line of an example.
#[derive(Default)]
pub struct Args {
    is_offscreen: bool,
    frames: Option<u32>,
    screenshot: Option<PathBuf>,
    others: Vec<String>,
}

impl Args {
    /// Parses the program's command line.
    pub fn parse() -> Result<Self> {
        let (mut args, mut words) = (Self::default(), std::env::args().skip(1));
        while let Some(word) = words.next() {
            let mut value = || words.next().with_context(|| format!("{word} needs a value"));
            match word.as_str() {
                "--offscreen" => args.is_offscreen = true,
                "--frames" => args.frames = Some(value()?.parse().context("--frames needs a number")?),
                "--screenshot" => args.screenshot = Some(value()?.into()),
                _ => args.others.push(word),
            }
        }
        Ok(args)
    }

    /// Returns true when the example opens a window: there is a display, and `--offscreen` is not given.
    pub fn opens_window(&self) -> bool {
        !self.is_offscreen && has_display()
    }

    /// Returns the number of frames to draw offscreen.
    pub fn frames_or(&self, default: u32) -> u32 {
        self.frames.unwrap_or(default)
    }

    /// Returns true when the command line has a flag of the example's own.
    pub fn has_flag(&self, name: &str) -> bool {
        self.others.iter().any(|word| word == name)
    }

    /// Returns the tile set to show; without SOURCE it generates a small one in the system's temporary folder.
    pub fn source(&self) -> Result<String> {
        match self.others.iter().find(|word| !word.starts_with("--")) {
            Some(source) => Ok(source.clone()),
            None => {
                Ok(terrane_data_gen::default_set(&std::env::temp_dir().join("terrane-hello"))?.display().to_string())
            }
        }
    }

    /// Writes the last image if `--screenshot` is given.
    pub fn save(&self, viewer: &mut Viewer) -> Result<()> {
        self.save_image(|| Ok(viewer.read_back()?))
    }

    /// Writes an image if `--screenshot` is given.
    pub fn save_image(&self, image: impl FnOnce() -> Result<image::RgbaImage>) -> Result<()> {
        let Some(file) = &self.screenshot else { return Ok(()) };
        // Without alpha, so that FILE may be a JPEG too.
        let image = image::DynamicImage::ImageRgba8(image()?).into_rgb8();
        image.save(file).with_context(|| file.display().to_string())
    }
}

/// Draws frames 1/60 s apart until `--frames` (60 by default) are drawn and all tiles are loaded.
pub fn draw(args: &Args, viewer: &mut Viewer) -> Result<(), ViewerError> {
    while viewer.frame_stamp().frame < args.frames_or(60) || !viewer.is_settled() {
        viewer.frame_at(f64::from(viewer.frame_stamp().frame) / 60.0)?;
    }
    Ok(())
}

/// Shows the scene that `build` adds: in a window, or offscreen with an image written at the end.
pub fn show(
    args: &Args,
    options: WindowOptions,
    build: impl FnOnce(&mut Viewer) -> Result<(), ViewerError> + 'static,
) -> Result<()> {
    let config = ViewerConfig { samples: 4, ..ViewerConfig::default() };
    if args.opens_window() {
        run_window(config, WindowOptions { on_open: Box::new(build), ..options })?;
        return Ok(());
    }
    let mut viewer = Viewer::new_offscreen(&config)?;
    build(&mut viewer)?;
    draw(args, &mut viewer)?;
    args.save(&mut viewer)
}
