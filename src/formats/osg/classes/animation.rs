//! The members of an AnimationPathCallback, as the pose that its path begins with.

use glam::{DAffine3, DQuat, DVec3};

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::Object;

/// The name under which the callback is counted.
const NOTE: &str = "OpenSceneGraph class osg::AnimationPathCallback (its first pose is drawn)";

impl Reader<'_> {
    /// Reads the members of a class of animation; `None` if it is none. The members of callbacks in binary differ between
    /// versions, so that only those of text are read.
    pub(super) fn pose_of(&mut self, class: &str) -> Result<Option<Object>> {
        if !self.input.is_text() {
            return Ok(None);
        }
        match class {
            "AnimationPathCallback" => {
                self.object_members()?;
                self.object_member("NestedCallback")?;
                let path = self.object_member("AnimationPath")?;
                let pivot = self.point_member("PivotPoint", DVec3::ZERO)?;
                let Object::Pose(pose) = path else { return Ok(Some(Object::Nothing)) };
                self.notes.add(NOTE);
                let pose = *pose * DAffine3::from_translation(-pivot);
                Ok(Some(if pose.is_finite() { Object::Pose(Box::new(pose)) } else { Object::Nothing }))
            }
            "AnimationPath" => {
                self.object_members()?;
                let mut first: Option<(f64, DAffine3)> = None;
                if self.marked_member("TimeControlPointMap")? {
                    for (time, pose) in self.list_unless_empty(Self::control_point)? {
                        if first.is_none_or(|(earliest, _)| time < earliest) {
                            first = Some((time, pose));
                        }
                    }
                }
                Ok(Some(first.map_or(Object::Nothing, |(_, pose)| Object::Pose(Box::new(pose)))))
            }
            _ => Ok(None),
        }
    }

    /// Reads a time with its pose.
    fn control_point(&mut self) -> Result<(f64, DAffine3)> {
        self.input.keyword("Time")?;
        let time = self.double()?;
        let pose = self.block(|reader| {
            let position = reader.point_member("Position", DVec3::ZERO)?;
            let rotation: DQuat = reader.rotation_member("Rotation")?;
            let scale = reader.point_member("Scale", DVec3::ONE)?;
            Ok(DAffine3::from_scale_rotation_translation(scale, rotation, position))
        })?;
        Ok((time, pose))
    }
}
