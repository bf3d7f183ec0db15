//! Small files whose numbers ask for much memory: each fails with one error that names it, the bytes and the limit, and nothing
//! is allocated beyond the budget of one content. Each file wants several times the budget.

use std::sync::Arc;

use kit::contents::pnts_bytes;
use kit::splats::{gzip, spz_glb, spz_header};
use terrane::fetch::{IoError, Limits};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{Content, ContentReader, Fetched, ReadOptions, decode};
use terrane::scene::Node;

use super::peak_bytes;

/// The budget of one content in these tests.
pub(super) const BUDGET: u64 = 4 << 20;
/// The bytes that a decoder may hold beside the budget: its input once more, tables of decompressors, and a list that has grown.
pub(super) const SLACK: u64 = 2 << 20;

pub(super) fn options(max_content_bytes: u64) -> ReadOptions {
    ReadOptions::for_root("/set/tileset.json", Limits { max_content_bytes, ..Limits::default() })
}

pub(super) fn content(uri: &str, bytes: Vec<u8>) -> Content {
    Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() }
}

/// Decodes a file with the budget. It must fail by it, and not hold more than it, although it takes more without it.
pub(super) fn assert_refused(name: &str, uri: &str, bytes: Vec<u8>) {
    assert_refused_within(BUDGET + SLACK, name, uri, bytes);
}

fn assert_refused_within(most: u64, name: &str, uri: &str, bytes: Vec<u8>) {
    assert_content_refused(most, name, content(uri, bytes));
}

/// Asserts the same as [`assert_refused`] for any content and any maximum of bytes at once.
pub(super) fn assert_content_refused(most: u64, name: &str, within: Content) {
    let (input, uri, free) = (within.bytes.len() as u64, within.uri.clone(), within.clone());
    let (_, unlimited) = peak_bytes(|| drop(decode(free, &options(u64::MAX))));
    println!("{name}: {input} bytes become {unlimited} at once");
    assert!(unlimited > most + input, "{name}: {unlimited} bytes without a budget are not hostile");
    let (decoded, peak) = peak_bytes(|| decode(within, &options(BUDGET)));
    let error = decoded.expect_err(name);
    assert!(matches!(error, IoError::TooLarge { limit: BUDGET, got, .. } if got > BUDGET), "{name}: {error}");
    assert!(error.to_string().starts_with(&format!("{uri}: memory of one content in bytes")), "{name}: {error}");
    assert!(peak <= most + input, "{name}: {peak} bytes at once, {input} of the file");
}

/// Returns a glTF with a node, a mesh and accessors without bytes, which may have any length.
fn gltf(node: &str, primitives: &str, accessors: &str) -> Vec<u8> {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{node}}}],"meshes":[{{"primitives":[{primitives}]}}],"accessors":[{accessors}],"bufferViews":[{{"buffer":0,"byteLength":12}}],"buffers":[{{"byteLength":12,"uri":"data:;base64,AAAAAAAAAAAAAAAA"}}]}}"#
    )
    .into_bytes()
}

fn zeros(kind: &str, component: u32, count: u32) -> String {
    format!(r#"{{"componentType":{component},"type":"{kind}","count":{count},"min":[0,0,0],"max":[0,0,0]}}"#)
}

#[test]
fn gltf_takes_no_more_than_its_budget() {
    const FLOAT: u32 = 5126;
    const SHORT: u32 = 5123;
    let (many, three) = (zeros("VEC3", FLOAT, 300_000), zeros("VEC3", FLOAT, 3));
    let position = r#"{"attributes":{"POSITION":0}}"#;
    assert_refused("vertices", "/set/a.gltf", gltf("", position, &many));
    let indexed = r#"{"attributes":{"POSITION":0},"indices":1}"#;
    let indices = zeros("SCALAR", SHORT, 3_000_000);
    assert_refused("indices", "/set/a.gltf", gltf("", indexed, &format!("{three},{indices}")));
    let shared = vec![position; 600].join(",");
    let some = zeros("VEC3", FLOAT, 1000);
    assert_refused("primitives that share an accessor", "/set/a.gltf", gltf("", &shared, &some));
    let instances = r#","extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":1}}}"#;
    let places = zeros("VEC3", FLOAT, 20_000);
    assert_refused("instances", "/set/a.gltf", gltf(instances, position, &format!("{three},{places}")));
    let sparse = r#"{"componentType":5126,"type":"VEC3","count":300000,"sparse":{"count":1,"indices":{"bufferView":0,"componentType":5125},"values":{"bufferView":0}}}"#;
    assert_refused("a sparse accessor", "/set/a.gltf", gltf("", position, sparse));
    let nodes = vec!["{}"; 60_000].join(",");
    let objects = format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{nodes}]}}"#);
    assert_refused("JSON", "/set/a.gltf", objects.into_bytes());
}

