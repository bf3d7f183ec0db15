//! State sets, materials and images.

use std::sync::Arc;

use base64::Engine as _;
use terrane::scene::{AlphaMode, OverlayMode, SecondUv, Texture, Topology};
use terrane::state::{
    Attribute, BinDetails, BlendEquation, BlendFactor, CompareFunction, CullFace, FilterMode, Fog, FogMode, LightModel,
    Mode, PolygonMode, SortMode, StateSet, StateValue, WrapMode,
};

use super::*;
use kit::osg_files::{Osgb, VERSION, geode, group, osgt, triangle};

fn state_set(id: u32, members: &str) -> String {
    format!("StateSet TRUE {{ osg::StateSet {{ UniqueID {id} {members} }} }}")
}

/// The graph of a geode with one triangle and a state set.
fn with_state(members: &str) -> (Node, Ignored) {
    read(osgt(VERSION, &geode(1, &state_set(2, members), &[triangle(10, "")])))
}

fn set(node: &Node) -> &StateSet {
    node.state_set.as_deref().expect("a state set")
}

#[test]
fn modes_attributes_and_bins_keep_their_flags() {
    let (node, ignored) = with_state(
        "ModeList 4 { GL_CULL_FACE ON|OVERRIDE GL_DEPTH_TEST OFF|PROTECTED GL_BLEND ON GL_POINT_SMOOTH ON }
        AttributeList 3 {
            osg::CullFace { UniqueID 3 Mode FRONT } Value OVERRIDE
            osg::BlendFunc { UniqueID 4 SourceRGB ONE SourceAlpha ONE DestinationRGB ONE DestinationAlpha ZERO } Value OFF
            osg::Depth { UniqueID 5 Function GEQUAL WriteMask FALSE } Value OFF }
        RenderingHint 2 RenderBinMode OVERRIDE_RENDERBIN_DETAILS BinNumber 11 BinName \"DepthSortedBin\"",
    );
    let set = set(&node);
    let on_above_all = StateValue::ON | StateValue::OVERRIDE;
    for (mode, value) in [
        (Mode::CullFace, on_above_all),
        (Mode::DepthTest, StateValue::OFF | StateValue::PROTECTED),
        (Mode::Blend, StateValue::ON),
    ] {
        assert!(set.modes.contains(&(mode, value)), "{mode:?}: {:?}", set.modes);
    }
    assert_eq!(set.attributes[0], (Attribute::CullFace(CullFace::Front), on_above_all));
    let Attribute::BlendFunc(blend) = &set.attributes[1].0 else { panic!("{:?}", set.attributes) };
    assert_eq!((blend.source, blend.destination_alpha), (BlendFactor::One, BlendFactor::Zero));
    let Attribute::Depth(depth) = &set.attributes[2].0 else { panic!("{:?}", set.attributes) };
    assert_eq!((depth.function, depth.write), (CompareFunction::GreaterOrEqual, false));
    assert_eq!((set.bin, set.bin_value), (Some(BinDetails::new(11, SortMode::BackToFront)), on_above_all));
    assert_eq!(ignored.iter().collect::<Vec<_>>(), [("OpenSceneGraph: mode 0xb10", 1)]);
    // A hint alone selects a bin too.
    let (node, _) = with_state("RenderingHint 2");
    assert_eq!(self::set(&node).bin, Some(BinDetails::TRANSPARENT));
}

