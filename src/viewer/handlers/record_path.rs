//! [`RecordCameraPathHandler`]: records and plays camera paths.

use std::path::PathBuf;

use crate::viewer::GuiActionAdapter;
use crate::viewer::camera_path::{AnimationPath, ControlPoint, PathError};
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;
use crate::viewer::manipulators::{AnimationPathManipulator, CameraManipulator, ManipulatorView};

#[derive(Clone, Copy, Debug)]
enum Action {
    Record,
    Play,
}

const KEYS: Bindings<Action> = Bindings(&[
    (&[Key::Char('z')], Action::Record, "record the camera path; again: write it"),
    (&[Key::Char('Z')], Action::Play, "play the recorded path; again: stop"),
]);

/// Records the camera's pose each frame, writes the path in OSG's text form and plays it; OSG's
/// `RecordCameraPathHandler`.
pub struct RecordCameraPathHandler {
    file: PathBuf,
    recording: Option<Vec<ControlPoint>>,
    path: Option<AnimationPath>,
    playing: Option<Playing>,
}

struct Playing {
    /// The manipulator before, which is restored at the end.
    before: Option<Box<dyn CameraManipulator>>,
}

impl RecordCameraPathHandler {
    /// Creates a handler that writes paths to a file. Until a path is recorded it plays the path in that file.
    pub fn new(file: PathBuf) -> Self {
        Self { file, recording: None, path: None, playing: None }
    }

    fn record(&mut self, viewer: &mut GuiActionAdapter<'_>) {
        let Some(points) = self.recording.take() else {
            self.stop(viewer);
            self.recording = Some(Vec::new());
            viewer.notify("recording the camera path; Z writes it");
            return;
        };
        let written = AnimationPath::new(points).and_then(|path| {
            path.write(&self.file)?;
            Ok(path)
        });
        match written {
            Ok(path) => {
                viewer.notify(format!("wrote {}", self.file.display()));
                self.path = Some(path);
            }
            Err(error) => viewer.notify(error.to_string()),
        }
    }

    fn play(&mut self, viewer: &mut GuiActionAdapter<'_>) -> Result<(), PathError> {
        if self.stop(viewer) {
            return Ok(());
        }
        if self.recording.is_some() {
            self.record(viewer);
        }
        let path = match &self.path {
            Some(path) => path.clone(),
            None => self.path.insert(AnimationPath::read(&self.file)?).clone(),
        };
        let before = viewer.take_manipulator();
        viewer.set_manipulator(Some(Box::new(AnimationPathManipulator::new(path))));
        self.playing = Some(Playing { before });
        Ok(())
    }

    /// Stops playing and restores the manipulator; returns false when no path was playing.
    fn stop(&mut self, viewer: &mut GuiActionAdapter<'_>) -> bool {
        let Some(playing) = self.playing.take() else { return false };
        // The manipulator continues from the current pose of the path.
        viewer.set_manipulator(playing.before);
        true
    }

    fn frame(&mut self, viewer: &mut GuiActionAdapter<'_>) {
        let now_s = viewer.frame_stamp().reference_time_s;
        if let Some(points) = &mut self.recording {
            points.push(ControlPoint::from_pose(now_s, &viewer.camera.world_from_eye));
        }
        let is_finished = |manipulator: &mut dyn CameraManipulator, _: &ManipulatorView<'_>| manipulator.is_finished();
        if self.playing.is_some() && viewer.with_manipulator(is_finished) == Some(true) {
            self.stop(viewer);
            viewer.notify("end of the path");
        }
    }
}

impl GuiEventHandler for RecordCameraPathHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        match KEYS.action(event) {
            Some(Action::Record) => self.record(viewer),
            Some(Action::Play) => {
                if let Err(error) = self.play(viewer) {
                    viewer.notify(error.to_string());
                }
            }
            None => {
                if event.mask() == EventMask::FRAME {
                    self.frame(viewer);
                }
                return false;
            }
        }
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN | EventMask::FRAME
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }
}
