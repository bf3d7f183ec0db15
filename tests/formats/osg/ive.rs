//! Files in .ive, in all versions and both byte orders, compared with the same scenes in text.

use glam::DVec4;
use kit::ive_files::scenes::{paged, terrain_tile, textured, unusual_nodes, volumes};
use kit::ive_files::{GEODE, Ive, VERSION};
use kit::osg_files::{VERSION as TEXT_VERSION, geode, group, osgt, triangle};
use terrane::fetch::Limits;
use terrane::formats::{dependencies, inspect, verify};
use terrane::scene::{Page, Topology};

use super::*;

/// Checks that two files read as the same nodes, with the same notes.
fn assert_same(binary: &[u8], text: &str, companions: &[Fetched]) {
    let read =
        |bytes: &[u8]| read_with(bytes, companions.to_vec(), &options()).unwrap_or_else(|error| panic!("{error}"));
    let (ours, expected) = (read(binary), read(osgt(TEXT_VERSION, text).as_bytes()));
    let [lines, expected_lines] = [&ours.0, &expected.0].map(|node| format!("{node:#?}"));
    for (line, expected) in lines.lines().zip(expected_lines.lines()) {
        assert_eq!(line, expected);
    }
    assert_eq!(lines.lines().count(), expected_lines.lines().count());
    assert_eq!(ours.1, expected.1);
}

