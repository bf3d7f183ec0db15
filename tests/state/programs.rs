//! Programs of the application: uniforms and defines, and the errors and appearance of invalid ones. Needs a GPU; a
//! software adapter suffices.

use std::sync::Arc;

use image::RgbaImage;
use kit::frames::{MAGENTA, pixel};
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::cull::CullCamera;
use terrane::scene::Node;
use terrane::state::{
    Attribute, CompareFunction, Program, Sampler, StateSet, TextureBinding, TextureDimension, TextureFormat,
    TextureObject, UniformValue,
};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];
const BLACK: [u8; 3] = [0, 0, 0];

/// Pipelines of a dropped program are freed, and a program that reuses its slot gets none of them.
#[test]
fn programs_reuse_slots_of_others() {
    let Some(mut rig) = rig("programs_reuse_slots_of_others") else { return };
    let rig = &mut *rig;
    let set = |color: [u8; 3], has_uniforms: bool| {
        let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
        let (declared, value) = match has_uniforms {
            true => ("struct U { tint: vec3<f32> } @group(2) @binding(0) var<uniform> u: U;", "u.tint".to_owned()),
            false => ("", format!("vec3<f32>({r:?}, {g:?}, {b:?})")),
        };
        let wgsl = format!(
            "{declared}
            @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {{
                return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
            }}
            @fragment fn fs_main() -> @location(0) vec4<f32> {{ return vec4<f32>({value}, 1.0); }}"
        );
        let program = Arc::new(Program { name: "one of many".into(), wgsl, defines: Vec::new() });
        StateSet::default().with(Attribute::Program(program)).with_uniform("tint", UniformValue::Vec3([r, g, b]))
    };
    let stays = Arc::new(set(RED, true));
    for round in 0..12 {
        let color = [RED, GREEN, BLUE][round % 3];
        let quad = |x: f32| quad([x, 0.0, 0.0], [0.25; 2], [1.0; 4]);
        let scene = rig.scene(Node::group(vec![
            Node::geode(vec![quad(-0.5)]).with_state_set(stays.clone()),
            Node::geode(vec![quad(0.5)]).with_state_set(Arc::new(set(color, round % 2 == 0))),
        ]));
        let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
        rig.release(scene);
        assert_eq!([pixel(&picture, 16, 32), pixel(&picture, 48, 32)], [RED, color], "round {round}");
        assert!(rig.renderer.take_errors().is_empty());
    }
}

/// Regression: each of two renderers that had drawn with a program kept it alive for the other.
#[test]
fn programs_are_released_by_all_renderers() {
    let (Some(first), Some(second)) = (kit::rig::new_rig([SIDE; 2]), kit::rig::new_rig([SIDE; 2])) else {
        return;
    };
    let mut rigs = [first, second];
    let program = Program::new(
        "of both",
        "@vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
        }
        @fragment fn fs_main() -> @location(0) vec4<f32> { return vec4<f32>(0.0, 1.0, 0.0, 1.0); }",
    );
    let kept = Arc::downgrade(&program);
    let set = Arc::new(StateSet::default().with(Attribute::Program(program)));
    let square = || Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0; 4])]);
    for rig in &mut rigs {
        let scene = rig.scene(square().with_state_set(set.clone()));
        let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
        assert_eq!(pixel(&picture, 32, 32), GREEN);
        rig.release(scene);
    }
    drop(set);
    for rig in &mut rigs {
        let scene = rig.scene(square());
        // Cull looks for dropped state sets in every sixteenth frame.
        for _ in 0..20 {
            rig.draw(&scene, &unit_camera(SIDE), &plain());
        }
        rig.release(scene);
        assert!(rig.renderer.take_errors().is_empty());
    }
    assert_eq!(kept.strong_count(), 0, "no renderer uses it any more");
}

