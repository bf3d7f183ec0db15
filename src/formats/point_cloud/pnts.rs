//! Point Cloud (3D Tiles 1.0, `pnts`): a header, and a feature table of positions, colours, normals and batch ids, plain or
//! compressed with Draco, and a batch table. Positions are z-up in the tile's frame. Decode threads.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec2, Vec3};
use serde::Deserialize;

use super::draco::{DracoJson, DracoPoints};
use crate::fetch::{IoError, Limits, about_to_allocate};
use crate::formats::ignored::Notes;
use crate::formats::options::ReadOptions;
use crate::formats::properties;
use crate::formats::properties::feature_table::{self, BinaryOffset, Global};
use crate::math::Aabb;
use crate::math::color::linear_from_srgb8;
use crate::scene::{
    AlphaMode, AttributeFormat, Drawable, DrawableFeatures, FeatureIdSet, FeatureIds, Geometry, Material, Mesh,
    MeshVertex, Node, Topology,
};

const HEADER_BYTES: usize = 28;
/// The bytes that a point takes: its position, normal and colour as read, its vertex, index and batch id.
const POINT_BYTES: u64 = 72;
/// The vertex attribute that batch ids become, if the application asks for it.
const BATCH_ID_ATTRIBUTE: &str = "_BATCHID";

#[derive(Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
struct FeatureTable {
    points_length: Global<usize>,
    position: Option<BinaryOffset>,
    position_quantized: Option<BinaryOffset>,
    quantized_volume_offset: Option<Global<[f64; 3]>>,
    quantized_volume_scale: Option<Global<[f64; 3]>>,
    rtc_center: Option<Global<[f64; 3]>>,
    rgba: Option<BinaryOffset>,
    rgb: Option<BinaryOffset>,
    rgb565: Option<BinaryOffset>,
    constant_rgba: Option<Global<[u8; 4]>>,
    normal: Option<BinaryOffset>,
    normal_oct16p: Option<BinaryOffset>,
    batch_id: Option<BatchIds>,
    batch_length: Option<Global<usize>>,
    #[serde(rename = "extensions")]
    extensions: Option<Extensions>,
}

/// The column of batch ids.
#[derive(Clone, Deserialize)]
#[serde(rename_all = "camelCase")]
struct BatchIds {
    byte_offset: usize,
    component_type: Option<String>,
}

#[derive(Deserialize)]
struct Extensions {
    #[serde(rename = "3DTILES_draco_point_compression", default)]
    draco: Option<DracoJson>,
}

