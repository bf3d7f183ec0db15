//! Nodes and drawables of OSG's other libraries: osgSim, osgFX, osgShadow, osgAnimation and osgText.

use glam::DVec3;
use kit::osg_files::{Osgb, VERSION, geode, osgt, triangle};
use terrane::scene::{AlphaMode, Topology};

use super::*;

/// A node of a class with two geodes below it.
fn over_two(class: &str, members: &str) -> String {
    let children = [geode(10, "", &[triangle(11, "")]), geode(20, "", &[triangle(21, "")])].join("\n");
    osgt(VERSION, &format!("{class} {{ UniqueID 1 Children 2 {{ {children} }} {members} }}"))
}

#[test]
fn effects_and_groups_keep_their_children() {
    for class in [
        "osgFX::Scribe",
        "osgFX::Cartoon",
        "osgShadow::ShadowedScene",
        "osgSim::OverlayNode",
        "osgSim::VisibilityGroup",
    ] {
        let (node, ignored) = read(over_two(class, "Enabled TRUE SelectedTechnique -1 More { 1 { } }"));
        assert_eq!(drawables(&node).len(), 2, "{class}");
        assert_eq!(ignored.count(&format!("OpenSceneGraph class {class} (its children are drawn)")), 1, "{ignored:?}");
    }
    let (node, _) = read(over_two("osgAnimation::Bone", "Matrix { 1 0 0 0 0 1 0 0 0 0 1 0 7 8 9 1 }"));
    assert!(matches!(node.kind, NodeKind::Transform(map) if map.translation == DVec3::new(7.0, 8.0, 9.0)));
    let bar = geode(1, "", &[triangle(11, "")]).replace("osg::Geode", "osgSim::ScalarBar");
    assert_eq!(drawables(&read(osgt(VERSION, &bar)).0).len(), 1);
    let morph = triangle(11, "").replace("osg::Geometry", "osgAnimation::MorphGeometry");
    let (node, ignored) = read(osgt(VERSION, &geode(1, "", &[morph])));
    assert_eq!(drawables(&node).len(), 1);
    assert_eq!(ignored.count("OpenSceneGraph class osgAnimation::MorphGeometry (its rest pose is drawn)"), 1);
}

#[test]
fn rigs_without_vertices_show_their_source() {
    let rig = format!(
        "osgAnimation::RigGeometry {{ UniqueID 2 InfluenceMap 1 {{ VertexInfluence \"bone\" 2 {{ 0 1 1 0.5 }} }}
        SourceGeometry TRUE {{ {} }} More {{ 1 }} }}",
        triangle(11, "")
    );
    let (node, ignored) = read(osgt(VERSION, &geode(1, "", &[rig])));
    assert_eq!(mesh(drawables(&node)[0]).vertices.len(), 3, "{ignored:?}");
}

#[test]
fn multi_switches_show_their_active_set() {
    let sets = "Values 2 { SwitchSet 2 { TRUE FALSE } SwitchSet 1 { FALSE } } ValueNames 2 { a \"b }\" }";
    for (members, expected) in [
        (format!("ActiveSwitchSet 1 {sets}"), [false, true]),
        (sets.to_owned(), [true, false]),
        (format!("NewChildDefaultValue FALSE ActiveSwitchSet 1 {sets}"), [false, false]),
        (format!("ActiveSwitchSet 5 {sets}"), [false, false]),
    ] {
        let (node, ignored) = read(over_two("osgSim::MultiSwitch", &members));
        assert!(matches!(&node.kind, NodeKind::Switch(shown) if shown[..] == expected), "{members}: {:?}", node.kind);
        assert!(ignored.is_empty(), "{ignored:?}");
    }
}

#[test]
fn impostors_are_levels_of_detail() {
    let (node, ignored) = read(over_two("osgSim::Impostor", "RangeList 2 { 0 50 50 900 } ImpostorThreshold 10"));
    assert!(matches!(&node.kind, NodeKind::Lod { ranges_m, .. } if ranges_m[1] == [50.0, 900.0]));
    assert!(ignored.is_empty(), "{ignored:?}");
}