#[test]
fn fog_and_light_models_are_state() {
    let attributes = "AttributeList 5 {
        osg::Fog { UniqueID 3 Mode EXP Density 0.5 Color 1 0 0 1 FogCoordinateSource DEPTH } Value OFF
        osg::LightModel { UniqueID 4 AmbientIntensity 1 1 0 1 ColorControl SEPARATE_SPECULAR_COLOR TwoSided TRUE } Value OFF
        osg::PolygonMode { UniqueID 5 Mode UseFrontAndBack TRUE Front LINE Back LINE } Value OFF
        osg::BlendColor { UniqueID 6 ConstantColor 0 1 0 0.5 } Value OFF
        osg::BlendEquation { UniqueID 7 EquationRGB RGBA_MAX EquationAlpha RGBA_MAX } Value OFF }";
    let (node, ignored) = with_state(&format!("ModeList 1 {{ GL_FOG ON }} {attributes}"));
    assert!(ignored.is_empty(), "{ignored:?}");
    let fog = Fog { mode: FogMode::Exp { density_per_m: 0.5 }, color: [1.0, 0.0, 0.0], is_displayed: true };
    let model = LightModel {
        ambient: [1.0, 1.0, 0.0],
        two_sided: true,
        color_control: terrane::state::ColorControl::SeparateSpecularColor,
        ..LightModel::default()
    };
    let expected = [
        Attribute::Fog(fog),
        Attribute::LightModel(model),
        Attribute::PolygonMode(PolygonMode::Line),
        Attribute::BlendColor([0.0, 1.0, 0.0, 0.5]),
        Attribute::BlendEquation(BlendEquation::Max),
    ];
    let found: Vec<Attribute> = set(&node).attributes.iter().map(|(attribute, _)| attribute.clone()).collect();
    assert_eq!(found, expected);
    // Text without a mode of the Fog is LINEAR, which OSG's writer leaves out.
    let linear = attributes.replace("Mode EXP Density 0.5", "Start 2 End 6");
    let (node, _) = with_state(&format!("ModeList 1 {{ GL_FOG ON }} {linear}"));
    let fog = Fog { mode: FogMode::Linear { start_m: 2.0, end_m: 6.0 }, ..fog };
    assert_eq!(self::set(&node).attributes[0].0, Attribute::Fog(fog));
    // OSG's fog needs its mode, while the haze of the environment stays on.
    for modes in ["", "ModeList 1 { GL_FOG OFF }"] {
        let (node, _) = with_state(&format!("{modes} {attributes}"));
        let set = set(&node);
        assert_eq!((set.attributes.len(), set.modes.len()), (4, 0), "{modes}: {set:?}");
    }
}

#[test]
fn points_have_the_size_of_their_state() {
    let point = |members: &str| format!("AttributeList 1 {{ osg::Point {{ UniqueID 3 {members} }} Value OFF }}");
    let points = triangle(10, "").replace("Mode TRIANGLES", "Mode POINTS");
    let read_points = |state: &str| {
        let state = format!("StateSet TRUE {{ osg::StateSet {{ UniqueID 2 {state} }} }}");
        read(osgt(VERSION, &geode(1, &state, std::slice::from_ref(&points))))
    };
    let (node, ignored) = read_points(&point("Size 6 DistanceAttenuation 1 0 0 MaxSize 100"));
    assert!(ignored.is_empty(), "{ignored:?}");
    let squares = mesh(drawables(&node)[0]);
    assert_eq!((squares.topology, squares.vertices.len(), squares.indices.len()), (Topology::Squares, 12, 18));
    // Offsets of the corners in pixels.
    assert_eq!((squares.vertices[0].uv, squares.vertices[3].uv), ([-3.0; 2], [3.0; 2]));
    let plain = mesh(drawables(&read_points("").0)[0]).clone();
    assert_eq!((plain.topology, plain.vertices.len()), (Topology::Points, 3));
    for i in 0..3 {
        assert_eq!(squares.vertices[4 * i].position, plain.vertices[i].position);
    }
    assert_eq!(mesh(drawables(&read_points(&point("Size 1")).0)[0]).topology, Topology::Points);
    let (node, ignored) = read_points(&point("Size 6 DistanceAttenuation 1 0 0.5"));
    assert_eq!(mesh(drawables(&node)[0]).topology, Topology::Points);
    assert_eq!(ignored.count("OpenSceneGraph: attribute Point"), 1, "{ignored:?}");
}

#[test]
fn materials_of_drawables_follow_the_state_above() {
    let plain = read(osgt(VERSION, &geode(1, "", &[triangle(10, "")]))).0;
    let material = &drawables(&plain)[0].material;
    // OSG culls no faces and lights by default.
    assert!(material.double_sided && !material.unlit && material.alpha == AlphaMode::Opaque);

    let material = |members: &str| {
        let (node, ignored) = with_state(members);
        assert!(ignored.is_empty(), "{ignored:?}");
        drawables(&node)[0].material.clone()
    };
    let unlit = material("ModeList 2 { GL_LIGHTING OFF GL_CULL_FACE ON }");
    assert!(unlit.unlit && !unlit.double_sided);
    assert_eq!(material("ModeList 1 { GL_BLEND ON }").alpha, AlphaMode::Blend);
    let alpha = "AttributeList 1 { osg::AlphaFunc { UniqueID 3 Function GREATER ReferenceValue 0.25 } Value OFF }";
    assert_eq!(material(&format!("ModeList 1 {{ GL_ALPHA_TEST ON }} {alpha}")).alpha, AlphaMode::Mask(0.25));
    assert_eq!(material(alpha).alpha, AlphaMode::Opaque, "the mode is off");
    let red = material(
        "AttributeList 1 { osg::Material { UniqueID 3 Ambient TRUE Front 0 0 0 1 Back 0 0 0 1
        Diffuse TRUE Front 1 0 0 0.5 Back 1 0 0 0.5 } Value OFF }",
    );
    assert_eq!(red.base_color, [1.0, 0.0, 0.0, 0.5]);
}

