//! Proxy nodes: the application's graph refers to tile sets that are loaded when they first become visible.
//!
//! ```text
//! cargo run --release --example proxy_node -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: nine orange houses (one tile set nine times, each turned a little more) without any ground.

mod shared;

use std::{fs, sync::Arc};

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::math::BoundingSphere;
use terrane::scene::{Node, NodeKind, Page, ProxyLoading, ProxyNode};
use terrane::viewer::{Viewer, WindowOptions};

const TILESET: &str = r#"{ "asset": { "version": "1.1" }, "geometricError": 10, "root": {
    "boundingVolume": { "box": [0, 0, 3, 4, 0, 0, 0, 4, 0, 0, 0, 3] }, "geometricError": 0, "refine": "REPLACE",
    "content": { "uri": "house.glb" } } }"#;

fn main() -> Result<()> {
    let folder = std::env::temp_dir().join("terrane-proxy-node");
    fs::create_dir_all(&folder)?;
    fs::write(folder.join("house.glb"), write_glb(&house()))?;
    let tileset = folder.join("tileset.json").display().to_string();
    fs::write(&tileset, TILESET)?;

    let build = move |viewer: &mut Viewer| {
        viewer.page_files_in(&folder)?;
        let proxies = (0..9).map(|i| {
            let corner = DVec3::new(f64::from(i % 3) * 14.0, f64::from(i / 3) * 14.0, 0.0);
            Node::new(NodeKind::ProxyNode(Box::new(ProxyNode {
                uri: Arc::from(tileset.as_str()),
                bounds: BoundingSphere::new(corner + DVec3::Z * 3.0, 7.0),
                content_transform: DAffine3::from_translation(corner) * DAffine3::from_rotation_z(0.2 * f64::from(i)),
                loading: ProxyLoading::DeferToPager,
            })))
        });
        let page = Page::from_node(Node::group(proxies.collect())).expect("groups and ProxyNodes can be culled");
        viewer.add_root(page)?;
        Ok(())
    };
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

/// Four walls and a roof, in glTF's axes: y up.
fn house() -> GlbMesh {
    let outline = [[-4.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 6.0], [-4.0, 4.0]];
    let positions = [-4.0, 4.0].iter().flat_map(|z| outline.map(|[x, y]| [x, y, *z])).collect();
    let mut indices = vec![0, 2, 1, 0, 4, 2, 4, 3, 2, 5, 6, 7, 5, 7, 9, 9, 7, 8];
    for i in 0..5 {
        let next = (i + 1) % 5;
        indices.extend([i, next, next + 5, i, next + 5, i + 5]);
    }
    let base_color = [0.9, 0.35, 0.08, 1.0];
    GlbMesh { positions, indices, base_color, ..GlbMesh::default() }
}
