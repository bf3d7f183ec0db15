//! [`SurfaceProperty`]: a property whose values are on a mesh, in an image or in its vertices. Plain CPU data, any thread.

use std::collections::HashSet;
use std::fmt;
use std::sync::Arc;

use super::data_texture::{DataTexture, SurfacePoint};
use super::property_table::PropertyInfo;
use super::property_value::PropertyValue;

/// Converts the bytes of a stored value.
pub(crate) trait ValueDecoder: Send + Sync {
    /// Returns the value that bytes stand for; the default of the property if they are too few.
    fn value(&self, bytes: &[u8]) -> PropertyValue;
}

/// The stored values of a property.
#[derive(Clone, Debug)]
pub(crate) enum SurfaceValues {
    Texture(DataTexture),
    /// `size` bytes for each vertex.
    PerVertex {
        bytes: Arc<[u8]>,
        size: usize,
    },
}

/// A property of the points of a mesh.
#[derive(Clone)]
pub struct SurfaceProperty {
    /// The class of the property in the schema.
    pub class: Arc<str>,
    /// Name, semantic and range.
    pub info: PropertyInfo,
    values: SurfaceValues,
    decoder: Arc<dyn ValueDecoder>,
}

impl SurfaceProperty {
    pub(crate) fn new(
        class: Arc<str>,
        info: PropertyInfo,
        values: SurfaceValues,
        decoder: Arc<dyn ValueDecoder>,
    ) -> Self {
        Self { class, info, values, decoder }
    }

    /// Returns the value at a point: of the texel, without filtering, or of the nearest corner of the primitive.
    pub fn value(&self, at: &SurfacePoint) -> PropertyValue {
        match &self.values {
            SurfaceValues::Texture(texture) => self.decoder.value(&texture.texel(at).unwrap_or_default()),
            SurfaceValues::PerVertex { bytes, size } => {
                let first = (at.nearest_vertex() as usize).saturating_mul(*size);
                self.decoder.value(bytes.get(first..first.saturating_add(*size)).unwrap_or_default())
            }
        }
    }

    /// Returns the property for a mesh of some of the vertices.
    pub(super) fn with_vertices(&self, vertices: &[u32]) -> Self {
        let values = match &self.values {
            SurfaceValues::Texture(texture) => SurfaceValues::Texture(texture.with_vertices(vertices)),
            SurfaceValues::PerVertex { bytes, size } => {
                let mut own = Vec::with_capacity(vertices.len() * size);
                for (i, vertex) in (1..).zip(vertices) {
                    let first = *vertex as usize * size;
                    own.extend_from_slice(bytes.get(first..first + size).unwrap_or_default());
                    own.resize(i * size, 0);
                }
                SurfaceValues::PerVertex { bytes: own.into(), size: *size }
            }
        };
        Self { values, ..self.clone() }
    }

    /// Returns the bytes of memory beside images and values whose addresses are in `counted`, and adds those.
    pub(super) fn size_bytes_beside(&self, counted: &mut HashSet<usize>) -> u64 {
        let values = match &self.values {
            SurfaceValues::Texture(texture) => texture.size_bytes_beside(counted),
            SurfaceValues::PerVertex { bytes, .. } if counted.insert(bytes.as_ptr().addr()) => bytes.len() as u64,
            SurfaceValues::PerVertex { .. } => 0,
        };
        self.info.size_bytes() as u64 + values
    }
}

impl fmt::Debug for SurfaceProperty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SurfaceProperty({}.{}, {:?})", self.class, self.info.name, self.values)
    }
}
