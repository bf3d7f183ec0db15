//! Texture units that the fixed function draws: pictures with the pixels that OpenGL's formulas give, and what takes part.

use std::sync::Arc;

use base64::Engine as _;
use kit::frames::pixel;
use kit::rig::{plain, rig, unit_camera};
use terrane::scene::SecondUv;
use terrane::state::{Attribute, StateSet, TexEnv, TexGen};

use super::*;
use kit::osg_files::{VERSION, geode, osgt};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];
const WHITE: [u8; 3] = [255; 3];
/// Texels of an image of 2 x 2, the lowest row first as OSG has them.
const QUARTERS: [[u8; 3]; 4] = [RED, GREEN, BLUE, WHITE];
/// Coordinates from corner to corner of the square.
const CORNERS: &str = "0 0 \n 1 0 \n 1 1 \n 0 1";
/// Planes under which the square has coordinates from 0 to 1.
const PLANES: &str = "PlaneS 1 0 0 0.5 PlaneT 0 1 0 0.5";

/// A texture unit in text.
struct UnitText {
    mode: &'static str,
    texture: String,
    attributes: Vec<String>,
    uvs: Option<&'static str>,
    is_generated: bool,
}

fn image(id: usize, texels: &[[u8; 3]]) -> String {
    let (width, height) = if texels.len() == 4 { (2, 2) } else { (texels.len(), 1) };
    let pixels = base64::engine::general_purpose::STANDARD.encode(texels.concat());
    format!(
        "ClassName osg::Image UniqueID {id} FileName \"\" WriteHint 0 0 Origin 0 Size {width} {height} 1
        InternalTextureFormat 6407 PixelFormat 6407 DataType 5121 Packing 1 AllocationMode 2 Data 1 {{ \"{pixels}\" }}"
    )
}

/// A unit of a texture class with an image.
fn unit_of(class: &str, mode: &'static str, id: usize, texels: &[[u8; 3]]) -> UnitText {
    let image = image(id + 1, texels);
    let texture = format!(
        "osg::{class} {{ UniqueID {id} WRAP_S REPEAT WRAP_T REPEAT MIN_FILTER NEAREST MAG_FILTER NEAREST
        Image TRUE {{ {image} }} }}"
    );
    UnitText { mode, texture, attributes: Vec::new(), uvs: Some(CORNERS), is_generated: false }
}

fn unit(id: usize, texels: &[[u8; 3]]) -> UnitText {
    unit_of("Texture2D", "GL_TEXTURE_2D", id, texels)
}

impl UnitText {
    /// Adds an attribute.
    fn with(mut self, attribute: &str) -> Self {
        self.attributes.push(attribute.to_owned());
        self
    }

    fn with_uvs(self, uvs: &'static str) -> Self {
        Self { uvs: Some(uvs), ..self }
    }

    /// Generates the coordinates instead.
    fn generated(self, members: &str) -> Self {
        let unit = self.with(&format!("osg::TexGen {{ UniqueID 900 {members} }}"));
        Self { uvs: None, is_generated: true, ..unit }
    }
}