/// The scene of [`textured`] in text.
fn scene_in_text() -> String {
    let state = "StateSet TRUE { osg::StateSet { UniqueID 50 ModeList 2 { GL_BLEND ON GL_CULL_FACE ON|OVERRIDE }
        AttributeList 2 { osg::BlendFunc { UniqueID 51 SourceRGB SRC_ALPHA SourceAlpha SRC_ALPHA DestinationRGB ONE
            DestinationAlpha ONE } Value ON
            osg::Material { UniqueID 52 ColorMode OFF Ambient TRUE Front 0 0.5 0 1 Back 0 0 0 0
            Diffuse TRUE Front 0.25 0.5 0 1 Back 0 0 0 0 Specular TRUE Front 0.5 0.5 0 1 Back 0 0 0 0
            Emission TRUE Front 0.75 0.5 0 1 Back 0 0 0 0 Shininess FALSE Front 0 Back 0 } Value ON|OVERRIDE }
        TextureModeList 1 { Data 1 { GL_TEXTURE_2D ON } }
        TextureAttributeList 1 { Data 1 { osg::Texture2D { UniqueID 53 WRAP_S REPEAT WRAP_T REPEAT MIN_FILTER LINEAR
            MAG_FILTER LINEAR Image TRUE { ClassName osg::Image UniqueID 54 FileName \"a.png\" WriteHint 0 2 } } Value ON } } } }";
    let textured = geode(2, &format!("Name \"textured\" {state}"), &[triangle(10, "")]);
    let placed = format!(
        "osg::MatrixTransform {{ UniqueID 4 Children 1 {{ {textured} }} Matrix {{ 0 1 0 0 -1 0 0 0 0 0 1 0 5 6 7 1 }} }}"
    );
    let again = "osg::Geode { UniqueID 2 }";
    format!("osg::Group {{ UniqueID 1 Name \"root\" Children 2 {{ {placed} {again} }} }}")
}

#[test]
fn scene_reads_as_in_text_in_every_version_and_byte_order() {
    let text = scene_in_text();
    let png = crate::gltf_builder::png(4, [1, 2, 3]);
    for version in 0..=VERSION {
        for file in [textured(Ive::new(version)), textured(Ive::big_endian(version))] {
            let needed = dependencies(URI, &file.bytes, None, &[], &options());
            assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["/set/a.png"], "version {version}");
            assert_same(&file.bytes, &text, &[(needed[0].clone(), Ok(png.clone()))]);
        }
    }
    let (bytes, image) = (textured(Ive::new(VERSION)).compressed(), vec![("/set/a.png".into(), Ok(png))]);
    assert_same(&bytes, &text, &image);
}

#[test]
fn transforms_and_choices_read_as_in_text() {
    let mut file = Ive::new(VERSION);
    file.u32(0).group("", 6, |file| {
        file.u32s(&[1, 0x14]).transform(1, |file| {
            file.triangle_geode(2);
        });
        file.f32s(&[1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0, 2.0, 2.0, 2.0, 1.0, 0.0, 0.0]);
        file.u32s(&[3, 0x16])
            .group("", 2, |file| {
                file.triangle_geode(4).triangle_geode(5);
            })
            .raw(&[0, 1]);
        // An LOD about a centre, with a radius and two ranges.
        file.u32s(&[6, 0x11]).group("", 2, |file| {
            file.triangle_geode(7).triangle_geode(8);
        });
        file.f32s(&[9.0]).u32(1).f32s(&[1.0, 2.0, 3.0]).u32s(&[0, 2]).f32s(&[0.0, 10.0, 10.0, 100.0]);
        // One by the size of its bounding sphere.
        file.u32s(&[9, 0x11]).group("", 1, |file| {
            file.triangle_geode(10);
        });
        file.f32s(&[-1.0]).u32(0).f32s(&[1.0, 2.0, 3.0]).u32s(&[1, 1]).f32s(&[20.0, 1e6]);
        // A Billboard that turns to the eye.
        file.u32s(&[11, 0x10, GEODE]).node("").u32(1).triangle(11).u32(0);
        file.f32s(&[0.0, 0.0, 1.0, 0.0, -1.0, 0.0]).u32(1).f32s(&[5.0, 6.0, 7.0]);
        // An AutoTransform that keeps its size.
        file.u32s(&[12, 0x30]).transform(1, |file| {
            file.triangle_geode(13);
        });
        file.f32s(&[1.0, 2.0, 3.0, 0.0, 0.0, 0.5, 0.0]).u32(1).raw(&[1]);
        file.f32s(&[0.5, 8.0, 0.25, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
    });
    let child = |id: u32| geode(id, "", &[triangle(200 + id * 10, "")]);
    let both = |id: u32| format!("Children 2 {{ {} {} }}", child(id), child(id + 1));
    let text = group(
        1,
        &[
            format!(
                "osg::PositionAttitudeTransform {{ UniqueID 100 Children 1 {{ {} }} Position 1 2 3 Attitude 0 0 1 0
                Scale 2 2 2 PivotPoint 1 0 0 }}",
                child(2)
            ),
            format!("osg::Switch {{ UniqueID 101 {} ValueList 2 {{ FALSE TRUE }} }}", both(4)),
            format!(
                "osg::LOD {{ UniqueID 102 {} CenterMode USER_DEFINED_CENTER UserCenter 1 2 3 9
                RangeList 2 {{ 0 10 10 100 }} }}",
                both(7)
            ),
            format!(
                "osg::LOD {{ UniqueID 103 Children 1 {{ {} }} RangeMode PIXEL_SIZE_ON_SCREEN RangeList 1 {{ 20 1e6 }} }}",
                child(10)
            ),
            format!(
                "osg::Billboard {{ UniqueID 104 Drawables 1 {{ {} }} Mode POINT_ROT_EYE PositionList 1 {{ 5 6 7 }} }}",
                triangle(1000, "")
            ),
            format!(
                "osg::AutoTransform {{ UniqueID 105 Children 1 {{ {} }} MinimumScale 0.5 MaximumScale 8 Position 1 2 3
                PivotPoint 0 0 0.5 AutoRotateMode ROTATE_TO_SCREEN AutoScaleToScreen TRUE }}",
                child(13)
            ),
        ],
    );
    assert_same(&file.bytes, &text, &[]);
}

