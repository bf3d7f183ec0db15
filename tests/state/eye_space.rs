//! Lights and clip planes as attributes of state sets, which move with the eye; a default light is a headlight. Programs get the
//! position of the eye in the world.

use std::sync::Arc;

use crate::lighting::*;
use glam::{DAffine3, DVec3};
use kit::frames::count;
use kit::rig::{Rig, camera, plain, rig};
use terrane::cull::CullCamera;
use terrane::scene::{Drawable, Geometry, Material, Mesh, Node};
use terrane::state::{Attribute, Light, Mode, Program, StateSet, StateValue};

/// Returns a state with one light, of number 0, in place of the sun.
fn lit_by(light: Light) -> StateSet {
    StateSet::default().with(Attribute::Light(light))
}

#[test]
fn headlight_shines_from_every_eye() {
    let Some(mut rig) = rig("headlight_shines_from_every_eye") else { return };
    let rig = &mut *rig;
    let ball = Mesh::sphere(DVec3::ZERO, 1.0, 32);
    let ball = Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(ball)), Material::default())]);
    let mut middle_from = |set: &StateSet, eye: DVec3| {
        // The state set of the camera holds for the whole scene.
        rig.visitor.state_set = Some(Arc::new(set.clone()));
        let scene = rig.scene(Node::transform(DAffine3::from_rotation_z(0.7), vec![ball.clone()]));
        let view = camera([SIDE; 2], eye, DVec3::ZERO, DVec3::Z);
        let picture = rig.picture(&scene, &view, &plain());
        rig.visitor.state_set = None;
        rig.release(scene);
        kit::frames::pixel(&picture, SIDE / 2, SIDE / 2)
    };
    let headlight = lit_by(Light::default());
    for eye in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::new(1.0, -2.0, 3.0)] {
        let [r, g, b] = middle_from(&headlight, 4.0 * eye.normalize());
        assert!(r > 250 && g > 250 && b > 250, "from {eye}: {r} {g} {b}");
    }
    let from_the_left = lit_by(Light { position: [-1.0, 0.0, 0.0, 0.0], ..Light::default() });
    assert!(middle_from(&from_the_left, DVec3::X * 4.0)[0] < 30, "across the view");
}

#[test]
fn lights_of_state_sets_hold_below_them() {
    let Some(mut rig) = rig("lights_of_state_sets_hold_below_them") else { return };
    let rig = &mut *rig;
    let colored = |number, diffuse| Light { number, diffuse, ..Light::default() };
    let of =
        |light: Light| StateSet::default().with_mode(Mode::Light(0), StateValue::OFF).with(Attribute::Light(light));
    // A LightSource of the same number elsewhere in the graph shines on others.
    let source = light(colored(1, [1.0, 0.0, 0.0]));
    let white = |set: StateSet| node(square(WHITE), set);
    assert_near(middle(rig, vec![source.clone(), white(only_light_1())]), [1.0, 0.0, 0.0], "the LightSource");
    let blue = of(colored(1, [0.0, 0.0, 1.0]));
    assert_near(middle(rig, vec![source.clone(), white(blue.clone())]), [0.0, 0.0, 1.0], "the state set's");
    let nested = Node::group(vec![white(of(colored(1, [0.0, 1.0, 0.0])))]).with_state_set(Arc::new(blue.clone()));
    assert_near(middle(rig, vec![nested]), [0.0, 1.0, 0.0], "the innermost one");
    let both = Node::group(vec![white(of(colored(2, [0.0, 1.0, 0.0])))]).with_state_set(Arc::new(blue));
    assert_near(middle(rig, vec![both]), [0.0, 1.0, 1.0], "lights of two numbers");
    let mut reported = |set: StateSet| {
        let scene = rig.scene(white(set));
        let picture = rig.picture(&scene, &kit::rig::unit_camera(SIDE), &plain());
        rig.release(scene);
        (kit::frames::pixel(&picture, SIDE / 2, SIDE / 2), rig.renderer.take_errors())
    };
    let (dark, errors) = reported(of(Light { position: [0.0; 4], ..colored(3, [1.0; 3]) }));
    assert_near(dark, [0.0; 3], "invalid");
    assert!(matches!(&errors[..], [e] if e.contains("a light of a state set: light 3")), "{errors:?}");
    let (_, errors) = reported(StateSet::default().with(Attribute::Light(colored(8, [1.0; 3]))));
    assert!(errors.iter().any(|e| e.contains("light 8 is out of range")), "{errors:?}");
}

