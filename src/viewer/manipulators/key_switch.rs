//! Several manipulators, one at a time.

use glam::DAffine3;

use super::{CameraManipulator, ManipulatorView, usage};
use crate::viewer::events::{EventKind, GuiEventAdapter, Key, Usage};

/// Chooses among manipulators by keys; the one chosen goes on from where the other was. OSG's
/// `KeySwitchMatrixManipulator`.
#[derive(Default)]
pub struct KeySwitchManipulator {
    choices: Vec<(Key, &'static str, Box<dyn CameraManipulator>)>,
    current: usize,
    pose: Option<DAffine3>,
    announced: bool,
}

impl KeySwitchManipulator {
    /// None to choose from.
    pub fn new() -> Self {
        Self::default()
    }

    /// With one more; the first is chosen at the start. A key that is taken already is never reached.
    #[must_use]
    pub fn with(mut self, key: Key, name: &'static str, manipulator: impl CameraManipulator + 'static) -> Self {
        self.choices.push((key, name, Box::new(manipulator)));
        self
    }

    /// The same with another one chosen at the start, by name.
    #[must_use]
    pub fn starting_with(mut self, name: &str) -> Self {
        self.current = self.choices.iter().position(|(_, n, _)| *n == name).unwrap_or(self.current);
        self
    }

    /// Name of the one that is chosen.
    pub fn current_name(&self) -> &'static str {
        self.choices.get(self.current).map_or("", |(_, name, _)| name)
    }

    /// Chooses by name; false when there is none of that name.
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
        self.announced |= self.current != index;
        self.current = index;
        if let (Some((.., chosen)), Some(pose)) = (self.choices.get_mut(index), &self.pose) {
            chosen.set_pose(pose, view);
        }
    }

    fn chosen(&mut self) -> Option<&mut Box<dyn CameraManipulator>> {
        self.choices.get_mut(self.current).map(|(.., chosen)| chosen)
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
        self.chosen().is_some_and(|chosen| chosen.handle(event, view))
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let last = self.pose.unwrap_or(view.camera.world_from_eye);
        let pose = self.chosen().map_or(last, |chosen| chosen.advance(dt_s, view));
        self.pose = Some(if pose.is_finite() { pose } else { last });
        self.pose.unwrap_or(last)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if world_from_eye.is_finite() {
            self.pose = Some(*world_from_eye);
            self.chosen().into_iter().for_each(|chosen| chosen.set_pose(world_from_eye, view));
        }
    }

    fn home(&mut self, view: &ManipulatorView<'_>) {
        self.chosen().into_iter().for_each(|chosen| chosen.home(view));
    }

    fn is_moving(&self) -> bool {
        self.choices.get(self.current).is_some_and(|(.., chosen)| chosen.is_moving())
    }

    fn pose_after(&self, seconds: f64) -> Option<DAffine3> {
        self.choices.get(self.current).and_then(|(.., chosen)| chosen.pose_after(seconds))
    }

    fn take_notice(&mut self) -> Option<String> {
        std::mem::take(&mut self.announced).then(|| self.current_name().to_owned())
    }

    fn usage(&self) -> Vec<Usage> {
        let switches = self.choices.iter().map(|(key, name, _)| usage(&key.to_string(), name));
        let own = self.choices.get(self.current).map(|(.., chosen)| chosen.usage());
        switches.chain(own.into_iter().flatten()).collect()
    }
}
