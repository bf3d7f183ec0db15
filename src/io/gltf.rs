//! glTF 2.0 and glb to nodes: the `gltf` crate parses and validates the JSON, accessors are read here by slices.
//!
//! The crate's own readers cost 151 us for a 65 x 65 tile, slices about 10. glTF is y-up, pages are z-up: the root
//! of what is returned turns it, as 3D Tiles asks.

use std::collections::HashMap;
use std::sync::Arc;

use base64::Engine as _;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Semantic;

use super::gltf_elements::{Elements, attribute_format, columns_and_rows, element_bytes};
use super::gltf_json::Document;
use super::index_lists::{Listed, list_key_of, mode, shared};
use super::{IoError, Limits, ReadOptions, image, occluder};
use crate::math::Aabb;
use crate::scene::{
    AlphaMode, ContentKey, Drawable, Geometry, Material, Mesh, MeshVertex, Node, NodeKind, SharedParts,
    SharedStateManager, VertexAttributes, VertexFormat,
};
use crate::state::WrapMode;

/// Extensions that may be required.
const KNOWN_EXTENSIONS: &[&str] =
    &["KHR_mesh_quantization", "KHR_materials_unlit", "KHR_texture_transform", "CESIUM_RTC"];

/// A primitive takes about as much memory as so many vertices.
const VERTICES_OF_PRIMITIVE: usize = 16;

/// z-up from y-up: (x, y, z) becomes (x, -z, y).
const Z_UP_FROM_Y_UP: DMat3 = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);

/// A binary glTF. `rtc_center` is z-up and added after the turn (b3dm's RTC_CENTER).
pub(crate) fn read_glb(
    uri: &str,
    bytes: &[u8],
    rtc_center: Option<DVec3>,
    options: &ReadOptions,
) -> Result<Node, IoError> {
    let bad = |reason: &str| IoError::invalid(uri, format!("glb: {reason}"));
    let u32_at = |at: usize| -> Option<u32> { Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?)) };
    if !bytes.starts_with(b"glTF") {
        return Err(bad("wrong magic"));
    }
    let version = u32_at(4).ok_or_else(|| bad("truncated header"))?;
    if version != 2 {
        return Err(IoError::unsupported(uri, format!("glb version {version}")));
    }
    let length = u32_at(8).ok_or_else(|| bad("truncated header"))? as usize;
    if length > bytes.len() {
        return Err(bad(&format!("truncated: {} of {length} bytes", bytes.len())));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12usize;
    while at + 8 <= length {
        let size = u32_at(at).ok_or_else(|| bad("truncated chunk"))? as usize;
        let kind = bytes.get(at + 4..at + 8).ok_or_else(|| bad("truncated chunk"))?;
        let end = (at + 8).checked_add(size).filter(|e| *e <= length).ok_or_else(|| bad("chunk beyond the end"))?;
        let data = &bytes[at + 8..end];
        match kind {
            b"JSON" if json.is_none() => json = Some(data),
            b"BIN\0" if binary.is_none() => binary = Some(data),
            _ => {}
        }
        at = end.next_multiple_of(4);
    }
    read(uri, json.ok_or_else(|| bad("no JSON chunk"))?, binary, rtc_center, options)
}

/// A glTF in JSON; its buffers and images must be data: URIs.
pub(crate) fn read_gltf(uri: &str, json: &[u8], options: &ReadOptions) -> Result<Node, IoError> {
    read(uri, json, None, None, options)
}

