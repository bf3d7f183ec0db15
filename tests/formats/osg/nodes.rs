//! Nodes: transforms, switches, levels of detail, tiles and proxies.

use glam::DVec3;
use terrane::math::BoundingVolume;
use terrane::scene::{Page, ProxyLoading, RangeMode};

use super::*;
use kit::osg_files::{VERSION, geode, group, osgt, triangle};

#[test]
fn transforms_place_their_children() {
    let child = |id: u32| geode(id, "", &[triangle(id + 1, "")]);
    let turned = format!(
        "osg::MatrixTransform {{ UniqueID 2 Children 1 {{ {} }} Matrix {{ 0 1 0 0 \n -1 0 0 0 \n 0 0 1 0 \n 10 20 30 1 }} }}",
        child(10)
    );
    let placed = format!(
        "osg::PositionAttitudeTransform {{ UniqueID 3 Name \"a \\\"b\\\"\" Children 1 {{ {} }}
        Position 100 0 0 Attitude 0 0 1 0 Scale 2 2 2 PivotPoint 1 0 0 }}",
        child(20)
    );
    let (node, ignored) = read(osgt(VERSION, &group(1, &[turned, placed])));
    assert!(ignored.is_empty(), "{ignored:?}");
    let map = |node: &Node| match node.kind {
        NodeKind::Transform(map) => map,
        _ => panic!("a transform"),
    };
    // x becomes y, y becomes -x.
    assert!(map(&node.children[0]).transform_point3(DVec3::X).distance(DVec3::new(10.0, 21.0, 30.0)) < 1e-12);
    // The pivot lands on the position; half a turn and twice the size around it.
    let placed = map(&node.children[1]);
    assert!(placed.transform_point3(DVec3::X).distance(DVec3::new(100.0, 0.0, 0.0)) < 1e-9);
    assert!(placed.transform_point3(DVec3::new(2.0, 0.0, 5.0)).distance(DVec3::new(98.0, 0.0, 10.0)) < 1e-9);
    assert_eq!(node.children[1].name, "a \"b\"");
}

#[test]
fn switches_and_ranges_count_children_that_are_skipped() {
    let unknown = "osgFoo::Bar { UniqueID 5 Text \"a } b\" More { 1 2 { 3 } } }".to_owned();
    let children = [unknown, geode(10, "", &[triangle(11, "")]), geode(20, "NodeMask 0x10", &[triangle(21, "")])];
    let all = children.join("\n");
    let switch = format!("osg::Switch {{ UniqueID 2 Children 3 {{ {all} }} ValueList 3 {{ FALSE TRUE FALSE }} }}");
    let (node, ignored) = read(osgt(VERSION, &switch));
    let NodeKind::Switch(shown) = &node.kind else { panic!("a switch") };
    assert_eq!((shown.as_slice(), node.children.len()), (&[false, true, false][..], 3));
    assert_eq!((ignored.count("OpenSceneGraph class osgFoo::Bar"), node.children[2].mask), (1, 0x10));

    let lod = format!("osg::LOD {{ UniqueID 2 Children 3 {{ {all} }} RangeList 2 {{ 0 100 \n 100 1e+30 }} }}");
    let (node, _) = read(osgt(VERSION, &lod));
    let NodeKind::Lod { center, ranges_m } = &node.kind else { panic!("levels") };
    assert_eq!(ranges_m[..2], [[0.0, 100.0], [100.0, f64::from(1e30f32)]]);
    assert_eq!((ranges_m.len(), ranges_m[2]), (3, [f64::MAX; 2]), "a child without a range is never shown");
    assert!(center.distance(DVec3::new(0.5, 0.5, 0.0)) < 1e-6);

    let by_size = format!(
        "osg::LOD {{ UniqueID 2 Children 3 {{ {all} }} CenterMode USER_DEFINED_CENTER UserCenter 1 2 3 4
        RangeMode PIXEL_SIZE_ON_SCREEN RangeList 1 {{ 0 50 }} }}"
    );
    let (node, _) = read(osgt(VERSION, &by_size));
    let NodeKind::LodByPixelSize { center, radius_m, ranges_px } = &node.kind else { panic!("levels") };
    assert_eq!((*center, *radius_m, ranges_px[0]), (DVec3::new(1.0, 2.0, 3.0), 4.0, [0.0, 50.0]));
}

