//! Instanced 3D Model (3D Tiles 1.0, `i3dm`): a header, tables, and a glTF that is drawn once for each instance. Decode
//! threads.
//!
//! Every instance becomes a transform above drawables that all instances share, so that the mesh is decoded and uploaded
//! once. Positions are z-up in the tile's frame; the model is rotated to z-up before its instance transform applies.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use serde::Deserialize;

use super::gltf::{self, GltfSource};
use super::ignored::Notes;
use super::options::{Fetched, ReadOptions};
use super::properties;
use super::properties::feature_table::{self, BinaryOffset, Global};
use crate::fetch::{IoError, Limits, about_to_allocate, resolve};
use crate::math::Ellipsoid;
use crate::scene::{Drawable, FeatureIdSet, FeatureIds, Node, NodeKind, PropertyTable};
use crate::state::StateSet;

const HEADER_BYTES: usize = 32;
/// An instance takes about as much memory as this many vertices.
const VERTICES_PER_INSTANCE: usize = 16;
/// The bytes that an instance takes beside what it draws: its position, directions and transform.
const INSTANCE_BYTES: u64 = 192;

#[derive(Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
struct FeatureTable {
    instances_length: Global<usize>,
    position: Option<BinaryOffset>,
    position_quantized: Option<BinaryOffset>,
    quantized_volume_offset: Option<Global<[f64; 3]>>,
    quantized_volume_scale: Option<Global<[f64; 3]>>,
    normal_up: Option<BinaryOffset>,
    normal_right: Option<BinaryOffset>,
    normal_up_oct32p: Option<BinaryOffset>,
    normal_right_oct32p: Option<BinaryOffset>,
    scale: Option<BinaryOffset>,
    scale_non_uniform: Option<BinaryOffset>,
    rtc_center: Option<Global<[f64; 3]>>,
    #[serde(default)]
    east_north_up: bool,
    batch_id: Option<BatchId>,
}

/// The column of batch ids.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BatchId {
    byte_offset: usize,
    component_type: Option<String>,
}

/// The parts of an i3dm.
struct Parts<'a> {
    feature_json: &'a [u8],
    feature_binary: &'a [u8],
    batch_json: &'a [u8],
    batch_binary: &'a [u8],
    model: Model<'a>,
}

enum Model<'a> {
    /// A glTF or glb inside of the file.
    Embedded(&'a [u8]),
    /// A reference to a glTF or glb.
    Reference(&'a str),
}

impl<'a> Parts<'a> {
    fn new(uri: &str, bytes: &'a [u8]) -> Result<Self, IoError> {
        let truncated = || IoError::invalid(uri, "i3dm: truncated header");
        let word =
            |at: usize| -> Option<usize> { Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize) };
        let version = word(4).ok_or_else(truncated)?;
        if version != 1 {
            return Err(IoError::unsupported(uri, format!("i3dm version {version}")));
        }
        let mut at = HEADER_BYTES;
        let mut parts = [&bytes[..0]; 4];
        for (i, part) in parts.iter_mut().enumerate() {
            let end = word(12 + 4 * i).and_then(|length| at.checked_add(length)).ok_or_else(truncated)?;
            *part = bytes.get(at..end).ok_or_else(|| IoError::invalid(uri, "i3dm: truncated tables"))?;
            at = end;
        }
        let [feature_json, feature_binary, batch_json, batch_binary] = parts;
        // Padding after the declared length belongs to whatever holds the file.
        let end = word(8).filter(|length| (at..=bytes.len()).contains(length)).unwrap_or(bytes.len());
        let body = &bytes[at..end];
        let model = match word(28) {
            Some(0) => {
                let text = std::str::from_utf8(body).map_err(|_| IoError::invalid(uri, "i3dm: URI is not UTF-8"))?;
                Model::Reference(text.trim_matches(|c: char| c.is_ascii_whitespace() || c == '\0'))
            }
            Some(1) => Model::Embedded(body),
            format => return Err(IoError::unsupported(uri, format!("i3dm with glTF format {format:?}"))),
        };
        Ok(Self { feature_json, feature_binary, batch_json, batch_binary, model })
    }
}

