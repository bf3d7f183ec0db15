//! Measures the traversal of a tile tree: a quadtree of `levels` levels, refined everywhere or seen from a low eye.
//!
//! Needs no GPU. Prints one JSON object per line. `ns_per_tile` is the time of the whole cull, `walk_ns_per_tile` that of
//! the traversal without visits of visible content.

use std::time::{Duration, Instant};

use glam::{DAffine3, DMat3, DVec3};
use serde_json::json;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::{Aabb, BoundingVolume, OrientedBox};
use terrane::scene::{
    DrawSlot, Drawable, Geometry, Material, Mesh, Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine,
    Scene, SceneError, Topology,
};

use super::measurement::{percentile, print_line};

/// Half the side of the terrain in metres.
const HALF_M: f64 = 20_000.0;

/// The share of the tiles' contents that is loaded.
#[derive(Clone, Copy, PartialEq)]
enum Content {
    /// All contents are loaded, and tiles are drawn.
    All,
    /// One in sixteen tiles of the last level is missing.
    Most,
    /// No content is loaded, and every tile is requested.
    None,
}

/// Measures each case for about `seconds` and prints a line for it.
pub fn run(seconds: f64) {
    let time = Duration::from_secs_f64(if seconds.is_finite() { seconds.clamp(0.0, 3600.0) } else { 1.0 });
    for levels in [6, 8, 10] {
        for content in [Content::All, Content::Most, Content::None] {
            match scene(levels, content) {
                Ok(scene) => {
                    for view in ["above", "low"] {
                        print_line(measure(&scene, levels, content, view, time));
                    }
                }
                Err(error) => print_line(json!({"bench": "terrane_tiles", "error": error.to_string()})),
            }
        }
    }
}

fn quad(levels: u32, center: DVec3, half_m: f64, error_m: f64) -> Node {
    let half_axes = DMat3::from_diagonal(DVec3::new(half_m, half_m, 1.0));
    let mut node = Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        bounds: BoundingVolume::Box(OrientedBox { center, half_axes }),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m: if levels <= 1 { 0.0 } else { error_m } },
        refine: Refine::Replace,
        content: Some("tile".into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    })));
    if levels > 1 {
        let corners = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)];
        let child = |(x, y)| quad(levels - 1, center + DVec3::new(x, y, 0.0) * half_m, 0.5 * half_m, 0.5 * error_m);
        node.children = corners.map(child).to_vec();
    }
    node
}

/// Returns the content of a tile: a drawable without vertices with a draw slot, as if it were uploaded.
fn content(slot: u32) -> Result<Page, SceneError> {
    let bounds = Aabb { min: DVec3::splat(-50.0), max: DVec3::splat(50.0) };
    let mesh =
        Mesh { vertices: Vec::new(), indices: [].into(), topology: Topology::Triangles, bounds, ..Mesh::default() };
    let drawable = Drawable::new(Geometry::Mesh(mesh.into()), Material::default());
    let mut page = Page::from_node(Node::geode(vec![drawable]))?;
    page.take_drawables();
    page.set_draw_slots(0, vec![DrawSlot(slot)]);
    Ok(page)
}

fn scene(levels: u32, loaded: Content) -> anyhow::Result<Scene> {
    let mut scene = Scene::new();
    let root = scene.add_root(Page::from_node(quad(levels, DVec3::ZERO, HALF_M, 2_000.0))?);
    if loaded == Content::None {
        return Ok(scene);
    }
    let slots: Vec<_> = scene.slots_of_page(root).collect();
    for (slot, place) in slots.into_iter().zip(0..) {
        let is_last = scene.slot(slot).is_some_and(|s| s.depth + 1 == levels);
        if loaded == Content::All || !is_last || place % 16 != 0 {
            scene.attach(slot, content(place)?).map_err(|_| anyhow::anyhow!("the slot is occupied"))?;
        }
    }
    Ok(scene)
}

fn camera(view: &str) -> CullCamera {
    let (eye, error_px) = match view {
        "above" => (DVec3::new(0.0, -10.0, 42_000.0), 1e-6),
        _ => (DVec3::new(0.0, -12_000.0, 1_500.0), 1.0),
    };
    let mut camera = CullCamera {
        eye_from_world: DAffine3::from_mat4(glam::dcamera::rh::view::look_at_mat4(eye, DVec3::ZERO, DVec3::Z)),
        ..CullCamera::default()
    };
    camera.settings.max_sse_px = error_px;
    camera
}

fn measure(scene: &Scene, levels: u32, content: Content, view: &str, time: Duration) -> serde_json::Value {
    let mut camera = camera(view);
    let mut stage = RenderStage::new();
    let mut medians = [CullVisitor::new(), CullVisitor::walking_tiles()].map(|mut visitor| {
        for _ in 0..3 {
            visitor.traverse(scene, &camera, &mut stage);
        }
        let mut seconds = Vec::new();
        let end = Instant::now() + time;
        while Instant::now() < end || seconds.len() < 5 {
            camera.frame += 1;
            camera.simulation_time_s += 1.0 / 60.0;
            let start = Instant::now();
            visitor.traverse(scene, &camera, &mut stage);
            seconds.push(start.elapsed().as_secs_f64());
        }
        let counters = stage.counters;
        (percentile(&mut seconds, 0.5), counters)
    });
    let [(whole, counters), (walk, _)] = &mut medians;
    let per_tile = |seconds: f64| (seconds * 1e11 / f64::from(counters.tiles_visited.max(1))).round() / 100.0;
    json!({
        "bench": "terrane_tiles", "levels": levels, "view": view,
        "content": match content {
            Content::All => "all",
            Content::Most => "most",
            Content::None => "none",
        },
        "tiles_visited": counters.tiles_visited, "tiles_drawn": counters.tiles_drawn,
        "wanted_missing": counters.wanted_missing, "ns_per_tile": per_tile(*whole),
        "walk_ns_per_tile": per_tile(*walk),
    })
}