#[test]
fn programs_have_uniforms_and_defines() {
    let Some(mut rig) = rig("programs_have_uniforms_and_defines") else { return };
    let rig = &mut *rig;
    let wgsl = "
        struct Uniforms {
            tint: vec3<f32>, factor: f32, turned: mat3x3<f32>, count: u32, osg_FrameNumber: u32,
            osg_SimulationTime: f32, table: array<vec4<f32>, 3>, osg_ViewMatrixInverse: mat4x4<f32>,
        }
        @group(2) @binding(0) var<uniform> uniforms: Uniforms;
        override FANCY: bool = false;
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
        }
        @fragment fn fs_main() -> @location(0) vec4<f32> {
            var color = uniforms.tint * uniforms.factor;
            if FANCY { color = uniforms.turned * color; }
            if uniforms.count != 7u || uniforms.osg_FrameNumber != 5u || uniforms.osg_SimulationTime != 2.5 {
                color = vec3<f32>(1.0, 1.0, 0.0);
            }
            if uniforms.table[2].y != 4.0 || uniforms.osg_ViewMatrixInverse[3].z != 10.0 {
                color = vec3<f32>(0.0, 1.0, 1.0);
            }
            return vec4<f32>(color, 1.0);
        }";
    rig.renderer.clock = terrane::draw::FrameClock { simulation_time_s: 2.5, ..Default::default() };
    let set = |fancy: bool, tint: UniformValue| {
        let defines = if fancy { vec![("FANCY".to_string(), 1.0), ("UNKNOWN".into(), 3.0)] } else { vec![] };
        let program = Arc::new(Program { name: "tinted".into(), wgsl: wgsl.into(), defines });
        StateSet::default()
            .with(Attribute::Program(program))
            .with_uniform("tint", tint)
            .with_uniform("factor", UniformValue::Float(0.5))
            // Red becomes blue.
            .with_uniform("turned", UniformValue::Mat3([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
            .with_uniform("count", UniformValue::Uint(7))
            .with_uniform("table", UniformValue::Vec4Array([[0.0; 4], [1.0; 4], [0.0, 4.0, 0.0, 0.0]].into()))
    };
    let mut middle = |set: StateSet| {
        let scene = rig.scene(Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0; 4])]).with_state_set(Arc::new(set)));
        let picture = rig.picture(&scene, &CullCamera { frame: 5, ..unit_camera(SIDE) }, &plain());
        rig.release(scene);
        (pixel(&picture, 32, 32), rig.renderer.take_errors())
    };
    let red = UniformValue::Vec3([2.0, 0.0, 0.0]);
    assert_eq!(middle(set(false, red.clone())), (RED, vec![]));
    assert_eq!(middle(set(true, red)), (BLUE, vec![]));
    let (color, errors) = middle(set(false, UniformValue::Vec2([1.0, 0.0])));
    assert_eq!(color, BLACK);
    assert!(
        matches!(&errors[..], [e] if e.contains("tint") && e.contains("vec2<f32> instead of vec3<f32>")),
        "{errors:?}"
    );
}

