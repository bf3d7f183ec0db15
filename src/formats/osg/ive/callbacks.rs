//! Callbacks of nodes and drawables.

use std::sync::Arc;

use super::{Reader, ids};
use crate::formats::osg::error::Result;
use crate::formats::osg::motion::{AnimationObject, Looping, PathObject, PathPoint};

impl Reader<'_> {
    /// Reads an AnimationPathCallback; `None` if it has no path.
    pub(super) fn animation(&mut self) -> Result<Option<Arc<AnimationObject>>> {
        self.expect(ids::ANIMATION_PATH_CALLBACK)?;
        self.object_members()?;
        let pivot = self.point()?;
        // The time of the first frame and that of a pause follow; OSG's reader sets no pause.
        let [offset_s, multiplier, ..] = self.doubles::<4>()?;
        if self.integer()? == 0 {
            return Ok(None);
        }
        let path = self.animation_path()?.map(Arc::new);
        let moves = |path| AnimationObject { path, pivot, is_inverse: false, offset_s, multiplier, is_paused: false };
        Ok(path.map(|path| Arc::new(moves(path))))
    }

    fn animation_path(&mut self) -> Result<Option<PathObject>> {
        const POINT_BYTES: usize = 11 * 4;
        self.expect(ids::ANIMATION_PATH)?;
        self.object_members()?;
        let looping = Looping::of_number(self.unsigned()?);
        let points = self.list(POINT_BYTES, |reader| {
            let time_s = reader.float()?.into();
            let (position, rotation) = (reader.point()?, reader.rotation()?);
            Ok(PathPoint { time_s, position, rotation, scale: reader.point()? })
        })?;
        Ok(PathObject::new(points, looping))
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