#[test]
fn paged_levels_and_proxies_read_as_in_text() {
    let text =
        "osg::PagedLOD { UniqueID 1 CenterMode USER_DEFINED_CENTER UserCenter 1 2 3 9 RangeList 2 { 100 1e30 0 100 }
        DatabasePath TRUE \"tiles\" RangeDataList 2 { \"coarse.ive\" \"fine.ive\" } PriorityList 2 { 0 1 2 3 } }";
    assert_same(&paged(Ive::new(VERSION), false).bytes, text, &[]);
    let (node, _) = read(paged(Ive::big_endian(6), true).bytes);
    let tiles = tiles(&node);
    assert_eq!(drawables(&read_part(tiles[0]).unwrap()).len(), 1);
    assert_eq!((tiles.len(), tiles[1].content.as_deref()), (2, Some("/set/tiles/fine.ive")));

    let proxy = |version: u32, names: &[&str], children: u32| {
        let mut file = Ive::new(version);
        file.u32s(&[0, 0x27]).node("").f32s(&[9.0]).u32(1).f32s(&[1.0, 2.0, 3.0]).since(45, |file| file.u32(1));
        file.u32(names.len() as u32);
        for name in names {
            file.text(name);
        }
        file.u32(children);
        for child in 0..children {
            file.triangle_geode(child + 1);
        }
        file.bytes
    };
    let text = "osg::ProxyNode { UniqueID 1 FileNames 1 { \"a.ive\" }
        LoadingExternalReferenceMode DEFER_LOADING_TO_DATABASE_PAGER CenterMode USER_DEFINED_CENTER UserCenter 1 2 3 9 }";
    assert_same(&proxy(45, &["a.ive"], 0), text, &[]);
    let proxies = |node: &Node| node.children.iter().filter(|n| matches!(n.kind, NodeKind::ProxyNode(_))).count();
    // A file that was written into this one is not loaded again.
    let (node, _) = read(proxy(44, &["a.ive", "b.ive"], 1));
    assert_eq!((drawables(&node).len(), proxies(&node)), (1, 1));
    let (node, _) = read(proxy(44, &["a.ive", ""], 1));
    assert_eq!((drawables(&node).len(), proxies(&node)), (1, 1));
}

#[test]
fn arrays_and_primitive_sets_of_every_type_are_read() {
    let mut file = Ive::new(VERSION);
    file.u32s(&[0, GEODE]).node("").u32s(&[1, 0, 0x1001]).drawable().u32(5);
    file.u32(0x1_0001).primitives().u32s(&[0, 3]);
    file.u32(0x1_0002).primitives().u32s(&[0, 1, 3]);
    file.u32(0x1_0005).primitives().u32(3).raw(&[0, 1, 2]);
    file.u32(0x1_0003).primitives().u32(3).u16s(&[0, 1, 2]);
    file.u32(0x1_0004).primitives().u32(3).u32s(&[0, 1, 2]);
    // Positions of doubles, through indices.
    file.raw(&[1, 16]).u32(2).f64s(&[0.0, 0.0, 0.0, 1.0, 2.0, 3.0]).raw(&[1, 2]).u32(3).u16s(&[0, 1, 0]);
    // Normals of bytes for each primitive set; colours of bytes for all.
    file.raw(&[1, 3, 13]).u32(5).raw(&[0, 0, 127].repeat(5)).raw(&[0]);
    file.raw(&[1, 1, 4]).u32(1).raw(&[255, 0, 0, 255]).raw(&[0]);
    // Secondary colours and coordinates of fog.
    file.raw(&[1, 4, 8]).u32(1).f32s(&[0.0; 4]).raw(&[0, 1, 4, 5]).u32(1).f32s(&[0.0]).raw(&[0]);
    // Two sets of coordinates, the first without an array.
    file.u32(2).raw(&[0, 0, 1, 9]).u32(1).u16s(&[1, 2]).raw(&[0]);
    // Vertex attributes.
    file.u32(1).raw(&[4, 1, 1, 17]).u32(1).f64s(&[0.0; 4]).raw(&[0]);
    let (node, ignored) = read(&file.bytes);
    assert!(ignored.is_empty(), "{ignored:?}");
    let all = drawables(&node);
    let triangles: usize = all.iter().map(|drawable| mesh(drawable).indices.len() / 3).sum();
    assert_eq!(triangles, 5);
    let mesh = mesh(all[0]);
    assert_eq!(mesh.topology, Topology::Triangles);
    assert_eq!((mesh.vertices[0].normal, mesh.vertices[0].color[..3].to_vec()), ([0, 0, 127, 0], vec![255, 0, 0]));
}

