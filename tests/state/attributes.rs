//! Custom vertex attributes: the values that programs read, the errors of missing ones, and other shading that ignores
//! them. Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use glam::DVec3;
use image::RgbaImage;
use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shadows::{ground, solid, sunny, tower};
use kit::shapes::{mesh, quad};

use terrane::scene::AttributeFormat::{self, *};
use terrane::scene::{Drawable, Environment, Geometry, Material, Mesh, MeshVertex, Node, PrimitiveMode, Sky};
use terrane::state::{Attribute, Program, StateSet, SurfaceMaterial};

const SIDE: u32 = 64;
const GREEN: [u8; 3] = [0, 255, 0];
const BLACK: [u8; 3] = [0, 0, 0];

/// Returns a program that shows a color, computed from the attributes of each vertex.
fn program(name: &str, inputs: &str, color: &str) -> Attribute {
    let wgsl = format!(
        "struct V {{ @builtin(position) position: vec4<f32>, @location(0) color: vec3<f32> }}
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32, {inputs}) -> V {{
            return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), {color});
        }}
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> {{ return vec4<f32>(in.color, 1.0); }}"
    );
    Attribute::Program(Program::new(name, &wgsl))
}

/// Returns a set that shows green where the attribute `heat` is 1, black where it is 0.
fn heat_program() -> StateSet {
    let set = StateSet { name: "set of heat".into(), ..StateSet::default() };
    set.with(program("heat", "@location(4) heat: f32", "vec3<f32>(0.0, heat, 0.0)"))
}

fn mesh_of(drawable: Drawable) -> Mesh {
    let Geometry::Mesh(mesh) = drawable.geometry else { panic!("a mesh") };
    Mesh::clone(&mesh)
}

/// Returns the same drawable with its mesh changed.
fn with(drawable: Drawable, change: impl FnOnce(Mesh) -> Mesh) -> Drawable {
    let material = drawable.material.clone();
    Drawable::new(Geometry::Mesh(Arc::new(change(mesh_of(drawable)))), material)
}

/// Returns the same drawable with attributes that are zero, except for the last one, `heat`, which is 1.
fn heated(drawable: Drawable, before: &[(&str, AttributeFormat)]) -> Drawable {
    with(drawable, |mesh| {
        let count = mesh.vertices.len();
        let padded = before.iter().fold(mesh, |mesh, (name, format)| {
            mesh.with_attribute(name, *format, &vec![0u8; count * format.size_bytes()]).unwrap()
        });
        padded.with_attribute("heat", Float32, &vec![1.0f32; count]).unwrap()
    })
}

fn black() -> Environment {
    Environment { sky: Sky::Background(BLACK), ..plain() }
}

fn assert_no_errors(rig: &mut Rig) {
    assert_eq!(rig.renderer.take_errors(), Vec::<String>::new());
}

/// Returns the number that component `c` of vertex `n` holds, before normalization.
fn number(n: u32, c: u32) -> u32 {
    3 * n + 30 * c + 1
}

/// Converts small numbers to binary16.
fn half(of: u32) -> u16 {
    let exponent = of.ilog2();
    ((exponent + 15) << 10 | (of << (10 - exponent) & 0x3ff)) as u16
}

/// A format, its number of components, their bits, and the conversion to the value that a program reads.
const FORMATS: [(AttributeFormat, u32, u32, &str); 26] = [
    (Uint8x4, 4, 8, "u32"),
    (Sint8x4, 4, 8, "i32"),
    (Unorm8x4, 4, 8, "255.0"),
    (Snorm8x4, 4, 8, "127.0"),
    (Uint16x2, 2, 16, "u32"),
    (Uint16x4, 4, 16, "u32"),
    (Sint16x2, 2, 16, "i32"),
    (Sint16x4, 4, 16, "i32"),
    (Unorm16x2, 2, 16, "65535.0"),
    (Unorm16x4, 4, 16, "65535.0"),
    (Snorm16x2, 2, 16, "32767.0"),
    (Snorm16x4, 4, 16, "32767.0"),
    (Float16x2, 2, 16, "half"),
    (Float16x4, 4, 16, "half"),
    (Float32, 1, 32, "float"),
    (Float32x2, 2, 32, "float"),
    (Float32x3, 3, 32, "float"),
    (Float32x4, 4, 32, "float"),
    (Uint32, 1, 32, "u32"),
    (Uint32x2, 2, 32, "u32"),
    (Uint32x3, 3, 32, "u32"),
    (Uint32x4, 4, 32, "u32"),
    (Sint32, 1, 32, "i32"),
    (Sint32x2, 2, 32, "i32"),
    (Sint32x3, 3, 32, "i32"),
    (Sint32x4, 4, 32, "i32"),
];