#[test]
fn parts_with_degrees_of_freedom_stand_as_they_are() {
    let members = "MaxHPR 3 3 3 CurrentHPR 1.5707963267948966 0 0 CurrentTranslate 0 0 5 CurrentScale 1 1 1
        PutMatrix { 1 0 0 0 0 1 0 0 0 0 1 0 -1 0 0 1 } LimitationFlags 3 AnimationOn TRUE HPRMultOrder HPR";
    let (node, ignored) = read(over_two("osgSim::DOFTransform", members));
    assert!(ignored.is_empty(), "{ignored:?}");
    let NodeKind::Transform(map) = node.kind else { panic!("a transform: {node:?}") };
    assert!(map.transform_point3(DVec3::new(3.0, 0.0, 0.0)).abs_diff_eq(DVec3::new(1.0, 2.0, 5.0), 1e-6));
    // At rest it is nowhere else.
    let (node, _) = read(over_two("osgSim::DOFTransform", ""));
    assert!(matches!(node.kind, NodeKind::Group));
}

/// Two light points, of which one is on. Its sector, whose class is not read, needs the sizes of blocks.
#[test]
fn light_points_are_points() {
    for has_sizes in [false, true] {
        let mut file = Osgb::new(VERSION, has_sizes);
        file.object("osgSim::LightPointNode", 1, |file| {
            file.node_members("lights").raw(&[1]).u32(2).block(|file| {
                for (is_on, x) in [(true, 3.0), (false, 4.0)] {
                    file.block(|file| {
                        file.f32s(&[x, 2.0, 1.0]).f32s(&[1.0, 0.0, 0.0, 1.0]).raw(&[u8::from(is_on)]).u32(1);
                        file.f32s(&[1.0, 0.5]).raw(&[u8::from(has_sizes && is_on)]);
                        if has_sizes && is_on {
                            file.block(|file| {
                                file.object("osgSim::ConeSector", 9, |file| {
                                    file.raw(&[1, 2, 3]);
                                });
                            });
                        }
                        file.raw(&[0]);
                    });
                }
            });
            file.f32s(&[0.0, 30.0, 1e30]).raw(&[0, 0]);
        });
        let (node, ignored) = read(&file.bytes);
        assert_eq!(ignored.count("OpenSceneGraph class osgSim::ConeSector"), u64::from(has_sizes), "{ignored:?}");
        let drawable = drawables(&node)[0];
        let mesh = mesh(drawable);
        assert_eq!((mesh.topology, mesh.vertices.len()), (Topology::Points, 1));
        assert_eq!((mesh.vertices[0].position, mesh.vertices[0].color), ([3.0, 2.0, 1.0], [255, 0, 0, 255]));
        assert!(drawable.material.unlit);
    }
}

#[test]
fn dot_osg_has_the_same_classes() {
    let triangle = "Geode {\n Geometry {\n PrimitiveSets 1 {\n DrawArrays TRIANGLES 0 3\n }\n
        VertexArray Vec3Array 3 {\n 0 0 0\n 1 0 0\n 0 1 0\n }\n }\n }\n";
    let with =
        |class: &str, members: &str| format!("{class} {{\n{members}\n num_children 2\n {triangle} {triangle}\n}}\n");
    let sets = " NewChildDefaultValue 1\n ActiveSwitchSet 1\n ValueList 0 {\n 1\n 1\n }\n ValueList 1 {\n 0\n 1\n }";
    let (node, ignored) = read(with("osgSim::MultiSwitch", sets));
    assert!(matches!(&node.kind, NodeKind::Switch(shown) if shown[..] == [false, true]), "{node:?}");
    assert!(ignored.is_empty(), "{ignored:?}");
    let (node, _) = read(with("osgSim::DOFTransform", " currentTranslate 1 2 3\n currentScale 1 1 1\n multOrder PRH"));
    assert!(matches!(node.kind, NodeKind::Transform(map) if map.translation == DVec3::new(1.0, 2.0, 3.0)));
    let (node, ignored) = read(with("osgFX::Scribe", " enabled TRUE"));
    assert_eq!((drawables(&node).len(), ignored.iter().count()), (2, 1));
    let points =
        "osgSim::LightPointNode {\n num_lightpoints 2\n lightPoint {\n isOn TRUE\n position 1 2 3\n color 0 1 0 1\n }
        lightPoint {\n isOn FALSE\n position 4 5 6\n }\n}\n";
    let (node, ignored) = read(points);
    assert!(ignored.is_empty(), "{ignored:?}");
    assert_eq!(mesh(drawables(&node)[0]).vertices[0].position, [1.0, 2.0, 3.0]);
}