/// A PagedLOD in text: its first child is in the file, the others are files.
fn paged_lod(mode: &str, path: &str, ranges: &[&str], files: &[&str]) -> String {
    let names: Vec<String> =
        std::iter::once("\"\"".to_owned()).chain(files.iter().map(|f| format!("\"{f}\""))).collect();
    let priorities = "0 1 ".repeat(names.len());
    format!(
        "osg::PagedLOD {{ UniqueID 1 CenterMode USER_DEFINED_CENTER UserCenter 1 2 3 50 {mode}
        RangeList {} {{ {} }} {path} RangeDataList {} {{ {} }} PriorityList {} {{ {priorities} }} Children 1 {{ {} }} }}",
        ranges.len(),
        ranges.join("\n"),
        names.len(),
        names.join("\n"),
        names.len(),
        geode(10, "", &[triangle(11, "")])
    )
}

#[test]
fn paged_levels_by_size_become_a_chain_of_tiles() {
    let text = paged_lod(
        "RangeMode PIXEL_SIZE_ON_SCREEN",
        "DatabasePath FALSE",
        &["0 400", "400 1000", "1000 1e+30"],
        &["level 1.osgb", "sub\\\\level#2.osgb"],
    );
    let (node, ignored) = read(osgt(VERSION, &text));
    assert!(ignored.is_empty(), "{ignored:?}");
    let [first, second, third] = tiles(&node)[..] else { panic!("three tiles: {node:?}") };
    let size = |tile: &PagedLod| match tile.range_mode {
        RangeMode::PixelSize { center, radius_m, size_px } => (center, radius_m, size_px),
        _ => panic!("by size"),
    };
    assert_eq!(size(first), (DVec3::new(1.0, 2.0, 3.0), 50.0, 400.0));
    assert_eq!((size(second).2, size(third).2), (1000.0, f64::INFINITY));
    let BoundingVolume::Sphere(sphere) = first.bounds else { panic!("a sphere") };
    assert_eq!((sphere.center, sphere.radius_m), (DVec3::new(1.0, 2.0, 3.0), 50.0));
    assert_eq!(second.content.as_deref(), Some("/set/level 1.osgb"));
    assert_eq!(third.content.as_deref(), Some("/set/sub/level#2.osgb"));
    // The first content is in memory.
    assert!(first.reader_data.as_ref().is_some_and(|data| data.is_whole_content() && data.size_bytes() > 36));
    assert_eq!(drawables(&read_part(first).unwrap()).len(), 1);
    Page::from_node(node).unwrap();
}

#[test]
fn paged_levels_by_distance_start_with_the_farthest() {
    let text = paged_lod("", "", &["50 1e+30", "0 50"], &["near.osgb"]);
    let (node, _) = read(osgt(VERSION, &text));
    let [far, near] = tiles(&node)[..] else { panic!("two tiles") };
    assert_eq!(far.range_mode, RangeMode::Distance { center: DVec3::new(1.0, 2.0, 3.0), range_m: 50.0 });
    assert_eq!(near.content.as_deref(), Some("/set/near.osgb"));
    // Beyond the last range nothing is shown.
    let text = paged_lod("", "", &["50 900", "10 50"], &["near.osgb"]);
    let (node, _) = read(osgt(VERSION, &text));
    let NodeKind::Lod { ranges_m, .. } = &node.kind else { panic!("levels: {node:?}") };
    assert_eq!((ranges_m.as_slice(), tiles(&node).len()), (&[[10.0, 900.0]][..], 2));
}

#[test]
fn paths_outside_of_the_set_are_refused_alone() {
    for (path, expected) in [
        ("DatabasePath TRUE \"sub/\"", Ok("/set/sub/b.osgb")),
        ("DatabasePath TRUE \"/home/me/\"", Ok("/set/b.osgb")),
        ("DatabasePath TRUE \"C:\\\\work\"", Ok("/set/b.osgb")),
        ("DatabasePath TRUE \"../../other\"", Err("leaves the tile set's folder")),
    ] {
        let (node, ignored) = read(osgt(VERSION, &paged_lod("", path, &["50 1e+30", "0 50"], &["b.osgb"])));
        let tile = tiles(&node)[1];
        match expected {
            Ok(uri) => assert_eq!(tile.content.as_deref(), Some(uri), "{path}"),
            Err(reason) => assert!(read_part(tile).unwrap_err().to_string().contains(reason), "{path}"),
        }
        assert_eq!(ignored.iter().count(), usize::from(expected == Ok("/set/b.osgb")), "{path}: {ignored:?}");
        assert_eq!(drawables(&read_part(tiles(&node)[0]).unwrap()).len(), 1, "the rest draws");
    }
    for escape in ["../../x.osgb", "/etc/passwd", "file:///etc/passwd", "http://a.org/x.osgb"] {
        let (node, _) = read(osgt(VERSION, &paged_lod("", "", &["50 1e+30", "0 50"], &[escape])));
        assert!(read_part(tiles(&node)[1]).is_err(), "{escape}");
    }
}

