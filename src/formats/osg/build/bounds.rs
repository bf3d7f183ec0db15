//! Spheres around objects, which the ranges of levels of detail are measured from.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::{terrain, text};
use crate::formats::osg::objects::{
    AutoObject, CenterMode, DrawableClass, DrawableObject, LodObject, NodeClass, NodeObject, Object, ProxyObject,
    ShapeObject, TerrainSettings,
};
use crate::math::{Aabb, BoundingSphere};

/// The spheres around nodes and drawables by address, since files may share them often.
#[derive(Default)]
pub(super) struct Spheres {
    by_address: HashMap<usize, BoundingSphere>,
    /// The settings of the Terrain above the current object.
    pub terrain: TerrainSettings,
    /// The samples of terrain that were looked at: tiles may share them.
    samples: usize,
}

/// The maximum number of samples of terrain that are looked at for the spheres of a file. Further tiles have none.
const MAX_SAMPLES: usize = 1 << 26;

/// Returns a sphere around an object in the frame that it is in; empty if it has no bound. `known` keeps those of nodes
/// and drawables by address, since files may share them often.
pub(super) fn sphere(object: &Object, known: &mut Spheres) -> BoundingSphere {
    let key = match object {
        Object::Node(node) => Arc::as_ptr(node).addr(),
        Object::Drawable(drawable) => Arc::as_ptr(drawable).addr(),
        _ => return BoundingSphere::EMPTY,
    };
    if let Some(sphere) = known.by_address.get(&key) {
        return *sphere;
    }
    let sphere = match object {
        Object::Node(node) => of_node(node, known),
        Object::Drawable(drawable) => of_drawable(drawable),
        _ => BoundingSphere::EMPTY,
    };
    known.by_address.insert(key, sphere);
    sphere
}

fn of_drawable(drawable: &DrawableObject) -> BoundingSphere {
    match &drawable.class {
        DrawableClass::Geometry(geometry) => {
            let Some(vertices) = &geometry.vertices else { return BoundingSphere::EMPTY };
            let mut bounds = Aabb::EMPTY;
            vertices.array.for_each(0..vertices.array.count(), |point| {
                let point = DVec3::from_array(point);
                if point.is_finite() {
                    bounds = bounds.with(point);
                }
            });
            box_sphere(&bounds)
        }
        DrawableClass::Shape { shape, .. } => shape.as_ref().map_or(BoundingSphere::EMPTY, |shape| of_shape(shape)),
        DrawableClass::Text(text) => text::sphere(text),
    }
}

fn of_node(node: &NodeObject, known: &mut Spheres) -> BoundingSphere {
    let mut children = || {
        let spheres = node.children.iter().map(|child| sphere(child, known));
        spheres.fold(BoundingSphere::EMPTY, |all, sphere| all.union(&sphere))
    };
    match &node.class {
        NodeClass::Group
        | NodeClass::Switch(_)
        | NodeClass::Sequence(_)
        | NodeClass::CoordinateSystem(_)
        | NodeClass::Light { .. }
        | NodeClass::Projection(_)
        | NodeClass::Clip { .. } => children(),
        NodeClass::Terrain(settings, _) => {
            let above = std::mem::replace(&mut known.terrain, *settings);
            let spheres = node.children.iter().map(|child| sphere(child, known));
            let all = spheres.fold(BoundingSphere::EMPTY, |all, sphere| all.union(&sphere));
            known.terrain = above;
            all
        }
        NodeClass::TerrainTile(tile) => {
            known.samples = known.samples.saturating_add(tile.sample_count());
            let is_affordable = known.samples <= MAX_SAMPLES;
            if is_affordable { terrain::sphere(tile, &known.terrain) } else { BoundingSphere::EMPTY }
        }
        NodeClass::Transform { parent_from_child, is_absolute, .. } => {
            let map = parent_from_child.unwrap_or(DAffine3::IDENTITY);
            let sphere = children();
            // Children that move with the eye have no position.
            if *is_absolute || sphere.is_empty() { BoundingSphere::EMPTY } else { sphere.transformed(&map) }
        }
        // Children that are drawn over the view have no position.
        NodeClass::Camera(_) => BoundingSphere::EMPTY,
        NodeClass::AutoTransform(AutoObject { is_absolute: true, .. }) => BoundingSphere::EMPTY,
        NodeClass::AutoTransform(auto) => {
            let sphere = children();
            if sphere.is_empty() { sphere } else { sphere.transformed(&auto.parent_from_child()) }
        }
        NodeClass::Billboard(billboard) => {
            let spheres = node.children.iter().zip(&billboard.positions).map(|(drawable, position)| {
                let BoundingSphere { center, radius_m } = sphere(drawable, known);
                // It turns about its position.
                let reach_m = if radius_m < 0.0 { radius_m } else { center.length() + radius_m };
                BoundingSphere::new(*position, reach_m)
            });
            spheres.fold(BoundingSphere::EMPTY, |all, sphere| all.union(&sphere))
        }
        NodeClass::Lod(lod) | NodeClass::PagedLod(lod, _) => of_lod(lod, children),
        NodeClass::Proxy(ProxyObject { center_mode, user_center, .. }) => {
            of_center(*center_mode, *user_center, children)
        }
    }
}

/// Returns the sphere of an LOD whose children have the sphere that `children` returns.
pub(super) fn of_lod(lod: &LodObject, children: impl FnOnce() -> BoundingSphere) -> BoundingSphere {
    of_center(lod.center_mode, lod.user_center, children)
}

/// Returns the sphere of a node with a centre mode.
pub(super) fn of_center(
    mode: CenterMode,
    user_center: Option<(DVec3, f64)>,
    children: impl FnOnce() -> BoundingSphere,
) -> BoundingSphere {
    let own =
        user_center.filter(|(_, radius)| *radius >= 0.0).map(|(center, radius)| BoundingSphere::new(center, radius));
    match (mode, own) {
        (CenterMode::UserDefined, Some(own)) => own,
        (CenterMode::Union, Some(own)) => own.union(&children()),
        _ => children(),
    }
}

fn of_shape(shape: &ShapeObject) -> BoundingSphere {
    match shape {
        ShapeObject::Box { center, half_lengths, .. } => BoundingSphere::new(*center, half_lengths.length()),
        ShapeObject::Sphere { center, radius } => BoundingSphere::new(*center, radius.abs()),
        ShapeObject::Round { center, radius, height, .. } => BoundingSphere::new(*center, radius.abs() + height.abs()),
        ShapeObject::Triangles { positions, .. } => {
            let point = |i| DVec3::new(positions.get(i, 0), positions.get(i, 1), positions.get(i, 2));
            box_sphere(&Aabb::from_points((0..positions.count()).map(point).filter(|point| point.is_finite())))
        }
        ShapeObject::HeightField(field) => {
            let places = (0..field.rows).flat_map(|row| (0..field.columns).map(move |column| (column, row)));
            let points = places.map(|(column, row)| field.position(column, row));
            box_sphere(&Aabb::from_points(points.filter(|point| point.is_finite())))
        }
        ShapeObject::Composite(parts) => {
            parts.iter().fold(BoundingSphere::EMPTY, |all, part| all.union(&of_shape(part)))
        }
    }
}

fn box_sphere(bounds: &Aabb) -> BoundingSphere {
    if bounds.is_empty() { BoundingSphere::EMPTY } else { bounds.bounding_sphere() }
}
