//! Makes nodes of the engine of the objects of a file.
//!
//! State sets stay state sets. What a drawable's material says is resolved here from the state sets above the drawable in
//! its file: textures of two units, diffuse colour, lighting, blending, alpha test and culling of faces. So the quick shaders
//! draw it, and images are shared and paged as those of other formats. What they lack is in state sets of the drawables.
//! Decode threads.

mod bounds;
mod cameras;
mod coordinates;
mod environments;
mod facing;
mod looks;
mod meshes;
mod old_images;
mod paging;
mod shapes;
mod sizes;
mod states;
mod terrain;
mod text;
mod textures;
mod units;

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use self::looks::Look;
use self::meshes::{UvSet, UvSets};
pub(super) use self::paging::HeldFile;
pub(in crate::formats) use self::paging::{InlinePart, TerrainBelow};
use self::textures::FixedUnit;
pub(super) use self::textures::external_images;
use self::units::Unit;
use super::error::OsgError;
use super::motion::AnimationObject;
use super::objects::{
    DrawableClass, DrawableObject, NodeClass, NodeObject, Object, StateObject, TerrainSettings, TextureTarget,
};
use crate::fetch::{IoError, about_to_allocate};
use crate::formats::ignored::Notes;
use crate::formats::options::{Fetched, ReadOptions};
use crate::math::BoundingSphere;
use crate::scene::{Drawable, Material, Mesh, MetallicRoughness, Node, NodeKind, OverlayMode, Topology};
use crate::state::{StateSet, TexGen, TextureBinding};

/// A file may have one node for this number of [`Limits::max_elements`](crate::fetch::Limits). A shared node counts at each
/// place.
const ELEMENTS_PER_NODE: usize = 16;
/// The bytes that a node takes, in the tree and in the arrays of a page.
const NODE_BYTES: u64 = 1024;

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

/// The textures of a drawable.
#[derive(Default)]
struct Shown {
    texture: Option<textures::BuiltTexture>,
    overlay: Option<(textures::BuiltTexture, OverlayMode)>,
    /// The units of the fixed function.
    fixed: Vec<FixedUnit>,
    uv_sets: UvSets,
}

/// Makes the nodes of one file. One thread. More than 16 fields: a cache for each kind of object that files share, and a counter
/// for each limit.
struct Builder<'a> {
    source: Source<'a>,
    /// By address: objects that the file shares stay shared.
    sets: HashMap<usize, Option<Arc<StateSet>>>,
    textures: HashMap<usize, Option<textures::BuiltTexture>>,
    /// With true if t = 0 is at the first row.
    unit_textures: HashMap<usize, Option<(TextureBinding, bool)>>,
    meshes: HashMap<(usize, UvSets, bool), Meshes>,
    /// The state sets of drawables in the order in which they were made.
    drawable_sets: Vec<Arc<StateSet>>,
    /// Tiles of osgTerrain; `None` for those that are not drawn.
    tiles: HashMap<usize, Option<terrain::BuiltTile>>,
    /// With the settings of the Terrain above the current object.
    spheres: bounds::Spheres,
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

/// Makes the node of a file's root object, with the settings of the Terrain above it.
pub(super) fn node_of_file(root: &Object, above: TerrainSettings, source: Source<'_>) -> Result<Node, IoError> {
    if !matches!(root, Object::Node(_) | Object::Drawable(_)) {
        let error = OsgError::Unsupported("a file without a node that is read".to_owned());
        return Err(error.at(source.uri));
    }
    let mut builder = Builder::new(source);
    builder.spheres.terrain = above;
    let node = builder.node(root)?;
    builder.finish(node)
}

/// Returns about the memory that an object takes with everything below it, in bytes.
pub(super) fn size_bytes(root: &Object) -> u64 {
    sizes::of_object(root, &mut HashMap::new()).bytes
}

/// Returns a sphere around the root object of a file, as its PagedLODs declare it; empty if it is unknown.
pub(super) fn sphere_of_file(root: &Object) -> BoundingSphere {
    bounds::sphere(root, &mut bounds::Spheres::default())
}

