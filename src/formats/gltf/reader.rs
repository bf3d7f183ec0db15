//! Reads a glTF document: parses it and converts the nodes of its default scene.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::accessors::Buffers;
use super::context::Context;
use super::document::{self, Parsed};
use super::double_precision::DoublePrecision;
use super::external;
use super::features::FeatureTables;
use super::glb::{self, Chunks};
use super::instances::Instances;
use super::lights::Lights;
use super::mesh::{MeshReader, SkinPose};
use super::node_tree::NodeTree;
use super::occluder;
use super::version1;
use crate::fetch::IoError;
use crate::formats::external_files::ExternalFiles;
use crate::formats::ignored::Notes;
use crate::formats::options::{Fetched, ReadOptions};
use crate::scene::{LocalLights, Node, NodeKind, PropertyTable};

/// The bytes of a glTF and what belongs to them.
pub(in crate::formats) struct GltfSource<'a> {
    /// The address, for errors.
    pub uri: &'a str,
    /// The address that references are relative to.
    pub base: &'a str,
    /// A glb, or the JSON of a glTF.
    pub bytes: &'a [u8],
    /// The z-up RTC_CENTER of a b3dm, added after the rotation to z-up.
    pub rtc_center: Option<DVec3>,
    /// The properties of the features that the attribute `_BATCHID` names.
    pub batch_table: Option<Arc<PropertyTable>>,
    /// External buffers and images.
    pub companions: &'a [Fetched],
}

impl<'a> GltfSource<'a> {
    fn chunks(&self) -> Result<Chunks<'a>, IoError> {
        match self.bytes.starts_with(b"glTF") {
            true => glb::chunks(self.uri, self.bytes),
            false => Ok(Chunks { json: glb::text(self.bytes), binary: None }),
        }
    }
}

/// Returns the references to external buffers, images and schemas, relative to the glTF; none if it is invalid.
pub(in crate::formats) fn references(uri: &str, bytes: &[u8], options: &ReadOptions) -> Vec<String> {
    // Schemas describe features.
    let with_schema = options.keep_features || options.style.is_some();
    let source = GltfSource { uri, base: uri, bytes, rtc_center: None, batch_table: None, companions: &[] };
    let limits = &options.limits;
    // The decoder returns the error.
    let chunks = source.chunks().ok().filter(|chunks| limits.check_json(uri, &chunks.json).is_ok());
    let Some(chunks) = chunks else { return Vec::new() };
    let of_version_1 = || {
        let upgraded = version1::upgraded(uri, &chunks, limits, &Notes::default()).ok().flatten();
        external::references(&upgraded.filter(|json| limits.check_json(uri, json).is_ok())?, with_schema)
    };
    external::references(&chunks.json, with_schema).or_else(of_version_1).unwrap_or_default()
}

/// Reads a glTF or glb. The root of the result rotates the content to z-up. Invalid primitives are noted and left out; if no
/// primitive is left, the result is the error of the first one.
pub(in crate::formats) fn read(source: GltfSource<'_>, options: &ReadOptions, notes: &Notes) -> Result<Node, IoError> {
    let chunks = source.chunks()?;
    let GltfSource { uri, base, rtc_center, companions, batch_table, .. } = source;
    let files = ExternalFiles::new(base, &options.root, &options.limits, companions);
    let context = Context::new(uri, options, notes, files);
    let Parsed { document, double, left_out } = document::parse(&context, &chunks)?;
    let buffers = Buffers::read(&context, &document, chunks.binary)?;
    let tables = FeatureTables::new(&context, &document, &buffers, batch_table)?;
    let mut reader = Reader {
        context: &context,
        document: &document,
        buffers: &buffers,
        meshes: MeshReader::new(&context, &buffers, &document, &tables),
        tables: &tables,
        double: &double,
        tree: None,
        is_visited: vec![false; document.nodes().len()],
        skinned: Vec::new(),
        lights: Lights::new(&context, &document),
    };
    if let Some(error) = left_out {
        reader.meshes.refuse(error);
    }
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let mut children = Vec::new();
    match scene {
        Some(scene) => {
            for node in scene.nodes() {
                children.push(reader.node(&node, 0)?);
            }
        }
        None => {
            for mesh in document.meshes() {
                children.extend(reader.meshes.drawables(&mesh, None, None)?.into_nodes());
            }
        }
    }
    children.append(&mut reader.skinned);
    reader.meshes.into_result()?;
    let lights = reader.lights.into_placed();
    if !lights.is_empty() {
        let lit = NodeKind::LocalLights(LocalLights { lights });
        children = vec![Node { children, ..Node::new(lit) }];
    }
    let center = rtc_center.unwrap_or(DVec3::ZERO) + double.cesium_rtc().unwrap_or(DVec3::ZERO);
    // CESIUM_RTC is added after the rotation too, since Cesium's exporters write it z-up.
    let rotation = DAffine3 { matrix3: options.gltf_up_axis.z_up(), translation: center };
    Ok(Node::transform(rotation, children))
}

