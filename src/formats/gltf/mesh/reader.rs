//! [`MeshReader`]: meshes of a glTF as drawables.

use std::collections::HashMap;
use std::sync::Arc;

use gltf::mesh::Mode;

use super::attributes::{add_second_uv, additional_attributes};
use super::deform::Deformation;
use super::outline::{self, MeshDrawables};
use super::primitive::PrimitiveData;
use super::skin::SkinPose;
use super::vertices::Vertices;
use crate::fetch::IoError;
use crate::formats::gltf::accessors::{BUFFER_MISSING, Buffers, IndexLists, list_key_of};
use crate::formats::gltf::context::Context;
use crate::formats::gltf::features::{FeatureTables, PrimitiveImages};
use crate::formats::gltf::materials::Surfaces;
use crate::formats::gltf::splats;
use crate::scene::{ContentKey, Drawable, Geometry, Material, Mesh, PrimitiveMode, SharedParts, Topology};

/// Reads the meshes of one glTF.
pub(in super::super) struct MeshReader<'a> {
    context: &'a Context<'a>,
    buffers: &'a Buffers<'a>,
    document: &'a gltf::Document,
    tables: &'a FeatureTables,
    surfaces: Surfaces<'a>,
    index_lists: IndexLists<'a>,
    /// The drawables of meshes that were read without a deformation of their node, by the index of the mesh.
    meshes: HashMap<usize, MeshDrawables>,
    /// The error of the first primitive that is invalid.
    first_error: Option<IoError>,
    has_drawables: bool,
}

impl<'a> MeshReader<'a> {
    pub fn new(
        context: &'a Context<'a>,
        buffers: &'a Buffers<'a>,
        document: &'a gltf::Document,
        tables: &'a FeatureTables,
    ) -> Self {
        Self {
            context,
            buffers,
            document,
            tables,
            surfaces: Surfaces::new(context, document),
            index_lists: IndexLists::new(context),
            meshes: HashMap::new(),
            first_error: None,
            has_drawables: false,
        }
    }

    /// Keeps the reason why a part of the glTF is not drawn.
    pub fn refuse(&mut self, error: IoError) {
        self.first_error.get_or_insert(error);
    }

    /// Returns the error of the first invalid part, or of the first missing buffer, if no primitive is drawn.
    pub fn into_result(self) -> Result<(), IoError> {
        let error = self.first_error.or_else(|| self.buffers.first_missing().cloned());
        error.filter(|_| !self.has_drawables).map_or(Ok(()), Err)
    }

    /// Reads a mesh. Nodes that draw the same mesh share its vertices. `weights` are those of the node, `skin` its skin.
    /// Invalid primitives are noted and left out.
    pub fn drawables(
        &mut self,
        mesh: &gltf::Mesh<'_>,
        weights: Option<&[f32]>,
        skin: Option<&SkinPose>,
    ) -> Result<MeshDrawables, IoError> {
        self.context.budget.add_primitives(mesh.primitives().len())?;
        let is_plain = weights.is_none() && skin.is_none();
        if let Some(known) = self.meshes.get(&mesh.index()).filter(|_| is_plain) {
            return Ok(known.clone());
        }
        let deformation = Deformation { weights: weights.or(mesh.weights()).unwrap_or_default(), skin };
        let mut drawables = MeshDrawables::default();
        for primitive in mesh.primitives() {
            match self.primitive(&primitive, deformation) {
                Ok(read) => {
                    self.has_drawables |= !read.is_empty();
                    read.into_iter().for_each(|(drawable, outline)| drawables.push(drawable, outline));
                }
                Err(error @ IoError::Invalid { .. }) => {
                    self.context.notes.add("glTF: invalid primitive that is not drawn");
                    self.refuse(error);
                }
                Err(error) => return Err(error),
            }
        }
        if is_plain {
            self.meshes.insert(mesh.index(), drawables.clone());
        }
        Ok(drawables)
    }

