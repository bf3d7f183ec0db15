//! Render bins: glass is sorted back to front after everything opaque, and an outline is drawn last, over everything.
//!
//! ```text
//! cargo run --release --example transparency_and_bins -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: seven panes of glass in a ring around a white ball, the nearer tinting the farther, and an orange frame
//! around the ball that shows through all of them.

mod shared;

use std::sync::Arc;

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::scene::{AlphaMode, Drawable, Material, Mesh, Node, Page};
use terrane::state::{BinDetails, Mode, SortMode, StateSet, StateValue};
use terrane::viewer::{Viewer, WindowOptions};

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 1.2, 48).into(), Material::default());
    // Blended materials go to the transparent bin (number 10, sorted back to front) automatically.
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
    // Bin 20 is drawn after bin 10; without the depth test its lines cover everything.
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