/// Reads a point cloud as one drawable.
pub(in crate::formats) fn read(uri: &str, bytes: &[u8], options: &ReadOptions, notes: &Notes) -> Result<Node, IoError> {
    let bad = |reason: &str| IoError::invalid(uri, format!("pnts: {reason}"));
    let word =
        |at: usize| -> Option<usize> { Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize) };
    if word(4) != Some(1) {
        return Err(IoError::unsupported(uri, "pnts of another version than 1"));
    }
    let (json_bytes, binary_bytes) = word(12).zip(word(16)).ok_or_else(|| bad("truncated header"))?;
    let json_end = HEADER_BYTES.checked_add(json_bytes).ok_or_else(|| bad("the lengths in the header overflow"))?;
    let json = bytes.get(HEADER_BYTES..json_end).ok_or_else(|| bad("truncated feature table"))?;
    let end = json_end.checked_add(binary_bytes).ok_or_else(|| bad("the lengths in the header overflow"))?;
    let binary = bytes.get(json_end..end).ok_or_else(|| bad("truncated feature table"))?;
    options.limits.check_json(uri, json)?;
    let invalid = |e: serde_json::Error| IoError::invalid(uri, format!("pnts feature table: {e}"));
    let (table, binary) = feature_table::parse_columns(json, binary).map_err(invalid)?;
    let (table, binary): (FeatureTable, &[u8]) = (table, &binary);
    let count = table.points_length.count(binary).ok_or_else(|| bad("POINTS_LENGTH is invalid"))?;
    if count > options.limits.max_elements {
        return Err(bad(&format!("{count} points")));
    }
    about_to_allocate(POINT_BYTES * count as u64).map_err(|error| error.at(uri))?;
    let draco = table.extensions.as_ref().and_then(|extensions| extensions.draco.as_ref());
    let draco = draco.map(|json| DracoPoints::decode(uri, json, binary, count)).transpose()?;
    let column = |place: &Option<BinaryOffset>, size: usize| -> Result<Option<&[u8]>, IoError> {
        let Some(place) = place else { return Ok(None) };
        let end = count.checked_mul(size).and_then(|n| n.checked_add(place.byte_offset));
        end.and_then(|end| binary.get(place.byte_offset..end))
            .map(Some)
            .ok_or_else(|| bad("a column reaches beyond the binary part of the feature table"))
    };
    let vector = |global: &Option<Global<[f64; 3]>>, name: &str| -> Result<Option<DVec3>, IoError> {
        let Some(global) = global else { return Ok(None) };
        global.vector(binary).map(|v| Some(DVec3::from_array(v))).ok_or_else(|| bad(&format!("{name} is invalid")))
    };
    let (positions, origin) = match draco.as_ref().and_then(DracoPoints::positions) {
        Some(points) => (points, vector(&table.rtc_center, "RTC_CENTER")?.unwrap_or_default()),
        None => positions(&table, &column, &vector, &bad)?,
    };
    let compressed = draco.as_ref().and_then(DracoPoints::normals);
    let normals = match compressed {
        Some(normals) => Some(normals),
        None => match (column(&table.normal, 12)?, column(&table.normal_oct16p, 2)?) {
            (Some(data), _) => Some(data.chunks_exact(12).map(vec3).collect::<Vec<_>>()),
            (None, Some(data)) => Some(data.chunks_exact(2).map(|b| oct16p(b[0], b[1])).collect()),
            (None, None) => None,
        },
    };
    let constant = match table.constant_rgba {
        Some(global) => global.bytes(binary).ok_or_else(|| bad("CONSTANT_RGBA is invalid"))?,
        None => [255; 4],
    };
    let compressed = draco.as_ref().and_then(DracoPoints::colors);
    let colors: Vec<[u8; 4]> = match compressed {
        Some(colors) => colors,
        None => match (column(&table.rgba, 4)?, column(&table.rgb, 3)?, column(&table.rgb565, 2)?) {
            (Some(data), _, _) => data.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]).collect(),
            (_, Some(data), _) => data.chunks_exact(3).map(|c| [c[0], c[1], c[2], 255]).collect(),
            (_, _, Some(data)) => data.chunks_exact(2).map(|c| rgb565(u16::from_le_bytes([c[0], c[1]]))).collect(),
            _ => vec![constant; count],
        },
    };
    let mut mesh = mesh_of(positions, normals.as_deref(), colors);
    let invalid = mesh.vertices.len() - mesh.indices.len();
    if invalid > 0 && mesh.indices.is_empty() {
        return Err(bad("no position is finite"));
    }
    notes.add_count("pnts: point that is not drawn because its position is not finite", invalid as u64);
    let wants_attribute = options.vertex_attributes.iter().any(|name| **name == *BATCH_ID_ATTRIBUTE);
    let ids = match draco.as_ref().and_then(DracoPoints::batch_ids) {
        Some(ids) => Some(ids),
        None if wants_attribute || options.keep_features => batch_ids(&table, &column, &bad)?,
        None => None,
    };
    if wants_attribute && let Some(ids) = &ids {
        let added = mesh.with_attribute(BATCH_ID_ATTRIBUTE, AttributeFormat::Uint32, ids);
        mesh = added.map_err(|error| bad(&error.to_string()))?;
    }
    let features = options.keep_features.then(|| {
        let rows = match (&ids, table.batch_length) {
            (Some(ids), None) => ids.iter().max().map_or(0, |largest| *largest as usize + 1),
            (Some(_), Some(length)) => length.count(binary).unwrap_or(0),
            // Without batch ids the table has a row for each point.
            (None, _) => count,
        };
        let lengths = [20, 24].map(|at| word(at).unwrap_or(0));
        features_of(bytes.get(end..).unwrap_or_default(), lengths, rows, ids, (&options.limits, notes))
    });
    let alpha = match mesh.vertices.iter().all(|vertex| vertex.color[3] == u8::MAX) {
        true => AlphaMode::Opaque,
        false => AlphaMode::Blend,
    };
    let material = Material { unlit: normals.is_none(), alpha, ..Material::default() };
    let mut drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), material);
    drawable.features = features;
    let geode = Node::geode(vec![drawable]);
    Ok(Node::transform(DAffine3::from_translation(origin), vec![geode]))
}

