//! The text format of OpenSceneGraph before 3.0, as its writers and people write it.

use std::sync::Arc;

use glam::DVec3;
use terrane::scene::{AlphaMode, OverlayMode, Topology};
use terrane::state::{Attribute, TexEnv, TexGen, TextureDimension, WrapMode};

use super::*;

/// A triangle with a texture and a material.
const TRIANGLE: &str = r#"
Geometry {
  DataVariance STATIC
  StateSet {
    UniqueID StateSet_0
    rendering_hint TRANSPARENT_BIN
    renderBinMode INHERIT
    GL_BLEND ON
    GL_CULL_FACE OVERRIDE|ON
    Material {
      ColorMode OFF
      diffuseColor 1 0 0 1
      ambientColor FRONT 0 0 0
      shininess 0
    }
    textureUnit 0 {
      GL_TEXTURE_2D ON
      Texture2D {
        file "Images/a b.png"
        wrap_s REPEAT
        wrap_t CLAMP
      }
      TexEnv {
        mode DECAL
      }
    }
  }
  useDisplayList TRUE
  PrimitiveSets 1
  {
    DrawElementsUShort TRIANGLES 3
    {
      0 2 1
    }
  }
  VertexArray UniqueID Vertices Vec3Array 3
  {
    0 0 0
    1 0 0
    0 1e0 0
  }
  NormalBinding OVERALL
  NormalArray Vec3Array 1
  {
    0 0 1
  }
  TexCoordArray 0 Vec2Array 3
  {
    0 0
    1 0
    0 1
  }
}"#;

fn with(class: &str, members: &str, children: &[&str]) -> String {
    format!(
        "{class} {{\n  nodeMask 0xffffffff\n  cullingActive TRUE\n{members}\n  num_children {}\n{}\n}}\n",
        children.len(),
        children.join("\n")
    )
}

#[test]
fn geometry_with_its_state_is_read() {
    let text = format!("Geode {{\n  name \"a \\\"name\\\"\"\n  num_drawables 1\n{TRIANGLE}\n}}\n");
    let needed = terrane::formats::dependencies(URI, text.as_bytes(), None, &[], &options());
    assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["/set/Images/a b.png"]);
    let png = crate::gltf_builder::png(4, [1, 2, 3]);
    let (node, ignored) = read_with(text.as_bytes(), vec![(needed[0].clone(), Ok(png))], &options()).unwrap();
    assert!(ignored.is_empty(), "{ignored:?}");
    assert_eq!(node.name, "a \"name\"");
    let drawable = drawables(&node)[0];
    let (mesh, material) = (mesh(drawable), &drawable.material);
    assert_eq!((mesh.topology, &*mesh.indices), (Topology::Triangles, &[0, 2, 1][..]));
    assert_eq!((mesh.vertices[2].position, mesh.vertices[2].normal), ([0.0, 1.0, 0.0], [0, 0, 127, 0]));
    assert_eq!(
        (material.alpha, material.double_sided, material.base_color),
        (AlphaMode::Blend, false, [1.0, 0.0, 0.0, 1.0])
    );
    let surface = material.metallic_roughness.as_ref().unwrap();
    let image = surface.overlay.as_ref().unwrap();
    assert_eq!((image.mips[0][..3].to_vec(), surface.overlay_mode), (vec![1, 2, 3], OverlayMode::Over));
    assert_eq!(image.sampling.wrap, [WrapMode::Repeat, WrapMode::ClampToEdge]);
}

