//! Two windows on one view: the second one continues the image of the first to the right.
//!
//! ```text
//! cargo run --release --example two_windows -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a row of coloured balls that starts in the left window and continues in the right one; a drag in the left
//! window turns both. Offscreen, the images of the two windows side by side.

mod shared;

use anyhow::Result;
use glam::{DAffine3, DMat4, DVec3};
use image::{GenericImage as _, RgbaImage};
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::viewer::{Slave, SlaveWindow, Viewer, ViewerConfig, ViewerError, WindowOptions, run_window};

const SIZE_PX: [u32; 2] = [640, 720];

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    let config = ViewerConfig { size_px: SIZE_PX, samples: 4, max_contexts: 2, ..ViewerConfig::default() };
    // Clip space is 2 units wide: the second window shows what lies one image width to the right.
    let projection_offset = DMat4::from_translation(DVec3::new(-2.0, 0.0, 0.0));
    if args.opens_window() {
        let second = SlaveWindow {
            title: "right".into(),
            size_px: SIZE_PX,
            position_px: None,
            shares_device: true,
            projection_offset,
            view_offset: DAffine3::IDENTITY,
        };
        let options = WindowOptions { title: "left".into(), slaves: vec![second], ..WindowOptions::default() };
        run_window(config, WindowOptions { on_open: Box::new(build), ..options })?;
        return Ok(());
    }
    let mut viewer = Viewer::new_offscreen(&config)?;
    let first = viewer.context();
    let second = viewer.composite_mut().open_offscreen_on(first, &config.traits())?;
    viewer.add_slave(Slave { projection_offset, ..Slave::new(second) })?;
    build(&mut viewer)?;
    shared::draw(&args, &mut viewer)?;
    args.save_image(|| {
        let [width, height] = SIZE_PX;
        let mut both = RgbaImage::new(2 * width, height);
        for (context, x) in [(first, 0), (second, width)] {
            both.copy_from(&viewer.composite_mut().read_back(context)?, x, 0)?;
        }
        Ok(both)
    })
}

fn build(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let balls = (0..9).map(|i| {
        let hue = 0.7 * f64::from(i);
        let [r, g, b] = [0.0, 2.1, 4.2].map(|phase: f64| (0.5 + 0.5 * (hue + phase).cos()) as f32);
        let material = Material { base_color: [r, g, b, 1.0], ..Material::default() };
        let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 0.8, 32).into(), material);
        let center = DVec3::new(2.0 * f64::from(i) - 3.0, 0.0, 0.0);
        Node::transform(DAffine3::from_translation(center), vec![Node::geode(vec![ball])])
    });
    viewer.add_root(Page::from_node(Node::group(balls.collect())).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -9.0, 2.0), DVec3::ZERO, DVec3::Z);
    Ok(())
}