#[test]
fn images_are_read_in_every_mode() {
    let png = crate::gltf_builder::png(2, [1, 2, 3]);
    let pixels = [9; 12];
    let file = |write: &dyn Fn(&mut Ive)| {
        let mut file = Ive::new(VERSION);
        file.u32s(&[0, GEODE]).node_with("", |file| {
            file.state_set(
                0,
                &[],
                |file| {
                    file.u32(0);
                },
                &[(0xde1, 1)],
                |file| {
                    file.u32s(&[1, 0, 0x122]).texture();
                    write(file);
                    file.u32(1);
                },
            );
        });
        file.u32(1).triangle(0);
        file.bytes
    };
    let texel = |bytes: &[u8]| {
        let images = vec![("/set/a.png".into(), Ok(png.clone()))];
        let (node, ignored) = read_with(bytes, images, &options()).unwrap();
        let texture = drawables(&node)[0].material.texture.clone();
        (texture.map(|texture| texture.mips[0][..3].to_vec()), ignored)
    };
    let named = |file: &mut Ive, mode: u8, name: &str| {
        file.image(mode).text(name).u32(png.len() as u32).raw(&png);
    };
    for (bytes, expected) in [
        (
            file(&|file| {
                file.image(0).text("a.png");
            }),
            Some(vec![1, 2, 3]),
        ),
        (
            file(&|file| {
                file.image(1).raw(&[1]).pixels([2, 2], &pixels);
            }),
            Some(vec![9, 9, 9]),
        ),
        (file(&|file| named(file, 2, "b.png")), Some(vec![1, 2, 3])),
        (file(&|file| named(file, 3, ".png")), Some(vec![1, 2, 3])),
        // Nothing follows the marker, the name or the size.
        (
            file(&|file| {
                file.image(1).raw(&[0]);
            }),
            None,
        ),
        (
            file(&|file| {
                file.image(0).text("");
            }),
            None,
        ),
        (
            file(&|file| {
                file.image(2).text("").u32(0);
            }),
            None,
        ),
    ] {
        let (texel, ignored) = texel(&bytes);
        assert_eq!(texel, expected);
        assert!(ignored.is_empty(), "{ignored:?}");
    }
    let sequence = file(&|file| {
        file.u32(0x32).object("").u32(0).f64s(&[1.0]).u32(2).text("a.png").text("b.png");
    });
    let (first, ignored) = texel(&sequence);
    assert_eq!(first, Some(vec![1, 2, 3]));
    assert_eq!(ignored.count("OpenSceneGraph class osg::ImageSequence (its first image is drawn)"), 1);
}