#[test]
fn nodes_of_every_kind_are_read() {
    let matrix = "Matrix {\n 1 0 0 0\n 0 1 0 0\n 0 0 1 0\n 5 6 7 1\n}";
    let geode = format!("Geode {{\n  num_drawables 1\n{TRIANGLE}\n}}");
    let moved = with("MatrixTransform", matrix, &[&geode]);
    let placed =
        with("osg::PositionAttitudeTransform", "  position 1 2 3\n  attitude 0 0 0 1\n  scale 2 2 2", &["Use Geode_1"]);
    let known = geode.replacen("Geode {", "Geode {\n  UniqueID Geode_1", 1);
    let switch = with(
        "Switch",
        "  NewChildDefaultValue FALSE\n  ValueList {\n    1\n    0\n  }",
        &[&known, "Use Geode_1", "Use Geode_1"],
    );
    let paged = "PagedLOD {\n  Center 1 2 3\n  Radius 9\n  RangeMode DISTANCE_FROM_EYE_POINT\n  RangeList 2 {\n    100 1e+10\n    0 100\n  }
  NumChildrenThatCannotBeExpired 1\n  FileNameList 2 {\n    \"\"\n    \"fine.osg\"\n  }\n  num_children 1\n  Use Geode_1\n}";
    let shape = "Geode {\n  num_drawables 1\n  ShapeDrawable {\n    Sphere {\n      Center 0 0 0\n      Radius 2\n    }\n    color 0 1 0 1\n  }\n}";
    let (node, ignored) =
        read(with("Group", "  description {\n    \"a { brace\"\n  }", &[&moved, &switch, &placed, paged, shape]));
    assert_eq!(ignored.iter().collect::<Vec<_>>(), [("OpenSceneGraph: external image that is missing", 2)]);
    let [moved, switch, placed, paged, shape] = &node.children[..] else { panic!("{node:?}") };
    let NodeKind::Transform(map) = moved.kind else { panic!("{moved:?}") };
    assert_eq!(map.translation, DVec3::new(5.0, 6.0, 7.0));
    let NodeKind::Switch(shown) = &switch.kind else { panic!("{switch:?}") };
    assert_eq!(shown, &[true, false, false]);
    let NodeKind::Transform(map) = placed.kind else { panic!("{placed:?}") };
    assert_eq!(map.transform_point3(DVec3::X), DVec3::new(3.0, 2.0, 3.0));
    // The shared geode is one mesh.
    let meshes = [switch, placed].map(|node| std::ptr::from_ref(mesh(drawables(node)[0])));
    assert_eq!(meshes[0], meshes[1]);
    let contents: Vec<_> = tiles(paged).iter().filter_map(|tile| tile.content.clone()).collect();
    assert!(contents.contains(&Arc::from("/set/fine.osg")), "{contents:?}");
    assert!(mesh(drawables(shape)[0]).bounds.max.x > 1.9);
}

#[test]
fn classes_that_are_not_read_are_counted_and_the_rest_is_drawn() {
    let effect = "osgParticle::ModularEmitter {\n  particleTemplate {\n    shape QUAD\n  }\n}";
    let geode = format!("Geode {{\n{TRIANGLE}\n}}");
    let rig = format!(
        "Geode {{\n  osgAnimation::RigGeometry {{\n    num_influences 1\n    osgAnimation::VertexInfluence \"a\" 1 {{\n      0 1\n    }}\n{TRIANGLE}\n  }}\n}}"
    );
    let (node, ignored) = read(with("Group", "", &[effect, &geode, &rig, "Use Nothing"]));
    assert_eq!(drawables(&node).len(), 2);
    for kind in [
        "OpenSceneGraph class osgParticle::ModularEmitter",
        "OpenSceneGraph class osgAnimation::RigGeometry (its rest pose is drawn)",
        "OpenSceneGraph: a reference that cannot be followed",
    ] {
        assert_eq!(ignored.count(kind), 1, "{kind}: {ignored:?}");
    }
}

/// Files of the first versions: points without a type, indices of normals, several roots.
#[test]
fn old_files_are_read() {
    let geometry = "Geode {\n num_geosets 1\n Geometry {\n  GeoState {\n   lighting OFF\n  }\n  Primitives 1\n  {\n   DrawArrayLengths TRIANGLE_STRIP 0 1\n   {\n    4\n   }\n  }
  VertexArray 4\n  {\n   0 0 0\n   1 0 0\n   0 1 0\n   1 1 0\n  }\n  NormalBinding PER_VERTEX\n  NormalArray 2\n  {\n   0 0 1\n   0 0 -1\n  }
  NormalIndices IntArray 4\n  {\n   0 1 0 1\n  }\n  ColorBinding OVERALL\n  ColorArray UVec4bArray 1\n  {\n   0 255 0 255\n  }\n }\n}\n";
    let (node, ignored) = read(geometry.repeat(2));
    assert!(ignored.is_empty(), "{ignored:?}");
    let all = drawables(&node);
    let mesh = mesh(all[0]);
    assert_eq!((all.len(), mesh.indices.len()), (2, 6));
    assert!(all[0].material.unlit);
    let of = |x: f32, y: f32| mesh.vertices.iter().find(|vertex| vertex.position == [x, y, 0.0]).unwrap();
    assert_eq!((of(1.0, 0.0).normal[2], of(0.0, 1.0).normal[2], of(1.0, 1.0).color), (-127, 127, [0, 255, 0, 255]));
}