/// A square over the middle half of the picture, unlit, with texture units: the state set and the geometry.
fn square_parts(units: &[UnitText]) -> [String; 2] {
    let (mut modes, mut attributes, mut uvs) = (String::new(), String::new(), String::new());
    for (number, unit) in units.iter().enumerate() {
        let generation = "GL_TEXTURE_GEN_S ON GL_TEXTURE_GEN_T ON GL_TEXTURE_GEN_R ON GL_TEXTURE_GEN_Q ON";
        modes += &match unit.is_generated {
            true => format!("Data 5 {{ {} ON {generation} }} ", unit.mode),
            false => format!("Data 1 {{ {} ON }} ", unit.mode),
        };
        let all: Vec<String> =
            std::iter::once(&unit.texture).chain(&unit.attributes).map(|text| format!("{text} Value OFF")).collect();
        attributes += &format!("Data {} {{ {} }} ", all.len(), all.join("\n"));
        let points = unit.uvs.unwrap_or_default();
        let count = points.split('\n').filter(|point| !point.is_empty()).count();
        uvs += &match count {
            0 => "NULL ".to_owned(),
            _ => {
                let width = points.split('\n').next().map_or(0, |point| point.split_whitespace().count());
                format!("osg::Vec{width}Array {{ UniqueID {} vector {count} {{ {points} }} }} ", 800 + number)
            }
        };
    }
    let count = units.len();
    let state = format!(
        "StateSet TRUE {{ osg::StateSet {{ UniqueID 2 ModeList 1 {{ GL_LIGHTING OFF }}
        TextureModeList {count} {{ {modes} }} TextureAttributeList {count} {{ {attributes} }} }} }}"
    );
    let geometry = format!(
        "osg::Geometry {{ UniqueID 10
        PrimitiveSetList 1 {{ osg::DrawArrays {{ UniqueID 11 Mode QUADS Count 4 }} }}
        VertexArray TRUE {{ osg::Vec3Array {{ UniqueID 12 Binding BIND_PER_VERTEX
            vector 4 {{ -0.5 -0.5 0 \n 0.5 -0.5 0 \n 0.5 0.5 0 \n -0.5 0.5 0 }} }} }}
        NormalArray TRUE {{ osg::Vec3Array {{ UniqueID 13 Binding BIND_OVERALL vector 1 {{ 0 0 1 }} }} }}
        TexCoordArrayList {count} {{ {uvs} }} }}"
    );
    [state, geometry]
}

fn square(units: &[UnitText]) -> String {
    let [state, geometry] = square_parts(units);
    osgt(VERSION, &geode(1, &state, &[geometry]))
}

/// Returns the pixels at the lower left, lower right, upper left and upper right of the square.
fn pixels(units: &[UnitText]) -> Option<[[u8; 3]; 4]> {
    let mut rig = rig("texture units of OpenSceneGraph")?;
    let (node, ignored) = read(square(units));
    assert!(ignored.is_empty(), "{ignored:?}");
    let scene = rig.scene(node);
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    Some([(20, 44), (44, 44), (20, 20), (44, 20)].map(|(x, y)| pixel(&picture, x, y)))
}

#[track_caller]
fn assert_color(units: &[UnitText], expected: [u8; 3]) {
    let Some(got) = pixels(units) else { return };
    let is_near = |got: &[u8; 3]| got.iter().zip(expected).all(|(got, want)| got.abs_diff(want) <= 2);
    assert!(got.iter().all(is_near), "{got:?} instead of {expected:?}");
}

#[track_caller]
fn assert_quarters(units: &[UnitText], expected: [[u8; 3]; 4]) {
    let Some(got) = pixels(units) else { return };
    assert_eq!(got, expected);
}

fn state(node: &Node) -> Option<&StateSet> {
    drawables(node)[0].state_set.as_deref()
}

