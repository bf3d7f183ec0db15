//! Custom vertex attributes beside those that every mesh has, such as tangents or second texture coordinates; OSG's
//! `Geometry::setVertexAttribArray`. Plain CPU data, made on any thread, read by the draw thread's uploads.

use std::sync::Arc;

use super::attribute_format::AttributeFormat;
use crate::scene::error::MeshError;

/// Names and formats of custom attributes, in the order in which they follow a `MeshVertex` in memory.
pub(crate) type AttributeLayout = [(Arc<str>, AttributeFormat)];

/// Returns the bytes that the attributes of a layout add to a vertex.
pub(crate) fn added_stride(layout: &AttributeLayout) -> usize {
    layout.iter().map(|(_, format)| format.size_bytes()).sum()
}

/// The maximum number of custom attributes of a mesh: with those of a [`MeshVertex`](super::MeshVertex) the sixteen that
/// every adapter supports.
pub const MAX_ATTRIBUTES: usize = 12;
/// The names of the attributes of a `MeshVertex`.
const OWN: [&str; 4] = ["position", "uv", "normal", "color"];

/// The custom attributes of a mesh; see [`Mesh::with_attribute`](super::Mesh::with_attribute).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VertexAttributes {
    layout: Arc<AttributeLayout>,
    /// The bytes of each attribute, an element per vertex.
    elements: Vec<Arc<[u8]>>,
}

impl VertexAttributes {
    /// Returns true if there are no custom attributes.
    pub fn is_empty(&self) -> bool {
        self.elements.is_empty()
    }

    /// Returns the name, format and bytes of each attribute.
    pub fn iter(&self) -> impl Iterator<Item = (&str, AttributeFormat, &[u8])> {
        self.layout.iter().zip(&self.elements).map(|((name, format), elements)| (&**name, *format, &**elements))
    }

    /// Returns the format and bytes of an attribute.
    pub fn get(&self, name: &str) -> Option<(AttributeFormat, &[u8])> {
        self.iter().find(|(of, ..)| *of == name).map(|(_, format, elements)| (format, elements))
    }

    /// Returns the bytes of all elements.
    pub fn size_bytes(&self) -> u64 {
        self.elements.iter().map(|elements| elements.len() as u64).sum()
    }

    /// Returns the names and formats.
    pub(crate) fn layout(&self) -> &Arc<AttributeLayout> {
        &self.layout
    }

    /// Adds an attribute of a mesh with a number of vertices. Fails if the name is taken or the length does not match.
    pub(crate) fn push(
        &mut self,
        vertices: usize,
        name: &str,
        format: AttributeFormat,
        elements: Arc<[u8]>,
    ) -> Result<(), MeshError> {
        if OWN.contains(&name) || self.get(name).is_some() {
            return Err(MeshError::AttributeTwice { name: name.to_owned() });
        }
        if self.elements.len() >= MAX_ATTRIBUTES {
            return Err(MeshError::TooManyAttributes { name: name.to_owned(), limit: MAX_ATTRIBUTES });
        }
        check_length(vertices, name, format, &elements)?;
        self.layout = self.layout.iter().cloned().chain([(Arc::from(name), format)]).collect();
        self.elements.push(elements);
        Ok(())
    }

    /// Fails unless every attribute has an element for each vertex.
    pub(crate) fn check(&self, vertices: usize) -> Result<(), MeshError> {
        self.iter().try_for_each(|(name, format, elements)| check_length(vertices, name, format, elements))
    }
}

fn check_length(vertices: usize, name: &str, format: AttributeFormat, elements: &[u8]) -> Result<(), MeshError> {
    if vertices.checked_mul(format.size_bytes()) == Some(elements.len()) {
        return Ok(());
    }
    Err(MeshError::AttributeLength { name: name.to_owned(), format, vertices, bytes: elements.len() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Mesh, MeshVertex, Topology};

    fn three() -> Mesh {
        Mesh::new(vec![MeshVertex::default(); 3], vec![0, 1, 2], Topology::Triangles)
    }

    #[test]
    fn attributes_are_stored_unchanged() {
        let mesh = three()
            .with_attribute("heat", AttributeFormat::Float32, &[1.0f32, 2.0, 3.0])
            .and_then(|mesh| mesh.with_attribute("ids", AttributeFormat::Uint16x2, &[[1u16, 2], [3, 4], [5, 6]]))
            .unwrap();
        assert_eq!(added_stride(mesh.attributes.layout()), 8);
        assert_eq!(mesh.attributes.size_bytes(), 24);
        let (format, bytes) = mesh.attributes.get("heat").unwrap();
        assert_eq!((format, bytemuck::pod_collect_to_vec(bytes)), (AttributeFormat::Float32, vec![1.0f32, 2.0, 3.0]));
        let names: Vec<_> = mesh.attributes.iter().map(|(name, format, _)| (name.to_owned(), format)).collect();
        assert_eq!(names, [("heat".into(), AttributeFormat::Float32), ("ids".into(), AttributeFormat::Uint16x2)]);
        assert!(mesh.attributes.get("cold").is_none() && !mesh.attributes.is_empty());
        assert_ne!(mesh, three());
    }

    #[test]
    fn wrong_length_name_or_count_is_refused() {
        let short = three().with_attribute("heat", AttributeFormat::Float32x2, &[0.0f32; 5]).unwrap_err();
        let expected = MeshError::AttributeLength {
            name: "heat".into(),
            format: AttributeFormat::Float32x2,
            vertices: 3,
            bytes: 20,
        };
        assert_eq!(short, expected);
        let heat = |mesh: Mesh, name: &str| mesh.with_attribute(name, AttributeFormat::Float32, &[0.0f32; 3]);
        let twice = heat(heat(three(), "heat").unwrap(), "heat").unwrap_err();
        assert_eq!(twice, MeshError::AttributeTwice { name: "heat".into() });
        assert_eq!(heat(three(), "uv").unwrap_err(), MeshError::AttributeTwice { name: "uv".into() });
        let full = (0..MAX_ATTRIBUTES).try_fold(three(), |mesh, i| heat(mesh, &format!("a{i}"))).unwrap();
        assert_eq!(
            heat(full, "one more").unwrap_err(),
            MeshError::TooManyAttributes { name: "one more".into(), limit: 12 }
        );
    }

    #[test]
    fn sizes_match_wgpu() {
        use AttributeFormat::*;
        for (format, wgpu) in [
            (Uint8x4, wgpu::VertexFormat::Uint8x4),
            (Snorm16x4, wgpu::VertexFormat::Snorm16x4),
            (Float16x2, wgpu::VertexFormat::Float16x2),
            (Float32x3, wgpu::VertexFormat::Float32x3),
            (Sint32, wgpu::VertexFormat::Sint32),
        ] {
            assert_eq!(format.size_bytes() as u64, wgpu.size(), "{format:?}");
        }
    }
}