#[test]
fn images_take_no_more_than_the_budget_of_their_content() {
    let png = |side: u32, is_wide: bool| {
        let mut png = std::io::Cursor::new(Vec::new());
        let image = match is_wide {
            true => image::DynamicImage::new_rgba16(side, side),
            false => image::DynamicImage::new_luma8(side, side),
        };
        image.write_to(&mut png, image::ImageFormat::Png).unwrap();
        png.into_inner()
    };
    for (name, image) in [("8 bits a channel", png(2048, false)), ("16 bits a channel", png(1000, true))] {
        let glb = write_glb(&GlbMesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            uvs: vec![[0.0; 2]; 3],
            indices: vec![0, 1, 2],
            image: Some(image),
            base_color: [1.0; 4],
            ..GlbMesh::default()
        });
        assert_refused(name, "/set/a.glb", glb);
    }
}

#[test]
fn other_formats_take_no_more_than_the_budget() {
    // A list that grows holds its old and its new memory for a moment.
    assert_refused_within(2 * BUDGET + SLACK, "gzip", "/set/a.glb", gzip(&vec![0; 12 << 20]));
    let splats = [spz_header(3, 200_000, 3, 12, 0), vec![0; 65 * 200_000]].concat();
    assert_refused("SPZ", "/set/a.glb", spz_glb(&gzip(&splats)));
    let table = r#"{"POINTS_LENGTH":400000,"POSITION_QUANTIZED":{"byteOffset":0},"QUANTIZED_VOLUME_SCALE":[1,1,1],"QUANTIZED_VOLUME_OFFSET":[0,0,0]}"#;
    assert_refused("pnts", "/set/a.pnts", pnts_bytes(table, &vec![0; 6 * 400_000]));
    // A header of quantized-mesh, vertices at one position, as many triangles as use each once, and edges without vertices.
    let (vertices, triangles) = (200_000u32, 66_666u32);
    let (places, codes) = (vec![0; 6 * vertices as usize], vec![0; 12 * triangles as usize + 16]);
    let quantized = [&[0; 88][..], &vertices.to_le_bytes(), &places, &triangles.to_le_bytes(), &codes].concat();
    assert_refused("quantized-mesh", "/set/0/0/0.terrain", quantized);
    let words = format!("Group {{ a {} }}", "b ".repeat(400_000));
    assert_refused(".osg", "/set/a.osg", words.into_bytes());
    let numbers = format!(
        "#Ascii Scene \n#Version 161 \n#Generator OpenSceneGraph 3.6.5 \n\nosg::Geode {{ UniqueID 1 Drawables 1 {{ osg::Geometry {{ UniqueID 2 VertexArray TRUE {{ osg::Vec3dArray {{ UniqueID 4 Binding BIND_PER_VERTEX vector 400000 {{ {} }} }} }} }} }} }}",
        "0 ".repeat(1_200_000)
    );
    assert_refused(".osgt", "/set/a.osgt", numbers.into_bytes());
}

#[test]
fn instances_of_i3dm_take_no_more_than_the_budget() {
    let model = write_glb(&GlbMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let count = 30_000;
    let mut table = format!(r#"{{"INSTANCES_LENGTH":{count},"POSITION":{{"byteOffset":0}}}}"#).into_bytes();
    table.resize(table.len().next_multiple_of(8), b' ');
    let positions = vec![0; 12 * count];
    let mut bytes = b"i3dm".to_vec();
    let length = 32 + table.len() + positions.len() + model.len();
    for word in [1, length, table.len(), positions.len(), 0, 0, 1] {
        bytes.extend((word as u32).to_le_bytes());
    }
    assert_refused("i3dm", "/set/a.i3dm", [bytes, table, positions, model].concat());
}

/// Says the bytes that its contents take, which are not allocated.
#[derive(Debug)]
struct Announced;

impl ContentReader for Announced {
    fn accepts(&self, uri: &str, _bytes: &[u8]) -> bool {
        uri.ends_with(".own")
    }

    fn decoded_bytes(&self, _uri: &str, _bytes: &[u8]) -> u64 {
        3 * BUDGET
    }

    fn read(&self, uri: &str, _bytes: &[u8], _files: &[Fetched], _options: &ReadOptions) -> Result<Node, String> {
        panic!("{uri} is read beyond its budget");
    }
}

#[test]
fn readers_of_an_application_are_not_called_beyond_the_budget() {
    let options = ReadOptions { readers: Arc::new([Arc::new(Announced)]), ..options(BUDGET) };
    let error = decode(content("/set/a.own", vec![7]), &options).unwrap_err();
    assert!(matches!(error, IoError::TooLarge { got, limit: BUDGET, .. } if got == 3 * BUDGET), "{error}");
}
