//! Billboards, AutoTransforms, and shapes of triangles and heights, laid out as OSG's own writers do.

use glam::DVec3;
use kit::osg_files::{Osgb, VERSION, geode, osgt, triangle};
use terrane::scene::{AutoScale, Billboard, BillboardMode};

use super::*;

/// The billboards of a graph in order.
fn billboards(node: &Node) -> Vec<&Billboard> {
    let mut all = Vec::new();
    if let NodeKind::Billboard(billboard) = &node.kind {
        all.push(&**billboard);
    }
    all.extend(node.children.iter().flat_map(billboards));
    all
}

fn corners(drawable: &Drawable) -> Vec<DVec3> {
    mesh(drawable).vertices.iter().map(|vertex| DVec3::from_array(vertex.position.map(f64::from))).collect()
}

fn billboard(members: &str) -> Node {
    let text = format!(
        "osg::Billboard {{ UniqueID 1 Drawables 2 {{ {} {} }} {members} PositionList 2 {{ 5 0 1 \n -5 0 1 }} }}",
        triangle(10, ""),
        triangle(20, "")
    );
    let (node, ignored) = read(osgt(VERSION, &text));
    assert!(ignored.is_empty(), "{ignored:?}");
    node
}

#[test]
fn billboards_turn_about_their_positions() {
    let node = billboard("Axis 0 0 1 Normal 0 -1 0");
    let [first, second] = billboards(&node)[..] else { panic!("{node:?}") };
    assert_eq!(first.mode, BillboardMode::AxialRot { axis: DVec3::Z });
    assert_eq!((first.drawables[0].0, second.drawables[0].0), (DVec3::new(5.0, 0.0, 1.0), DVec3::new(-5.0, 0.0, 1.0)));
    assert_eq!(corners(&first.drawables[0].1), [DVec3::ZERO, DVec3::X, DVec3::Y], "the engine's own directions");
    // The triangle looks along x: its front becomes -y, and the axis stays up.
    let node = billboard("Mode AXIAL_ROT Axis 0 0 1 Normal 1 0 0");
    let turned = corners(&billboards(&node)[0].drawables[0].1);
    assert!(turned[1].distance(DVec3::NEG_Y) < 1e-6 && turned[2].distance(DVec3::X) < 1e-6, "{turned:?}");
    let modes = [("POINT_ROT_EYE", BillboardMode::PointRotEye), ("POINT_ROT_WORLD", BillboardMode::PointRotWorld)];
    for (name, mode) in modes {
        let node = billboard(&format!("Mode {name}"));
        assert_eq!((billboards(&node).len(), billboards(&node)[0].mode), (2, mode), "{name}");
    }
}

fn auto(members: &str) -> (Node, Ignored) {
    let drawn = geode(10, "", &[triangle(11, "")]);
    let text = format!("osg::AutoTransform {{ UniqueID 1 Children 1 {{ {drawn} }} {members} }}");
    read(osgt(VERSION, &text))
}

#[test]
fn auto_transforms_turn_and_keep_their_size() {
    let members = "MinimumScale 0.5 MaximumScale 20 Position 3 4 5 Scale 9 9 9 PivotPoint 0 0 -1";
    let (node, ignored) = auto(&format!("{members} AutoRotateMode ROTATE_TO_SCREEN AutoScaleToScreen TRUE"));
    assert!(ignored.is_empty(), "{ignored:?}");
    let [facing] = billboards(&node)[..] else { panic!("{node:?}") };
    assert_eq!((facing.mode, facing.auto_scale), (BillboardMode::PointRotEye, Some(AutoScale { min: 0.5, max: 20.0 })));
    assert_eq!(facing.drawables[0].0, DVec3::new(3.0, 4.0, 5.0));
    // z points at the eye and y up on the screen; the pivot is the origin.
    let found = corners(&facing.drawables[0].1);
    let expected = [DVec3::NEG_Y, DVec3::new(1.0, -1.0, 0.0), DVec3::new(0.0, -1.0, 1.0)];
    assert!(found.iter().zip(expected).all(|(found, expected)| found.distance(expected) < 1e-6), "{found:?}");

    // Nothing turns: a transform.
    let (node, ignored) = auto("MaximumScale 1.79769e+308 Position 3 4 5 Scale 2 2 2 Rotation 0 0 0.707107 0.707107");
    let NodeKind::Transform(map) = node.kind else { panic!("a transform") };
    assert!(map.transform_point3(DVec3::X).distance(DVec3::new(3.0, 6.0, 5.0)) < 1e-5 && ignored.is_empty());
    let (node, ignored) = auto("MaximumScale 1.79769e+308 AutoRotateMode ROTATE_TO_CAMERA AutoScaleToScreen TRUE");
    assert_eq!(billboards(&node)[0].auto_scale, Some(AutoScale { min: 0.0, max: f64::INFINITY }));
    assert_eq!(ignored.iter().count(), 1, "{ignored:?}");
}