/// Returns a mesh of points with colours in sRGB. A point whose position is not finite keeps its vertex, which no index refers
/// to, so that features still go by the number of a point.
fn mesh_of(positions: Vec<Vec3>, normals: Option<&[Vec3]>, colors: Vec<[u8; 4]>) -> Mesh {
    let mut bounds = Aabb::EMPTY;
    let mut vertices = Vec::with_capacity(positions.len());
    let mut indices = Vec::with_capacity(positions.len());
    for (i, (mut position, [red, green, blue, alpha])) in positions.into_iter().zip(colors).enumerate() {
        match position.is_finite() {
            true => {
                bounds = bounds.union(&Aabb { min: position.as_dvec3(), max: position.as_dvec3() });
                indices.push(i as u32);
            }
            false => position = Vec3::ZERO,
        }
        let normal = normals.and_then(|n| n.get(i)).copied().unwrap_or(Vec3::ZERO);
        let normal = (normal.clamp(Vec3::NEG_ONE, Vec3::ONE) * 127.0).round();
        vertices.push(MeshVertex {
            position: position.to_array(),
            normal: [normal.x as i8, normal.y as i8, normal.z as i8, 0],
            // Colours of points are sRGB, colours of vertices linear.
            color: [linear(red), linear(green), linear(blue), alpha],
            ..MeshVertex::default()
        });
    }
    Mesh { vertices, indices: indices.into(), topology: Topology::Points, bounds, ..Mesh::default() }
}

/// Returns the features of points from their batch ids and the batch table, which `bytes` begin with: JSON and a binary part of
/// some lengths.
fn features_of(
    bytes: &[u8],
    [json_length, binary_length]: [usize; 2],
    rows: usize,
    ids: Option<Vec<u32>>,
    (limits, notes): (&Limits, &Notes),
) -> Arc<DrawableFeatures> {
    let part = |at: usize, length: usize| bytes.get(at..at.saturating_add(length)).unwrap_or_default();
    let (json, binary) = (part(0, json_length), part(json_length, binary_length));
    let batch = properties::batch_table(json, binary, rows, limits, &|kind| notes.add(kind));
    let (table, tables) = (batch.is_some().then_some(0), batch.map(Arc::new).into_iter().collect());
    let ids = ids.map_or(FeatureIds::VertexIndex, |ids| FeatureIds::PerVertex(ids.into()));
    let set = FeatureIdSet { label: String::new(), null_id: None, ids, table };
    Arc::new(DrawableFeatures { sets: vec![set], tables, ..DrawableFeatures::default() })
}

