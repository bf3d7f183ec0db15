//! Reads real 3D Tiles without a GPU. The numbers of tiles, contents and triangles equal those of a validator. The
//! files are beside a developer's checkout; without them the test is skipped with a message.

use std::path::Path;
use std::sync::Arc;

use kit::skip::skipped;
use serde_json::Value;
use terrane::fetch::{IoError, Limits, read_file, root_uri};
use terrane::formats::{Content, ReadOptions, decode_node, dependencies, inspect};
use terrane::scene::{Geometry, Node, NodeKind, ReaderData, Topology};

#[derive(Default)]
struct Found {
    contents: u64,
    externals: u64,
    triangles: u64,
    errors: Vec<IoError>,
}

impl Found {
    fn load(&mut self, uri: &Arc<str>, reader_data: Option<ReaderData>, options: &ReadOptions) {
        let data = reader_data.as_ref();
        let continues = data.is_some_and(ReaderData::continues_tileset);
        let read = match data.is_some_and(ReaderData::is_whole_content) {
            true => Ok(Vec::new()),
            false => read_file(uri, &options.limits),
        };
        let read = read.and_then(|bytes| {
            let others = dependencies(uri, &bytes, data, &[], options).into_iter();
            let companions = others.map(|uri| (uri.clone(), read_file(&uri, &options.limits))).collect();
            decode_node(Content { uri: uri.clone(), bytes, reader_data: data.cloned(), companions }, options)
        });
        match read {
            Ok(node) if continues => self.walk(&node, options),
            Ok(node) => self.walk(&node, &options.below(uri)),
            Err(error) => self.errors.push(error),
        }
    }

    fn walk(&mut self, node: &Node, options: &ReadOptions) {
        match &node.kind {
            NodeKind::PagedLod(tile) => {
                if let Some(content) = &tile.content {
                    let continues = tile.reader_data.as_ref().is_some_and(ReaderData::continues_tileset);
                    self.contents += u64::from(!continues);
                    self.load(content, tile.reader_data.clone(), options);
                }
            }
            NodeKind::ProxyNode(proxy) => {
                self.externals += 1;
                self.load(&proxy.uri, None, options);
            }
            NodeKind::Geode(drawables) => {
                for drawable in drawables {
                    let Geometry::Mesh(mesh) = &drawable.geometry else { continue };
                    if mesh.topology == Topology::Triangles {
                        self.triangles += mesh.indices.len() as u64 / 3;
                    }
                }
            }
            _ => {}
        }
        for child in &node.children {
            self.walk(child, options);
        }
    }
}

#[test]
fn sample_tile_sets_match_the_counts_of_a_validator() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/3d-tiles");
    let Ok(text) = std::fs::read(samples.join("expected.json")) else {
        return skipped(format!("no sample tile sets at {}", samples.display()));
    };
    let expected: Value = serde_json::from_slice(&text).unwrap();
    let limits = Limits::default();
    let mut compared = 0;
    for case in expected["cases"].as_array().unwrap() {
        let file = case["file"].as_str().unwrap();
        let root = root_uri(samples.join(file).to_str().unwrap()).unwrap();
        let mut found = Found::default();
        found.load(&root, None, &ReadOptions::for_root(&root, limits));
        let reasons: Vec<String> = found.errors.iter().map(|e| format!("{}: {}", e.uri(), e.reason())).collect();
        let count = |key: &str| case["validate"][key].as_u64().unwrap();
        let info = inspect(&root, &limits).unwrap();
        // One set refers to a file that does not exist.
        let missing = found.errors.iter().filter(|e| matches!(e, IoError::NotFound { .. })).count() as u64;
        assert_eq!(reasons.len() as u64, missing, "{file}: {reasons:?}");
        assert_eq!(missing, u64::from(file.contains("DiscreteLOD")), "{file}: {reasons:?}");
        assert_eq!(info.tiles, count("tiles"), "{file}: tiles");
        assert_eq!(found.contents, info.contents, "{file}: contents");
        // The validator counts an external tileset as a content, and ignores a missing file.
        assert_eq!(found.contents + found.externals - missing, count("contents"), "{file}: contents");
        // The validator counts a mesh once, whatever its instances.
        let instances = if file.contains("GpuInstances") { 10 } else { 1 };
        assert_eq!(found.triangles, instances * count("tri"), "{file}: triangles");
        compared += 1;
    }
    assert!(compared >= 17, "{compared} tile sets were compared");
}
