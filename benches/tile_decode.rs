//! Measures decoding, from the bytes of one content to a page: the work of a decode thread for each tile.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use std::hint::black_box;
use std::io::Cursor;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use kit::subtrees::{Scheme, Subtree};
use terrane::fetch::Limits;
use terrane::formats::writers::{GlbMesh, write_glb, write_height_exr};
use terrane::formats::{Content, Fetched, ReadOptions, decode, decode_node};
use terrane::scene::{NodeKind, ShareModes, SharedStateManager};

/// The number of vertices along a side, and that of texels.
const SIDE: usize = 65;
const TEXELS: u32 = 256;

fn height(i: usize, j: usize) -> f32 {
    500.0 + 200.0 * (0.1 * i as f32).sin() * (0.13 * j as f32).cos()
}

fn image(format: image::ImageFormat) -> Vec<u8> {
    let texel = |x: u32, y: u32| image::Rgb([(x ^ y) as u8, (x / 2 + y / 2) as u8, (x * y / 256) as u8]);
    let mut bytes = Cursor::new(Vec::new());
    let written = image::RgbImage::from_fn(TEXELS, TEXELS, texel).write_to(&mut bytes, format);
    written.map_or_else(|_| Vec::new(), |()| bytes.into_inner())
}

fn glb() -> Vec<u8> {
    let mut mesh = GlbMesh { image: Some(image(image::ImageFormat::Png)), base_color: [1.0; 4], ..GlbMesh::default() };
    for j in 0..SIDE {
        for i in 0..SIDE {
            mesh.positions.push([i as f32, height(i, j), j as f32]);
            mesh.normals.push([0.0, 1.0, 0.0]);
            mesh.uvs.push([i as f32 / 64.0, j as f32 / 64.0]);
        }
    }
    for j in 0..SIDE - 1 {
        for i in 0..SIDE - 1 {
            let a = (j * SIDE + i) as u16;
            let (b, c, d) = (a + 1, a + SIDE as u16, a + SIDE as u16 + 1);
            mesh.indices.extend([a, c, b, b, c, d]);
        }
    }
    write_glb(&mesh)
}

/// Returns the JSON of 1,365 tiles on six levels.
fn tileset() -> Vec<u8> {
    fn tile(level: u32, x: f64, y: f64) -> String {
        let half = 10_000.0 / f64::from(1u32 << level);
        let children = if level == 5 {
            String::new()
        } else {
            [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)]
                .map(|(dx, dy)| tile(level + 1, x + dx * half, y + dy * half))
                .join(",")
        };
        format!(
            r#"{{"boundingVolume":{{"box":[{x},{y},0,{half},0,0,0,{half},0,0,0,500]}},"geometricError":{},"content":{{"uri":"{level}/{x}/{y}.glb"}},"children":[{children}]}}"#,
            half / 50.0
        )
    }
    format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":1000,"root":{}}}"#, tile(0, 0.0, 0.0)).into_bytes()
}

/// A full subtree of 5.6 million tiles, as the content of the tile that stands for it.
fn subtree() -> Content {
    let set = r#"{"asset":{"version":"1.1"},"geometricError":1000,"root":{
        "boundingVolume":{"region":[0.1,0.8,0.2,0.9,0,100]},"geometricError":500,"content":{"uri":"{level}/{x}/{y}.glb"},
        "implicitTiling":{"subdivisionScheme":"QUADTREE","subtreeLevels":12,"availableLevels":12,
        "subtrees":{"uri":"{level}.{x}.{y}.subtree"}}}}"#;
    let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
    let content = |bytes: Vec<u8>, reader_data| Content {
        uri: "/set/0.0.0.subtree".into(),
        bytes,
        reader_data,
        companions: Vec::new(),
    };
    let mut subtree = Subtree::new(Scheme::Quadtree, 12, 1);
    subtree.fill();
    let root = decode_node(content(set.into(), None), &options).expect("a tileset");
    let NodeKind::PagedLod(tile) = root.kind else { panic!("a tile") };
    content(subtree.binary(), tile.reader_data)
}

fn tile_decode(criterion: &mut Criterion) {
    let plain = ReadOptions::for_root("/set/tileset.json", Limits::default());
    let sharing = |modes| ReadOptions { sharing: Some(Arc::new(SharedStateManager::new(modes))), ..plain.clone() };
    let stride = SIDE + 2;
    let heights = (0..stride * stride).map(|k| height(k % stride, k / stride)).collect();
    let exr = write_height_exr("tile", stride, heights).unwrap_or_default();
    let data: Arc<str> = r#"{"region":[0.1,0.8,0.11,0.81],"side":65,"border":1,"level":1,"errors_m":[1.0,2.0],"imagery":"/set/tile.jpg"}"#.into();
    let imagery: Fetched = ("/set/tile.jpg".into(), Ok(image(image::ImageFormat::Jpeg)));
    let content =
        |bytes: Vec<u8>| Content { uri: "/set/tile".into(), bytes, reader_data: None, companions: Vec::new() };
    let cases = [
        (
            "65x65 heights (EXR) and a 256x256 JPEG",
            Content { reader_data: Some(data.into()), companions: vec![imagery], ..content(exr) },
        ),
        ("65x65 vertices (glb) and a 256x256 PNG", content(glb())),
        ("tileset.json of 1,365 tiles", content(tileset())),
        ("subtree of 12 levels, 1.4 MB: its first page", subtree()),
    ];
    let mut group = criterion.benchmark_group("tile_decode");
    for (name, content) in cases {
        group.throughput(Throughput::Bytes(content.bytes.len() as u64));
        let mut bench = |name: String, options: &ReadOptions| {
            group.bench_function(name, |b| {
                b.iter_batched(
                    || content.clone(),
                    |content| {
                        let page = decode(black_box(content), options);
                        assert!(page.is_ok(), "decoding failed");
                        black_box(page)
                    },
                    criterion::BatchSize::PerIteration,
                );
            });
        };
        bench(name.to_owned(), &plain);
        // Each page is dropped before the next is decoded, which measures the search for equal contents if there are
        // none.
        bench(format!("{name}, without equal contents"), &sharing(ShareModes::default()));
        let options = sharing(ShareModes::default());
        let kept = decode(content.clone(), &options);
        bench(format!("{name}, shared"), &options);
        drop(kept);
    }
    group.finish();
}

criterion_group!(benches, tile_decode);
criterion_main!(benches);
