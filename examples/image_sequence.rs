//! A screen plays a sequence of pictures that are read from files while it plays, eight ahead; another shows the same
//! files at half the speed, to and fro.
//!
//! ```text
//! cargo run --release --example image_sequence -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: two screens on a grey ground; on each a bright disc on a coloured board, which goes round.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use glam::DVec3;
use terrane::pager::{ImageSequence, LoopingMode};
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::state::{Attribute, Mode, StateSet, StateValue, TextureBinding};
use terrane::viewer::{Viewer, ViewerConfig, ViewerError, WindowOptions, has_display, run_window};

const PICTURES: u32 = 24;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(60), |n| n.parse())?;
    let folder = std::env::temp_dir().join(format!("terrane-image-sequence-{}", std::process::id()));
    let files = write_pictures(&folder)?;
    let build = move |viewer: &mut Viewer| build(viewer, &files);
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let options = WindowOptions { on_open: Box::new(build), ..WindowOptions::default() };
        run_window(ViewerConfig::default(), options)?;
    } else {
        let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
        build(&mut viewer)?;
        for frame in 0..frames {
            viewer.frame_at(f64::from(frame) / 60.0)?;
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        value("--screenshot").map_or(Ok(()), |file| viewer.read_back()?.save(file).map_err(anyhow::Error::from))?;
    }
    Ok(std::fs::remove_dir_all(folder)?)
}

/// A disc that goes round once.
fn write_pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder)?;
    let picture = |k: u32| {
        let angle = f64::from(k) / f64::from(PICTURES) * std::f64::consts::TAU;
        let (x, y) = (128.0 + 80.0 * angle.cos(), 128.0 - 80.0 * angle.sin());
        let file = folder.join(format!("{k:02}.png"));
        image::RgbImage::from_fn(256, 256, |i, j| {
            let inside = (f64::from(i) - x).hypot(f64::from(j) - y) < 36.0;
            image::Rgb(if inside { [250, 230, 90] } else { [(i / 2) as u8, 40, (j / 2) as u8] })
        })
        .save(&file)
        .map(|()| file)
    };
    Ok((0..PICTURES).map(picture).collect::<Result<_, _>>()?)
}

fn build(viewer: &mut Viewer, files: &[PathBuf]) -> Result<(), ViewerError> {
    let mut screen = |x: f64, looping: LoopingMode, speed: f64| {
        let sequence = ImageSequence::from_files("disc", files.iter().map(|f| f.display().to_string()));
        sequence.set_looping_mode(looping);
        sequence.set_length(1.0);
        sequence.set_time_multiplier(speed);
        sequence.play();
        viewer.add_image_sequence(&sequence)?;
        let shows = StateSet::default()
            .with_mode(Mode::Lighting, StateValue::OFF)
            .with(Attribute::Texture(0, TextureBinding::new(sequence.texture())));
        let mesh = Mesh::rectangle(DVec3::new(x, 0.0, 0.5), DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 4.0));
        Ok::<_, ViewerError>(
            Node::geode(vec![Drawable::new(mesh.into(), Material::default())]).with_state_set(Arc::new(shows)),
        )
    };
    let screens = [screen(-4.5, LoopingMode::Looping, 1.0)?, screen(0.5, LoopingMode::Swing, 0.5)?];
    let ground = Mesh::rectangle(DVec3::new(-20.0, -20.0, 0.0), DVec3::new(40.0, 0.0, 0.0), DVec3::new(0.0, 40.0, 0.0));
    let grey = Material { base_color: [0.2, 0.2, 0.2, 1.0], ..Material::default() };
    let ground = Node::geode(vec![Drawable::new(ground.into(), grey)]);
    let [a, b] = screens;
    viewer.add_root(Page::from_node(Node::group(vec![ground, a, b])).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -11.0, 3.5), DVec3::new(0.0, 0.0, 2.3), DVec3::Z);
    Ok(())
}