#[test]
fn overrides_win_over_what_is_below_unless_it_is_protected() {
    let below = |flags: &str| state_set(3, &format!("ModeList 1 {{ GL_LIGHTING {flags} }}"));
    for (flags, is_lit) in [("ON", false), ("ON|PROTECTED", true)] {
        let inner = geode(4, &below(flags), &[triangle(10, "")]);
        let above = state_set(2, "ModeList 1 { GL_LIGHTING OFF|OVERRIDE }");
        let (node, _) =
            read(osgt(VERSION, &group(1, &[inner]).replace("UniqueID 1 ", &format!("UniqueID 1 {above} "))));
        assert_eq!(!drawables(&node)[0].material.unlit, is_lit, "{flags}");
    }
}

#[test]
fn highlights_and_glows_take_the_fixed_function() {
    let (node, _) = with_state(
        "AttributeList 1 { osg::Material { UniqueID 3 Diffuse TRUE Front 0.9 0.2 0.1 1 Back 0.9 0.2 0.1 1
        Specular TRUE Front 1 1 1 1 Back 1 1 1 1 Shininess TRUE Front 40 Back 40 } Value OFF }",
    );
    let Attribute::SurfaceMaterial(surface) = &set(&node).attributes[0].0 else { panic!("{:?}", set(&node)) };
    assert_eq!((surface.specular, surface.shininess), ([1.0; 3], 40.0));
    assert_eq!(drawables(&node)[0].material.base_color, [1.0; 4], "the colour is not applied twice");
}

#[test]
fn vertex_colors_are_shown_where_opengl_shows_them() {
    let colors = "ColorArray TRUE { osg::Vec4Array { UniqueID 20 Binding BIND_OVERALL vector 1 { 0 1 0 1 } } }";
    let color = |members: &str| {
        let (node, _) = read(osgt(VERSION, &geode(1, &state_set(2, members), &[triangle(10, colors)])));
        let drawable = drawables(&node)[0];
        (mesh(drawable).vertices[0].color, drawable.material.base_color[0])
    };
    let blue = |mode: &str| {
        format!(
            "AttributeList 1 {{ osg::Material {{ UniqueID 3 {mode} Diffuse TRUE Front 0 0 1 1 Back 0 0 1 1 }} Value OFF }}"
        )
    };
    let (green, white) = ([0, 255, 0, 255], [255; 4]);
    assert_eq!(color(""), (green, 1.0));
    assert_eq!(color(&blue("")), (white, 0.0), "a material hides vertex colours");
    assert_eq!(color(&blue("ColorMode AMBIENT_AND_DIFFUSE")), (green, 1.0));
    assert_eq!(color(&format!("ModeList 1 {{ GL_LIGHTING OFF }} {}", blue(""))), (green, 1.0), "it needs light");
}

/// The texture of the first drawable of a graph.
fn texture(node: &Node) -> Option<&Arc<Texture>> {
    drawables(node)[0].material.texture.as_ref()
}

/// A state set in text with a texture of unit 0.
fn textured(image: &str) -> String {
    format!(
        "TextureModeList 1 {{ Data 1 {{ GL_TEXTURE_2D ON }} }}
        TextureAttributeList 1 {{ Data 1 {{ osg::Texture2D {{ UniqueID 30 WRAP_S REPEAT WRAP_T MIRROR WRAP_R CLAMP
            MIN_FILTER LINEAR MAG_FILTER NEAREST {image} }} Value OFF }} }}"
    )
}