/// In signed formats every second component is negative.
fn is_negative(format: AttributeFormat, c: u32) -> bool {
    matches!(format, Sint8x4 | Snorm8x4 | Sint16x2 | Sint16x4 | Snorm16x2 | Snorm16x4) && c % 2 == 1
}

fn elements(format: AttributeFormat, components: u32, bits: u32, kind: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (n, c) in (0..4).flat_map(|n| (0..components).map(move |c| (n, c))) {
        let value = number(n, c) as i32;
        let value = if is_negative(format, c) { -value } else { value };
        match (bits, kind) {
            (8, _) => bytes.extend((value as i8).to_ne_bytes()),
            (16, "half") => bytes.extend(half(value as u32).to_ne_bytes()),
            (16, _) => bytes.extend((value as i16).to_ne_bytes()),
            (_, "float") => bytes.extend((value as f32).to_ne_bytes()),
            _ => bytes.extend(value.to_ne_bytes()),
        }
    }
    bytes
}

#[test]
fn attributes_of_every_format_reach_programs() {
    let Some(mut rig) = rig("attributes_of_every_format_reach_programs") else { return };
    let rig = &mut *rig;
    // There are at most fifteen layouts, so the second half uses the slots of the first.
    for half in FORMATS.chunks(13) {
        let across = half.len() as f32;
        let nodes = half.iter().zip(0u8..).map(|(&(format, components, bits, kind), place)| {
            let scalar = format.scalar();
            let ty = if components == 1 { scalar.to_owned() } else { format!("vec{components}<{scalar}>") };
            let scale = kind.parse().unwrap_or(1.0);
            let off = (0..components).map(|c| {
                let part = if components == 1 { "" } else { [".x", ".y", ".z", ".w"][c as usize] };
                let sign = if is_negative(format, c) { -1.0 } else { 1.0 };
                format!(
                    "abs({sign:?} * {scale:?} * f32(value{part}) - (3.0 * f32(number) + {:?}))",
                    number(0, c) as f32
                )
            });
            let off = off.collect::<Vec<_>>().join(" + ");
            // The order is one that no mesh has: the first attribute is at the later location.
            let inputs = format!("@location(6) number: u32, @location(4) value: {ty}");
            let color = format!("select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), {off} < 0.01)");
            let set = StateSet::default().with(program(&format!("{format:?}"), &inputs, &color));
            let at = (2.0 * f32::from(place) + 1.0) / across - 1.0;
            let drawable = with(quad([at, 0.0, 0.0], [0.8 / across, 1.0], [1.0; 4]), |mesh| {
                let mesh = mesh.with_attribute("number", Uint32, &[0u32, 1, 2, 3]).unwrap();
                mesh.with_attribute("value", format, &elements(format, components, bits, kind)).unwrap()
            });
            Node::geode(vec![drawable]).with_state_set(Arc::new(set))
        });
        let scene = rig.scene(Node::group(nodes.collect()));
        let side = 8 * half.len() as u32;
        let picture = rig.picture(&scene, &unit_camera(side), &plain());
        rig.release(scene);
        assert_no_errors(rig);
        for (place, (format, ..)) in (0u32..).zip(half) {
            assert_eq!(pixel(&picture, 8 * place + 4, side / 2), GREEN, "{format:?}");
        }
    }
}

#[test]
fn programs_read_struct_members_and_defaults_of_missing_components() {
    let Some(mut rig) = rig("programs_read_struct_members_and_defaults_of_missing_components") else { return };
    let rig = &mut *rig;
    // Two components are given and four read; four are given and one read.
    let set = StateSet::default().with(Attribute::Program(Program::new(
        "struct",
        "struct Further { @location(9) TEXCOORD_1: vec4<f32>, @location(5) _HEAT: f32 }
        struct V { @builtin(position) position: vec4<f32>, @location(0) color: vec4<f32> }
        @vertex fn vs_main(further: Further, @builtin(instance_index) i: u32, vertex: MeshVertex) -> V {
            let position = frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
            let is_right = all(further.TEXCOORD_1 == vec4<f32>(0.25, 0.5, 0.0, 1.0));
            return V(position, vec4<f32>(select(1.0, 0.0, is_right), further._HEAT, 0.0, 1.0));
        }
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> { return in.color; }",
    )));
    let drawable = with(quad([0.0; 3], [0.5; 2], [1.0; 4]), |mesh| {
        let mesh = mesh.with_attribute("_HEAT", Unorm8x4, &[[255u8, 9, 9, 9]; 4]).unwrap();
        mesh.with_attribute("TEXCOORD_1", Float32x2, &[[0.25f32, 0.5]; 4]).unwrap()
    });
    let scene = rig.scene(Node::geode(vec![drawable]).with_state_set(Arc::new(set)));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    assert_no_errors(rig);
    assert_eq!(pixel(&picture, 32, 32), GREEN);
}

