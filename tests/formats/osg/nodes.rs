//! Nodes: transforms, switches, levels of detail, tiles and proxies.

use glam::{DVec3, DVec4};
use terrane::math::BoundingVolume;
use terrane::scene::{
    IntersectionVisitor, LineSegmentIntersector, Page, ProxyLoading, RangeMode, ReferenceFrame, RenderOrder, Scene,
    UpdateInfo,
};
use terrane::state::{Light, Mode, StateValue};

use super::*;
use kit::osg_files::{Osgb, VERSION, geode, group, osgt, triangle};

/// The members of a Camera that draws over the view in units of a hundredth of its sides.
const OVER_THE_VIEW: &str = "ReferenceFrame ABSOLUTE_RF ClearMask DEPTH ClearColor 0 0 0 1
    ProjectionMatrix { 0.02 0 0 0 \n 0 0.02 0 0 \n 0 0 -1 0 \n -1 -1 -0 1 } RenderOrder POST_RENDER 3 InheritanceMask CULL_MASK";

/// A Camera with a geode of a triangle.
fn camera(members: &str) -> String {
    osgt(
        VERSION,
        &format!("osg::Camera {{ UniqueID 1 Children 1 {{ {} }} {members} }}", geode(2, "", &[triangle(3, "")])),
    )
}

#[test]
fn cameras_draw_over_the_view() {
    let (node, ignored) = read(camera(OVER_THE_VIEW));
    assert!(ignored.is_empty(), "{ignored:?}");
    let NodeKind::Camera(made) = &node.kind else { panic!("{:?}", node.kind) };
    assert_eq!((made.order, made.frame), (RenderOrder::PostRender(3), ReferenceFrame::Absolute));
    assert_eq!((made.clear_color, made.clear_depth), (None, true));
    let projection = made.projection.unwrap();
    assert!(projection.project_point3(DVec3::new(75.0, 25.0, 0.0)).distance(DVec3::new(0.5, -0.5, 0.5)) < 1e-9);
    assert_eq!(drawables(&node).len(), 1);

    let (perspective, _) = read(camera(
        "ReferenceFrame ABSOLUTE_RF ProjectionMatrix { 1 0 0 0 \n 0 1 0 0 \n 0 0 -1.5 -1 \n 0 0 -2.5 0 }
        ViewMatrix { 1 0 0 0 \n 0 1 0 0 \n 0 0 1 0 \n 0 0 -7 1 } RenderOrder NESTED_RENDER 0",
    ));
    let NodeKind::Camera(made) = &perspective.kind else { panic!("{:?}", perspective.kind) };
    assert_eq!((made.order, made.clear_color), (RenderOrder::Nested, Some([0.0; 4])));
    assert_eq!(made.view.translation, DVec3::new(0.0, 0.0, -7.0));
    // The near plane is 1 m in front of the eye.
    assert!((made.projection.unwrap().project_point3(DVec3::new(0.0, 0.0, -1.0)).z - 1.0).abs() < 1e-9);
}

/// The members of a Camera in binary, in which nothing but their order tells them apart.
#[test]
fn cameras_in_binary_are_those_of_text() {
    for version in [100, VERSION] {
        let mut file = Osgb::new(version, true);
        file.object("osg::Camera", 1, |file| {
            file.node_members("").children(1, |file| {
                file.triangle_geode(10);
            });
            // The frame, event focus, what is cleared and with which values; no colour mask, no viewport.
            file.u32(1).raw(&[1]);
            if version < 123 {
                file.raw(&[1]);
            }
            file.u32(0x100).f32s(&[0.5; 4]).f32s(&[0.0; 4]).f64s(&[1.0]).u32(0).raw(&[0, 0]).u32(0).u32(1);
            for matrix in [2.0, 1.0] {
                let row = |at: usize| std::array::from_fn::<f64, 4, _>(|i| if i == at { matrix } else { 0.0 });
                let rows = [row(0), row(1), row(2).map(|z| -z), [0.0, 0.0, 0.0, 1.0]].concat();
                file.block(|file| {
                    file.f64s(&rows);
                });
            }
            // Behind the order are two buffers and the target.
            file.raw(&[1]).u32(2).u32(7).u32(0).u32(0).u32(3).raw(&[0]).raw(&[9; 40]);
        });
        let (node, ignored) = read(&file.bytes);
        assert!(ignored.is_empty(), "{version}: {ignored:?}");
        let NodeKind::Camera(made) = &node.kind else { panic!("{:?}", node.kind) };
        assert_eq!((made.order, made.frame), (RenderOrder::PostRender(7), ReferenceFrame::Absolute));
        assert_eq!((made.clear_color, made.clear_depth), (None, true));
        assert_eq!(made.projection.unwrap().x_axis.x, 2.0);
        assert_eq!(drawables(&node).len(), 1);
    }
}

