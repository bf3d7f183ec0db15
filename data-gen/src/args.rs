//! The options of `terrane gen`, and what it reports.

use std::io::Write as _;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use crate::Crs;

/// Most levels of a pyramid.
pub(crate) const MAX_LEVELS: u32 = 9;
/// Threads that may be asked for.
pub(crate) const JOBS: RangeInclusive<usize> = 1..=256;
/// Sides of procedural terrain that can be made, metres.
pub(crate) const SIZES_M: RangeInclusive<f64> = 100.0..=2_000_000.0;

/// What the tiles hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ContentKind {
    /// EXR heights and JPEG colour, drawn from one shared grid.
    #[default]
    Height,
    /// glb meshes with skirts, for any 3D Tiles client that knows KHR_mesh_quantization.
    Mesh,
}

/// Makes a tile set from elevation data, or from noise where none is given.
#[derive(Clone, Debug, clap::Args)]
pub struct GenArgs {
    /// Folder to write
    pub out: PathBuf,
    /// Elevation: GeoTIFF, HGT, terrain-RGB PNG or EXR; several are put together, the first that knows a place wins
    #[arg(long, value_name = "FILE")]
    pub dem: Vec<PathBuf>,
    /// Colour: GeoTIFF, or PNG or JPEG with a world file
    #[arg(long, value_name = "FILE")]
    pub imagery: Option<PathBuf>,
    /// Reference system of rasters that name none, as those with a world file: 4326, 3857, or a UTM zone's 326zz,
    /// 327zz, 258zz or 269zz
    #[arg(long, value_name = "CODE", value_parser = reference_system)]
    pub epsg: Option<Crs>,
    /// What the tiles hold
    #[arg(long, value_enum, default_value_t)]
    pub content: ContentKind,
    /// Vertices of meshes in floats, twice the bytes: for clients without KHR_mesh_quantization
    #[arg(long)]
    pub float_vertices: bool,
    /// Levels of the pyramid; by default as many as the elevation has detail for
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_LEVELS)))]
    pub levels: Option<u32>,
    /// Side of procedural terrain in metres; not with --dem
    #[arg(long, value_name = "M", default_value_t = 60_000.0, conflicts_with = "dem", value_parser = size_m)]
    pub size: f64,
    /// Seed of procedural terrain; not with --dem
    #[arg(long, default_value_t = 1, conflicts_with = "dem")]
    pub seed: u64,
    /// Threads; all cores by default
    #[arg(long, value_parser = jobs)]
    pub jobs: Option<usize>,
    /// Replace the tile set that OUT holds
    #[arg(long)]
    pub overwrite: bool,
}

impl GenArgs {
    /// The defaults for a folder.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self {
            out: out.into(),
            dem: Vec::new(),
            imagery: None,
            epsg: None,
            content: ContentKind::Height,
            float_vertices: false,
            levels: None,
            size: 60_000.0,
            seed: 1,
            jobs: None,
            overwrite: false,
        }
    }
}

impl GenArgs {
    /// Checks options that have no effect together; the error names both. The command line also refuses `--size` and
    /// `--seed` beside `--dem`.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.dem.is_empty() && self.imagery.is_none() && self.epsg.is_some() {
            return Err("--epsg has no effect without --dem or --imagery".to_owned());
        }
        if self.content == ContentKind::Height && self.float_vertices {
            return Err("--float-vertices has no effect without --content mesh".to_owned());
        }
        Ok(())
    }
}

fn size_m(text: &str) -> Result<f64, String> {
    let size_m: f64 = text.parse().map_err(|_| "expected a number of metres".to_owned())?;
    if SIZES_M.contains(&size_m) { Ok(size_m) } else { Err(format!("{size_m} m is not within 100 m and 2,000 km")) }
}

fn jobs(text: &str) -> Result<usize, String> {
    let jobs = text.parse().ok().filter(|jobs| JOBS.contains(jobs));
    jobs.ok_or_else(|| format!("expected a number of threads from {} to {}", JOBS.start(), JOBS.end()))
}

fn reference_system(code: &str) -> Result<Crs, String> {
    let known = code.parse().ok().and_then(Crs::from_epsg);
    known.ok_or_else(|| "unknown code; known are 4326, 3857 and the UTM zones' 326zz, 327zz, 258zz, 269zz".to_owned())
}

/// What was made.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Summary {
    /// Folder.
    pub out: PathBuf,
    /// Tiles written.
    pub tiles: u64,
    /// Levels.
    pub levels: u32,
    /// Bytes written.
    pub bytes: u64,
    /// Lowest height in metres.
    pub min_height_m: f64,
    /// Highest height in metres.
    pub max_height_m: f64,
    /// Samples of the finest level that no source knew and that were filled from around.
    pub filled_samples: u64,
    /// Measured errors by level, root first, metres.
    pub level_errors_m: Vec<f64>,
    /// Seconds it took.
    pub seconds: f64,
}

impl Summary {
    /// Writes its line to standard output. That nobody reads it any more is no error.
    pub fn print(&self) -> std::io::Result<()> {
        let mut out = std::io::stdout().lock();
        match writeln!(out, "{self}").and_then(|()| out.flush()) {
            Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
            written => written,
        }
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} tiles on {} levels, {:.1} MB, heights {:.0} to {:.0} m, {} samples filled, {:.1} s: {}",
            self.tiles,
            self.levels,
            self.bytes as f64 / 1e6,
            self.min_height_m,
            self.max_height_m,
            self.filled_samples,
            self.seconds,
            self.out.display()
        )
    }
}