fn read(
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
        // What is missing may stand in an extension: textures have no source of their own there.
        let required = super::gltf_json::extensions_required(json);
        refused(&required).unwrap_or_else(|| IoError::invalid(uri, format!("glTF JSON: {e}")))
    })?;
    if let Some(error) = refused(&root.extensions_required) {
        return Err(error);
    }
    root.extensions_required.clear();
    // The crate takes for granted what the next two loops check.
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
    // Attributes of unknown names are not drawn and not judged.
    for primitive in root.meshes.iter_mut().flat_map(|m| m.primitives.iter_mut()) {
        primitive.attributes.retain(|semantic, _| matches!(semantic, gltf::json::validation::Checked::Valid(_)));
    }
    let places = Document::read(json, &root).map_err(|e| IoError::invalid(uri, format!("glTF JSON: {e}")))?;
    let cesium_rtc = places.cesium_rtc();
    let document = gltf::Document::from_json(root).map_err(|e| IoError::invalid(uri, format!("glTF: {e}")))?;
    let mut reader = Reader {
        uri,
        buffers: Vec::new(),
        limits: &options.limits,
        sharing: options.sharing.as_deref(),
        kept: &options.vertex_attributes,
        is_met: vec![false; document.nodes().len()],
        places,
        primitives: 0,
        vertices: 0,
        listed: 0,
        image_bytes: 0,
        textures: HashMap::new(),
        indices: HashMap::new(),
    };
    for buffer in document.buffers() {
        let data = match buffer.source() {
            gltf::buffer::Source::Bin if buffer.index() > 0 => {
                return Err(IoError::invalid(uri, format!("glTF: buffer {} has no data", buffer.index())));
            }
            gltf::buffer::Source::Bin => {
                std::borrow::Cow::Borrowed(binary.ok_or_else(|| IoError::invalid(uri, "glTF: no binary chunk"))?)
            }
            gltf::buffer::Source::Uri(reference) => std::borrow::Cow::Owned(data_uri(uri, reference)?),
        };
        if data.len() < buffer.length() {
            let reason = format!("glTF: buffer of {} bytes, {} declared", data.len(), buffer.length());
            return Err(IoError::invalid(uri, reason));
        }
        reader.buffers.push(data);
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
                children.push(reader.mesh(&mesh)?);
            }
        }
    }
    let center = rtc_center.unwrap_or(DVec3::ZERO) + cesium_rtc.map_or(DVec3::ZERO, |c| c);
    // CESIUM_RTC is applied after the turn as well: Cesium's exporters write it z-up.
    let turn = DAffine3 { matrix3: Z_UP_FROM_Y_UP, translation: center };
    Ok(Node::transform(turn, children))
}

/// The bytes of a base64 `data:` URI; anything else is refused.
fn data_uri(uri: &str, reference: &str) -> Result<Vec<u8>, IoError> {
    let data = reference.strip_prefix("data:").and_then(|d| d.split_once(";base64,"));
    let Some((_, text)) = data else {
        return Err(IoError::unsupported(uri, format!("glTF with an external file {:.60}", reference)));
    };
    // Some writers leave the padding out.
    let engine = base64::engine::GeneralPurpose::new(
        &base64::alphabet::STANDARD,
        base64::engine::general_purpose::PAD.with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
    );
    engine.decode(text).map_err(|e| IoError::invalid(uri, format!("glTF: base64 of a data: URI: {e}")))
}

struct Reader<'a> {
    uri: &'a str,
    buffers: Vec<std::borrow::Cow<'a, [u8]>>,
    limits: &'a Limits,
    sharing: Option<&'a SharedStateManager>,
    /// Names of attributes that meshes keep.
    kept: &'a [Arc<str>],
    places: Document,
    /// By node: it hangs somewhere.
    is_met: Vec<bool>,
    /// Drawn so far, with those of meshes that are drawn again.
    primitives: usize,
    vertices: usize,
    /// Of lists made so far: of accessors, and of strips and the like.
    listed: usize,
    /// Of images decoded so far, with their mips.
    image_bytes: u64,
    /// Decoded once a file: image index and wrap.
    textures: HashMap<(usize, [WrapMode; 2]), image::Shared>,
    /// Index accessors shared by primitives.
    indices: HashMap<usize, (Listed, ContentKey)>,
}

impl<'a> Reader<'a> {
    fn bad(&self, reason: impl Into<String>) -> IoError {
        IoError::invalid(self.uri, format!("glTF: {}", reason.into()))
    }