/// A text in text with the members behind its characters, which begin at the origin.
#[cfg(feature = "text")]
fn text(characters: &str, members: &str) -> String {
    format!(
        "osg::Geode {{ UniqueID 1 Drawables 1 {{ osgText::Text {{ UniqueID 2 StateSet TRUE {{ osg::StateSet {{ UniqueID 3
        AttributeList 1 {{ osg::Program {{ UniqueID 4 }} Value ON }} }} }} Font \"arial.ttf\" FontSize 32 40 CharacterSize 10 1
        {characters} {members} BackdropImplementation 4 }} }} }}"
    )
}

/// Returns the box around the letters of a text, without the margin of the glyphs, and its middle without the texts own place.
#[cfg(feature = "text")]
fn letters(node: &Node) -> (terrane::math::Aabb, DVec3, usize) {
    let mut at = node;
    let mut place = DVec3::ZERO;
    while !matches!(at.kind, NodeKind::Geode(_) | NodeKind::Billboard(_)) {
        if let NodeKind::Transform(map) = at.kind {
            place = map.translation;
        }
        at = at.children.first().expect("a text");
    }
    let drawable = match &at.kind {
        NodeKind::Geode(all) => &all[0],
        NodeKind::Billboard(billboard) => &billboard.drawables[0].1,
        kind => panic!("{kind:?}"),
    };
    let mesh = mesh(drawable);
    (mesh.bounds, place, mesh.vertices.len() / 4)
}