/// Returns an attribute in the format of glTF's `_BASIS`.
#[test]
fn programs_assemble_matrices_from_their_columns() {
    let Some(mut rig) = rig("programs_assemble_matrices_from_their_columns") else { return };
    let square = with(quad([0.0; 3], [0.5; 2], [1.0; 4]), |mesh| {
        let columns = [[0.0f32, 0.0], [1.0, 0.0]].into_iter().zip(["_BASIS_0", "_BASIS_1"]);
        columns.fold(mesh, |mesh, (column, name)| mesh.with_attribute(name, Float32x2, &[column; 4]).unwrap())
    });
    let inputs = "@location(4) _BASIS_0: vec2<f32>, @location(5) _BASIS_1: vec2<f32>";
    let color = "vec3<f32>(0.0, mat2x2<f32>(_BASIS_0, _BASIS_1) * vec2<f32>(0.0, 1.0))";
    let set = StateSet::default().with(program("basis", inputs, color));
    let scene = rig.scene(Node::geode(vec![square]).with_state_set(Arc::new(set)));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &black());
    assert_eq!((pixel(&picture, 32, 32), pixel(&picture, 2, 2)), (GREEN, BLACK));
    rig.release(scene);
    assert_no_errors(&mut rig);
}

#[test]
fn missing_or_mistyped_attributes_are_visible_and_reported_once() {
    let Some(mut rig) = rig("missing_or_mistyped_attributes_are_visible_and_reported_once") else { return };
    let rig = &mut *rig;
    let set = Arc::new(heat_program());
    let at = |x: f32| quad([x, 0.5, 0.0], [0.2, 0.2], [1.0; 4]);
    let of = |x: f32, name: &str, format, values: [u32; 4]| {
        with(at(x), |mesh| mesh.with_attribute(name, format, &values).unwrap())
    };
    let line = |i: u16| MeshVertex { position: [-1.0 + f32::from(i), -0.51, 0.0], ..MeshVertex::default() };
    let lines = Mesh::from_arrays(PrimitiveMode::LineStrip, (0..3).map(line).collect());
    // There are enough vertices to be packed.
    let ball = Mesh::sphere(DVec3::new(0.75, 0.5, 0.0), 0.2, 32);
    let scene = rig.scene(
        Node::geode(vec![
            at(-0.75),
            of(-0.25, "heat", Uint32, [1; 4]),
            heated(at(0.25), &[]),
            Drawable::new(ball.into(), Material::default()),
            Drawable::new(lines.into(), Material::default()),
            of(0.0, "cold", Float32, [0; 4]),
        ])
        .with_state_set(set),
    );
    for frame in 0..3 {
        // The second time it is drawn to another target, and with shadows.
        let seen = unit_camera(if frame == 1 { 2 * SIDE } else { SIDE });
        let shadows = sunny(DVec3::Z).shadows.filter(|_| frame > 0);
        let picture = rig.picture(&scene, &seen, &Environment { shadows, ..black() });
        if frame != 1 {
            let row = [8, 24, 40, 56].map(|x| pixel(&picture, x, 16));
            assert_eq!(row, [MAGENTA, MAGENTA, GREEN, MAGENTA]);
            assert_eq!([pixel(&picture, 32, 16), pixel(&picture, 32, 48)], [MAGENTA; 2]);
        }
        let mut errors = rig.renderer.take_errors();
        errors.sort();
        let expected = [
            "triangles with cold: attribute \"heat\" (f32) is missing",
            "lines without custom attributes: attribute \"heat\" (f32) is missing",
            "triangles with heat: attribute \"heat\" is Uint32, which the program reads as f32",
            "triangles without custom attributes: attribute \"heat\" (f32) is missing",
        ];
        let mut expected = expected.map(|what| format!("set of heat: program \"heat\" cannot draw {what}"));
        expected.sort();
        assert_eq!(errors, if frame == 0 { &expected[..] } else { &[] });
    }
    rig.release(scene);
}

