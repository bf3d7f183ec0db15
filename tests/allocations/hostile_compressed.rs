//! The same as `hostile.rs` for compressed contents and for contents with a tile's own data. Headers that announce gigabytes fail
//! without a large allocation, whatever the budget is.

use std::fmt::Write as _;

use base64::Engine as _;
use kit::compressed::{Triangles, uastc_mosaic};
use kit::ive_files::{GEODE, Ive, VERSION};
use meshoptimizer_rs::Workspace;
use meshoptimizer_rs::codec::{VertexEncoding, encode_vertex_buffer};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use terrane::fetch::Limits;
use terrane::formats::{Content, Fetched, ReadOptions, Style, decode, decode_node};
use terrane::scene::{Node, NodeKind, ReaderData};

use super::hostile::{BUDGET, SLACK, assert_content_refused, assert_refused, content, options};
use super::peak_bytes;

/// Decodes a file whose header announces gigabytes, with the usual limits. It must fail, or be drawn without the part.
fn assert_small(name: &str, content: Content) {
    let input = content.bytes.len() as u64;
    let options = options(Limits::default().max_content_bytes);
    let (decoded, peak) = peak_bytes(|| decode(content, &options).map(drop));
    println!("{name}: {input} bytes become {peak} at once, {decoded:?}");
    assert!(peak <= SLACK + input, "{name}: {peak} bytes at once, {input} of the file");
    if let Err(error) = decoded {
        assert!(!error.reason().is_empty() && error.uri().starts_with("/set/"), "{name}: {error}");
    }
}

fn data_uri(bytes: &[u8]) -> String {
    format!("data:;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

/// Returns a glTF of a triangle with the members of its buffer views, buffers and so on after the first ones. The first accessor has
/// the positions.
fn triangle(primitive: &str, views: &str, buffers: &str, rest: &str) -> Vec<u8> {
    let triangle: Vec<u8> =
        [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let uri = data_uri(&triangle);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{{primitive}}}]}}],"bufferViews":[{{"buffer":0,"byteLength":36}}{views}],"buffers":[{{"byteLength":36,"uri":"{uri}"}}{buffers}]{rest}}}"#
    )
    .into_bytes()
}

const POSITION: &str = r#""attributes":{"POSITION":0}"#;

