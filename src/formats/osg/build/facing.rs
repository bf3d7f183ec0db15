//! Billboards and AutoTransforms: drawables that turn towards the eye or keep their size on the screen.
//!
//! The engine's billboards look along -y and have z up. So the vertices are turned once, from the directions that the file
//! gives, and moved so that their pivot is the origin.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::Builder;
use crate::fetch::IoError;
use crate::formats::osg::objects::{
    AutoObject, AutoTurn, BillboardObject, BillboardTurn, DrawableObject, NodeClass, NodeObject, Object,
};
use crate::math::Aabb;
use crate::scene::{AutoScale, Billboard, BillboardMode, Drawable, Geometry, Mesh, Node, NodeKind};

/// Scales from here on are no limit; OSG's writers use the largest double.
const ENDLESS_SCALE: f64 = 1e30;

/// How drawables face the eye.
#[derive(Clone, Copy)]
pub(super) struct Facing {
    pub position: DVec3,
    pub mode: BillboardMode,
    pub auto_scale: Option<AutoScale>,
}

/// Turns what has x to the right and y up on the screen to the directions of the engine's billboards.
pub(super) fn upright() -> DQuat {
    DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2)
}

impl Builder<'_> {
    pub(super) fn billboard(&mut self, object: &Arc<NodeObject>, billboard: &BillboardObject) -> Result<Node, IoError> {
        let BillboardObject { axis, normal, .. } = *billboard;
        let normal = normal.normalize_or(DVec3::NEG_Y);
        let (mode, turn) = match billboard.mode {
            // OSG turns the normal to the z axis, and that to the eye.
            BillboardTurn::Eye => {
                let to_z = |from| DQuat::from_rotation_arc(from, DVec3::Z);
                (BillboardMode::PointRotEye, to_z(DVec3::NEG_Y).inverse() * to_z(normal))
            }
            BillboardTurn::World => (BillboardMode::PointRotWorld, DQuat::from_rotation_arc(normal, DVec3::NEG_Y)),
            BillboardTurn::Axis => {
                let axis = axis.normalize_or(DVec3::Z);
                let front = (normal - axis * axis.dot(normal)).try_normalize();
                let front = front.unwrap_or_else(|| axis.any_orthonormal_vector());
                // The columns are what becomes x, y and z.
                let from_engine = DMat3::from_cols((-front).cross(axis), -front, axis);
                (BillboardMode::AxialRot { axis }, DQuat::from_mat3(&from_engine.transpose()))
            }
        };
        let mut nodes = Vec::with_capacity(object.children.len());
        for (number, child) in object.children.iter().enumerate() {
            let Object::Drawable(drawable) = child else {
                nodes.push(self.node(child)?);
                continue;
            };
            self.count_nodes(1)?;
            let position = billboard.positions.get(number).copied().unwrap_or(DVec3::ZERO);
            let facing = Facing { position, mode, auto_scale: None };
            nodes.push(self.facing_drawable(drawable, &DAffine3::from_quat(turn), &facing)?);
        }
        Ok(Node::group(nodes))
    }

    pub(super) fn auto_transform(&mut self, object: &Arc<NodeObject>, auto: &AutoObject) -> Result<Node, IoError> {
        let still = auto.parent_from_child();
        if auto.is_absolute || !still.is_finite() || (auto.turn == AutoTurn::No && auto.screen_scales.is_none()) {
            let map = if still.is_finite() { still } else { DAffine3::IDENTITY };
            let kind = if auto.is_absolute { NodeKind::AbsoluteTransform(map) } else { NodeKind::Transform(map) };
            return Ok(Node { children: self.children(&object.children)?, ..Node::new(kind) });
        }
        let auto_scale = auto.screen_scales.map(|[min, max]| AutoScale {
            min: min.max(0.0),
            max: if max < ENDLESS_SCALE { max } else { f64::INFINITY },
        });
        let (mode, turn) = match auto.turn {
            AutoTurn::No => (BillboardMode::NoRotation, auto.rotation),
            // The children are parallel to the screen with x to the right and y up.
            AutoTurn::Screen => (BillboardMode::PointRotEye, upright()),
            AutoTurn::Camera => {
                self.note("OpenSceneGraph: AutoTransform that rotates to the camera (it is parallel to the screen)");
                (BillboardMode::PointRotEye, upright())
            }
        };
        // The screen's scale replaces that of the file.
        let scale = if auto_scale.is_some() { DVec3::ONE } else { auto.scale };
        let map = DAffine3::from_scale_rotation_translation(scale, turn, DVec3::ZERO);
        let map = map * DAffine3::from_translation(-auto.pivot);
        let facing = Facing { position: auto.position, mode, auto_scale };
        let nodes = object.children.iter().map(|child| self.facing_node(child, &map, &facing));
        Ok(Node::group(nodes.collect::<Result<_, _>>()?))
    }

    /// Makes a node below an AutoTransform. `pivot_from_node` maps it to the frame whose origin is the pivot.
    fn facing_node(&mut self, object: &Object, pivot_from_node: &DAffine3, facing: &Facing) -> Result<Node, IoError> {
        self.count_nodes(1)?;
        let node = match object {
            Object::Drawable(drawable) => return self.facing_drawable(drawable, pivot_from_node, facing),
            Object::Node(node) => node,
            _ => return Ok(Node::group(Vec::new())),
        };
        let map = match &node.class {
            NodeClass::Group | NodeClass::CoordinateSystem(_) => *pivot_from_node,
            NodeClass::Transform { parent_from_child: Some(map), is_absolute: false, .. } => *pivot_from_node * *map,
            _ => {
                self.note("OpenSceneGraph: AutoTransform over a node that it does not turn");
                let still = DAffine3::from_translation(facing.position) * *pivot_from_node;
                return Ok(Node::transform(still, vec![self.node(object)?]));
            }
        };
        let state_set = node.state.as_ref().and_then(|state| self.state_set(state));
        let depth = self.states.len();
        self.states.extend(node.state.clone());
        let children: Result<Vec<Node>, IoError> =
            node.children.iter().map(|child| self.facing_node(child, &map, facing)).collect();
        self.states.truncate(depth);
        Ok(Node { name: node.name.clone(), mask: node.mask, state_set, ..Node::group(children?) })
    }

    /// Makes the node of a drawable that faces the eye.
    pub(super) fn facing_drawable(
        &mut self,
        object: &Arc<DrawableObject>,
        pivot_from_drawable: &DAffine3,
        facing: &Facing,
    ) -> Result<Node, IoError> {
        let mut geode = self.still_geode(object)?;
        let mut map = *pivot_from_drawable;
        if let NodeKind::Transform(own) = &geode.kind {
            // Positions of doubles have an origin of their own.
            map *= *own;
            geode = geode.children.pop().unwrap_or_else(|| Node::group(Vec::new()));
        }
        let kind = std::mem::replace(&mut geode.kind, NodeKind::Group);
        if let NodeKind::Geode(drawables) = kind {
            let drawables = drawables.into_iter().map(|drawable| (facing.position, moved(drawable, &map)));
            let Facing { mode, auto_scale, .. } = *facing;
            let billboard = Billboard { mode, auto_scale, drawables: drawables.collect() };
            geode.kind = NodeKind::Billboard(Box::new(billboard));
        }
        Ok(geode)
    }
}

/// Returns a drawable whose vertices are mapped.
fn moved(mut drawable: Drawable, map: &DAffine3) -> Drawable {
    // The normal cone and the hash of the geometry do not hold any more.
    (drawable.cluster, drawable.shared.geometry) = (None, None);
    if let Geometry::Mesh(mesh) = &mut drawable.geometry {
        let mut turned = Mesh::clone(mesh);
        for vertex in &mut turned.vertices {
            let position = DVec3::from_array(vertex.position.map(f64::from));
            vertex.position = map.transform_point3(position).as_vec3().to_array();
            let [x, y, z, w] = vertex.normal;
            let normal = map.matrix3 * DVec3::from_array([x, y, z].map(f64::from));
            let [x, y, z] = normal.normalize_or_zero().to_array().map(|part| (part * 127.0).round() as i8);
            vertex.normal = [x, y, z, w];
        }
        let positions = turned.vertices.iter().map(|vertex| DVec3::from_array(vertex.position.map(f64::from)));
        turned.bounds = Aabb::from_points(positions);
        *mesh = Arc::new(turned);
    }
    drawable
}