/// Returns the batch id of each point, if there are any.
fn batch_ids<'a>(
    table: &FeatureTable,
    column: &impl Fn(&Option<BinaryOffset>, usize) -> Result<Option<&'a [u8]>, IoError>,
    bad: &impl Fn(&str) -> IoError,
) -> Result<Option<Vec<u32>>, IoError> {
    let Some(BatchIds { byte_offset, component_type }) = table.batch_id.clone() else { return Ok(None) };
    let at = Some(BinaryOffset { byte_offset });
    let ids = |size: usize, read: &dyn Fn(&[u8]) -> u32| -> Result<Option<Vec<u32>>, IoError> {
        Ok(column(&at, size)?.map(|data| data.chunks_exact(size).map(read).collect()))
    };
    match component_type.as_deref().unwrap_or("UNSIGNED_SHORT") {
        "UNSIGNED_BYTE" => ids(1, &|b| u32::from(b[0])),
        "UNSIGNED_SHORT" => ids(2, &|b| u32::from(u16::from_le_bytes([b[0], b[1]]))),
        "UNSIGNED_INT" => ids(4, &|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        other => Err(bad(&format!("BATCH_ID has the component type {other:.40}"))),
    }
}

/// Returns positions relative to an origin, and the origin.
fn positions<'a>(
    table: &FeatureTable,
    column: &impl Fn(&Option<BinaryOffset>, usize) -> Result<Option<&'a [u8]>, IoError>,
    vector: &impl Fn(&Option<Global<[f64; 3]>>, &str) -> Result<Option<DVec3>, IoError>,
    bad: &impl Fn(&str) -> IoError,
) -> Result<(Vec<Vec3>, DVec3), IoError> {
    let center = vector(&table.rtc_center, "RTC_CENTER")?.unwrap_or_default();
    let (points, origin) = if let Some(data) = column(&table.position, 12)? {
        (data.chunks_exact(12).map(vec3).collect(), center)
    } else if let Some(data) = column(&table.position_quantized, 6)? {
        let offset = vector(&table.quantized_volume_offset, "QUANTIZED_VOLUME_OFFSET")?;
        let scale = vector(&table.quantized_volume_scale, "QUANTIZED_VOLUME_SCALE")?;
        let (Some(offset), Some(scale)) = (offset, scale) else {
            return Err(bad("POSITION_QUANTIZED without QUANTIZED_VOLUME_OFFSET and QUANTIZED_VOLUME_SCALE"));
        };
        let step = scale / 65535.0;
        let point = |b: &[u8]| {
            let [x, y, z] = [0, 2, 4].map(|k| f64::from(u16::from_le_bytes([b[k], b[k + 1]])));
            (DVec3::new(x, y, z) * step).as_vec3()
        };
        (data.chunks_exact(6).map(point).collect(), center + offset)
    } else {
        return Err(bad("neither POSITION nor POSITION_QUANTIZED"));
    };
    if origin.is_finite() { Ok((points, origin)) } else { Err(bad("the origin is not finite")) }
}

/// Reads three little-endian floats from a slice of 12 bytes.
fn vec3(bytes: &[u8]) -> Vec3 {
    let at = |k: usize| f32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]);
    Vec3::new(at(0), at(4), at(8))
}

/// Decodes a unit vector that is folded onto an octahedron (Meyer et al., "On Floating-Point Normal Vectors", 2010), one byte
/// per coordinate.
fn oct16p(x: u8, y: u8) -> Vec3 {
    let p = Vec2::new(f32::from(x), f32::from(y)) / 255.0 * 2.0 - 1.0;
    let z = 1.0 - p.x.abs() - p.y.abs();
    let fold = |a: f32, b: f32| (1.0 - b.abs()) * if a < 0.0 { -1.0 } else { 1.0 };
    let xy = if z < 0.0 { Vec2::new(fold(p.x, p.y), fold(p.y, p.x)) } else { p };
    xy.extend(z).normalize_or_zero()
}

fn rgb565(c: u16) -> [u8; 4] {
    let part = |value: u16, max: u16| (u32::from(value) * 255 / u32::from(max)) as u8;
    [part(c >> 11, 31), part(c >> 5 & 63, 63), part(c & 31, 31), 255]
}

