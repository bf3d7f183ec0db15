//! `terrane fly` and `terrane view`: a flight over a tile set, offscreen or in a window, and its report.

mod defaults;
mod errors;
mod flight;
mod hole_counter;
mod image_writer;
mod interrupt;
mod summary;
mod views;

use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result, anyhow, bail};
use glam::{DAffine3, DMat4, DVec3};
use terrane::fetch::{HttpConfig, shown};
use terrane::formats::{OverlaySet, Style};
use terrane::pager::PagerConfig;
use terrane::trace::Recording;
use terrane::viewer::{
    AnimationPath, Arrangement, DisplaySettingError, DisplaySettings, LoadedRoot, ParentWindow, PathError, SlaveWindow,
    Viewer, ViewerConfig, ViewerError, WindowOptions, has_display, run_window,
};

use self::errors::into_viewer_error;
use self::flight::Flight;
use self::interrupt::Interrupt;
use crate::args::FlyArgs;
use crate::default_set;
use crate::net::Opened;

/// The source that means the ellipsoid. A folder of this name is `./globe`.
const GLOBE: &str = "globe";

/// Runs `terrane fly` or `terrane view`. `settings` come from the environment and the command line.
pub fn run(args: Box<FlyArgs>, settings: Result<DisplaySettings, DisplaySettingError>) -> Result<()> {
    let settings = settings?;
    let Some(file) = args.trace.clone() else { return fly(args, settings) };
    // A file that cannot be written is reported before the flight, not after it.
    std::fs::File::create(&file).with_context(|| file.display().to_string())?;
    let recording = Recording::start()?;
    // All threads have ended when `fly` returns, so the recording is complete.
    fly(args, settings).and(recording.write(&file).map(drop).map_err(Into::into))
}

fn fly(args: Box<FlyArgs>, settings: DisplaySettings) -> Result<()> {
    let display = has_display();
    if args.interactive && !display {
        bail!("there is no display to open a window on; `terrane fly` renders without one");
    }
    check_outputs(&args)?;
    let path = args.path.as_deref().map(|file| {
        AnimationPath::read(file).map_err(|error| match error {
            PathError::Io { .. } => anyhow!("{error}"),
            error => anyhow!("{}: {error}", file.display()),
        })
    });
    let path = path.transpose()?;
    let is_asked_offscreen = args.offscreen;
    let offscreen = is_asked_offscreen || !display;
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
    let mut config = viewer_config(&args, settings);
    let Opened { source, http, attributions, .. } = args.scene.net.open(&source)?;
    config.pager.http = http;
    config.pager.credits = attributions.into_iter().map(Arc::from).collect();
    config.pager.style = args.scene.style.as_deref().map(read_style).transpose()?;
    config.pager.overlays = overlays(&args, &mut config.pager.http)?;
    let interrupt = Interrupt::new();
    // The root is read before a window opens or an adapter is requested, so that an invalid source ends the program here.
    if let Some(views) = views {
        let root = if views.needs_root() { Some(read_root(&source, &config.pager)?) } else { None };
        return views::run(*args, config, views, root, interrupt);
    }
    let root = read_root(&source, &config.pager)?;
    interrupt.stop_in_order();
    let mut flight = Flight::new(*args, path, interrupt.stop)?;
    flight.eyes = config.stereo;
    let mut viewer = if offscreen {
        let mut viewer = Viewer::new_offscreen(&config)?;
        flight.open(&mut viewer, root)?;
        // The simulation time of frames is the time on the path, so the path can be announced.
        viewer.view_mut().announced = flight.path.clone();
        while flight.before_frame(&mut viewer)? {
            let start = Instant::now();
            viewer.frame_at(flight.time_s())?;
            flight.after_frame(&mut viewer)?;
            flight.load_unseen(&mut viewer, start);
        }
        viewer
    } else {
        let (viewer, back) = in_window(flight, config, root, &source, arrangement)?;
        flight = back;
        viewer
    };
    let where_drawn = match (is_asked_offscreen, offscreen) {
        (true, _) => "offscreen",
        (false, true) => "offscreen, as there is no display,",
        (false, false) => "in a window",
    };
    flight.finish(&mut viewer, where_drawn)
}

/// Fails for files that cannot be written: that is reported before the flight, not after it.
fn check_outputs(args: &FlyArgs) -> Result<()> {
    if let Some(file) = args.screenshot.as_deref().filter(|file| is_other_image(file)) {
        bail!("{}: the image is written as PNG or JPEG; give it a name that ends in .png or .jpg", file.display());
    }
    let files = [&args.report, &args.selection, &args.screenshot];
    match files.into_iter().flatten().find(|file| file.is_dir()) {
        Some(folder) => bail!("{}: is a folder", folder.display()),
        None => Ok(()),
    }
}

