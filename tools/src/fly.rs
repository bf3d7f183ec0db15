//! `terrane fly` and `terrane view`: a flight over a tile set, offscreen or in a window, and its report.

use std::collections::VecDeque;
use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, bail};
use glam::{DAffine3, DMat4, DVec3};
use image::RgbaImage;
use terrane::cull::{Stereo, SunShadows};
use terrane::draw::{Sky, Water};
use terrane::fetch::shown;
use terrane::trace::Recording;
use terrane::viewer::{
    AnimationPath, Arrangement, Camera, DisplaySettingError, DisplaySettings, HoleCheck, KEY_COLOR, LoadedRoot,
    ParentWindow, PathError, Report, Settled, SlaveWindow, ViewFrom, Viewer, ViewerConfig, ViewerError, WindowOptions,
    has_display, run_window,
};
use terrane_data_gen::Progress;

use crate::args::FlyArgs;
use crate::pictures::{self, PictureWriter};
use crate::{default_set, summary};

/// Frames of a flight when none are asked for.
const DEFAULT_FRAMES: u32 = 300;
/// The same on a software driver, which takes some 30 ms a frame.
const DEFAULT_SOFTWARE_FRAMES: u32 = 100;
/// Limit in pixels for height tiles: their error is the height's alone, and at CesiumJS's 16 ridges visibly
/// change shape as they morph; at 3 the picture hardly changes any more and costs about four times the triangles.
pub const HEIGHT_SSE_PX: f64 = 3.0;
/// Limit in pixels for all other sets: CesiumJS's default.
pub const FOREIGN_SSE_PX: f64 = 16.0;
/// A window that is hidden for so long when its settled picture is to be taken is taken as never shown.
const HIDDEN_AFTER: Duration = Duration::from_secs(10);
/// Without any progress of the pager for so long, a picture is taken as never complete.
const STALLED_AFTER: Duration = Duration::from_secs(60);

/// `settings` are what environment and command line say of the display.
pub fn run(args: Box<FlyArgs>, settings: Result<DisplaySettings, DisplaySettingError>) -> Result<()> {
    let settings = settings?;
    let Some(file) = args.trace.clone() else { return fly(args, settings) };
    // Told before the flight, not after it.
    std::fs::File::create(&file).with_context(|| file.display().to_string())?;
    let recording = Recording::start()?;
    // All threads have ended by then.
    fly(args, settings).and(recording.write(&file).map(drop).map_err(Into::into))
}

