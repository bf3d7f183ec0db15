//! Applies a style to the drawables of a content. Decode threads.
//!
//! Triangles, lines and points of features that are hidden are removed. Colours become colours of vertices, so that a mesh
//! of many features stays one drawable, or two if some of its features are transparent. Where all features of a drawable
//! have one colour, as those of an instance, its material gets the colour, so that instances still share their mesh.

use std::collections::HashMap;
use std::sync::Arc;

use glam::DAffine3;

use super::looks::{FeatureColumn, Looks};
use super::style::Style;
use crate::fetch::about_to_allocate;
use crate::formats::ignored::Notes;
use crate::formats::subset::Subset;
use crate::scene::{
    AlphaMode, Drawable, DrawableFeatures, FeatureIdSet, FeatureIds, Geometry, Material, Mesh, MeshVertex, Node,
    NodeKind, Topology,
};

/// The kind of object that a style is applied to.
#[derive(Clone, Copy)]
pub(in crate::formats) struct Styled {
    pub set_from_content: DAffine3,
    /// False if features are removed afterwards.
    pub keeps_features: bool,
    /// See [`Limits::max_elements`](crate::fetch::Limits::max_elements).
    pub max_elements: usize,
}

/// Applies a style to all drawables below the root node of a content.
pub(in crate::formats) fn apply(node: &mut Node, style: &Style, to: Styled, notes: &Notes) {
    style.note_ignored(notes);
    Styler { style, to, notes, known: HashMap::new() }.node(node, to.set_from_content);
}

/// The addresses of a mesh and of its features, and whether its material ignores alpha.
type MeshKey = (usize, usize, bool);

/// A drawable that a styled mesh becomes.
#[derive(Clone)]
struct Part {
    mesh: Arc<Mesh>,
    features: Option<Arc<DrawableFeatures>>,
    paint: Paint,
}

/// How a part gets the colours of its features.
#[derive(Clone, Copy)]
enum Paint {
    /// By the material: all features have this colour. `None` keeps the colour as it is.
    Material(Option<[f32; 4]>),
    /// By the vertices. Colours of points replace the colour of the material.
    Vertices { is_transparent: bool, is_replaced: bool },
}

/// A mesh that was styled. Its source is kept, so that no other mesh gets its address.
struct StyledMesh {
    _source: Drawable,
    parts: Vec<Part>,
}

struct Styler<'a> {
    style: &'a Style,
    to: Styled,
    notes: &'a Notes,
    /// Meshes that several nodes draw are styled once.
    known: HashMap<MeshKey, StyledMesh>,
}

impl Styler<'_> {
    fn node(&mut self, node: &mut Node, set_from_parent: DAffine3) {
        let mut set_from_node = set_from_parent;
        match &mut node.kind {
            NodeKind::Transform(map) => set_from_node = set_from_parent * *map,
            NodeKind::Geode(drawables) => {
                let styled = std::mem::take(drawables).into_iter();
                *drawables = styled.flat_map(|drawable| self.drawables(drawable, &set_from_parent)).collect();
            }
            _ => {}
        }
        node.children.iter_mut().for_each(|child| self.node(child, set_from_node));
    }

    /// Returns the drawables that replace a drawable.
    fn drawables(&mut self, mut drawable: Drawable, set_from_drawable: &DAffine3) -> Vec<Drawable> {
        let Geometry::Mesh(mesh) = &drawable.geometry else {
            let look = self.style.look(&Default::default());
            if let Some(color) = look.color {
                tint(&mut drawable.material, color);
            }
            return if look.is_visible() { vec![drawable] } else { Vec::new() };
        };
        let mesh = mesh.clone();
        let parts = self.parts(&mesh, &drawable, set_from_drawable).into_iter();
        let drawables = parts.map(|part| {
            let mut drawable = drawable.clone();
            if !Arc::ptr_eq(&part.mesh, &mesh) {
                // The contents of other pages differ.
                (drawable.shared.geometry, drawable.shared.indices) = (None, None);
                drawable.geometry = Geometry::Mesh(part.mesh);
            }
            drawable.features = part.features.filter(|_| self.to.keeps_features);
            part.paint.apply(&mut drawable.material);
            drawable
        });
        drawables.collect()
    }

    fn parts(&mut self, mesh: &Arc<Mesh>, drawable: &Drawable, set_from_mesh: &DAffine3) -> Vec<Part> {
        let (style, features) = (self.style, drawable.features.as_deref());
        let column = features.and_then(FeatureColumn::of);
        let is_texture = |set: &FeatureIdSet| matches!(set.ids, FeatureIds::Texture(_));
        if features.is_some_and(|features| features.sets.iter().any(is_texture)) {
            self.notes.add("style: feature ids in textures");
        }
        let has_semantics = mesh.topology == Topology::Points && style.has_semantics();
        let is_opaque = drawable.material.alpha == AlphaMode::Opaque;
        let address = features.map_or(0, |features| std::ptr::from_ref(features).addr());
        let key = (Arc::as_ptr(mesh).addr(), address, is_opaque);
        if let Some(known) = self.known.get(&key).filter(|_| !style.has_absolute_positions()) {
            return known.parts.clone();
        }
        let vertices = mesh.vertices.len();
        let looks = match column {
            _ if has_semantics => Looks::of_points(style, column, mesh, set_from_mesh),
            Some(column) if !column.is_one_feature(style) => Looks::of_features(style, column, vertices),
            Some(column) => Looks::uniform(column.look(style, column.set.id(0)), vertices),
            None => Looks::uniform(style.look(&Default::default()), vertices),
        };
        let is_large = mesh.topology == Topology::Points && looks.all().iter().any(|look| look.point_size_px() > 1.0);
        let has_squares = is_large && mesh.indices.len().saturating_mul(4) <= self.to.max_elements;
        if is_large && !has_squares {
            self.notes.add("style: pointSize of a point cloud that is too large for it");
        }
        // A copy of the mesh; a square of four vertices and six indices for each point.
        let copied = if has_squares { 4 * mesh.indices.len() } else { vertices };
        let bytes = size_of::<MeshVertex>() * copied + 2 * size_of::<u32>() * (vertices + mesh.indices.len() + copied);
        if about_to_allocate(bytes as u64).is_err() {
            // The content fails as a whole.
            return Vec::new();
        }
        let parts = styled_parts(mesh, drawable, &looks, has_squares);
        self.known.insert(key, StyledMesh { _source: drawable.clone(), parts: parts.clone() });
        parts
    }
}

