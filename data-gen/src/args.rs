//! The options of `terrane gen`, and the summary that it prints.

use std::io::Write as _;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use crate::Crs;

/// Largest number of levels of a pyramid.
pub(crate) const MAX_LEVELS: u32 = 9;
/// Valid numbers of threads.
pub(crate) const JOBS: RangeInclusive<usize> = 1..=256;
/// Valid sides of procedural terrain in metres.
pub(crate) const SIZES_M: RangeInclusive<f64> = 100.0..=2_000_000.0;

/// The form of the tiles' content.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ContentKind {
    /// EXR heights and JPEG colour. The renderer draws all tiles with one shared grid.
    #[default]
    Height,
    /// glb meshes with skirts, for any 3D Tiles client that supports KHR_mesh_quantization.
    Mesh,
}

/// Makes a tile set from elevation files, or from noise if none are given.
#[derive(Clone, Debug, clap::Args)]
pub struct GenArgs {
    /// Folder to write
    pub out: PathBuf,
    /// Elevation: GeoTIFF, HGT, terrain-RGB PNG or EXR; where several overlap, the first with data wins
    #[arg(long, value_name = "FILE")]
    pub dem: Vec<PathBuf>,
    /// Colour: GeoTIFF, or PNG or JPEG with a world file
    #[arg(long, value_name = "FILE")]
    pub imagery: Option<PathBuf>,
    /// EPSG code of the reference system of rasters that do not name one, such as those with a world file: 4326, 3857,
    /// or 326zz, 327zz, 258zz or 269zz for UTM zones
    #[arg(long, value_name = "CODE", value_parser = reference_system)]
    pub epsg: Option<Crs>,
    /// Content of the tiles
    #[arg(long, value_enum, default_value_t)]
    pub content: ContentKind,
    /// Write mesh vertices as floats, for clients without KHR_mesh_quantization; vertices take twice the bytes
    #[arg(long)]
    pub float_vertices: bool,
    /// Levels of the pyramid; by default enough for all detail of the elevation
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_LEVELS)))]
    pub levels: Option<u32>,
    /// Side of procedural terrain in metres, 100 to 2,000,000; not with --dem
    #[arg(long, value_name = "M", default_value_t = 60_000.0, conflicts_with = "dem", value_parser = size_m)]
    pub size: f64,
    /// Seed of procedural terrain; not with --dem
    #[arg(long, default_value_t = 1, conflicts_with = "dem")]
    pub seed: u64,
    /// Number of threads; by default one per core
    #[arg(long, value_parser = jobs)]
    pub jobs: Option<usize>,
    /// Replace the tile set in OUT
    #[arg(long)]
    pub overwrite: bool,
}

impl GenArgs {
    /// Returns the default options for a folder.
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
    known
        .ok_or_else(|| "unknown code; supported are 4326, 3857 and 326zz, 327zz, 258zz, 269zz for UTM zones".to_owned())
}

/// The summary of a run, printed at its end.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Summary {
    /// The folder of the tile set.
    pub out: PathBuf,
    /// The number of tiles written.
    pub tiles: u64,
    /// The number of levels.
    pub levels: u32,
    /// The number of bytes written.
    pub bytes: u64,
    /// Lowest height in metres.
    pub min_height_m: f64,
    /// Highest height in metres.
    pub max_height_m: f64,
    /// The number of samples of the finest level without data; they were filled from their surroundings.
    pub filled_samples: u64,
    /// Measured errors by level, root first, metres.
    pub level_errors_m: Vec<f64>,
    /// The duration of the run in seconds.
    pub seconds: f64,
}

impl Summary {
    /// Writes the summary as one line to standard output. A closed pipe is not an error.
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
