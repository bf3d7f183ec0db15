//! The arguments of every subcommand.

use std::path::PathBuf;

use clap::{Args as ClapArgs, Parser, Subcommand};
use terrane::cull::StereoMode;
use terrane::fetch::is_remote;
use terrane::viewer::ThreadingModel;

use crate::net::NetArgs;
use crate::values::{NotNegative, Positive, Rgb, Size, SunFrom, View, finite, not_negative, pace, samples, secs};

/// Streams terrain that is larger than memory, and draws it without a hitch.
#[derive(Debug, Parser)]
#[command(name = "terrane", version, about, max_term_width = 110)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

impl Args {
    /// What no single argument says is wrong; exit code 2, as of the others.
    pub fn check(&self) -> Result<(), String> {
        match &self.command {
            Command::Fly(args) if args.frames == Some(0) && !args.settle => {
                Err("--frames 0 draws nothing; --settle draws the picture of the first camera".to_owned())
            }
            Command::Bench(BenchArgs { bench: Bench::Page { url: Some(url), .. } }) if !is_remote(url) => {
                Err(format!("--url {url}: neither an http(s) URL nor an s3://, gs:// or az:// URI"))
            }
            Command::Serve(args) => args.check(),
            Command::Stress(args) => args.check(),
            _ => Ok(()),
        }
    }
}

/// What [`terrane::viewer::DisplaySettings`] takes out of the command line before the rest is read.
const DISPLAY_HELP: &str = "Of the display, each with its value, or as TERRANE_DISPLAY_TYPE and so on in the environment: \
    --display-type --stereo --stereo-mode --eye-separation --screen-width --screen-height --screen-distance \
    --split-horizontal-eye-mapping --split-horizontal-separation --split-vertical-eye-mapping \
    --split-vertical-separation --split-auto-adjust-aspect-ratio --max-contexts --multi-samples --min-alpha-bits \
    --min-stencil-bits --compile-contexts";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly along a path over a tile set and report what the frames cost
    #[command(after_help = DISPLAY_HELP)]
    Fly(Box<FlyArgs>),
    /// Open a window on a tile set and move in it
    #[command(after_help = DISPLAY_HELP)]
    View(ViewArgs),
    /// Make a tile set from noise or from elevation models
    Gen(Box<terrane_data_gen::GenArgs>),
    /// Say what is in a tile set
    Info(InfoArgs),
    /// Serve a folder over HTTP, as well or as badly as asked
    Serve(crate::serve::ServeArgs),
    /// Fly at random over a set that comes badly, and check what must hold in each frame
    Stress(crate::stress::StressArgs),
    /// Look after the cache on disk
    Cache(crate::cache::CacheArgs),
    /// Measure one layer; JSON lines on stdout
    Bench(BenchArgs),
}