#[test]
fn broken_files_are_errors_of_one_sentence() {
    let error = |text: &str| read_with(text.as_bytes(), Vec::new(), &options()).unwrap_err().reason();
    assert!(
        error("Group {\n  name \"a\n").contains("line 3: a string does not end"),
        "{}",
        error("Group {\n  name \"a\n")
    );
    assert!(error("Group {\n  Geode {\n  }\n").contains("the text ends inside of a block"));
    assert!(error("Group {\n}\n}").contains("line 3: } without {"));
    assert!(error("osgSim::Something {\n}").contains("a file without a node that is read"));
    assert!(error(&"Group {\n".repeat(200)).contains("depth"));
    // Nodes that refer to nodes that were read are as deep as nested ones.
    let nested: String = (0..150).map(|i| format!("Group {{\n  UniqueID g{i}\n  Use g{}\n}}\n", i - 1)).collect();
    assert!(error(&nested).contains("depth of nodes"), "{}", error(&nested));
    let geode = |array: &str| format!("Geode {{\n Geometry {{\n  VertexArray {array} 1 {{\n 0 0 0\n }}\n }}\n}}");
    assert!(error(&geode("Vec9Array")).contains("array of type Vec9Array"));
    for other in ["Group\n", "{}", "<html>", "name {", ""] {
        assert!(!error(other).contains("OpenSceneGraph"), "{other}");
    }
}

