//! [`SkinPose`]: the joints of a skin in the pose that the nodes of the file give.

use glam::{Affine3A, DAffine3, DMat4, DVec3};
use gltf::accessor::Dimensions;

use crate::fetch::IoError;
use crate::formats::gltf::accessors::Buffers;
use crate::formats::gltf::context::Context;

/// The pose of a skin.
pub(in super::super) struct SkinPose {
    /// Maps positions of the mesh to the frame of the glTF relative to `origin`, by joint.
    pub joints: Vec<Affine3A>,
    /// The position of the first joint, which keeps the coordinates small enough for f32.
    pub origin: DVec3,
}

impl SkinPose {
    /// Reads a skin. `root_from_node` returns the transform of a node to the frame of the glTF.
    pub fn new(
        skin: &gltf::Skin<'_>,
        buffers: &Buffers<'_>,
        context: &Context<'_>,
        root_from_node: impl Fn(usize) -> Option<DAffine3>,
    ) -> Result<Self, IoError> {
        let inverse_binds = match skin.inverse_bind_matrices() {
            Some(accessor) if accessor.dimensions() == Dimensions::Mat4 => {
                context.budget.add_vertices(accessor.count())?;
                buffers.elements(&accessor, Dimensions::Mat4)?
            }
            Some(_) => return Err(context.bad("inverseBindMatrices of the wrong type")),
            None => None,
        };
        let mut joints = Vec::new();
        for (i, joint) in skin.joints().enumerate() {
            let pose = root_from_node(joint.index());
            let pose = pose.ok_or_else(|| context.bad("transform of a joint is not affine and finite"))?;
            let inverse_bind = match &inverse_binds {
                Some(elements) if i < elements.count => {
                    DAffine3::from_mat4(DMat4::from_cols_array(&elements.vector::<16>(i).map(f64::from)))
                }
                Some(_) => return Err(context.bad("a skin has fewer inverseBindMatrices than joints")),
                None => DAffine3::IDENTITY,
            };
            joints.push((pose.translation, pose * inverse_bind));
        }
        let origin = joints.first().map_or(DVec3::ZERO, |(position, _)| *position);
        let relative = |map: &DAffine3| DAffine3 { translation: map.translation - origin, ..*map }.as_affine3a();
        let joints: Vec<Affine3A> = joints.iter().map(|(_, map)| relative(map)).collect();
        if joints.is_empty() || !joints.iter().all(|joint| joint.is_finite()) {
            return Err(context.bad("a skin has no joints, or a joint that is not finite"));
        }
        Ok(Self { joints, origin })
    }
}