#[test]
fn uniforms_of_every_type_reach_programs() {
    let Some(mut rig) = rig("uniforms_of_every_type_reach_programs") else { return };
    let rig = &mut *rig;
    use UniformValue::*;
    let columns = [[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0], [9.0, 10.0, 11.0, 12.0], [13.0, 14.0, 15.0, 16.0]];
    let of_three = [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5], [7.5, 8.5, 9.5]];
    let of_two = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]];
    let in_three = [[1.0, 2.0, 3.0], [5.0, 6.0, 7.0], [9.0, 10.0, 11.0], [13.0, 14.0, 15.0]];
    // Types are smaller than the alignment of the next one, so that each offset is checked against WGSL.
    let given = [
        ("f32", Float(-0.25), "all(V == -0.25)"),
        ("vec2<f32>", Vec2([0.5, -1.5]), "all(V == vec2(0.5, -1.5))"),
        ("vec3<f32>", Vec3([1.25, 2.25, -3.25]), "all(V == vec3(1.25, 2.25, -3.25))"),
        ("vec4<f32>", Vec4([4.0, 3.0, 2.0, -1.0]), "all(V == vec4(4.0, 3.0, 2.0, -1.0))"),
        ("i32", Int(-7), "V == -7"),
        ("vec2<i32>", IVec2([-8, 9]), "all(V == vec2(-8, 9))"),
        ("vec3<i32>", IVec3([10, -11, 12]), "all(V == vec3(10, -11, 12))"),
        ("vec4<i32>", IVec4([-13, 14, i32::MIN, i32::MAX]), "all(V == vec4(-13, 14, -2147483647 - 1, 2147483647))"),
        ("u32", Uint(17), "V == 17u"),
        ("vec2<u32>", UVec2([18, 19]), "all(V == vec2(18u, 19u))"),
        ("vec3<u32>", UVec3([20, 21, 22]), "all(V == vec3(20u, 21u, 22u))"),
        ("vec4<u32>", UVec4([23, 24, 25, u32::MAX]), "all(V == vec4(23u, 24u, 25u, 4294967295u))"),
        ("mat2x2<f32>", Mat2([[1.0, 2.0], [3.0, 4.0]]), "all(V[0] == vec2(1.0, 2.0)) && all(V[1] == vec2(3.0, 4.0))"),
        (
            "mat3x3<f32>",
            Mat3(of_three),
            "all(V[0] == vec3(1.5, 2.5, 3.5)) && all(V[1] == vec3(4.5, 5.5, 6.5)) && all(V[2] == vec3(7.5, 8.5, 9.5))",
        ),
        (
            "mat4x4<f32>",
            Mat4(columns),
            "all(V[1] == vec4(5.0, 6.0, 7.0, 8.0)) && all(V * vec4(0.0, 0.0, 0.0, 1.0) == V[3]) && V[3].w == 16.0",
        ),
        (
            "mat2x3<f32>",
            Mat2x3([in_three[0], in_three[1]]),
            "all(V[0] == vec3(1.0, 2.0, 3.0)) && all(V[1] == vec3(5.0, 6.0, 7.0))",
        ),
        (
            "mat2x4<f32>",
            Mat2x4([columns[0], columns[1]]),
            "all(V[0] == vec4(1.0, 2.0, 3.0, 4.0)) && all(V[1] == vec4(5.0, 6.0, 7.0, 8.0))",
        ),
        (
            "mat3x2<f32>",
            Mat3x2([of_two[0], of_two[1], of_two[2]]),
            "all(V[0] == vec2(1.0, 2.0)) && all(V[1] == vec2(3.0, 4.0)) && all(V[2] == vec2(5.0, 6.0))",
        ),
        (
            "mat3x4<f32>",
            Mat3x4([columns[0], columns[1], columns[2]]),
            "all(V[0] == vec4(1.0, 2.0, 3.0, 4.0)) && all(V[2] == vec4(9.0, 10.0, 11.0, 12.0))",
        ),
        ("mat4x2<f32>", Mat4x2(of_two), "all(V[1] == vec2(3.0, 4.0)) && all(V[3] == vec2(7.0, 8.0))"),
        ("mat4x3<f32>", Mat4x3(in_three), "all(V[1] == vec3(5.0, 6.0, 7.0)) && all(V[3] == vec3(13.0, 14.0, 15.0))"),
        // Each of the three has a column, of which the last component is 0.
        ("array<vec3<f32>, 3>", Vec3Array(in_three[..2].into()), "V[1].z == 7.0 && all(V[2] == vec3(0.0))"),
        ("array<vec3<i32>, 2>", IVec3Array([[1, 2, 3], [-4, -5, -6]].into()), "all(V[1] == vec3(-4, -5, -6))"),
        ("array<vec4<i32>, 2>", IVec4Array([[1, 2, 3, 4], [5, 6, 7, -8]].into()), "all(V[1] == vec4(5, 6, 7, -8))"),
        ("array<vec3<u32>, 2>", UVec3Array([[1, 2, 3], [4, 5, 6]].into()), "all(V[1] == vec3(4u, 5u, 6u))"),
        ("array<vec4<u32>, 2>", UVec4Array([[1, 2, 3, 4], [5, 6, 7, 8]].into()), "all(V[1] == vec4(5u, 6u, 7u, 8u))"),
        (
            "array<mat2x2<f32>, 2>",
            Mat2Array([[of_two[0], of_two[1]], [of_two[2], of_two[3]]].into()),
            "V[0][1].x == 3.0 && all(V[1][1] == vec2(7.0, 8.0))",
        ),
        (
            "array<mat2x3<f32>, 2>",
            Mat2x3Array([[in_three[0], in_three[1]], [in_three[2], in_three[3]]].into()),
            "V[0][1].x == 5.0 && all(V[1][1] == vec3(13.0, 14.0, 15.0))",
        ),
        (
            "array<mat2x4<f32>, 2>",
            Mat2x4Array([[columns[0], columns[1]], [columns[2], columns[3]]].into()),
            "V[0][1].x == 5.0 && all(V[1][1] == vec4(13.0, 14.0, 15.0, 16.0))",
        ),
        ("array<mat3x3<f32>, 2>", Mat3Array([of_three; 2].into()), "all(V[1][2] == vec3(7.5, 8.5, 9.5))"),
        (
            "array<mat3x4<f32>, 2>",
            Mat3x4Array([[columns[3]; 3], [columns[0], columns[1], columns[2]]].into()),
            "V[0][2].x == 13.0 && all(V[1][2] == vec4(9.0, 10.0, 11.0, 12.0))",
        ),
        (
            "array<mat4x2<f32>, 2>",
            Mat4x2Array([[of_two[3]; 4], of_two].into()),
            "V[0][3].x == 7.0 && all(V[1][2] == vec2(5.0, 6.0))",
        ),
        (
            "array<mat4x3<f32>, 2>",
            Mat4x3Array([[in_three[3]; 4], in_three].into()),
            "V[0][3].x == 13.0 && all(V[1][2] == vec3(9.0, 10.0, 11.0))",
        ),
        (
            "array<mat4x4<f32>, 2>",
            Mat4Array([[columns[3]; 4], columns].into()),
            "all(V[1][1] == vec4(5.0, 6.0, 7.0, 8.0))",
        ),
        ("array<vec4<f32>, 4>", Vec4Array(columns.into()), "all(V[0] == vec4(1.0, 2.0, 3.0, 4.0)) && V[3].x == 13.0"),
    ];
    let times = [
        ("osg_FrameNumber", "u32", "uniforms.osg_FrameNumber == 6u"),
        ("osg_FrameTime", "f32", "uniforms.osg_FrameTime == 12.5"),
        ("osg_DeltaFrameTime", "f32", "uniforms.osg_DeltaFrameTime == 0.125"),
        ("osg_SimulationTime", "f32", "uniforms.osg_SimulationTime == 1000.5"),
        ("osg_ViewMatrix", "mat4x4<f32>", "all(uniforms.osg_ViewMatrix[3] == vec4(0.0, 0.0, -10.0, 1.0))"),
    ];
    let mut set = StateSet::default();
    let (mut declared, mut checked, mut whats) = (String::new(), String::new(), Vec::new());
    let mut add = |what, name: &str, ty: &str, holds: &str| {
        declared += &format!("{name}: {ty}, ");
        checked += &format!("case {}u: {{ holds = {holds}; }}\n", whats.len());
        whats.push(what);
    };
    for (at, (ty, value, holds)) in given.into_iter().enumerate() {
        let name = format!("given_{at}");
        add(ty, &name, ty, &holds.replace('V', &format!("uniforms.{name}")));
        set = set.with_uniform(&name, value);
    }
    times.into_iter().for_each(|(name, ty, holds)| add(name, name, ty, holds));
    let count = whats.len();
    let wgsl = format!(
        "struct Uniforms {{ {declared} }}
        @group(2) @binding(0) var<uniform> uniforms: Uniforms;
        struct V {{ @builtin(position) position: vec4<f32>, @location(0) uv: vec2<f32> }}
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {{
            return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), vertex.uv);
        }}
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> {{
            var holds = false;
            switch u32(in.uv.x * {count}.0) {{
                {checked}
                default: {{}}
            }}
            return vec4<f32>(select(1.0, 0.0, holds), select(0.0, 1.0, holds), 0.0, 1.0);
        }}"
    );
    let set = set.with(Attribute::Program(Program::new("types", &wgsl)));
    rig.renderer.clock =
        terrane::draw::FrameClock { reference_time_s: 12.5, delta_s: 0.125, simulation_time_s: 1000.5 };
    let scene = rig.scene(Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set)));
    let side = 4 * count as u32;
    let picture = rig.picture(&scene, &CullCamera { frame: 6, ..unit_camera(side) }, &plain());
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    for (place, what) in (0u32..).zip(whats) {
        assert_eq!(pixel(&picture, 4 * place + 2, side / 2), GREEN, "{what}");
    }
}

