//! Levels of detail of tile trees: fades between them, stand-ins for failed tiles, and normal maps of generated ones.

use std::sync::Arc;

use kit::rig::Rig;
use kit::shapes::mesh;
use terrane::scene::{Drawable, Geometry, Material, MeshVertex, Node, NodeId, Page, PageId, Scene};

mod fade;
mod normal_maps;
mod stand_ins;

/// Uploads a content and attaches it to a slot.
fn attach(rig: &mut Rig, scene: &mut Scene, slot: NodeId, content: Node) -> PageId {
    let mut page = Page::from_node(content).unwrap();
    let compiled = rig.compile(page.take_drawables());
    assert!(compiled.errors.is_empty(), "{:?}", compiled.errors);
    page.set_draw_slots(0, compiled.slots);
    scene.attach(slot, page).unwrap()
}

fn detach(rig: &mut Rig, scene: &mut Scene, page: PageId) {
    for (_, slots) in scene.detach(page).unwrap().take_draw_slots() {
        rig.ctx.release(&slots);
    }
}

/// Returns a square with too many triangles for vertex pulling.
fn large([x, y, z]: [f32; 3], half: f32, material: Material) -> Drawable {
    let n = 6u32;
    let at = |i: u32| half * (2.0 * i as f32 / n as f32 - 1.0);
    let vertex = |k: u32| MeshVertex {
        position: [x + at(k % (n + 1)), y + at(k / (n + 1)), z],
        normal: [0, 0, 127, 0],
        color: [255; 4],
        ..MeshVertex::default()
    };
    let corners = |c: u32| [0, 1, n + 2, 0, n + 2, n + 1].map(|k| c / n * (n + 1) + c % n + k);
    let indices = (0..n * n).flat_map(corners).collect();
    Drawable::new(Geometry::Mesh(Arc::new(mesh((0..(n + 1) * (n + 1)).map(vertex).collect(), indices))), material)
}
