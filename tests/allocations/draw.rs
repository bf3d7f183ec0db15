//! A steady frame allocates nothing in draw's own code. The noop adapter draws.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::rig::{Rig, camera, noop_traits};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::cull::{CullVisitor, RenderStage};
use terrane::gpu::GraphicsContext;
use terrane::scene::{
    AttributeFormat, Environment, Geometry, LocalLights, Mesh, Node, NodeKind, OcclusionQueryNode, SunShadows,
};
use terrane::state::{BinDetails, Light, SortMode, StateSet};

use crate::attribution::allocations;

#[test]
fn steady_draw_allocates_nothing() {
    let mut rig = Rig::new(GraphicsContext::new_offscreen(&noop_traits([64, 64])).unwrap());
    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 2600.0, root_error_m: 250.0, textured: true };
    let mut nodes: Vec<Node> = (0..16).map(|i| terrain.tile(2, i % 4, i / 4)).collect();
    // The scene has meshes under state sets of three bins near the terrain's middle, some of them blended.
    let up = terrain.world(0.5, 0.5, 1_000.0);
    nodes.extend((0..200u32).map(|i| {
        let bin = Some(BinDetails::new(i as i32 % 3 - 1, SortMode::ByState));
        let set = StateSet { bin, color: Some([1.0, 0.5, 0.2, 1.0]), ..StateSet::default() };
        let offset = up + 100.0 * DVec3::new(f64::from(i % 20), f64::from(i / 20), 0.0);
        let alpha = if i % 7 == 0 { 0.5 } else { 1.0 };
        let mut drawable = quad([0.0; 3], [20.0 + (i % 5) as f32, 20.0], [1.0, 1.0, 1.0, alpha]);
        if let (0, Geometry::Mesh(mesh)) = (i % 3, &mut drawable.geometry) {
            let plain = Mesh::clone(mesh);
            *mesh = Arc::new(plain.with_attribute("heat", AttributeFormat::Float32, &[0.5f32; 4]).unwrap());
        }
        let geode = Node::geode(vec![drawable]);
        let geode = match i % 10 {
            0 => {
                let lights = LocalLights { lights: vec![Light::default(); 3] };
                Node { children: vec![geode], ..Node::new(NodeKind::LocalLights(lights)) }
            }
            _ => geode,
        };
        Node::transform(DAffine3::from_translation(offset), vec![geode]).with_state_set(Arc::new(set))
    }));
    nodes.extend((0..8u32).map(|i| {
        let query = OcclusionQueryNode { query_frames: 1, ..OcclusionQueryNode::default() };
        let place = DAffine3::from_translation(up + DVec3::new(300.0 * f64::from(i), 0.0, 500.0));
        let below = Node::geode(vec![quad([0.0; 3], [2_000.0, 2_000.0], [1.0; 4])]);
        let mut asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        asked.children = vec![below];
        Node::transform(place, vec![asked])
    }));
    let scene = rig.scene(Node::group(nodes));
    let environment = Environment { shadows: Some(SunShadows::default()), ..Environment::default() };
    let (mut leaves, mut number) = (0, 0);
    let mut fly = |rig: &mut Rig, frames: std::ops::Range<u32>| {
        for frame in frames {
            let angle = f64::from(frame) * 0.3;
            let eye = terrain.world(0.5 + 0.2 * angle.cos(), 0.5 + 0.2 * angle.sin(), 20_000.0);
            let mut view = camera([64, 64], eye, terrain.world(0.5, 0.5, 0.0), DVec3::Z);
            number += 1;
            view.frame = number;
            leaves += rig.draw(&scene, &view, &environment).leaves;
        }
    };
    for _ in 0..3 {
        fly(&mut rig, 0..20);
    }
    // Only two frames are recorded, because resolving the names of a call stack takes milliseconds.
    let (own, wgpu) = allocations(|| fly(&mut rig, 7..9));
    eprintln!("wgpu itself allocated {} times a frame", wgpu / 2);
    assert!(wgpu > 0, "the call stacks have no names: are there symbols?");
    assert!(own.is_empty(), "{} allocations, the first:\n{}", own.len(), own[0]);
    assert!(leaves > 1_000);
    assert_eq!(rig.stage.queries.len(), 8);
    assert_eq!((rig.stage.light_groups.len(), rig.stage.local_lights.len()), (20, 60));
    assert_eq!(rig.stage.shadows.cascades.len(), 4);
    assert!(rig.stage.counters.shadow_leaves > 100);
    let (own, _) = allocations(|| drop((CullVisitor::new(), Box::new(RenderStage::new()))));
    assert!(!own.is_empty(), "the allocation of a box is counted");
}
