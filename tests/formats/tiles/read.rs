//! Valid 3D Tiles and glTF: volumes, refinement, transforms, external tilesets. No GPU.

use std::io::Write as _;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use terrane::fetch::{IoError, Limits};
use terrane::formats::writers::{GlbMesh, write_glb, write_height_exr};
use terrane::formats::{Content, ReadOptions, companions, decode, decode_node, inspect};
use terrane::math::BoundingVolume;
use terrane::scene::{AlphaMode, Drawable, Geometry, Node, NodeKind, PagedLod, RangeMode, Refine, Sampling, Topology};
use terrane::state::{FilterMode, WrapMode};

const SET: &str = "/data/set/tileset.json";

fn content(bytes: impl Into<Vec<u8>>) -> Content {
    Content { uri: SET.into(), bytes: bytes.into(), reader_data: None, companions: Vec::new() }
}

fn read(bytes: impl Into<Vec<u8>>) -> Node {
    decode_node(content(bytes), &ReadOptions::for_root(SET, Limits::default())).unwrap()
}

fn tileset(version: &str, root: &str) -> Node {
    read(format!(r#"{{"asset":{{"version":"{version}"}},"geometricError":100,"root":{root}}}"#))
}

fn lod(node: &Node) -> &PagedLod {
    let (NodeKind::PagedLod(lod) | NodeKind::MultiContentTile(lod)) = &node.kind else {
        panic!("a tile, not {:?}", node.kind)
    };
    lod
}

fn error_m(lod: &PagedLod) -> f64 {
    let RangeMode::ScreenSpaceError { geometric_error_m } = lod.range_mode else { panic!("by error") };
    geometric_error_m
}

#[test]
fn volumes_have_their_position_and_size() {
    let tile = |volume: &str| tileset("1.1", &format!(r#"{{"boundingVolume":{{{volume}}},"geometricError":7}}"#));
    let node = tile(r#""box":[1,2,3, 4,0,0, 0,5,0, 0,0,6]"#);
    let BoundingVolume::Box(b) = lod(&node).bounds else { panic!("a box") };
    assert_eq!((b.center, b.half_axes.x_axis, b.half_axes.z_axis.z), (DVec3::new(1.0, 2.0, 3.0), DVec3::X * 4.0, 6.0));
    let node = tile(r#""sphere":[1,2,3,9]"#);
    let BoundingVolume::Sphere(s) = lod(&node).bounds else { panic!("a sphere") };
    assert_eq!((s.center, s.radius_m), (DVec3::new(1.0, 2.0, 3.0), 9.0));
    let node = tile(r#""region":[0.1,0.2,0.3,0.4,-5,60]"#);
    let BoundingVolume::Region(r) = lod(&node).bounds else { panic!("a region") };
    assert_eq!([r.west, r.south, r.east, r.north, r.min_height_m, r.max_height_m], [0.1, 0.2, 0.3, 0.4, -5.0, 60.0]);
    assert_eq!((error_m(lod(&node)), lod(&node).refine, &lod(&node).content), (7.0, Refine::Replace, &None));
}

#[test]
fn refinement_is_inherited_and_contents_are_resolved() {
    let child = |extra: &str| format!(r#"{{"boundingVolume":{{"sphere":[0,0,0,1]}},"geometricError":1{extra}}}"#);
    let root = format!(
        r#"{{"refine":"ADD","boundingVolume":{{"sphere":[0,0,0,5]}},"geometricError":9,"content":{{"url":"a/b.b3dm?v=1"}},"children":[{},{}]}}"#,
        child(r#","content":{"uri":"../set/c.glb"}"#),
        child(r#","refine":"REPLACE""#),
    );
    // Version 1.0 uses `url`, and some of its files have the keyword in lower case.
    for (version, root) in [("1.0", root.clone()), ("1.1", root.replace("\"ADD\"", "\"add\""))] {
        let node = tileset(version, &root);
        assert_eq!(lod(&node).content.as_deref(), Some("/data/set/a/b.b3dm"), "the query is not part of a file's name");
        assert_eq!((lod(&node).refine, node.children.len()), (Refine::Add, 2));
        let [first, second] = [0, 1].map(|i| lod(&node.children[i]));
        assert_eq!((first.refine, first.content.as_deref()), (Refine::Add, Some("/data/set/c.glb")));
        assert_eq!((second.refine, &second.content), (Refine::Replace, &None));
    }
}

#[test]
fn transforms_are_multiplied_and_scale_errors() {
    // The first transform doubles the size and moves 10 east; the second turns a quarter around z.
    let outer = "[2,0,0,0, 0,2,0,0, 0,0,2,0, 10,0,0,1]";
    let inner = "[0,1,0,0, -1,0,0,0, 0,0,1,0, 0,0,0,1]";
    let node = tileset(
        "1.0",
        &format!(
            r#"{{"transform":{outer},"boundingVolume":{{"sphere":[1,0,0,3]}},"geometricError":5,"children":[{{"transform":{inner},"boundingVolume":{{"sphere":[1,0,0,1]}},"geometricError":2,"content":{{"uri":"x.glb"}}}}]}}"#
        ),
    );
    let sphere = |lod: &PagedLod| lod.bounds.bounding_sphere();
    assert_eq!((sphere(lod(&node)).center, sphere(lod(&node)).radius_m), (DVec3::new(12.0, 0.0, 0.0), 6.0));
    assert_eq!(error_m(lod(&node)), 10.0);
    let child = lod(&node.children[0]);
    assert!(sphere(child).center.distance(DVec3::new(10.0, 2.0, 0.0)) < 1e-12, "{:?}", sphere(child));
    assert_eq!(error_m(child), 4.0);
    let moved = child.content_transform.transform_point3(DVec3::new(0.0, 1.0, 1.0));
    assert!(moved.distance(DVec3::new(8.0, 0.0, 2.0)) < 1e-12, "{moved}");
    // Regions are on the globe with any transform.
    let node = tileset(
        "1.1",
        &format!(r#"{{"transform":{outer},"boundingVolume":{{"region":[0,0,0.1,0.1,0,1]}},"geometricError":5}}"#),
    );
    assert!(matches!(lod(&node).bounds, BoundingVolume::Region(r) if r.east == 0.1));
}

#[test]
fn external_tileset_is_a_proxy() {
    let node = tileset(
        "1.1",
        r#"{"transform":[1,0,0,0,0,1,0,0,0,0,1,0,7,0,0,1],"boundingVolume":{"sphere":[0,0,0,5]},"geometricError":9,"content":{"uri":"sub/tileset.json"}}"#,
    );
    assert_eq!((&lod(&node).content, node.children.len()), (&None, 1));
    let NodeKind::ProxyNode(proxy) = &node.children[0].kind else { panic!("a proxy") };
    assert_eq!((&*proxy.uri, proxy.bounds.radius_m), ("/data/set/sub/tileset.json", 5.0));
    assert_eq!(proxy.content_transform, DAffine3::from_translation(DVec3::X * 7.0));
}

#[test]
fn several_contents_are_drawn_together() {
    let node = tileset(
        "1.1",
        r#"{"boundingVolume":{"sphere":[0,0,0,5]},"geometricError":9,"contents":[{"uri":"a.glb"},{"uri":"b.glb"}]}"#,
    );
    assert_eq!(lod(&node).refine, Refine::Add);
    let contents: Vec<_> = node.children.iter().map(|c| lod(c).content.as_deref().unwrap()).collect();
    assert_eq!(contents, ["/data/set/a.glb", "/data/set/b.glb"]);
    // ADD refinement keeps the parent. REPLACE needs all contents of a tile together.
    let with_children = |refine: &str| {
        format!(
            r#"{{"boundingVolume":{{"sphere":[0,0,0,5]}},"geometricError":9,"refine":"{refine}",
            "contents":[{{"uri":"a.glb"}},{{"uri":"b.glb"}}],
            "children":[{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":0,"content":{{"uri":"c.glb"}}}}]}}"#
        )
    };
    let node = tileset("1.1", &with_children("ADD"));
    let [first, second] = &node.children[..] else { panic!("two contents") };
    assert_eq!((lod(first).content.as_deref(), error_m(lod(first))), (Some("/data/set/a.glb"), 9.0));
    assert_eq!((lod(second).content.as_deref(), second.children.len()), (Some("/data/set/b.glb"), 0));
    assert_eq!(lod(&first.children[0]).content.as_deref(), Some("/data/set/c.glb"));
    // Children replace both contents in the same frame: they are one.
    let node = tileset("1.1", &with_children("REPLACE"));
    let tile = lod(&node);
    assert_eq!((tile.content.as_deref(), node.children.len()), (Some("/data/set/a.glb"), 1));
    let companions = companions(tile.content.as_ref().unwrap(), tile.reader_data.as_ref());
    assert_eq!(companions, ["/data/set/b.glb".into()]);
    let both = Content {
        uri: "/data/set/a.glb".into(),
        bytes: triangle(),
        reader_data: tile.reader_data.clone(),
        companions: vec![("/data/set/b.glb".into(), Ok(triangle()))],
    };
    let options = ReadOptions::for_root(SET, Limits::default());
    assert_eq!(decode(both.clone(), &options).unwrap().drawable_count(), 2);
    let missing = IoError::NotFound { uri: "/data/set/b.glb".to_owned() };
    let one = Content { companions: vec![("/data/set/b.glb".into(), Err(missing.clone()))], ..both };
    assert_eq!(decode(one, &options).unwrap_err(), missing);
}

/// Regression: terrain with trees was white, as its images were not loaded.
#[test]
fn height_tile_beside_another_content_has_its_image() {
    let heights = r#"{"terrane":{"content":"height","side":3,"border":1,"level_errors_m":[9,1]}}"#;
    let region = r#""boundingVolume":{"region":[0.1,0.2,0.101,0.201,0,9]},"geometricError":1"#;
    let node = read(format!(
        r#"{{"asset":{{"version":"1.1","extras":{heights}}},"geometricError":9,"root":{{{region},"refine":"REPLACE",
        "contents":[{{"uri":"0.exr"}},{{"uri":"0.glb"}}],"extras":{{"terrane":{{"imagery":"0.png"}}}},
        "children":[{{{region},"content":{{"uri":"1.exr"}}}}]}}}}"#
    ));
    let tile = lod(&node);
    let companions = companions(tile.content.as_ref().unwrap(), tile.reader_data.as_ref());
    assert_eq!(companions, ["/data/set/0.glb".into(), "/data/set/0.png".into()]);
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(4, 4).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let both = Content {
        uri: "/data/set/0.exr".into(),
        bytes: write_height_exr("0.exr", 5, vec![0.0; 25]).unwrap(),
        reader_data: tile.reader_data.clone(),
        companions: vec![(companions[0].clone(), Ok(triangle())), (companions[1].clone(), Ok(png.into_inner()))],
    };
    let node = decode_node(both, &ReadOptions::for_root(SET, Limits::default())).unwrap();
    let mut found = Vec::new();
    drawables(&node, DAffine3::IDENTITY, &mut found);
    let heights = found.iter().find_map(|(_, drawable)| match &drawable.geometry {
        Geometry::Height(tile) => Some(tile),
        _ => None,
    });
    assert_eq!((found.len(), heights.unwrap().texture.is_some()), (2, true));
}

/// Regression: they were parsed but not read, so that errors of the reader were not reported and deep tilesets were
/// ignored.
#[test]
fn info_reads_external_tilesets_like_the_reader() {
    let folder = tempfile::tempdir().unwrap();
    let set = |below: &str| {
        format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"boundingVolume":{{"sphere":[0,0,0,5]}},
            "geometricError":9{below}}}}}"#
        )
    };
    let limits = Limits { max_depth: 3, ..Limits::default() };
    // Each of two files has three levels, so that no file is too deep.
    let tile = r#""boundingVolume":{"sphere":[0,0,0,5]},"geometricError":1"#;
    let nested = |last: &str| format!(r#","children":[{{{tile},"children":[{{{tile}{last}}}]}}]"#);
    let write = |name: &str, json: String| std::fs::write(folder.path().join(name), json).unwrap();
    write("tileset.json", set(&nested(r#","content":{"uri":"below.json"}"#)));
    write("below.json", set(&nested("")));
    let info = inspect(folder.path().to_str().unwrap(), &limits).unwrap();
    assert_eq!((info.tiles, info.levels.len(), info.errors.len()), (6, 6, 0), "{info}");
    write("below.json", set(r#","children":[{"boundingVolume":{},"geometricError":1}]"#));
    let info = inspect(folder.path().to_str().unwrap(), &limits).unwrap();
    let [error] = &info.errors[..] else { panic!("{info}") };
    assert!(error.uri.ends_with("below.json") && error.reason.contains("boundingVolume"), "{info}");
}

#[test]
fn gzip_and_byte_order_marks_are_removed() {
    let plain = br#"{"asset":{"version":"1.1"},"geometricError":1,"root":{"boundingVolume":{"sphere":[0,0,0,5]},"geometricError":3}}"#;
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gzip.write_all(plain).unwrap();
    for bytes in [plain.to_vec(), gzip.finish().unwrap(), [b"\xef\xbb\xbf".as_slice(), plain].concat()] {
        assert_eq!(error_m(lod(&read(bytes))), 3.0);
    }
}

/// Returns the drawables of a tree with the transforms above them.
fn drawables(node: &Node, above: DAffine3, out: &mut Vec<(DAffine3, Drawable)>) {
    let here = if let NodeKind::Transform(m) = node.kind { above * m } else { above };
    if let NodeKind::Geode(list) = &node.kind {
        out.extend(list.iter().map(|d| (here, d.clone())));
    }
    for child in &node.children {
        drawables(child, here, out);
    }
}

fn only_drawable(node: &Node) -> (DAffine3, Drawable) {
    let mut all = Vec::new();
    drawables(node, DAffine3::IDENTITY, &mut all);
    assert_eq!(all.len(), 1);
    all.remove(0)
}

fn triangle() -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 3.0]],
        indices: vec![0, 1, 2],
        base_color: [0.5, 1.0, 1.0, 1.0],
        ..GlbMesh::default()
    })
}

/// The 16-bit index 65,535 restarts a strip.
#[test]
fn index_65535_is_written_in_32_bits() {
    let wide = |vertices: usize| {
        let last = (vertices - 1) as u16;
        let indices = vec![0, 1, last];
        write_glb(&GlbMesh { positions: vec![[0.5; 3]; vertices], indices, ..GlbMesh::default() })
    };
    for (vertices, component) in [(65_535, "5123"), (65_536, "5125")] {
        let glb = wide(vertices);
        let json = String::from_utf8_lossy(&glb[20..2000]).into_owned();
        assert!(json.contains(&format!(r#""componentType":{component},"count":3"#)), "{json:.800}");
        let Geometry::Mesh(mesh) = only_drawable(&read(glb)).1.geometry else { panic!("a mesh") };
        assert_eq!(mesh.indices[2] as usize, vertices - 1);
    }
}

/// Returns the world positions of a drawable's vertices.
fn positions((world, drawable): &(DAffine3, Drawable)) -> Vec<DVec3> {
    let Geometry::Mesh(mesh) = &drawable.geometry else { panic!("a mesh") };
    mesh.vertices.iter().map(|v| world.transform_point3(glam::Vec3::from(v.position).as_dvec3())).collect()
}

#[test]
fn gltf_is_rotated_to_z_up() {
    let drawable = only_drawable(&read(triangle()));
    assert_eq!(positions(&drawable)[2], DVec3::new(0.0, -3.0, 2.0), "y is up in glTF");
    assert_eq!(drawable.1.material.base_color, [0.5, 1.0, 1.0, 1.0]);
    let page = decode(content(triangle()), &ReadOptions::for_root(SET, Limits::default())).unwrap();
    assert_eq!(page.drawable_count(), 1);
}

/// Returns the triangle below nested nodes, from the root down; each is the only child of the previous one.
fn under(nodes: &[&str]) -> String {
    use base64::Engine as _;
    let bytes: Vec<u8> =
        [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    let below =
        |i: usize| if i + 1 < nodes.len() { format!(r#""children":[{}]"#, i + 1) } else { r#""mesh":0"#.into() };
    let of = |(i, node): (usize, &&str)| format!("{{{node}{}}}", below(i));
    let nodes: Vec<String> = nodes.iter().enumerate().map(of).collect();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{}],
        "extensionsUsed":["KHR_draco_mesh_compression"],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},
            "extensions":{{"KHR_draco_mesh_compression":{{"bufferView":0,"attributes":{{"POSITION":0}}}}}}}}]}}],
        "buffers":[{{"byteLength":36,"uri":"data:;base64,{data}"}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}]}}"#,
        nodes.join(",")
    )
}

