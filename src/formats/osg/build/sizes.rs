//! [`Size`]: the memory that the objects of a part take until it becomes a page, and the nodes that it becomes.

use std::collections::HashMap;
use std::sync::Arc;

use crate::formats::osg::objects::{
    AttributeObject, BoundArray, DrawableClass, DrawableObject, ImageData, ImageObject, Indices, NodeClass, Object,
    ShapeObject, StateObject, TerrainTileObject, TextureObject,
};

/// The bytes of an object without its arrays and images.
const OBJECT_BYTES: u64 = 200;

/// About the size of objects. What nodes share counts for each of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Size {
    pub bytes: u64,
    pub nodes: usize,
}

impl Size {
    pub fn plus(self, other: Self) -> Self {
        Self { bytes: self.bytes.saturating_add(other.bytes), nodes: self.nodes.saturating_add(other.nodes) }
    }
}

/// Returns the size of an object with everything below it. `known` keeps those of nodes and drawables by address.
pub(super) fn of_object(object: &Object, known: &mut HashMap<usize, Size>) -> Size {
    let (key, state) = match object {
        Object::Node(node) => (Arc::as_ptr(node).addr(), node.state.as_deref()),
        Object::Drawable(drawable) => (Arc::as_ptr(drawable).addr(), drawable.state.as_deref()),
        _ => return Size { bytes: 0, nodes: 1 },
    };
    if let Some(size) = known.get(&key) {
        return *size;
    }
    let mut size = Size { bytes: OBJECT_BYTES + state.map_or(0, of_state), nodes: 1 };
    match object {
        Object::Node(node) => {
            match &node.class {
                NodeClass::TerrainTile(tile) => {
                    size.bytes = size.bytes.saturating_add(of_tile(tile));
                    // The transform and the drawable.
                    size.nodes += 2;
                }
                NodeClass::Sequence(sequence) => size.bytes += sequence.times_s.len() as u64 * 8,
                NodeClass::Transform { animation: Some(animation), .. } => size.bytes += animation.path.size_bytes(),
                _ => {}
            }
            size = node.children.iter().fold(size, |size, child| size.plus(of_object(child, known)));
        }
        Object::Drawable(drawable) => size.bytes = size.bytes.saturating_add(of_drawable(drawable)),
        _ => {}
    }
    known.insert(key, size);
    size
}

fn of_drawable(drawable: &DrawableObject) -> u64 {
    let geometry = match &drawable.class {
        DrawableClass::Geometry(geometry) => geometry,
        DrawableClass::Shape { shape, .. } => return shape.as_deref().map_or(0, of_shape),
        DrawableClass::Text(text) => return text.text.len() as u64,
    };
    let of_array = |array: &Option<BoundArray>| array.as_ref().map_or(0, |array| array.array.values.size_bytes());
    let sets = geometry.primitives.iter().map(|set| match &set.indices {
        Indices::Elements(values) => values.size_bytes(),
        Indices::Lengths { lengths, .. } => lengths.len() as u64 * 4,
        Indices::Arrays { .. } => 0,
    });
    let arrays = [&geometry.vertices, &geometry.normals, &geometry.colors].into_iter();
    let arrays = arrays.chain(&geometry.tex_coords).map(of_array);
    sets.sum::<u64>() + arrays.sum::<u64>()
}

fn of_shape(shape: &ShapeObject) -> u64 {
    match shape {
        ShapeObject::Triangles { positions, indices } => positions.values.size_bytes() + indices.values.size_bytes(),
        ShapeObject::HeightField(field) => field.heights.values.size_bytes(),
        ShapeObject::Composite(parts) => parts.iter().map(|part| of_shape(part)).sum(),
        ShapeObject::Box { .. } | ShapeObject::Sphere { .. } | ShapeObject::Round { .. } => 0,
    }
}

fn of_tile(tile: &TerrainTileObject) -> u64 {
    let heights = tile.elevation.as_deref().and_then(|layer| layer.heights());
    let images: u64 = tile.images().map(|(_, _, image)| of_image(image)).sum();
    heights.map_or(0, |field| field.heights.values.size_bytes()) + images
}

fn of_image(image: &ImageObject) -> u64 {
    match &image.data {
        ImageData::External => 0,
        ImageData::File(bytes) => bytes.len() as u64,
        ImageData::Raw(raw) => raw.bytes.len() as u64,
    }
}

fn of_state(state: &StateObject) -> u64 {
    let attributes = state.texture_attributes.iter().flatten();
    let textures = attributes.filter_map(|(attribute, _)| match &**attribute {
        AttributeObject::Texture(texture) => Some(texture),
        _ => None,
    });
    let images = textures.flat_map(TextureObject::all_images).map(|image| of_image(image));
    OBJECT_BYTES + images.sum::<u64>()
}
