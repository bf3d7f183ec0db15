//! Paged levels of detail without a tile set: balls in a row, each in three files that are paged by distance.
//!
//! ```text
//! cargo run --release --example paged_lod -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a row of balls that leads away: near ones round and red, then coarser and yellow, far ones angular and blue.

mod shared;

use std::f32::consts::{PI, TAU};
use std::{fs, path::Path, sync::Arc};

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::scene::{Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine};
use terrane::viewer::{Viewer, WindowOptions};

/// File, segments, colour, and the distance in metres below which the next finer file replaces it.
const LEVELS: [(&str, u16, [f32; 4], f64); 3] = [
    ("coarse.glb", 5, [0.1, 0.25, 0.9, 1.0], 45.0),
    ("medium.glb", 10, [0.9, 0.7, 0.1, 1.0], 22.0),
    ("fine.glb", 48, [0.8, 0.1, 0.08, 1.0], 0.0),
];

fn main() -> Result<()> {
    let folder = std::env::temp_dir().join("terrane-paged-lod");
    fs::create_dir_all(&folder)?;
    for (file, segments, color, _) in LEVELS {
        fs::write(folder.join(file), write_glb(&ball(segments, color)))?;
    }
    let build = move |viewer: &mut Viewer| {
        viewer.page_files_in(&folder)?;
        let balls = (0..12).map(|i| tile(&folder, 0, DVec3::new(f64::from(i % 3 - 1) * 5.0, 8.0 * f64::from(i), 0.0)));
        let page = Page::from_node(Node::group(balls.collect())).expect("groups and PagedLods can be culled");
        viewer.add_root(page)?;
        viewer.view_mut().camera.look_at(DVec3::new(-3.0, -14.0, 9.0), DVec3::new(0.0, 20.0, 0.0), DVec3::Z);
        Ok(())
    };
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

/// Returns a ball at a level, with the next finer level as its child.
fn tile(folder: &Path, level: usize, center: DVec3) -> Node {
    let (file, _, _, range_m) = LEVELS[level];
    let children = if level + 1 < LEVELS.len() { vec![tile(folder, level + 1, center)] } else { Vec::new() };
    let lod = PagedLod {
        bounds: BoundingVolume::Sphere(BoundingSphere::new(center, 2.0)),
        range_mode: RangeMode::Distance { center, range_m },
        refine: Refine::Replace,
        content: Some(Arc::from(folder.join(file).display().to_string())),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    };
    Node { children, ..Node::new(NodeKind::PagedLod(Box::new(lod))) }
}

fn ball(segments: u16, base_color: [f32; 4]) -> GlbMesh {
    let (mut positions, mut normals, mut indices, row) = (vec![], vec![], vec![], segments + 1);
    for (i, j) in (0..row * row).map(|k| (k % row, k / row)) {
        let (t, p) = (PI * f32::from(j) / f32::from(segments), TAU * f32::from(i) / f32::from(segments));
        let normal = [t.sin() * p.sin(), t.cos(), t.sin() * p.cos()];
        normals.push(normal);
        positions.push(normal.map(|n| 2.0 * n));
        if i < segments && j < segments {
            indices.extend([0, row, row + 1, 0, row + 1, 1].map(|corner| j * row + i + corner));
        }
    }
    GlbMesh { positions, normals, indices, base_color, ..GlbMesh::default() }
}