#[test]
fn cameras_that_draw_elsewhere_are_counted() {
    let over = |from: &str, to: &str| camera(&OVER_THE_VIEW.replacen(from, to, 1));
    for (file, reason) in [
        (
            over("InheritanceMask", "RenderTargetImplementation FRAME_BUFFER_OBJECT InheritanceMask"),
            "it draws to a texture or to a window",
        ),
        (
            over("InheritanceMask", "BufferAttachmentMap 1 { Attachment COLOR_BUFFER { Type 0 } } InheritanceMask"),
            "it draws to a texture or to a window",
        ),
        (
            over("ProjectionMatrix", "Viewport TRUE { osg::Viewport { UniqueID 9 X 0 } } ProjectionMatrix"),
            "it draws to a part of the window",
        ),
        (over("POST_RENDER", "PRE_RENDER"), "it draws before the view, which covers it"),
        (over("ReferenceFrame ABSOLUTE_RF", ""), "its projection is relative"),
        (over("0 0 -1 0", "0 0 nan 0"), "its projection is unusual"),
    ] {
        let (node, ignored) = read(file);
        assert_eq!(ignored.count(&format!("OpenSceneGraph class osg::Camera ({reason})")), 1, "{ignored:?}");
        assert!(drawables(&node).is_empty(), "{reason}");
    }
}

/// The image shows a quad that the file draws over the lower left quarter of the view.
#[test]
fn overlays_of_files_are_seen_wherever_the_eye_is() {
    let Some(mut rig) = kit::rig::rig("overlays_of_files_are_seen_wherever_the_eye_is") else { return };
    let quad = "osg::Geometry { UniqueID 4 PrimitiveSetList 1 { osg::DrawArrays { UniqueID 5 Mode QUADS Count 4 } }
        VertexArray TRUE { osg::Vec3Array { UniqueID 6 vector 4 { 0 0 -5 \n 50 0 -5 \n 50 50 -5 \n 0 50 -5 } } }
        ColorArray TRUE { osg::Vec4Array { UniqueID 7 Binding BIND_OVERALL vector 1 { 0 1 0 1 } } } }";
    let unlit = "StateSet TRUE { osg::StateSet { UniqueID 8 ModeList 1 { GL_LIGHTING OFF } } }";
    let overlay =
        camera(OVER_THE_VIEW).replace(&geode(2, "", &[triangle(3, "")]), &geode(2, unlit, &[quad.to_owned()]));
    let older = "Projection {\n Matrix {\n 0.02 0 0 0\n 0 0.02 0 0\n 0 0 -1 0\n -1 -1 0 1\n }\n MatrixTransform {\n
        referenceFrame ABSOLUTE\n Geode {\n StateSet {\n GL_LIGHTING OFF\n GL_DEPTH_TEST OFF\n }\n Geometry {\n PrimitiveSets 1 {\n DrawArrays QUADS 0 4\n
        }\n VertexArray Vec3Array 4 {\n 0 0 0\n 50 0 0\n 50 50 0\n 0 50 0\n }\n ColorBinding OVERALL\n ColorArray Vec4Array 1 {\n
        0 1 0 1\n }\n }\n }\n }\n}\n";
    for file in [overlay, older.to_owned()] {
        let (node, ignored) = read(file);
        assert!(ignored.is_empty(), "{ignored:?}");
        // Somewhere else in the scene.
        let scene = rig.scene(Node::transform(glam::DAffine3::from_translation(DVec3::splat(1e5)), vec![node]));
        let picture = rig.picture(&scene, &kit::rig::unit_camera(64), &kit::rig::plain());
        rig.release(scene);
        let errors = rig.renderer.take_errors();
        assert!(errors.is_empty(), "{errors:?}");
        let green = picture.pixels().filter(|pixel| pixel.0[..3] == [0, 255, 0]).count();
        assert_eq!(green, 32 * 32);
        assert_eq!(picture.get_pixel(3, 60).0[..3], [0, 255, 0]);
    }
}

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

