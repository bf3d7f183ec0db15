//! Attributes of glTF meshes that the application asks to keep.

use std::sync::Arc;

use base64::Engine as _;
use terrane::fetch::{IoError, Limits};
use terrane::formats::{Content, ReadOptions, decode};
use terrane::scene::{AttributeFormat, Drawable, Geometry, Mesh, Page, ShareModes, SharedStateManager};

/// An attribute's name, component type, normalized or not, type of its elements, and bytes for three vertices.
type Given<'a> = (&'a str, u32, bool, &'a str, Vec<u8>);

const BYTE: u32 = 5120;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;

/// Returns a triangle with these attributes, each in a separate view with a gap between elements.
fn triangle(given: &[Given<'_>], gap: usize) -> Vec<u8> {
    let mut buffer: Vec<u8> =
        [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].concat().iter().flat_map(|x| x.to_le_bytes()).collect();
    let mut views = vec![r#"{"buffer":0,"byteLength":36}"#.to_owned()];
    let mut accessors =
        vec![r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}"#.to_owned()];
    let mut attributes = vec![r#""POSITION":0"#.to_owned()];
    for (name, component, normalized, ty, bytes) in given {
        let (offset, size) = (buffer.len(), bytes.len() / 3);
        let stride = size.next_multiple_of(4) + gap;
        for element in bytes.chunks(size) {
            buffer.extend(element);
            buffer.resize(buffer.len() + stride - size, 0xee);
        }
        let length = buffer.len() - offset;
        let view = views.len();
        views.push(format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length},"byteStride":{stride}}}"#));
        attributes.push(format!(r#""{name}":{}"#, accessors.len()));
        accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":{component},"normalized":{normalized},"count":3,"type":"{ty}"}}"#
        ));
    }
    let uri = base64::engine::general_purpose::STANDARD.encode(&buffer);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"meshes":[{{"primitives":[{{"attributes":{{{}}}}}]}}],"buffers":
        [{{"byteLength":{},"uri":"data:application/octet-stream;base64,{uri}"}}],"bufferViews":[{}],"accessors":[{}]}}"#,
        attributes.join(","),
        buffer.len(),
        views.join(","),
        accessors.join(","),
    )
    .into_bytes()
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn options(names: &[&str]) -> ReadOptions {
    let vertex_attributes = names.iter().map(|name| Arc::from(*name)).collect();
    ReadOptions { vertex_attributes, ..ReadOptions::for_root("/set/tileset.json", Limits::default()) }
}

fn read(bytes: Vec<u8>, options: &ReadOptions) -> Result<Page, IoError> {
    let uri = "/set/tile.gltf".into();
    decode(Content { uri, bytes, reader_data: None, companions: Vec::new() }, options)
}

fn drawable(page: &mut Page) -> Drawable {
    page.take_drawables().remove(0)
}

fn mesh(drawable: &Drawable) -> &Arc<Mesh> {
    let Geometry::Mesh(mesh) = &drawable.geometry else { panic!("a mesh") };
    mesh
}

fn tangents(w: f32) -> Given<'static> {
    let values: Vec<f32> = (0..3u8).flat_map(|i| [f32::from(i), 0.5, -0.25, w]).collect();
    ("TANGENT", FLOAT, false, "VEC4", floats(&values))
}

#[test]
fn requested_attributes_are_kept_under_their_names() {
    use AttributeFormat::*;
    let given: [Given<'_>; 6] = [
        tangents(1.0),
        ("TEXCOORD_1", UNSIGNED_SHORT, true, "VEC2", (0..12).collect()),
        ("_HEAT", FLOAT, false, "SCALAR", floats(&[1.0, 2.0, 3.0])),
        ("_RGB", UNSIGNED_BYTE, true, "VEC3", (0..9).collect()),
        ("_STEPS", BYTE, false, "SCALAR", vec![255, 1, 2]),
        ("_ID", UNSIGNED_INT, false, "SCALAR", (0..12).collect()),
    ];
    for gap in [0, 4] {
        let bytes = triangle(&given, gap);
        // By default no attributes are kept.
        let plain = read(bytes.clone(), &options(&[])).unwrap();
        let plain_bytes = plain.size_bytes();
        assert!(mesh(&drawable(&mut { plain })).attributes.is_empty());
        let names = ["_HEAT", "TANGENT", "TEXCOORD_1", "_RGB", "_STEPS", "_ID", "_NOT_THERE"];
        let mut page = read(bytes, &options(&names)).unwrap();
        assert_eq!(page.size_bytes() - plain_bytes, 3 * (4 + 16 + 4 + 4 + 4 + 4));
        let drawable = drawable(&mut page);
        let kept: Vec<_> = mesh(&drawable).attributes.iter().collect();
        let padded = |bytes: &[u8], size: usize| -> Vec<u8> {
            bytes.chunks(size).flat_map(|e| e.iter().copied().chain(std::iter::repeat(0)).take(4)).collect()
        };
        let [tangents, texcoords, heat, rgb, steps, ids] = given.clone().map(|(.., bytes)| bytes);
        let (rgb, steps) = (padded(&rgb, 3), padded(&steps, 1));
        let expected: [(&str, AttributeFormat, &[u8]); 6] = [
            ("_HEAT", Float32, &heat),
            ("TANGENT", Float32x4, &tangents),
            ("TEXCOORD_1", Unorm16x2, &texcoords),
            ("_RGB", Unorm8x4, &rgb),
            ("_STEPS", Sint8x4, &steps),
            ("_ID", Uint32, &ids),
        ];
        assert_eq!(kept, expected, "{gap} bytes between elements");
    }
}