#[test]
fn environments_and_combinations_are_those_of_displayed_colors() {
    let first = || unit(100, &[[51, 204, 128]]);
    let second = |texel: [u8; 3], environment: &str| [first(), unit(200, &[texel]).with(environment)];
    // 51 (1 - 200/255) + 0.9 x 200, and so on.
    assert_color(
        &second([200, 100, 50], "osg::TexEnv { UniqueID 210 Mode BLEND Color 0.9 0.1 0.3 1 }"),
        [191, 134, 118],
    );
    let combine = |members: &str| format!("osg::TexEnvCombine {{ UniqueID 210 {members} }}");
    // 4 (192/255 - 0.5) (1 - 0.5).
    let bump = combine("Combine_RGB DOT3_RGB Source1_RGB CONSTANT ConstantColor 1 0.5 0.5 1");
    assert_color(&second([192, 128, 128], &bump), [129; 3]);
    assert_color(&second([200, 100, 50], &combine("Scale_RGB 2")), [80, 160, 50]);
    assert_color(
        &second([20, 100, 50], &combine("Combine_RGB SUBTRACT Source0_RGB PREVIOUS Source1_RGB TEXTURE")),
        [31, 104, 78],
    );
    assert_color(&second([100, 100, 100], &combine("Combine_RGB ADD_SIGNED")), [24, 177, 101]);
    // A unit reads the texture of another one, which stays in its unit.
    let crossed = combine(
        "Combine_RGB INTERPOLATE Source0_RGB TEXTURE0 Source1_RGB TEXTURE Source2_RGB CONSTANT
        Operand2_RGB SRC_COLOR ConstantColor 0 1 0.5 1",
    );
    assert_color(&second([200, 100, 50], &crossed), [200, 204, 89]);
}

#[test]
fn three_textures_have_coordinates_of_their_own() {
    let (left, right) =
        ("0.25 0.5 \n 0.25 0.5 \n 0.25 0.5 \n 0.25 0.5", "0.75 0.5 \n 0.75 0.5 \n 0.75 0.5 \n 0.75 0.5");
    let middle = "0.5 0 \n 0.5 0 \n 0.5 0 \n 0.5 0";
    let (dark, light) = ([0; 3], [200; 3]);
    let units = [
        unit(100, &[light, dark]).with_uvs(left),
        unit(200, &[dark, light]).with_uvs(right),
        unit(300, &[dark, light, dark]).with_uvs(middle),
        unit(400, &[light, dark]).with_uvs(left),
    ];
    // The fourth power of the light of 200.
    assert_color(&units, [94; 3]);
    let (node, ignored) = read(square(&units));
    assert!(ignored.is_empty(), "the fourth unit has other coordinates, but an equal array: {ignored:?}");
    let attributes = &mesh(drawables(&node)[0]).attributes;
    assert!(attributes.get(SecondUv::ATTRIBUTE).is_some() && attributes.get(SecondUv::THIRD_ATTRIBUTE).is_some());
    assert!(drawables(&node)[0].material.texture.is_some(), "the first texture stays the base colour");
}

#[test]
fn generated_coordinates_are_opengls() {
    let textured = |members: &str| [unit(100, &QUARTERS).generated(members)];
    // Coordinates that meshes can have need no fixed function.
    let object = textured(&format!("Mode OBJECT_LINEAR {PLANES}"));
    assert_quarters(&object, QUARTERS);
    assert!(state(&read(square(&object)).0).is_none());
    let eye = textured(&format!("Mode EYE_LINEAR {PLANES}"));
    assert_quarters(&eye, QUARTERS);
    let set = read(square(&eye)).0;
    assert!(matches!(state(&set).unwrap().attributes[1].0, Attribute::TexGen(0, TexGen::EyeLinear(_))));
    // The square reflects what is behind the eye: to the right of it on the right, above it above.
    assert_quarters(&textured("Mode SPHERE_MAP"), QUARTERS);
    // Under a second texture too.
    assert_quarters(&[unit(100, &[WHITE]), unit(200, &QUARTERS).generated("Mode SPHERE_MAP")], QUARTERS);
}