    fn node(&mut self, node: &gltf::Node<'_>, depth: u32) -> Result<Node, IoError> {
        if depth > self.limits.max_depth {
            return Err(self.bad("node tree too deep"));
        }
        if self.is_met.get_mut(node.index()).is_none_or(|is_met| std::mem::replace(is_met, true)) {
            return Err(self.bad(format!("node {} hangs in two places", node.index())));
        }
        if node.extension_value("EXT_mesh_gpu_instancing").is_some() {
            return Err(IoError::unsupported(self.uri, "glTF extension EXT_mesh_gpu_instancing"));
        }
        let transform = self.places.transform(node.index());
        let transform = transform.ok_or_else(|| self.bad("transform of a node is not affine and finite"))?;
        let mut children = Vec::new();
        if let Some(mesh) = node.mesh() {
            children.push(self.mesh(&mesh)?);
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

    fn mesh(&mut self, mesh: &gltf::Mesh<'_>) -> Result<Node, IoError> {
        self.primitives = self.primitives.saturating_add(mesh.primitives().len());
        if self.primitives > self.limits.max_elements / VERTICES_OF_PRIMITIVE {
            return Err(self.bad(format!("{} primitives", self.primitives)));
        }
        let mut drawables = Vec::with_capacity(mesh.primitives().len());
        for primitive in mesh.primitives() {
            drawables.push(self.primitive(&primitive)?);
        }
        Ok(Node::geode(drawables))
    }

    fn primitive(&mut self, primitive: &gltf::Primitive<'_>) -> Result<Drawable, IoError> {
        let positions = primitive.get(&Semantic::Positions).ok_or_else(|| self.bad("primitive without POSITION"))?;
        let count = positions.count();
        self.count_vertices(count)?;
        let material = primitive.material();
        let pbr = material.pbr_metallic_roughness();
        let base_texture = pbr.base_color_texture();
        let uv_transform = base_texture.as_ref().and_then(|t| t.texture_transform());
        let uv_set = base_texture
            .as_ref()
            .map_or(0, |t| uv_transform.as_ref().and_then(|x| x.tex_coord()).unwrap_or_else(|| t.tex_coord()));
        let positions = self.elements(&positions, Dimensions::Vec3)?;
        let normals = self.attribute(primitive, &Semantic::Normals, count, &[Dimensions::Vec3])?;
        let uvs = self.attribute(primitive, &Semantic::TexCoords(uv_set), count, &[Dimensions::Vec2])?;
        let colors = self.attribute(primitive, &Semantic::Colors(0), count, &[Dimensions::Vec3, Dimensions::Vec4])?;
        let (mut min, mut max, mut is_finite) = (Vec3::INFINITY, Vec3::NEG_INFINITY, true);
        let mut vertices = vec![MeshVertex { color: [255; 4], ..MeshVertex::default() }; count];
        positions.read_into(&mut vertices, |vertex, position| {
            vertex.position = position;
            let p = Vec3::from_array(position);
            (min, max) = (min.min(p), max.max(p));
            is_finite &= p.is_finite();
        });
        if !is_finite {
            let first = vertices.iter().position(|vertex| !Vec3::from_array(vertex.position).is_finite());
            return Err(self.bad(format!("position {} is not finite", first.unwrap_or_default())));
        }
        if let Some(normals) = &normals {
            normals.read_into(&mut vertices, |vertex, normal: [f32; 3]| {
                let [x, y, z] = normal.map(snorm8);
                vertex.normal = [x, y, z, 0];
            });
        }
        if let Some(uvs) = &uvs {
            uvs.read_into(&mut vertices, |vertex, uv| vertex.uv = uv);
            if let Some(t) = &uv_transform {
                let ([sx, sy], [ox, oy], (sin, cos)) = (t.scale(), t.offset(), t.rotation().sin_cos());
                for MeshVertex { uv, .. } in &mut vertices {
                    let [u, v] = [uv[0] * sx, uv[1] * sy];
                    *uv = [u * cos + v * sin + ox, v * cos - u * sin + oy];
                }
            }
        }
        if let Some(c) = &colors {
            for (i, vertex) in vertices.iter_mut().enumerate() {
                for k in 0..c.components.min(4) {
                    vertex.color[k] = (c.value(i, k).clamp(0.0, 1.0) * 255.0).round() as u8;
                }
            }
        }
        let packs = vertices.iter().all(MeshVertex::packs);
        let format = match packs {
            true if positions.is_unorm16() => VertexFormat::Quantized,
            true => VertexFormat::Packed,
            false => VertexFormat::Full,
        };
        let attributes = self.kept_attributes(primitive, count)?;
        // Now, while they are in the cache.
        let vertices_key = self.sharing.map(|_| ContentKey::of_vertices(&vertices, &attributes));
        let (listed, list_key) = match primitive.indices() {
            Some(accessor) => self.indices(&accessor, count).map(|(listed, key)| (listed.list, Some(key)))?,
            None => ((0..count as u32).collect(), None),
        };
        let mode = mode(primitive.mode());
        self.count_listed(mode.assembled(listed.len()))?;
        let (topology, indices) = mode.assemble(listed.clone());
        let list_key = list_key.filter(|_| Arc::ptr_eq(&listed, &indices));
        let bounds = if count == 0 { Aabb::EMPTY } else { Aabb { min: min.as_dvec3(), max: max.as_dvec3() } };
        let (texture, shared_texture) = match base_texture {
            Some(t) => self.texture(&t.texture()).map(|(image, shared)| (Some(image), shared))?,
            None => (None, None),
        };
        let material = Material {
            base_color: pbr.base_color_factor(),
            texture,
            alpha: match material.alpha_mode() {
                gltf::material::AlphaMode::Opaque => AlphaMode::Opaque,
                gltf::material::AlphaMode::Mask => AlphaMode::Mask(material.alpha_cutoff().unwrap_or(0.5)),
                gltf::material::AlphaMode::Blend => AlphaMode::Blend,
            },
            double_sided: material.double_sided(),
            unlit: material.unlit(),
        };
        let mut mesh = Arc::new(Mesh { vertices, indices, topology, bounds, attributes });
        let (geometry, indices) = match (self.sharing, vertices_key) {
            (Some(sharing), Some(vertices_key)) => {
                let list_key = list_key.unwrap_or_else(|| list_key_of(&mesh.indices));
                sharing.mesh(&mut mesh, &vertices_key, &list_key)
            }
            _ => (None, None),
        };
        let mut drawable = Drawable::new(Geometry::Mesh(mesh), material);
        drawable.shared = SharedParts { geometry, indices, texture: shared_texture };
        Ok(drawable.with_vertex_format(format))
    }

    /// Counts vertices before there is memory for them.
    fn count_vertices(&mut self, count: usize) -> Result<(), IoError> {
        self.vertices = self.vertices.saturating_add(count);
        if self.vertices > self.limits.max_elements {
            return Err(self.bad(format!("{} vertices", self.vertices)));
        }
        Ok(())
    }

    /// The attributes that are to be kept, in the order asked for. Matrices are kept column by column.
    fn kept_attributes(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        vertices: usize,
    ) -> Result<VertexAttributes, IoError> {
        let mut attributes = VertexAttributes::default();
        for name in self.kept {
            let named = |(semantic, _): &(Semantic, gltf::Accessor<'_>)| semantic.to_string() == **name;
            let Some((_, accessor)) = primitive.attributes().find(named) else { continue };
            let (count, dimensions) = (accessor.count(), accessor.dimensions());
            let (columns, rows) = columns_and_rows(dimensions);
            let Some(format) = attribute_format(accessor.data_type(), accessor.normalized(), rows) else { continue };
            if count != vertices {
                return Err(self.bad(format!("{name} has {count} elements for {vertices} vertices")));
            }
            let bytes = columns * format.size_bytes();
            self.count_vertices(vertices.saturating_mul(bytes).div_ceil(size_of::<MeshVertex>()))?;
            for column in 0..columns {
                let elements = self.elements(&accessor, dimensions)?.column(column, rows).padded(format.size_bytes());
                let name = if columns > 1 { format!("{name}_{column}") } else { name.to_string() };
                attributes.push(vertices, &name, format, elements).map_err(|error| self.bad(error.to_string()))?;
            }
        }
        Ok(attributes)
    }

    fn attribute(
        &self,
        primitive: &gltf::Primitive<'_>,
        semantic: &Semantic,
        count: usize,
        dimensions: &[Dimensions],
    ) -> Result<Option<Elements<'_>>, IoError> {
        let Some(accessor) = primitive.get(semantic) else { return Ok(None) };
        let dimension = accessor.dimensions();
        if !dimensions.contains(&dimension) || accessor.count() != count {
            return Err(self.bad(format!("{} has the wrong type or count", semantic.to_string())));
        }
        self.elements(&accessor, dimension).map(Some)
    }

    /// The bytes of an accessor, every offset, stride and count checked.
    fn elements(&self, accessor: &gltf::Accessor<'_>, dimensions: Dimensions) -> Result<Elements<'_>, IoError> {
        if accessor.dimensions() != dimensions {
            return Err(self.bad("accessor of the wrong type"));
        }
        if accessor.sparse().is_some() {
            return Err(IoError::unsupported(self.uri, "sparse accessor"));
        }
        let view = accessor.view().ok_or_else(|| IoError::unsupported(self.uri, "accessor without a bufferView"))?;
        let (count, (size, tight)) = (accessor.count(), element_bytes(accessor.data_type(), dimensions));
        let stride = view.stride().unwrap_or(tight);
        let outside = || self.bad("accessor reaches beyond its buffer");
        if stride < size {
            return Err(self.bad("byteStride below the element's size"));
        }
        let needed = match count {
            0 => 0,
            n => (n - 1).checked_mul(stride).and_then(|b| b.checked_add(size)).ok_or_else(outside)?,
        };
        let end = accessor.offset().checked_add(needed).ok_or_else(outside)?;
        if end > view.length() {
            return Err(outside());
        }
        let begin = view.offset().checked_add(accessor.offset()).ok_or_else(outside)?;
        let buffer = self.buffers.get(view.buffer().index()).ok_or_else(outside)?;
        let bytes = begin.checked_add(needed).and_then(|end| buffer.get(begin..end)).ok_or_else(outside)?;
        Ok(Elements {
            bytes,
            stride,
            count,
            components: dimensions.multiplicity(),
            data_type: accessor.data_type(),
            normalized: accessor.normalized(),
        })
    }

    fn indices(&mut self, accessor: &gltf::Accessor<'_>, vertices: usize) -> Result<(Listed, ContentKey), IoError> {
        let known = self.indices.get(&accessor.index()).cloned();
        let indices = match known {
            Some(indices) => indices,
            None => {
                let e = self.elements(accessor, Dimensions::Scalar)?;
                if e.count > self.limits.max_elements {
                    return Err(self.bad(format!("{} indices", e.count)));
                }
                let count = e.count;
                self.count_listed(count)?;
                let e = self.elements(accessor, Dimensions::Scalar)?;
                let layout = [e.stride as u64, e.count as u64, e.data_type.size() as u64];
                let key = ContentKey::of(&[e.bytes, bytemuck::cast_slice(&layout)]);
                let at = |i: usize, n: usize| e.bytes.get(i * e.stride + n).copied().unwrap_or(0);
                let read = || -> Option<Arc<[u32]>> {
                    Some(match e.data_type {
                        DataType::U8 => (0..e.count).map(|i| u32::from(at(i, 0))).collect(),
                        DataType::U16 => {
                            (0..e.count).map(|i| u32::from(u16::from_le_bytes([at(i, 0), at(i, 1)]))).collect()
                        }
                        DataType::U32 => {
                            (0..e.count).map(|i| u32::from_le_bytes([at(i, 0), at(i, 1), at(i, 2), at(i, 3)])).collect()
                        }
                        _ => return None,
                    })
                };
                let is_unsigned = matches!(e.data_type, DataType::U8 | DataType::U16 | DataType::U32);
                let list = if is_unsigned { shared(key, read) } else { None };
                let listed = list.ok_or_else(|| self.bad("indices of a signed or float type"))?;
                self.indices.insert(accessor.index(), (listed.clone(), key));
                (listed, key)
            }
        };
        match indices.0.largest {
            Some(largest) if largest as usize >= vertices => {
                Err(self.bad(format!("index {largest} of {vertices} vertices")))
            }
            _ => Ok(indices),
        }
    }

    /// Counts indices before there is memory for them.
    fn count_listed(&mut self, indices: usize) -> Result<(), IoError> {
        self.listed = self.listed.saturating_add(indices);
        if self.listed > self.limits.max_elements.saturating_mul(8) {
            return Err(self.bad(format!("{} indices", self.listed)));
        }
        Ok(())
    }

    fn texture(&mut self, texture: &gltf::Texture<'_>) -> Result<image::Shared, IoError> {
        use gltf::texture::WrappingMode::{ClampToEdge, MirroredRepeat, Repeat};
        let sampler = texture.sampler();
        let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
            ClampToEdge => WrapMode::ClampToEdge,
            MirroredRepeat => WrapMode::Mirror,
            Repeat => WrapMode::Repeat,
        });
        let source = texture.source();
        let key = (source.index(), wrap);
        if let Some(known) = self.textures.get(&key) {
            return Ok(known.clone());
        }
        let limit = self.limits.max_image_bytes.saturating_mul(4);
        if self.image_bytes > limit {
            let (uri, got) = (self.uri.to_owned(), self.image_bytes);
            return Err(IoError::TooLarge { uri, what: "images of a glTF", got, limit });
        }
        let decoded = match source.source() {
            gltf::image::Source::View { view, .. } => {
                let outside = || self.bad("image reaches beyond its buffer");
                let buffer = self.buffers.get(view.buffer().index()).ok_or_else(outside)?;
                let end = view.offset().checked_add(view.length()).ok_or_else(outside)?;
                let bytes = buffer.get(view.offset()..end).ok_or_else(outside)?;
                image::decode_shared(self.uri, bytes, wrap, self.limits, self.sharing)?
            }
            gltf::image::Source::Uri { uri, .. } => {
                image::decode_shared(self.uri, &data_uri(self.uri, uri)?, wrap, self.limits, self.sharing)?
            }
        };
        self.image_bytes += decoded.0.mips.iter().map(|mip| mip.len() as u64).sum::<u64>();
        self.textures.insert(key, decoded.clone());
        Ok(decoded)
    }
}

/// Rounded to the nearest: among numbers of 2^23 to 2^24, a whole is the lowest bit.
fn snorm8(x: f32) -> i8 {
    (x.clamp(-1.0, 1.0) * 127.0 + 12_582_912.0).to_bits() as i8
}