/// Returns the files that an i3dm refers to: its model, and once that is in `known`, the buffers and images of the model.
/// References that are not allowed are left out.
pub(super) fn dependencies(uri: &str, bytes: &[u8], known: &[Fetched], options: &ReadOptions) -> Vec<Arc<str>> {
    let Ok(parts) = Parts::new(uri, bytes) else { return Vec::new() };
    let of_model = |model_uri: &str, model: &[u8]| -> Vec<Arc<str>> {
        let references = gltf::references(model_uri, model, options);
        references.iter().filter_map(|reference| resolve(model_uri, reference, &options.root).ok()).collect()
    };
    match parts.model {
        Model::Embedded(model) => of_model(uri, model),
        Model::Reference(reference) => {
            let Ok(model_uri) = resolve(uri, reference, &options.root) else { return Vec::new() };
            match known.iter().find(|(fetched, _)| *fetched == model_uri) {
                Some((_, Ok(model))) => of_model(&model_uri, model),
                _ => vec![model_uri],
            }
        }
    }
}

/// Reads an i3dm as one transform per instance. The first argument is its address, and the one that references are relative
/// to.
pub(super) fn read(
    (uri, base): (&str, &str),
    bytes: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    let Parts { feature_json, feature_binary, batch_json, batch_binary, model } = Parts::new(uri, bytes)?;
    options.limits.check_json(uri, feature_json)?;
    let bad = |e: serde_json::Error| IoError::invalid(uri, format!("i3dm feature table: {e}"));
    let (table, feature_binary) = feature_table::parse_columns(feature_json, feature_binary).map_err(bad)?;
    let table: FeatureTable = table;
    let ReadOptions { limits, ellipsoid, .. } = options;
    let reader = TableReader { uri, binary: &feature_binary, table: &table, limits, ellipsoid: *ellipsoid };
    let (origin, instances) = reader.instances()?;
    let source = |uri, base, bytes| GltfSource { uri, base, bytes, rtc_center: None, batch_table: None, companions };
    let model = match model {
        Model::Embedded(bytes) => gltf::read(source(uri, base, bytes), options, notes)?,
        Model::Reference(reference) => {
            let model_uri = resolve(base, reference, &options.root)?;
            let known = companions.iter().find(|(fetched, _)| *fetched == model_uri);
            let (_, bytes) = known.ok_or_else(|| IoError::NotFound { uri: model_uri.to_string() })?;
            gltf::read(source(&model_uri, &model_uri, bytes.as_ref().map_err(IoError::clone)?), options, notes)?
        }
    };
    let mut parts = Vec::new();
    collect_parts(model, DAffine3::IDENTITY, &mut parts, notes);
    let drawn = instances.len().saturating_mul(parts.iter().map(|part| part.drawables.len()).sum());
    if drawn > options.limits.max_elements / VERTICES_PER_INSTANCE {
        return Err(IoError::invalid(uri, format!("i3dm: {drawn} instances of primitives")));
    }
    // Each part has two nodes, which become entries of the page's arrays.
    let of_parts = 2 * (2 * size_of::<Node>() * parts.len()) as u64;
    let of_drawables = (2 * size_of::<Drawable>() * drawn) as u64;
    about_to_allocate(of_parts.saturating_mul(instances.len() as u64).saturating_add(of_drawables))
        .map_err(|error| error.at(uri))?;
    let mut children = Vec::with_capacity(instances.len() * parts.len());
    let features = match options.keep_features {
        true => Some(InstanceFeatures::new(&reader, instances.len(), batch_json, batch_binary, notes)?),
        false => None,
    };
    for (i, instance) in instances.iter().enumerate() {
        for ModelPart { map, state_set, drawables } in &parts {
            let mut drawables = drawables.clone();
            if let Some(features) = &features {
                drawables.iter_mut().for_each(|drawable| features.add_to(drawable, i));
            }
            let geode = Node { state_set: state_set.clone(), ..Node::geode(drawables) };
            children.push(Node::transform(*instance * *map, vec![geode]));
        }
    }
    Ok(Node::transform(DAffine3::from_translation(origin), children))
}