/// A node in text with triangles as children, 10 m apart.
fn over_triangles(class: &str, count: u32, members: &str) -> String {
    let child = |at: u32| {
        let triangle = geode(100 * at + 110, "", &[triangle(100 * at + 120, "")]);
        let matrix = format!("1 0 0 0 0 1 0 0 0 0 1 0 {} 0 0 1", 10 * at);
        format!(
            "osg::MatrixTransform {{ UniqueID {} Children 1 {{ {triangle} }} Matrix {{ {matrix} }} }}",
            100 * at + 101
        )
    };
    let children: Vec<String> = (0..count).map(child).collect();
    format!("{class} {{ UniqueID 1 Children {count} {{ {} }} {members} }}", children.join("\n"))
}

/// Returns the tens of metres at which triangles are shown.
fn shown(scene: &Scene) -> Vec<i32> {
    let is_hit = |at: &i32| {
        let over = DVec3::new(10.0 * f64::from(*at) + 0.2, 0.2, 5.0);
        let mut line = LineSegmentIntersector::new(over, over - 10.0 * DVec3::Z);
        IntersectionVisitor::new().traverse(scene, &mut line);
        line.first_intersection().is_some()
    };
    (-1..9).filter(is_hit).collect()
}

fn update(scene: &mut Scene, frame: u32, simulation_time_s: f64) {
    scene.update_traversal(&UpdateInfo { frame, reference_time_s: 0.0, simulation_time_s });
}

fn scene_of(text: &str) -> Scene {
    let (node, ignored) = read(osgt(VERSION, text));
    assert!(ignored.is_empty(), "{ignored:?}");
    let mut scene = Scene::new();
    scene.add_root(Page::from_node(node).unwrap());
    scene
}

#[test]
fn sequences_play_by_the_simulation_time() {
    let with = |members: &str| scene_of(&over_triangles("osg::Sequence", 3, members));
    let mut scene = with("TimeList 3 { 1 2 3 } LoopMode SWING Speed 2 Mode START");
    assert_eq!(shown(&scene), [0], "before the first update");
    // Twice as slow: 2 s, 4 s, 6 s, and back.
    for (frame, (time_s, child)) in
        (0..).zip([(0.0, 0), (1.9, 0), (2.0, 1), (6.0, 2), (12.0, 1), (16.0, 0), (166.0, 2)])
    {
        update(&mut scene, frame, time_s);
        assert_eq!(shown(&scene), [child], "{time_s} s");
    }
    let revision = scene.revision();
    update(&mut scene, 99, 167.0);
    assert_eq!(scene.revision(), revision, "a frame that shows the same child changes nothing");
    // One that ends begins with its first update, and costs nothing afterwards.
    let mut scene = with("TimeList 3 { 1 2 3 } Begin -1 End 0 Speed 1 NumRepeats 1 Mode START ClearOnStop TRUE");
    for (frame, (time_s, children)) in (0..).zip([(50.0, &[2][..]), (53.0, &[1]), (55.0, &[0]), (56.0, &[])]) {
        assert!(scene.has_update_callbacks());
        update(&mut scene, frame, time_s);
        assert_eq!(shown(&scene), children, "{time_s} s");
    }
    assert!(!scene.has_update_callbacks());
    // Without a speed each frame shows the next one, as in OSG.
    let mut scene = with("Mode START");
    for frame in 7..12 {
        update(&mut scene, frame, 0.0);
        assert_eq!(shown(&scene), [frame as i32 % 3]);
    }
    // OSG shows nothing of one that does not play.
    for members in ["Speed 1", "Speed 1 Mode PAUSE", "Mode STOP"] {
        let scene = with(members);
        assert!(shown(&scene).is_empty() && !scene.has_update_callbacks(), "{members}");
    }
}

