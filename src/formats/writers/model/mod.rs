//! Writes decoded drawables as a glb (glTF 2.0): meshes with normals, colours and two sets of texture coordinates, Gaussian
//! splats, materials, images as the files that they came as, features and their properties. Decode threads.
//!
//! ```text
//! height     height tiles as meshes
//! images     files that are kept, and JPEG or PNG of other texels
//! materials  metallic-roughness, unlit
//! features   EXT_mesh_features, EXT_structural_metadata
//! splats     KHR_gaussian_splatting
//! ```

mod features;
mod height;
mod images;
mod materials;
mod splats;

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DMat4, DVec3};
use serde_json::{Map, Value, json};

use self::features::Features;
use self::images::Images;
use self::materials::Materials;
use crate::formats::ignored::Notes;
use crate::formats::image::ImageFiles;
use crate::formats::writers::buffers::{self, Accuracy, Buffers, Component, Elements};
use crate::math::Aabb;
use crate::scene::{AttributeFormat, Drawable, DrawableFeatures, Geometry, Material, Mesh, SecondUv, Splats, Topology};

/// The vertices of a point that is drawn as a square.
const VERTICES_OF_SQUARE: usize = 4;

/// The geometry of a leaf.
#[derive(Clone, Debug)]
pub(in crate::formats) enum LeafShape {
    Mesh(Arc<Mesh>),
    Splats(Arc<Splats>),
}

impl LeafShape {
    /// Returns the box around it in the drawable's frame.
    pub fn bounds(&self) -> Aabb {
        match self {
            Self::Mesh(mesh) => mesh.bounds,
            Self::Splats(splats) => splats.bounds(),
        }
    }

    /// Returns true if nothing is drawn.
    pub fn is_empty(&self) -> bool {
        match self {
            Self::Mesh(mesh) => mesh.indices.is_empty(),
            Self::Splats(splats) => splats.list().is_empty(),
        }
    }
}

/// A mesh or splats with their transform in the model.
#[derive(Clone, Debug)]
pub(in crate::formats) struct Leaf {
    /// Maps the drawable to the frame of the model, z up.
    pub model_from_drawable: DAffine3,
    pub shape: LeafShape,
    pub material: Material,
    pub features: Option<Arc<DrawableFeatures>>,
}

impl Leaf {
    /// Returns a drawable as a mesh or splats. Height tiles become a mesh. Returns `None` for geometry that an application draws.
    pub fn new(model_from_drawable: DAffine3, drawable: Drawable) -> Option<Self> {
        let Drawable { geometry, mut material, features, .. } = drawable;
        let (model_from_drawable, shape) = match geometry {
            Geometry::Mesh(mesh) => (model_from_drawable, LeafShape::Mesh(mesh)),
            Geometry::Splats(splats) => (model_from_drawable, LeafShape::Splats(splats)),
            Geometry::Height(tile) => {
                material.texture = material.texture.or_else(|| tile.texture.clone());
                (model_from_drawable * height::tile_from_mesh(), LeafShape::Mesh(Arc::new(height::mesh_of(&tile))))
            }
            Geometry::Custom(_) => return None,
        };
        Some(Self { model_from_drawable, shape, material, features })
    }
}

/// A model to be written.
pub(in crate::formats) struct Model<'a> {
    pub leaves: &'a [Leaf],
    /// The files of the images.
    pub files: ImageFiles,
    pub credits: &'a [Arc<str>],
    /// Compresses vertices and indices with EXT_meshopt_compression.
    pub is_compressed: bool,
}

/// Returns a glb of a model, y up. What glTF cannot hold is noted. The error says why an image cannot be written.
pub(in crate::formats) fn write_model(model: &Model<'_>, notes: &Notes) -> Result<Vec<u8>, String> {
    let mut writer = Writer {
        buffers: Buffers::new(model.is_compressed),
        images: Images::new(model.files.clone()),
        materials: Materials::default(),
        features: Features::default(),
        notes,
        meshes: Vec::new(),
        known: HashMap::new(),
        index_lists: HashMap::new(),
        has_quantized: false,
        has_splats: false,
    };
    let mut nodes = Vec::new();
    for leaf in model.leaves {
        writer.add(leaf, &mut nodes)?;
    }
    Ok(writer.into_glb(nodes, model.credits))
}