#[test]
#[cfg(feature = "text")]
fn texts_are_letters_at_their_place() {
    let read_text = |characters: &str, members: &str| {
        let (node, ignored) = read(osgt(VERSION, &text(characters, members)));
        assert!(ignored.is_empty(), "{ignored:?}");
        node
    };
    // A capital is 0.7 of the height; the rectangles of letters have a margin of a sixteenth.
    let margin = 10.0 / 16.0;
    let near = |a: f64, b: f64| (a - b).abs() < 0.3;
    let node = read_text("Text TRUE \"HH\"", "Position 5 6 7 Color 1 0 0 0.5");
    let (bounds, place, count) = letters(&node);
    assert_eq!((place, count), (DVec3::new(5.0, 6.0, 7.0), 2));
    assert!(near(bounds.min.y, -margin) && near(bounds.max.y, 7.0 + margin) && bounds.max.z == 0.0, "{bounds:?}");
    let width = bounds.max.x - bounds.min.x;
    assert!((10.0..18.0).contains(&width) && bounds.min.x > -margin && bounds.min.x < 1.0, "{bounds:?}");
    let drawable = drawables(&node)[0];
    assert_eq!(mesh(drawable).vertices[0].color, [255, 0, 0, 128]);
    assert!(drawable.material.unlit && drawable.material.double_sided && drawable.material.alpha == AlphaMode::Blend);
    // All texts share a texture.
    let other = read_text("Text TRUE \"x\"", "");
    let texture = |node: &Node| drawables(node)[0].material.texture.clone().unwrap();
    assert!(std::sync::Arc::ptr_eq(&texture(&node), &texture(&other)));
    // Every alignment, for a text of two lines: where its box or base line is.
    for (name, x, y) in [
        ("LEFT_TOP", 0.0, -17.0),
        ("LEFT_CENTER", 0.0, -8.5),
        ("LEFT_BOTTOM", 0.0, 0.0),
        ("CENTER_TOP", 0.5, -17.0),
        ("CENTER_CENTER", 0.5, -8.5),
        ("CENTER_BOTTOM", 0.5, 0.0),
        ("RIGHT_TOP", 1.0, -17.0),
        ("RIGHT_CENTER", 1.0, -8.5),
        ("RIGHT_BOTTOM", 1.0, 0.0),
        ("LEFT_BASE_LINE", 0.0, -10.0),
        ("CENTER_BASE_LINE", 0.5, -10.0),
        ("RIGHT_BASE_LINE", 1.0, -10.0),
        ("LEFT_BOTTOM_BASE_LINE", 0.0, 0.0),
        ("CENTER_BOTTOM_BASE_LINE", 0.5, 0.0),
        ("RIGHT_BOTTOM_BASE_LINE", 1.0, 0.0),
    ] {
        let (bounds, ..) = letters(&read_text("Text TRUE \"HH\nHH\"", &format!("Alignment {name}")));
        assert!(near(bounds.min.y + margin, y) && near(bounds.max.y - margin, y + 17.0), "{name}: {bounds:?}");
        let left = bounds.min.x + margin;
        assert!((left + x * (width - 2.0 * margin)).abs() < 1.2, "{name}: {bounds:?}");
    }
    // Planes: the directions of the line and of its height.
    for (axis, right, up) in [
        ("XY_PLANE", DVec3::X, DVec3::Y),
        ("REVERSED_XY_PLANE", -DVec3::X, DVec3::Y),
        ("XZ_PLANE", DVec3::X, DVec3::Z),
        ("REVERSED_XZ_PLANE", -DVec3::X, DVec3::Z),
        ("YZ_PLANE", DVec3::Y, DVec3::Z),
        ("REVERSED_YZ_PLANE", -DVec3::Y, DVec3::Z),
        ("USER_DEFINED_ROTATION Rotation 0.707106781186547 0 0 0.707106781186547", DVec3::X, DVec3::Z),
    ] {
        let (bounds, ..) = letters(&read_text("Text TRUE \"HHHH\"", &format!("AxisAlignment {axis}")));
        let far = bounds.center() + bounds.half_size() * bounds.center().signum();
        assert!(far.dot(right) > 20.0 && near(far.dot(up), 7.0 + margin), "{axis}: {bounds:?}");
    }
    // Lines are further apart with a spacing, and break where the width says so.
    let (bounds, ..) = letters(&read_text("LineSpacing 0.5 Text TRUE \"H\n\nH\"", ""));
    assert!(near(bounds.max.y - bounds.min.y - 2.0 * margin, 37.0), "{bounds:?}");
    let (bounds, _, count) = letters(&read_text("MaximumWidth 17 Text TRUE \"HH HH-HH\"", ""));
    assert!(count == 7 && near(bounds.max.y - bounds.min.y - 2.0 * margin, 27.0) && bounds.max.x < 18.0, "{bounds:?}");
}