#[test]
fn cube_maps_are_seen_in_the_direction_of_reflections_and_normals() {
    let cube = |generator: &str| {
        let mut unit = unit_of("TextureCubeMap", "GL_TEXTURE_CUBE_MAP", 100, &[WHITE]);
        let faces = ["PosX", "NegX", "PosY", "NegY", "PosZ", "NegZ"];
        let faces = faces.iter().enumerate().map(|(i, name)| {
            let texels = if *name == "PosZ" { QUARTERS } else { [[0; 3]; 4] };
            format!("{name} TRUE {{ {} }} ", image(120 + i, &texels))
        });
        unit.texture = format!(
            "osg::TextureCubeMap {{ UniqueID 100 MIN_FILTER NEAREST MAG_FILTER NEAREST {} }}",
            faces.collect::<String>()
        );
        [unit.generated(generator)]
    };
    // The rows of +z go against y, and OSG's first row is the lowest of the image.
    assert_quarters(&cube("Mode REFLECTION_MAP"), [BLUE, WHITE, RED, GREEN]);
    let (node, ignored) = read(square(&cube("Mode NORMAL_MAP")));
    assert!(ignored.is_empty(), "{ignored:?}");
    assert!(matches!(state(&node).unwrap().attributes[1].0, Attribute::TexGen(0, TexGen::NormalMap)));
}

#[test]
fn volumes_are_cut_at_their_third_coordinate() {
    let volume = || {
        let texels = [QUARTERS, [BLUE; 4]].concat();
        let mut unit = unit_of("Texture3D", "GL_TEXTURE_3D", 100, &texels);
        unit.texture = unit.texture.replace("Size 8 1 1", "Size 2 2 2");
        unit
    };
    for (r, expected) in [(0.25, QUARTERS), (0.75, [BLUE; 4])] {
        let planes = format!("Mode OBJECT_LINEAR {PLANES} PlaneR 0 0 0 {r}");
        assert_quarters(&[volume().generated(&planes)], expected);
    }
    assert_quarters(&[volume().with_uvs("0 0 0.25 \n 1 0 0.25 \n 1 1 0.25 \n 0 1 0.25")], QUARTERS);
    assert_color(&[volume().with_uvs("0 0 0.75 \n 1 0 0.75 \n 1 1 0.75 \n 0 1 0.75")], BLUE);
    let (_, ignored) = read(square(&[volume().with_uvs("0 0 0 \n 1 0 0 \n 1 1 1 \n 0 1 1")]));
    assert_eq!(ignored.count("OpenSceneGraph: volume whose third coordinate varies (its front is drawn)"), 1);
}

#[test]
fn matrices_move_coordinates_of_any_kind() {
    let half = "osg::TexMat { UniqueID 110 Matrix { 1 0 0 0 \n 0 1 0 0 \n 0 0 1 0 \n 0.5 0 0 1 } }";
    let turned = [GREEN, RED, WHITE, BLUE];
    // The base colour, a second texture over coordinates that it shares, and the fixed function.
    assert_quarters(&[unit(100, &QUARTERS).with(half)], turned);
    assert!(state(&read(square(&[unit(100, &QUARTERS).with(half)])).0).is_none());
    assert_quarters(&[unit(100, &[WHITE]), unit(200, &QUARTERS).with(half)], turned);
    assert_quarters(&[unit(100, &QUARTERS).generated(&format!("Mode EYE_LINEAR {PLANES}")).with(half)], turned);
    let third = [unit(100, &[WHITE]), unit(200, &[WHITE]), unit(300, &QUARTERS).with(half)];
    assert_quarters(&third, turned);
    let (node, _) = read(square(&third));
    assert!(mesh(drawables(&node)[0]).attributes.get(SecondUv::ATTRIBUTE).is_none(), "all share the coordinates");
}

#[test]
fn rectangles_are_counted_in_texels_and_rows_in_one_coordinate() {
    let rectangle = |id| unit_of("TextureRectangle", "GL_TEXTURE_RECTANGLE", id, &QUARTERS);
    assert_quarters(&[rectangle(100).with_uvs("0 0 \n 2 0 \n 2 2 \n 0 2")], QUARTERS);
    let row = unit_of("Texture1D", "GL_TEXTURE_1D", 100, &[RED, BLUE]);
    assert_quarters(&[row], [RED, BLUE, RED, BLUE]);
    // In the fixed function.
    let eye = "Mode EYE_LINEAR PlaneS 2 0 0 1 PlaneT 0 2 0 1";
    assert_quarters(&[rectangle(100).generated(eye)], QUARTERS);
}