/// A page of a tile tree plays while it is there, and leaves nothing behind.
#[test]
fn sequences_of_pages_come_and_go() {
    let paged =
        "osg::PagedLOD { UniqueID 9 RangeList 1 { 0 1e30 } RangeDataList 1 { \"b.osgt\" } PriorityList 1 { 0 1 } }";
    let mut scene = scene_of(paged);
    let root = scene.roots()[0];
    let slot = terrane::scene::NodeId { page: root, index: 0 };
    let text = osgt(VERSION, &over_triangles("osg::Sequence", 2, "TimeList 2 { 1 1 } Speed 1 Mode START"));
    for round in 0..2 {
        assert!(!scene.has_update_callbacks());
        let page = Page::from_node(read(&text).0).unwrap();
        let page = scene.attach(slot, page).unwrap_or_else(|error| panic!("{}", error.0));
        for (time_s, child) in [(0.5, 0), (1.5, 1), (2.5, 0)] {
            update(&mut scene, 0, time_s);
            assert_eq!(shown(&scene), [child], "round {round}");
        }
        scene.detach(page).unwrap();
    }
    assert!(!scene.has_update_callbacks() && shown(&scene).is_empty());
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
fn transforms_follow_their_paths() {
    let point = |time: u32, x: u32| format!("Time {time} {{ Position {x} 0 0 Rotation 0 0 0 1 Scale 1 1 1 }}");
    let path = |looping: &str| {
        let points = format!("{} {}", point(5, 51), point(1, 11));
        format!("osg::AnimationPath {{ UniqueID 4 TimeControlPointMap 2 {{ {points} }} {looping} }}")
    };
    let transform = |class: &str, callback: &str, path: &str| {
        let callback = format!(
            "UpdateCallback TRUE {{ osg::AnimationPathCallback {{ UniqueID 3 {} {callback} }} }}",
            if path.is_empty() { String::new() } else { format!("AnimationPath TRUE {{ {path} }} PivotPoint 1 0 0") }
        );
        let child = geode(10, "", &[triangle(11, "")]);
        format!("{class} {{ UniqueID 2 {callback} Children 1 {{ {child} }} }}")
    };
    for class in ["osg::MatrixTransform", "osg::PositionAttitudeTransform"] {
        // Ten metres a second, twice as fast, half a second later. At the start it is 1 s before the first point.
        let mut scene = scene_of(&transform(class, "TimeOffset 0.5 TimeMultiplier 2", &path("LoopMode SWING")));
        for (time_s, place) in [(1.0, 1), (2.0, 3), (3.0, 5), (4.0, 3), (5.0, 1), (7.0, 5)] {
            update(&mut scene, 0, time_s);
            assert_eq!(shown(&scene), [place], "{class} at {time_s} s");
        }
        let mut scene = scene_of(&transform(class, "", &path("")));
        for (time_s, place) in [(1.0, 1), (4.0, 4), (6.0, 2)] {
            update(&mut scene, 0, time_s);
            assert_eq!(shown(&scene), [place], "{class} around at {time_s} s");
        }
        // Once along the path since the first update.
        let mut scene = scene_of(&transform(class, "", &path("LoopMode NO_LOOPING")));
        for (time_s, place) in [(70.0, 1), (73.0, 3), (75.0, 5)] {
            assert!(scene.has_update_callbacks());
            update(&mut scene, 0, time_s);
            assert_eq!(shown(&scene), [place], "{class} once at {time_s} s");
        }
        assert!(!scene.has_update_callbacks());
    }
    // A path that is paused, or that is not there, moves nothing.
    for (callback, path) in [("Pause TRUE", path("")), ("", String::new())] {
        let scene = scene_of(&transform("osg::MatrixTransform", callback, &path));
        assert!(!scene.has_update_callbacks());
        assert_eq!(shown(&scene), [0]);
    }
    // The inverse of a place: 11 m to the west, and the pivot.
    let inverse = transform("osg::MatrixTransform", "UseInverseMatrix TRUE", &path("LoopMode NO_LOOPING"));
    let inverse = inverse.replace("11 0 0", "9 0 0");
    assert_eq!(shown(&scene_of(&inverse)), [-1]);
}

/// In binary the members of a callback depend on the version.
#[test]
fn binary_paths_are_read() {
    for version in [100, VERSION] {
        let mut file = Osgb::new(version, false);
        file.object("osg::MatrixTransform", 1, |file| {
            file.object_members("").raw(&[0, 0, 1]);
            file.object("osg::AnimationPathCallback", 2, |file| {
                file.object_members("");
                if version < 112 {
                    file.raw(&[0]);
                }
                file.raw(&[1]).object("osg::AnimationPath", 3, |file| {
                    file.object_members("").raw(&[1]).u32(2).block(|file| {
                        for (time, x) in [(0.0, 10.0), (1.0, 20.0)] {
                            file.f64s(&[time]).block(|file| {
                                file.f64s(&[x, 0.0, 0.0]).f64s(&[0.0, 0.0, 0.0, 1.0]).f64s(&[1.0; 3]);
                            });
                        }
                    });
                    file.u32(1);
                });
                file.f64s(&[0.0; 3]).raw(&[0]).f64s(&[0.0, 1.0]).raw(&[0]);
            });
            file.raw(&[0, 0, 1]).u32(u32::MAX).raw(&[0]).children(1, |file| {
                file.object("osg::Node", 4, |file| {
                    file.node_members("");
                });
            });
            file.u32(0).block(|file| {
                file.f64s(&glam::DMat4::IDENTITY.to_cols_array());
            });
        });
        let (node, ignored) = read(&file.bytes);
        assert!(ignored.is_empty(), "{ignored:?}");
        assert!(
            matches!(node.kind, NodeKind::Transform(map) if map.translation.x == 10.0)
                && node.update_callback.is_some()
        );
    }
}

/// A light, a clip plane and a geode below them, in both text formats.
const LIT: [&str; 2] = [
    "osg::Group { UniqueID 1 StateSet TRUE { osg::StateSet { UniqueID 2 ModeList 2 { GL_LIGHT1 ON GL_CLIP_PLANE2 ON } } }
    Children 2 {
        osg::LightSource { UniqueID 3 Light TRUE { osg::Light { UniqueID 4 LightNum 1 Ambient 0 0 0 1 Diffuse 1 0 0 1
            Specular 0 0 1 1 Position 1 2 3 1 Direction 0 1 0 LinearAttenuation 0.5 SpotExponent 2 SpotCutoff 45 } } }
        osg::ClipNode { UniqueID 5 Children 1 { osg::Group { UniqueID 6 } }
            ClipPlaneList 1 { osg::ClipPlane { UniqueID 7 ClipPlane 1 0 0 -8 ClipPlaneNum 2 } } ReferenceFrame ABSOLUTE_RF } } }",
    "Group {\n StateSet {\n GL_LIGHT1 ON\n GL_CLIP_PLANE2 ON\n }\n num_children 2\n LightSource {\n referenceFrame RELATIVE\n
    Light {\n light_num 1\n ambient 0 0 0 1\n diffuse 1 0 0 1\n specular 0 0 1 1\n position 1 2 3 1\n direction 0 1 0\n
    linear_attenuation 0.5\n spot_exponent 2\n spot_cutoff 45\n }\n }\n ClipNode {\n referenceFrame ABSOLUTE\n
    ClipPlane {\n clipPlaneNum 2\n plane 1 0 0 -8\n }\n Group {\n }\n }\n }\n",
];

