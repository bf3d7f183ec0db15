//! OpenSceneGraph's own files and folders of oblique photogrammetry, written by the tests themselves; and the files of OSG's
//! writers where they are present.

mod bad_input;
mod dot_osg;
mod facing;
mod folders;
mod fuzz_parsers;
mod geometry;
mod ive;
mod libraries;
mod nodes;
mod samples;
mod states;
mod terrain;
mod units;

use terrane::fetch::{IoError, Limits};
use terrane::formats::{Content, Fetched, Ignored, ReadOptions, decode_noting};
use terrane::scene::{Drawable, Mesh, Node, NodeKind, PagedLod};

const URI: &str = "/set/a.osgb";

fn options() -> ReadOptions {
    ReadOptions::for_root(URI, Limits::default())
}

fn read_with(bytes: &[u8], companions: Vec<Fetched>, options: &ReadOptions) -> Result<(Node, Ignored), IoError> {
    decode_noting(Content { uri: URI.into(), bytes: bytes.to_vec(), reader_data: None, companions }, options)
}

fn read(bytes: impl AsRef<[u8]>) -> (Node, Ignored) {
    read_with(bytes.as_ref(), Vec::new(), &options()).unwrap_or_else(|error| panic!("{error}"))
}

/// The drawables of a graph in order, those of tiles left out.
fn drawables(node: &Node) -> Vec<&Drawable> {
    let mut all = Vec::new();
    if let NodeKind::Geode(own) = &node.kind {
        all.extend(own);
    }
    all.extend(node.children.iter().flat_map(drawables));
    all
}

fn mesh(drawable: &Drawable) -> &Mesh {
    let terrane::scene::Geometry::Mesh(mesh) = &drawable.geometry else { panic!("a mesh") };
    mesh
}

/// The tiles of a graph in order.
fn tiles(node: &Node) -> Vec<&PagedLod> {
    let mut all = Vec::new();
    if let NodeKind::PagedLod(tile) = &node.kind {
        all.push(&**tile);
    }
    all.extend(node.children.iter().flat_map(tiles));
    all
}

/// Reads the content of a tile that is in memory.
fn read_part(tile: &PagedLod) -> Result<Node, IoError> {
    let (uri, reader_data) = (tile.content.clone().unwrap(), tile.reader_data.clone());
    let content = Content { uri, bytes: Vec::new(), reader_data, companions: Vec::new() };
    decode_noting(content, &options()).map(|(node, _)| node)
}
