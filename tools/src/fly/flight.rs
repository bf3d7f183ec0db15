//! A flight: sets the camera of each frame, and collects images, hole counts and the report. The caller draws the frames.

use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use image::RgbaImage;
use terrane::cull::Stereo;
use terrane::fetch::shown;
use terrane::scene::{Sky, SunShadows, Water};
use terrane::viewer::{
    AnimationPath, HoleCheck, KEY_COLOR, LoadedRoot, Report, Settled, ViewFrom, Viewer, ViewerError,
};
use terrane_data_gen::Progress;

use super::defaults::{DEFAULT_FRAMES, DEFAULT_SOFTWARE_FRAMES, HEIGHT_SSE_PX, MESH_SSE_PX};
use super::hole_counter::HoleCounter;
use super::image_writer::{self, ImageWriter};
use super::summary;
use crate::args::FlyArgs;

/// The time after which waiting for a hidden window to show the settled frame ends.
const HIDDEN_TIMEOUT: Duration = Duration::from_secs(10);
/// The time between two frames offscreen while the first view loads. These frames are shown nowhere, and a software driver draws
/// them on the cores that load.
const UNSEEN_PERIOD: Duration = Duration::from_millis(250);
/// The longest time until the end of that loading is noticed.
const UNSEEN_SLICE: Duration = Duration::from_millis(2);
/// The time without progress of the pager after which waiting for the settled frame ends.
const STALL_TIMEOUT: Duration = Duration::from_secs(60);

/// The purpose of the next frame.
enum Phase {
    /// The first camera waits until all wanted tiles are drawn. Holds the time and the values of the last change of the
    /// pager's counters.
    Settling { last_progress: Option<(Instant, [u64; 4])> },
    /// The camera follows the path. Holds the number of the next frame.
    Flying(u32),
    /// The user moves the camera.
    Free,
}

/// The state of a flight.
pub struct Flight {
    pub args: FlyArgs,
    pub path: Option<AnimationPath>,
    stop: Arc<AtomicBool>,
    phase: Phase,
    /// The stereo settings of the display; `None` draws one eye.
    pub eyes: Option<Stereo>,
    frames: u32,
    writer: Option<ImageWriter>,
    progress: Option<Progress>,
    /// Counts hole pixels; `None` without `--check-holes`, and until the set is added.
    holes: Option<HoleCounter>,
    settled: Option<Settled>,
    hidden: Hidden,
    last_image: Option<RgbaImage>,
    screenshot_done: bool,
    stopped: bool,
}

impl Flight {
    /// Creates a flight. Setting `stop` ends it before its last frame.
    pub fn new(args: FlyArgs, path: Option<AnimationPath>, stop: Arc<AtomicBool>) -> Result<Self> {
        let phase = match (args.settle, args.interactive) {
            (true, _) => Phase::Settling { last_progress: None },
            (false, true) => Phase::Free,
            (false, false) => Phase::Flying(0),
        };
        Ok(Self {
            frames: args.frames.unwrap_or(if args.settle { 0 } else { DEFAULT_FRAMES }),
            writer: if args.frames_dir.is_some() { Some(ImageWriter::new()?) } else { None },
            progress: None,
            args,
            path,
            stop,
            phase,
            eyes: None,
            holes: None,
            settled: None,
            hidden: Hidden::default(),
            last_image: None,
            screenshot_done: false,
            stopped: false,
        })
    }