#[test]
fn proxies_load_as_they_say() {
    let proxy =
        |members: &str| format!("osg::ProxyNode {{ UniqueID 1 FileNames 1 {{ \"b c.osgt\" }} Children 0 {members} }}");
    for (members, loading, radius_m) in [
        ("", ProxyLoading::Immediately, f64::INFINITY),
        ("LoadingExternalReferenceMode DEFER_LOADING_TO_DATABASE_PAGER", ProxyLoading::DeferToPager, f64::INFINITY),
        (
            "LoadingExternalReferenceMode NO_AUTOMATIC_LOADING CenterMode USER_DEFINED_CENTER UserCenter 0 0 0 7",
            ProxyLoading::Never,
            7.0,
        ),
    ] {
        let (node, _) = read(osgt(VERSION, &proxy(members)));
        let NodeKind::ProxyNode(proxy) = &node.kind else { panic!("a proxy") };
        assert_eq!((&*proxy.uri, proxy.loading, proxy.bounds.radius_m), ("/set/b c.osgt", loading, radius_m));
    }
}

#[test]
fn sequences_show_the_first_child_that_plays() {
    let children = [geode(10, "", &[triangle(11, "")]), geode(20, "", &[triangle(21, "")])];
    let sequence = group(1, &children).replace("osg::Group", "osg::Sequence");
    let end = sequence.rfind('}').unwrap();
    let with = |members: &str| read(osgt(VERSION, &format!("{} {members} }}", &sequence[..end])));
    for (members, expected) in [
        ("TimeList 2 { 1 2 } LoopMode SWING", [true, false]),
        ("TimeList 2 { 1 2 } Begin 1 Speed 2 NumRepeats 3 DefaultTime 2 Mode START Sync TRUE", [false, true]),
        ("Begin -1", [false, true]),
        ("Begin 77", [false, true]),
    ] {
        let (node, ignored) = with(members);
        let NodeKind::Switch(shown) = &node.kind else { panic!("{node:?}") };
        assert_eq!(shown, &expected, "{members}");
        let kinds: Vec<_> = ignored.iter().collect();
        assert_eq!(kinds, [("OpenSceneGraph class osg::Sequence (its first child is drawn)", 1)]);
    }
}

#[test]
fn programs_have_one_name() {
    let state = "StateSet TRUE { osg::StateSet { UniqueID 30 AttributeList 1 { osg::Program { UniqueID 31 AttribBinding 0 } Value OFF }
        UniformList 1 { osg::Uniform { UniqueID 32 Type FLOAT } Value ON } } }";
    let (node, ignored) = read(osgt(VERSION, &geode(10, state, &[triangle(11, "")])));
    assert_eq!(drawables(&node).len(), 1);
    let kinds: Vec<_> = ignored.iter().collect();
    assert_eq!(kinds, [("OpenSceneGraph: shader programs in GLSL (not run)", 1)]);
}

#[test]
fn animated_transforms_have_their_first_pose() {
    let point = |time: u32, x: u32| format!("Time {time} {{ Position {x} 0 0 Rotation 0 0 1 0 Scale 2 2 2 }}");
    let path = format!(
        "osg::AnimationPath {{ UniqueID 4 TimeControlPointMap 2 {{ {} {} }} LoopMode SWING }}",
        point(5, 9),
        point(0, 3)
    );
    let callback = format!(
        "UpdateCallback TRUE {{ osg::AnimationPathCallback {{ UniqueID 3 AnimationPath TRUE {{ {path} }} PivotPoint 1 0 0
        TimeMultiplier 2 }} }}"
    );
    let text = format!(
        "osg::MatrixTransform {{ UniqueID 2 {callback} Children 1 {{ {} }} Matrix {{ 1 0 0 0 \n 0 1 0 0 \n 0 0 1 0 \n 7 7 7 1 }} }}",
        geode(10, "", &[triangle(11, "")])
    );
    let (node, ignored) = read(osgt(VERSION, &text));
    let NodeKind::Transform(map) = node.kind else { panic!("{node:?}") };
    // Half a turn about z after the pivot was moved to the origin, twice the size, and the position.
    assert!(map.transform_point3(DVec3::new(2.0, 1.0, 0.0)).distance(DVec3::new(1.0, -2.0, 0.0)) < 1e-12, "{map:?}");
    let kinds: Vec<_> = ignored.iter().collect();
    assert_eq!(kinds, [("OpenSceneGraph class osg::AnimationPathCallback (its first pose is drawn)", 1)]);
}