#[test]
fn transforms_of_nodes_keep_their_precision() {
    let turn = r#""rotation":[0.7071067811865476,0,0,0.7071067811865476],"#;
    let back = r#""rotation":[-0.7071068,0,0,0.7071068],"#;
    let there = r#""translation":[1215013.8,4081603.6,-4736302.2],"#;
    let matrix = r#""matrix":[1,0,0,0,0,1,0,0,0,0,1,0,1215013.8,4081603.6,-4736302.2,1],"#;
    // The rotation to z up swaps y and z: x, -z, y.
    for nodes in [&[there][..], &[matrix], &[turn, back, there]] {
        let drawable = only_drawable(&read(under(nodes)));
        let [origin, along_x, ..] = positions(&drawable)[..] else { panic!("a triangle") };
        assert!(origin.distance(DVec3::new(1215013.8, 4736302.2, 4081603.6)) < 1e-7, "{nodes:?} {origin}");
        assert!((along_x - origin).distance(DVec3::X) < 1e-7);
    }
}

#[test]
fn b3dm_is_moved_to_its_center() {
    let table = br#"{"BATCH_LENGTH":0,"RTC_CENTER":[100.0,200.0,300.0]}   "#;
    let glb = triangle();
    let mut b3dm = b"b3dm".to_vec();
    let total = 28 + table.len() + glb.len();
    for word in [1, total, table.len(), 0, 0, 0] {
        b3dm.extend((word as u32).to_le_bytes());
    }
    b3dm.extend(table);
    b3dm.extend(&glb);
    let drawable = only_drawable(&read(b3dm));
    assert_eq!(positions(&drawable)[1], DVec3::new(101.0, 200.0, 300.0));
}