#[test]
fn classes_that_are_not_drawn_are_read_over_and_counted() {
    let children = |class: &str| (format!("OpenSceneGraph class {class} (its children are drawn)"), 1);
    let mut expected = [
        "osg::OccluderNode",
        "osg::OcclusionQueryNode",
        "osg::TexGenNode",
        "osgFX::Cartoon",
        "osgFX::MultiTextureControl",
        "osgFX::Scribe",
        "osgSim::VisibilityGroup",
    ]
    .map(children)
    .to_vec();
    expected.push(("OpenSceneGraph class osg::Camera (it draws to a texture or to a window)".to_owned(), 1));
    expected.push(("OpenSceneGraph: light 0 of a file (the environment's light takes its place)".to_owned(), 1));
    if !cfg!(feature = "text") {
        expected.push(("OpenSceneGraph class osgText::Text".to_owned(), 1));
    }
    expected.sort();
    for version in [0, 5, 12, 18, 22, 28, 31, 37, 39, 41, VERSION] {
        let (node, ignored) = read(unusual_nodes(version).bytes);
        let found: Vec<_> = ignored.iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
        assert_eq!(found, expected, "version {version}");
        let count = 16 + usize::from(cfg!(feature = "text"));
        assert_eq!((node.children.len(), drawables(&node).len()), (16, count), "version {version}");
        assert!(matches!(&node.children[0].kind, NodeKind::Group), "light 0 is the environment's");
        assert!(
            matches!(&node.children[1].kind, NodeKind::ClipNode(clip) if clip.planes == [(0, DVec4::new(0.0, 0.0, 1.0, 5.0))])
        );
        let shown = |child: usize| match &node.children[child].kind {
            NodeKind::Switch(shown) => shown.clone(),
            kind => panic!("{kind:?}"),
        };
        assert_eq!((shown(9), shown(10)), (vec![false, true], vec![false, true]));
        assert!(node.children[9].update_callback.is_some());
    }
}

#[test]
fn effects_with_images_and_textures_are_read_over() {
    let mut file = Ive::new(VERSION);
    file.u32(0).group("", 4, |file| {
        let effect = |file: &mut Ive, id: u32, class: u32| {
            let child = |file: &mut Ive| {
                file.triangle_geode(100 + id);
            };
            file.u32s(&[id, class, 0x100_0002]).group("", 1, child).raw(&[1]).u32(0);
        };
        effect(file, 1, 0x100_0003);
        file.image(0).text("a.png").u32(0);
        // OSG writes SpecularHighlights under the number of AnisotropicLighting.
        effect(file, 2, 0x100_0003);
        file.u32s(&[0, 1]).f32s(&[0.0; 5]);
        effect(file, 3, 0x100_0004);
        file.u32s(&[0, 0, 1, 0x122]).texture().image(0).text("a.png").u32(0x122).texture().image(1).raw(&[0]);
        file.triangle_geode(4);
    });
    let (node, ignored) = read(&file.bytes);
    assert_eq!(drawables(&node).len(), 4);
    let classes = ["AnisotropicLighting", "BumpMapping", "SpecularHighlights"];
    let expected = classes.map(|class| format!("OpenSceneGraph class osgFX::{class} (its children are drawn)"));
    assert_eq!(ignored.iter().map(|(kind, _)| kind).collect::<Vec<_>>(), expected);
}

/// Regression: one tile of a volume was the error of the whole file.
#[test]
fn volumes_are_read_over_and_counted() {
    let file = volumes(VERSION);
    let (node, ignored) = read(&file.bytes);
    assert_eq!(drawables(&node).len(), 2);
    assert_eq!(ignored.iter().collect::<Vec<_>>(), [("OpenSceneGraph class osgVolume::VolumeTile", 3)]);
    for length in (12..file.bytes.len()).step_by(5) {
        assert!(read_with(&file.bytes[..length], Vec::new(), &options()).is_err(), "{length}");
    }
}

/// Regression: OSG's writer leaves a number alone for a drawable that it does not know, which was the error of the whole file.
#[test]
fn drawables_that_osg_does_not_write_are_left_out() {
    let mut file = Ive::new(VERSION);
    file.u32(0).group("", 2, |file| {
        file.u32s(&[1, GEODE]).node("").u32(2).u32(0).triangle(1);
        file.triangle_geode(2);
    });
    let (node, ignored) = read(&file.bytes);
    assert_eq!(drawables(&node).len(), 2);
    let counted: Vec<_> = ignored.iter().collect();
    assert_eq!(counted, [("OpenSceneGraph: a drawable that OSG's writer of .ive leaves out, such as particles", 1)]);
}

