//! The members of what moves: Sequence, AnimationPath and AnimationPathCallback.

use std::sync::Arc;

use glam::DVec3;

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::Names;
use crate::formats::osg::motion::{AnimationObject, Looping, PathObject, PathPoint, SequenceObject};
use crate::formats::osg::objects::{NodeClass, Object};

/// The version since which the members of NodeCallback are those of Callback, which subclasses do not write.
const VERSION_OF_CALLBACKS: u32 = 112;

impl Reader<'_> {
    pub(super) fn sequence(&mut self) -> Result<Object> {
        const LOOPS: Names = &[("LOOP", 0), ("SWING", 1)];
        const START: u32 = 0;
        const MODES: Names = &[("START", START), ("STOP", 1), ("PAUSE", 2), ("RESUME", 3)];
        let (node, children) = self.group_members()?;
        let mut sequence = SequenceObject { times_s: vec![1.0; children.len()], ..SequenceObject::default() };
        let times_s = self.vector_member("TimeList", Self::double)?;
        if !times_s.is_empty() {
            sequence.times_s = times_s;
        }
        sequence.swings = self.named_member("LoopMode", LOOPS, 0)? == 1;
        sequence.interval = [self.integer_member("Begin", 0)?, self.integer_member("End", -1)?];
        sequence.speed = self.float_member("Speed", 0.0)?.into();
        sequence.repeats = self.integer_member("NumRepeats", -1)?;
        // The time of children that are added later.
        self.double_member("DefaultTime", 1.0)?;
        sequence.last_time_s = self.double_member("LastFrameTime", 0.0)?;
        sequence.plays = self.named_member("Mode", MODES, 1)? == START;
        // Whether it skips children if frames are late.
        self.boolean_member("Sync", false)?;
        sequence.clears = self.boolean_member("ClearOnStop", false)?;
        Ok(node.with(NodeClass::Sequence(sequence), children))
    }

    /// Reads the members of a class of animation; `None` if it is none.
    pub(super) fn animation_of(&mut self, class: &str) -> Result<Option<Object>> {
        match class {
            "AnimationPathCallback" => self.animation_path_callback().map(Some),
            "AnimationPath" => self.animation_path().map(Some),
            _ => Ok(None),
        }
    }

    fn animation_path_callback(&mut self) -> Result<Object> {
        self.object_members()?;
        if self.input.is_text() || self.version < VERSION_OF_CALLBACKS {
            self.object_member("NestedCallback")?;
        }
        let path = self.object_member("AnimationPath")?;
        let pivot = self.point_member("PivotPoint", DVec3::ZERO)?;
        let is_inverse = self.boolean_member("UseInverseMatrix", false)?;
        let [offset_s, multiplier] =
            [self.double_member("TimeOffset", 0.0)?, self.double_member("TimeMultiplier", 1.0)?];
        let is_paused = self.boolean_member("Pause", false)?;
        let Object::Path(path) = path else { return Ok(Object::Nothing) };
        let animation = AnimationObject { path, pivot, is_inverse, offset_s, multiplier, is_paused };
        Ok(Object::Animation(Arc::new(animation)))
    }

    fn animation_path(&mut self) -> Result<Object> {
        const MODES: Names = &[("SWING", 0), ("LOOP", 1), ("NO_LOOPING", 2)];
        self.object_members()?;
        let mut points = Vec::new();
        if self.marked_member("TimeControlPointMap")? {
            points = self.list_unless_empty(Self::path_point)?;
        }
        let looping = Looping::of_number(self.named_member("LoopMode", MODES, 1)?);
        Ok(PathObject::new(points, looping).map_or(Object::Nothing, |path| Object::Path(Arc::new(path))))
    }

    /// Reads a time with its pose.
    fn path_point(&mut self) -> Result<PathPoint> {
        self.input.keyword("Time")?;
        let time_s = self.double()?;
        self.block(|reader| {
            let position = reader.point_member("Position", DVec3::ZERO)?;
            let rotation = reader.rotation_member("Rotation")?;
            Ok(PathPoint { time_s, position, rotation, scale: reader.point_member("Scale", DVec3::ONE)? })
        })
    }
}