    /// Adds the set to the viewer and sets the first camera.
    pub fn open(&mut self, viewer: &mut Viewer, root: LoadedRoot) -> Result<()> {
        let is_default = self.args.frames.is_none() && !self.args.settle && !self.args.interactive;
        if is_default && viewer.composite().is_software_adapter() {
            self.frames = DEFAULT_SOFTWARE_FRAMES;
            eprintln!(
                "software driver: flying {DEFAULT_SOFTWARE_FRAMES} frames instead of {DEFAULT_FRAMES} (--frames N)"
            );
        }
        viewer.set_root(root)?;
        viewer.view_mut().camera.settings.max_sse_px = match self.args.scene.sse {
            Some(limit) => limit.0,
            None if viewer.is_height_set() => HEIGHT_SSE_PX,
            None => MESH_SSE_PX,
        };
        viewer.view_mut().camera.settings.skip_sse_factor = self.args.scene.skip_sse.map_or(1.0, |factor| factor.0);
        viewer.view_mut().camera.settings.lod_fade_s = self.args.scene.lod_fade.0;
        if let Some(color) = self.args.background {
            viewer.view_mut().environment.sky = Sky::Background(color.0);
            viewer.view_mut().environment.fog.enabled = false;
        }
        let bounds = *viewer.bounds().context("the set has no bounds")?;
        if self.args.check_holes {
            viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
            viewer.view_mut().environment.fog.enabled = false;
            self.holes = HoleCheck::new(&bounds).map(HoleCounter::new);
        }
        let first = match (&self.args.view, &self.path) {
            (None, Some(path)) => path.world_from_eye(path.first_s()),
            (view, _) => bounds.first_camera(&view.map_or(ViewFrom::default(), |v| v.0)),
        };
        viewer.view_mut().camera.world_from_eye = first;
        if let Some(sun) = self.args.sun {
            viewer.view_mut().environment.sun_direction = bounds.frame.direction(sun.azimuth, sun.height);
        }
        viewer.view_mut().environment.shadows = self.args.shadows.then(SunShadows::default);
        viewer.view_mut().environment.water = self.args.water.filter(|h| h.is_finite()).map(Water::at);
        if let Some(stereo) = self.eyes {
            let fusion_distance_m = first.translation.distance(bounds.sphere.center);
            viewer.view_mut().set_stereo(Some(Stereo { fusion_distance_m, ..stereo }));
        }
        if self.path.is_none() {
            self.path = Some(bounds.default_path(&first));
        }
        Ok(())
    }

    /// Returns the time of the next frame on the path in seconds.
    pub fn time_s(&self) -> f64 {
        match (&self.phase, &self.path) {
            (Phase::Flying(next), Some(path)) => {
                // `before_frame` has already advanced `next` past the frame.
                let share = f64::from(next.saturating_sub(1)) / f64::from(self.frames.saturating_sub(1).max(1));
                path.first_s() + share * path.duration_s()
            }
            _ => 0.0,
        }
    }

    /// Sets the camera of the next frame and requests its image if needed. Returns false after the last frame.
    pub fn before_frame(&mut self, viewer: &mut Viewer) -> Result<bool> {
        if self.stop.load(Ordering::Relaxed) {
            self.stopped = true;
            return Ok(false);
        }
        let mut last = false;
        if let Phase::Settling { last_progress } = &mut self.phase {
            if viewer.is_settled() && viewer.frame_stamp().frame > 0 {
                match self.take_settled(viewer) {
                    Ok(()) => {
                        self.progress = None;
                        self.phase = if self.args.interactive { Phase::Free } else { Phase::Flying(0) };
                    }
                    // An interactive window may stay hidden; only a flight gives up.
                    Err(error) if is_hidden(&error) => {
                        if self.hidden.has_timed_out(Instant::now()) && !self.args.interactive {
                            self.hidden.ended = true;
                            return Ok(false);
                        }
                    }
                    Err(error) => return Err(error),
                }
            } else {
                check_progress(viewer, last_progress)?;
                let loaded = viewer.pager().map_or(0, |pager| pager.stats().loaded);
                let progress = || Progress::new("loading the first view", 0, "tiles loaded");
                self.progress.get_or_insert_with(progress).set_done(loaded);
            }
        }
        if let Phase::Flying(next) = self.phase {
            if next >= self.frames {
                return Ok(false);
            }
            self.phase = Phase::Flying(next + 1);
            let frames = u64::from(self.frames);
            self.progress.get_or_insert_with(|| Progress::new("flying", frames, "frames")).set_done(next.into());
            last = next + 1 == self.frames;
            let time_s = self.time_s();
            if let Some(path) = &self.path {
                viewer.view_mut().camera.world_from_eye = path.world_from_eye(time_s);
            }
        }
        if self.args.frames_dir.is_some() || self.holes.is_some() || (last && self.args.screenshot.is_some()) {
            viewer.want_picture();
            if let Some(holes) = &mut self.holes {
                holes.expect_image(viewer.frame_stamp().frame + 1, viewer.view().camera);
            }
        }
        Ok(true)
    }

