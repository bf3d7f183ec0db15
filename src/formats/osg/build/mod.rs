//! Makes nodes of the engine of the objects of a file.
//!
//! State sets stay state sets. What a drawable's material says is resolved here from the state sets above the drawable in
//! its file: texture of unit 0, diffuse colour, lighting, blending, alpha test and culling of faces. So the quick shaders
//! draw it, and images are shared and paged as those of other formats. Decode threads.

mod bounds;
mod facing;
mod looks;
mod meshes;
mod paging;
mod shapes;
mod sizes;
mod states;
mod textures;

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use self::looks::Look;
pub(in crate::formats) use self::paging::InlinePart;
pub(super) use self::paging::{HeldFile, escaped};
pub(super) use self::textures::external_images;
use super::error::OsgError;
use super::objects::{DrawableClass, DrawableObject, NodeClass, NodeObject, Object, StateObject};
use crate::fetch::IoError;
use crate::formats::ignored::Notes;
use crate::formats::options::{Fetched, ReadOptions};
use crate::math::BoundingSphere;
use crate::scene::{Drawable, Material, Mesh, Node, NodeKind, Topology};
use crate::state::StateSet;

/// A file may have one node for this number of [`Limits::max_elements`](crate::fetch::Limits). A shared node counts at each
/// place.
const ELEMENTS_PER_NODE: usize = 16;

/// The file that nodes are made of, and the options of its reading.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub uri: &'a Arc<str>,
    /// The address that references are relative to.
    pub base: &'a str,
    /// The images that the file refers to.
    pub companions: &'a [Fetched],
    pub options: &'a ReadOptions,
    pub notes: &'a Notes,
}

/// Meshes of a drawable, relative to an origin in the drawable's frame.
#[derive(Clone)]
struct Meshes {
    origin: DVec3,
    meshes: Vec<(Arc<Mesh>, bool)>,
}

/// Makes the nodes of one file. One thread.
struct Builder<'a> {
    source: Source<'a>,
    /// By address: objects that the file shares stay shared.
    sets: HashMap<usize, Option<Arc<StateSet>>>,
    textures: HashMap<usize, Option<textures::BuiltTexture>>,
    meshes: HashMap<(usize, bool, bool), Meshes>,
    alpha_tests: HashMap<(u32, u32), Arc<StateSet>>,
    spheres: HashMap<usize, BoundingSphere>,
    sizes: HashMap<usize, sizes::Size>,
    /// The state sets above the current object, outermost first.
    states: Vec<Arc<StateObject>>,
    /// The copy of the file's context that parts share, once there is one.
    shared_file: Option<Arc<paging::PartFile>>,
    /// The name of the part that is made; empty for the file itself.
    part: String,
    parts: usize,
    nodes: usize,
    vertices: usize,
    indices: usize,
    image_bytes: u64,
    has_drawables: bool,
    /// The reason why the first drawable was left out.
    first_error: Option<OsgError>,
}

/// Makes the node of a file's root object.
pub(super) fn node_of_file(root: &Object, source: Source<'_>) -> Result<Node, IoError> {
    if !matches!(root, Object::Node(_) | Object::Drawable(_)) {
        let error = OsgError::Unsupported("a file without a node that is read".to_owned());
        return Err(error.at(source.uri));
    }
    let mut builder = Builder::new(source);
    let node = builder.node(root)?;
    builder.finish(node)
}

/// Returns a sphere around the root object of a file, as its PagedLODs declare it; empty if it is unknown.
pub(super) fn sphere_of_file(root: &Object) -> BoundingSphere {
    bounds::sphere(root, &mut HashMap::new())
}

impl<'a> Builder<'a> {
    fn new(source: Source<'a>) -> Self {
        Self {
            source,
            sets: HashMap::new(),
            textures: HashMap::new(),
            meshes: HashMap::new(),
            alpha_tests: HashMap::new(),
            spheres: HashMap::new(),
            sizes: HashMap::new(),
            states: Vec::new(),
            shared_file: None,
            part: String::new(),
            parts: 0,
            nodes: 0,
            vertices: 0,
            indices: 0,
            image_bytes: 0,
            has_drawables: false,
            first_error: None,
        }
    }

    /// Returns the node, or the error of the first drawable if none could be made.
    fn finish(self, node: Node) -> Result<Node, IoError> {
        match self.first_error {
            Some(error) if !self.has_drawables => Err(error.at(self.source.uri)),
            _ => Ok(node),
        }
    }

    fn note(&self, kind: impl Into<std::borrow::Cow<'static, str>>) {
        self.source.notes.add(kind);
    }

    /// Adds to a counter, and fails beyond its limit.
    fn count(&self, counter: usize, more: usize, what: &'static str, limit: usize) -> Result<usize, IoError> {
        let got = counter.saturating_add(more);
        match got <= limit {
            true => Ok(got),
            false => {
                let (got, limit) = (got as u64, limit as u64);
                Err(IoError::TooLarge { uri: self.source.uri.to_string(), what, got, limit })
            }
        }
    }

    /// Counts nodes of the file, those of its parts included.
    fn count_nodes(&mut self, more: usize) -> Result<(), IoError> {
        let limit = self.source.options.limits.max_elements / ELEMENTS_PER_NODE;
        self.nodes = self.count(self.nodes, more, "nodes of an OpenSceneGraph file", limit)?;
        Ok(())
    }

    /// Makes the node of an object; an empty group of one that is not drawn.
    fn node(&mut self, object: &Object) -> Result<Node, IoError> {
        self.count_nodes(1)?;
        match object {
            Object::Node(node) => self.node_of(node),
            Object::Drawable(drawable) => self.geode(drawable),
            _ => Ok(Node::group(Vec::new())),
        }
    }

