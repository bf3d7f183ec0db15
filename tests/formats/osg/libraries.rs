//! Nodes and drawables of OSG's other libraries: osgSim, osgFX, osgShadow and osgAnimation.

use glam::DVec3;
use kit::osg_files::{Osgb, VERSION, geode, osgt, triangle};
use terrane::scene::Topology;

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