#[test]
fn lights_and_clip_planes_have_their_place() {
    let light = Light {
        number: 1,
        position: [1.0, 2.0, 3.0, 1.0],
        direction: [0.0, 1.0, 0.0],
        diffuse: [1.0, 0.0, 0.0],
        specular: [0.0, 0.0, 1.0],
        attenuation: [1.0, 0.5, 0.0],
        spot_cutoff: std::f32::consts::FRAC_PI_4,
        spot_exponent: 2.0,
        ..Light::default()
    };
    for (text, is_new) in [(osgt(VERSION, LIT[0]), true), (LIT[1].to_owned(), false)] {
        let (node, ignored) = read(text);
        assert!(ignored.is_empty(), "{is_new}: {ignored:?}");
        let modes = &node.state_set.as_ref().unwrap().modes;
        for mode in [Mode::Light(1), Mode::ClipPlane(2)] {
            assert!(modes.contains(&(mode, StateValue::ON)), "{is_new}: {modes:?}");
        }
        let NodeKind::LightSource(source) = &node.children[0].kind else { panic!("{is_new}: {node:?}") };
        assert_eq!((source.light, source.frame), (light, ReferenceFrame::Relative), "{is_new}");
        let NodeKind::ClipNode(clip) = &node.children[1].kind else { panic!("{is_new}: {node:?}") };
        assert_eq!(clip.planes, [(2, DVec4::new(1.0, 0.0, 0.0, -8.0))], "{is_new}");
        assert_eq!((clip.frame, node.children[1].children.len()), (ReferenceFrame::Absolute, 1), "{is_new}");
    }
    // OpenGL's fixed function has eight lights and six planes.
    let (node, ignored) = read(osgt(VERSION, &LIT[0].replace("LightNum 1", "LightNum 8").replace("Num 2", "Num 6")));
    assert!(node.children.iter().all(|child| matches!(child.kind, NodeKind::Group)), "{node:?}");
    assert_eq!(ignored.iter().count(), 2, "{ignored:?}");
}