/// Returns the opaque and the transparent part of a mesh, if it has them.
fn styled_parts(mesh: &Arc<Mesh>, drawable: &Drawable, looks: &Looks, has_squares: bool) -> Vec<Part> {
    let mut visible = looks.all().iter().filter(|look| look.is_visible());
    let Some(first) = visible.next() else { return Vec::new() };
    // The style replaces the colours of points unless they have batches, as in CesiumJS.
    let column = drawable.features.as_deref().and_then(FeatureColumn::of);
    let has_batches = column.is_some_and(|column| matches!(column.set.ids, FeatureIds::PerVertex(_)));
    let is_replaced = mesh.topology == Topology::Points && !has_batches;
    let is_uniform = visible.all(|look| look.color == first.color) && !(is_replaced && first.color.is_some());
    let (mut opaque, mut transparent) = (Vec::new(), Vec::new());
    for primitive in mesh.indices.chunks(indices_per_primitive(mesh.topology)) {
        // The vertices of a primitive have the same feature in valid files.
        match looks.of_vertex(primitive[0]) {
            look if !look.is_visible() => {}
            look if look.is_transparent() => transparent.extend_from_slice(primitive),
            _ => opaque.extend_from_slice(primitive),
        }
    }
    let mut parts = Vec::new();
    for (indices, is_transparent) in [(opaque, false), (transparent, true)] {
        if indices.is_empty() {
            continue;
        }
        let (mut mesh, mut features) = (mesh.clone(), drawable.features.clone());
        if indices.len() < mesh.indices.len() || !is_uniform || has_squares {
            let subset = if has_squares { Subset::squares(&mesh, &indices) } else { Subset::new(&mesh, &indices) };
            features = features.map(|features| Arc::new(subset.features(&features)));
            let is_alpha_ignored = drawable.material.alpha == AlphaMode::Opaque;
            let changed = subset.mesh(|number, vertex| {
                let look = looks.of_vertex(number);
                if let Some(color) = look.color.filter(|_| !is_uniform) {
                    paint(vertex, color, is_replaced, is_alpha_ignored);
                }
                if has_squares {
                    vertex.uv = vertex.uv.map(|direction| 0.5 * look.point_size_px() * direction);
                }
            });
            mesh = Arc::new(changed);
        }
        let paint = match is_uniform {
            true => Paint::Material(first.color),
            false => Paint::Vertices { is_transparent, is_replaced },
        };
        parts.push(Part { mesh, features, paint });
    }
    parts
}

fn indices_per_primitive(topology: Topology) -> usize {
    match topology {
        Topology::Squares => 6,
        Topology::Triangles => 3,
        Topology::Lines => 2,
        Topology::Points => 1,
    }
}

/// Multiplies the colour of a vertex by that of its feature, or replaces it.
fn paint(vertex: &mut MeshVertex, color: [f32; 4], is_replaced: bool, is_alpha_ignored: bool) {
    for (k, (own, factor)) in vertex.color.iter_mut().zip(color).enumerate() {
        let is_set = is_replaced || k == 3 && is_alpha_ignored;
        let own_factor = if is_set { 1.0 } else { f32::from(*own) / 255.0 };
        *own = (own_factor * factor * 255.0).round() as u8;
    }
}

/// Multiplies the colour of a material, as CesiumJS's `Cesium3DTileColorBlendMode.HIGHLIGHT`.
fn tint(material: &mut Material, [r, g, b, alpha]: [f32; 4]) {
    for (own, factor) in material.base_color.iter_mut().zip([r, g, b]) {
        *own *= factor;
    }
    if alpha < 1.0 {
        blend(material);
        material.base_color[3] *= alpha;
    }
}

/// Makes a material transparent. Its own alpha counts only if it counted before.
fn blend(material: &mut Material) {
    if material.alpha == AlphaMode::Opaque {
        material.base_color[3] = 1.0;
    }
    material.alpha = AlphaMode::Blend;
}

impl Paint {
    fn apply(self, material: &mut Material) {
        match self {
            Self::Material(None) => {}
            Self::Material(Some(color)) => tint(material, color),
            Self::Vertices { is_transparent, is_replaced } => {
                if is_replaced {
                    material.base_color[..3].fill(1.0);
                }
                if is_transparent {
                    blend(material);
                }
            }
        }
    }
}