/// The batch ids of the instances, and their properties.
struct InstanceFeatures {
    ids: Vec<u32>,
    table: Option<Arc<PropertyTable>>,
}

impl InstanceFeatures {
    /// Reads batch ids and batch table. Without batch ids, the number of an instance is its id.
    fn new(reader: &TableReader<'_>, count: usize, json: &[u8], binary: &[u8], notes: &Notes) -> Result<Self, IoError> {
        let ids: Vec<u32> = reader.batch_ids(count)?.unwrap_or_else(|| (0..count as u32).collect());
        let rows = ids.iter().max().map_or(0, |largest| *largest as usize + 1);
        let table = properties::batch_table(json, binary, rows, reader.limits, &|kind| notes.add(kind)).map(Arc::new);
        Ok(Self { ids, table })
    }

    /// Adds the feature of an instance to those of the model.
    fn add_to(&self, drawable: &mut Drawable, instance: usize) {
        let mut features = drawable.features.as_deref().cloned().unwrap_or_default();
        let table = self.table.is_some().then_some(features.tables.len());
        features.tables = features.tables.iter().cloned().chain(self.table.clone()).collect();
        let ids = FeatureIds::Uniform(self.ids.get(instance).copied().unwrap_or_default());
        features.sets.insert(0, FeatureIdSet { label: String::new(), null_id: None, ids, table });
        drawable.features = Some(Arc::new(features));
    }
}

/// Drawables of the model.
struct ModelPart {
    /// The transform to the model's frame.
    map: DAffine3,
    state_set: Option<Arc<StateSet>>,
    drawables: Vec<Drawable>,
}

/// Collects the drawables of a model.
fn collect_parts(node: Node, above: DAffine3, parts: &mut Vec<ModelPart>, notes: &Notes) {
    let map = match node.kind {
        NodeKind::Transform(map) => above * map,
        NodeKind::Geode(drawables) => {
            parts.push(ModelPart { map: above, state_set: node.state_set, drawables });
            above
        }
        NodeKind::Group => above,
        NodeKind::LocalLights(_) => {
            notes.add("i3dm: lights of the model");
            above
        }
        _ => {
            notes.add("i3dm: occluders of the model");
            above
        }
    };
    for child in node.children {
        collect_parts(child, map, parts, notes);
    }
}

/// Reads the columns of a feature table.
struct TableReader<'a> {
    uri: &'a str,
    binary: &'a [u8],
    table: &'a FeatureTable,
    limits: &'a Limits,
    /// The ellipsoid of the set, on which instances face east and north.
    ellipsoid: Ellipsoid,
}