    fn node_of(&mut self, object: &Arc<NodeObject>) -> Result<Node, IoError> {
        let state_set = object.state.as_ref().and_then(|state| self.state_set(state));
        let depth = self.states.len();
        self.states.extend(object.state.clone());
        let node = self.node_of_class(object);
        self.states.truncate(depth);
        let mut node = node?;
        if !object.name.is_empty() {
            node.name.clone_from(&object.name);
        }
        (node.mask, node.culling_active, node.state_set) = (object.mask, object.culling_active, state_set);
        Ok(node)
    }

    fn node_of_class(&mut self, object: &Arc<NodeObject>) -> Result<Node, IoError> {
        let kind = match &object.class {
            NodeClass::Group => NodeKind::Group,
            NodeClass::Transform { parent_from_child: Some(map), is_absolute: false } if *map == DAffine3::IDENTITY => {
                NodeKind::Group
            }
            NodeClass::Transform { parent_from_child, is_absolute } => {
                let map = parent_from_child.unwrap_or(DAffine3::IDENTITY);
                if *is_absolute { NodeKind::AbsoluteTransform(map) } else { NodeKind::Transform(map) }
            }
            NodeClass::Switch(shown) => NodeKind::Switch(shown.clone()),
            NodeClass::Lod(lod) => return self.lod(object, lod),
            NodeClass::PagedLod(lod, paged) => return self.paged_lod(object, lod, paged),
            NodeClass::Proxy(proxy) => return self.proxy(object, proxy),
            NodeClass::Billboard(billboard) => return self.billboard(object, billboard),
            NodeClass::AutoTransform(auto) => return self.auto_transform(object, auto),
        };
        Ok(Node { children: self.children(&object.children)?, ..Node::new(kind) })
    }

    /// Makes one node of each object.
    fn children(&mut self, objects: &[Object]) -> Result<Vec<Node>, IoError> {
        objects.iter().map(|child| self.node(child)).collect()
    }

    /// Makes the node of a drawable.
    fn geode(&mut self, object: &Arc<DrawableObject>) -> Result<Node, IoError> {
        let state_set = object.state.as_ref().and_then(|state| self.state_set(state));
        let depth = self.states.len();
        self.states.extend(object.state.clone());
        let made = self.drawables(object);
        self.states.truncate(depth);
        let (origin, drawables) = made?;
        self.has_drawables |= !drawables.is_empty();
        let geode = Node { name: object.name.clone(), mask: object.mask, state_set, ..Node::geode(drawables) };
        if origin == DVec3::ZERO {
            return Ok(geode);
        }
        Ok(Node::transform(DAffine3::from_translation(origin), vec![geode]))
    }

    /// Makes the drawables of a drawable: one for triangles, one for lines, and one for points.
    fn drawables(&mut self, object: &Arc<DrawableObject>) -> Result<(DVec3, Vec<Drawable>), IoError> {
        let look = Look::resolve(&self.states);
        let texture = match &look.texture {
            Some(attribute) => self.texture(attribute)?,
            None => None,
        };
        let starts_at_bottom = texture.as_ref().is_some_and(|texture| texture.starts_at_bottom);
        let Some(Meshes { origin, meshes }) = self.meshes_of(object, starts_at_bottom, look.has_vertex_colors())?
        else {
            return Ok((DVec3::ZERO, Vec::new()));
        };
        let state_set = look.alpha_test_beside_material().map(|(function, reference)| {
            let key = (function, reference.to_bits());
            self.alpha_tests.entry(key).or_insert_with(|| states::alpha_test(function, reference)).clone()
        });
        let options = self.source.options;
        let drawable = |(mesh, has_normals): (Arc<Mesh>, bool)| {
            let is_thin = mesh.topology != Topology::Triangles;
            let material = Material {
                base_color: look.base_color(),
                texture: texture.as_ref().map(|texture| texture.shared.0.clone()),
                alpha: look.alpha_mode(),
                double_sided: !look.culls_faces,
                unlit: !look.is_lit || (is_thin && !has_normals),
                metallic_roughness: None,
            };
            let mut drawable = Drawable::new(crate::scene::Geometry::Mesh(mesh), material);
            drawable.shared.texture = texture.as_ref().and_then(|texture| texture.shared.1.clone());
            drawable.state_set.clone_from(&state_set);
            if options.cluster_culling { drawable.with_cluster_culling() } else { drawable }
        };
        Ok((origin, meshes.into_iter().map(drawable).collect()))
    }

    /// Returns the meshes of a drawable; `None` if it is left out, which is noted.
    fn meshes_of(
        &mut self,
        object: &Arc<DrawableObject>,
        starts_at_bottom: bool,
        has_colors: bool,
    ) -> Result<Option<Meshes>, IoError> {
        let key = (Arc::as_ptr(object).addr(), starts_at_bottom, has_colors);
        if let Some(known) = self.meshes.get(&key) {
            return Ok(Some(known.clone()));
        }
        let made = match &object.class {
            DrawableClass::Geometry(geometry) => self.geometry(geometry, starts_at_bottom, has_colors),
            DrawableClass::Shape { shape: Some(shape), color } => Ok(self.shape(shape, *color, has_colors)),
            DrawableClass::Shape { shape: None, .. } => {
                self.note("OpenSceneGraph: a ShapeDrawable without a shape that is read");
                return Ok(None);
            }
        };
        match made {
            Ok(meshes) => {
                self.meshes.insert(key, meshes.clone());
                Ok(Some(meshes))
            }
            Err(OsgError::Invalid(reason)) => {
                self.note("OpenSceneGraph: invalid geometry that is not drawn");
                self.first_error.get_or_insert(OsgError::Invalid(reason));
                Ok(None)
            }
            Err(error) => Err(error.at(self.source.uri)),
        }
    }
}