/// With more uniforms than the adapter supports, the program is reported and the rest of the frame is drawn.
#[test]
fn programs_with_too_many_uniforms_are_reported_and_lose_no_frame() {
    let Some(mut rig) = rig("programs_with_too_many_uniforms_are_reported_and_lose_no_frame") else { return };
    let rig = &mut *rig;
    let count = rig.ctx.device().limits().max_uniform_buffer_binding_size / 16 + 1;
    let wgsl = format!(
        "struct Uniforms {{ table: array<vec4<f32>, {count}> }}
        @group(2) @binding(0) var<uniform> uniforms: Uniforms;
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {{
            return clip_of(leaves[i], point_in_eye(leaves[i], vertex.position));
        }}
        @fragment fn fs_main() -> @location(0) vec4<f32> {{ return uniforms.table[1]; }}"
    );
    let set = StateSet::default().with(Attribute::Program(Program::new("a table", &wgsl)));
    let tabled = Node::geode(vec![quad([0.5, 0.0, 0.0], [0.25; 2], [1.0; 4])]).with_state_set(Arc::new(set));
    let plain_one = Node::geode(vec![quad([-0.5, 0.0, 0.0], [0.25; 2], [0.0, 1.0, 0.0, 1.0])]);
    let scene = rig.scene(Node::group(vec![tabled, plain_one]));
    for frame in 0..2 {
        let picture = rig.picture(&scene, &unit_camera(64), &plain());
        assert_eq!(pixel(&picture, 16, 32), [0, 255, 0]);
        let errors = rig.renderer.take_errors();
        assert_eq!(errors.len(), usize::from(frame == 0), "{errors:?}");
        assert!(errors.iter().all(|e| e.contains("bytes of uniforms")), "{errors:?}");
        assert!(rig.ctx.take_device_errors().is_empty());
    }
    rig.release(scene);
}

