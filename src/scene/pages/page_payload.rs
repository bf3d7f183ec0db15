//! The payload of a page: drawables until a context has uploaded them, afterwards k-d trees and draw slots.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use crate::scene::features::DrawableFeatures;
use crate::scene::geometry::{BlockFormats, Drawable, Geometry, VertexFormat};
use crate::scene::intersect::KdTree;
use crate::scene::sharing::SharedContent;
use crate::state::TextureObject;

/// An index into the drawable table of a graphics context.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct DrawSlot(pub u32);

impl DrawSlot {
    /// The slot of a drawable that the renderer skips, because it is not uploaded or its upload failed.
    pub const NONE: Self = Self(u32::MAX);
}

/// A shared content that a page uses.
#[derive(Debug)]
pub(crate) struct SharedUse {
    pub content: Arc<SharedContent>,
    /// The size of its k-d tree; 0 if the page has none.
    pub tree_bytes: u64,
    /// The size on the GPU of a texture of state sets; 0 for others, whose sizes contexts report.
    pub texture_bytes: u64,
}

/// Payloads in drawable order, and what is kept of them.
#[derive(Debug, Default)]
pub(crate) struct PagePayload {
    /// Empty once the payloads were taken.
    drawables: Vec<Drawable>,
    drawable_bytes: u64,
    /// The families of compressed formats that the textures of appended drawables need.
    block_formats: BlockFormats,
    /// The addresses of shapes and images that are counted in `drawable_bytes` and may be shared by further drawables.
    counted: HashSet<usize>,
    /// The features of drawables that have some, by index. They stay when the payloads are taken.
    features: Vec<(u32, Arc<DrawableFeatures>)>,
    /// K-d trees by drawable; empty if none were built.
    kd_trees: Vec<Option<Arc<KdTree>>>,
    /// Contents shared with other pages, each listed once.
    shared: Vec<SharedUse>,
    /// The part of the k-d trees' bytes that is shared.
    shared_tree_bytes: u64,
    /// The drawables' slots by context.
    draw_slots: Vec<(u32, Vec<DrawSlot>)>,
}

impl PagePayload {
    /// Appends a drawable.
    pub(super) fn push(&mut self, drawable: Drawable) {
        self.drawable_bytes += drawable.size_bytes_beside(&mut self.counted);
        self.block_formats = self.block_formats.union(drawable.block_formats());
        if let Some(features) = &drawable.features {
            self.features.push((self.drawables.len() as u32, features.clone()));
        }
        self.drawables.push(drawable);
    }

    /// Returns the drawables that were not taken.
    pub fn drawables(&self) -> &[Drawable] {
        &self.drawables
    }

    /// Returns the families of compressed formats that the textures of the drawables needed when they were appended.
    pub fn block_formats(&self) -> BlockFormats {
        self.block_formats
    }

    /// Returns the features of a drawable, whether it was taken or not.
    pub fn features(&self, drawable: u32) -> Option<&Arc<DrawableFeatures>> {
        let at = self.features.binary_search_by_key(&drawable, |(drawable, _)| *drawable).ok()?;
        self.features.get(at).map(|(_, features)| features)
    }

    /// Returns a drawable that was not taken, to be changed.
    pub fn drawable_mut(&mut self, drawable: u32) -> Option<&mut Drawable> {
        self.drawables.get_mut(drawable as usize)
    }

    /// Takes all drawables.
    pub fn take(&mut self) -> Vec<Drawable> {
        self.drawable_bytes = 0;
        self.counted = HashSet::new();
        std::mem::take(&mut self.drawables)
    }

    /// Puts back all drawables that were taken.
    pub fn put(&mut self, drawables: Vec<Drawable>) {
        let mut counted = HashSet::new();
        self.drawable_bytes = drawables.iter().map(|drawable| drawable.size_bytes_beside(&mut counted)).sum();
        self.counted = counted;
        self.drawables = drawables;
    }

    /// Changes the drawables and their trees to shared ones; the memory counted for the drawables stays as it was.
    pub fn share(&mut self, mut share: impl FnMut(&mut Drawable, Option<&mut Option<Arc<KdTree>>>)) {
        let mut trees = self.kd_trees.iter_mut();
        for drawable in &mut self.drawables {
            share(drawable, trees.next());
        }
        self.hold_shared();
    }

    /// Stores the vertex format of each drawable.
    pub fn find_vertex_formats(&mut self) {
        // Instances of one mesh share its format.
        let mut found: HashMap<usize, VertexFormat> = HashMap::new();
        for drawable in &mut self.drawables {
            if let Geometry::Mesh(mesh) = &drawable.geometry {
                let mesh = Arc::as_ptr(mesh).addr();
                let format = *found.entry(mesh).or_insert_with(|| drawable.vertex_format());
                drawable.set_vertex_format(format);
            }
        }
    }