fn fly(args: Box<FlyArgs>, mut settings: DisplaySettings) -> Result<()> {
    let display = has_display();
    if args.interactive && !display {
        bail!("there is no display to open a window on; `terrane fly` renders without one");
    }
    // Told before the flight, not after it.
    let files = [&args.report, &args.selection, &args.screenshot];
    if let Some(folder) = files.into_iter().flatten().find(|file| file.is_dir()) {
        bail!("{}: is a folder", folder.display());
    }
    let path = args.path.as_deref().map(|file| {
        AnimationPath::read(file).map_err(|error| match error {
            PathError::Io { .. } => anyhow!("{error}"),
            error => anyhow!("{}: {error}", file.display()),
        })
    });
    let path = path.transpose()?;
    let offscreen = args.offscreen || !display;
    let mut arrangement = arrangement(&args, offscreen)?;
    let views = match &mut arrangement {
        Arrangement::Views(views) => Some(std::mem::take(views)),
        _ => None,
    };
    let source = match &args.source {
        Some(source) => source.clone(),
        None if views.as_ref().is_some_and(|views| !views.needs_root()) => String::new(),
        None => default_set::ensure()?,
    };
    settings.samples = settings.samples.max(args.samples);
    if let Some(mode) = args.stereo {
        (settings.stereo, settings.stereo_mode) = (true, mode);
    }
    let mut config =
        ViewerConfig { size_px: args.size.0, threading: args.threading, validation: false, ..ViewerConfig::default() };
    settings.configure(&mut config);
    config.pager.blocking = args.blocking;
    config.vsync = !args.no_vsync;
    if !args.no_pipeline_cache {
        config.pipeline_cache = default_set::cache_folder().map(|folder| folder.join("terrane").join("pipelines"));
    }
    config.look_ahead_s = args.look_ahead.unwrap_or(config.look_ahead_s);
    // Manipulators stay above the ground.
    config.pager.build_kd_trees = args.interactive;
    config.pager.http = args.net.http(&source)?;
    let interrupt = Interrupt::new();
    // Before a window opens or an adapter is asked for: a root that cannot be read ends here.
    if let Some(views) = views {
        let root = if views.needs_root() { Some(LoadedRoot::read(&source, &config.pager)?) } else { None };
        return crate::views::run(*args, config, views, root, interrupt);
    }
    let root = LoadedRoot::read(&source, &config.pager)?;
    interrupt.asks_for_the_end();
    let mut flight = Flight::new(*args, path, interrupt.stop)?;
    flight.eyes = config.stereo;
    let mut viewer = if offscreen {
        let mut viewer = Viewer::new_offscreen(&config)?;
        flight.open(&mut viewer, root)?;
        // Frames have the path's time.
        viewer.view_mut().announced = flight.path.clone();
        while flight.before_frame(&mut viewer)? {
            viewer.frame_at(flight.time_s())?;
            flight.after_frame(&mut viewer)?;
        }
        viewer
    } else {
        let (viewer, back) = in_window(flight, config, root, &source, arrangement)?;
        flight = back;
        viewer
    };
    let where_drawn = match (offscreen, display) {
        (true, true) => "offscreen",
        (true, false) => "offscreen, as there is no display",
        (false, _) => "in a window",
    };
    flight.finish(&mut viewer, where_drawn)
}

/// The exit code of what Ctrl-C has ended, as shells have it.
const INTERRUPTED: i32 = 130;

/// What Ctrl-C does: it ends the process, and asks for the end once there is something to end well.
pub struct Interrupt {
    asks: Arc<AtomicBool>,
    /// Set once the end is asked for.
    pub stop: Arc<AtomicBool>,
}

impl Interrupt {
    fn new() -> Self {
        let (asks, stop) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let interrupt = Self { asks: asks.clone(), stop: stop.clone() };
        // A second handler in one process (tests) is no reason not to fly.
        let _ = ctrlc::set_handler(move || match asks.load(Ordering::Relaxed) {
            true => stop.store(true, Ordering::Relaxed),
            false => std::process::exit(INTERRUPTED),
        });
        interrupt
    }

    /// Only asks from now on.
    pub fn asks_for_the_end(&self) {
        self.asks.store(true, Ordering::Relaxed);
    }
}

/// The windows that were asked for: by the command line, else by the environment where windows open as that says.
fn arrangement(args: &FlyArgs, offscreen: bool) -> Result<Arrangement> {
    let arrangement = match &args.config {
        Some(_) if offscreen => bail!("there is no display to open the windows of --config on"),
        Some(file) => Arrangement::read(file)?,
        None if offscreen || args.parent.is_some() || args.beside > 0 => Arrangement::Usual,
        None => Arrangement::from_environment()?.unwrap_or_default(),
    };
    match arrangement {
        Arrangement::Views(_) if !args.interactive => bail!("a flight has one view; `terrane view` shows several"),
        arrangement => Ok(arrangement),
    }
}

/// Windows beside a first of the same size: the first on its right, the second on its left, and so on outwards.
fn beside(count: u32, size_px: [u32; 2]) -> Vec<SlaveWindow> {
    let window = |i: u32| {
        let place = f64::from(i / 2 + 1) * if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        SlaveWindow {
            title: format!("Terrane {}", i + 2),
            size_px,
            position_px: None,
            shares_device: false,
            projection_offset: DMat4::from_translation(DVec3::new(-2.0 * place, 0.0, 0.0)),
            view_offset: DAffine3::IDENTITY,
        }
    };
    (0..count).map(window).collect()
}