#[test]
fn invalid_programs_are_visible_and_reported_once() {
    let Some(mut rig) = rig("invalid_programs_are_visible_and_reported_once") else { return };
    let rig = &mut *rig;
    let vertex =
        "@vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0); }";
    for (name, wgsl, says) in [
        ("syntax", "this is no WGSL".to_string(), "expected"),
        ("types", format!("{vertex} @fragment fn fs_main() -> @location(0) vec4<f32> {{ return 1; }}"), "types"),
        ("half", vertex.to_string(), "no fragment entry point"),
        // The device finds this error only when it creates the pipeline.
        (
            "inputs",
            format!(
                "{} @fragment fn fs_main() -> @location(0) vec4<f32> {{ return vec4(1.0); }}",
                vertex.replace("vs_main(", "vs_main(@location(9) own: f32, ")
            ),
            "program \"inputs\"",
        ),
        (
            "other",
            format!(
                "{vertex} @fragment fn fs_main() -> @location(0) vec4<f32> {{ return vec4(1.0); }}
            @group(3) @binding(0) var t: texture_2d<f32>;"
            ),
            "group 3",
        ),
    ] {
        let set = StateSet { name: format!("set of {name}"), ..StateSet::default() }
            .with(Attribute::Program(Program::new(name, &wgsl)));
        let broken = Node::geode(vec![quad([-0.5, 0.0, 0.0], [0.25; 2], [1.0; 4])]).with_state_set(Arc::new(set));
        let scene = rig.scene(Node::group(vec![
            broken,
            Node::geode(vec![quad([0.5, 0.0, 0.0], [0.25; 2], [0.0, 1.0, 0.0, 1.0])]),
        ]));
        let black = terrane::scene::Environment { sky: terrane::scene::Sky::Background([0; 3]), ..plain() };
        for frame in 0..3 {
            let picture = rig.picture(&scene, &unit_camera(SIDE), &black);
            assert_eq!((pixel(&picture, 16, 32), pixel(&picture, 48, 32)), (MAGENTA, GREEN), "{name}");
            let errors = rig.renderer.take_errors();
            assert_eq!(errors.len(), usize::from(frame == 0), "{errors:?}");
            for e in errors {
                assert!(e.contains(&format!("set of {name}")) && e.contains(says), "{e:?} instead of {says}");
            }
        }
        rig.release(scene);
    }
}

