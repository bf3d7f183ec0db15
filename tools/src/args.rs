//! The arguments of every subcommand of `terrane`, as clap parses them.

use std::path::PathBuf;

use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use terrane::cull::StereoMode;
use terrane::fetch::is_remote;
use terrane::viewer::ThreadingModel;

use crate::net::{ByteSize, NetArgs};
use crate::overlays::{OVERLAY_HELP, OverlayArg};
use crate::values::{
    BodyArg, NotNegative, Positive, Rgb, Size, SunFrom, View, finite, not_negative, pace, samples, secs,
};

/// Streams terrain that is larger than memory, and draws it without a hitch.
#[derive(Debug, Parser)]
#[command(name = "terrane", version, about, max_term_width = 110)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

impl Args {
    /// Checks combinations of arguments. The error ends the program with exit code 2, as other invalid arguments do.
    pub fn check(&self) -> Result<(), String> {
        if let Some((net, source)) = self.command.net() {
            net.check(source)?;
        }
        match &self.command {
            Command::Fly(args) if args.frames == Some(0) && !args.settle => {
                Err("--frames 0 draws nothing; --settle draws the image of the first camera".to_owned())
            }
            Command::Bench(BenchArgs { bench: Bench::Page { url: Some(url), .. } }) if !is_remote(url) => {
                Err(format!("--url {url}: neither an http(s) URL nor an s3://, gs:// or az:// URI"))
            }
            Command::Info(args) if args.map_of == MapOf::Problems && !args.verify => {
                Err("--map-of problems needs --verify".to_owned())
            }
            Command::Serve(args) => args.check(),
            Command::Stress(args) => args.check(),
            _ => Ok(()),
        }
    }
}

impl Command {
    /// Returns the arguments for servers with the source that they are for, which is empty if none is given.
    fn net(&self) -> Option<(&NetArgs, &str)> {
        Some(match self {
            Self::Fly(args) => (&args.scene.net, args.source.as_deref().unwrap_or_default()),
            Self::View(args) => (&args.scene.net, args.source.as_deref().unwrap_or_default()),
            Self::Info(args) => (&args.net, &args.source),
            Self::Convert(args) => args.net(),
            Self::Crop(args) => args.net(),
            Self::Cache(args) => return args.net(),
            Self::Bench(BenchArgs { bench: Bench::Page { url: Some(url), net, .. } }) => (net, url),
            _ => return None,
        })
    }
}

/// Lists the options that [`terrane::viewer::DisplaySettings`] removes from the command line before clap reads it.
const DISPLAY_HELP: &str = "Options of the display, each with a value; also as environment variables such as TERRANE_DISPLAY_TYPE: \
    --display-type --stereo --stereo-mode --eye-separation --screen-width --screen-height --screen-distance \
    --split-horizontal-eye-mapping --split-horizontal-separation --split-vertical-eye-mapping \
    --split-vertical-separation --split-auto-adjust-aspect-ratio --max-contexts --multi-samples --min-alpha-bits \
    --min-stencil-bits --compile-contexts";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly along a path over a tile set and report the times of frames
    #[command(after_help = DISPLAY_HELP)]
    Fly(Box<FlyArgs>),
    /// Open a window on a tile set and navigate in it
    #[command(after_help = DISPLAY_HELP)]
    View(Box<ViewArgs>),
    /// Generate a tile set from noise or from elevation files
    Gen(Box<terrane_data_gen::GenArgs>),
    /// Convert a set or model of any format that is read to 3D Tiles 1.1
    Convert(crate::convert::ConvertArgs),
    /// Join several 3D Tiles sets under one root
    Merge(crate::convert::MergeArgs),
    /// Keep the part of a set over a region, as 3D Tiles 1.1
    Crop(crate::convert::CropArgs),
    /// Describe the content of a tile set
    Info(InfoArgs),
    /// Serve a folder over HTTP, with a chosen latency, bandwidth and rate of faults
    Serve(crate::serve::ServeArgs),
    /// Fly random flights over a set from a faulty server and check invariants in each frame
    Stress(crate::stress::StressArgs),
    /// Inspect, clear, verify or fill the cache on disk
    Cache(crate::cache::CacheArgs),
    /// Measure one layer; prints JSON lines
    Bench(BenchArgs),
}