/// The same flight, a frame each time the window draws.
fn in_window(
    flight: Flight,
    config: ViewerConfig,
    root: LoadedRoot,
    source: &str,
    arrangement: Arrangement,
) -> Result<(Viewer, Flight)> {
    let interactive = flight.args.interactive;
    if interactive {
        writeln!(std::io::stdout(), "H shows the keys, Esc ends").context("stdout")?;
    }
    let options = WindowOptions {
        title: format!("Terrane - {}", shown(source)),
        path: flight.path.clone(),
        overlay: flight.args.stats,
        manipulated: interactive,
        on_demand: flight.args.on_demand,
        arrangement,
        parent: flight.args.parent.map(ParentWindow::x11),
        slaves: beside(flight.args.beside, flight.args.size.0),
        max_frame_rate: flight.args.max_fps.map(|rate| rate.0),
        ..WindowOptions::default()
    };
    // The event loop calls back from two places; both run on this thread, one after the other.
    let flight = std::rc::Rc::new(std::cell::RefCell::new(flight));
    let (on_open, before, after) = (flight.clone(), flight.clone(), flight.clone());
    let options = WindowOptions {
        on_open: Box::new(move |viewer| on_open.borrow_mut().open(viewer, root).map_err(application)),
        before_frame: Box::new(move |viewer| before.borrow_mut().before_frame(viewer).map_err(application)),
        after_frame: Box::new(move |viewer| after.borrow_mut().after_frame(viewer).map_err(application)),
        ..options
    };
    let viewer = run_window(config, options)?.ok_or_else(|| anyhow!("the window closed before it opened"))?;
    let flight = std::rc::Rc::try_unwrap(flight).map_err(|_| anyhow!("the window still holds the flight"))?;
    Ok((viewer, flight.into_inner()))
}

pub fn application(error: anyhow::Error) -> ViewerError {
    match error.downcast::<ViewerError>() {
        Ok(error) => error,
        Err(error) => ViewerError::Application(error.into()),
    }
}

/// What the next frame is for.
enum Phase {
    /// Holding the first camera until its picture is complete.
    Settling { last_progress: Option<(Instant, [u64; 4])> },
    /// Along the path; the number of the next frame.
    Flying(u32),
    /// Wherever the user goes.
    Free,
}

/// A flight under way, free of who calls the frames.
struct Flight {
    args: FlyArgs,
    path: Option<AnimationPath>,
    stop: Arc<AtomicBool>,
    phase: Phase,
    eyes: Option<Stereo>,
    frames: u32,
    writer: Option<PictureWriter>,
    progress: Option<Progress>,
    hole_check: Option<HoleCheck>,
    holes: u64,
    settled: Option<Settled>,
    hidden: Hidden,
    /// Cameras of the frames whose pictures are still to come.
    cameras: VecDeque<(u32, Camera)>,
    last_picture: Option<RgbaImage>,
    screenshot_done: bool,
    stopped: bool,
}

impl Flight {
    fn new(args: FlyArgs, path: Option<AnimationPath>, stop: Arc<AtomicBool>) -> Result<Self> {
        let phase = match (args.settle, args.interactive) {
            (true, _) => Phase::Settling { last_progress: None },
            (false, true) => Phase::Free,
            (false, false) => Phase::Flying(0),
        };
        Ok(Self {
            frames: args.frames.unwrap_or(if args.settle { 0 } else { DEFAULT_FRAMES }),
            writer: if args.frames_dir.is_some() { Some(PictureWriter::new()?) } else { None },
            progress: None,
            args,
            path,
            stop,
            phase,
            eyes: None,
            hole_check: None,
            holes: 0,
            settled: None,
            hidden: Hidden::default(),
            cameras: VecDeque::new(),
            last_picture: None,
            screenshot_done: false,
            stopped: false,
        })
    }