#[test]
fn programs_shade_height_tiles() {
    let Some(mut rig) = rig("programs_shade_height_tiles") else { return };
    let rig = &mut *rig;
    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 900.0, root_error_m: 250.0, textured: true };
    let eye = terrain.world(0.5, 0.2, 9_000.0);
    let seen = kit::rig::camera([128, 96], eye, terrain.world(0.5, 0.5, 0.0), terrain.up(0.5, 0.5));
    let draw = |rig: &mut Rig, set: Option<StateSet>| {
        let tile = terrain.tile(0, 0, 0);
        let scene = rig.scene(match set {
            Some(set) => tile.with_state_set(Arc::new(set)),
            None => tile,
        });
        let picture = rig.picture(&scene, &seen, &plain());
        rig.release(scene);
        (picture, rig.renderer.take_errors())
    };
    let (usual, _) = draw(rig, None);
    let covered = |picture: &RgbaImage| -> Vec<bool> { picture.pixels().map(|p| p.0[..3] != MAGENTA).collect() };
    assert!(covered(&usual).iter().filter(|c| **c).count() > 3_000);
    // The program lights the tile like the built-in shader, with its position, normal and image.
    let as_usual = "
        struct V { @builtin(position) p: vec4<f32>, @location(0) light: vec3<f32>, @location(1) uv: vec2<f32>,
            @location(2) @interpolate(flat) layer: u32 }
        struct Uniforms { tint: vec4<f32> }
        @group(2) @binding(0) var<uniform> uniforms: Uniforms;
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {
            let leaf = leaves[i];
            let at = point_in_eye(leaf, vertex.position);
            let ground = above_ground(at);
            let normal = normal_in_eye(leaf, vertex.normal.xyz);
            let lit = light(normal, ground.xyz, ground.w) * leaf.color.rgb * vertex.color.rgb;
            return V(frame.clip_from_eye * vec4<f32>(at, 1.0), lit, vertex.uv, leaf.layer);
        }
        @fragment fn fs_main(v: V) -> @location(0) vec4<f32> {
            let base = textureSample(color_layers, color_sampler, v.uv, v.layer);
            return vec4<f32>(base.rgb * v.light, 1.0) * uniforms.tint;
        }";
    let tinted = |tint: [f32; 4]| {
        let program = Program::new("as usual", as_usual);
        StateSet::default().with(Attribute::Program(program)).with_uniform("tint", UniformValue::Vec4(tint))
    };
    let (same, errors) = draw(rig, Some(tinted([1.0; 4])));
    assert!(errors.is_empty(), "{errors:?}");
    let differing = same.pixels().zip(usual.pixels()).filter(|(a, b)| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 3));
    let differing = differing.count();
    // Up is that of the point below the eye in one, and that of the tile's vertices in the other.
    assert!(differing < 100, "{differing}");
    let (green, errors) = draw(rig, Some(tinted([0.0, 1.0, 0.0, 1.0])));
    assert!(errors.is_empty() && covered(&green) == covered(&usual));
    assert!(green.pixels().all(|p| p.0[..3] == MAGENTA || (p.0[0] == 0 && p.0[2] == 0)));

    // A tile and a mesh have one program. Parts for meshes only leave the tile plain and are reported once.
    let for_meshes = "
        fn height_at() {}
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
        }
        @fragment fn fs_main() -> @location(0) vec4<f32> { return vec4<f32>(0.0, 0.0, 1.0, 1.0); }";
    let set = StateSet::default().with(Attribute::Program(Program::new("for meshes", for_meshes)));
    let (plainly, errors) = draw(rig, Some(set));
    assert_eq!(plainly, usual);
    assert!(
        matches!(&errors[..], [e] if e.contains("\"for meshes\" on height tiles") && e.contains("height_at")),
        "{errors:?}"
    );
}