// Options of `fly` and `view`: what is loaded, and how it is refined and drawn. A doc comment would become help text.
#[derive(Clone, Debug, Default, ClapArgs)]
pub struct SceneArgs {
    /// Refine tiles whose error projects to more pixels [default: 3 for height tiles, otherwise 16 as in CesiumJS]
    #[arg(long, value_name = "PX", allow_hyphen_values = true)]
    pub sse: Option<Positive>,
    /// While refining, load only tiles whose error is smaller by this factor than that of the visible tile: with 16, one
    /// in four levels of a quadtree [default: 1, every level]
    #[arg(long, value_name = "FACTOR")]
    pub skip_sse: Option<Positive>,
    /// Maximum memory of tiles that are on their way, such as 500MB: read and not decoded, or decoded and not drawn
    /// [default: 384MiB]
    #[arg(long, value_name = "SIZE")]
    pub max_loading: Option<ByteSize>,
    /// Duration of the fade between levels of detail in seconds; 0 switches without a fade
    #[arg(long, value_name = "SECONDS", default_value = "0.25")]
    pub lod_fade: NotNegative,
    /// Threading model: SingleThreaded, CullDrawThreadPerContext, DrawThreadPerContext,
    /// CullThreadPerCameraDrawThreadPerContext, or AutomaticSelection (that of TERRANE_THREADING, or the best)
    #[arg(long, value_name = "MODEL", default_value = "AutomaticSelection")]
    pub threading: ThreadingModel,
    /// Pin each thread of the threading model to a core
    #[arg(long)]
    pub cpu_affinity: bool,
    /// Colour, hide and size the features of tiles by a style in the 3D Tiles Styling language (JSON)
    #[arg(long, value_name = "FILE")]
    pub style: Option<PathBuf>,
    /// Drape images over the terrain
    #[arg(long = "overlay", value_name = "ADDRESS[,KEY=VALUE...]", help = OVERLAY_HELP)]
    pub overlays: Vec<OverlayArg>,
    /// The body of a set that names none, and of globe: earth, moon, mars, or radii in metres as EQUATORxPOLE or XxYxZ
    /// [default: earth]
    #[arg(long, value_name = "NAME|RADII")]
    pub body: Option<BodyArg>,
    /// Do not use the cache of compiled pipelines (terrane/pipelines in the user's cache folder)
    #[arg(long)]
    pub no_pipeline_cache: bool,
    #[command(flatten)]
    pub net: NetArgs,
}

// More than 16 fields: one for each option.
#[derive(Clone, Debug, Default, ClapArgs)]
pub struct FlyArgs {
    /// Folder, tileset.json, layer.json, archive (.3tz, .zip, .terrane), http(s) URL, s3://, gs:// or az:// URI, ion:ASSET_ID,
    /// google or globe; without it a small set is generated in the user's cache folder
    pub source: Option<String>,
    /// Camera path in OpenSceneGraph's text format, a line `t px py pz qx qy qz qw` per point [default: approach, fly low,
    /// orbit]
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Number of frames for the whole path [default: 300, 100 on a software driver, 0 with --settle]
    #[arg(long, value_name = "N")]
    pub frames: Option<u32>,
    /// Size of the image in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub size: Size,
    /// Draw to memory even if there is a display
    #[arg(long)]
    pub offscreen: bool,
    /// Keep the first camera until all wanted tiles are drawn, then take the image
    #[arg(long)]
    pub settle: bool,
    /// First camera: heading and pitch in degrees, and distance in metres to the centre of the set
    /// [default: 0,-35,2.2 radii]
    #[arg(long, value_name = "HEADING_DEG,PITCH_DEG,RANGE_M", allow_hyphen_values = true)]
    pub view: Option<View>,
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Prefetch tiles that the camera will need within this many seconds, after those it needs now; 0 turns prefetch off
    /// [default: 1]
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    pub look_ahead: Option<f64>,
    /// Do not wait for the screen's refresh (window only); frames may tear
    #[arg(long, conflicts_with = "offscreen")]
    pub no_vsync: bool,
    /// Load all tiles that a frame wants before drawing it, so that equal paths give equal images
    #[arg(long)]
    pub blocking: bool,
    /// Count background pixels where terrain must be, from the first frame with terrain on; draws on magenta
    #[arg(long)]
    pub check_holes: bool,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write a trace of all threads, for ui.perfetto.dev or chrome://tracing
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Write every frame as PNG
    #[arg(long, value_name = "DIR")]
    pub frames_dir: Option<PathBuf>,
    /// Write the last frame (with --settle, the settled one) as PNG, or as JPEG to a name that ends in .jpg
    #[arg(long, value_name = "FILE")]
    pub screenshot: Option<PathBuf>,
    /// Write the URIs of the contents of all tiles that are selected in that frame as JSON
    #[arg(long, value_name = "FILE")]
    pub selection: Option<PathBuf>,
    /// Plain background instead of sky and haze
    #[arg(long, value_name = "RRGGBB", conflicts_with = "check_holes")]
    pub background: Option<Rgb>,
    /// Height of a sea above the ellipsoid in metres [default: no sea]
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = finite)]
    pub water: Option<f32>,
    /// Draw shadows of the sun
    #[arg(long)]
    pub shadows: bool,
    /// Position of the sun: degrees clockwise from north, and degrees above the horizon
    #[arg(long, value_name = "AZIMUTH,HEIGHT", allow_hyphen_values = true)]
    pub sun: Option<SunFrom>,
    /// Draw in stereo: ANAGLYPHIC, HORIZONTAL_SPLIT, VERTICAL_SPLIT, LEFT_EYE, RIGHT_EYE, HORIZONTAL_INTERLACE,
    /// VERTICAL_INTERLACE or CHECKERBOARD; objects as far as the middle of the set appear at the depth of the screen
    #[arg(long, value_name = "MODE")]
    pub stereo: Option<StereoMode>,
    /// Samples per pixel: 1, 2, 4, 8 or 16, as far as the adapter has them; 4 draws smooth edges
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = samples)]
    pub samples: u32,
    /// Show the stats overlay from the start (window only)
    #[arg(long, conflicts_with = "offscreen")]
    pub stats: bool,
    /// True for `terrane view`: the user moves the camera.
    #[arg(skip)]
    pub interactive: bool,
    /// True to draw only when something changes.
    #[arg(skip)]
    pub on_demand: bool,
    /// Maximum frames per second (window only)
    #[arg(long, value_name = "FPS", conflicts_with = "offscreen")]
    pub max_fps: Option<Positive>,
    /// Number of additional windows, alternately right and left of the first, that show parts of one wide image
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "offscreen",
        value_parser = clap::value_parser!(u32).range(0..=8))]
    pub beside: u32,
    /// Open the windows of a JSON file instead of those of TERRANE_CONFIG_FILE, TERRANE_WINDOW and TERRANE_SCREEN
    #[arg(long, value_name = "FILE", conflicts_with_all = ["beside", "offscreen"])]
    pub config: Option<PathBuf>,
    /// The X11 window to open a child window in.
    #[arg(skip)]
    pub parent: Option<u32>,
}