    /// Takes the set and places the first camera.
    fn open(&mut self, viewer: &mut Viewer, root: LoadedRoot) -> Result<()> {
        let is_default = self.args.frames.is_none() && !self.args.settle && !self.args.interactive;
        if is_default && viewer.composite().is_software_adapter() {
            self.frames = DEFAULT_SOFTWARE_FRAMES;
            eprintln!(
                "software driver: flying {DEFAULT_SOFTWARE_FRAMES} frames instead of {DEFAULT_FRAMES} (--frames N)"
            );
        }
        viewer.set_root(root)?;
        viewer.view_mut().camera.settings.max_sse_px = match self.args.sse {
            Some(limit) => limit.0,
            None if viewer.is_height_set() => HEIGHT_SSE_PX,
            None => FOREIGN_SSE_PX,
        };
        viewer.view_mut().camera.settings.skip_sse_factor = self.args.skip_sse.map_or(1.0, |factor| factor.0);
        viewer.view_mut().camera.settings.lod_fade_s = self.args.lod_fade.0;
        if let Some(color) = self.args.background {
            viewer.view_mut().environment.sky = Sky::Background(color.0);
            viewer.view_mut().environment.fog.enabled = false;
        }
        let bounds = *viewer.bounds().context("the set has no bounds")?;
        if self.args.check_holes {
            viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
            viewer.view_mut().environment.fog.enabled = false;
            self.hole_check = HoleCheck::new(&bounds);
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

    /// Seconds on the path of the frame that comes next.
    fn time_s(&self) -> f64 {
        match (&self.phase, &self.path) {
            (Phase::Flying(next), Some(path)) => {
                // `next` already points past the frame that `before_frame` has set up.
                let share = f64::from(next.saturating_sub(1)) / f64::from(self.frames.saturating_sub(1).max(1));
                path.first_s() + share * path.duration_s()
            }
            _ => 0.0,
        }
    }

    /// Sets the camera and what is read back; false when there is no further frame.
    fn before_frame(&mut self, viewer: &mut Viewer) -> Result<bool> {
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
                    // Somebody who moves in it may have it hidden as long as he likes.
                    Err(error) if is_hidden(&error) => {
                        if self.hidden.is_for_long(Instant::now()) && !self.args.interactive {
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
        if self.args.frames_dir.is_some() || self.hole_check.is_some() || (last && self.args.screenshot.is_some()) {
            viewer.want_picture();
            self.cameras.push_back((viewer.frame_stamp().frame + 1, viewer.view().camera));
        }
        Ok(true)
    }

    fn after_frame(&mut self, viewer: &mut Viewer) -> Result<()> {
        for (frame, picture) in viewer.take_pictures() {
            while let Some((of_frame, camera)) = self.cameras.pop_front() {
                if of_frame == frame {
                    if let Some(check) = &self.hole_check {
                        self.holes += check.count(&picture, &camera, KEY_COLOR);
                    }
                    break;
                }
            }
            if let (Some(folder), Some(writer)) = (&self.args.frames_dir, &mut self.writer) {
                writer.write(folder.join(format!("frame-{frame:05}.png")), picture.clone())?;
            }
            self.last_picture = Some(picture);
        }
        Ok(())
    }

    /// The settled picture, its numbers and its contents.
    fn take_settled(&mut self, viewer: &mut Viewer) -> Result<()> {
        if let Some(file) = &self.args.screenshot {
            pictures::write(file, &viewer.picture()?)?;
            self.screenshot_done = true;
        }
        self.settled = Some(viewer.settled()?);
        self.write_selection(viewer)
    }

    fn write_selection(&self, viewer: &mut Viewer) -> Result<()> {
        let Some(file) = &self.args.selection else { return Ok(()) };
        let uris = viewer.drawn_contents();
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

    /// Waits for what is under way and writes what was asked for.
    fn finish(mut self, viewer: &mut Viewer, where_drawn: &str) -> Result<()> {
        self.progress = None;
        viewer.finish()?;
        self.after_frame(viewer)?;
        // What it complains of is reported, and without one (the window may be hidden) there still is a report.
        let screenshot = self.args.screenshot.as_ref().filter(|_| !self.screenshot_done);
        let screenshot = screenshot.map(|file| (file, self.last_picture.take().map_or_else(|| viewer.picture(), Ok)));
        if self.settled.is_none() {
            self.write_selection(viewer)?;
        }
        let mut report: Report = viewer.report()?;
        report.version = env!("CARGO_PKG_VERSION").to_owned();
        report.settled = self.settled;
        report.holes = self.args.check_holes.then_some(self.holes);
        let pictures = self.writer.take().map(PictureWriter::finish).transpose()?.unwrap_or(0);
        if let Some(file) = &self.args.report {
            write_text(file, &report.to_json())?;
        }
        if let Some((file, picture)) = screenshot {
            pictures::write(file, &picture?)?;
        }
        let notes = summary::Notes {
            where_drawn,
            stopped: self.stopped,
            written: self.written(pictures),
            is_interactive: self.args.interactive,
        };
        std::io::stdout().write_all(summary::lines(&report, &notes).as_bytes()).context("stdout")?;
        std::io::stderr().write_all(summary::error_lines(&report).as_bytes()).context("stderr")?;
        if self.hidden.ended {
            let seconds = HIDDEN_AFTER.as_secs();
            bail!("no settled picture: the window has been hidden for {seconds} s; show it, or draw with --offscreen");
        }
        if report.tiles.failed > 0 && report.tiles.merged == 0 {
            bail!("nothing was drawn: no content could be loaded, {} requests failed", report.tiles.failed);
        }
        Ok(())
    }

    /// The files that the options asked for, each with the name of its kind.
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

/// A window that shows nothing while its settled picture is to be taken.
#[derive(Default)]
struct Hidden {
    since: Option<Instant>,
    /// The flight has ended for it.
    ended: bool,
}

impl Hidden {
    /// It is hidden now; true where it has been for [`HIDDEN_AFTER`].
    fn is_for_long(&mut self, now: Instant) -> bool {
        now - *self.since.get_or_insert(now) >= HIDDEN_AFTER
    }
}

/// True of the error that a window shows nothing.
fn is_hidden(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(ViewerError::HiddenWindow))
}

/// Fails when nothing has moved for too long.
fn check_progress(viewer: &Viewer, last: &mut Option<(Instant, [u64; 4])>) -> Result<()> {
    let now = viewer.pager().map_or([0; 4], |pager| {
        let s = pager.stats();
        [s.loaded, s.merged, s.failed, s.bytes_read]
    });
    match last {
        Some((since, then)) if *then == now => {
            if since.elapsed() > STALLED_AFTER {
                let missing = viewer.stats().last().map_or(0, |s| s.wanted_missing);
                let seconds = STALLED_AFTER.as_secs();
                let (waiting, in_flight) = viewer.pager().map_or((0, 0), |p| (p.stats().waiting, p.stats().in_flight));
                bail!(
                    "the picture does not settle: {missing} tiles missing, {waiting} waiting, {in_flight} in flight, \
                     and no progress for {seconds} s"
                );
            }
        }
        _ => *last = Some((Instant::now(), now)),
    }
    Ok(())
}

fn write_text(file: &Path, text: &str) -> Result<()> {
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    std::fs::write(file, text).with_context(|| file.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_that_is_hidden_is_waited_for_and_not_for_ever() {
        let (mut hidden, now) = (Hidden::default(), Instant::now());
        assert!(!hidden.is_for_long(now) && !hidden.is_for_long(now + HIDDEN_AFTER / 2));
        assert!(hidden.is_for_long(now + HIDDEN_AFTER));
        assert!(is_hidden(&ViewerError::HiddenWindow.into()));
        assert!(!is_hidden(&ViewerError::DrawThreadStopped.into()) && !is_hidden(&anyhow!("no window")));
    }
}