#[test]
fn pixels_in_text_are_a_texture_that_starts_at_the_bottom() {
    let pixels = base64::engine::general_purpose::STANDARD.encode([255u8, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9]);
    let image = format!(
        "Image TRUE {{ ClassName osg::Image UniqueID 31 FileName \"\" WriteHint 0 0 Origin 0 Size 2 2 1
        InternalTextureFormat 6407 PixelFormat 6407 DataType 5121 Packing 1 AllocationMode 2
        Data 1 {{ \"{pixels}\" }} Name \"tiny\" }}"
    );
    let uvs = "TexCoordArrayList 1 { osg::Vec2Array { UniqueID 20 vector 3 { 0 0 \n 1 0 \n 0 1 } } }";
    let (node, ignored) = read(osgt(VERSION, &geode(1, &state_set(2, &textured(&image)), &[triangle(10, uvs)])));
    assert!(ignored.is_empty(), "{ignored:?}");
    let texture = texture(&node).unwrap();
    assert_eq!((texture.width, texture.height, texture.mips.len()), (2, 2, 1));
    // The first row has t = 0, and so v = 0.
    assert_eq!(texture.mips[0][..8], [255, 0, 0, 255, 0, 255, 0, 255]);
    assert_eq!(mesh(drawables(&node)[0]).vertices[2].uv, [0.0, 1.0]);
    let sampling = texture.sampling;
    assert_eq!(sampling.wrap, [WrapMode::Repeat, WrapMode::Mirror]);
    assert_eq!((sampling.min, sampling.mag, sampling.mip), (FilterMode::Linear, FilterMode::Nearest, None));
    // Without its mode the texture is off.
    let off = textured(&image).replace("GL_TEXTURE_2D ON", "GL_TEXTURE_2D OFF");
    let (node, _) = read(osgt(VERSION, &geode(1, &state_set(2, &off), &[triangle(10, uvs)])));
    assert!(self::texture(&node).is_none());
}

/// A state set in text with a texture of each unit: the red of its only pixel, and the mode of its environment.
fn units(units: &[(u8, &str)]) -> String {
    let image = |(unit, (red, _)): (usize, &(u8, &str))| {
        let pixel = base64::engine::general_purpose::STANDARD.encode([*red, 0, 0]);
        format!(
            "Image TRUE {{ ClassName osg::Image UniqueID {} FileName \"\" WriteHint 0 0 Origin 0 Size 1 1 1
            InternalTextureFormat 6407 PixelFormat 6407 DataType 5121 Packing 1 AllocationMode 2 Data 1 {{ \"{pixel}\" }} }}",
            40 + unit
        )
    };
    let of_unit = |(unit, of): (usize, &(u8, &str))| {
        let (texture, environment) = (50 + unit, 60 + unit);
        format!(
            "Data 2 {{ osg::Texture2D {{ UniqueID {texture} {} }} Value OFF
            osg::TexEnv {{ UniqueID {environment} Mode {} }} Value OFF }}",
            image((unit, of)),
            of.1
        )
    };
    let count = units.len();
    let modes = "Data 1 { GL_TEXTURE_2D ON } ".repeat(count);
    let attributes: Vec<String> = units.iter().enumerate().map(of_unit).collect();
    format!("TextureModeList {count} {{ {modes} }} TextureAttributeList {count} {{ {} }}", attributes.join(" "))
}

/// Texture coordinates of two units; in the second one t differs.
const TWO_UVS: &str = "TexCoordArrayList 2 { osg::Vec2Array { UniqueID 20 vector 3 { 0 0 \n 1 0 \n 0 1 } }
    osg::Vec2Array { UniqueID 21 vector 3 { 0 0.25 \n 1 0.5 \n 0 1 } } }";

#[test]
fn second_texture_changes_the_first_by_its_environment() {
    let graph =
        |of: &[(u8, &str)], uvs: &str| read(osgt(VERSION, &geode(1, &state_set(2, &units(of)), &[triangle(10, uvs)])));
    let second_uv = |node: &Node| {
        let bytes = mesh(drawables(node)[0]).attributes.get(SecondUv::ATTRIBUTE).map(|found| found.1.to_vec());
        bytes
            .map(|bytes| bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect::<Vec<f32>>())
    };
    for (environment, mode) in
        [("MODULATE", OverlayMode::Multiply), ("DECAL", OverlayMode::Over), ("ADD", OverlayMode::Add)]
    {
        let (node, ignored) = graph(&[(100, "MODULATE"), (200, environment)], TWO_UVS);
        assert!(ignored.is_empty(), "{ignored:?}");
        let material = &drawables(&node)[0].material;
        assert_eq!(material.texture.as_ref().unwrap().mips[0][0], 100);
        let surface = material.metallic_roughness.as_ref().unwrap();
        assert_eq!((surface.overlay.as_ref().unwrap().mips[0][0], surface.overlay_mode), (200, mode));
        // Pixels in the file begin with t = 0.
        assert_eq!(mesh(drawables(&node)[0]).vertices[2].uv, [0.0, 1.0]);
        assert_eq!(second_uv(&node).unwrap(), [0.0, 0.25, 1.0, 0.5, 0.0, 1.0]);
    }
    // A texture that replaces everything is shown without light and with its own coordinates.
    let (node, _) = graph(&[(100, "MODULATE"), (200, "REPLACE")], TWO_UVS);
    let drawable = drawables(&node)[0];
    let material = &drawable.material;
    assert!(material.unlit && material.metallic_roughness.is_none());
    assert_eq!((material.texture.as_ref().unwrap().mips[0][0], mesh(drawable).vertices[1].uv), (200, [1.0, 0.5]));

    let one_uv = "TexCoordArrayList 1 { osg::Vec2Array { UniqueID 20 vector 3 { 0 0 \n 1 0 \n 0 1 } } }";
    let (node, ignored) = graph(&[(1, "MODULATE"), (2, "ADD")], one_uv);
    assert!(drawables(&node)[0].material.metallic_roughness.is_none());
    assert_eq!(ignored.count("OpenSceneGraph: texture of a unit without texture coordinates"), 1);
}

/// The first unit has the lit colour below it.
#[test]
fn one_texture_covers_or_adds_to_the_material_by_its_environment() {
    for (environment, mode) in [("DECAL", OverlayMode::Over), ("ADD", OverlayMode::Add)] {
        let members = units(&[(100, environment)]);
        let (node, ignored) = read(osgt(VERSION, &geode(1, &state_set(2, &members), &[triangle(10, TWO_UVS)])));
        assert!(ignored.is_empty(), "{ignored:?}");
        let drawable = drawables(&node)[0];
        let surface = drawable.material.metallic_roughness.as_ref().unwrap();
        assert!(drawable.material.texture.is_none());
        assert_eq!((surface.overlay.as_ref().unwrap().mips[0][0], surface.overlay_mode), (100, mode));
        // Its coordinates are the only ones.
        assert_eq!(mesh(drawable).vertices[2].uv, [0.0, 1.0]);
        assert!(mesh(drawable).attributes.get(SecondUv::ATTRIBUTE).is_none());
    }
}

/// A state set with two textures, the second of which has a TexEnvCombine.
fn combined(members: &str) -> (Node, Ignored) {
    let environment = "osg::TexEnv { UniqueID 61 Mode COMBINE }";
    let state = units(&[(100, "MODULATE"), (200, "COMBINE")]);
    assert!(state.contains(environment));
    let state = state.replace(environment, &format!("osg::TexEnvCombine {{ UniqueID 61 {members} }}"));
    read(osgt(VERSION, &geode(1, &state_set(2, &state), &[triangle(10, TWO_UVS)])))
}

#[test]
fn tex_env_combine_is_the_environment_that_it_equals() {
    let overlay = |members: &str| {
        let (node, ignored) = combined(members);
        assert!(ignored.is_empty(), "{members}: {ignored:?}");
        let material = drawables(&node)[0].material.clone();
        let of_surface =
            |surface: &terrane::scene::MetallicRoughness| Some((surface.overlay.clone()?, surface.overlay_mode));
        let found =
            material.metallic_roughness.as_ref().and_then(of_surface).map(|(image, mode)| (image.mips[0][0], mode));
        (material.texture.unwrap().mips[0][0], found)
    };
    let own = "Source0_RGB TEXTURE1 Source1_RGB PREVIOUS";
    let colors = "Operand0_RGB SRC_COLOR Operand1_RGB SRC_COLOR";
    for (members, mode) in [
        // OSG's defaults: the texture by the colour below.
        ("", OverlayMode::Multiply),
        ("Combine_RGB MODULATE Source0_RGB PREVIOUS Source1_RGB TEXTURE", OverlayMode::Multiply),
        (&format!("Combine_RGB ADD {own} {colors}"), OverlayMode::Add),
        (
            &format!("Combine_RGB INTERPOLATE {own} Source2_RGB TEXTURE {colors} Operand2_RGB SRC_ALPHA"),
            OverlayMode::Over,
        ),
        (
            "Combine_RGB INTERPOLATE Source0_RGB PREVIOUS Source1_RGB TEXTURE Source2_RGB TEXTURE
             Operand2_RGB ONE_MINUS_SRC_ALPHA",
            OverlayMode::Over,
        ),
    ] {
        assert_eq!(overlay(members), (100, Some((200, mode))), "{members}");
    }
    assert_eq!(overlay("Combine_RGB REPLACE"), (200, None));
    assert_eq!(overlay("Combine_RGB REPLACE Source0_RGB PREVIOUS"), (100, None), "the texture is not used");
    assert_eq!(overlay("Source1_RGB PRIMARY_COLOR"), (200, None), "the first texture is not used");

    // Others take the fixed function.
    for members in [
        "Combine_RGB DOT3_RGB",
        "Combine_RGB SUBTRACT",
        "Operand0_RGB SRC_ALPHA",
        "Source0_RGB CONSTANT",
        "Scale_RGB 2",
    ] {
        let (node, ignored) = combined(members);
        assert!(ignored.is_empty(), "{members}: {ignored:?}");
        let drawable = drawables(&node)[0];
        assert_eq!(drawable.material.texture.as_ref().unwrap().mips[0][0], 100, "the first texture stays");
        assert!(drawable.material.metallic_roughness.is_none() && drawable.state_set.is_some(), "{members}");
    }
}

/// Photographs of a surface without normals have their light in them.
#[test]
fn textures_without_normals_are_not_lit() {
    let uvs = "TexCoordArrayList 1 { osg::Vec2Array { UniqueID 20 vector 3 { 0 0 \n 1 0 \n 0 1 } } }";
    let normals = "NormalArray TRUE { osg::Vec3Array { UniqueID 22 Binding BIND_OVERALL vector 1 { 0 0 1 } } }";
    let is_unlit = |state: &str, members: &str| {
        let (node, _) = read(osgt(VERSION, &geode(1, &state_set(2, state), &[triangle(10, members)])));
        drawables(&node)[0].material.unlit
    };
    let textured = units(&[(100, "MODULATE")]);
    assert!(is_unlit(&textured, uvs));
    assert!(!is_unlit(&textured, &format!("{normals} {uvs}")) && !is_unlit("", uvs));
}

#[test]
fn images_beside_the_file_are_fetched_with_it() {
    let image = "Image TRUE { ClassName osg::Image UniqueID 31 FileName \"textures\\\\a b.png\" WriteHint 2 2 }";
    let uvs = "TexCoordArrayList 1 { osg::Vec2Array { UniqueID 20 vector 3 { 0 0 \n 1 0 \n 0 1 } } }";
    let text = osgt(VERSION, &geode(1, &state_set(2, &textured(image)), &[triangle(10, uvs)]));
    let needed = terrane::formats::dependencies(URI, text.as_bytes(), None, &[], &options());
    assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["/set/textures/a b.png"]);
    let png = crate::gltf_builder::png(4, [1, 2, 3]);
    let companions = vec![(needed[0].clone(), Ok(png))];
    let (node, ignored) = read_with(text.as_bytes(), companions, &options()).unwrap();
    assert!(ignored.is_empty(), "{ignored:?}");
    assert_eq!(texture(&node).unwrap().mips[0][..4], [1, 2, 3, 255]);
    // OSG turns files over, so that t = 1 is at the first row.
    assert_eq!(mesh(drawables(&node)[0]).vertices[2].uv, [0.0, 0.0]);
    let (node, ignored) = read(text);
    assert!(texture(&node).is_none());
    assert_eq!(ignored.count("OpenSceneGraph: external image that is missing"), 1);
}