#[test]
fn units_that_cannot_be_drawn_have_a_name() {
    let left_out = |units: &[UnitText]| {
        let (node, ignored) = read(square(units));
        (node, ignored.iter().map(|(kind, _)| kind.to_owned()).collect::<Vec<_>>())
    };
    let five = [100, 200, 300, 400, 500, 600].map(|id| unit(id, &[WHITE]));
    let (node, kinds) = left_out(&five);
    assert_eq!(kinds, ["OpenSceneGraph: texture of a fifth unit"]);
    let textures = state(&node).unwrap().attributes.iter().filter(|(a, _)| matches!(a, Attribute::Texture(..)));
    assert_eq!(textures.count(), 4, "beside the base colour");
    let unknown = unit(200, &[WHITE]).with("osg::TexEnvCombine { UniqueID 210 Combine_RGB CLAMP }");
    let (node, kinds) = left_out(&[unit(100, &[RED]), unknown]);
    assert_eq!(kinds, ["OpenSceneGraph: TexEnvCombine of an unknown function"]);
    assert!(drawables(&node)[0].material.texture.is_some() && state(&node).is_none());
    let endless = "osg::TexMat { UniqueID 910 Matrix { inf 0 0 0 \n 0 1 0 0 \n 0 0 1 0 \n 0 0 0 1 } }";
    let moved = [unit(100, &[WHITE]).with(endless)];
    assert_eq!(left_out(&moved).1, ["OpenSceneGraph: texture with a TexMat that is not finite"]);
    let two = [unit(100, &[WHITE]), unit(200, &[WHITE]).with_uvs(""), unit(300, &[WHITE]).generated("Mode SPHERE_MAP")];
    assert_eq!(left_out(&two).1, ["OpenSceneGraph: texture of a unit without texture coordinates"]);
}

#[test]
fn drawables_of_equal_state_share_the_set() {
    let [state, geometry] = square_parts(&[unit(100, &QUARTERS).generated("Mode SPHERE_MAP")]);
    let second = geometry.replace("UniqueID 1", "UniqueID 5");
    let (node, _) = read(osgt(VERSION, &geode(1, &state, &[geometry, second])));
    let sets: Vec<_> = drawables(&node).iter().map(|drawable| drawable.state_set.clone().unwrap()).collect();
    assert!(sets.len() == 2 && Arc::ptr_eq(&sets[0], &sets[1]), "{sets:?}");
}

#[test]
fn highlights_keep_their_textures() {
    let material = "ModeList 1 { GL_LIGHTING ON } AttributeList 1 { osg::Material { UniqueID 70
        Specular TRUE Front 1 1 1 1 Back 1 1 1 1 Shininess TRUE Front 40 Back 40 } Value OFF }";
    let text = square(&[unit(100, &[RED]), unit(200, &[WHITE])]).replace("ModeList 1 { GL_LIGHTING OFF }", material);
    let (node, ignored) = read(text);
    assert!(ignored.is_empty(), "{ignored:?}");
    let drawable = drawables(&node)[0];
    assert!(drawable.material.texture.is_some() && drawable.material.metallic_roughness.is_none());
    let attributes = &drawable.state_set.as_ref().unwrap().attributes;
    assert!(matches!(attributes[..], [(Attribute::Texture(0, _), _)]), "a product is the default: {attributes:?}");
    let added = square(&[unit(100, &[RED]), unit(200, &[WHITE]).with("osg::TexEnv { UniqueID 210 Mode ADD }")]);
    let (node, _) = read(added.replace("ModeList 1 { GL_LIGHTING OFF }", material));
    let attributes = &state(&node).unwrap().attributes;
    assert!(matches!(attributes[1].0, Attribute::TexEnv(0, TexEnv::Combine(combine)) if combine.is_displayed));
}