#[derive(Clone, Debug, Default, ClapArgs)]
pub struct FlyArgs {
    /// Folder, tileset.json, archive (.3tz, .zip), http(s) URL or s3://, gs://, az:// URI; without it a small set is made in the user's cache folder
    pub source: Option<String>,
    /// Camera path in OpenSceneGraph's text form, `t px py pz qx qy qz qw` a line [default: approach, fly low, orbit]
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Frames to fly, the path spread over them [default: 300, 100 on a software driver; none after --settle]
    #[arg(long, value_name = "N")]
    pub frames: Option<u32>,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub size: Size,
    /// Draw into memory even where there is a display
    #[arg(long)]
    pub offscreen: bool,
    /// Hold the first camera until everything wanted is drawn, then take the picture
    #[arg(long)]
    pub settle: bool,
    /// First camera: heading and pitch in degrees and distance in metres to the centre of the set
    /// [default: 0,-35,2.2 radii]
    #[arg(long, value_name = "HEADING_DEG,PITCH_DEG,RANGE_M", allow_hyphen_values = true)]
    pub view: Option<View>,
    /// Refine tiles whose error shows as more pixels [default: 3 for height tiles, else 16 as CesiumJS]
    #[arg(long, value_name = "PX")]
    pub sse: Option<Positive>,
    /// On the way to finer tiles load only those that are so many times finer than what is there: at 16 of four levels
    /// of a quadtree one [default: 1, every level]
    #[arg(long, value_name = "FACTOR")]
    pub skip_sse: Option<Positive>,
    /// Seconds in which levels of detail fade into one another; 0 changes them at once
    #[arg(long, value_name = "SECONDS", default_value = "0.25")]
    pub lod_fade: NotNegative,
    /// Which threads cull and draw: SingleThreaded, CullDrawThreadPerContext, DrawThreadPerContext,
    /// CullThreadPerCameraDrawThreadPerContext, or AutomaticSelection: what TERRANE_THREADING names, else the best
    #[arg(long, value_name = "MODEL", default_value = "AutomaticSelection")]
    pub threading: ThreadingModel,
    /// Load what the camera will lack in so many seconds, after all that it lacks now; 0: nothing [default: 1]
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    pub look_ahead: Option<f64>,
    /// Do not wait for the screen's refresh (window only); frames may tear
    #[arg(long, conflicts_with = "offscreen")]
    pub no_vsync: bool,
    /// Load everything a frame wants before drawing it, so that equal paths give equal pictures
    #[arg(long)]
    pub blocking: bool,
    /// Count background pixels where terrain must be; draws on magenta
    #[arg(long)]
    pub check_holes: bool,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write what every thread did when, for ui.perfetto.dev or chrome://tracing
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Write every frame as PNG
    #[arg(long, value_name = "DIR")]
    pub frames_dir: Option<PathBuf>,
    /// Write the last frame (with --settle the settled one) as PNG
    #[arg(long, value_name = "FILE")]
    pub screenshot: Option<PathBuf>,
    /// Write the URIs of the contents drawn in that picture as JSON
    #[arg(long, value_name = "FILE")]
    pub selection: Option<PathBuf>,
    /// Plain background instead of sky and haze
    #[arg(long, value_name = "RRGGBB", conflicts_with = "check_holes")]
    pub background: Option<Rgb>,
    /// A sea at this height above the ellipsoid, metres
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = finite)]
    pub water: Option<f32>,
    /// Shadows of the sun
    #[arg(long)]
    pub shadows: bool,
    /// Where the sun stands: degrees clockwise from north, and above the horizon
    #[arg(long, value_name = "AZIMUTH,HEIGHT", allow_hyphen_values = true)]
    pub sun: Option<SunFrom>,
    /// Draw for two eyes: ANAGLYPHIC, HORIZONTAL_SPLIT, VERTICAL_SPLIT, LEFT_EYE, RIGHT_EYE, HORIZONTAL_INTERLACE,
    /// VERTICAL_INTERLACE or CHECKERBOARD; things as far as the middle of the set seem to lie in the screen
    #[arg(long, value_name = "MODE")]
    pub stereo: Option<StereoMode>,
    /// Samples a pixel, 1 or 4: smooth edges
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = samples)]
    pub samples: u32,
    /// Show the stats overlay from the start (window only)
    #[arg(long, conflicts_with = "offscreen")]
    pub stats: bool,
    /// Neither use nor keep what the driver compiles (terrane/pipelines in the user's cache folder)
    #[arg(long)]
    pub no_pipeline_cache: bool,
    #[command(flatten)]
    pub net: NetArgs,
    /// A window to move in, without a path.
    #[arg(skip)]
    pub interactive: bool,
    /// Draw only when something changes.
    #[arg(skip)]
    pub on_demand: bool,
    /// Maximum frames per second (window only)
    #[arg(long, value_name = "FPS", conflicts_with = "offscreen")]
    pub max_fps: Option<Positive>,
    /// Windows beside the first, alternately on its right and left, each with its part of one wide picture
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "offscreen",
        value_parser = clap::value_parser!(u32).range(0..=8))]
    pub beside: u32,
    /// Open the windows that a JSON file names, whatever TERRANE_CONFIG_FILE, TERRANE_WINDOW and TERRANE_SCREEN say
    #[arg(long, value_name = "FILE", conflicts_with_all = ["beside", "offscreen"])]
    pub config: Option<PathBuf>,
    /// The X11 window to open in.
    #[arg(skip)]
    pub parent: Option<u32>,
}

