//! The extension `3DTILES_draco_point_compression`: columns of a feature table that Draco has compressed. Decode threads.

use draco_core::{DecodeLimits, DecoderBuffer, ErrorKind, PointAttribute, PointCloud, PointCloudDecoder};
use glam::Vec3;
use serde::Deserialize;

use crate::fetch::{IoError, about_to_allocate, content_bytes_left};

/// The maximum bytes of one point: position, normal, colour, batch id, and some properties of the batch table.
const MAX_POINT_BYTES: u64 = 512;

/// The extension's JSON.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct DracoJson {
    /// Ids in the compressed cloud by the name of the column.
    properties: Properties,
    byte_offset: usize,
    byte_length: usize,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE", default)]
struct Properties {
    position: Option<u32>,
    normal: Option<u32>,
    rgb: Option<u32>,
    rgba: Option<u32>,
    batch_id: Option<u32>,
}

/// A decompressed point cloud.
pub(super) struct DracoPoints {
    cloud: PointCloud,
    properties: Properties,
}

impl DracoPoints {
    /// Decompresses the columns of `count` points, which the caller has checked, from the binary part of a feature table.
    pub fn decode(uri: &str, json: &DracoJson, binary: &[u8], count: usize) -> Result<Self, IoError> {
        let bad = |reason: &str| IoError::invalid(uri, format!("pnts: 3DTILES_draco_point_compression: {reason}"));
        let end = json.byte_offset.checked_add(json.byte_length);
        let bytes = end.and_then(|end| binary.get(json.byte_offset..end));
        let bytes = bytes.ok_or_else(|| bad("the compressed points reach beyond the feature table"))?;
        let mut limits = DecodeLimits::default();
        limits.max_points = count as u64;
        limits.max_decoded_bytes = (count as u64).saturating_mul(MAX_POINT_BYTES).min(content_bytes_left());
        let mut buffer = DecoderBuffer::new(bytes).with_limits(limits);
        let mut cloud = PointCloud::new();
        if let Err(error) = PointCloudDecoder::new().decode(&mut buffer, &mut cloud) {
            // The budget of the content was the limit, which has a better error.
            if error.kind() == ErrorKind::LimitExceeded && limits.max_decoded_bytes == content_bytes_left() {
                about_to_allocate(limits.max_decoded_bytes.saturating_add(1)).map_err(|error| error.at(uri))?;
            }
            return Err(bad(&error.to_string()));
        }
        if cloud.num_points() != count {
            return Err(bad(&format!("{} points, POINTS_LENGTH is {count}", cloud.num_points())));
        }
        let points = Self { cloud, properties: json.properties };
        let Properties { position, normal, rgb, rgba, batch_id } = json.properties;
        let components = [(position, 3), (normal, 3), (rgb, 3), (rgba, 4), (batch_id, 1)];
        for (id, components) in components.into_iter().filter_map(|(id, components)| Some((id?, components))) {
            let attribute = points.cloud.attribute_by_unique_id(id);
            let attribute = attribute.ok_or_else(|| bad(&format!("there is no property {id}")))?;
            if attribute.num_components() != components {
                let got = attribute.num_components();
                return Err(bad(&format!("property {id} has {got} components, expected {components}")));
            }
        }
        Ok(points)
    }

    /// Returns the positions; `None` if they are not compressed.
    pub fn positions(&self) -> Option<Vec<Vec3>> {
        self.vectors(self.properties.position)
    }

    /// Returns the normals; `None` if they are not compressed.
    pub fn normals(&self) -> Option<Vec<Vec3>> {
        self.vectors(self.properties.normal)
    }

    /// Returns the sRGB colours; `None` if they are not compressed.
    pub fn colors(&self) -> Option<Vec<[u8; 4]>> {
        if let Some(values) = self.values(self.properties.rgba, 4) {
            return Some(values.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]].map(|part| part as u8)).collect());
        }
        let values = self.values(self.properties.rgb, 3)?;
        Some(values.chunks_exact(3).map(|c| [c[0], c[1], c[2], 255.0].map(|part| part as u8)).collect())
    }

    /// Returns the batch ids; `None` if they are not compressed.
    pub fn batch_ids(&self) -> Option<Vec<u32>> {
        // An id up to 2^24 is exact as f32.
        Some(self.values(self.properties.batch_id, 1)?.into_iter().map(|id| id as u32).collect())
    }

    fn vectors(&self, id: Option<u32>) -> Option<Vec<Vec3>> {
        Some(self.values(id, 3)?.chunks_exact(3).map(Vec3::from_slice).collect())
    }

    fn values(&self, id: Option<u32>, components: usize) -> Option<Vec<f32>> {
        let attribute: &PointAttribute = self.cloud.attribute_by_unique_id(id?)?;
        Some(attribute.read_f32s(self.cloud.num_points(), components))
    }
}