#[derive(Clone, Debug, ClapArgs)]
pub struct ViewArgs {
    /// Folder, tileset.json, layer.json, archive (.3tz, .zip, .terrane), http(s) URL, s3://, gs:// or az:// URI, ion:ASSET_ID,
    /// google or globe
    #[arg(required_unless_present = "config")]
    pub source: Option<String>,
    /// Size of the window in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub size: Size,
    /// First camera: heading and pitch in degrees, and distance in metres to the centre of the set
    #[arg(long, value_name = "HEADING_DEG,PITCH_DEG,RANGE_M", allow_hyphen_values = true)]
    pub view: Option<View>,
    /// Camera path that key 7 plays
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Show the stats overlay from the start
    #[arg(long)]
    pub stats: bool,
    /// Draw only when something changes
    #[arg(long)]
    pub on_demand: bool,
    /// Maximum frames per second
    #[arg(long, value_name = "FPS")]
    pub max_fps: Option<Positive>,
    /// Number of additional windows, alternately right and left of the first, that show parts of one wide image
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=8))]
    pub beside: u32,
    /// Open the windows or views of a JSON file instead of those of TERRANE_CONFIG_FILE, TERRANE_WINDOW and
    /// TERRANE_SCREEN
    #[arg(long, value_name = "FILE", conflicts_with_all = ["beside", "parent"])]
    pub config: Option<PathBuf>,
    /// Open inside the X11 window with this number (decimal), for example a window of another toolkit
    #[arg(long, value_name = "WINDOW")]
    pub parent: Option<u32>,
}

impl From<ViewArgs> for Box<FlyArgs> {
    fn from(args: ViewArgs) -> Self {
        let ViewArgs { source, size, view, path, scene, stats, on_demand, max_fps, beside, config, parent } = args;
        Box::new(FlyArgs {
            source,
            size,
            view,
            path,
            scene,
            stats,
            on_demand,
            max_fps,
            beside,
            config,
            parent,
            interactive: true,
            ..FlyArgs::default()
        })
    }
}

/// The values that the colours of a map stand for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum MapOf {
    /// The finest level at each point
    #[default]
    Levels,
    /// The error of the finest tile that has one: with --verify the measured one where it is known
    Error,
    /// The bytes of the finest tile
    Bytes,
    /// The tiles with problems, in red
    Problems,
}