#[derive(Clone, Debug, ClapArgs)]
pub struct ViewArgs {
    /// Folder, tileset.json, archive (.3tz, .zip), http(s) URL or s3://, gs://, az:// URI
    #[arg(required_unless_present = "config")]
    pub source: Option<String>,
    /// Size of the window in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub size: Size,
    /// First camera: heading and pitch in degrees and distance in metres to the centre of the set
    #[arg(long, value_name = "HEADING_DEG,PITCH_DEG,RANGE_M", allow_hyphen_values = true)]
    pub view: Option<View>,
    /// Camera path that key 7 plays
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Refine tiles whose error shows as more pixels [default: 3 for height tiles, else 16 as CesiumJS]
    #[arg(long, value_name = "PX")]
    pub sse: Option<Positive>,
    /// On the way to finer tiles load only those that are so many times finer than what is there: at 16 of four levels
    /// of a quadtree one [default: 1, every level]
    #[arg(long, value_name = "FACTOR")]
    pub skip_sse: Option<Positive>,
    /// Seconds in which levels of detail fade into one another; 0 changes them at once
    #[arg(long, value_name = "SECONDS", default_value = "0.25")]
    pub lod_fade: NotNegative,
    /// Which threads cull and draw: SingleThreaded, CullDrawThreadPerContext, DrawThreadPerContext,
    /// CullThreadPerCameraDrawThreadPerContext, or AutomaticSelection: what TERRANE_THREADING names, else the best
    #[arg(long, value_name = "MODEL", default_value = "AutomaticSelection")]
    pub threading: ThreadingModel,
    /// Show the stats overlay from the start
    #[arg(long)]
    pub stats: bool,
    /// Draw only when something changes
    #[arg(long)]
    pub on_demand: bool,
    /// Frames a second at most
    #[arg(long, value_name = "FPS")]
    pub max_fps: Option<Positive>,
    /// Windows beside the first, alternately on its right and left, each with its part of one wide picture
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=8))]
    pub beside: u32,
    /// Open the windows, or the several views, that a JSON file names, whatever TERRANE_CONFIG_FILE, TERRANE_WINDOW and
    /// TERRANE_SCREEN say
    #[arg(long, value_name = "FILE", conflicts_with_all = ["beside", "parent"])]
    pub config: Option<PathBuf>,
    /// Neither use nor keep what the driver compiles (terrane/pipelines in the user's cache folder)
    #[arg(long)]
    pub no_pipeline_cache: bool,
    /// Open in the X11 window of this number, as other toolkits have it (decimal)
    #[arg(long, value_name = "WINDOW")]
    pub parent: Option<u32>,
    #[command(flatten)]
    pub net: NetArgs,
}

impl From<ViewArgs> for Box<FlyArgs> {
    fn from(args: ViewArgs) -> Self {
        let ViewArgs {
            source,
            size,
            view,
            path,
            sse,
            skip_sse,
            lod_fade,
            threading,
            stats,
            on_demand,
            max_fps,
            beside,
            config,
            no_pipeline_cache,
            parent,
            net,
        } = args;
        Box::new(FlyArgs {
            source,
            size,
            view,
            path,
            sse,
            skip_sse,
            lod_fade,
            threading,
            stats,
            on_demand,
            max_fps,
            beside,
            config,
            no_pipeline_cache,
            parent,
            net,
            interactive: true,
            ..FlyArgs::default()
        })
    }
}

#[derive(Clone, Debug, ClapArgs)]
pub struct InfoArgs {
    /// Folder, tileset.json, archive (.3tz, .zip), http(s) URL or s3://, gs://, az:// URI
    pub source: String,
    /// One JSON document instead of text
    #[arg(long)]
    pub json: bool,
    /// Read and decode every content too; exit code 1 where one fails
    #[arg(long)]
    pub verify: bool,
    #[command(flatten)]
    pub net: NetArgs,
}