/// Returns a slope of a grid of squares with normals. No program reads its attributes.
fn slope(squares: u32, attributes: bool) -> Mesh {
    let side = squares + 1;
    let vertex = |k: u32| {
        let [x, y] = [k % side, k / side].map(|k| 2.0 * k as f32 / squares as f32 - 1.0);
        MeshVertex { position: [x, y, 0.2 * x * y], uv: [x, y], normal: [10, 20, 120, 0], color: [200, 100, 50, 255] }
    };
    let square = |k: u32| {
        let a = k / squares * side + k % squares;
        [a, a + 1, a + side + 1, a, a + side + 1, a + side]
    };
    let slope = mesh((0..side * side).map(vertex).collect(), (0..squares * squares).flat_map(square).collect());
    if !attributes {
        return slope;
    }
    let (few, many) = (vec![[0.5f32, -7.0, 1e9]; slope.vertices.len()], vec![[77u16, 1]; slope.vertices.len()]);
    slope.with_attribute("few", Float32x3, &few).unwrap().with_attribute("many", Unorm16x2, &many).unwrap()
}

#[test]
fn other_shading_ignores_attributes() {
    let Some(mut rig) = rig("other_shading_ignores_attributes") else { return };
    let rig = &mut *rig;
    let fixed = StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial::default()));
    let to_sun = DVec3::new(0.6, -0.4, 0.9);
    let seen = camera([160, 120], DVec3::new(-9.0, -16.0, 12.0), DVec3::new(0.0, 0.0, 1.0), DVec3::Z);
    let mut draw = |attributes: bool, set: Option<&StateSet>, shadows: bool| {
        // Two triangles, and many that would be packed if they were white.
        let raised = |mut mesh: Mesh, x: f32, z: f32| {
            for vertex in &mut mesh.vertices {
                let [a, b, c] = vertex.position;
                vertex.position = [2.0 * a + x, 2.0 * b, c + z];
            }
            let indices = mesh.indices.to_vec();
            let attributes = std::mem::take(&mut mesh.attributes);
            Mesh { attributes, ..Mesh::new(mesh.vertices, indices, mesh.topology) }
        };
        let all = vec![
            ground(20.0),
            solid(raised(slope(1, attributes), -3.0, 2.0)),
            solid(raised(slope(8, attributes), 2.0, 3.0)),
        ];
        let node = Node::geode(all);
        let node = if let Some(set) = set { node.with_state_set(Arc::new(set.clone())) } else { node };
        let scene = rig.scene(node);
        let environment = sunny(to_sun);
        let environment = if shadows { environment } else { Environment { shadows: None, ..environment } };
        let picture = rig.picture(&scene, &seen, &environment);
        rig.release(scene);
        assert_no_errors(rig);
        picture
    };
    let differing = |a: &RgbaImage, b: &RgbaImage| a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
    let mut lit = None;
    for (set, shadows) in [(None, false), (None, true), (Some(&fixed), false), (Some(&fixed), true)] {
        let [without, with] = [false, true].map(|attributes| draw(attributes, set, shadows));
        assert_eq!(differing(&without, &with), 0, "{set:?} {shadows}");
        // It still casts shadows.
        match lit.take().filter(|_| shadows) {
            Some(lit) => assert!(differing(&lit, &with) > 300, "{set:?}: {}", differing(&lit, &with)),
            None => lit = Some(with),
        }
    }
}