#[derive(Clone, Debug, ClapArgs)]
pub struct InfoArgs {
    /// Folder, tileset.json, layer.json, archive (.3tz, .zip, .terrane), http(s) URL, s3://, gs:// or az:// URI, ion:ASSET_ID,
    /// google
    pub source: String,
    /// Print one JSON document instead of text
    #[arg(long)]
    pub json: bool,
    /// Read, decode and measure all contents as well: bytes, errors, edges, bounds; exit code 1 if something is wrong
    #[arg(long)]
    pub verify: bool,
    /// Draw a map of the tiles as PNG
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    /// What the colours of the map mean
    #[arg(long, value_name = "WHAT", value_enum, default_value_t, requires = "map")]
    pub map_of: MapOf,
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
    /// All benches below, one after the other; takes about ten minutes
    All {
        /// Print a Markdown document with machine, date and commit instead of JSON lines
        #[arg(long)]
        markdown: bool,
        /// Minimum time to measure each case, seconds [default: that of each bench]
        #[arg(long, value_parser = secs)]
        secs: Option<f64>,
    },
    /// Cull: from the scene to render stages, without a GPU
    Cull {
        /// Minimum time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
        /// Number of drawables of each scene
        #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [1_000, 10_000, 100_000],
            value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        drawables: Vec<u32>,
    },
    /// Traversal of a tile tree, without a GPU
    Tiles {
        /// Minimum time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Intersections of lines with a terrain of a million triangles, without a GPU
    Pick {
        /// Minimum time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Submission of render stages to wgpu's noop adapter: processor time per leaf
    Submit {
        /// Minimum time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Whole frames of 64 x 64 pixels with the software driver
    Frame {
        /// Minimum time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
        /// Draw leaves that lie between pixel centres as well
        #[arg(long)]
        every_leaf: bool,
    },
    /// Whole frames while images of an overlay arrive from a map server on this machine, and without an overlay
    Overlays {
        /// Minimum time of each flight, seconds
        #[arg(long, default_value_t = 10.0, value_parser = secs)]
        secs: f64,
    },
    /// Frame times with each threading model
    Threading {
        /// Minimum time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Savings by sharing equal contents, and the cost of finding them
    Share {
        /// Minimum time to decode each set, seconds
        #[arg(long, default_value_t = 10.0, value_parser = secs)]
        secs: f64,
    },
    /// Update of a pager with many resident pages while nothing changes, and with many requests
    Resident {
        /// Number of resident pages
        #[arg(long, default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        tiles: u32,
        /// Number of requests that wait
        #[arg(long, default_value_t = 50_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        requests: u32,
        /// Minimum time to measure each case, seconds
        #[arg(long, default_value_t = 1.0, value_parser = secs)]
        secs: f64,
    },
    /// Paging: from files to merged pages
    Page {
        /// Number of frames of the flight
        #[arg(long, default_value_t = 1200, value_parser = clap::value_parser!(u32).range(2..))]
        frames: u32,
        /// Frames per second; 0 for no limit
        #[arg(long, default_value_t = 60.0, value_parser = pace)]
        pace: f64,
        /// Draw each frame as well
        #[arg(long)]
        draw: bool,
        /// Maximum number of resident tiles; of 540 a tenth stays free, so that as many are kept as by the peer (121 files
        /// of four tiles)
        #[arg(long, default_value_t = 540, value_parser = clap::value_parser!(u32).range(1..))]
        tiles: u32,
        /// Content of the tiles
        #[arg(long, value_enum, default_value_t = PageContent::Mesh)]
        content: PageContent,
        /// Page OpenSceneGraph's own files in this folder, as the peer's `osg_page build` writes them
        #[arg(long, value_name = "FOLDER", conflicts_with_all = ["content", "world", "url"])]
        osgb: Option<PathBuf>,
        /// Number of copies of the terrain along each side, all from the same files
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
        world: u32,
        /// Fly a straight line at this speed instead of the peer's path
        #[arg(long, value_name = "M_PER_S")]
        speed: Option<Positive>,
        /// Prefetch tiles that the announced path will need within this many seconds; the peers cannot do this
        #[arg(long, value_name = "SECONDS", default_value = "0", value_parser = not_negative)]
        look_ahead: f64,
        /// While refining, load only tiles whose error is smaller by this factor than that of the visible tile
        #[arg(long, value_name = "FACTOR", default_value = "1")]
        skip_sse: Positive,
        /// Do not announce the path: prefetch by extrapolating the motion of the eye
        #[arg(long)]
        by_motion: bool,
        /// Read the tiles from this server instead of files; the folder to serve is printed on stderr
        #[arg(long, value_name = "URL")]
        url: Option<String>,
        #[command(flatten)]
        net: Box<NetArgs>,
    },
}

/// The content of the tiles of `bench page`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PageContent {
    /// Binary glTF with positions, normals, texture coordinates and an image, like the peer's tiles
    Mesh,
    /// The same with 16 bytes per vertex (KHR_mesh_quantization), like the meshes of `terrane gen`
    Quantized,
    /// EXR heights on a shared grid, and an image
    Height,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn arguments_are_consistent() {
        Args::command().debug_assert();
    }
}