/// Returns a glTF with one image.
fn textured(image: &[u8]) -> Vec<u8> {
    let uri = data_uri(image);
    let rest = format!(
        r#","accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}}],"materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],"textures":[{{"source":0}}],"images":[{{"uri":"{uri}"}}]"#
    );
    triangle(&format!(r#"{POSITION},"material":0"#), "", "", &rest)
}

/// Writes a number of 8 bytes at an offset.
fn put(bytes: &mut [u8], at: usize, number: u64) {
    bytes[at..at + 8].copy_from_slice(&number.to_le_bytes());
}

/// Returns a KTX2 file of one level in one colour, whose blocks are compressed by zstd.
fn ktx2(side: u32) -> Vec<u8> {
    const LEVEL: usize = 80;
    let plain = uastc_mosaic([side; 2], 1, |_| [9, 9, 9, 255]);
    let start = plain.len() - side as usize * side as usize;
    let mut file = plain[..start].to_vec();
    let packed = compress_to_vec(&plain[start..], CompressionLevel::Fastest);
    file[44] = 2;
    put(&mut file, LEVEL + 8, packed.len() as u64);
    file.extend(packed);
    file
}

#[test]
fn ktx2_takes_no_more_than_the_budget_of_its_content() {
    assert_refused("KTX2", "/set/a.gltf", textured(&ktx2(2048)));
    let mut larger = ktx2(64);
    put(&mut larger, 80 + 16, 1 << 40);
    assert_small("a KTX2 level of a terabyte", content("/set/a.gltf", textured(&larger)));
    let mut wide = ktx2(64);
    for at in [20, 24] {
        wide[at..at + 4].copy_from_slice(&(1u32 << 31).to_le_bytes());
    }
    assert_small("KTX2 sides of gigabytes", content("/set/a.gltf", textured(&wide)));
}

/// Returns a glTF whose positions are in a compressed view of vertices of 12 bytes.
fn meshopt(compressed: &[u8], count: u64, declared: u64) -> Vec<u8> {
    let (length, uri, bytes) = (compressed.len(), data_uri(compressed), 12 * declared);
    let extension = format!(
        r#"{{"buffer":1,"byteOffset":0,"byteLength":{length},"byteStride":12,"count":{count},"mode":"ATTRIBUTES"}}"#
    );
    let view =
        format!(r#",{{"buffer":2,"byteLength":{bytes},"extensions":{{"EXT_meshopt_compression":{extension}}}}}"#);
    let buffers = format!(r#",{{"byteLength":{length},"uri":"{uri}"}},{{"byteLength":{bytes}}}"#);
    let rest = r#","accessors":[{"bufferView":1,"componentType":5126,"type":"VEC3","count":3}]"#;
    triangle(POSITION, &view, &buffers, rest)
}

#[test]
fn meshopt_takes_no_more_than_the_budget_of_its_content() {
    let count = 600_000;
    let encoding = VertexEncoding::new(0, 2).unwrap();
    let packed = encode_vertex_buffer(&vec![0; 12 * count], count, 12, encoding, &mut Workspace::default()).unwrap();
    assert_refused("meshopt", "/set/a.gltf", meshopt(&packed, count as u64, count as u64));
    let few = encode_vertex_buffer(&[0; 36], 3, 12, encoding, &mut Workspace::default()).unwrap();
    for (name, count, declared) in [
        ("meshopt vertices of terabytes", 1 << 40, 1 << 40),
        ("as many as the limit of files", 40_000_000, 40_000_000),
        ("more than the view has", 1 << 40, 3),
    ] {
        assert_small(name, content("/set/a.gltf", meshopt(&few, count, declared)));
    }
}

/// Returns a glTF with a Draco mesh, whose accessors declare these numbers of vertices and indices.
fn draco(compressed: &[u8], vertices: usize, indices: usize) -> Vec<u8> {
    let (length, uri) = (compressed.len(), data_uri(compressed));
    let extension =
        r#""extensions":{"KHR_draco_mesh_compression":{"bufferView":1,"attributes":{"POSITION":0,"COLOR_0":1}}}"#;
    let primitive = format!(r#""attributes":{{"POSITION":0,"COLOR_0":2}},"indices":1,{extension}"#);
    let rest = format!(
        r#","extensionsUsed":["KHR_draco_mesh_compression"],"accessors":[{{"componentType":5126,"type":"VEC3","count":{vertices}}},{{"componentType":5125,"type":"SCALAR","count":{indices}}},{{"componentType":5121,"normalized":true,"type":"VEC4","count":{vertices}}}]"#
    );
    let view = format!(r#",{{"buffer":1,"byteLength":{length}}}"#);
    triangle(&primitive, &view, &format!(r#",{{"byteLength":{length},"uri":"{uri}"}}"#), &rest)
}

#[test]
fn draco_takes_no_more_than_the_budget_of_its_content() {
    let grid = Triangles::grid(400);
    let (vertices, indices, packed) = (grid.vertex_count(), grid.indices.len(), grid.draco(5));
    assert_refused("Draco", "/set/a.gltf", draco(&packed, vertices, indices));
    assert_small("more Draco vertices than the accessors", content("/set/a.gltf", draco(&packed, 3, 3)));
    // Behind the header of 11 bytes stand the numbers of faces and of points, in seven bits a byte.
    let mut huge = Triangles::grid(3).draco(0);
    huge.splice(11..13, [0xff, 0xff, 0xff, 0xff, 0x0f, 0xff, 0xff, 0xff, 0xff, 0x0f]);
    for (vertices, indices) in [(9, 24), (9, 4_000_000_000)] {
        assert_small("Draco faces of gigabytes", content("/set/a.gltf", draco(&huge, vertices, indices)));
    }
}

/// Returns a file with a Geometry whose vertices are zeros.
fn ive(vertices: u32, written: usize) -> Ive {
    let mut file = Ive::new(VERSION);
    file.u32(0).u32(GEODE).node("").u32(1).u32(1).u32(0x1001).drawable();
    file.u32(1).u32(0x1_0001).primitives().u32s(&[0, 3]);
    file.raw(&[1, 7]).u32(vertices).raw(&vec![0; 12 * written]).raw(&[0]);
    file.raw(&[0; 8]).u32s(&[0, 0]);
    file
}

#[test]
fn ive_takes_no_more_than_the_budget() {
    let file = ive(600_000, 600_000);
    assert_refused(".ive", "/set/a.ive", file.bytes.clone());
    // The bytes are read in steps, so that what is unfolded may be twice the budget while a list grows.
    assert_content_refused(2 * BUDGET + SLACK, "compressed .ive", content("/set/a.ive", file.compressed()));
    for vertices in [i32::MAX as u32, 400_000_000] {
        assert_small("vertices of gigabytes in .ive", content("/set/a.ive", ive(vertices, 3).bytes));
    }
    let mut file = ive(3, 3).compressed();
    file[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_small("a compressed .ive of four gigabytes", content("/set/a.ive", file));
}

/// Returns the data of the first tile of a tileset.
fn data_of_tile(tileset: &str) -> ReaderData {
    fn find(node: &Node) -> Option<ReaderData> {
        let own = if let NodeKind::PagedLod(tile) = &node.kind { tile.reader_data.clone() } else { None };
        own.or_else(|| node.children.iter().find_map(find))
    }
    let root = content("/set/tileset.json", tileset.as_bytes().to_vec());
    find(&decode_node(root, &options(u64::MAX)).unwrap()).unwrap()
}

/// Returns the content of the largest height tile that there is.
fn heights(bytes: Vec<u8>) -> Content {
    let tileset = r#"{"asset":{"version":"1.1","extras":{"terrane":{"content":"height","side":257,"border":1,"level_errors_m":[9]}}},"geometricError":9,"root":{"refine":"REPLACE","boundingVolume":{"region":[0.1,0.8,0.11,0.81,0,1]},"geometricError":9,"content":{"uri":"a.exr"}}}"#;
    Content { reader_data: Some(data_of_tile(tileset)), ..content("/set/a.exr", bytes) }
}

/// Returns an OpenEXR file with an attribute, whose size is announced, and a data window, before which nothing is allocated.
fn exr(attribute_bytes: u32, side: u32) -> Vec<u8> {
    let mut file = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    let mut attribute = |name: &str, kind: &str, size: u32, bytes: &[u8]| {
        file.extend([name.as_bytes(), &[0], kind.as_bytes(), &[0]].concat());
        file.extend(size.to_le_bytes());
        file.extend(bytes);
    };
    let window: Vec<u8> = [0, 0, side - 1, side - 1].iter().flat_map(|at| at.to_le_bytes()).collect();
    let channel = [b"Y\0".as_slice(), &2u32.to_le_bytes(), &[0; 4], &1u32.to_le_bytes(), &1u32.to_le_bytes(), &[0]];
    attribute("channels", "chlist", 19, &channel.concat());
    attribute("compression", "compression", 1, &[0]);
    attribute("dataWindow", "box2i", 16, &window);
    attribute("displayWindow", "box2i", 16, &window);
    attribute("lineOrder", "lineOrder", 1, &[0]);
    attribute("pixelAspectRatio", "float", 4, &1f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", 8, &[0; 8]);
    attribute("screenWindowWidth", "float", 4, &1f32.to_le_bytes());
    attribute("own", "blob", attribute_bytes, &[0; 4]);
    file.push(0);
    file
}

#[test]
fn headers_of_heights_allocate_nothing() {
    for (name, file) in [
        ("a window of gigabytes", exr(4, 1 << 30)),
        ("an attribute of gigabytes", exr(i32::MAX as u32, 259)),
        ("scan lines that are missing", exr(4, 259)),
    ] {
        assert_small(&format!("EXR with {name}"), heights(file));
    }
    let packed = |side: u16, planes: u8, data: &[u8]| {
        let [low, high] = side.to_le_bytes();
        [b"TRHT".as_slice(), &[1, planes, 1, 0, low, high, 0, 0], &[0; 12], data].concat()
    };
    let zeros = compress_to_vec(&vec![0u8; 32 << 20][..], CompressionLevel::Fastest);
    assert_small("packed heights of gigabytes", heights(packed(u16::MAX, 4, &zeros)));
    assert_small("differences beyond their number", heights(packed(259, 4, &zeros)));
}

#[test]
fn buffers_of_subtrees_take_no_more_than_the_budget() {
    let tileset = |contents: &str| {
        format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"refine":"REPLACE","boundingVolume":{{"box":[0,0,0,1,0,0,0,1,0,0,0,1]}},"geometricError":9,"contents":[{contents}],"implicitTiling":{{"subdivisionScheme":"OCTREE","subtreeLevels":3,"availableLevels":9,"subtrees":{{"uri":"s/{{level}}/{{x}}/{{y}}/{{z}}"}}}}}}}}"#
        )
    };
    let count = 250;
    let list = |item: &dyn Fn(usize) -> String| (0..count).map(item).collect::<Vec<_>>().join(",");
    let contents = list(&|i| format!(r#"{{"uri":"c/{i}/{{level}}/{{x}}/{{y}}/{{z}}"}}"#));
    let data = data_of_tile(&tileset(&contents));
    let subtree = |buffer: &str| {
        format!(
            r#"{{"buffers":[{}],"bufferViews":[{}],"tileAvailability":{{"constant":1}},"contentAvailability":[{}],"childSubtreeAvailability":{{"constant":0}}}}"#,
            list(&|_| buffer.to_owned()),
            list(&|i| format!(r#"{{"buffer":{i},"byteOffset":0,"byteLength":10}}"#)),
            list(&|i| format!(r#"{{"bitstream":{i}}}"#)),
        )
    };
    // All buffers are one file, of which each view needs a copy.
    let buffer: Fetched = ("/set/s/0/0/0/bits".into(), Ok(vec![255; 64 << 10]));
    let content = |text: String, companions: Vec<Fetched>| Content {
        uri: "/set/s/0/0/0/0".into(),
        bytes: text.into_bytes(),
        reader_data: Some(data.clone()),
        companions,
    };
    let shared = content(subtree(r#"{"byteLength":65536,"uri":"bits"}"#), vec![buffer]);
    assert_content_refused(BUDGET + SLACK, "buffers of a subtree", shared);
    let mut header = b"subt\x01\0\0\0".to_vec();
    header.extend(u64::MAX.to_le_bytes());
    header.extend(u64::MAX.to_le_bytes());
    let huge = Content { bytes: header, ..content(String::new(), Vec::new()) };
    assert_small("chunks of a subtree beyond all bytes", huge);
    let announced = subtree(r#"{"byteLength":1000000000000,"uri":"bits"}"#);
    let empty: Fetched = ("/set/s/0/0/0/bits".into(), Ok(vec![0; 64]));
    assert_small("a buffer of a terabyte", content(announced.clone(), vec![empty]));
    // Each of the 73 tiles has all contents.
    let full: Fetched = ("/set/s/0/0/0/bits".into(), Ok(vec![255; 64]));
    assert_content_refused(BUDGET + SLACK, "contents of a subtree", content(announced, vec![full]));
}

/// A style is read before any content, without a budget.
#[test]
fn styles_are_bounded_before_they_are_parsed() {
    let mut objects = String::from(r#"{"a":["#);
    for _ in 0..1_000_000 {
        let _ = write!(objects, r#"{{"":0}},"#);
    }
    objects.push_str("0]}");
    let (read, peak) = peak_bytes(|| Style::from_json("/set/style.json", objects.as_bytes()));
    assert!(read.unwrap_err().to_string().starts_with("/set/style.json: "));
    assert!(peak < SLACK, "{peak} bytes at once");
    // The longest list of conditions that is read, and the longest expression.
    let conditions = vec![r#"["${a}===1","color('red')"]"#; 250_000].join(",");
    let sum = vec!["1"; 4_000_000].join("+");
    let styles = [format!(r#"{{"color":{{"conditions":[{conditions}]}}}}"#), format!(r#"{{"pointSize":"{sum}"}}"#)];
    for style in styles {
        let (read, peak) = peak_bytes(|| Style::from_json("/set/style.json", style.as_bytes()).map(drop));
        println!("a style of {} bytes becomes {peak} at once", style.len());
        read.unwrap();
        assert!(peak < ReadOptions::for_root("/set/a", Limits::default()).limits.max_content_bytes, "{peak}");
    }
}