/// A view without a stride, and one that ends with the bytes of the last element, are valid.
fn tight(gltf: Vec<u8>, stride: usize, spare: usize) -> Vec<u8> {
    let text = String::from_utf8(gltf).unwrap();
    let whole = 3 * stride;
    let (from, to) =
        (format!(r#""byteLength":{whole},"byteStride":{stride}}}"#), format!(r#""byteLength":{}}}"#, whole - spare));
    assert_eq!(text.matches(&from).count(), 1, "{text}");
    text.replace(&from, &to).into_bytes()
}

#[test]
fn matrices_are_kept_as_columns() {
    use AttributeFormat::*;
    // A type, the bytes of an element with padding between columns, columns and rows.
    let cases = [
        (FLOAT, false, "MAT2", 2, 2, 4, Float32x2),
        (FLOAT, false, "MAT3", 3, 3, 4, Float32x3),
        (FLOAT, false, "MAT4", 4, 4, 4, Float32x4),
        (UNSIGNED_BYTE, true, "MAT2", 2, 2, 1, Unorm8x4),
        (BYTE, true, "MAT3", 3, 3, 1, Snorm8x4),
        (UNSIGNED_BYTE, false, "MAT4", 4, 4, 1, Uint8x4),
        (UNSIGNED_SHORT, true, "MAT2", 2, 2, 2, Unorm16x2),
        (UNSIGNED_SHORT, false, "MAT3", 3, 3, 2, Uint16x4),
    ];
    for (component, normalized, ty, columns, rows, size, format) in cases {
        let column = usize::next_multiple_of(rows * size, 4);
        // Each column has different numbers; the padding is noise.
        let byte = |element: usize, c: usize, at: usize| (100 * element + 16 * c + at) as u8;
        let element = |e| {
            (0..columns)
                .flat_map(move |c| (0..column).map(move |at| if at < rows * size { byte(e, c, at) } else { 0xee }))
        };
        let bytes: Vec<u8> = (0..3).flat_map(element).collect();
        let given = |gap| triangle(&[("_BASIS", component, normalized, ty, bytes.clone())], gap);
        let spare = column - rows * size;
        for gltf in [given(0), given(4), tight(given(0), columns * column, 0), tight(given(0), columns * column, spare)]
        {
            let mut page = read(gltf, &options(&["_BASIS"])).unwrap();
            let drawable = drawable(&mut page);
            let kept: Vec<_> = mesh(&drawable).attributes.iter().collect();
            assert_eq!(kept.len(), columns, "{ty}");
            for (c, (name, of, elements)) in kept.into_iter().enumerate() {
                let own = |e| (0..format.size_bytes()).map(move |at| if at < rows * size { byte(e, c, at) } else { 0 });
                assert_eq!((name, of), (&*format!("_BASIS_{c}"), format), "{ty}");
                assert_eq!(elements, (0..3).flat_map(own).collect::<Vec<u8>>(), "{ty} {component} column {c}");
            }
        }
        // The view ends within the last column.
        let error = read(tight(given(0), columns * column, spare + 1), &options(&["_BASIS"])).unwrap_err().to_string();
        assert!(error.contains("accessor reaches beyond its buffer"), "{ty}: {error}");
        let error = read(
            triangle(
                &[("_A", component, normalized, ty, bytes.clone()), ("_A_1", BYTE, false, "SCALAR", vec![1, 2, 3])],
                0,
            ),
            &options(&["_A", "_A_1"]),
        );
        assert!(error.unwrap_err().to_string().contains("\"_A_1\""), "{ty}");
    }
    // Sixteen columns exceed the limit.
    let four: Vec<_> = ["_A", "_B", "_C", "_D"].map(|name| (name, FLOAT, false, "MAT4", floats(&[0.0; 48]))).into();
    let error = read(triangle(&four, 0), &options(&["_A", "_B", "_C", "_D"])).unwrap_err().to_string();
    assert!(error.contains("\"_D_0\"") && error.contains("one more than the 12"), "{error}");
}

#[test]
fn equal_meshes_with_different_attributes_are_not_shared() {
    let sharing = Some(Arc::new(SharedStateManager::new(ShareModes::default())));
    let options = ReadOptions { sharing, ..options(&["TANGENT", "_HEAT"]) };
    let heat = |name: &'static str| -> Given<'static> { (name, FLOAT, false, "SCALAR", floats(&[1.0, 2.0, 3.0])) };
    let contents = [
        vec![tangents(1.0)],
        vec![tangents(1.0)],
        vec![tangents(-1.0)],
        vec![tangents(1.0), heat("_HEAT")],
        vec![tangents(1.0), heat("_COLD")],
        vec![],
    ];
    let mut pages: Vec<Page> = contents.iter().map(|given| read(triangle(given, 0), &options).unwrap()).collect();
    let drawables: Vec<Drawable> = pages.iter_mut().map(drawable).collect();
    // The attribute `cold` of the fifth mesh is not requested.
    let equal = [0, 0, 2, 3, 0, 5];
    for (i, first) in equal.into_iter().enumerate() {
        for (j, other) in equal.into_iter().enumerate() {
            let is_one = Arc::ptr_eq(mesh(&drawables[i]), mesh(&drawables[j]));
            assert_eq!(is_one, first == other, "{i} and {j}");
        }
    }
    // An application finds the attributes through the manager.
    let sharing = SharedStateManager::new(ShareModes::default());
    let own = |heat: f32| {
        let corners =
            (0..3u8).map(|i| terrane::scene::MeshVertex { position: [f32::from(i); 3], ..Default::default() });
        let mesh = Mesh::from_arrays(terrane::scene::PrimitiveMode::Triangles, corners.collect());
        let mesh = mesh.with_attribute("heat", AttributeFormat::Float32, &[heat; 3]).unwrap();
        let node = terrane::scene::Node::geode(vec![Drawable::new(mesh.into(), Default::default())]);
        let mut page = Page::from_node(node).unwrap();
        sharing.share(&mut page);
        (drawable(&mut page), page)
    };
    let [(a, _a), (b, _b), (c, _c)] = [1.0, 1.0, 2.0].map(own);
    assert!(Arc::ptr_eq(mesh(&a), mesh(&b)) && !Arc::ptr_eq(mesh(&a), mesh(&c)));
    assert_eq!(sharing.stats().payload_bytes_spared, 3 * (28 + 4 + 4));
}

#[test]
fn attributes_that_cannot_be_kept_are_errors() {
    // Two elements for three vertices are an error.
    let short = String::from_utf8(triangle(&[tangents(1.0)], 0)).unwrap();
    let at = short.rfind(r#""count":3"#).unwrap();
    let short = format!("{}{}{}", &short[..at], r#""count":2"#, &short[at + 9..]).into_bytes();
    assert!(read(short.clone(), &options(&[])).is_ok(), "attributes that are not requested are not checked");
    let error = read(short, &options(&["TANGENT"])).unwrap_err().to_string();
    assert!(error.contains("/set/tile.gltf") && error.contains("TANGENT has 2 elements for 3 vertices"), "{error}");
    let heat = |i: usize| -> (String, Vec<u8>) { (format!("_{i}"), floats(&[0.0; 12])) };
    let many: Vec<_> = (0..13).map(heat).collect();
    let given: Vec<Given<'_>> =
        many.iter().map(|(name, bytes)| (&name[..], FLOAT, false, "VEC4", bytes.clone())).collect();
    let names: Vec<&str> = many.iter().map(|(name, _)| &name[..]).collect();
    assert!(read(triangle(&given, 0), &options(&names[1..])).is_ok());
    let error = read(triangle(&given, 0), &options(&names)).unwrap_err().to_string();
    assert!(error.contains("one more than the 12"), "{error}");
    // Attributes count as the number of vertices that takes as much memory.
    let limits = Limits { max_elements: 16, ..Limits::default() };
    let limited = |names: &[&str]| read(triangle(&given, 0), &ReadOptions { limits, ..options(names) });
    assert!(limited(&names[..6]).is_ok());
    assert!(limited(&names[..7]).unwrap_err().to_string().contains("vertices of a glTF is 17"));
}
