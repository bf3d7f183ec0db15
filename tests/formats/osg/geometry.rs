//! Arrays, bindings, primitive sets and shapes.

use std::sync::Arc;

use terrane::scene::{Geometry, NodeKind, Topology};

use super::*;
use kit::osg_files::{Osgb, VERSION, geode, group, osgt, triangle};

/// A geometry in text with four vertices in a square, with primitive sets and members.
fn square(sets: &[&str], members: &str) -> String {
    let list: Vec<String> =
        (10..).zip(sets).map(|(id, set)| set.replacen("{", &format!("{{ UniqueID {id}"), 1)).collect();
    let geometry = format!(
        "osg::Geometry {{ UniqueID 2 PrimitiveSetList {} {{ {} }}
        VertexArray TRUE {{ osg::Vec3Array {{ UniqueID 3 Binding BIND_PER_VERTEX
            vector 4 {{ 0 0 0 \n 1 0 0 \n 1 1 0 \n 0 1 0 }} }} }} {members} }}",
        list.len(),
        list.join("\n")
    );
    osgt(VERSION, &geode(1, "", &[geometry]))
}

#[test]
fn every_primitive_set_is_read() {
    for (set, topology, indices) in [
        ("osg::DrawArrays { Mode QUADS Count 4 }", Topology::Triangles, &[0, 1, 2, 0, 2, 3][..]),
        ("osg::DrawArrays { Mode TRIANGLE_FAN First 1 Count 3 }", Topology::Triangles, &[1, 2, 3]),
        ("osg::DrawArrayLengths { Mode LINE_STRIP vector 2 { 2 2 } }", Topology::Lines, &[0, 1, 2, 3]),
        (
            "osg::DrawElementsUByte { Mode TRIANGLE_STRIP vector 4 { 0 1 3 2 } }",
            Topology::Triangles,
            &[0, 1, 3, 3, 1, 2],
        ),
        ("osg::DrawElementsUShort { Mode LINE_LOOP vector 3 { 0 1 2 } }", Topology::Lines, &[0, 1, 1, 2, 2, 0]),
        ("osg::DrawElementsUInt { Mode POINTS vector 2 { 3 1 } }", Topology::Points, &[3, 1]),
        ("osg::DrawElementsUInt { Mode POLYGON vector 4 { 0 1 2 3 } }", Topology::Triangles, &[0, 1, 2, 0, 2, 3]),
    ] {
        // The mode POINTS is the default, which text leaves out.
        for set in [set.to_owned(), set.replace("Mode POINTS ", "")] {
            let (node, ignored) = read(square(&[&set], ""));
            let mesh = mesh(drawables(&node)[0]);
            assert_eq!((mesh.topology, &*mesh.indices, mesh.vertices.len()), (topology, indices, 4), "{set}");
            assert!(ignored.is_empty(), "{ignored:?}");
        }
    }
}

#[test]
fn sets_of_several_topologies_become_several_meshes() {
    let sets = [
        "osg::DrawElementsUByte { Mode TRIANGLES vector 3 { 1 2 3 } }",
        "osg::DrawArrays { Mode LINES Count 2 }",
        "osg::DrawElementsUByte { Mode TRIANGLES vector 3 { 3 2 1 } }",
    ];
    let (node, _) = read(square(&sets, ""));
    let all = drawables(&node);
    let lists: Vec<(Topology, &[u32], usize)> =
        all.iter().map(|d| (mesh(d).topology, &*mesh(d).indices, mesh(d).vertices.len())).collect();
    let expected = [(Topology::Triangles, &[0, 1, 2, 2, 1, 0][..], 3), (Topology::Lines, &[0, 1][..], 2)];
    assert_eq!(lists, expected);
    assert_eq!(mesh(all[0]).vertices[0].position, [1.0, 0.0, 0.0]);
    assert!(all[1].material.unlit && !all[0].material.unlit, "lines without normals are not lit");
}

