//! [`ModelInfo`]: the counts of a single content, for `terrane info` of a model instead of a tile set.

use std::collections::HashSet;
use std::sync::Arc;

use serde::Serialize;

use crate::formats::options::{Content, ReadOptions};
use crate::formats::read::decode_node;
use crate::scene::{Drawable, Geometry, Node, NodeKind, ReaderData, Topology};

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

impl ModelInfo {
    /// Counts what is in a node and below it.
    pub(super) fn of(node: &Node, options: &ReadOptions) -> Self {
        let mut model = Self::default();
        model.add(node, options, &mut HashSet::new());
        model
    }

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