    /// Reads the drawables of a primitive, each with its outline: one, or several of a large cloud of splats. Returns none if a
    /// buffer that it cannot do without is missing.
    fn primitive(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        deformation: Deformation<'_>,
    ) -> Result<Vec<(Drawable, Option<Drawable>)>, IoError> {
        let Self { context, buffers, document, tables, surfaces, index_lists, .. } = self;
        if let Some(splats) = splats::read(context, buffers, document, primitive)? {
            return Ok(splats.into_iter().map(|splats| (splats, None)).collect());
        }
        let Some(data) = PrimitiveData::new(context, buffers, document, primitive)? else { return Ok(Vec::new()) };
        let mut surface = surfaces.get(&primitive.material());
        let not_drawn = || {
            context.notes.add(BUFFER_MISSING);
            Ok(Vec::new())
        };
        let vertices = Vertices::new(context, &data, surface.texture_coordinates(), deformation)?;
        let Some(vertices) = vertices else { return not_drawn() };
        let mut attributes = additional_attributes(context, &data)?;
        if let Some(set) = surface.reflection.as_ref().and_then(|reflection| reflection.second_set) {
            add_second_uv(context, &data, set, &mut attributes)?;
        }
        let attribute = |name: &str| match data.accessor(name) {
            Some(accessor) => Ok(data.elements(name, &accessor)?.filter(|elements| elements.count == data.count)),
            None => Ok(None),
        };
        let images = PrimitiveImages::new(context, surfaces, buffers);
        let features = tables.of_primitive(primitive, images, &attribute)?;
        let sharing = context.options.sharing.as_deref();
        // Hashed here, while the vertices are in the CPU cache.
        let vertices_key = sharing.map(|_| ContentKey::of_vertices(&vertices.list, &attributes));
        let mut restart = None;
        let (mode, read, list_key) = match (data.triangles()?, primitive.indices()) {
            (Some(triangles), _) => (PrimitiveMode::Triangles, triangles, None),
            (None, Some(accessor)) => {
                let elements = || data.index_elements(&accessor);
                let list = match has_runs(primitive.mode()) {
                    true => index_lists.get_restarting(&accessor, data.count, elements)?,
                    false => index_lists.get(&accessor, data.count, elements)?.map(|(list, key)| (list, key, None)),
                };
                let Some((list, key, restarts)) = list else { return not_drawn() };
                restart = restarts;
                (mode(primitive.mode()), list.list, Some(key))
            }
            (None, None) => (mode(primitive.mode()), (0..data.count as u32).collect(), None),
        };
        context.budget.add_indices(mode.assembled(read.len()))?;
        let (topology, indices) = match restart {
            Some(restart) => assemble_runs(mode, &read, restart),
            None => mode.assemble(read.clone()),
        };
        let indices = vertices.finite(context, topology, indices)?;
        let list_key = list_key.filter(|_| Arc::ptr_eq(&read, &indices));
        // Points and lines without normals are not lit (glTF 2.0, 3.7.2.1).
        surface.unlit |= topology != Topology::Triangles && !vertices.has_normals;
        let (texture, shared_texture) = surfaces.texture(&surface, buffers)?.unzip();
        let reflection = surface.reflection.filter(|_| topology == Topology::Triangles);
        let reflection =
            reflection.map(|reflection| surfaces.reflection(&surface, &reflection, buffers)).transpose()?;
        let (metallic_roughness, maps) =
            reflection.map_or((None, Default::default()), |(model, maps)| (Some(model), maps));
        let material = Material {
            base_color: surface.base_color,
            texture,
            alpha: surface.alpha,
            double_sided: surface.double_sided,
            unlit: surface.unlit,
            metallic_roughness,
        };
        let are_finite = vertices.are_finite();
        let Vertices { list, bounds, format, .. } = vertices;
        let mut mesh = Arc::new(Mesh { vertices: list, indices, topology, bounds, attributes });
        let (geometry, indices) = match (sharing, vertices_key) {
            (Some(sharing), Some(vertices_key)) => {
                let list_key = list_key.unwrap_or_else(|| list_key_of(&mesh.indices));
                sharing.mesh(&mut mesh, &vertices_key, &list_key)
            }
            _ => (None, None),
        };
        let mut drawable = Drawable::new(Geometry::Mesh(mesh), material);
        drawable.features = features;
        drawable.shared = SharedParts { geometry, indices, texture: shared_texture.flatten(), maps };
        let drawable = drawable.with_vertex_format(format);
        let drawable = if context.options.cluster_culling { drawable.with_cluster_culling() } else { drawable };
        let edges = match are_finite {
            true => outline::edges(context, document, primitive, &data, index_lists)?,
            false => None,
        };
        let outline = edges.map(|edges| outline::lines(context, &edges, &drawable)).transpose()?.flatten();
        Ok(vec![(drawable, outline)])
    }
}

/// Returns true if the primitives of a mode go on until they are restarted.
fn has_runs(mode: Mode) -> bool {
    matches!(mode, Mode::LineStrip | Mode::LineLoop | Mode::TriangleStrip | Mode::TriangleFan)
}

/// Assembles the primitives between the indices that restart them.
fn assemble_runs(mode: PrimitiveMode, list: &[u32], restart: u32) -> (Topology, Arc<[u32]>) {
    let topology = mode.assemble([].into()).0;
    let runs = list.split(|index| *index == restart).map(|run| mode.assemble(run.into()).1);
    (topology, runs.flat_map(|run| run.to_vec()).collect())
}

/// Converts the mode of a primitive.
fn mode(mode: Mode) -> PrimitiveMode {
    match mode {
        Mode::Points => PrimitiveMode::Points,
        Mode::Lines => PrimitiveMode::Lines,
        Mode::LineStrip => PrimitiveMode::LineStrip,
        Mode::LineLoop => PrimitiveMode::LineLoop,
        Mode::Triangles => PrimitiveMode::Triangles,
        Mode::TriangleStrip => PrimitiveMode::TriangleStrip,
        Mode::TriangleFan => PrimitiveMode::TriangleFan,
    }
}