fn linear(srgb: u8) -> u8 {
    (linear_from_srgb8(srgb) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fetch::Limits;
    use crate::scene::NodeKind;

    fn read(uri: &str, bytes: &[u8], options: &ReadOptions) -> Result<Node, IoError> {
        super::read(uri, bytes, options, &Notes::default())
    }

    fn options() -> ReadOptions {
        ReadOptions::for_root("/set/tileset.json", Limits::default())
    }

    fn pnts(json: &str, binary: &[u8]) -> Vec<u8> {
        let mut json = json.as_bytes().to_vec();
        json.resize(json.len().next_multiple_of(8), b' ');
        let mut out = b"pnts".to_vec();
        for word in [1, 28 + json.len() + binary.len(), json.len(), binary.len(), 0, 0] {
            out.extend((word as u32).to_le_bytes());
        }
        [out, json, binary.to_vec()].concat()
    }

    fn cloud(bytes: &[u8]) -> (DVec3, Arc<Mesh>, Material) {
        let node = read("t.pnts", bytes, &options()).unwrap();
        let NodeKind::Transform(place) = node.kind else { panic!("a transform") };
        let NodeKind::Geode(drawables) = &node.children[0].kind else { panic!("a geode") };
        let Geometry::Mesh(mesh) = &drawables[0].geometry else { panic!("points") };
        (place.translation, mesh.clone(), drawables[0].material.clone())
    }

    #[test]
    fn positions_colors_and_normals() {
        let mut binary: Vec<u8> = [1.0f32, 2.0, 3.0, -1.0, 0.0, 5.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        binary.extend([255, 0, 128, 0, 255, 0]);
        binary.extend([127, 127, 255, 128]);
        let json = r#"{"POINTS_LENGTH":2,"RTC_CENTER":[10,20,30],"POSITION":{"byteOffset":0},"RGB":{"byteOffset":24},"NORMAL_OCT16P":{"byteOffset":30}}"#;
        let (origin, mesh, material) = cloud(&pnts(json, &binary));
        assert_eq!((origin, mesh.topology, mesh.indices.len()), (DVec3::new(10.0, 20.0, 30.0), Topology::Points, 2));
        assert_eq!((mesh.vertices[0].position, mesh.vertices[0].color), ([1.0, 2.0, 3.0], [255, 0, 55, 255]));
        assert_eq!((mesh.bounds.min, mesh.bounds.max), (DVec3::new(-1.0, 0.0, 3.0), DVec3::new(1.0, 2.0, 5.0)));
        let [up, east] = [0, 1].map(|i| mesh.vertices[i].normal);
        assert!(up[2] > 125 && east[0] > 125, "{up:?} {east:?}");
        assert!(!material.unlit);
    }

    #[test]
    fn quantized_positions_and_one_color() {
        let binary: Vec<u8> = [0u16, 65535, 32768].iter().flat_map(|x| x.to_le_bytes()).collect();
        let json = r#"{"POINTS_LENGTH":1,"POSITION_QUANTIZED":{"byteOffset":0},"QUANTIZED_VOLUME_OFFSET":[1,2,3],"QUANTIZED_VOLUME_SCALE":[10,10,10],"CONSTANT_RGBA":[255,255,0,255]}"#;
        let (origin, mesh, material) = cloud(&pnts(json, &binary));
        assert_eq!(origin, DVec3::new(1.0, 2.0, 3.0));
        let [x, y, z] = mesh.vertices[0].position;
        assert!(x == 0.0 && y == 10.0 && (z - 5.0).abs() < 1e-3);
        assert_eq!((mesh.vertices[0].color, material.unlit), ([255, 255, 0, 255], true));
        assert_eq!(material.alpha, AlphaMode::Opaque);
        let (_, _, glass) = cloud(&pnts(&json.replace("255,255,0,255", "255,255,0,128"), &binary));
        assert_eq!(glass.alpha, AlphaMode::Blend);
    }

    #[test]
    fn columns_may_be_lists_in_the_json() {
        let (_, mesh, _) =
            cloud(&pnts(r#"{"POINTS_LENGTH":2,"POSITION":[1,2,3,4,5,6],"RGB":[255,0,128,0,255,0]}"#, &[]));
        assert_eq!((mesh.vertices[1].position, mesh.vertices[0].color), ([4.0, 5.0, 6.0], [255, 0, 55, 255]));
        assert!(read("t", &pnts(r#"{"POINTS_LENGTH":3,"POSITION":[1,2,3,4,5,6]}"#, &[]), &options()).is_err());
    }

    /// Regression: one of them took the cloud.
    #[test]
    fn points_without_finite_positions_are_left_out() {
        let of = |x: f32| [1.0, 2.0, 3.0, x, 0.0, 0.0].iter().flat_map(|x: &f32| x.to_le_bytes()).collect::<Vec<u8>>();
        let json = r#"{"POINTS_LENGTH":2,"POSITION":{"byteOffset":0}}"#;
        let (_, mesh, _) = cloud(&pnts(json, &of(f32::NAN)));
        assert_eq!((mesh.vertices.len(), &mesh.indices[..], mesh.bounds.min.x), (2, &[0][..], 1.0));
        let none = pnts(json, &[0xff; 24]);
        assert!(read("t", &none, &options()).unwrap_err().to_string().contains("no position is finite"));
    }

    #[test]
    fn global_values_may_be_in_the_binary_part() {
        let mut binary: Vec<u8> = [65535u16, 0, 32768, 0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let numbers = [1.0f32, 2.0, 3.0, 10.0, 10.0, 10.0, 100.0, 200.0, 300.0];
        binary.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
        binary.extend([1, 0, 0, 0, 255, 0, 0, 255]);
        let json = r#"{"POINTS_LENGTH":{"byteOffset":44},"POSITION_QUANTIZED":{"byteOffset":0},"QUANTIZED_VOLUME_OFFSET":{"byteOffset":8},"QUANTIZED_VOLUME_SCALE":{"byteOffset":20},"RTC_CENTER":{"byteOffset":32},"CONSTANT_RGBA":{"byteOffset":48}}"#;
        let (origin, mesh, _) = cloud(&pnts(json, &binary));
        assert_eq!((origin, mesh.vertices.len()), (DVec3::new(101.0, 202.0, 303.0), 1));
        assert_eq!((mesh.vertices[0].position[0], mesh.vertices[0].color), (10.0, [255, 0, 0, 255]));
        for at in [8, 20, 32, 44, 48] {
            let beyond = json.replace(&format!("Offset\":{at}}}"), "Offset\":50}");
            assert!(read("t", &pnts(&beyond, &binary), &options()).is_err(), "{beyond}");
        }
    }

    /// Three points with colours, normals and batch ids, as Draco stores them in order.
    fn draco(positions: &[f32]) -> Vec<u8> {
        use draco_core::{DataType, EncoderBuffer, EncoderOptions, GeometryAttributeType, PointAttribute, PointCloud};
        let count = positions.len() / 3;
        let mut cloud = PointCloud::new();
        cloud.set_num_points(count);
        let mut add = |kind, components: u8, data_type, bytes: &[u8]| {
            let mut attribute = PointAttribute::new();
            attribute.init(kind, components, data_type, false, count);
            attribute.buffer_mut().write(0, bytes);
            cloud.add_attribute(attribute);
        };
        let floats = |values: &[f32]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        add(GeometryAttributeType::Position, 3, DataType::Float32, &floats(positions));
        let colors: Vec<u8> = (0..3 * count).map(|i| (20 * i) as u8).collect();
        add(GeometryAttributeType::Color, 3, DataType::Uint8, &colors);
        add(GeometryAttributeType::Normal, 3, DataType::Float32, &floats(&[0.0, 0.0, 1.0].repeat(count)));
        let ids: Vec<u8> = (0..count as u16).flat_map(|id| (7 * id).to_le_bytes()).collect();
        add(GeometryAttributeType::Generic, 1, DataType::Uint16, &ids);
        let mut encoder = draco_core::PointCloudEncoder::new();
        encoder.set_point_cloud(cloud);
        let mut options = EncoderOptions::new();
        options.set_encoding_method(0);
        let mut buffer = EncoderBuffer::new();
        encoder.encode(&options, &mut buffer).unwrap();
        buffer.data().to_vec()
    }

    fn with_draco(count: usize, compressed: &[u8]) -> Vec<u8> {
        let length = compressed.len();
        let none = r#"{"byteOffset":0}"#;
        let json = format!(
            r#"{{"POINTS_LENGTH":{count},"RTC_CENTER":[10,20,30],"POSITION":{none},"RGB":{none},"NORMAL":{none},
            "BATCH_ID":{{"byteOffset":0,"componentType":"UNSIGNED_SHORT"}},"BATCH_LENGTH":9,
            "extensions":{{"3DTILES_draco_point_compression":{{"byteOffset":0,"byteLength":{length},
            "properties":{{"POSITION":0,"RGB":1,"NORMAL":2,"BATCH_ID":3}}}}}}}}"#
        );
        pnts(&json, compressed)
    }

    #[test]
    fn draco_columns_are_decompressed() {
        let positions = [1.0, 2.0, 3.0, -1.0, 0.5, 9.0, 4.0, 4.0, 4.0];
        let bytes = with_draco(3, &draco(&positions));
        let (origin, mesh, material) = cloud(&bytes);
        assert_eq!((origin, mesh.vertices.len(), material.unlit), (DVec3::new(10.0, 20.0, 30.0), 3, false));
        for (i, vertex) in mesh.vertices.iter().enumerate() {
            assert_eq!(vertex.position, positions[3 * i..3 * i + 3]);
            assert_eq!(vertex.normal[2], 127);
            let [red, green, blue] = [0, 1, 2].map(|k| linear(20 * (3 * i + k) as u8));
            assert_eq!(vertex.color, [red, green, blue, 255]);
        }
        let options = ReadOptions { vertex_attributes: ["_BATCHID"].map(Arc::from).into(), ..options() };
        let node = read("t.pnts", &bytes, &options).unwrap();
        let NodeKind::Geode(drawables) = &node.children[0].kind else { panic!("a geode") };
        let Geometry::Mesh(mesh) = &drawables[0].geometry else { panic!("points") };
        let (_, ids) = mesh.attributes.get("_BATCHID").unwrap();
        assert_eq!(bytemuck::cast_slice::<u8, u32>(ids), [0, 7, 14]);
    }

    #[test]
    fn broken_draco_clouds_are_refused() {
        let positions: Vec<f32> = (0..300).map(|i| i as f32 * 0.7).collect();
        let compressed = draco(&positions);
        assert!(read("t", &with_draco(100, &compressed), &options()).is_ok());
        for count in [0, 99, 101, 1_000_000_000] {
            assert!(read("t", &with_draco(count, &compressed), &options()).is_err(), "{count} points");
        }
        for at in 0..compressed.len() {
            assert!(read("t", &with_draco(100, &compressed[..at]), &options()).is_err(), "{at} bytes");
            for bit in 0..8 {
                let mut changed = compressed.clone();
                changed[at] ^= 1 << bit;
                // Any answer, but no panic and no large allocation.
                let _ = read("t", &with_draco(100, &changed), &options());
            }
        }
        let without = |property: &str| {
            let bytes = with_draco(100, &compressed);
            let mut changed = bytes;
            let at = changed.windows(7).position(|window| window == b"\"RGB\":1").unwrap();
            changed[at..at + 7].copy_from_slice(property.as_bytes());
            read("t", &changed, &options()).unwrap_err().reason()
        };
        assert!(without("\"RGB\":7").contains("no property 7"));
        assert!(without("\"RGB\":3").contains("components"));
    }

    #[test]
    fn batch_ids_of_all_types_are_kept_on_request() {
        let options = ReadOptions { vertex_attributes: ["_BATCHID"].map(Arc::from).into(), ..options() };
        for (component, bytes) in [
            ("UNSIGNED_BYTE", vec![5, 6]),
            ("UNSIGNED_SHORT", vec![5, 0, 6, 0]),
            ("UNSIGNED_INT", vec![5, 0, 0, 0, 6, 0, 0, 0]),
        ] {
            let mut binary: Vec<u8> = [0.0_f32; 6].iter().flat_map(|x| x.to_le_bytes()).collect();
            binary.extend(bytes);
            let json = format!(
                r#"{{"POINTS_LENGTH":2,"POSITION":{{"byteOffset":0}},"BATCH_ID":{{"byteOffset":24,"componentType":"{component}"}}}}"#
            );
            let node = read("t", &pnts(&json, &binary), &options).unwrap();
            let NodeKind::Geode(drawables) = &node.children[0].kind else { panic!("a geode") };
            let Geometry::Mesh(mesh) = &drawables[0].geometry else { panic!("points") };
            assert_eq!(bytemuck::cast_slice::<u8, u32>(mesh.attributes.get("_BATCHID").unwrap().1), [5, 6]);
            let strange = json.replace(component, "DOUBLE");
            assert!(read("t", &pnts(&strange, &binary), &options).is_err());
        }
    }

    #[test]
    fn batch_tables_are_kept_on_request() {
        let mut binary: Vec<u8> = [0.0_f32; 6].iter().flat_map(|x| x.to_le_bytes()).collect();
        binary.extend([1, 0]);
        let table = br#"{"name":["roof","wall"],"id":{"byteOffset":0,"componentType":"SHORT","type":"SCALAR"}}"#;
        let options = ReadOptions { keep_features: true, ..options() };
        let names = |json: &str| {
            let mut bytes = pnts(json, &binary);
            bytes[20..24].copy_from_slice(&(table.len() as u32).to_le_bytes());
            bytes[24..28].copy_from_slice(&4_u32.to_le_bytes());
            bytes.extend(table);
            bytes.extend([7, 0, 9, 0]);
            let node = read("t", &bytes, &options).unwrap();
            let NodeKind::Geode(drawables) = &node.children[0].kind else { panic!("a geode") };
            let features = drawables[0].features.clone().unwrap();
            let of = |vertex| {
                let feature = features.at_vertex(vertex).next().unwrap();
                feature
                    .properties()
                    .iter()
                    .map(|(name, value)| format!("{name} {value:?}"))
                    .collect::<Vec<_>>()
                    .join(", ")
            };
            [of(0), of(1)]
        };
        let ids = r#"{"POINTS_LENGTH":2,"POSITION":{"byteOffset":0},"BATCH_LENGTH":2,"BATCH_ID":{"byteOffset":24,"componentType":"UNSIGNED_BYTE"}}"#;
        let [first, second] = names(ids);
        assert!(first.contains("wall") && first.contains('9') && second.contains("roof"), "{first}; {second}");
        let [first, second] = names(r#"{"POINTS_LENGTH":2,"POSITION":{"byteOffset":0}}"#);
        assert!(first.contains("roof") && first.contains('7') && second.contains("wall"), "{first}; {second}");
    }

    #[test]
    fn truncated_and_invalid_clouds_are_refused() {
        let binary: Vec<u8> = [1.0f32, 2.0, 3.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let whole = pnts(r#"{"POINTS_LENGTH":1,"POSITION":{"byteOffset":0}}"#, &binary);
        assert!(read("t", &whole, &options()).is_ok());
        for length in 0..whole.len() {
            assert!(read("t", &whole[..length], &options()).is_err(), "{length} bytes");
        }
        for json in [
            r#"{"POINTS_LENGTH":2,"POSITION":{"byteOffset":0}}"#,
            r#"{"POINTS_LENGTH":1,"POSITION":{"byteOffset":18446744073709551615}}"#,
            r#"{"POINTS_LENGTH":18446744073709551615,"POSITION":{"byteOffset":0}}"#,
            r#"{"POINTS_LENGTH":1}"#,
            r#"{"POINTS_LENGTH":1,"POSITION_QUANTIZED":{"byteOffset":0}}"#,
            r#"{"POINTS_LENGTH":1,"POSITION":{"byteOffset":0},"extensions":{"3DTILES_draco_point_compression":{}}}"#,
        ] {
            let error = read("t", &pnts(json, &binary), &options()).err().map(|e| e.reason());
            assert!(error.is_some_and(|e| !e.is_empty()), "{json}");
        }
    }
}