/// Returns the configuration that follows from the arguments and the display settings alone.
fn viewer_config(args: &FlyArgs, mut settings: DisplaySettings) -> ViewerConfig {
    settings.samples = settings.samples.max(args.samples);
    if let Some(mode) = args.stereo {
        (settings.stereo, settings.stereo_mode) = (true, mode);
    }
    let mut config = ViewerConfig {
        size_px: args.size.0,
        threading: args.scene.threading,
        validation: false,
        ..ViewerConfig::default()
    };
    settings.configure(&mut config);
    config.cpu_affinity = args.scene.cpu_affinity;
    config.vsync = !args.no_vsync;
    if !args.scene.no_pipeline_cache {
        config.pipeline_cache = default_set::cache_folder().map(|folder| folder.join("terrane").join("pipelines"));
    }
    config.look_ahead_s = args.look_ahead.unwrap_or(config.look_ahead_s);
    config.pager.blocking = args.blocking;
    // Manipulators need the k-d trees to stay above the ground.
    config.pager.build_kd_trees = args.interactive;
    config.pager.limits = args.scene.net.limits();
    config.pager.max_bytes_loading = args.scene.max_loading.map_or(config.pager.max_bytes_loading, |size| size.0);
    config.pager.ellipsoid = args.scene.body.map_or(config.pager.ellipsoid, |body| body.0);
    config
}

/// Returns true if a name promises an image of another format than PNG and JPEG.
fn is_other_image(file: &Path) -> bool {
    let extension = file.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    extension.is_some_and(|e| ["bmp", "webp", "tif", "tiff", "gif", "exr", "tga"].contains(&e.as_str()))
}

/// Reads the root of a source. The word `globe` means the bare ellipsoid.
fn read_root(source: &str, config: &PagerConfig) -> Result<LoadedRoot, ViewerError> {
    match source {
        GLOBE => LoadedRoot::ellipsoid(config),
        source => LoadedRoot::read(source, config),
    }
}

/// Returns the overlays of the command line; `None` without any.
fn overlays(args: &FlyArgs, http: &mut HttpConfig) -> Result<Option<Arc<OverlaySet>>> {
    if args.scene.overlays.is_empty() {
        return Ok(None);
    }
    let overlays = args.scene.overlays.iter().map(|overlay| args.scene.net.open_overlay(&overlay.0, http));
    let set = OverlaySet::new(overlays.collect::<Result<_>>()?)?;
    Ok(Some(Arc::new(match args.scene.sse {
        Some(limit) => set.with_max_sse_px(limit.0),
        None => set,
    })))
}

/// Reads a style from a file.
fn read_style(file: &Path) -> Result<Arc<Style>> {
    let bytes = std::fs::read(file).with_context(|| file.display().to_string())?;
    Ok(Arc::new(Style::from_json(&file.display().to_string(), &bytes)?))
}

/// Returns the windows to open: those of the command line, or those of the environment if the options leave the choice.
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

/// Returns additional windows of the same size: the first on the right of the main window, the second on its left, and
/// so on outwards.
fn beside(count: u32, size_px: [u32; 2]) -> Vec<SlaveWindow> {
    let window = |i: u32| {
        let offset = f64::from(i / 2 + 1) * if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        SlaveWindow {
            title: format!("Terrane {}", i + 2),
            size_px,
            position_px: None,
            shares_device: false,
            projection_offset: DMat4::from_translation(DVec3::new(-2.0 * offset, 0.0, 0.0)),
            view_offset: DAffine3::IDENTITY,
        }
    };
    (0..count).map(window).collect()
}

/// Runs the flight in a window, with one frame each time the window draws.
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
    // The callbacks of the event loop share the flight. They all run on this thread, one after the other.
    let flight = std::rc::Rc::new(std::cell::RefCell::new(flight));
    let (on_open, before, after) = (flight.clone(), flight.clone(), flight.clone());
    let options = WindowOptions {
        on_open: Box::new(move |viewer| on_open.borrow_mut().open(viewer, root).map_err(into_viewer_error)),
        before_frame: Box::new(move |viewer| before.borrow_mut().before_frame(viewer).map_err(into_viewer_error)),
        after_frame: Box::new(move |viewer| after.borrow_mut().after_frame(viewer).map_err(into_viewer_error)),
        ..options
    };
    let viewer = run_window(config, options)?.ok_or_else(|| anyhow!("the window closed before it opened"))?;
    let flight = std::rc::Rc::try_unwrap(flight).map_err(|_| anyhow!("the window still holds the flight"))?;
    Ok((viewer, flight.into_inner()))
}
