//! Morph targets at their default weights, and skins in their rest pose. glTF animates both; a still scene applies them once.

use glam::{Affine3A, Vec3};
use gltf::accessor::Dimensions;
use gltf::mesh::Semantic;

use super::primitive::PrimitiveData;
use super::skin::SkinPose;
use crate::fetch::IoError;
use crate::formats::gltf::accessors::Elements;

/// The maximum number of sets of joints: each set is four more joints of a vertex.
const MAX_JOINT_SETS: u32 = 8;

/// The changes that a node makes to the vertices of its mesh.
#[derive(Clone, Copy)]
pub(super) struct Deformation<'a> {
    /// The weights of the morph targets, in their order.
    pub weights: &'a [f32],
    pub skin: Option<&'a SkinPose>,
}

impl Deformation<'_> {
    /// Returns true if the vertices stay as they are.
    pub fn is_none(&self) -> bool {
        self.skin.is_none() && self.weights.iter().all(|weight| *weight == 0.0)
    }
}

/// Positions and normals after the deformation.
pub(super) struct Deformed {
    pub positions: Vec<Vec3>,
    /// Empty if the primitive has no normals. Not normalized.
    pub normals: Vec<Vec3>,
}

impl Deformed {
    /// Deforms the positions and normals of a primitive.
    pub fn new(
        data: &PrimitiveData<'_>,
        positions: &Elements<'_>,
        normals: Option<&Elements<'_>>,
        by: Deformation<'_>,
    ) -> Result<Self, IoError> {
        let all = |elements: &Elements<'_>| -> Vec<Vec3> {
            (0..data.count).map(|i| Vec3::from_array(elements.vector(i))).collect()
        };
        let mut deformed = Self { positions: all(positions), normals: normals.map(all).unwrap_or_default() };
        for (target, weight) in data.morph_targets().zip(by.weights) {
            if *weight == 0.0 || !weight.is_finite() {
                continue;
            }
            for (accessor, vertices) in
                [(target.positions(), &mut deformed.positions), (target.normals(), &mut deformed.normals)]
            {
                let Some(accessor) = accessor else { continue };
                let Some(elements) = data.displacement(&accessor)? else { continue };
                for (i, vertex) in vertices.iter_mut().enumerate() {
                    *vertex += *weight * Vec3::from_array(elements.vector(i));
                }
            }
        }
        if let Some(skin) = by.skin {
            deformed.apply_skin(data, skin)?;
        }
        Ok(deformed)
    }

    /// Replaces each vertex by the weighted mean of where its joints map it. Vertices without weights follow the first joint.
    fn apply_skin(&mut self, data: &PrimitiveData<'_>, skin: &SkinPose) -> Result<(), IoError> {
        let mut sets = Vec::new();
        for set in 0..MAX_JOINT_SETS {
            let joints = data.attribute(&Semantic::Joints(set), &[Dimensions::Vec4])?;
            let weights = data.attribute(&Semantic::Weights(set), &[Dimensions::Vec4])?;
            let (Some(joints), Some(weights)) = (joints, weights) else { break };
            sets.push((joints, weights));
        }
        let Self { positions, normals } = self;
        for (i, position) in positions.iter_mut().enumerate() {
            let (mut sum, mut map) = (0.0, Affine3A::ZERO);
            for (joints, weights) in &sets {
                for (c, weight) in weights.vector::<4>(i).into_iter().enumerate() {
                    let joint = skin.joints.get(joints.unsigned(i, c) as usize);
                    let Some(joint) = joint.filter(|_| weight > 0.0) else { continue };
                    sum += weight;
                    map.matrix3 += joint.matrix3 * weight;
                    map.translation += joint.translation * weight;
                }
            }
            if sum > 0.0 {
                map.matrix3 *= 1.0 / sum;
                map.translation /= sum;
            } else {
                map = skin.joints[0];
            }
            *position = map.transform_point3(*position);
            if let Some(normal) = normals.get_mut(i) {
                // Exact for joints that rotate and scale alike along all axes.
                *normal = map.transform_vector3(*normal);
            }
        }
        Ok(())
    }
}
