//! Cameras and Projections of a file that draw to the view: texts and images over it. Decode threads.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec4};

use super::{Builder, bounds};
use crate::fetch::IoError;
use crate::formats::osg::objects::{CameraObject, CameraOrder, NodeObject};
use crate::math::BoundingSphere;
use crate::math::color::linear_rgba;
use crate::scene::{CameraNode, Node, NodeKind, ReferenceFrame, RenderOrder};

impl Builder<'_> {
    /// Makes the node of a Camera; an empty group, noted, if it does not draw to the view.
    pub(super) fn camera(&mut self, object: &Arc<NodeObject>, camera: &CameraObject) -> Result<Node, IoError> {
        match self.camera_of(object, camera) {
            Ok(made) => {
                let kind = NodeKind::Camera(Box::new(made));
                Ok(Node { children: self.children(&object.children)?, ..Node::new(kind) })
            }
            Err(reason) => {
                self.note(format!("OpenSceneGraph class osg::Camera ({reason})"));
                Ok(Node::group(Vec::new()))
            }
        }
    }

    /// Returns the camera of the engine, or the reason why there is none.
    fn camera_of(&mut self, object: &NodeObject, camera: &CameraObject) -> Result<CameraNode, &'static str> {
        let order = match camera.order {
            _ if camera.has_target => return Err("it draws to a texture or to a window"),
            _ if camera.has_viewport => return Err("it draws to a part of the window"),
            CameraOrder::Before => return Err("it draws before the view, which covers it"),
            CameraOrder::Nested => RenderOrder::Nested,
            CameraOrder::After => RenderOrder::PostRender(camera.number),
        };
        let is_affine = camera.view.is_finite() && camera.view.row(3) == DVec4::W;
        if !is_affine {
            return Err("its view is not affine");
        }
        let view = DAffine3::from_mat4(camera.view);
        let keeps_projection = !camera.is_absolute && camera.projection == DMat4::IDENTITY;
        let projection = match keeps_projection {
            true => None,
            // OSG multiplies it with the one above.
            false if !camera.is_absolute => return Err("its projection is relative"),
            false => {
                let spheres = object.children.iter().map(|child| bounds::sphere(child, &mut self.spheres));
                let all = spheres.fold(BoundingSphere::EMPTY, |all, sphere| all.union(&sphere));
                let in_eye = if all.is_empty() { all } else { all.transformed(&view) };
                Some(reversed(camera.projection, &in_eye).ok_or("its projection is unusual")?)
            }
        };
        let frame = if camera.is_absolute { ReferenceFrame::Absolute } else { ReferenceFrame::Relative };
        let clears = |bit: u32| camera.clear_mask & bit != 0;
        Ok(CameraNode {
            view,
            frame,
            projection,
            clear_color: clears(CameraObject::CLEAR_COLOR).then(|| linear_rgba(camera.clear_color)),
            clear_depth: clears(CameraObject::CLEAR_DEPTH),
            ..CameraNode::new(order)
        })
    }

    /// Makes the node of a Projection; a group, noted, if its matrix is unusual.
    pub(super) fn projection(&mut self, object: &Arc<NodeObject>, matrix: DMat4) -> Result<Node, IoError> {
        let kind = match reversed(matrix, &BoundingSphere::EMPTY) {
            Some(projection) => NodeKind::Projection(projection),
            None => {
                self.note("OpenSceneGraph class osg::Projection (its children are drawn)");
                NodeKind::Group
            }
        };
        Ok(Node { children: self.children(&object.children)?, ..Node::new(kind) })
    }
}

/// Returns a projection of OpenGL with reversed depths; `None` unless it is an orthographic or a perspective one. As OSG
/// computes near and far planes, parallel rays reach everything that is drawn, and others reach infinitely far.
fn reversed(projection: DMat4, drawn_in_eye: &BoundingSphere) -> Option<DMat4> {
    let (depth, w) = (projection.row(2), projection.row(3));
    if !projection.is_finite() || depth.truncate().truncate() != glam::DVec2::ZERO {
        return None;
    }
    let row = if w == DVec4::W && depth.z != 0.0 {
        // The distances at which OpenGL's depth is -1 and 1.
        let [mut near, mut far] = [(1.0 + depth.w) / depth.z, (depth.w - 1.0) / depth.z];
        if !drawn_in_eye.is_empty() {
            let distance = -drawn_in_eye.center.z;
            let [nearest, farthest] = [distance - drawn_in_eye.radius_m, distance + drawn_in_eye.radius_m];
            (near, far) = (near.min(nearest), far.max(farthest));
        }
        DVec4::new(0.0, 0.0, 1.0 / (far - near), far / (far - near))
    } else if w == DVec4::new(0.0, 0.0, -1.0, 0.0) {
        let near = depth.w / (depth.z - 1.0);
        DVec4::new(0.0, 0.0, 0.0, near)
    } else {
        return None;
    };
    let is_valid = row.is_finite() && row.w > 0.0 && row.z >= 0.0;
    let [x, y] = [projection.row(0), projection.row(1)];
    is_valid.then(|| DMat4::from_cols(x, y, row, w).transpose())
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, dcamera::rh::proj};

    use super::*;

    #[test]
    fn depths_are_reversed_and_reach_what_is_drawn() {
        let none = BoundingSphere::EMPTY;
        let flat = proj::opengl::orthographic(0.0, 100.0, 0.0, 50.0, -1.0, 1.0);
        let made = reversed(flat, &none).unwrap();
        let expected = proj::directx::orthographic(0.0, 100.0, 0.0, 50.0, 1.0, -1.0);
        assert!(made.abs_diff_eq(expected, 1e-12), "{made}");
        let far_away = BoundingSphere::new(DVec3::new(50.0, 25.0, -20.0), 5.0);
        let made = reversed(flat, &far_away).unwrap();
        let depth = |z: f64| made.project_point3(DVec3::new(1.0, 1.0, z)).z;
        assert!((depth(-25.0) - 0.0).abs() < 1e-12 && (depth(1.0) - 1.0).abs() < 1e-12, "{made}");
        let made = reversed(proj::opengl::perspective(1.0, 1.5, 0.5, 100.0), &none).unwrap();
        assert!(made.abs_diff_eq(proj::directx::perspective_infinite_reverse(1.0, 1.5, 0.5), 1e-9), "{made}");
        let skewed = flat * DMat4::from_rotation_x(0.5);
        assert_eq!([DMat4::ZERO, DMat4::NAN, skewed].map(|matrix| reversed(matrix, &none)), [None; 3]);
    }
}