impl TableReader<'_> {
    fn bad(&self, reason: &str) -> IoError {
        IoError::invalid(self.uri, format!("i3dm: {reason}"))
    }

    /// Returns the bytes of `N`-byte elements; `None` if the column is missing.
    fn column<const N: usize>(&self, at: &Option<BinaryOffset>, count: usize) -> Result<Option<&[[u8; N]]>, IoError> {
        let Some(BinaryOffset { byte_offset }) = *at else { return Ok(None) };
        let end = count.checked_mul(N).and_then(|size| size.checked_add(byte_offset));
        let bytes = end.and_then(|end| self.binary.get(byte_offset..end));
        let outside = || self.bad("a column reaches beyond the binary part of the feature table");
        bytes.map(|bytes| Some(bytes.as_chunks().0)).ok_or_else(outside)
    }

    fn vector(&self, global: &Option<Global<[f64; 3]>>, name: &str) -> Result<Option<DVec3>, IoError> {
        let Some(global) = global else { return Ok(None) };
        let vector = global.vector(self.binary).ok_or_else(|| self.bad(&format!("{name} is invalid")))?;
        Ok(Some(DVec3::from_array(vector)))
    }

    /// Returns the origin of the instances in the tile's frame, and their transforms relative to it.
    fn instances(&self) -> Result<(DVec3, Vec<DAffine3>), IoError> {
        let table = self.table;
        let count = table.instances_length.count(self.binary).ok_or_else(|| self.bad("INSTANCES_LENGTH is invalid"))?;
        if count > self.limits.max_elements / VERTICES_PER_INSTANCE {
            return Err(self.bad(&format!("{count} instances")));
        }
        about_to_allocate(INSTANCE_BYTES * count as u64).map_err(|error| error.at(self.uri))?;
        let center = self.vector(&table.rtc_center, "RTC_CENTER")?.unwrap_or_default();
        let (origin, positions) = self.positions(count, center)?;
        let up = self.directions(&table.normal_up, &table.normal_up_oct32p, count)?;
        let right = self.directions(&table.normal_right, &table.normal_right_oct32p, count)?;
        let scales = self.column::<4>(&table.scale, count)?;
        let axis_scales = self.column::<12>(&table.scale_non_uniform, count)?;
        let mut instances = Vec::with_capacity(count);
        for (i, position) in positions.into_iter().enumerate() {
            let rotation = match (&up, &right) {
                (Some(up), Some(right)) => basis(up[i], right[i]),
                // The centre of the earth has no directions; these are Cesium's there.
                _ if table.east_north_up && origin + position == DVec3::ZERO => {
                    DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z)
                }
                _ if table.east_north_up => {
                    self.ellipsoid.ecef_from_enu(&self.ellipsoid.geodetic(origin + position)).matrix3
                }
                _ => DMat3::IDENTITY,
            };
            let scale = scales.map_or(1.0, |scales| f64::from(f32::from_le_bytes(scales[i])));
            let scale = axis_scales.map_or(DVec3::ONE, |scales| floats(&scales[i])) * scale;
            let instance = DAffine3 { matrix3: rotation * DMat3::from_diagonal(scale), translation: position };
            if !instance.is_finite() {
                return Err(self.bad(&format!("instance {i} is not finite")));
            }
            instances.push(instance);
        }
        Ok((origin, instances))
    }

    /// Returns the batch ids; `None` if there are none.
    fn batch_ids(&self, count: usize) -> Result<Option<Vec<u32>>, IoError> {
        let Some(BatchId { byte_offset, component_type }) = &self.table.batch_id else { return Ok(None) };
        let at = Some(BinaryOffset { byte_offset: *byte_offset });
        match component_type.as_deref() {
            Some("UNSIGNED_BYTE") => {
                let ids = self.column::<1>(&at, count)?;
                Ok(ids.map(|ids| ids.iter().map(|id| u32::from(id[0])).collect()))
            }
            None | Some("UNSIGNED_SHORT") => {
                let ids = self.column::<2>(&at, count)?;
                Ok(ids.map(|ids| ids.iter().map(|id| u32::from(u16::from_le_bytes(*id))).collect()))
            }
            Some("UNSIGNED_INT") => {
                let ids = self.column::<4>(&at, count)?;
                Ok(ids.map(|ids| ids.iter().map(|id| u32::from_le_bytes(*id)).collect()))
            }
            Some(_) => Err(self.bad("BATCH_ID has an invalid component type")),
        }
    }

    /// Returns the origin of the positions, and the positions relative to it.
    fn positions(&self, count: usize, center: DVec3) -> Result<(DVec3, Vec<DVec3>), IoError> {
        let table = self.table;
        if let Some(positions) = self.column::<12>(&table.position, count)? {
            return Ok((center, positions.iter().map(floats).collect()));
        }
        let Some(positions) = self.column::<6>(&table.position_quantized, count)? else {
            return Err(self.bad("neither POSITION nor POSITION_QUANTIZED"));
        };
        let offset = self.vector(&table.quantized_volume_offset, "QUANTIZED_VOLUME_OFFSET")?;
        let scale = self.vector(&table.quantized_volume_scale, "QUANTIZED_VOLUME_SCALE")?;
        let (Some(offset), Some(scale)) = (offset, scale) else {
            return Err(self.bad("POSITION_QUANTIZED without QUANTIZED_VOLUME_OFFSET and QUANTIZED_VOLUME_SCALE"));
        };
        let step = scale / 65535.0;
        let position =
            |b: &[u8; 6]| DVec3::from_array([0, 2, 4].map(|k| f64::from(u16::from_le_bytes([b[k], b[k + 1]])))) * step;
        Ok((center + offset, positions.iter().map(position).collect()))
    }

    /// Returns unit vectors, stored as floats or folded onto an octahedron; `None` if there are none.
    fn directions(
        &self,
        plain: &Option<BinaryOffset>,
        oct32p: &Option<BinaryOffset>,
        count: usize,
    ) -> Result<Option<Vec<DVec3>>, IoError> {
        if let Some(directions) = self.column::<12>(plain, count)? {
            return Ok(Some(directions.iter().map(floats).collect()));
        }
        let folded = self.column::<4>(oct32p, count)?;
        Ok(folded.map(|folded| folded.iter().map(|b| unfold([b[0], b[1]], [b[2], b[3]])).collect()))
    }
}