/// A roof above the ground is moved by an attribute, and casts its shadow at the new position.
#[test]
fn vertices_moved_by_a_program_cast_shadows_at_their_new_position() {
    let Some(mut rig) = rig("vertices_moved_by_a_program_cast_shadows_at_their_new_position") else { return };
    let rig = &mut *rig;
    let to_sun = DVec3::new(1.0, 0.5, 1.0);
    let seen = camera([256, 192], DVec3::new(-40.0, -50.0, 45.0), DVec3::new(0.0, 0.0, 2.0), DVec3::Z);
    let wgsl = "
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32, @location(4) place: vec3<f32>)
                -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position + place), 1.0);
        }
        @fragment fn fs_main() -> @location(0) vec4<f32> { return vec4<f32>(1.0, 0.0, 0.0, 1.0); }";
    let set = Arc::new(StateSet::default().with(Attribute::Program(Program::new("moved", wgsl))));
    let mut tower_mesh = Mesh::cuboid(&tower());
    for vertex in &mut tower_mesh.vertices {
        vertex.position[0] -= 30.0;
    }
    let places = vec![[30.0f32, 0.0, 0.0]; tower_mesh.vertices.len()];
    let moved = solid(tower_mesh.with_attribute("place", Float32x3, &places).unwrap());
    let scene =
        rig.scene(Node::group(vec![Node::geode(vec![ground(200.0)]), Node::geode(vec![moved]).with_state_set(set)]));
    let picture = rig.picture(&scene, &seen, &sunny(to_sun));
    let (dark, lit) = kit::shadows::check(&picture, &rig.stage.shadows, &seen, [&[tower()], &[]], to_sun);
    rig.release(scene);
    assert_no_errors(rig);
    assert!(dark > 20 && lit > 5_000, "{dark} dark, {lit} lit");
}

/// The pipelines belong to the layout, not to its slot.
#[test]
fn slots_of_layouts_are_reused() {
    let Some(mut rig) = rig("slots_of_layouts_are_reused") else { return };
    let rig = &mut *rig;
    let set = Arc::new(heat_program());
    for round in 0..40 {
        let before: Vec<_> = FORMATS[round % 26..].iter().map(|(format, ..)| ("pad", *format)).take(1).collect();
        let square =
            |x: f32, before: &[(&str, AttributeFormat)]| heated(quad([x, 0.0, 0.0], [0.3; 2], [1.0; 4]), before);
        // Another layout is used in all rounds.
        let scene = rig.scene(Node::geode(vec![square(-0.5, &before), square(0.5, &[])]).with_state_set(set.clone()));
        let picture = rig.picture(&scene, &unit_camera(SIDE), &black());
        rig.release(scene);
        assert_no_errors(rig);
        assert_eq!([pixel(&picture, 16, 32), pixel(&picture, 48, 32)], [GREEN; 2], "round {round}");
    }
}

#[test]
fn layouts_beyond_the_limit_are_reported_and_the_rest_is_drawn() {
    let Some(mut rig) = rig("layouts_beyond_the_limit_are_reported_and_the_rest_is_drawn") else { return };
    let rig = &mut *rig;
    let named = |i: usize| heated(quad([0.0; 3], [0.5; 2], [1.0; 4]), &[(&format!("pad{i}"), Float32)]);
    let compiled = rig.compile((0..16).map(named).collect());
    assert!(
        matches!(&compiled.errors[..], [e] if e.contains("pad15") && e.contains("15 other lists")),
        "{:?}",
        compiled.errors
    );
    // A known layout still has its slot.
    let known = rig.compile(vec![named(3)]);
    assert_eq!(known.errors, Vec::<String>::new());
    // Four vertices have two more floats each, and there are six indices.
    assert_eq!(known.bytes, 4 * (28 + 8) + 6 * 4);
    rig.ctx.release(&compiled.slots);
    rig.ctx.release(&known.slots);
    let again = rig.compile(vec![named(99)]);
    assert_eq!(again.errors, Vec::<String>::new());
    rig.ctx.release(&again.slots);
}

/// A mesh may have changed since its attribute was checked.
#[test]
fn meshes_with_another_number_of_vertices_than_attributes_fail_to_upload() {
    let Some(mut rig) = rig("meshes_with_another_number_of_vertices_than_attributes_fail_to_upload") else { return };
    let longer = with(heated(quad([0.0; 3], [0.5; 2], [1.0; 4]), &[]), |mut mesh| {
        mesh.vertices.push(MeshVertex::default());
        mesh
    });
    let compiled = rig.compile(vec![longer]);
    let expected = "attribute \"heat\" of Float32 has 16 bytes for 5 vertices of 4 each";
    assert_eq!(compiled.errors, [expected]);
}

