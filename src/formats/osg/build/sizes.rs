//! The memory that the objects of a part take until it is made into a page.

use std::collections::HashSet;
use std::sync::Arc;

use crate::formats::osg::objects::{
    AttributeObject, BoundArray, DrawableClass, ImageData, Indices, Object, StateObject, TextureObject,
};

/// The bytes of an object without its arrays and images.
const OBJECT_BYTES: u64 = 200;

/// Returns about the bytes of memory of objects with everything below them, shared ones counted once.
pub(super) fn of_objects(objects: &[Object]) -> u64 {
    let mut seen = HashSet::new();
    objects.iter().map(|object| of_object(object, &mut seen)).sum()
}

fn of_object(object: &Object, seen: &mut HashSet<usize>) -> u64 {
    let own = match object {
        Object::Node(node) if seen.insert(Arc::as_ptr(node).addr()) => {
            let children: u64 = node.children.iter().map(|child| of_object(child, seen)).sum();
            children + of_state(node.state.as_ref(), seen)
        }
        Object::Drawable(drawable) if seen.insert(Arc::as_ptr(drawable).addr()) => {
            let state = of_state(drawable.state.as_ref(), seen);
            let DrawableClass::Geometry(geometry) = &drawable.class else { return state + OBJECT_BYTES };
            let of_array =
                |array: &Option<BoundArray>| array.as_ref().map_or(0, |array| array.array.values.size_bytes());
            let sets = geometry.primitives.iter().map(|set| match &set.indices {
                Indices::Elements(values) => values.size_bytes(),
                Indices::Lengths { lengths, .. } => lengths.len() as u64 * 4,
                Indices::Arrays { .. } => 0,
            });
            let arrays = [&geometry.vertices, &geometry.normals, &geometry.colors].into_iter();
            let arrays = arrays.chain(&geometry.tex_coords).map(of_array);
            state + sets.sum::<u64>() + arrays.sum::<u64>()
        }
        _ => return 0,
    };
    OBJECT_BYTES + own
}

fn of_state(state: Option<&Arc<StateObject>>, seen: &mut HashSet<usize>) -> u64 {
    let Some(state) = state else { return 0 };
    if !seen.insert(Arc::as_ptr(state).addr()) {
        return 0;
    }
    let attributes = state.texture_attributes.iter().flatten();
    let images = attributes.map(|(attribute, _)| match &**attribute {
        AttributeObject::Texture(TextureObject { image: Some(image), .. })
            if seen.insert(Arc::as_ptr(image).addr()) =>
        {
            match &image.data {
                ImageData::External => 0,
                ImageData::File(bytes) => bytes.len() as u64,
                ImageData::Raw(raw) => raw.bytes.len() as u64,
            }
        }
        _ => 0,
    });
    OBJECT_BYTES + images.sum::<u64>()
}