#[test]
fn gltf_samplers_wrap_and_filter() {
    use base64::Engine as _;
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(2, 2).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let uri = |bytes: &[u8]| format!("data:;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes));
    let (buffer, image) = (uri(&[0; 36]), uri(png.get_ref()));
    let [repeat, clamped, mirror] = [WrapMode::Repeat, WrapMode::ClampToEdge, WrapMode::Mirror];
    let [nearest, linear] = [FilterMode::Nearest, FilterMode::Linear];
    let repeated = Sampling { wrap: [repeat, repeat], ..Sampling::default() };
    let minified = |min, mip| Sampling { min, mip, ..repeated };
    for (sampler, expected) in [
        ("{}", repeated),
        (r#"{"wrapS":33071,"wrapT":10497}"#, Sampling { wrap: [clamped, repeat], ..repeated }),
        (r#"{"wrapS":33648,"wrapT":33071}"#, Sampling { wrap: [mirror, clamped], ..repeated }),
        (r#"{"magFilter":9728}"#, Sampling { mag: nearest, ..repeated }),
        (r#"{"magFilter":9729,"minFilter":9728}"#, minified(nearest, None)),
        (r#"{"minFilter":9729}"#, minified(linear, None)),
        (r#"{"minFilter":9984}"#, minified(nearest, Some(nearest))),
        (r#"{"minFilter":9985}"#, minified(linear, Some(nearest))),
        (r#"{"minFilter":9986}"#, minified(nearest, Some(linear))),
        (r#"{"minFilter":9987}"#, minified(linear, Some(linear))),
    ] {
        let gltf = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
            "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],
            "textures":[{{"source":0,"sampler":0}}],"samplers":[{sampler}],"images":[{{"uri":"{image}"}}],
            "buffers":[{{"byteLength":36,"uri":"{buffer}"}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[0,0,0]}}]}}"#
        );
        let drawable = only_drawable(&read(gltf));
        let texture = drawable.1.material.texture.as_ref().unwrap();
        assert_eq!(texture.sampling, expected, "{sampler}");
        assert_eq!(texture.mips.len(), if expected.mip.is_some() { 2 } else { 1 }, "{sampler}");
    }
}

#[test]
fn gltf_json_with_data_uris_strips_and_materials_is_read() {
    use base64::Engine as _;
    // Four corners are drawn as a strip with 8-bit indices.
    let mut buffer = Vec::new();
    for p in [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]] {
        buffer.extend(p.iter().flat_map(|x| x.to_le_bytes()));
    }
    buffer.extend([0u8, 1, 2, 3]);
    let uri =
        format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(buffer));
    let gltf = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0,"translation":[5,0,0]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"mode":5,"material":0}}]}}],
        "materials":[{{"alphaMode":"MASK","alphaCutoff":0.25,"doubleSided":true}}],
        "buffers":[{{"byteLength":52,"uri":"{uri}"}}],
        "bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":4}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
        {{"bufferView":1,"componentType":5121,"count":4,"type":"SCALAR"}}]}}"#
    );
    let drawable = only_drawable(&read(gltf));
    let Geometry::Mesh(mesh) = &drawable.1.geometry else { panic!("a mesh") };
    assert_eq!(
        (mesh.topology, &*mesh.indices),
        (Topology::Triangles, &[0, 1, 2, 2, 1, 3][..]),
        "the strip keeps its winding order"
    );
    assert_eq!((drawable.1.material.alpha, drawable.1.material.double_sided), (AlphaMode::Mask(0.25), true));
    assert_eq!(positions(&drawable)[3], DVec3::new(6.0, 0.0, 1.0));
}

