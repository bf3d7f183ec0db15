//! Lights, clip planes, texture planes and uniforms of programs below nested cameras, relative to the camera's own eye.
//! Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use glam::{DAffine3, DVec3, DVec4};
use image::RgbaImage;
use kit::cameras::{no_errors, picture};
use kit::frames::pixel;
use kit::frames::{differ, keep};
use kit::rig::{Rig, camera, plain, rig};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::scene::{
    CameraEnvironment, CameraNode, ClipNode, LightSource, Node, NodeKind, ReferenceFrame, RenderOrder, TexGenNode,
};
use terrane::state::{
    Attribute, FilterMode, Light, Mode, Program, Sampler, StateSet, StateValue, TexGen, TextureBinding, TextureObject,
    WrapMode,
};

const SIZE: [u32; 2] = [96, 96];

/// Returns a camera that sees its children.
fn own() -> CullCamera {
    camera(SIZE, DVec3::new(1.5, -1.0, 4.0), DVec3::new(0.2, 0.1, 0.0), DVec3::Y)
}

/// Returns the main camera, which looks elsewhere.
fn outer() -> CullCamera {
    camera(SIZE, DVec3::new(-30.0, 4.0, 20.0), DVec3::new(-40.0, 0.0, 10.0), DVec3::Z)
}

fn nested(environment: CameraEnvironment, children: Vec<Node>) -> Node {
    let own = own();
    let camera = CameraNode {
        frame: ReferenceFrame::Absolute,
        view: own.eye_from_world,
        projection: Some(own.clip_from_eye),
        environment,
        ..CameraNode::new(RenderOrder::Nested)
    };
    Node::camera(camera, children)
}

fn drawn(rig: &mut Rig, nodes: Vec<Node>, from: &CullCamera) -> RgbaImage {
    let picture = picture(rig, Node::group(nodes), from, &plain());
    no_errors(rig);
    picture
}

/// Returns a square with a red highlight near the middle.
fn lamp() -> Node {
    let light = Light { number: 1, position: [0.6, 0.5, 0.7, 1.0], diffuse: [1.0, 0.2, 0.1], ..Light::default() };
    Node::new(NodeKind::LightSource(Box::new(LightSource { light, frame: ReferenceFrame::Relative })))
}

/// Returns four lit squares around the origin.
fn lit_squares() -> Node {
    let squares = [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]].map(|[x, y]| {
        let mut square = quad([x, y, 0.0], [0.45, 0.45], [1.0; 4]);
        square.material.unlit = false;
        square
    });
    let set = StateSet::default().with_mode(Mode::Light(0), StateValue::OFF).with_mode(Mode::Light(1), StateValue::ON);
    Node::geode(squares.into()).with_state_set(Arc::new(set))
}

fn brightest(picture: &RgbaImage) -> u8 {
    picture.pixels().filter(|p| p.0[..3] != kit::frames::MAGENTA).map(|p| p.0[0]).max().unwrap()
}

#[test]
fn lights_have_their_positions_for_all_cameras() {
    let Some(mut rig) = rig("lights_have_their_positions_for_all_cameras") else { return };
    let rig = &mut *rig;
    let expected = drawn(rig, vec![lamp(), lit_squares()], &own());
    keep("nested-light-expected", &expected);
    assert!(brightest(&expected) > 200);
    let inherited = || CameraEnvironment::Inherited;
    let inside = drawn(rig, vec![nested(inherited(), vec![lamp(), lit_squares()])], &outer());
    assert_eq!(differ(&inside, &expected, 1), 0, "a light below the camera");
    let outside = drawn(rig, vec![lamp(), nested(inherited(), vec![lit_squares()])], &outer());
    keep("nested-light-outside", &outside);
    assert_eq!(differ(&outside, &expected, 1), 0, "a light beside the camera");
    let beside = drawn(rig, vec![nested(inherited(), vec![lamp()]), lit_squares()], &own());
    assert_eq!(differ(&beside, &expected, 1), 0, "a light below a camera, on nodes beside it");
    // A nested camera without its own light keeps the lights relative to the main eye.
    let light = || CameraEnvironment::Light;
    let inside = drawn(rig, vec![nested(light(), vec![lamp(), lit_squares()])], &outer());
    assert_eq!(differ(&inside, &expected, 1), 0, "an overlay with its own light");
    let outside = drawn(rig, vec![lamp(), nested(light(), vec![lit_squares()])], &outer());
    assert!(differ(&outside, &expected, 8) > 1000, "an overlay in the light of the picture");
}

