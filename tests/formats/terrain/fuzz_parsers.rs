//! Fuzzed parsers of terrain services: layer.json, tiles, and the metadata in tiles. They are run like those of
//! `tests/formats/fuzz_parsers.rs`, by tests and by `tools/fuzz`.

use kit::fuzz::Parser;
use kit::quantized::{TerrainTile, layer_json, ranges};
use terrane::fetch::{DECODER_PANICKED, Limits};
use terrane::formats::{Content, ReadOptions, decode, decode_node, dependencies};
use terrane::scene::{Node, NodeKind, ReaderData};

fn options() -> ReadOptions {
    ReadOptions::for_root("/set/layer.json", Limits { max_file_bytes: 8 << 20, ..Limits::default() })
}

fn tile_bytes() -> Vec<u8> {
    let metadata = format!(r#"{{"available":{}}}"#, ranges(1, 3, |[level, x, _]| x >> level == 0));
    let (water, metadata) = (Some(vec![0; 65536]), Some(metadata));
    TerrainTile { cells: 3, has_normals: true, water, metadata, ..TerrainTile::new([0, 0, 0], |x, y| 99.0 * x * y) }
        .bytes()
}

/// Tiles under the name of a terrain file, without a set.
fn terrain_tile() -> Parser {
    let small = TerrainTile { cells: 2, ..TerrainTile::new([9, 5, 6], |x, y| x + y) }.bytes();
    Parser::new("terrain-tile", [tile_bytes(), small], |bytes| {
        read("/set/9/5/6.terrain", bytes, None);
    })
}

/// The tree of a service: layer.json is changed, or the tile that names those below it.
fn terrain_set() -> Parser {
    let members = format!(r#""minzoom":0,"maxzoom":3,"parentUrl":"base","available":{}"#, ranges(0, 3, |_| true));
    let named = layer_json(r#""metadataAvailability":2,"extensions":["metadata"],"attribution":"(c)""#);
    let seeds = [layer_json(&members).into_bytes(), named.clone().into_bytes(), tile_bytes()];
    Parser::new("terrain-set", seeds, move |bytes| {
        dependencies("/set/layer.json", bytes, None, &[], &options());
        let root = read("/set/layer.json", bytes, None).or_else(|| read("/set/layer.json", named.as_bytes(), None));
        // Pages are made to the end of one branch. Each file is the input.
        let mut next = root.as_ref().and_then(first_page);
        for _ in 0..12 {
            let Some(page) = next else { break };
            let file = if page.is_whole_content() { &[] } else { bytes };
            next = read("/set/0/0/0.terrain", file, Some(page)).as_ref().and_then(first_page);
        }
    })
}

fn read(uri: &str, bytes: &[u8], reader_data: Option<ReaderData>) -> Option<Node> {
    let options = options();
    let content =
        || Content { uri: uri.into(), bytes: bytes.to_vec(), reader_data: reader_data.clone(), companions: Vec::new() };
    match decode(content(), &options) {
        Ok(page) => assert!(page.size_bytes() < 1 << 28),
        Err(error) => assert!(
            !error.uri().is_empty() && !error.reason().is_empty() && error.reason() != DECODER_PANICKED,
            "{error:?}"
        ),
    }
    decode_node(content(), &options).ok()
}

/// Returns the first page that hangs below a node.
fn first_page(node: &Node) -> Option<ReaderData> {
    let own = match &node.kind {
        NodeKind::PagedLod(tile) => tile.reader_data.clone().filter(ReaderData::continues_tileset),
        _ => None,
    };
    own.or_else(|| node.children.iter().find_map(first_page))
}

kit::parsers! {
    terrain_set,
    terrain_tile,
}