#[test]
fn arrays_are_bound_overall_per_set_and_per_vertex() {
    let two =
        ["osg::DrawArrays { Mode TRIANGLES Count 3 }", "osg::DrawElementsUByte { Mode TRIANGLES vector 3 { 0 2 3 } }"];
    let members = "NormalArray TRUE { osg::Vec3Array { UniqueID 4 Binding BIND_OVERALL vector 1 { 0 0 -3 } } }
        ColorArray TRUE { osg::Vec4Array { UniqueID 5 Binding BIND_PER_PRIMITIVE_SET vector 2 { 1 0 0 1 \n 0 1 0 0.5 } } }
        TexCoordArrayList 1 { osg::Vec2Array { UniqueID 6 vector 4 { 0 0 \n 1 0 \n 1 1 \n 0 0.25 } } }";
    let (node, _) = read(square(&two, members));
    let mesh = mesh(drawables(&node)[0]);
    assert_eq!((mesh.vertices.len(), mesh.indices.len()), (6, 6), "sets have vertices of their own");
    assert!(mesh.vertices.iter().all(|vertex| vertex.normal == [0, 0, -127, 0]));
    let colors: Vec<[u8; 4]> = mesh.vertices.iter().map(|vertex| vertex.color).collect();
    assert_eq!(colors, [[[255, 0, 0, 255]; 3], [[0, 255, 0, 128]; 3]].concat());
    // t goes up, v down.
    assert_eq!(mesh.vertices[5].uv, [0.0, 0.75]);
    // Bytes are normalized colours.
    let bytes = "ColorArray TRUE { osg::Vec4ubArray { UniqueID 5 Binding BIND_PER_VERTEX
        vector 4 { 255 255 255 255 \n 0 0 0 255 \n 255 0 0 51 \n 1 2 3 4 } } }";
    let (node, _) = read(square(&two, bytes));
    let mesh = self::mesh(drawables(&node)[0]);
    assert_eq!((mesh.vertices.len(), mesh.vertices[2].color), (4, [255, 0, 0, 51]));
}

#[test]
fn vertices_in_doubles_are_relative_to_their_middle() {
    let far = |id: u32| {
        triangle(id, "")
            .replace("Vec3Array", "Vec3dArray")
            .replace("0 0 0 \n 1 0 0 \n 0 1 0", "4000000.25 1 2 \n 4000001.25 1 2 \n 4000000.25 3 2")
    };
    let (node, _) = read(osgt(VERSION, &geode(1, "", &[far(10)])));
    let NodeKind::Transform(map) = &node.children[0].kind else { panic!("a transform: {node:?}") };
    let mesh = mesh(drawables(&node)[0]);
    let at = map.transform_point3(glam::DVec3::from_array(mesh.vertices[1].position.map(f64::from)));
    assert_eq!(at, glam::DVec3::new(4_000_001.25, 1.0, 2.0));
}

#[test]
fn shared_drawables_and_arrays_are_the_same() {
    let drawable = triangle(10, "");
    let reference = "osg::Geometry { UniqueID 10 }".to_owned();
    let (node, _) = read(osgt(VERSION, &group(1, &[geode(2, "", &[drawable]), geode(3, "", &[reference])])));
    let [a, b] = drawables(&node)[..] else { panic!("two drawables") };
    let (Geometry::Mesh(a), Geometry::Mesh(b)) = (&a.geometry, &b.geometry) else { panic!("meshes") };
    assert!(Arc::ptr_eq(a, b));
}

#[test]
fn further_texture_coordinates_are_kept_if_they_are_asked_for() {
    let sets = ["osg::DrawArrays { Mode QUADS Count 4 }"];
    let text = square(&sets, "TexCoordArrayList 2 { NULL osg::Vec2Array { UniqueID 6 vector 4 { 0 1 2 3 4 5 6 7 } } }");
    let wanted = ReadOptions { vertex_attributes: ["TEXCOORD_1".into()].into(), ..options() };
    let (node, _) = read_with(text.as_bytes(), Vec::new(), &wanted).unwrap();
    let (_, bytes) = mesh(drawables(&node)[0]).attributes.get("TEXCOORD_1").unwrap();
    let floats: Vec<f32> = bytemuck::pod_collect_to_vec(bytes);
    assert_eq!(floats, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let (node, _) = read(text);
    assert!(mesh(drawables(&node)[0]).attributes.is_empty());
}

/// Before version 112 arrays have a number, may be indexed, and may be bound to single primitives.
#[test]
fn arrays_of_old_versions_are_read() {
    let data = |name: &str, array: &str, indices: &str, binding: &str| {
        format!("{name} {{ Array TRUE {array} Indices {indices} Binding {binding} Normalize 0 }}")
    };
    let vertices = data("VertexData", "ArrayID 1 Vec3fArray 4 { 0 0 0 1 0 0 1 1 0 0 1 0 }", "FALSE", "BIND_PER_VERTEX");
    let normals = data("NormalData", "ArrayID 2 Vec3fArray 2 { 0 0 1 0 0 -1 }", "FALSE", "BIND_PER_PRIMITIVE");
    let colors = data(
        "ColorData",
        "ArrayID 3 Vec4ubArray 2 { 255 0 0 255 0 0 255 255 }",
        "TRUE ArrayID 4 UIntArray 4 { 0 1 1 0 }",
        "BIND_PER_VERTEX",
    );
    let uvs = format!(
        "TexCoordData 1 {{ {} }}",
        data("Data", "ArrayID 5 Vec2fArray 4 { 0 0 1 0 1 1 0 1 }", "FALSE", "BIND_PER_VERTEX")
    );
    let geometry = format!(
        "osg::Geometry {{ UniqueID 2 PrimitiveSetList 1 {{ DrawElementsUShort GL_TRIANGLES 6 {{ 0 1 2 0 2 3 }} }}
        {vertices} {normals} {colors} {uvs} FastPathHint TRUE }}"
    );
    let (node, ignored) = read(osgt(80, &geode(1, "", &[geometry])));
    assert!(ignored.is_empty(), "{ignored:?}");
    let mesh = mesh(drawables(&node)[0]);
    let normals: Vec<i8> = mesh.vertices.iter().map(|vertex| vertex.normal[2]).collect();
    assert_eq!(normals, [127, 127, 127, -127, -127, -127]);
    let reds: Vec<u8> = mesh.vertices.iter().map(|vertex| vertex.color[0]).collect();
    assert_eq!(reds, [255, 0, 0, 255, 0, 255]);
    assert_eq!(mesh.vertices[5].uv, [0.0, 0.0]);
}