#[test]
fn texture_units_of_every_kind_are_read() {
    let unit = |members: &str| {
        let state = format!("    textureUnit 1 {{\n{members}\n    }}\n  }}\n  useDisplayList TRUE",);
        let geometry = TRIANGLE.replacen("  }\n  useDisplayList TRUE", &state, 1);
        let text = format!("Geode {{\n{geometry}\n}}\n");
        let png = crate::gltf_builder::png(4, [1, 2, 3]);
        let needed = terrane::formats::dependencies(URI, text.as_bytes(), None, &[], &options());
        let companions = needed.iter().map(|uri| (uri.clone(), Ok(png.clone()))).collect();
        let (node, ignored) = read_with(text.as_bytes(), companions, &options()).unwrap();
        assert!(ignored.is_empty(), "{ignored:?}");
        (drawables(&node)[0].state_set.clone().unwrap(), needed.len())
    };
    let faces = ["POSITIVE_X", "NEGATIVE_X", "POSITIVE_Y", "NEGATIVE_Y", "POSITIVE_Z", "NEGATIVE_Z"];
    let faces: Vec<String> = faces.iter().map(|face| format!("image {face} \"{face}.png\"")).collect();
    let cube = format!(
        "GL_TEXTURE_CUBE_MAP ON\nGL_TEXTURE_GEN_S ON\nTextureCubeMap {{\nwrap_s CLAMP\n{}\n}}\nTexGen {{\nmode REFLECTION_MAP\n}}",
        faces.join("\n")
    );
    let (set, images) = unit(&cube);
    assert_eq!(images, 7);
    // The base colour is laid over the material, so that it takes a unit too.
    let of = |slot: u8, kind: fn(u8, &Attribute) -> bool| set.attributes.iter().any(|(found, _)| kind(slot, found));
    assert!(of(1, |slot, found| matches!(found, Attribute::TexGen(at, TexGen::ReflectionMap) if *at == slot)));
    assert!(of(1, |slot, found| matches!(found, Attribute::Texture(at, binding)
        if *at == slot && binding.texture.dimension == TextureDimension::Cube && binding.texture.size == [4, 4, 6])));
    let (set, _) = unit(
        "GL_TEXTURE_2D ON\nGL_TEXTURE_GEN_S ON\nTexture2D {\nImageSequence {\nFileNames {\n\"a.png\"\n\"b.png\"\n}\n}\n}\n
        TexGen {\nmode EYE_LINEAR\nplane_s 2 0 0 0.5\nplane_t 0 1 0 0\n}\nTexMat {\nDataVariance STATIC\n1 0 0 0\n0 3 0 0\n0 0 1 0\n0 0 0 1\n}\n
        TexEnv {\nmode BLEND\ncolor 1 0 0 1\n}",
    );
    let planes = set.attributes.iter().find_map(|(found, _)| match found {
        Attribute::TexGen(1, TexGen::EyeLinear(planes)) => Some(planes[0]),
        _ => None,
    });
    assert_eq!(planes, Some([2.0, 0.0, 0.0, 0.5]));
    assert!(
        set.attributes.iter().any(|(found, _)| matches!(found, Attribute::TexMat(1, matrix) if matrix[1][1] == -3.0))
    );
    assert!(set.attributes.iter().any(|(found, _)| matches!(found, Attribute::TexEnv(1, TexEnv::Combine(combine))
        if combine.constant == [1.0, 0.0, 0.0, 1.0])));
}

#[test]
fn sequences_play_and_programs_have_one_name() {
    let geode = format!("Geode {{\n{TRIANGLE}\n}}");
    let sequence = with(
        "Sequence",
        "  defaultTime 1\n  frameTime {\n    1\n    2\n  }\n  interval LOOP -1 0\n  mode START",
        &[&geode, &geode],
    );
    let program = "StateSet {\n  Program {\n    num_shaders 1\n    Shader {\n      type VERTEX\n      code {\n        \"void main() {}\"\n      }\n    }\n  }\n  Uniform {\n    name \"a\"\n    float 1\n  }\n}";
    let (node, ignored) = read(with("Group", program, &[&sequence]));
    let NodeKind::Switch(shown) = &node.children[0].kind else { panic!("{node:?}") };
    assert_eq!(shown, &[false, true]);
    assert!(node.children[0].update_callback.is_some());
    assert_eq!(ignored.count("OpenSceneGraph: shader programs in GLSL (not run)"), 1);
    assert_eq!(ignored.iter().count(), 2, "and the images that are missing: {ignored:?}");
}

#[test]
fn paths_move_transforms() {
    let geode = format!("Geode {{\n{TRIANGLE}\n}}");
    let path = "  UpdateCallbacks {\n    AnimationPathCallback {\n      pivotPoint 1 0 0\n      timeOffset 0\n      timeMultiplier 1
      AnimationPath {\n        LoopMode NO_LOOPING\n        ControlPoints {\n          3 9 0 0 0 0 0 1 2 2 2
          0 5 6 7 0 0 0 1 2 2 2\n        }\n      }\n    }\n  }";
    for class in ["MatrixTransform", "PositionAttitudeTransform"] {
        let (node, _) = read(with(class, path, &[&geode]));
        let NodeKind::Transform(map) = node.kind else { panic!("{node:?}") };
        assert_eq!(map.transform_point3(glam::DVec3::X), glam::DVec3::new(5.0, 6.0, 7.0), "{class}");
        assert!(node.update_callback.is_some());
    }
}