#[test]
fn gltf_nodes_keep_their_occluders() {
    let gltf = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"translation":[0,0,7],
        "children":[1,2,3,4],"extras":{"terrane":{"occluder":{"corners":[[0,0,0],[4,0,0],[4,3,0],[0,3,0]],
        "holes":[[[1,1,0],[2,1,0],[1,2,0]]]}}}},{"name":"occluder","extras":"of another kind"},
        {"extras":{"occluder":5,"terrane":{"else":1}}},{"extras":["terrane"]},{"extras":"\"terrane\":\"occluder\""}]}"#;
    let mut open = vec![(DAffine3::IDENTITY, read(gltf))];
    let mut found = Vec::new();
    while let Some((world, node)) = open.pop() {
        let world = match node.kind {
            NodeKind::Transform(map) => world * map,
            NodeKind::OccluderNode(ref occluder) => {
                found.push((world.transform_point3(occluder.corners[2]), occluder.holes[0].len()));
                world
            }
            _ => world,
        };
        open.extend(node.children.into_iter().map(|child| (world, child)));
    }
    assert_eq!(found, [(DVec3::new(4.0, -7.0, 3.0), 3)], "z is up, and the node's transform applies");
}

#[test]
fn tiles_of_one_file_share_their_indices() {
    let [a, b] = [0, 1].map(|_| only_drawable(&read(triangle())).1);
    let [Geometry::Mesh(a), Geometry::Mesh(b)] = [&a.geometry, &b.geometry] else { panic!("meshes") };
    assert!(Arc::ptr_eq(&a.indices, &b.indices), "equal lists are stored once");
}

