//! Render bins: glass sorted back to front after everything opaque, and a mark that is drawn last, over all.
//!
//! ```text
//! cargo run --release --example transparency_and_bins -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: seven panes of glass in a ring around a white ball, the nearer tinting the farther, and an orange frame
//! around the ball that shows through all of them.

use std::sync::Arc;

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::scene::{AlphaMode, Drawable, Material, Mesh, Node, Page};
use terrane::state::{BinDetails, Mode, SortMode, StateSet, StateValue};
use terrane::viewer::{Viewer, ViewerConfig, WindowOptions, has_display, run_window};

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(30), |n| n.parse())?;
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let options = WindowOptions { on_open: Box::new(build), ..WindowOptions::default() };
        return Ok(run_window(ViewerConfig::default(), options).map(drop)?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
    build(&mut viewer)?;
    for _ in 0..frames {
        viewer.frame()?;
    }
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 1.2, 48).into(), Material::default());
    // Materials that blend go to the transparent bin (number 10, back to front) by themselves.
    let panes = (0..7).map(|i| {
        let hue = f64::from(i) / 7.0 * std::f64::consts::TAU;
        let [r, g, b] = [0.0, 2.1, 4.2].map(|phase: f64| (0.5 + 0.5 * (hue + phase).cos()) as f32);
        let glass = Material {
            base_color: [r, g, b, 0.45],
            alpha: AlphaMode::Blend,
            double_sided: true,
            unlit: true,
            ..Material::default()
        };
        let pane = Mesh::rectangle(DVec3::new(-1.1, 3.0, -1.5), DVec3::new(2.2, 0.0, 0.0), DVec3::new(0.0, 0.0, 3.0));
        Node::transform(DAffine3::from_rotation_z(hue), vec![Node::geode(vec![Drawable::new(pane.into(), glass)])])
    });
    // Bin 20 comes after 10; without the depth test its lines are over everything.
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let outline = Mesh::polyline(&corners.map(|(x, z)| DVec3::new(1.5 * x, 0.0, 1.5 * z)));
    let orange = Material { base_color: [1.0, 0.35, 0.0, 1.0], unlit: true, ..Material::default() };
    let last = StateSet {
        bin: Some(BinDetails::new(20, SortMode::ByState)),
        ..StateSet::default().with_mode(Mode::DepthTest, StateValue::OFF)
    };
    let mark = Node::geode(vec![Drawable::new(outline.into(), orange)]).with_state_set(Arc::new(last));
    let all = [Node::geode(vec![ball]), mark].into_iter().chain(panes).collect();
    viewer.add_root(Page::from_node(Node::group(all)).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::new(4.0, -9.0, 4.5), DVec3::ZERO, DVec3::Z);
    Ok(())
}
