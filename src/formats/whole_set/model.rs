//! Summary of a single content, for `terrane info` of a model instead of a tile set.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use serde::Serialize;

use super::info::{BoundsInfo, Info};
use super::tree::read_companions;
use crate::fetch::markup::text_and_first_byte;
use crate::fetch::{IoError, Source, encoding};
use crate::formats::height;
use crate::formats::options::{Content, ReadOptions};
use crate::formats::osg;
use crate::formats::read::decode_node;
use crate::formats::terrain;
use crate::scene::{Drawable, Geometry, Node, NodeKind, Page, ReaderData, Topology};

/// Counts of a single content. A mesh that several nodes draw counts once for each of them.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ModelInfo {
    /// Number of nodes, those of parts in the file included.
    pub nodes: u64,
    /// Number of drawables.
    pub drawables: u64,
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Number of Gaussian splats.
    pub splats: u64,
    /// The highest degree of spherical harmonics of splats.
    pub splat_harmonics: u8,
    /// Number of images, equal ones counted once.
    pub images: u64,
    /// Bytes of the decoded images with their mip levels.
    pub image_bytes: u64,
    /// Number of references to other files that are paged: of PagedLODs and ProxyNodes.
    pub paged_files: u64,
}

/// Reads a content that is no tileset.
pub(super) fn inspect_model(
    uri: &Arc<str>,
    bytes: Vec<u8>,
    options: &ReadOptions,
    from: &Source,
) -> Result<Info, IoError> {
    let bytes = encoding::gunzip(uri, bytes, &options.limits)?;
    let mut info = Info { format: format_name(uri, &bytes, options), contents: 1, ..Info::default() };
    info.bytes = bytes.len() as u64;
    if osg::is_metadata(&bytes)
        && let Some((srs, [x, y, z])) = osg::reference_system(&bytes)
    {
        info.describe("srs", if srs.is_empty() { "none (its own frame)".to_owned() } else { srs });
        info.describe("origin", format!("{x}, {y}, {z}"));
    }
    let mut options = options.clone();
    let companions = read_companions(from, uri, &bytes, None, &mut options, &mut info.bytes);
    let node = decode_node(Content { uri: uri.clone(), bytes, reader_data: None, companions }, &options)?;
    let mut model = ModelInfo::default();
    model.add(&node, &options, &mut HashSet::new());
    let page = Page::from_node(node).map_err(|e| IoError::invalid(uri, e.to_string()))?;
    let sphere = page.bounding_sphere();
    info.bounds = BoundsInfo { center: sphere.center.to_array(), radius_m: sphere.radius_m, region: None };
    info.model = Some(model);
    let ignored = options.ignored.snapshot();
    info.ignored = ignored.iter().map(|(kind, count)| (kind.to_owned(), count)).collect::<BTreeMap<_, _>>();
    Ok(info)
}

impl ModelInfo {
    fn add(&mut self, node: &Node, options: &ReadOptions, images: &mut HashSet<usize>) {
        self.nodes += 1;
        match &node.kind {
            NodeKind::Geode(drawables) => drawables.iter().for_each(|drawable| self.add_drawable(drawable, images)),
            NodeKind::ProxyNode(_) => self.paged_files += 1,
            NodeKind::PagedLod(tile) => match (&tile.content, &tile.reader_data) {
                // A part of the file itself.
                (Some(uri), Some(data)) if data.is_whole_content() => self.add_part(uri, data, options),
                (Some(_), _) => self.paged_files += 1,
                (None, _) => {}
            },
            _ => {}
        }
        node.children.iter().for_each(|child| self.add(child, options, images));
    }

    fn add_drawable(&mut self, drawable: &Drawable, images: &mut HashSet<usize>) {
        self.drawables += 1;
        if let Geometry::Mesh(mesh) = &drawable.geometry {
            self.vertices += mesh.vertices.len() as u64;
            let is_triangles = mesh.topology == Topology::Triangles;
            self.triangles += if is_triangles { mesh.indices.len() as u64 / 3 } else { 0 };
        }
        if let Geometry::Splats(splats) = &drawable.geometry {
            self.splats += splats.list().len() as u64;
            self.splat_harmonics = self.splat_harmonics.max(splats.harmonics().degree());
        }
        let maps = drawable.material.metallic_roughness.iter().flat_map(|surface| surface.maps()).flatten();
        for texture in drawable.material.texture.iter().chain(maps) {
            if images.insert(Arc::as_ptr(texture).addr()) {
                self.images += 1;
                self.image_bytes += texture.size_bytes();
            }
        }
    }

    /// Adds a content in memory. One that is refused is listed by the verification.
    fn add_part(&mut self, uri: &Arc<str>, data: &ReaderData, options: &ReadOptions) {
        let (uri, reader_data) = (uri.clone(), Some(data.clone()));
        let content = Content { uri, bytes: Vec::new(), reader_data, companions: Vec::new() };
        match decode_node(content, options) {
            // Its images are decoded anew, so that addresses of others say nothing.
            Ok(node) => self.add(&node, options, &mut HashSet::new()),
            Err(_) => self.paged_files += 1,
        }
    }
}

/// Returns the name of a format, by its magic bytes or, for a format without them, by its name.
fn format_name(uri: &str, bytes: &[u8], options: &ReadOptions) -> String {
    if osg::is_native(bytes) {
        return osg::format_name(bytes, options);
    }
    let name = match bytes.get(..4) {
        Some(b"glTF") => "glTF (glb)",
        Some(b"b3dm") => "3D Tiles content (b3dm)",
        Some(b"i3dm") => "3D Tiles content (i3dm)",
        Some(b"cmpt") => "3D Tiles content (cmpt)",
        Some(b"pnts") => "3D Tiles content (pnts)",
        Some(&[0x76, 0x2f, 0x31, 0x01]) => "height tile (EXR)",
        Some(bytes) if bytes == height::PACKED_MAGIC => "height tile (packed)",
        _ if osg::is_metadata(bytes) => "oblique photogrammetry (metadata.xml)",
        _ if text_and_first_byte(bytes).1 == Some(b'{') => "glTF (JSON)",
        _ if terrain::is_tile_name(uri) => "quantized-mesh tile",
        _ => "unknown",
    };
    name.to_owned()
}