fn shape(text: &str) -> Node {
    let drawable = format!("osg::ShapeDrawable {{ UniqueID 2 Shape TRUE {{ {text} }} Color 1 1 1 1 }}");
    let (node, ignored) = read(osgt(VERSION, &geode(1, "", &[drawable])));
    assert!(ignored.is_empty(), "{ignored:?}");
    node
}

#[test]
fn triangle_meshes_are_drawn_without_invalid_triangles() {
    let node = shape(
        "osg::TriangleMesh { UniqueID 3 Vertices osg::Vec3Array { UniqueID 4 vector 4 { 0 0 0 2 0 0 0 2 0 0 0 2 } }
        Indices osg::UIntArray { UniqueID 5 vector 9 { 0 1 2 0 2 3 0 1 4 } } }",
    );
    let mesh = mesh(drawables(&node)[0]);
    assert_eq!((mesh.vertices.len(), &*mesh.indices), (4, &[0, 1, 2, 0, 2, 3][..]));
    assert_eq!((mesh.bounds.max, mesh.vertices[0].normal), (DVec3::splat(2.0), [0; 4]));
}

/// Two rows of three heights that rise by 10 m a row.
const FIELD: &str = "osg::HeightField { UniqueID 3 Area 3 2 Origin 10 20 30 XInterval 2 YInterval 3 SkirtHeight 1.5
    Heights ArrayID 1 FloatArray 6 { 0 0 0 10 10 10 } }";

#[test]
fn height_fields_have_cells_and_skirts() {
    let node = shape(FIELD);
    let mesh = mesh(drawables(&node)[0]);
    assert_eq!((mesh.vertices.len(), mesh.indices.len() / 3), (6 + 6, 4 + 12));
    assert_eq!((mesh.bounds.min, mesh.bounds.max), (DVec3::new(10.0, 20.0, 28.5), DVec3::new(14.0, 23.0, 40.0)));
    let at = |i: u32| DVec3::from_array(mesh.vertices[i as usize].position.map(f64::from));
    let faces = |triangle: &[u32]| (at(triangle[1]) - at(triangle[0])).cross(at(triangle[2]) - at(triangle[0]));
    let middle = DVec3::new(12.0, 21.5, 0.0);
    for (number, triangle) in mesh.indices.chunks_exact(3).enumerate() {
        let outwards = (at(triangle[0]) + at(triangle[1]) + at(triangle[2])) / 3.0 - middle;
        let is_right =
            if number < 4 { faces(triangle).z > 0.0 } else { faces(triangle).dot(outwards.with_z(0.0)) > 0.0 };
        assert!(is_right, "triangle {number}");
    }
    let [_, y, z, _] = mesh.vertices[0].normal.map(f64::from);
    assert!((y / z + 10.0 / 3.0).abs() < 0.2, "{y} {z}");
    // Fewer heights than the grid has.
    let error = read_with(
        osgt(
            VERSION,
            &geode(
                1,
                "",
                &[format!(
                    "osg::ShapeDrawable {{ UniqueID 2 Shape TRUE {{ {} }} }}",
                    FIELD.replace("Area 3 2", "Area 3 3")
                )],
            ),
        )
        .as_bytes(),
        Vec::new(),
        &options(),
    );
    assert!(error.unwrap_err().to_string().contains("HeightField of 3 x 3 with 6 heights"));
}

/// The same in the binary encoding, where every member is present.
#[test]
fn binary_height_fields_and_billboards_are_read() {
    let mut file = Osgb::new(VERSION, false);
    file.object("osg::Billboard", 1, |file| {
        file.node_members("facing").raw(&[1]).u32(1).block(|file| {
            file.object("osg::ShapeDrawable", 2, |file| {
                // Drawable: no bound or callback; a shape.
                file.node_members("").raw(&[0, 0, 1]).object("osg::HeightField", 3, |file| {
                    file.object_members("").raw(&[1]).u32(2).u32(2).f32s(&[0.0, 0.0, 0.0, 1.0, 1.0, 0.0]).u32(0);
                    file.f64s(&[0.0, 0.0, 0.0, 1.0]);
                    file.raw(&[1]).u32(1).u32(6).u32(4).block(|file| {
                        file.f32s(&[0.0, 0.0, 0.0, 7.0]);
                    });
                });
                // Display lists, mask, culling; colour and no hints.
                file.raw(&[1, 1, 0]).u32(u32::MAX).raw(&[1]).f32s(&[1.0; 4]).raw(&[0]);
            });
        });
        file.u32(0).f32s(&[0.0, 0.0, 1.0, 0.0, -1.0, 0.0]).raw(&[1]).u32(1).block(|file| {
            file.f64s(&[1.0, 2.0, 3.0]);
        });
    });
    let (node, ignored) = read(&file.bytes);
    assert!(ignored.is_empty(), "{ignored:?}");
    let [billboard] = billboards(&node)[..] else { panic!("{node:?}") };
    assert_eq!((billboard.mode, billboard.drawables[0].0), (BillboardMode::PointRotEye, DVec3::new(1.0, 2.0, 3.0)));
    assert_eq!(mesh(&billboard.drawables[0].1).bounds.max, DVec3::new(1.0, 1.0, 7.0));
}