#[test]
fn light_points_and_moving_parts_are_placed() {
    let mut file = Ive::new(VERSION);
    file.u32(0).group("", 3, |file| {
        // Two points that are on, one of them in a sector and blinking, and one that is off.
        file.u32s(&[1, 0x10_0007]).node("").f32s(&[0.0, 30.0, 1e9]).raw(&[0]).u32(3);
        for point in 0..3u8 {
            file.u32(0x10_0006).raw(&[u8::from(point < 2)]).f32s(&[
                f32::from(point),
                0.0,
                0.0,
                1.0,
                0.0,
                0.0,
                1.0,
                1.0,
                1.0,
            ]);
            match point {
                0 => file.raw(&[1]).u32(0x10_0005).f32s(&[0.0; 5]).raw(&[1]).u32(0x10_0001).object("").u32(1),
                _ => file.raw(&[0, 0]).u32(0),
            };
            if point == 0 {
                file.f64s(&[1.0]).f32s(&[0.0; 4]).f64s(&[0.0, 0.0]).u32(0);
            }
        }
        // A DOFTransform about a point, turned by a quarter.
        file.u32s(&[2, 0x22]).transform(1, |file| {
            file.triangle_geode(102);
        });
        file.f64s(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 1.0]);
        file.f32s(&[0.0; 9]).f32s(&[std::f32::consts::FRAC_PI_2, 0.0, 0.0]).f32s(&[0.0; 9]).f32s(&[0.0, 0.0, 4.0]);
        file.f32s(&[0.0; 9]).f32s(&[1.0; 3]).raw(&[0]).u32(0).raw(&[0]);
        // A transform that an animation moves.
        file.u32s(&[3, 4, 3, 2]).object("").raw(&[1]).u32(0).raw(&[0, 1]);
        file.u32(0x51).object("").f32s(&[1.0, 0.0, 0.0]).f64s(&[0.0, 1.0, 0.0, 0.0]).u32(1);
        file.u32(0x15).object("").u32(0).u32(2);
        for time in [5.0, 0.0] {
            file.f32s(&[time, 10.0 + time, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
        }
        file.raw(&[0, 0, 0]).u32s(&[u32::MAX, 1]).triangle_geode(103).f64s(&[0.0; 16]);
    });
    let (node, ignored) = read(&file.bytes);
    assert_eq!(
        ignored.iter().map(|(kind, _)| kind).collect::<Vec<_>>(),
        ["OpenSceneGraph: a matrix that is not affine"]
    );
    assert!(node.children[2].update_callback.is_some());
    let points = mesh(drawables(&node)[0]);
    assert_eq!((points.topology, points.vertices.len()), (Topology::Points, 2));
    let map = |child: usize| match node.children[child].kind {
        NodeKind::Transform(map) => map,
        _ => panic!("a transform"),
    };
    let at = |child: usize, x: f64| map(child).transform_point3(glam::DVec3::new(x, 0.0, 0.0));
    assert!(at(1, 1.0).distance(glam::DVec3::new(1.0, 0.0, 4.0)) < 1e-6, "{}", at(1, 1.0));
    assert!(at(1, 2.0).distance(glam::DVec3::new(1.0, 1.0, 4.0)) < 1e-6, "{}", at(1, 2.0));
    assert_eq!(at(2, 1.0), glam::DVec3::new(10.0, 0.0, 0.0));
}

#[test]
fn attributes_that_are_not_drawn_are_read_over_and_counted() {
    let floats = |count: usize| vec![0u8; 4 * count];
    // Class, bytes of its members, and what is counted; nothing for those that are drawn.
    let classes: [(u32, Vec<u8>, &str); 19] = [
        (0x105, floats(4), ""),
        (0x134, [6u32, 6].map(|equation| (0x8000 + equation).to_le_bytes()).concat(), ""),
        (0x131, floats(7), "class osg::Stencil"),
        (0x132, floats(14), "class osg::StencilTwoSided"),
        (0x1127, floats(4), "class osg::Viewport"),
        (0x1128, floats(4), "class osg::Scissor"),
        (0x1129, floats(2), ""),
        (0x1131, floats(1), "class osg::PointSprite"),
        (0x1132, vec![0; 9], "class osg::Multisample"),
        (0x1133, floats(9), ""),
        (0x1134, vec![0; 6], "class osg::LineStipple"),
        (0x1135, [&[3, 0, 0, 0][..], &[7; 3]].concat(), "class osg::PolygonStipple"),
        (0x1122, vec![0; 36], "clip plane of a state set (not used)"),
        (0x12e, floats(2), "class osg::FragmentProgram"),
        (0x12f, floats(1), "class osg::VertexProgram"),
        (0x12a, floats(1), "attribute ShadeModel"),
        (0x12b, [5.0f32, 1.0, 1.0, 0.5, 0.0, 1.0, 9.0].map(f32::to_le_bytes).concat(), "attribute Point"),
        (0x12d, floats(1), "attribute LineWidth"),
        (0x1121, vec![0; 22], ""),
    ];
    let mut file = Ive::new(VERSION);
    file.u32s(&[0, GEODE]).node_with("", |file| {
        file.raw(&[1]).u32s(&[0, 5]).object("").raw(&[1]).u32(3).text("RenderBin").u32(0).u32(classes.len() as u32 + 1);
        for (id, (class, members, _)) in classes.iter().enumerate() {
            file.u32s(&[id as u32, *class]).object("").raw(members).u32(1);
        }
        // A Program with a Shader.
        file.u32s(&[90, 0x1124]).object("").u32s(&[1, 4, 5, 1]).text("a").u32s(&[6, 1, 0, 0x1125]).object("").u32(0);
        file.text("void main() {}").u32(1);
        // No texture units; two uniforms, one of them twice.
        file.u32s(&[0, 0, 3, 0, 0x1126])
            .object("a")
            .u32s(&[0x1406, 1])
            .raw(&[5])
            .u32(1)
            .f32s(&[1.0])
            .u32(1)
            .u32s(&[0, 1]);
        file.u32s(&[1, 0x1126]).object("b").u32s(&[0x8b56, 1]).raw(&[0]).u32s(&[1, 1]).u32(1);
    });
    file.u32(1).triangle(0);
    let (node, ignored) = read(&file.bytes);
    let left_out: Vec<&str> =
        classes.iter().map(|(.., counted)| *counted).filter(|counted| !counted.is_empty()).collect();
    for counted in &left_out {
        let kind = if counted.starts_with("class") {
            format!("OpenSceneGraph {counted}")
        } else {
            format!("OpenSceneGraph: {counted}")
        };
        assert_eq!(ignored.count(&kind), 1, "{kind}: {ignored:?}");
    }
    assert_eq!(ignored.count("OpenSceneGraph: shader programs in GLSL (not run)"), 1);
    assert_eq!((ignored.iter().count(), drawables(&node).len()), (left_out.len() + 1, 1));
    let drawn = &node.state_set.as_ref().unwrap().attributes;
    // Fog is off without its mode.
    assert_eq!(drawn.len(), classes.len() - left_out.len() - 1, "{drawn:?}");
    assert_eq!(node.state_set.as_ref().unwrap().bin.as_ref().map(|bin| bin.number), Some(3));
}

#[test]
fn broken_files_are_one_clear_error() {
    let error = |bytes: &[u8]| read_with(bytes, Vec::new(), &options()).unwrap_err().to_string();
    let whole = unusual_nodes(VERSION).bytes;
    for length in (12..whole.len()).step_by(7) {
        let error = error(&whole[..length]);
        assert!(error.contains("/set/a.osgb") && error.contains("OpenSceneGraph file"), "{length}: {error}");
    }
    let node = |write: &dyn Fn(&mut Ive)| {
        let mut file = Ive::new(VERSION);
        write(file.u32(0));
        file.bytes
    };
    let deep = node(&|file| {
        for id in 1..200 {
            file.u32(3).node("").u32s(&[1, id]);
        }
    });
    for (bytes, expected) in [
        (Ive::new(46).bytes, "version 46 of .ive, of which 45 is the newest is not supported"),
        (
            node(&|file| {
                file.u32(0xabcd);
            }),
            ".ive: a node of class 0xabcd is not supported",
        ),
        (
            node(&|file| {
                file.u32s(&[3, 7]);
            }),
            ".ive: osg::Node should follow 0 bytes before the end, not class osg::Image",
        ),
        (
            node(&|file| {
                file.u32(3).node("").u32(1 << 30);
            }),
            "a list of 1073741824 elements in the last 0 bytes",
        ),
        (deep, "depth of objects"),
        ([&[4, 3, 2, 1, 45, 0, 0, 0, 1, 0, 0, 0, 9, 0, 0, 0][..], b"no zlib"].concat(), "zlib: "),
    ] {
        let error = error(&bytes);
        assert!(error.contains(expected), "{error}");
    }
    // Heights that are equal take no bytes in the file.
    let flat = node(&|file| {
        file.u32(0x20_0001)
            .group("", 0, |_| ())
            .u32s(&[0, 0, 0, 0])
            .u32s(&[u32::MAX, 0, 0x20_0005, 0x20_0003])
            .object("");
        file.u32(u32::MAX).u32s(&[0, 0, 0, 0]).raw(&[0, 1]).u32s(&[40_000, 50_000]).f32s(&[0.0; 10]).u32(0);
        file.u32(2_000_000_000).raw(&[1]).f32s(&[7.0]);
    });
    assert!(error(&flat).contains("equal heights of an .ive file"), "{}", error(&flat));
}

#[test]
fn database_of_ive_files_is_followed_and_described() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("tiles")).unwrap();
    let root = folder.path().join("root.ive");
    std::fs::write(&root, paged(Ive::new(VERSION), true).compressed()).unwrap();
    let mut fine = Ive::big_endian(20);
    fine.triangle_geode(0);
    std::fs::write(folder.path().join("tiles/fine.ive"), &fine.bytes).unwrap();
    let uri = root.to_str().unwrap();
    let verified = verify(uri, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.failed, verified.ignored.len()), (0, 0), "{verified:?}");
    let info = inspect(uri, &Limits::default()).unwrap();
    assert_eq!(info.format, "OpenSceneGraph (ive, version 45)");
    let bytes = std::fs::read(&root).unwrap();
    let content = Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() };
    let page: Page = terrane::formats::decode(content, &ReadOptions::for_root(uri, Limits::default())).unwrap();
    assert!(page.bounding_sphere().radius_m > 1.0);
}

