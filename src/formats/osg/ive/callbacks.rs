//! Callbacks of nodes and drawables.

use glam::DAffine3;

use super::{Reader, ids};
use crate::formats::osg::error::Result;

impl Reader<'_> {
    /// Reads an AnimationPathCallback: the pose that its path begins with, if it has one.
    pub(super) fn animation(&mut self) -> Result<Option<Box<DAffine3>>> {
        self.expect(ids::ANIMATION_PATH_CALLBACK)?;
        self.object_members()?;
        let pivot = self.point()?;
        // Offset, multiplier, first and pause time.
        self.doubles::<4>()?;
        if self.integer()? == 0 {
            return Ok(None);
        }
        let Some(first) = self.animation_path()? else { return Ok(None) };
        self.notes.add("OpenSceneGraph class osg::AnimationPathCallback (its first pose is drawn)");
        let pose = first * DAffine3::from_translation(-pivot);
        Ok(pose.is_finite().then(|| Box::new(pose)))
    }

    /// Reads an AnimationPath, and returns its earliest pose.
    fn animation_path(&mut self) -> Result<Option<DAffine3>> {
        const POINT_BYTES: usize = 11 * 4;
        self.expect(ids::ANIMATION_PATH)?;
        self.object_members()?;
        // The loop mode.
        self.integer()?;
        let mut first: Option<(f32, DAffine3)> = None;
        for _ in 0..self.count(POINT_BYTES)? {
            let time = self.float()?;
            let (position, rotation, scale) = (self.point()?, self.rotation()?, self.point()?);
            if first.is_none_or(|(earliest, _)| time < earliest) {
                first = Some((time, DAffine3::from_scale_rotation_translation(scale, rotation, position)));
            }
        }
        Ok(first.map(|(_, pose)| pose))
    }

    /// Reads over a ClusterCullingCallback: the cones of normals are computed again.
    pub(super) fn cluster_culling(&mut self) -> Result<()> {
        self.expect(ids::CLUSTER_CULLING_CALLBACK)?;
        self.object_members()?;
        // The control point, the normal, the radius and the deviation.
        self.floats::<8>().map(drop)
    }

    /// Reads over the callback of osgVolume that turns key strokes into properties.
    pub(super) fn property_adjustment(&mut self) -> Result<()> {
        self.expect(ids::VOLUME_PROPERTY_ADJUSTMENT_CALLBACK)?;
        self.object_members()?;
        self.integers::<5>().map(drop)
    }
}