#[test]
#[cfg(feature = "text")]
fn backdrops_of_texts_are_copies_behind_the_letters() {
    let read_text = |kind: &str, offset: &str| {
        let members = format!(
            "Color 1 0 0 0.5 BackdropType {kind} BackdropImplementation 4 BackdropOffset {offset} BackdropColor 0 0 1 0.5"
        );
        let (node, ignored) = read(osgt(VERSION, &text("Text TRUE \"HH\"", &members)));
        assert!(ignored.is_empty(), "{ignored:?}");
        mesh(drawables(&node)[0]).vertices.clone()
    };
    // The letters are drawn last, in their colour. Each copy has two rectangles.
    let offsets = |kind: &str, offset: &str| {
        let vertices = read_text(kind, offset);
        let (copies, letters) = vertices.split_at(vertices.len() - 8);
        assert!(letters.iter().all(|vertex| vertex.color == [255, 0, 0, 128]), "{kind}");
        assert!(copies.iter().all(|vertex| vertex.color == [0, 0, 255, 64]), "{kind}");
        let offsets: Vec<[i32; 2]> = copies
            .chunks_exact(8)
            .map(|copy| {
                let of = |i: usize, axis: usize| copy[i].position[axis] - letters[i].position[axis];
                let all = [0, 1].map(|axis| of(0, axis));
                assert!((0..8).all(|i| [0, 1].map(|axis| of(i, axis) - all[axis]).iter().all(|by| by.abs() < 1e-5)));
                // Hundredths of the height, which is 10.
                all.map(|by| (by * 10.0).round() as i32)
            })
            .collect();
        offsets
    };
    for (kind, expected) in [
        ("DROP_SHADOW_BOTTOM_RIGHT", [10, -5]),
        ("DROP_SHADOW_CENTER_RIGHT", [10, 0]),
        ("DROP_SHADOW_TOP_RIGHT", [10, 5]),
        ("DROP_SHADOW_BOTTOM_CENTER", [0, -5]),
        ("DROP_SHADOW_TOP_CENTER", [0, 5]),
        ("DROP_SHADOW_BOTTOM_LEFT", [-10, -5]),
        ("DROP_SHADOW_CENTER_LEFT", [-10, 0]),
        ("DROP_SHADOW_TOP_LEFT", [-10, 5]),
    ] {
        assert_eq!(offsets(kind, "0.1 0.05"), [expected], "{kind}");
    }
    // An outline is as wide as 0.8 of the offset to the right, on every side.
    let mut around = offsets("OUTLINE", "0.1 0.9");
    around.sort_unstable();
    let all = [-8, 0, 8].into_iter().flat_map(|right| [-8, 0, 8].map(|up| [right, up]));
    assert_eq!(around, all.filter(|offset| *offset != [0, 0]).collect::<Vec<_>>());
    assert!(offsets("NONE", "0.1 0.05").is_empty());
    // Offsets that are larger than a letter are invalid.
    for offset in ["nan 0", "1e30 0", "0 inf"] {
        assert!(offsets("DROP_SHADOW_TOP_RIGHT", offset).is_empty(), "{offset}");
    }
}

#[test]
#[cfg(feature = "text")]
fn boxes_of_texts_are_behind_and_around_the_letters() {
    let drawn = |mode: &str| {
        let members = format!("Position 1 2 3 DrawMode {mode} BoundingBoxMargin 2 BoundingBoxColor 0 0 1 0.5");
        let (node, ignored) = read(osgt(VERSION, &text("Text TRUE \"HH\"", &members)));
        assert!(ignored.is_empty(), "{ignored:?}");
        let of = |drawable: &&Drawable| {
            let mesh = mesh(drawable);
            (mesh.topology, mesh.vertices.len(), mesh.bounds, mesh.vertices[0].color)
        };
        drawables(&node).iter().map(of).collect::<Vec<_>>()
    };
    let near = |a: f64, b: f64| (a - b).abs() < 0.3;
    let letters = drawn("TEXT");
    assert_eq!((letters.len(), letters[0].1), (1, 8));
    let filled = drawn("TEXT|FILLED");
    assert_eq!((filled.len(), filled[0].1, filled[0].3), (1, 12, [0, 0, 255, 128]), "the box comes first");
    // A capital is 0.7 of the height of 10; the margin is added on all sides.
    assert!(near(filled[0].2.min.y, -2.0) && near(filled[0].2.max.y, 9.0), "{:?}", filled[0].2);
    let all = drawn("TEXT|BOUND|FILLED|ALIGNMENT");
    assert_eq!((all.len(), all[1].0, all[1].1, all[1].3), (2, Topology::Lines, 12, [255; 4]));
    assert!(near(all[1].2.min.y, -5.0), "the cross is as high as a letter");
    let outline = drawn("BOUND");
    assert_eq!((outline.len(), outline[0].1), (1, 8));
    assert!(outline[0].2.min.x == filled[0].2.min.x && outline[0].2.max.y == filled[0].2.max.y);
}

