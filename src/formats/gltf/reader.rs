//! Reads a glTF document: checks its JSON and converts its nodes.

use glam::{DAffine3, DVec3};

use super::buffers::Buffers;
use super::double_precision::{DoublePrecision, extensions_required};
use super::mesh::MeshReader;
use super::occluder;
use crate::fetch::IoError;
use crate::formats::options::ReadOptions;
use crate::scene::{Node, NodeKind};

/// Supported extensions that a glTF may require.
const KNOWN_EXTENSIONS: &[&str] =
    &["KHR_mesh_quantization", "KHR_materials_unlit", "KHR_texture_transform", "CESIUM_RTC"];

/// Reads a glTF in JSON. Its buffers and images must be `data:` URIs.
pub(in crate::formats) fn read_gltf(uri: &str, json: &[u8], options: &ReadOptions) -> Result<Node, IoError> {
    read_document(uri, json, None, None, options)
}

/// Reads a glTF from its JSON and its binary chunk.
pub(super) fn read_document(
    uri: &str,
    json: &[u8],
    binary: Option<&[u8]>,
    rtc_center: Option<DVec3>,
    options: &ReadOptions,
) -> Result<Node, IoError> {
    let refused = |required: &[String]| {
        let unknown = required.iter().find(|name| !KNOWN_EXTENSIONS.contains(&name.as_str()));
        unknown.map(|name| IoError::unsupported(uri, format!("required glTF extension {name}")))
    };
    let mut root = gltf::json::Root::from_slice(json).map_err(|e| {
        // An unsupported extension may replace required properties, such as the source of a texture. It is the better error.
        let required = extensions_required(json);
        refused(&required).unwrap_or_else(|| IoError::invalid(uri, format!("glTF JSON: {e}")))
    })?;
    if let Some(error) = refused(&root.extensions_required) {
        return Err(error);
    }
    root.extensions_required.clear();
    // The crate panics or misbehaves unless the next two conditions hold.
    let accessors = root.accessors.len();
    for primitive in root.meshes.iter().flat_map(|m| &m.primitives) {
        if let Some(index) = primitive.attributes.values().map(|a| a.value()).find(|index| *index >= accessors) {
            return Err(IoError::invalid(uri, format!("glTF: accessor {index} of {accessors}")));
        }
    }
    for (i, image) in root.images.iter().enumerate() {
        let named = if image.buffer_view.is_some() { image.mime_type.is_some() } else { image.uri.is_some() };
        if !named {
            let reason = format!("glTF: image {i} has no source, or no mimeType for its bufferView");
            return Err(IoError::invalid(uri, reason));
        }
    }
    // Attributes with unknown names are ignored, valid or not.
    for primitive in root.meshes.iter_mut().flat_map(|m| m.primitives.iter_mut()) {
        primitive.attributes.retain(|semantic, _| matches!(semantic, gltf::json::validation::Checked::Valid(_)));
    }
    let double = DoublePrecision::read(json, &root).map_err(|e| IoError::invalid(uri, format!("glTF JSON: {e}")))?;
    let cesium_rtc = double.cesium_rtc();
    let document = gltf::Document::from_json(root).map_err(|e| IoError::invalid(uri, format!("glTF: {e}")))?;
    let buffers = Buffers::read(uri, &document, binary)?;
    let mut reader = Reader {
        uri,
        max_depth: options.limits.max_depth,
        meshes: MeshReader::new(uri, options, buffers),
        double,
        is_visited: vec![false; document.nodes().len()],
    };
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
                children.push(reader.meshes.mesh(&mesh)?);
            }
        }
    }
    let center = rtc_center.unwrap_or(DVec3::ZERO) + cesium_rtc.map_or(DVec3::ZERO, |c| c);
    // CESIUM_RTC is added after the rotation too, since Cesium's exporters write it z-up.
    let rotation = DAffine3 { matrix3: options.gltf_up_axis.z_up(), translation: center };
    Ok(Node::transform(rotation, children))
}

/// Converts the nodes of one glTF.
struct Reader<'a> {
    uri: &'a str,
    max_depth: u32,
    meshes: MeshReader<'a>,
    double: DoublePrecision,
    /// By index of the node: true if it already has a parent.
    is_visited: Vec<bool>,
}

impl Reader<'_> {
    fn bad(&self, reason: impl Into<String>) -> IoError {
        IoError::invalid(self.uri, format!("glTF: {}", reason.into()))
    }

    fn node(&mut self, node: &gltf::Node<'_>, depth: u32) -> Result<Node, IoError> {
        if depth > self.max_depth {
            return Err(self.bad("node tree too deep"));
        }
        if self.is_visited.get_mut(node.index()).is_none_or(|is_visited| std::mem::replace(is_visited, true)) {
            return Err(self.bad(format!("node {} has two parents", node.index())));
        }
        if node.extension_value("EXT_mesh_gpu_instancing").is_some() {
            return Err(IoError::unsupported(self.uri, "glTF extension EXT_mesh_gpu_instancing"));
        }
        let transform = self.double.transform(node.index());
        let transform = transform.ok_or_else(|| self.bad("transform of a node is not affine and finite"))?;
        let mut children = Vec::new();
        if let Some(mesh) = node.mesh() {
            children.push(self.meshes.mesh(&mesh)?);
        }
        if let Some(extras) = node.extras()
            && let Some(occluder) = occluder::of_node(self.uri, node.index(), extras.get())?
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
}
