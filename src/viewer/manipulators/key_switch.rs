//! [`KeySwitchManipulator`]: switches between manipulators by keys.

use glam::DAffine3;

use super::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::events::{EventKind, GuiEventAdapter, Key, Usage};

/// Switches between manipulators by keys; the new one continues from the pose of the old one. OSG's
/// `KeySwitchMatrixManipulator`.
#[derive(Default)]
pub struct KeySwitchManipulator {
    choices: Vec<(Key, &'static str, Box<dyn CameraManipulator>)>,
    current: usize,
    pose: Option<DAffine3>,
    needs_notice: bool,
}

impl KeySwitchManipulator {
    /// Creates a switch without manipulators.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a manipulator under a key. The first one is active at the start. When two have the same key, the earlier one
    /// gets it.
    #[must_use]
    pub fn with(mut self, key: Key, name: &'static str, manipulator: impl CameraManipulator + 'static) -> Self {
        self.choices.push((key, name, Box::new(manipulator)));
        self
    }

    /// Makes another manipulator active at the start, by name; an unknown name changes nothing.
    #[must_use]
    pub fn starting_with(mut self, name: &str) -> Self {
        self.current = self.choices.iter().position(|(_, n, _)| *n == name).unwrap_or(self.current);
        self
    }

    /// Returns the name of the active manipulator; empty without one.
    pub fn current_name(&self) -> &'static str {
        self.choices.get(self.current).map_or("", |(_, name, _)| name)
    }

    /// Makes a manipulator active by name; returns false when the name is unknown.
    pub fn choose(&mut self, name: &str, view: &ManipulatorView<'_>) -> bool {
        match self.choices.iter().position(|(_, n, _)| *n == name) {
            Some(index) => {
                self.switch(index, view);
                true
            }
            None => false,
        }
    }

    fn switch(&mut self, index: usize, view: &ManipulatorView<'_>) {
        self.needs_notice |= self.current != index;
        self.current = index;
        if let (Some((.., active)), Some(pose)) = (self.choices.get_mut(index), &self.pose) {
            active.set_pose(pose, view);
        }
    }

    fn active(&mut self) -> Option<&mut Box<dyn CameraManipulator>> {
        self.choices.get_mut(self.current).map(|(.., active)| active)
    }
}

impl CameraManipulator for KeySwitchManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        if let (Some(key), EventKind::KeyDown { .. }) = (event.key_pressed(), &event.kind)
            && let Some(index) = self.choices.iter().position(|(k, ..)| *k == key)
        {
            self.switch(index, view);
            return true;
        }
        self.active().is_some_and(|active| active.handle(event, view))
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let last = self.pose.unwrap_or(view.camera.world_from_eye);
        let pose = self.active().map_or(last, |active| active.advance(dt_s, view));
        self.pose = Some(if pose.is_finite() { pose } else { last });
        self.pose.unwrap_or(last)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if world_from_eye.is_finite() {
            self.pose = Some(*world_from_eye);
            self.active().into_iter().for_each(|active| active.set_pose(world_from_eye, view));
        }
    }

    fn home(&mut self, view: &ManipulatorView<'_>) {
        self.active().into_iter().for_each(|active| active.home(view));
    }

    fn is_moving(&self) -> bool {
        self.choices.get(self.current).is_some_and(|(.., active)| active.is_moving())
    }

    fn pose_after(&self, seconds: f64) -> Option<DAffine3> {
        self.choices.get(self.current).and_then(|(.., active)| active.pose_after(seconds))
    }

    fn take_notice(&mut self) -> Option<String> {
        std::mem::take(&mut self.needs_notice).then(|| self.current_name().to_owned())
    }

    fn usage(&self) -> Vec<Usage> {
        let switches = self.choices.iter().map(|(key, name, _)| Usage::new(&key.to_string(), name));
        let own = self.choices.get(self.current).map(|(.., active)| active.usage());
        switches.chain(own.into_iter().flatten()).collect()
    }
}