impl<'a> Builder<'a> {
    fn new(source: Source<'a>) -> Self {
        Self {
            source,
            sets: HashMap::new(),
            textures: HashMap::new(),
            unit_textures: HashMap::new(),
            meshes: HashMap::new(),
            drawable_sets: Vec::new(),
            tiles: HashMap::new(),
            spheres: bounds::Spheres::default(),
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
        about_to_allocate(NODE_BYTES * more as u64).map_err(|error| error.at(self.source.uri))?;
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
            NodeClass::Group | NodeClass::CoordinateSystem(_) => NodeKind::Group,
            NodeClass::Transform { parent_from_child: Some(map), is_absolute: false, animation: None }
                if *map == DAffine3::IDENTITY =>
            {
                NodeKind::Group
            }
            NodeClass::Transform { parent_from_child, is_absolute, animation } => {
                let map = parent_from_child.unwrap_or(DAffine3::IDENTITY);
                let update_callback = animation.as_ref().and_then(AnimationObject::callback);
                if *is_absolute && update_callback.is_some() {
                    self.note("OpenSceneGraph: animation of an absolute transform (its first pose is drawn)");
                }
                let update_callback = update_callback.filter(|_| !is_absolute);
                let kind = if *is_absolute { NodeKind::AbsoluteTransform(map) } else { NodeKind::Transform(map) };
                return Ok(Node { update_callback, children: self.children(&object.children)?, ..Node::new(kind) });
            }
            NodeClass::Switch(shown) => NodeKind::Switch(shown.clone()),
            NodeClass::Sequence(sequence) => {
                let kind = NodeKind::Switch(sequence.first(object.children.len()));
                let (update_callback, children) = (sequence.callback(), self.children(&object.children)?);
                return Ok(Node { update_callback, children, ..Node::new(kind) });
            }
            NodeClass::Lod(lod) => return self.lod(object, lod),
            NodeClass::PagedLod(lod, paged) => return self.paged_lod(object, lod, paged),
            NodeClass::Proxy(proxy) => return self.proxy(object, proxy),
            NodeClass::Light { light, is_absolute } => return self.light_source(object, light.as_ref(), *is_absolute),
            NodeClass::Clip { planes, is_absolute } => return self.clip_node(object, planes, *is_absolute),
            NodeClass::Camera(camera) => return self.camera(object, camera),
            NodeClass::Projection(matrix) => return self.projection(object, **matrix),
            NodeClass::Billboard(billboard) => return self.billboard(object, billboard),
            NodeClass::AutoTransform(auto) => return self.auto_transform(object, auto),
            NodeClass::Terrain(settings, _) => return self.terrain(object, settings),
            NodeClass::TerrainTile(tile) => return self.terrain_tile(object, tile),
        };
        Ok(Node { children: self.children(&object.children)?, ..Node::new(kind) })
    }

    /// Makes one node of each object.
    fn children(&mut self, objects: &[Object]) -> Result<Vec<Node>, IoError> {
        objects.iter().map(|child| self.node(child)).collect()
    }

    /// Makes the node of a drawable.
    fn geode(&mut self, object: &Arc<DrawableObject>) -> Result<Node, IoError> {
        match &object.class {
            DrawableClass::Text(text) => self.text_node(object, text),
            _ => self.still_geode(object),
        }
    }

    /// Makes the node of a drawable that turns to no eye.
    fn still_geode(&mut self, object: &Arc<DrawableObject>) -> Result<Node, IoError> {
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
        if let DrawableClass::Text(text) = &object.class {
            let letters = self.text_drawables(text)?;
            // A text at a position that is not finite has no letters.
            return Ok((if letters.is_empty() { DVec3::ZERO } else { text.position }, letters));
        }
        let look = Look::resolve(&self.states);
        let Shown { texture, overlay, fixed, uv_sets } = self.shown(object, &look)?;
        let Some(Meshes { origin, mut meshes }) = self.meshes_of(object, uv_sets, look.has_vertex_colors())? else {
            return Ok((DVec3::ZERO, Vec::new()));
        };
        if look.point_size_px > 1.0 {
            let has_texture = texture.is_some() || !fixed.is_empty();
            self.enlarge_points(&mut meshes, look.point_size_px, has_texture)?;
        }
        let state_set = self.state_of_drawable(&fixed, origin, look.alpha_test_beside_material());
        let options = self.source.options;
        let surface = overlay.as_ref().map(|(texture, overlay_mode)| MetallicRoughness {
            overlay: Some(texture.shared.0.clone()),
            overlay_mode: *overlay_mode,
            ..MetallicRoughness::default()
        });
        let drawable = |(mesh, has_normals): (Arc<Mesh>, bool)| {
            let is_thin = mesh.topology != Topology::Triangles;
            let is_two_sided = !look.culls_faces;
            let may_be_ground = is_two_sided && texture.is_some() && has_normals && !is_thin;
            let is_two_sided = is_two_sided && !(may_be_ground && terrain::is_ground_with_skirt(&mesh));
            // Photographs show the light that they were taken in. OSG has one normal for all of such a surface.
            let is_photo = (texture.is_some() || fixed.iter().any(|unit| unit.coordinates.needs_uvs())) && !has_normals;
            let material = Material {
                base_color: look.base_color(),
                texture: texture.as_ref().map(|texture| texture.shared.0.clone()),
                alpha: look.alpha_mode(),
                double_sided: is_two_sided,
                unlit: !look.is_lit || is_photo || (is_thin && !has_normals),
                metallic_roughness: surface.clone(),
            };
            let mut drawable = Drawable::new(crate::scene::Geometry::Mesh(mesh), material);
            drawable.shared.texture = texture.as_ref().and_then(|texture| texture.shared.1.clone());
            if let Some((texture, _)) = &overlay {
                drawable.shared.maps[MetallicRoughness::OVERLAY].clone_from(&texture.shared.1);
            }
            drawable.state_set.clone_from(&state_set);
            if options.cluster_culling { drawable.with_cluster_culling() } else { drawable }
        };
        Ok((origin, meshes.into_iter().map(drawable).collect()))
    }

