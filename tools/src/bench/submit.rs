//! Measures the submission of a stage: the processor time of `Renderer::draw` per visible leaf on wgpu's noop adapter.
//! Prints one JSON object per line.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use glam::{DAffine3, DVec3};
use serde_json::json;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::draw::Renderer;
use terrane::gpu::{AdapterChoice, CompileBudget, CompileOperation, ContextTraits, GraphicsContext};
use terrane::math::Aabb;
use terrane::scene::{Drawable, Environment, Geometry, HeightTile, Material, Mesh, Node, Page, Scene};
use terrane::state::{Attribute, StateSet, SurfaceMaterial};

use super::cull::triangle;
use super::measurement::{percentile, print_line};

/// The content of the stage.
#[derive(Clone, Copy, PartialEq)]
enum Content {
    /// Height tiles, instances of one grid.
    Height,
    /// Meshes with separate vertices, under this number of state sets.
    Mesh(u32),
    /// Meshes that are so small that one draw call draws many of them, under this number of state sets.
    Small(u32),
}

/// Measures each case for about `seconds` and prints a line for it.
pub fn run(seconds: f64) -> Result<()> {
    let time = Duration::from_secs_f64(if seconds.is_finite() { seconds.clamp(0.0, 3600.0) } else { 1.0 });
    for leaves in [1_000, 10_000] {
        for content in [Content::Height, Content::Mesh(1), Content::Mesh(64), Content::Small(1), Content::Small(64)] {
            print_line(measure(content, leaves, time)?);
        }
    }
    Ok(())
}

fn height_tile() -> Drawable {
    let side = 9usize;
    let cell = |i: usize| (i as f64 - 4.0) as f32 * 0.1;
    let tile = HeightTile {
        side: side as u32,
        heights: vec![0.0; (side + 2) * (side + 2)],
        rows: (0..side).map(|j| [-cell(j), 0.0, 0.0, 1.0]).collect(),
        columns: (0..side).map(|i| [cell(i) * 1e-9, 0.0]).collect(),
        p0_m: 1e9,
        level: 0,
        coarser_errors_m: Vec::new(),
        skirt_m: 0.1,
        cell_m: [0.1, 0.1],
        texture: None,
        bounds: Aabb { min: DVec3::splat(-0.5), max: DVec3::splat(0.5) },
    };
    Drawable::new(Geometry::Height(Arc::new(tile)), Material::default())
}

fn measure(content: Content, leaves: u32, time: Duration) -> Result<serde_json::Value> {
    // Each leaf covers several pixels.
    let traits = ContextTraits { size_px: [2048, 2048], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
    let mut ctx = GraphicsContext::new_offscreen(&traits)?;
    let mut renderer = Renderer::new(&mut ctx);
    let sets = match content {
        Content::Height => 1,
        Content::Mesh(sets) | Content::Small(sets) => sets,
    };
    // Each state set has a different material, so the bindings change between them.
    let sets: Vec<_> = (0..sets)
        .map(|i| {
            let set = StateSet { color: Some([1.0, 0.5, 0.25, 1.0]), ..StateSet::default() };
            let material = SurfaceMaterial { shininess: i as f32, ..SurfaceMaterial::default() };
            Arc::new(if sets > 1 { set.with(Attribute::SurfaceMaterial(material)) } else { set })
        })
        .collect();
    let side = f64::from(leaves).sqrt().ceil();
    let nodes = (0..leaves)
        .map(|i| {
            let place = DVec3::new(f64::from(i) % side, (f64::from(i) / side).floor(), 0.0);
            let drawable = match content {
                Content::Height => height_tile(),
                Content::Mesh(_) => Drawable::new(Mesh::sphere(DVec3::ZERO, 0.4, 8).into(), Material::default()),
                Content::Small(_) => triangle(DVec3::ZERO),
            };
            let geode = Node::geode(vec![drawable]).with_state_set(sets[i as usize % sets.len()].clone());
            Node::transform(DAffine3::from_translation(place), vec![geode])
        })
        .collect();
    let mut page = Page::from_node(Node::group(nodes))?;
    ctx.compile(CompileOperation { ticket: 0, drawables: page.take_drawables() });
    ctx.run_compiles(&CompileBudget::UNLIMITED);
    for compiled in ctx.take_compiled() {
        page.set_draw_slots(0, compiled.slots);
    }
    let mut scene = Scene::new();
    scene.add_root(page);
    let center = DVec3::new(0.5 * side, 0.5 * side, 0.0);
    let view = glam::dcamera::rh::view::look_at_mat4(center + DVec3::new(0.0, 0.0, 1.2 * side), center, DVec3::Y);
    let camera = CullCamera { eye_from_world: DAffine3::from_mat4(view), ..CullCamera::default() };
    let mut stage = RenderStage::new();
    CullVisitor::new().cull(&scene, &camera, &mut stage);
    let environment = Environment::default();
    for _ in 0..5 {
        renderer.draw(&mut ctx, &stage, &environment)?;
    }
    let (mut total, mut drawn) = (Vec::new(), None);
    let end = Instant::now() + time;
    while Instant::now() < end || total.len() < 5 {
        let start = Instant::now();
        drawn = Some(renderer.draw(&mut ctx, &stage, &environment)?);
        total.push(start.elapsed().as_secs_f64());
    }
    let drawn = drawn.unwrap_or_default();
    let median = percentile(&mut total, 0.5);
    let round = |v: f64| (v * 10.0).round() / 10.0;
    Ok(json!({
        "bench": "terrane_submit", "n": leaves,
        "content": match content {
            Content::Height => "height",
            Content::Mesh(_) => "mesh",
            Content::Small(_) => "small mesh",
        },
        "statesets": sets.len(),
        "leaves": drawn.leaves, "draw_calls": drawn.draw_calls, "state_changes": drawn.state_changes,
        "iters": total.len(), "total_us": round(median * 1e6),
        "ns_per_leaf": round(median * 1e9 / f64::from(drawn.leaves.max(1))),
        "p95_us": round(percentile(&mut total, 0.95) * 1e6),
    }))
}