/// Any binding is tested, because a frame that the adapter refuses would lose everything.
#[test]
fn depth_textures_have_fitting_samplers_or_are_replaced() {
    let Some(mut rig) = rig("depth_textures_have_fitting_samplers_or_are_replaced") else { return };
    let rig = &mut *rig;
    let program = |dimension: &str, read: &str, sampler: &str| {
        let wgsl = format!(
            "@group(2) @binding(1) var depths: texture_depth_{dimension};
            @group(2) @binding(2) var way: {sampler};
            @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {{
                return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
            }}
            @fragment fn fs_main() -> @location(0) vec4<f32> {{
                return vec4<f32>({read}, 1.0, 0.0, 1.0);
            }}"
        );
        Attribute::Program(Arc::new(Program { name: "depths".into(), wgsl, defines: vec![] }))
    };
    let plain_read = program("2d", "textureSample(depths, way, vec2<f32>(0.5))", "sampler");
    let compared = program("2d", "textureSampleCompareLevel(depths, way, vec2<f32>(0.5), 0.5)", "sampler_comparison");
    let cube = program("cube", "textureSample(depths, way, vec3<f32>(1.0, 0.0, 0.0))", "sampler");
    let layers = program("2d_array", "textureSample(depths, way, vec2<f32>(0.5), 0)", "sampler");
    // Each has a separate name, because an error is reported once.
    let names = std::cell::Cell::new(0);
    let bound = |is_depth: bool, compare| {
        names.set(names.get() + 1);
        let (format, texels) =
            if is_depth { (TextureFormat::Depth32, vec![]) } else { (TextureFormat::Rgba8, vec![vec![255; 4]]) };
        let name = names.get().to_string();
        let (dimension, size) = (TextureDimension::D2, [1, 1, 1]);
        let texture = Arc::new(TextureObject { name, dimension, size, format, levels: 1, texels, is_changing: false });
        let sampler = Sampler { compare, ..Sampler::default() };
        Some(Attribute::Texture(0, TextureBinding { texture, sampler }))
    };
    let less = Some(CompareFunction::LessOrEqual);
    // A program, the bound textures, and whether an error is reported.
    for (program, binding, is_wrong) in [
        (&plain_read, None, false),
        (&plain_read, bound(true, None), false),
        (&plain_read, bound(true, less), true),
        (&plain_read, bound(false, None), true),
        (&compared, None, false),
        (&compared, bound(true, less), false),
        (&compared, bound(true, None), true),
        (&cube, None, false),
        (&cube, bound(true, None), true),
        (&layers, None, false),
        (&layers, bound(true, None), true),
    ] {
        let mut set = StateSet::default().with(program.clone());
        if let Some(binding) = &binding {
            set = set.with(binding.clone());
        }
        let reads = Node::geode(vec![quad([-0.5, 0.0, 0.0], [0.3; 2], [1.0; 4])]).with_state_set(Arc::new(set));
        let other = Node::geode(vec![quad([0.5, 0.0, 0.0], [0.3; 2], [0.0, 0.0, 1.0, 1.0])]);
        let scene = rig.scene(Node::group(vec![reads, other]));
        let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
        rig.release(scene);
        assert_eq!(pixel(&picture, 48, 32), BLUE, "the rest of the frame is drawn: {binding:?}");
        assert_eq!(pixel(&picture, 16, 32)[1..], GREEN[1..], "{binding:?}");
        let errors = rig.renderer.take_errors();
        assert_eq!(errors.iter().any(|e| e.contains("does not fit unit 0")), is_wrong, "{binding:?}: {errors:?}");
        assert_eq!(errors.len(), usize::from(is_wrong), "{errors:?}");
    }
}