#[derive(Clone, Debug, ClapArgs)]
pub struct BenchArgs {
    #[command(subcommand)]
    pub bench: Bench,
}

#[derive(Clone, Debug, Subcommand)]
pub enum Bench {
    /// Every bench below, one after the other; takes about ten minutes
    All {
        /// Print a Markdown document with machine, date and commit instead of JSON lines
        #[arg(long)]
        markdown: bool,
        /// Shortest time to measure each case, seconds [default: that of each bench]
        #[arg(long, value_parser = secs)]
        secs: Option<f64>,
    },
    /// Scene to render stages, without a GPU
    Cull {
        /// Shortest time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
        /// Drawables of the scenes
        #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [1_000, 10_000, 100_000],
            value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        drawables: Vec<u32>,
    },
    /// The walk of a tile tree, without a GPU
    Tiles {
        /// Shortest time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Lines through a terrain of a million triangles, without a GPU
    Pick {
        /// Shortest time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Render stages to the adapter that does nothing: the processor's time per leaf
    Submit {
        /// Shortest time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Whole frames of 64 x 64 pixels with the software driver
    Frame {
        /// Shortest time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
        /// Hand the adapter what lies between pixels too
        #[arg(long)]
        every_leaf: bool,
    },
    /// What each threading model makes of update, cull and draw
    Threading {
        /// Shortest time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// What equal contents share, and what looking for them costs
    Share {
        /// Shortest time to decode each set, seconds
        #[arg(long, default_value_t = 10.0, value_parser = secs)]
        secs: f64,
    },
    /// A pager with many pages while nothing changes
    Resident {
        /// Pages that are merged
        #[arg(long, default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        tiles: u32,
        /// Shortest time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Files to merged pages
    Page {
        /// Frames of the flight
        #[arg(long, default_value_t = 1200, value_parser = clap::value_parser!(u32).range(2..))]
        frames: u32,
        /// Frames a second; 0 for as many as go
        #[arg(long, default_value_t = 60.0, value_parser = pace)]
        pace: f64,
        /// Draw each frame too
        #[arg(long)]
        draw: bool,
        /// Most tiles that are kept; of 540 a tenth is left free, which keeps as many as the peer (121 files of four)
        #[arg(long, default_value_t = 540, value_parser = clap::value_parser!(u32).range(1..))]
        tiles: u32,
        /// What the tiles hold
        #[arg(long, value_enum, default_value_t = PageContent::Mesh)]
        content: PageContent,
        /// So many terrains along each side, all from the same files
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
        world: u32,
        /// Fly straight on at so many metres a second, instead of along the peer's path
        #[arg(long, value_name = "M_PER_S")]
        speed: Option<Positive>,
        /// Load what the announced path will want in so many seconds; the peers cannot
        #[arg(long, value_name = "SECONDS", default_value = "0", value_parser = not_negative)]
        look_ahead: f64,
        /// Load only tiles that are so many times finer than what is there, on the way to those that are wanted
        #[arg(long, value_name = "FACTOR", default_value = "1")]
        skip_sse: Positive,
        /// Nothing is announced: look ahead where the eye's motion goes on to
        #[arg(long)]
        by_motion: bool,
        /// Where the tiles' folder is served, instead of reading files; the folder is named on stderr
        #[arg(long, value_name = "URL")]
        url: Option<String>,
        #[command(flatten)]
        net: NetArgs,
    },
}

/// What the tiles of `bench page` hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PageContent {
    /// Binary glTF with positions, normals, texture coordinates and an image, as the peer's tiles
    Mesh,
    /// The same in 16 bytes a vertex, as KHR_mesh_quantization and `terrane gen` have them
    Quantized,
    /// EXR heights on a shared grid and an image
    Height,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_arguments_are_consistent() {
        Args::command().debug_assert();
    }
}
