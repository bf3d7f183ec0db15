//! CESIUM_primitive_outline: edges of a primitive's triangles that are drawn as black lines.
//!
//! The lines are a separate drawable. The triangles are drawn a little farther from the eye than they are, since lines and
//! triangles of one edge would otherwise hide each other at random.

use std::sync::{Arc, LazyLock};

use gltf::Accessor;
use serde_json::Value;

use super::primitive::PrimitiveData;
use crate::fetch::IoError;
use crate::formats::gltf::accessors::{IndexLists, list_key_of};
use crate::formats::gltf::context::Context;
use crate::formats::subset::Subset;
use crate::scene::{ContentKey, Drawable, Geometry, Material, Mesh, Node, SharedParts, Topology};
use crate::state::{Attribute, PolygonOffset, StateSet};

const EXTENSION: &str = "CESIUM_primitive_outline";
/// At the middle of a pixel of a line, a triangle may be nearer than its edge by half of the slope across the line. At the
/// samples of a multisampled pixel it may be nearer by 0.7 of the slope. A larger factor would show more of hidden edges
/// where they meet visible ones. The units cover rounding.
const OFFSET: PolygonOffset = PolygonOffset { factor: 1.0, units: 16.0 };
/// CesiumJS's default.
const BLACK: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// Returns the state set of all triangles with outlines. It is one object, since state sets are shared by identity.
fn behind_outline() -> Arc<StateSet> {
    static SET: LazyLock<Arc<StateSet>> = LazyLock::new(|| {
        let set = StateSet { name: "triangles with an outline".to_owned(), ..StateSet::default() };
        Arc::new(set.with(Attribute::PolygonOffset(OFFSET)))
    });
    SET.clone()
}

/// The drawables of a mesh.
#[derive(Clone, Default)]
pub(in super::super) struct MeshDrawables {
    /// Outlines, and everything that has none.
    plain: Vec<Drawable>,
    /// Triangles with an outline.
    outlined: Vec<Drawable>,
}

impl MeshDrawables {
    /// Adds a primitive with its outline.
    pub(super) fn push(&mut self, drawable: Drawable, outline: Option<Drawable>) {
        let list = if outline.is_some() { &mut self.outlined } else { &mut self.plain };
        list.push(drawable);
        self.plain.extend(outline);
    }

    /// Returns the number of drawables.
    pub fn len(&self) -> usize {
        self.plain.len() + self.outlined.len()
    }

    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Drawable> {
        self.plain.iter_mut().chain(&mut self.outlined)
    }

    /// Returns the nodes that draw the mesh: one, or two if there are outlines.
    pub fn into_nodes(self) -> Vec<Node> {
        let mut nodes = vec![Node::geode(self.plain)];
        if !self.outlined.is_empty() {
            nodes.push(Node::geode(self.outlined).with_state_set(behind_outline()));
        }
        nodes
    }
}

/// Returns the outlined edges of a primitive, two vertices each; `None` if it has none. An outline that is invalid or whose
/// buffer is missing is noted.
pub(super) fn edges(
    context: &Context<'_>,
    document: &gltf::Document,
    primitive: &gltf::Primitive<'_>,
    data: &PrimitiveData<'_>,
    index_lists: &mut IndexLists<'_>,
) -> Result<Option<Arc<[u32]>>, IoError> {
    let Some(extension) = primitive.extension_value(EXTENSION) else { return Ok(None) };
    let index = extension.get("indices").and_then(Value::as_u64).and_then(|index| usize::try_from(index).ok());
    let accessor: Option<Accessor<'_>> = index.and_then(|index| document.accessors().nth(index));
    let list = accessor.map(|accessor| index_lists.get(&accessor, data.count, || data.index_elements(&accessor)));
    let kind = match list {
        Some(Ok(Some((list, _)))) if list.list.len().is_multiple_of(2) => return Ok(Some(list.list)),
        Some(Err(error)) if error.is_transient() => return Err(error),
        Some(Ok(None)) => "glTF: outline that is not drawn because its buffer is missing",
        _ => "glTF: invalid outline",
    };
    context.notes.add(kind);
    Ok(None)
}

/// Returns the lines along edges of a triangle mesh. They show the features of the triangles.
pub(super) fn lines(context: &Context<'_>, edges: &[u32], triangles: &Drawable) -> Result<Option<Drawable>, IoError> {
    let Geometry::Mesh(of) = &triangles.geometry else { return Ok(None) };
    if of.topology != Topology::Triangles {
        context.notes.add("glTF: outline of a primitive without triangles");
        return Ok(None);
    }
    if edges.is_empty() {
        return Ok(None);
    }
    context.budget.add_primitives(1)?;
    context.budget.add_vertices(of.vertices.len().min(edges.len()))?;
    let subset = Subset::lines(of, edges);
    let mut mesh: Arc<Mesh> = Arc::new(subset.mesh(|_, _| ()));
    let (geometry, indices) = match context.options.sharing.as_deref() {
        Some(sharing) => {
            let vertices_key = ContentKey::of_vertices(&mesh.vertices, &mesh.attributes);
            let list_key = list_key_of(&mesh.indices);
            sharing.mesh(&mut mesh, &vertices_key, &list_key)
        }
        None => (None, None),
    };
    let mut lines =
        Drawable::new(Geometry::Mesh(mesh), Material { base_color: BLACK, unlit: true, ..Material::default() });
    lines.features = triangles.features.as_ref().map(|features| Arc::new(subset.features(features)));
    lines.shared = SharedParts { geometry, indices, ..SharedParts::default() };
    Ok(Some(lines))
}