/// Converts the nodes of one glTF.
struct Reader<'a> {
    context: &'a Context<'a>,
    document: &'a gltf::Document,
    buffers: &'a Buffers<'a>,
    meshes: MeshReader<'a>,
    tables: &'a FeatureTables,
    double: &'a DoublePrecision,
    /// The tree of nodes, once a skin or a light needs it.
    tree: Option<NodeTree<'a>>,
    /// By index of the node: true if it already has a parent.
    is_visited: Vec<bool>,
    /// Skinned meshes. Their vertices are in the frame of the glTF, whatever the transforms above them.
    skinned: Vec<Node>,
    lights: Lights<'a>,
}

impl Reader<'_> {
    fn node(&mut self, node: &gltf::Node<'_>, depth: u32) -> Result<Node, IoError> {
        if depth > self.context.options.limits.max_depth {
            return Err(self.context.bad("node tree too deep"));
        }
        if self.is_visited.get_mut(node.index()).is_none_or(|is_visited| std::mem::replace(is_visited, true)) {
            // A circle of nodes.
            self.context.notes.add("glTF: node that is its own ancestor");
            return Ok(Node::group(Vec::new()));
        }
        let visibility = node.extension_value("KHR_node_visibility");
        if visibility.and_then(|of| of.get("visible")?.as_bool()) == Some(false) {
            return Ok(Node::group(Vec::new()));
        }
        let Some(transform) = self.double.transform(node.index()) else {
            self.context.notes.add("glTF: node that is not drawn because its transform is not affine and finite");
            self.meshes.refuse(self.context.bad("transform of a node is not affine and finite"));
            return Ok(Node::group(Vec::new()));
        };
        let mut children = Vec::new();
        if let Some(mesh) = node.mesh() {
            match node.skin() {
                Some(skin) => self.skinned_mesh(node, &mesh, &skin)?,
                None => self.mesh(node, &mesh, &mut children)?,
            }
        }
        let (document, double, tree) = (self.document, self.double, &mut self.tree);
        self.lights
            .add(node, || tree.get_or_insert_with(|| NodeTree::new(document, double)).root_from_node(node.index()));
        if let Some(extras) = node.extras()
            && let Some(occluder) = occluder::of_node(self.context.uri, node.index(), extras.get())?
        {
            children.push(Node::new(NodeKind::OccluderNode(Box::new(occluder))));
        }
        for child in node.children() {
            children.push(self.node(&child, depth + 1)?);
        }
        if transform == DAffine3::IDENTITY {
            return Ok(if children.len() == 1 { children.swap_remove(0) } else { Node::group(children) });
        }
        Ok(Node::transform(transform, children))
    }

    /// Adds a mesh to the children of its node: once, or at each of its instances.
    fn mesh(&mut self, node: &gltf::Node<'_>, mesh: &gltf::Mesh<'_>, children: &mut Vec<Node>) -> Result<(), IoError> {
        let instances = match Instances::new(self.context, self.document, self.buffers, self.tables, node) {
            Err(error @ IoError::Invalid { .. }) => {
                self.context.notes.add("glTF: instances that are not drawn because they are invalid");
                self.meshes.refuse(error);
                return Ok(());
            }
            instances => instances?,
        };
        let drawables = self.meshes.drawables(mesh, node.weights(), None)?;
        let Some(instances) = instances else {
            children.extend(drawables.into_nodes());
            return Ok(());
        };
        self.context.budget.add_primitives(instances.transforms.len().saturating_mul(drawables.len()))?;
        for (i, transform) in instances.transforms.iter().enumerate() {
            let mut drawables = drawables.clone();
            let sets = instances.feature_sets(i as u32);
            if !sets.is_empty() {
                drawables.iter_mut().for_each(|drawable| self.tables.add_instance(drawable, &sets));
            }
            children.push(Node::transform(*transform, drawables.into_nodes()));
        }
        Ok(())
    }

    /// Reads a skinned mesh, and keeps it for the root of the glTF.
    fn skinned_mesh(
        &mut self,
        node: &gltf::Node<'_>,
        mesh: &gltf::Mesh<'_>,
        skin: &gltf::Skin<'_>,
    ) -> Result<(), IoError> {
        let (document, double) = (self.document, self.double);
        let tree = self.tree.get_or_insert_with(|| NodeTree::new(document, double));
        let pose = match SkinPose::new(skin, self.buffers, self.context, |joint| tree.root_from_node(joint)) {
            Err(error @ IoError::Invalid { .. }) => {
                self.context.notes.add("glTF: mesh that is not drawn because its skin is invalid");
                self.meshes.refuse(error);
                return Ok(());
            }
            pose => pose?,
        };
        let drawables = self.meshes.drawables(mesh, node.weights(), Some(&pose))?;
        self.skinned.push(Node::transform(DAffine3::from_translation(pose.origin), drawables.into_nodes()));
        Ok(())
    }
}