/// Returns a wavy square, 40 m by 10 m, far from its origin.
fn wavy(quantized: bool) -> GlbMesh {
    let mut mesh = GlbMesh { base_color: [1.0; 4], quantized, ..GlbMesh::default() };
    for j in 0..9u16 {
        for i in 0..9u16 {
            let [u, v] = [i, j].map(|k| f32::from(k) / 8.0);
            let slope = DVec3::new(0.3 * f64::from(u).sin(), 1.0, 0.2).normalize().as_vec3();
            mesh.positions.push([1000.0 + 40.0 * u, (7.0 * u).sin(), -500.0 + 10.0 * v]);
            mesh.normals.push(slope.to_array());
            mesh.uvs.push([u, v]);
            if i < 8 && j < 8 {
                let a = 9 * j + i;
                mesh.indices.extend([a, a + 9, a + 1, a + 1, a + 9, a + 10]);
            }
        }
    }
    mesh
}

#[test]
fn quantized_meshes_are_half_as_large_and_equal() {
    let files = [false, true].map(|quantized| write_glb(&wavy(quantized)));
    // A vertex takes 16 bytes less, minus the additional description in the file.
    assert!(files[0].len() - files[1].len() > 81 * 16 - 400, "{} {}", files[0].len(), files[1].len());
    let [plain, quantized] = [0, 1].map(|i| only_drawable(&read(files[i].clone())));
    // The tolerance is half a step of the longest side, plus the rounding of floats far from their origin.
    for (a, b) in positions(&plain).into_iter().zip(positions(&quantized)) {
        assert!((a - b).abs().max_element() <= 0.5 * 40.0 / 65535.0 + 1e-4, "{a} {b}");
    }
    let [Geometry::Mesh(a), Geometry::Mesh(b)] = [&plain.1.geometry, &quantized.1.geometry] else { panic!("meshes") };
    assert_eq!(a.indices, b.indices);
    for (a, b) in a.vertices.iter().zip(&b.vertices) {
        assert_eq!((a.normal, a.color), (b.normal, b.color));
        assert!((0..2).all(|k| (a.uv[k] - b.uv[k]).abs() <= 0.51 / 65535.0));
        assert!(b.position.iter().all(|x| (0.0..=1.0).contains(x)), "a transform scales them to metres");
    }
    // Values out of range are written unchanged.
    let mut beyond = wavy(true);
    beyond.uvs[3] = [1.5, -0.25];
    let (_, beyond) = only_drawable(&read(write_glb(&beyond)));
    let Geometry::Mesh(mesh) = &beyond.geometry else { panic!("a mesh") };
    assert_eq!(mesh.vertices[3].uv, [1.5, -0.25]);
    let point = GlbMesh { positions: vec![[3.0, 4.0, 5.0]; 3], indices: vec![0, 1, 2], quantized: true, ..wavy(true) };
    let point = GlbMesh { normals: vec![], uvs: vec![], ..point };
    assert_eq!(
        positions(&only_drawable(&read(write_glb(&point)))),
        [DVec3::new(3.0, -5.0, 4.0); 3],
        "no extent at all"
    );
}
