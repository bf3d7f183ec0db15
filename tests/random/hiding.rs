//! Random scenes: leaves that are culled by occluders or queries would not be visible. Needs a GPU; a software adapter
//! suffices. `RANDOM_SCENES=FIRST..END` draws those seeds.

use std::sync::Arc;

use crate::graphs::{Differences, Maker, eye, picture, seeds};
use glam::DVec3;
use kit::rig::{camera, new_rig, plain};
use terrane::cull::CullCamera;
use terrane::scene::{
    ConvexPlanarOccluder, CullingMode, Drawable, Geometry, Material, Mesh, Node, NodeKind, OcclusionQueryNode,
};

const SIDE: u32 = 96;

/// Returns a wall at a random position that hides leaves, and its occluder.
fn wall(maker: &mut Maker) -> [Node; 2] {
    let [along, up] = [0; 2].map(|_| eye(&mut maker.random) * 0.2);
    let corners = [along + up, up - along, -along - up, along - up].to_vec();
    let mesh = Mesh::rectangle(-along - up, 2.0 * along, 2.0 * up);
    let material =
        Material { base_color: [0.4, 0.3, 0.2, 1.0], double_sided: true, unlit: true, ..Material::default() };
    let place = maker.random.place(8.0);
    let occluder = Node::new(NodeKind::OccluderNode(Box::new(ConvexPlanarOccluder { corners, holes: vec![] })));
    let drawn = Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), material)]);
    [drawn, occluder].map(|node| Node::transform(place, vec![node]))
}

#[test]
fn leaves_hidden_by_occluders_are_not_visible() {
    let Some(mut rig) = new_rig([256, 256]) else { return };
    let rig = &mut rig;
    let (mut differences, mut hidden) = (Differences::default(), 0);
    for seed in seeds(6000, 2) {
        let mut maker = Maker::new(seed, true);
        let scene = maker.scene();
        let mut camera = camera([SIDE, SIDE], eye(&mut maker.random), DVec3::ZERO, DVec3::Z);
        camera.settings.culling = CullingMode::VIEW_FRUSTUM | CullingMode::SHADOW_OCCLUSION;
        let walls: Vec<[Node; 2]> = (0..3).map(|_| wall(&mut maker)).collect();
        let drawn = walls.iter().map(|[drawn, _]| drawn.clone()).chain([scene]).collect::<Vec<_>>();
        let whole = picture(rig, &Node::group(drawn.clone()), &camera, &plain());
        let leaves = rig.stage.leaf_count();
        let occluders = walls.into_iter().map(|[_, occluder]| occluder).chain(drawn).collect();
        let other = picture(rig, &Node::group(occluders), &camera, &plain());
        hidden += leaves - rig.stage.leaf_count();
        differences.compare("behind occluders", seed, [&whole, &other], 12);
    }
    differences.assert_none();
    assert!(hidden > 0, "nothing was hidden");
}

/// Returns the same graph with queries above some of its nodes.
fn queried(node: &Node, maker: &mut Maker) -> Node {
    let copy = Node { children: node.children.iter().map(|child| queried(child, maker)).collect(), ..node.clone() };
    if !maker.random.percent(40) {
        return copy;
    }
    let query = OcclusionQueryNode { query_frames: 1, failures_to_hide: 1, ..OcclusionQueryNode::default() };
    Node { children: vec![copy], ..Node::new(NodeKind::OcclusionQueryNode(Box::new(query))) }
}

#[test]
fn leaves_hidden_by_queries_are_not_visible() {
    let Some(mut rig) = new_rig([256, 256]) else { return };
    let rig = &mut rig;
    let (mut differences, mut hidden) = (Differences::default(), 0);
    for seed in seeds(7000, 2) {
        let mut maker = Maker::new(seed, true);
        let node = maker.scene();
        let camera = camera([SIDE, SIDE], eye(&mut maker.random), DVec3::ZERO, DVec3::Z);
        let whole = picture(rig, &node, &camera, &plain());
        let leaves = rig.stage.leaf_count();
        let scene = rig.scene(queried(&node, &mut maker));
        for frame in 1..12 {
            rig.draw(&scene, &CullCamera { frame, ..camera }, &plain());
        }
        let other = rig.picture(&scene, &CullCamera { frame: 12, ..camera }, &plain());
        hidden += leaves - rig.stage.leaf_count();
        rig.release(scene);
        differences.compare("below queries", seed, [&whole, &other], 8);
    }
    differences.assert_none();
    assert!(hidden > 0, "nothing was hidden");
}