#[test]
fn binary_files_of_all_ages_hold_the_same() {
    let geode_of = |mut file: Osgb| {
        file.triangle_geode(1);
        file.bytes
    };
    let plain = geode_of(Osgb::new(VERSION, true));
    let mut zlib = Osgb::with_compressor(VERSION, true, "zlib").bytes;
    let start = Osgb::new(VERSION, true).bytes.len();
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, &plain[start..]).unwrap();
    zlib.extend(encoder.finish().unwrap());
    for (name, bytes) in [
        ("new", plain),
        ("zlib", zlib),
        ("without sizes", geode_of(Osgb::new(VERSION, false))),
        ("65", geode_of(Osgb::new(65, false))),
        ("80", geode_of(Osgb::new(80, false))),
        ("100", geode_of(Osgb::new(100, true))),
    ] {
        let (node, ignored) = read(bytes);
        let mesh = mesh(drawables(&node)[0]);
        assert_eq!((node.name.as_str(), &*mesh.indices), ("geode", &[0, 1, 2][..]), "{name}");
        assert_eq!(mesh.vertices[1].position, [1.0, 0.0, 0.0], "{name}");
        assert!(ignored.is_empty(), "{name}: {ignored:?}");
    }
}

#[test]
fn files_of_machines_with_the_other_byte_order_are_read() {
    let mut file = Osgb::big_endian(VERSION);
    file.object("osg::MatrixTransform", 1, |file| {
        file.node_members("turned").raw(&[0]).u32(0).block(|file| {
            file.f64s(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 7.0, 8.0, 9.0, 1.0]);
        });
    });
    let (node, _) = read(file.bytes);
    let NodeKind::Transform(map) = node.kind else { panic!("a transform") };
    assert_eq!((node.name.as_str(), map.translation), ("turned", glam::DVec3::new(7.0, 8.0, 9.0)));
}

#[test]
fn shapes_are_tessellated() {
    let shape = |shape: &str| format!("osg::ShapeDrawable {{ UniqueID 2 Shape TRUE {{ {shape} }} Color 1 0 0 1 }}");
    for (text, triangles, low, high) in [
        ("osg::Box { UniqueID 3 Center 1 2 3 HalfLengths 1 1 2 }", 12, [0.0, 1.0, 1.0], [2.0, 3.0, 5.0]),
        ("osg::Sphere { UniqueID 3 Radius 5 }", 1600, [-5.0; 3], [5.0; 3]),
        ("osg::Cylinder { UniqueID 3 Radius 1 Height 4 }", 240, [-1.0, -1.0, -2.0], [1.0, 1.0, 2.0]),
        ("osg::Cone { UniqueID 3 Radius 1 Height 4 }", 160, [-1.0, -1.0, -1.0], [1.0, 1.0, 3.0]),
    ] {
        let (node, _) = read(osgt(VERSION, &geode(1, "", &[shape(text)])));
        let mesh = mesh(drawables(&node)[0]);
        assert_eq!(mesh.indices.len() / 3, triangles, "{text}");
        let bounds = [mesh.bounds.min, mesh.bounds.max];
        let expected = [low, high].map(glam::DVec3::from_array);
        assert!(bounds[0].distance(expected[0]) < 1e-3 && bounds[1].distance(expected[1]) < 1e-3, "{text}: {bounds:?}");
        assert_eq!(mesh.vertices[0].color, [255, 0, 0, 255]);
    }
}