    /// Loads until the next frame is due, offscreen while the first view settles. A frame is due when everything that was
    /// requested has arrived, and at the latest [`UNSEEN_PERIOD`] after `start`, when the last one began.
    pub fn load_unseen(&self, viewer: &mut Viewer, start: Instant) {
        let next = start + UNSEEN_PERIOD;
        let loads = |viewer: &Viewer| viewer.pager().is_some_and(|pager| !pager.is_idle());
        let settles = matches!(self.phase, Phase::Settling { .. }) && !self.args.blocking;
        while settles && loads(viewer) && Instant::now() < next {
            viewer.work_until(next.min(Instant::now() + UNSEEN_SLICE));
        }
    }

    /// Takes the images that were read back since the last call.
    pub fn after_frame(&mut self, viewer: &mut Viewer) -> Result<()> {
        for (frame, image) in viewer.take_pictures() {
            if let Some(holes) = &mut self.holes {
                holes.count(frame, &image);
            }
            if let (Some(folder), Some(writer)) = (&self.args.frames_dir, &mut self.writer) {
                writer.write(folder.join(format!("frame-{frame:05}.png")), image.clone())?;
            }
            self.last_image = Some(image);
        }
        Ok(())
    }

    /// Stores the settled image, its statistics and its contents.
    fn take_settled(&mut self, viewer: &mut Viewer) -> Result<()> {
        if let Some(file) = &self.args.screenshot {
            image_writer::write(file, &viewer.picture()?)?;
            self.screenshot_done = true;
        }
        self.settled = Some(viewer.settled()?);
        self.write_selection(viewer)
    }

    fn write_selection(&self, viewer: &mut Viewer) -> Result<()> {
        let Some(file) = &self.args.selection else { return Ok(()) };
        let uris = viewer.selected_contents();
        let root = shown(viewer.root_uri().unwrap_or_default()).into_owned();
        let path = root.split('?').next().unwrap_or(&root);
        let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let relative = |uri: &str| {
            let uri = shown(uri);
            uri.strip_prefix(folder).and_then(|rest| rest.strip_prefix('/')).unwrap_or(&uri).to_owned()
        };
        let relative: Vec<String> = uris.iter().map(|uri| relative(uri)).collect();
        let json = serde_json::json!({ "selectedContent": relative });
        write_text(file, &format!("{json}\n"))
    }

    /// Waits for requests and images in flight, writes the files of the options, and prints the summary.
    pub fn finish(mut self, viewer: &mut Viewer, where_drawn: &str) -> Result<()> {
        self.progress = None;
        viewer.finish()?;
        self.after_frame(viewer)?;
        // A screenshot may fail, for example of a hidden window. The report is written first and includes its errors.
        let screenshot = self.args.screenshot.as_ref().filter(|_| !self.screenshot_done);
        let screenshot = screenshot.map(|file| (file, self.last_image.take().map_or_else(|| viewer.picture(), Ok)));
        if self.settled.is_none() {
            self.write_selection(viewer)?;
        }
        let mut report: Report = viewer.report()?;
        report.version = env!("CARGO_PKG_VERSION").to_owned();
        report.settled = self.settled;
        report.holes = self.args.check_holes.then(|| self.holes.as_ref().map_or(0, HoleCounter::pixels));
        let images = self.writer.take().map(ImageWriter::finish).transpose()?.unwrap_or(0);
        if let Some(file) = &self.args.report {
            write_text(file, &report.to_json())?;
        }
        if let Some((file, image)) = screenshot {
            image_writer::write(file, &image?)?;
        }
        let notes = summary::Notes {
            where_drawn,
            stopped: self.stopped,
            written: self.written(images),
            is_interactive: self.args.interactive,
        };
        std::io::stdout().write_all(summary::lines(&report, &notes).as_bytes()).context("stdout")?;
        std::io::stderr().write_all(summary::error_lines(&report).as_bytes()).context("stderr")?;
        if self.hidden.ended {
            let seconds = HIDDEN_TIMEOUT.as_secs();
            bail!("no settled frame: the window has been hidden for {seconds} s; show it, or draw with --offscreen");
        }
        if report.tiles.failed > 0 && report.tiles.merged == 0 {
            bail!("nothing was drawn: no content could be loaded, {} requests failed", report.tiles.failed);
        }
        Ok(())
    }