/// One mesh is uploaded in several slices, another one replaces that of a drawable with other attributes.
#[test]
fn large_and_changed_meshes_have_their_attributes_at_the_correct_vertices() {
    let Some(mut rig) = rig("large_and_changed_meshes_have_their_attributes_at_the_correct_vertices") else { return };
    let rig = &mut *rig;
    let inputs = "@location(4) place: vec2<f32>";
    let color = "select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), all(place == vertex.position.xy))";
    let set = Arc::new(StateSet::default().with(program("places", inputs, color)));
    let placed = |squares: u32, pads: usize| {
        let plain = slope(squares, false);
        let places: Vec<[f32; 2]> = plain.vertices.iter().map(|v| [v.position[0], v.position[1]]).collect();
        let padded = (0..pads).fold(plain, |mesh, i| {
            let zeros = vec![0u8; 8 * mesh.vertices.len()];
            mesh.with_attribute(&format!("pad{i}"), Uint16x4, &zeros).unwrap()
        });
        padded.with_attribute("place", Float32x2, &places).unwrap()
    };
    let material = Material { unlit: true, double_sided: true, ..Material::default() };
    let mut page = terrane::scene::Page::from_node(
        Node::geode(vec![Drawable::new(placed(150, 1).into(), material)]).with_state_set(set),
    )
    .unwrap();
    let compiled = rig.compile(page.take_drawables());
    let slot = compiled.slots[0];
    page.set_draw_slots(0, compiled.slots);
    let mut scene = terrane::scene::Scene::new();
    scene.add_root(page);
    for changed in [None, Some(placed(2, 3)), Some(placed(60, 0)), Some(slope(3, true)), Some(placed(3, 1))] {
        let lacks = changed.as_ref().is_some_and(|mesh| mesh.attributes.get("place").is_none());
        if let Some(mesh) = changed {
            rig.ctx.rewrite(slot, &Arc::new(mesh)).unwrap();
        }
        let picture = rig.picture(&scene, &unit_camera(SIDE), &black());
        let shown = if lacks { MAGENTA } else { GREEN };
        assert!(count(&picture, shown) > 64 * 64 - 200, "{shown:?}: {}", count(&picture, shown));
        assert_eq!(rig.renderer.take_errors().len(), usize::from(lacks));
    }
    rig.release(scene);
}

/// A primitive mode, its corners, and pixels near which something is drawn and pixels that stay empty.
type Case<'a> = (PrimitiveMode, &'a [[f32; 2]], &'a [[u32; 2]], &'a [[u32; 2]]);

#[test]
fn primitives_of_every_mode_are_drawn() {
    let Some(mut rig) = rig("primitives_of_every_mode_are_drawn") else { return };
    let rig = &mut *rig;
    use PrimitiveMode::*;
    let around = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
    let zigzag = [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]];
    let [center, left, bottom] = [[32, 32], [16, 30], [30, 47]];
    let cases: [Case<'_>; 10] = [
        (Points, &around, &[[16, 47]], &[center, left, bottom]),
        (Lines, &around, &[bottom], &[center, left]),
        (LineStrip, &around, &[bottom], &[center, left]),
        (LineLoop, &around, &[bottom, left], &[center]),
        (Triangles, &around, &[[40, 40]], &[[24, 24]]),
        (TriangleStrip, &zigzag, &[[24, 40], [40, 24], center], &[[10, 10]]),
        (TriangleFan, &around, &[[40, 40], [24, 24], center], &[[10, 10]]),
        (Quads, &around, &[[40, 40], [24, 24], center], &[[10, 10]]),
        (QuadStrip, &zigzag, &[[24, 40], [40, 24], center], &[[10, 10]]),
        (Polygon, &around, &[[40, 40], [24, 24], center], &[[10, 10]]),
    ];
    for (mode, corners, covered, free) in cases {
        let vertex =
            |[x, y]: &[f32; 2]| MeshVertex { position: [*x, *y, 0.0], color: [255; 4], ..MeshVertex::default() };
        let vertices: Vec<MeshVertex> = corners.iter().map(vertex).collect();
        let elements = Mesh::from_elements(mode, vertices.clone(), &[0u8, 1, 2, 3]).unwrap();
        assert_eq!(elements, Mesh::from_arrays(mode, vertices));
        // Materials are single-sided, so back faces are invisible.
        let material = Material { base_color: [0.0, 1.0, 0.0, 1.0], unlit: true, ..Material::default() };
        let scene = rig.scene(Node::geode(vec![Drawable::new(elements.into(), material)]));
        let picture = rig.picture(&scene, &unit_camera(SIDE), &black());
        rig.release(scene);
        let near =
            |[x, y]: &[u32; 2]| (0..9).map(|k| pixel(&picture, x + k % 3 - 1, y + k / 3 - 1)).any(|p| p == GREEN);
        assert!(covered.iter().all(near), "{mode:?}");
        assert!(!free.iter().any(near), "{mode:?}");
    }
}