#[test]
#[cfg(feature = "text")]
fn texts_face_the_screen_and_keep_their_size() {
    use terrane::scene::{AutoScale, BillboardMode};
    const CAPPED: &str = "CharacterSizeMode OBJECT_COORDS_WITH_MAXIMUM_SCREEN_SIZE_CAPPED_BY_FONT_HEIGHT";
    for (before, behind, mode, scale, height) in [
        ("", "AxisAlignment SCREEN", BillboardMode::PointRotEye, None, 8.2),
        (
            "CharacterSizeMode SCREEN_COORDS",
            "AutoRotateToScreen TRUE",
            BillboardMode::PointRotEye,
            Some([0.0, f64::INFINITY]),
            8.2,
        ),
        // At most 40 pixels, and at most 10 units.
        (CAPPED, "", BillboardMode::NoRotation, Some([0.0, 0.25]), 33.0),
    ] {
        let (before, behind) = (format!("{before} Text TRUE \"H\""), format!("Position 1 2 3 {behind}"));
        let (node, ignored) = read(osgt(VERSION, &text(&before, &behind)));
        assert!(ignored.is_empty(), "{ignored:?}");
        let mut at = &node;
        while !at.children.is_empty() {
            at = &at.children[0];
        }
        let NodeKind::Billboard(billboard) = &at.kind else { panic!("{:?}", at.kind) };
        assert_eq!((billboard.mode, billboard.drawables[0].0), (mode, DVec3::new(1.0, 2.0, 3.0)));
        assert_eq!(billboard.auto_scale, scale.map(|[min, max]| AutoScale { min, max }));
        let bounds = mesh(&billboard.drawables[0].1).bounds;
        let size = bounds.max - bounds.min;
        let upwards = if mode == BillboardMode::PointRotEye { size.z } else { size.y };
        assert!((upwards - height).abs() < 0.05 * height, "{before} {behind}: {size}");
    }
}

