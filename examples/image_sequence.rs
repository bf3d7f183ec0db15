//! Image sequences: one screen plays images that are read from files while it plays, eight ahead. Another plays the same
//! files at half the speed, forwards and backwards.
//!
//! ```text
//! cargo run --release --example image_sequence -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: two screens on grey ground, each with a bright disc that circles on a coloured board.

mod shared;

use std::{path::Path, path::PathBuf, sync::Arc};

use anyhow::Result;
use glam::DVec3;
use terrane::pager::{ImageSequence, LoopingMode};
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::state::{Attribute, Mode, StateSet, StateValue, TextureBinding};
use terrane::viewer::{Viewer, ViewerConfig, ViewerError, WindowOptions};

const IMAGES: u32 = 24;

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    let folder = std::env::temp_dir().join(format!("terrane-image-sequence-{}", std::process::id()));
    let files = write_images(&folder)?;
    let build = move |viewer: &mut Viewer| build(viewer, &files);
    if args.opens_window() {
        shared::show(&args, WindowOptions::default(), build)?;
    } else {
        let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
        build(&mut viewer)?;
        for frame in 0..args.frames_or(60) {
            viewer.frame_at(f64::from(frame) / 60.0)?;
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        args.save(&mut viewer)?;
    }
    Ok(std::fs::remove_dir_all(folder)?)
}

/// Writes images of a disc that circles once.
fn write_images(folder: &Path) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder)?;
    let write = |k: u32| {
        let angle = f64::from(k) / f64::from(IMAGES) * std::f64::consts::TAU;
        let (x, y) = (128.0 + 80.0 * angle.cos(), 128.0 - 80.0 * angle.sin());
        let file = folder.join(format!("{k:02}.png"));
        image::RgbImage::from_fn(256, 256, |i, j| {
            let inside = (f64::from(i) - x).hypot(f64::from(j) - y) < 36.0;
            image::Rgb(if inside { [250, 230, 90] } else { [(i / 2) as u8, 40, (j / 2) as u8] })
        })
        .save(&file)
        .map(|()| file)
    };
    Ok((0..IMAGES).map(write).collect::<Result<_, _>>()?)
}

fn build(viewer: &mut Viewer, files: &[PathBuf]) -> Result<(), ViewerError> {
    let mut screen = |x: f64, looping: LoopingMode, speed: f64| {
        let sequence = ImageSequence::from_files("disc", files.iter().map(|f| f.display().to_string()));
        sequence.set_looping_mode(looping);
        sequence.set_length(1.0);
        sequence.set_time_multiplier(speed);
        sequence.play();
        viewer.add_image_sequence(&sequence)?;
        let texture = StateSet::default()
            .with_mode(Mode::Lighting, StateValue::OFF)
            .with(Attribute::Texture(0, TextureBinding::new(sequence.texture())));
        let mesh = Mesh::rectangle(DVec3::new(x, 0.0, 0.5), DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 4.0));
        let screen = Drawable::new(mesh.into(), Material::default());
        Ok::<_, ViewerError>(Node::geode(vec![screen]).with_state_set(Arc::new(texture)))
    };
    let (left, right) = (screen(-4.5, LoopingMode::Looping, 1.0)?, screen(0.5, LoopingMode::Swing, 0.5)?);
    let ground = Mesh::rectangle(DVec3::new(-20.0, -20.0, 0.0), DVec3::new(40.0, 0.0, 0.0), DVec3::new(0.0, 40.0, 0.0));
    let grey = Material { base_color: [0.2, 0.2, 0.2, 1.0], ..Material::default() };
    let ground = Node::geode(vec![Drawable::new(ground.into(), grey)]);
    viewer.add_root(Page::from_node(Node::group(vec![ground, left, right])).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -11.0, 3.5), DVec3::new(0.0, 0.0, 2.3), DVec3::Z);
    Ok(())
}
