//! Pipelines for a change of views are created before the frame that shows it.

use std::sync::Arc;

use glam::DVec3;
use kit::rig::{Rig, camera, new_rig, plain};
use kit::shadows::small_maps;
use kit::shapes::{ball, quad};
use terrane::draw::ViewChange;
use terrane::scene::{
    AlphaMode, DistanceFog, Drawable, Environment, Geometry, LightSource, Material, Mesh, Node, NodeKind,
    ReferenceFrame, Sky, Water,
};
use terrane::state::{Attribute, Light, Mode, StateSet, StateValue, Stencil, SurfaceMaterial};

/// Returns drawables of several kinds: plain, masked, blended, small and large ones, and one with a material.
fn kinds() -> Vec<Node> {
    let sphere = |alpha, x: f64| {
        let mesh = Mesh::sphere(DVec3::new(x, 0.0, 0.0), 0.8, 24);
        Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material { alpha, ..Material::default() })])
    };
    let mut small = quad([0.0, 2.0, 0.0], [0.5; 2], [1.0; 4]);
    small.material.unlit = false;
    let material = StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial::default()));
    vec![
        sphere(AlphaMode::Opaque, -2.0),
        sphere(AlphaMode::Mask(0.5), 0.0),
        Node::geode(vec![small]),
        ball(DVec3::new(2.0, 0.0, 0.0), 0.7, [1.0; 4]).with_state_set(Arc::new(material)),
    ]
}

fn seen() -> terrane::cull::CullCamera {
    camera([64; 2], DVec3::new(0.0, -1.0, 9.0), DVec3::ZERO, DVec3::Y)
}

fn light() -> Node {
    let source = LightSource { light: Light::default(), frame: ReferenceFrame::Relative };
    let mut nodes = kinds();
    nodes.push(Node::new(NodeKind::LightSource(Box::new(source))));
    Node::group(nodes)
}

/// Draws the kinds in a plain view, then after a change. Returns how many pipelines the first frame after the change
/// creates.
fn created_by(change: &ViewChange, after: impl Fn() -> Node, prewarms: bool) -> Option<u32> {
    let mut rig: Rig = new_rig([64; 2])?;
    let before = rig.scene(Node::group(kinds()));
    rig.draw(&before, &seen(), &plain());
    assert_eq!(rig.draw(&before, &seen(), &plain()).pipelines_created, 0);
    if prewarms {
        rig.renderer.prewarm_change(&mut rig.ctx, change);
    }
    let after = rig.scene(after());
    let stats = rig.draw(&after, &seen(), &change.environment);
    let again = rig.draw(&after, &seen(), &change.environment);
    assert!(rig.renderer.take_errors().is_empty());
    assert_eq!(again.pipelines_created, 0);
    Some(stats.pipelines_created)
}

/// Regression: pipelines were prewarmed for the targets, air, lights and shadows of the last frame alone.
#[test]
fn change_that_was_announced_creates_no_pipeline_in_its_frame() {
    let same = ViewChange { environment: plain(), has_own_light: false, uses_stencil: false };
    let group = || Node::group(kinds());
    let haze = Environment { fog: DistanceFog { enabled: true, density_per_m: 0.001 }, ..plain() };
    let sky = Environment { sky: Sky::Atmosphere, water: Some(Water::at(-100.0)), ..plain() };
    let shadows = Environment { shadows: small_maps(), sun_direction: DVec3::Z, ..plain() };
    let both = Environment { shadows: small_maps(), sun_direction: DVec3::Z, ..haze };
    let stencil = || {
        let set = StateSet::default()
            .with(Attribute::Stencil(Stencil::default()))
            .with_mode(Mode::StencilTest, StateValue::ON);
        let mut nodes = kinds();
        nodes.push(Node::geode(vec![quad([0.0; 3], [0.1; 2], [1.0; 4])]).with_state_set(Arc::new(set)));
        Node::group(nodes)
    };
    let of = |environment| ViewChange { environment, ..same };
    let with_stencil = ViewChange { uses_stencil: true, ..same };
    let with_light = ViewChange { has_own_light: true, ..same };
    let changes: [(&str, ViewChange, &dyn Fn() -> Node); 6] = [
        ("haze", of(haze), &group),
        ("sky and water", of(sky), &group),
        ("shadows", of(shadows), &group),
        ("haze and shadows", of(both), &group),
        ("light 0", with_light, &light),
        ("stencil", with_stencil, &stencil),
    ];
    for (name, change, after) in changes {
        let Some(without) = created_by(&change, after, false) else { return };
        let Some(with) = created_by(&change, after, true) else { return };
        println!("{name}: {without} pipelines without prewarming, {with} with it");
        // The drawable with the stencil is new.
        let new = u32::from(name == "stencil");
        assert!(without > new, "{name}: {without}");
        assert_eq!(with, new, "{name}");
    }
}