#[test]
fn tiles_of_terrains_read_as_in_text() {
    let locator = "Transform { 20 0 0 0 0 10 0 0 0 0 1 0 100 200 0 1 }";
    let colors = "ColorLayers 3 { Layer 0 osgTerrain::ImageLayer { UniqueID 30 FileName \"a.png\"
        Locator TRUE { osgTerrain::Locator { UniqueID 2 } }
        Image { ClassName osg::Image UniqueID 40 FileName \"a.png\" WriteHint 2 2 } }
        Layer 1 osgTerrain::ImageLayer { UniqueID 30 }
        Layer 2 osgTerrain::ProxyLayer { UniqueID 32 FileName \"c.tif\" } }";
    let text = kit::osg_files::terrain_tile(1, locator, [3, 2], "SkirtHeight 1", "0 1 2 10 20 51", colors);
    let image = vec![("/set/a.png".into(), Ok(crate::gltf_builder::png(4, [1, 2, 3])))];
    for version in [0, 22, 23, 26, 27, 34, 35, VERSION] {
        let tile = terrain_tile(version).bytes;
        assert_same(&tile, &text, &image);
        // The tile as a child of a group, before a triangle that shows where it ends.
        let mut file = Ive::new(version);
        let start = file.bytes.len();
        file.u32(100).group("", 2, |file| {
            file.raw(&tile[start..]).triangle_geode(101);
        });
        let (node, _) = read(&file.bytes);
        assert_eq!((node.children.len(), drawables(&node.children[1]).len()), (2, 1), "version {version}");
    }
}