/// The key of a mesh: the addresses of its geometry and features, and its material; the factor of the opacity for splats.
type MeshKey = (usize, usize, usize);

struct Writer<'a> {
    buffers: Buffers,
    images: Images,
    materials: Materials,
    features: Features,
    notes: &'a Notes,
    meshes: Vec<Value>,
    /// The indices of meshes. Drawables that share a mesh share it in the glb.
    known: HashMap<MeshKey, usize>,
    /// The accessors of index lists by their address and number of vertices.
    index_lists: HashMap<(usize, usize), usize>,
    has_quantized: bool,
    has_splats: bool,
}

impl Writer<'_> {
    /// Adds the node of a drawable.
    fn add(&mut self, leaf: &Leaf, nodes: &mut Vec<Value>) -> Result<(), String> {
        let Leaf { model_from_drawable, shape, material, features } = leaf;
        if shape.is_empty() {
            return Ok(());
        }
        let key = match shape {
            LeafShape::Mesh(mesh) => {
                let material = self.materials.index(material, &mut self.images, &mut self.buffers)?;
                let features = features.as_ref().map_or(0, |features| Arc::as_ptr(features).addr());
                (Arc::as_ptr(mesh).addr(), features, material)
            }
            LeafShape::Splats(splats) => (Arc::as_ptr(splats).addr(), 0, material.base_color[3].to_bits() as usize),
        };
        let index = match self.known.get(&key) {
            Some(known) => *known,
            None => {
                let primitive = match shape {
                    LeafShape::Mesh(mesh) => self.primitive(leaf, mesh, key.2),
                    LeafShape::Splats(splats) => self.splats(splats, material),
                };
                self.meshes.push(json!({ "primitives": [primitive] }));
                self.known.insert(key, self.meshes.len() - 1);
                self.meshes.len() - 1
            }
        };
        let mut node = json!({ "mesh": index });
        let map = y_up_from_z_up() * *model_from_drawable;
        if map != DAffine3::IDENTITY {
            node["matrix"] = json!(DMat4::from(map).to_cols_array());
        }
        nodes.push(node);
        Ok(())
    }

    fn splats(&mut self, splats: &Splats, material: &Material) -> Value {
        self.has_splats = true;
        let [r, g, b, opacity] = material.base_color;
        if [r, g, b] != [1.0; 3] {
            self.notes.add("colour factors of Gaussian splats");
        }
        splats::primitive(splats, opacity, &mut self.buffers)
    }

    fn primitive(&mut self, leaf: &Leaf, mesh: &Arc<Mesh>, material: usize) -> Value {
        let squares;
        let (mesh, mode) = match mesh.topology {
            Topology::Triangles => (mesh, 4),
            Topology::Lines => (mesh, 1),
            Topology::Points => (mesh, 0),
            Topology::Squares => {
                self.notes.add("points larger than a pixel");
                squares = Arc::new(points_of_squares(mesh));
                (&squares, 0)
            }
        };
        let count = mesh.vertices.len();
        let mut attributes = Map::new();
        let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|vertex| vertex.position).collect();
        attributes.insert("POSITION".into(), self.buffers.positions(&positions).into());
        let mut add = |name: &str, kind, component, stride, bytes: &[u8]| {
            let (is_normalized, accuracy) = (component != Component::F32, Accuracy::Exact);
            let elements = Elements { kind, component, is_normalized, stride, bytes, accuracy };
            attributes.insert(name.into(), self.buffers.attribute(&elements).into());
        };
        if mesh.vertices.iter().any(|vertex| vertex.normal[..3] != [0; 3]) {
            let normals: Vec<[i8; 4]> = mesh.vertices.iter().map(|vertex| vertex.normal).collect();
            self.has_quantized = true;
            add("NORMAL", "VEC3", Component::I8, 4, bytemuck::cast_slice(&normals));
        }
        let uvs: Vec<[f32; 2]> = mesh.vertices.iter().map(|vertex| vertex.uv).collect();
        if mode != 0 && uvs.iter().any(|uv| *uv != [0.0; 2]) {
            add("TEXCOORD_0", "VEC2", Component::F32, 8, bytemuck::cast_slice(&uvs));
        }
        if leaf.material.metallic_roughness.as_ref().is_some_and(|surface| surface.second_uv.is_used()) {
            let second = mesh.attributes.get(SecondUv::ATTRIBUTE);
            let second = second.filter(|(format, _)| *format == AttributeFormat::Float32x2);
            let bytes = second.map_or(bytemuck::cast_slice(&uvs), |(_, bytes)| bytes);
            add("TEXCOORD_1", "VEC2", Component::F32, 8, bytes);
        }
        if mesh.vertices.iter().any(|vertex| vertex.color != [255; 4]) {
            let colors: Vec<[u8; 4]> = mesh.vertices.iter().map(|vertex| vertex.color).collect();
            add("COLOR_0", "VEC4", Component::U8, 4, bytemuck::cast_slice(&colors));
        }
        let further_uvs = [SecondUv::ATTRIBUTE, SecondUv::THIRD_ATTRIBUTE];
        for (name, ..) in mesh.attributes.iter().filter(|(name, ..)| !further_uvs.contains(name)) {
            self.notes.add(format!("vertex attribute {name}"));
        }
        let mut primitive = json!({ "material": material, "mode": mode });
        if let Some(features) = &leaf.features
            && let Some(of_mesh) = self.features.add(features, count, &mut attributes, &mut self.buffers, self.notes)
        {
            primitive["extensions"] = json!({ features::MESH_FEATURES: of_mesh });
        }
        // Meshes that share a list, such as the grid of all tiles, share its accessor.
        let list = (mesh.indices.as_ptr().addr(), count);
        let indices = match self.index_lists.get(&list) {
            Some(known) => *known,
            None => self.buffers.indices(&mesh.indices, count, mode == 4),
        };
        if mesh.topology != Topology::Squares {
            self.index_lists.insert(list, indices);
        }
        primitive["attributes"] = attributes.into();
        primitive["indices"] = indices.into();
        primitive
    }

    fn into_glb(self, nodes: Vec<Value>, credits: &[Arc<str>]) -> Vec<u8> {
        let Self { buffers, images, materials, features, notes, meshes, has_quantized, has_splats, .. } = self;
        (0..materials.overlays).for_each(|_| notes.add("raster overlays"));
        let mut used: Vec<&str> = materials.extensions.clone();
        // Clients without these extensions would draw wrong.
        let mut required: Vec<&str> = images.extensions.clone();
        required.extend(has_quantized.then_some("KHR_mesh_quantization"));
        required.extend(buffers.has_compressed().then_some(buffers::MESHOPT));
        used.extend(&required);
        used.extend(features.has_ids.then_some(features::MESH_FEATURES));
        used.extend(has_splats.then_some(splats::GAUSSIAN_SPLATTING));
        let mut document = json!({ "asset": { "version": "2.0", "generator": "terrane" }, "scene": 0 });
        if !credits.is_empty() {
            document["asset"]["copyright"] = credits.join("; ").into();
        }
        if let Some(metadata) = features.metadata() {
            used.push(features::STRUCTURAL_METADATA);
            document["extensions"] = json!({ features::STRUCTURAL_METADATA: metadata });
        }
        document["scenes"] = match nodes.len() {
            0 => json!([{}]),
            count => json!([{ "nodes": (0..count).collect::<Vec<_>>() }]),
        };
        let lists = [("nodes", nodes), ("meshes", meshes)];
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document[name] = list.into();
        }
        for (name, list) in [("extensionsUsed", used), ("extensionsRequired", required)] {
            if !list.is_empty() {
                document[name] = json!(list);
            }
        }
        materials.add_to(&mut document);
        images.add_to(&mut document);
        buffers.into_glb(document)
    }
}

/// Returns one vertex for each square.
fn points_of_squares(mesh: &Mesh) -> Mesh {
    let vertices: Vec<_> = mesh.vertices.iter().step_by(VERTICES_OF_SQUARE).copied().collect();
    let indices: Vec<u32> = (0..vertices.len() as u32).collect();
    Mesh::new(vertices, indices, Topology::Points)
}

/// Returns the map to the axes of glTF.
fn y_up_from_z_up() -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y))
}