#[test]
fn clip_planes_of_state_sets_move_with_the_eye() {
    let Some(mut rig) = rig("clip_planes_of_state_sets_move_with_the_eye") else { return };
    let rig = &mut *rig;
    let red = |rig: &mut Rig, plane: [f64; 4], view: &CullCamera| {
        let set = unlit().with(Attribute::ClipPlane(2, plane));
        let scene = rig.scene(Node::group(vec![node(square([1.0, 0.0, 0.0, 1.0]), set)]));
        let picture = rig.picture(&scene, view, &plain());
        rig.release(scene);
        count(&picture, RED)
    };
    let view = kit::rig::unit_camera(SIDE);
    // The square is 32 pixels wide; x >= 0.25 leaves a quarter.
    assert_eq!(red(rig, [1.0, 0.0, 0.0, -0.25], &view), 8 * 32);
    let moved = CullCamera {
        eye_from_world: DAffine3::from_translation(DVec3::new(0.25, 0.0, 0.0)) * view.eye_from_world,
        ..view
    };
    assert_eq!(red(rig, [1.0, 0.0, 0.0, -0.25], &moved), 16 * 32, "the square has moved, the plane has not");
    assert_eq!(red(rig, [0.0, 0.0, 1.0, 5.0], &view), 0, "10 m in front of the eye is beyond z = -5");
}

#[test]
fn programs_know_positions_on_the_globe_to_a_millimetre() {
    let Some(mut rig) = rig("programs_know_positions_on_the_globe_to_a_millimetre") else { return };
    let rig = &mut *rig;
    // The colours are decimetres of world coordinates, which repeat.
    let program = Program::new(
        "decimetres",
        "struct Uniforms { terrane_EyeLow: vec3<f32>, terrane_WorldFromEye: mat3x3<f32>, terrane_EyeHigh: vec3<f32> }
        @group(2) @binding(0) var<uniform> uniforms: Uniforms;
        struct V { @builtin(position) clip: vec4<f32>, @location(0) in_eye: vec3<f32> }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {
            let at = point_in_eye(leaves[i], vertex.position);
            return V(frame.clip_from_eye * vec4<f32>(at, 1.0), at);
        }
        @fragment fn fs_main(v: V) -> @location(0) vec4<f32> {
            let near = uniforms.terrane_EyeLow + uniforms.terrane_WorldFromEye * v.in_eye;
            return vec4<f32>(fract(10.0 * (fract(uniforms.terrane_EyeHigh) + near)), 1.0);
        }",
    );
    let site = DVec3::new(3_912_345.637, -1_234_567.142, 4_867_890.351);
    let set = Arc::new(StateSet::default().with(Attribute::Program(program)));
    let geode = Node::geode(vec![square(WHITE)]).with_state_set(set);
    for (turn, shift) in [(0.0, [0.0, 0.0]), (0.9, [0.0, 0.0]), (0.9, [0.013, -0.008]), (2.5, [0.021, 0.017])] {
        // The square turns with the eye, and the eye is shifted along it.
        let world_from_site = DAffine3::from_translation(site) * DAffine3::from_rotation_z(turn);
        let shift = DVec3::new(shift[0], shift[1], 0.0);
        let view = kit::rig::unit_camera(SIDE);
        let from_site = view.eye_from_world * DAffine3::from_translation(-shift);
        let view = CullCamera { eye_from_world: from_site * world_from_site.inverse(), ..view };
        let scene = rig.scene(Node::transform(world_from_site, vec![geode.clone()]));
        let picture = rig.picture(&scene, &view, &plain());
        rig.release(scene);
        // The centre of the pixel right of and below the middle.
        let seen = world_from_site.transform_point3(shift + DVec3::new(1.0, -1.0, 0.0) / f64::from(SIDE));
        let wanted = (10.0 * seen.fract_gl()).fract_gl();
        assert!(wanted.cmpgt(DVec3::splat(0.03)).all() && wanted.cmplt(DVec3::splat(0.97)).all(), "{wanted}");
        let got = kit::frames::pixel(&picture, SIDE / 2, SIDE / 2);
        assert_near(got, wanted.as_vec3().to_array(), &format!("turned by {turn}, shifted by {shift}"));
    }
    assert!(rig.renderer.take_errors().is_empty());
}