#[test]
fn planes_have_their_positions_for_all_cameras() {
    let Some(mut rig) = rig("planes_have_their_positions_for_all_cameras") else { return };
    let rig = &mut *rig;
    let clip = || {
        let planes = vec![(2, DVec4::new(0.8, 0.6, 0.0, 0.1))];
        Node::new(NodeKind::ClipNode(Box::new(ClipNode { planes, frame: ReferenceFrame::Relative })))
    };
    let texels = [[255u8, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 0, 255]].concat();
    let nearest = Sampler {
        min_filter: FilterMode::Nearest,
        mag_filter: FilterMode::Nearest,
        wrap: [WrapMode::Repeat; 3],
        ..Sampler::default()
    };
    let binding = TextureBinding { texture: TextureObject::image("quarters", [2, 2], texels), sampler: nearest };
    let planes = TexGen::planes([0.7, 0.1, 0.0, 0.3], [0.1, -0.6, 0.0, 0.2]);
    let texgen =
        || Node::new(NodeKind::TexGenNode(Box::new(TexGenNode { unit: 0, texgen: TexGen::EyeLinear(planes) })));
    let turned = |node: Node| Node::transform(DAffine3::from_rotation_z(0.4), vec![node]);
    let set = Arc::new(
        StateSet::default()
            .with_mode(Mode::ClipPlane(2), StateValue::ON)
            .with(Attribute::Texture(0, binding))
            .with(Attribute::TexGen(0, TexGen::EyeLinear([[0.0; 4]; 4]))),
    );
    let square = || Node::geode(vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])]).with_state_set(set.clone());
    let expected = drawn(rig, vec![clip(), turned(texgen()), square()], &own());
    keep("nested-planes-expected", &expected);
    let colours: std::collections::BTreeSet<_> = expected.pixels().map(|p| p.0).collect();
    assert!(colours.len() >= 5, "four colours and the cut area: {colours:?}");
    for environment in [CameraEnvironment::Inherited, CameraEnvironment::Light] {
        let inside = drawn(rig, vec![nested(environment.clone(), vec![clip(), turned(texgen()), square()])], &outer());
        assert_eq!(differ(&inside, &expected, 1), 0, "{environment:?}: below the camera");
        let outside = drawn(rig, vec![clip(), turned(texgen()), nested(environment.clone(), vec![square()])], &outer());
        keep("nested-planes-outside", &outside);
        assert_eq!(differ(&outside, &expected, 1), 0, "{environment:?}: beside the camera");
    }
}

#[test]
fn programs_receive_the_matrices_of_their_camera() {
    let Some(mut rig) = rig("programs_receive_the_matrices_of_their_camera") else { return };
    let rig = &mut *rig;
    // The colours show positions in the world, for which the correct inverse is needed.
    let wgsl = "
        struct Uniforms { osg_ViewMatrix: mat4x4<f32>, osg_ViewMatrixInverse: mat4x4<f32> }
        @group(2) @binding(0) var<uniform> uniforms: Uniforms;
        struct Fragment { @builtin(position) clip: vec4<f32>, @location(0) world: vec3<f32>, @location(1) eye: vec3<f32> }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> Fragment {
            let eye = point_in_eye(leaves[i], vertex.position);
            let world = uniforms.osg_ViewMatrixInverse * vec4<f32>(eye, 1.0);
            return Fragment(frame.clip_from_eye * vec4<f32>(eye, 1.0), world.xyz, eye);
        }
        @fragment fn fs_main(in: Fragment) -> @location(0) vec4<f32> {
            let eye = uniforms.osg_ViewMatrix * vec4<f32>(in.world, 1.0);
            return vec4<f32>(0.5 + 0.5 * in.world.xy, step(distance(eye.xyz, in.eye), 0.01), 1.0);
        }";
    let program = Arc::new(Program { name: "world".into(), wgsl: wgsl.into(), defines: vec![] });
    let set = Arc::new(StateSet::default().with(Attribute::Program(program)));
    let square = || Node::geode(vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])]).with_state_set(set.clone());
    let expected = drawn(rig, vec![square()], &own());
    keep("nested-program-expected", &expected);
    assert_eq!(pixel(&expected, 48, 48)[2], 255);
    for environment in [CameraEnvironment::Inherited, CameraEnvironment::Light] {
        let found = drawn(rig, vec![nested(environment, vec![square()])], &outer());
        assert_eq!(differ(&found, &expected, 1), 0);
    }
}