/// A binary file with a state set whose texture has a given image.
fn binary_image(write_image: impl FnOnce(&mut Osgb)) -> Vec<u8> {
    let mut file = Osgb::new(100, true);
    file.object("osg::Group", 1, |file| {
        file.object_members("").raw(&[0, 0, 0, 0, 0, 1]).u32(u32::MAX).raw(&[1]);
        file.object("osg::StateSet", 2, |file| {
            // No modes and attributes; the mode of unit 0, and its texture.
            file.object_members("").raw(&[0, 0]);
            file.raw(&[1]).u32(1).block(|file| {
                file.u32(1).block(|file| {
                    file.u32(0xde1).u32(1);
                });
            });
            file.raw(&[1]).u32(1).block(|file| {
                file.u32(1).block(|file| {
                    file.object("osg::Texture2D", 3, |file| {
                        file.object_members("").raw(&[0, 0]);
                        for (mode, value) in [(1u8, 0x2901), (1, 0x2901), (1, 0x2901), (1, 0x2703), (1, 0x2601)] {
                            file.raw(&[mode]).u32(value);
                        }
                        file.f32s(&[1.0]).raw(&[1, 0, 0, 1]).f64s(&[0.0; 4]).u32(0).u32(0);
                        // No formats, no shadow, no attachment; a swizzle.
                        file.raw(&[0, 0, 0, 0]).u32(0x203).u32(0x1909).f32s(&[0.0]).raw(&[0, 1]).text("RGBA");
                        file.raw(&[1]);
                        write_image(file);
                        file.u32(0).u32(0);
                    });
                    file.u32(0);
                });
            });
            // No uniforms, no hint, no bin.
            file.raw(&[0]).u32(0).u32(0).u32(0).text("").raw(&[1, 0, 0]);
        });
        file.children(1, |file| {
            file.triangle_geode(10);
        });
    });
    file.bytes
}