/// Returns the rotation that maps y to `up` and x to `right`, or the identity if they span no plane.
fn basis(up: DVec3, right: DVec3) -> DMat3 {
    let forward = right.cross(up).try_normalize();
    let (Some(up), Some(forward)) = (up.try_normalize(), forward) else { return DMat3::IDENTITY };
    DMat3::from_cols(up.cross(forward), up, forward)
}

/// Decodes a unit vector that is folded onto an octahedron (Meyer et al., "On Floating-Point Normal Vectors", 2010), two bytes
/// per coordinate.
fn unfold(x: [u8; 2], y: [u8; 2]) -> DVec3 {
    let [x, y] = [x, y].map(|part| f64::from(u16::from_le_bytes(part)) / 65535.0 * 2.0 - 1.0);
    let z = 1.0 - x.abs() - y.abs();
    let fold = |a: f64, b: f64| (1.0 - b.abs()) * if a < 0.0 { -1.0 } else { 1.0 };
    let (x, y) = if z < 0.0 { (fold(x, y), fold(y, x)) } else { (x, y) };
    DVec3::new(x, y, z).normalize_or_zero()
}

fn floats(bytes: &[u8; 12]) -> DVec3 {
    let part = |k: usize| f64::from(f32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]));
    DVec3::new(part(0), part(4), part(8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folded_directions_are_unit_vectors() {
        let middle = 32768u16.to_le_bytes();
        let end = u16::MAX.to_le_bytes();
        for (x, y, expected) in [
            (middle, middle, DVec3::Z),
            (end, middle, DVec3::X),
            (middle, end, DVec3::Y),
            ([0, 0], middle, DVec3::NEG_X),
            (end, end, DVec3::NEG_Z),
        ] {
            assert!(unfold(x, y).distance(expected) < 1e-4, "{expected}");
        }
    }

    #[test]
    fn directions_that_span_no_plane_do_not_rotate() {
        assert_eq!(basis(DVec3::Y, DVec3::X), DMat3::IDENTITY);
        for (up, right) in [(DVec3::ZERO, DVec3::X), (DVec3::X, DVec3::X), (DVec3::NAN, DVec3::X)] {
            assert_eq!(basis(up, right), DMat3::IDENTITY);
        }
        let turned = basis(DVec3::Z, DVec3::X);
        assert_eq!((turned * DVec3::Y, turned * DVec3::X), (DVec3::Z, DVec3::X));
        assert!((turned.determinant() - 1.0).abs() < 1e-12);
    }
}