    /// Returns the textures of a drawable with the coordinates that they need.
    fn shown(&mut self, object: &DrawableObject, look: &Look) -> Result<Shown, IoError> {
        let units = &look.units;
        units.left_out.iter().for_each(|what| self.note(*what));
        let mut shown = Shown::default();
        if let Some(base) = &units.base {
            shown.texture = self.texture(&base.texture)?;
            shown.uv_sets.first = UvSet::of(base, shown.texture.as_ref());
        }
        let geometry = match &object.class {
            DrawableClass::Geometry(geometry) => Some(geometry),
            DrawableClass::Shape { .. } | DrawableClass::Text(_) => None,
        };
        let has_uvs = |unit: &Unit| {
            !unit.coordinates.needs_uvs() || geometry.is_some_and(|geometry| geometry.has_uvs(unit.number))
        };
        let lacks_uvs = |unit: &&Unit| !has_uvs(unit);
        let all = units.overlay.iter().map(|(unit, _)| unit).chain(units.fixed.iter().map(|(unit, _)| unit));
        all.filter(lacks_uvs).for_each(|_| self.note("OpenSceneGraph: texture of a unit without texture coordinates"));
        if let Some((unit, mode)) = units.overlay.as_ref().filter(|(unit, _)| has_uvs(unit)) {
            let Some(texture) = self.texture(&unit.texture)? else { return Ok(shown) };
            let uv_set = UvSet::of(unit, Some(&texture));
            let first = shown.uv_sets.first;
            match &units.base {
                None => shown.uv_sets.first = uv_set,
                Some(_) if geometry.is_some_and(|geometry| geometry.has_equal_uvs(first, uv_set)) => {}
                Some(_) => shown.uv_sets.second = Some(uv_set),
            }
            shown.overlay = Some((texture, *mode));
        }
        let mut sets: Vec<UvSet> = units.base.iter().map(|_| shown.uv_sets.first).collect();
        for (unit, environment) in units.fixed.iter().filter(|(unit, _)| has_uvs(unit)) {
            let Some((binding, starts_at_bottom)) = self.unit_texture(&unit.texture)? else { continue };
            let own = geometry.filter(|_| unit.coordinates.needs_uvs());
            let set = own.map(|geometry| geometry.place_of_uvs(unit.number, &mut sets)).unwrap_or(Some(0));
            let Some(set) = set else {
                self.note("OpenSceneGraph: texture with a fourth set of coordinates");
                continue;
            };
            let [width, height, _] = binding.texture.size;
            let mut coordinates = unit.coordinates;
            if let Some(geometry) = own.filter(|_| unit.target == TextureTarget::D3) {
                // Meshes have two coordinates.
                match geometry.depth_of_uvs(unit.number) {
                    Some(depth) => coordinates = coordinates.at_depth(depth),
                    None => self.note("OpenSceneGraph: volume whose third coordinate varies (its front is drawn)"),
                }
            }
            let coordinates = if unit.is_in_texels { coordinates.of_rectangle([width, height]) } else { coordinates };
            shown.fixed.push(FixedUnit {
                binding,
                environment: *environment,
                coordinates,
                own_coordinates: [None, Some(TexGen::SecondUv), Some(TexGen::ThirdUv)][set],
                are_turned_over: sets.get(set).is_some_and(|set| !set.starts_at_bottom),
                is_turned_over: !starts_at_bottom,
            });
        }
        if !units.fixed.is_empty() {
            let set = |at: usize| sets.get(at).copied();
            shown.uv_sets = UvSets { first: set(0).unwrap_or_default(), second: set(1), third: set(2) };
        }
        Ok(shown)
    }

    /// Returns the meshes of a drawable; `None` if it is left out, which is noted.
    fn meshes_of(
        &mut self,
        object: &Arc<DrawableObject>,
        uv_sets: UvSets,
        has_colors: bool,
    ) -> Result<Option<Meshes>, IoError> {
        let key = (Arc::as_ptr(object).addr(), uv_sets, has_colors);
        if let Some(known) = self.meshes.get(&key) {
            return Ok(Some(known.clone()));
        }
        let made = match &object.class {
            DrawableClass::Geometry(geometry) => self.geometry(geometry, uv_sets, has_colors),
            DrawableClass::Shape { shape: Some(shape), color } => {
                Ok(self.shape(shape, *color, has_colors, uv_sets.first))
            }
            DrawableClass::Shape { shape: None, .. } => {
                self.note("OpenSceneGraph: a ShapeDrawable without a shape that is read");
                return Ok(None);
            }
            DrawableClass::Text(_) => return Ok(None),
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