#[test]
#[cfg(feature = "text")]
fn texts_read_the_same_in_every_format() {
    let letters_of = |bytes: &[u8]| {
        let (node, ignored) = read(bytes);
        let all: Vec<_> = drawables(&node).iter().flat_map(|drawable| mesh(drawable).vertices.clone()).collect();
        let kinds: Vec<String> = ignored.iter().map(|(kind, _)| kind.to_owned()).collect();
        (letters(&node).1, all, kinds)
    };
    let numbers = "Text FALSE osg::UIntArray { UniqueID 9 vector 4 { 65 214 937 1046 } }";
    let members = "Position 1 2 3 Alignment CENTER_TOP Rotation 0 1 0 0 DrawMode TEXT|BOUND Color 0 1 0 1
        BackdropType DROP_SHADOW_BOTTOM_LEFT BackdropImplementation 4 BackdropOffset 0.125 0.0625 BackdropColor 0 0 1 0.5
        ColorGradientMode OVERALL";
    let backdrop = [0.125, 0.0625, 0.0, 0.0, 1.0, 0.5];
    let expected = letters_of(osgt(VERSION, &text(numbers, members)).as_bytes());
    assert_eq!((expected.1.len(), expected.2.len()), (40, 1), "{:?}", expected.2);
    // The characters of bytes: UTF-8, or one a byte.
    let mut file = Osgb::new(VERSION, false);
    let bytes = |file: &mut Osgb, text: &[u8]| {
        file.raw(&(text.len() as u32).to_le_bytes()).raw(text);
    };
    file.object("osg::Geode", 1, |file| {
        file.node_members("").raw(&[1]).u32(1).block(|file| {
            file.object("osgText::Text", 2, |file| {
                file.node_members("").raw(&[0, 0, 0, 1, 1, 0]).u32(u32::MAX).raw(&[1]);
                file.raw(&[1]).text("arial.ttf").raw(&[1]).u32(32).u32(40).raw(&[1]).f32s(&[10.0, 1.0]);
                file.u32(0).f32s(&[0.0; 3]).raw(&[1, 1]);
                bytes(file, "A\u{d6}\u{3a9}\u{416}".as_bytes());
                file.f32s(&[1.0, 2.0, 3.0]).u32(3).u32(0).f64s(&[0.0, 1.0, 0.0, 0.0]).raw(&[0]).u32(0).u32(3);
                file.f32s(&[0.0; 5]).f32s(&[0.0, 1.0, 0.0, 1.0]).u32(5).u32(2).raw(&[1]).f32s(&backdrop).u32(2);
                file.raw(&[1]).block(|file| {
                    file.f64s(&[0.0; 16]);
                });
            });
        });
    });
    assert_eq!(letters_of(&file.bytes), expected);
    let older = |characters: &str| {
        format!(
            "Geode {{\n osgText::Text {{\n color 0 1 0 1\n font arial.ttf\n fontResolution 32 40\n characterSize 10 1\n alignment CENTER_TOP
            rotation 0 1 0 0\n layout LEFT_TO_RIGHT\n position 1 2 3\n drawMode 3\n {characters}\n backdropType DROP_SHADOW_BOTTOM_LEFT
            backdropHorizontalOffset 0.125\n backdropVerticalOffset 0.0625\n backdropColor 0 0 1 0.5\n colorGradientMode OVERALL\n }}\n}}\n"
        )
    };
    assert_eq!(letters_of(older("text 4 {\n 65 214 937 1046\n }").as_bytes()), expected);
    assert_eq!(letters_of(older("text \"A\u{d6}\u{3a9}\u{416}\"").as_bytes()), expected);
    let mut ive = kit::ive_files::Ive::new(45);
    ive.u32s(&[0, 6]).node("").u32s(&[1, 1, 0x1000_0001]).drawable().text("arial").u32s(&[32, 40]).f32s(&[10.0, 1.0]);
    ive.u32(0).f32s(&[0.0; 3]).u32(3).f32s(&[0.0, 1.0, 0.0, 0.0]).raw(&[0]).u32(0).f32s(&[1.0, 2.0, 3.0]);
    ive.f32s(&[0.0, 1.0, 0.0, 1.0]).u32(3).f32s(&[0.0; 5]).u32(5).f32s(&backdrop).u32s(&[4, 2]).f32s(&[0.0; 16]);
    ive.raw(&[0]).u32s(&[4, 65, 214, 937, 1046]);
    assert_eq!(letters_of(&ive.bytes), expected);
    // Bytes that are no UTF-8 are a letter each, in all of them.
    let mut latin = osgt(VERSION, &text("Text TRUE \"A#\"", "")).into_bytes();
    let at = latin.windows(3).position(|bytes| bytes == b"\"A#").unwrap() + 2;
    latin[at] = 0xd6;
    assert_eq!(letters_of(&latin).1, letters_of(osgt(VERSION, &text("Text TRUE \"A\u{d6}\"", "")).as_bytes()).1);
    // A letter that the typeface lacks is a box, and noted; texts of invalid sizes draw nothing.
    let (node, ignored) = read(osgt(VERSION, &text("Text TRUE \"\u{4e2d}\"", "")));
    assert_eq!((drawables(&node).len(), ignored.iter().count()), (1, 1));
    for size in ["CharacterSize nan 1", "CharacterSize 1 0", "CharacterSize -1 1", "CharacterSize 1 1 LineSpacing inf"]
    {
        let (node, ignored) = read(osgt(VERSION, &text("Text TRUE \"A\"", "").replace("CharacterSize 10 1", size)));
        assert_eq!((drawables(&node).len(), ignored.iter().count()), (0, 1), "{size}");
    }
    let (node, _) = read(osgt(VERSION, &text("Text TRUE \"A\"", "Position nan 0 0")));
    assert!(drawables(&node).is_empty() && terrane::scene::Page::from_node(node).is_ok());
}