    /// Returns the files that were written, each with the name of its kind.
    fn written(&self, frames: usize) -> Vec<String> {
        let args = &self.args;
        let files = [
            ("screenshot", &args.screenshot),
            ("selection", &args.selection),
            ("report", &args.report),
            ("trace", &args.trace),
        ];
        let files =
            files.into_iter().filter_map(|(kind, file)| Some(format!("{kind} in {}", file.as_ref()?.display())));
        let folder = args.frames_dir.as_ref().filter(|_| frames > 0);
        folder.map(|folder| format!("{frames} frames in {}", folder.display())).into_iter().chain(files).collect()
    }
}

/// Measures how long a window has been hidden while its settled frame is needed.
#[derive(Default)]
struct Hidden {
    since: Option<Instant>,
    /// True if the flight ended for this reason.
    ended: bool,
}

impl Hidden {
    /// Records that the window is hidden. Returns true once that has lasted [`HIDDEN_TIMEOUT`].
    fn has_timed_out(&mut self, now: Instant) -> bool {
        now - *self.since.get_or_insert(now) >= HIDDEN_TIMEOUT
    }
}

/// Returns true for the error of a hidden window.
fn is_hidden(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(ViewerError::HiddenWindow))
}

/// Fails if the pager's counters have not changed for [`STALL_TIMEOUT`].
fn check_progress(viewer: &Viewer, last: &mut Option<(Instant, [u64; 4])>) -> Result<()> {
    let now = viewer.pager().map_or([0; 4], |pager| {
        let s = pager.stats();
        [s.loaded, s.merged, s.failed, s.bytes_read]
    });
    match last {
        Some((since, then)) if *then == now => {
            if since.elapsed() > STALL_TIMEOUT {
                let missing = viewer.stats().last().map_or(0, |s| s.wanted_missing);
                let seconds = STALL_TIMEOUT.as_secs();
                let (waiting, in_flight) = viewer.pager().map_or((0, 0), |p| (p.stats().waiting, p.stats().in_flight));
                bail!(
                    "the view does not settle: {missing} tiles missing, {waiting} waiting, {in_flight} in flight, \
                     and no progress for {seconds} s"
                );
            }
        }
        _ => *last = Some((Instant::now(), now)),
    }
    Ok(())
}

/// Writes a text file and creates its folder.
fn write_text(file: &Path, text: &str) -> Result<()> {
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    std::fs::write(file, text).with_context(|| file.display().to_string())
}

#[cfg(test)]
mod tests {
    use anyhow::anyhow;

    use super::*;

    #[test]
    fn waiting_for_a_hidden_window_times_out() {
        let (mut hidden, now) = (Hidden::default(), Instant::now());
        assert!(!hidden.has_timed_out(now) && !hidden.has_timed_out(now + HIDDEN_TIMEOUT / 2));
        assert!(hidden.has_timed_out(now + HIDDEN_TIMEOUT));
        assert!(is_hidden(&ViewerError::HiddenWindow.into()));
        assert!(!is_hidden(&ViewerError::DrawThreadStopped.into()) && !is_hidden(&anyhow!("no window")));
    }
}