fn image_file(file: &mut Osgb, name: &str, bytes: &[u8]) {
    file.text("osg::Image").u32(4).text(name).u32(1).u32(1).u32(bytes.len() as u32).raw(bytes).object_members("");
}

#[test]
fn image_files_and_pixels_in_binary_are_read() {
    let png = crate::gltf_builder::png(4, [7, 8, 9]);
    let (node, ignored) = read(binary_image(|file| image_file(file, "a.png", &png)));
    assert!(ignored.is_empty(), "{ignored:?}");
    let texture = self::texture(&node).unwrap();
    assert_eq!((texture.width, texture.mips.len(), &texture.mips[0][..4]), (4, 3, &[7, 8, 9, 255][..]));

    // Pixels of DXT1: two red and blue blocks, with the offset of a level.
    let blocks = [[0x00, 0xf8, 0x1f, 0x00, 0, 0, 0, 0], [0x00, 0xf8, 0x1f, 0x00, 0x55, 0x55, 0x55, 0x55]].concat();
    let raw = |format: u32| {
        let blocks = blocks.clone();
        binary_image(move |file| {
            file.text("osg::Image").u32(4).text("").u32(1).u32(0);
            for word in [0, 8, 4, 1, format, format, 0x1401, 1, 2] {
                file.u32(word);
            }
            file.u32(blocks.len() as u32).raw(&blocks).u32(1).u32(16).object_members("");
        })
    };
    let (node, _) = read(raw(0x83f0));
    let texture = self::texture(&node).unwrap();
    assert_eq!((texture.width, texture.height), (8, 4));
    assert_eq!(texture.mips[0][12..20], [255, 0, 0, 255, 0, 0, 255, 255]);
    // Formats that are not read, and files that are none, are noted.
    let (node, ignored) = read(raw(0x9274));
    assert!(self::texture(&node).is_none() && ignored.count("OpenSceneGraph: image of pixel format 0x9274") == 1);
    let (node, ignored) = read(binary_image(|file| image_file(file, "a.tga", b"no image at all")));
    assert!(self::texture(&node).is_none() && ignored.iter().count() == 1, "{ignored:?}");
}

#[test]
fn state_sets_that_the_file_shares_are_the_same() {
    let shared = state_set(2, "ModeList 1 { GL_DEPTH_TEST OFF }");
    let reference = "StateSet TRUE { osg::StateSet { UniqueID 2 } }";
    let children = [geode(3, &shared, &[triangle(10, "")]), geode(4, reference, &[triangle(20, "")])];
    let (node, _) = read(osgt(VERSION, &group(1, &children)));
    let sets: Vec<_> = node.children.iter().map(|child| child.state_set.clone().unwrap()).collect();
    assert!(Arc::ptr_eq(&sets[0], &sets[1]));
}