    /// Builds a k-d tree for each drawable, or takes the one of the shared content.
    pub fn build_kd_trees(&mut self) {
        // Instances of one mesh share its tree.
        let mut built: HashMap<usize, Option<Arc<KdTree>>> = HashMap::new();
        let tree = |d: &Drawable| match (&d.shared.geometry, &d.geometry) {
            (Some(shared), geometry) => shared.tree(geometry),
            (None, Geometry::Mesh(mesh)) if Arc::strong_count(mesh) > 1 => {
                let build = || KdTree::build(&d.geometry).map(Arc::new);
                built.entry(Arc::as_ptr(mesh).addr()).or_insert_with(build).clone()
            }
            (None, geometry) => KdTree::build(geometry).map(Arc::new),
        };
        self.kd_trees = self.drawables.iter().map(tree).collect();
        self.hold_shared();
    }

    /// Returns the k-d tree of a drawable, if one was built.
    pub fn kd_tree(&self, drawable: u32) -> Option<&Arc<KdTree>> {
        self.kd_trees.get(drawable as usize)?.as_ref()
    }

    /// Replaces the k-d tree of a drawable, if trees were built at all.
    pub fn rebuild_kd_tree(&mut self, drawable: u32, build: impl FnOnce() -> Option<Arc<KdTree>>) {
        if let Some(tree) = self.kd_trees.get_mut(drawable as usize) {
            *tree = build();
        }
    }

    /// Takes references to the shared contents of the drawables, so that they stay shared when the payloads are taken.
    pub fn hold_shared(&mut self) {
        let mut uses: Vec<SharedUse> = Vec::new();
        self.shared_tree_bytes = 0;
        for (i, drawable) in self.drawables.iter().enumerate() {
            for content in drawable.shared.iter() {
                let is_geometry = drawable.shared.geometry.as_ref().is_some_and(|g| Arc::ptr_eq(g, content));
                let tree = self.kd_trees.get(i).and_then(Option::as_ref).filter(|_| is_geometry);
                let tree_bytes = tree.map_or(0, |t| t.size_bytes());
                self.shared_tree_bytes += tree_bytes;
                uses.push(SharedUse { content: content.clone(), tree_bytes, texture_bytes: 0 });
            }
        }
        uses.sort_by_key(|u| Arc::as_ptr(&u.content));
        uses.dedup_by(|a, b| Arc::ptr_eq(&a.content, &b.content));
        uses.shrink_to_fit();
        self.shared = uses;
    }

    /// Adds textures of state sets to the shared contents.
    pub fn hold_textures<'a>(&mut self, textures: impl Iterator<Item = &'a Arc<TextureObject>>) {
        let mut met = HashSet::new();
        for texture in textures.filter(|texture| texture.is_uploaded_once()) {
            if met.insert(Arc::as_ptr(texture)) {
                let (content, texture_bytes) = (SharedContent::of_texture(texture), texture.size_bytes());
                self.shared.push(SharedUse { content, tree_bytes: 0, texture_bytes });
            }
        }
    }

    /// Returns the contents shared with other pages, each once.
    pub fn shared(&self) -> &[SharedUse] {
        &self.shared
    }

    /// Returns the part of [`Self::size_bytes`] that other pages share.
    pub fn shared_tree_bytes(&self) -> u64 {
        self.shared_tree_bytes
    }

    /// Returns the draw slots of every context that has uploaded the page.
    pub fn draw_slots(&self) -> &[(u32, Vec<DrawSlot>)] {
        &self.draw_slots
    }

    /// Sets the draw slots of a context, in drawable order.
    pub fn set_draw_slots(&mut self, context: u32, slots: Vec<DrawSlot>) {
        match self.draw_slots.iter_mut().find(|(c, _)| *c == context) {
            Some(entry) => entry.1 = slots,
            None => self.draw_slots.push((context, slots)),
        }
    }

    /// Takes the draw slots of every context, to be released.
    pub fn take_draw_slots(&mut self) -> Vec<(u32, Vec<DrawSlot>)> {
        std::mem::take(&mut self.draw_slots)
    }

    /// Drops the draw slots of a context that no longer exists.
    pub fn forget_context(&mut self, context: u32) {
        self.draw_slots.retain(|(c, _)| *c != context);
    }

    /// Returns the bytes of CPU memory of drawables, trees and slots.
    pub fn size_bytes(&self) -> u64 {
        let slots: usize = self.draw_slots.iter().map(|(_, slots)| slots.len() * 4).sum();
        let mut counted = HashSet::new();
        let is_new = |tree: &&Arc<KdTree>| counted.insert(Arc::as_ptr(tree).addr());
        let trees = self.kd_trees.iter().flatten().filter(is_new).map(|tree| tree.size_bytes()).sum::<u64>();
        self.drawable_bytes + slots as u64 + trees + self.feature_bytes()
    }

    /// Returns the bytes of the features, each table, image and list of ids once.
    fn feature_bytes(&self) -> u64 {
        let mut counted = HashSet::new();
        self.features.iter().map(|(_, features)| features.size_bytes_beside(&mut counted)).sum()
    }
}
