//! The options of `terrane gen`, and the summary that it prints.

use std::io::Write as _;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use crate::{Crs, HeightEncoding, OutputArgs, RasterOptions, RunArgs, Sharding, TileArgs, VerticalDatum, WorldArgs};

/// Largest number of levels of a pyramid.
pub(crate) const MAX_LEVELS: u32 = 24;
/// Valid numbers of threads.
pub(crate) const JOBS: RangeInclusive<usize> = 1..=256;
/// Valid sides of procedural terrain in metres.
pub(crate) const SIZES_M: RangeInclusive<f64> = 100.0..=2_000_000.0;
/// Largest width of the band between elevation files.
const MAX_BLEND_M: f64 = 1_000_000.0;

/// The form of the tiles' content.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ContentKind {
    /// EXR heights and images of colour. The renderer draws all tiles with one shared grid.
    #[default]
    Height,
    /// glb meshes with skirts, for any 3D Tiles client that supports KHR_mesh_quantization and EXT_meshopt_compression.
    Mesh,
    /// Terrain for globes without colour: quantized-mesh tiles in the geographic tiling, with a layer.json.
    QuantizedMesh,
}

/// The colour of tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Color {
    /// Imagery, and natural colours where there is none.
    #[default]
    Natural,
    /// Tiles have no texture.
    None,
}

/// The treatment of positions without elevation inside the rectangle of the set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Voids {
    /// Nothing is drawn there. Tiles on the border are meshes.
    #[default]
    Cut,
    /// They continue the heights around them.
    Fill,
    /// They lie at a height of 0 m.
    Sea,
}

/// Makes a tile set from elevation files, or from noise if none are given.
// More than 16 fields: one for each option and each group of options.
#[derive(Clone, Debug, clap::Args)]
pub struct GenArgs {
    /// Folder to write, or a folder in a bucket: s3://BUCKET/FOLDER, gs://... or az://...
    pub out: PathBuf,
    /// Elevation: GeoTIFF, VRT, HGT (also in a zip file), DTED, USGS DEM, netCDF, Erdas Imagine, JPEG 2000, PNG, PMTiles, MBTiles, EXR, ASCII grid,
    /// XYZ, a grid of Surfer or SAGA, or plain samples with a .hdr file; a folder of them or of web tiles z/x/y.png; a pattern such as "*.tif"; a text file with a path in each
    /// line; the address of a GeoTIFF or of PMTiles (https, s3). Where files overlap, the first with data wins
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub dem: Vec<PathBuf>,
    /// Treatment of positions without elevation
    #[arg(long, value_enum, default_value_t)]
    pub voids: Voids,
    /// Value of elevation samples without data, beside the one that a file declares
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub nodata: Option<f64>,
    /// Channel with heights: a name in EXR files, after PART: if there are several parts, of a variable in netCDF; a number from 1 in GeoTIFF and Erdas
    #[arg(long, value_name = "NAME")]
    pub channel: Option<String>,
    /// Meaning of the colours of PNGs
    #[arg(long, value_enum, default_value_t)]
    pub encoding: HeightEncoding,
    /// Metres for each step of grey PNGs, or for each unit of EXR files; a factor of the heights of other rasters
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub height_scale: Option<f64>,
    /// Metres that are added to the scaled heights
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_negative_numbers = true)]
    pub height_offset: f64,
    /// Width in metres of the band in which an elevation file blends into those below it
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    pub blend: f64,
    /// Colour: GeoTIFF, VRT, PMTiles or MBTiles; PNG, JPEG or WebP with a world file; a folder of them or of web tiles
    /// z/x/y.png; a pattern or a list. The first is above the others
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub imagery: Vec<PathBuf>,
    /// Colour of the tiles: natural colours by height and slope where there is no imagery, or none
    #[arg(long, value_enum, default_value_t)]
    pub color: Color,
    /// Reference system of rasters that do not name one, or one that is not supported: an EPSG code, or PROJ's notation
    /// (+proj=...)
    #[arg(long, value_name = "CODE", value_parser = Crs::parse)]
    pub epsg: Option<Crs>,
    /// Grid in the format NTv2 (.gsb) or GeoTIFF (of PROJ) that shifts the datum of sources to WGS84, in place of EPSG's
    /// parameters
    #[arg(long, value_name = "FILE")]
    pub datum_grid: Option<PathBuf>,
    /// Surface that the heights of --dem are measured from: ellipsoid, egm96, egm2008, or a geoid grid of PROJ (GTX, GeoTIFF)
    #[arg(long, value_name = "DATUM", default_value = "ellipsoid", value_parser = VerticalDatum::parse)]
    pub vertical_datum: VerticalDatum,
    /// Content of the tiles
    #[arg(long, value_enum, default_value_t)]
    pub content: ContentKind,
    /// Write mesh vertices as floats and without compression, for clients without KHR_mesh_quantization
    #[arg(long)]
    pub float_vertices: bool,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would print a comment as a heading")]
    pub tiles: TileArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would print a comment as a heading")]
    pub output: OutputArgs,
    /// Levels of the pyramid; by default enough for all detail of the elevation
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_LEVELS)))]
    pub levels: Option<u32>,
    /// Side of procedural terrain in metres, 100 to 2,000,000; not with --dem
    #[arg(long, value_name = "M", default_value_t = 60_000.0, conflicts_with = "dem", value_parser = size_m)]
    pub size: f64,
    /// Seed of procedural terrain; not with --dem
    #[arg(long, default_value_t = 1, conflicts_with = "dem")]
    pub seed: u64,
    /// The kind of procedural terrain, and its place.
    #[command(flatten)]
    pub world: WorldArgs,
    /// Number of threads; by default one per core
    #[arg(long, value_parser = jobs)]
    pub jobs: Option<usize>,
    /// Replace the tile set in OUT
    #[arg(long)]
    pub overwrite: bool,
    /// The part of the set to make.
    #[command(flatten)]
    pub sharding: Sharding,
    /// How the run goes.
    #[command(flatten)]
    pub run: RunArgs,
}

impl GenArgs {
    /// Returns the default options for a folder.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self {
            out: out.into(),
            dem: Vec::new(),
            voids: Voids::Cut,
            nodata: None,
            channel: None,
            encoding: HeightEncoding::TerrainRgb,
            height_scale: None,
            height_offset: 0.0,
            blend: 0.0,
            imagery: Vec::new(),
            color: Color::Natural,
            epsg: None,
            datum_grid: None,
            vertical_datum: VerticalDatum::Ellipsoid,
            content: ContentKind::Height,
            float_vertices: false,
            tiles: TileArgs::default(),
            output: OutputArgs::default(),
            levels: None,
            size: 60_000.0,
            seed: 1,
            world: WorldArgs::default(),
            jobs: None,
            overwrite: false,
            sharding: Sharding::default(),
            run: RunArgs::default(),
        }
    }

    /// Returns what elevation files do not say themselves.
    pub fn raster_options(&self) -> RasterOptions {
        RasterOptions {
            crs: self.epsg.clone(),
            channel: self.channel.clone(),
            nodata: self.nodata,
            height_scale: self.height_scale,
            height_offset: self.height_offset,
            encoding: self.encoding,
        }
    }

    /// Checks options that have no effect together; the error names both. The command line also refuses `--size` and
    /// `--seed` beside `--dem`.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.dem.is_empty() && self.imagery.is_empty() && self.epsg.is_some() {
            return Err("--epsg has no effect without --dem or --imagery".to_owned());
        }
        if self.dem.is_empty() && self.imagery.is_empty() && self.datum_grid.is_some() {
            return Err("--datum-grid has no effect without --dem or --imagery".to_owned());
        }
        for (name, is_given) in [
            ("--voids", self.voids != Voids::Cut),
            ("--nodata", self.nodata.is_some()),
            ("--channel", self.channel.is_some()),
            ("--encoding", self.encoding != HeightEncoding::TerrainRgb),
            ("--height-scale", self.height_scale.is_some()),
            ("--height-offset", self.height_offset != 0.0),
            ("--blend", self.blend != 0.0),
            ("--vertical-datum", self.vertical_datum != VerticalDatum::Ellipsoid),
        ] {
            if self.dem.is_empty() && is_given {
                return Err(format!("{name} has no effect without --dem"));
            }
        }
        if !(0.0..=MAX_BLEND_M).contains(&self.blend) {
            return Err(format!("--blend must be 0 to {MAX_BLEND_M} m"));
        }
        let is_finite = self.height_scale.is_none_or(|scale| scale.is_finite() && scale != 0.0);
        if !is_finite || !self.height_offset.is_finite() {
            return Err("--height-scale and --height-offset must be finite, and the scale not 0".to_owned());
        }
        if self.color == Color::None && !self.imagery.is_empty() {
            return Err("--imagery has no effect with --color none".to_owned());
        }
        if self.content != ContentKind::Mesh && self.float_vertices {
            return Err("--float-vertices has no effect without --content mesh".to_owned());
        }
        self.check_run()?;
        self.tiles.check(self)?;
        self.output.check(self)
    }

    /// Checks the options of the run.
    fn check_run(&self) -> Result<(), String> {
        let run = &self.run;
        if run.aligned && self.dem.is_empty() {
            return Err("--aligned has no effect without --dem".to_owned());
        }
        if run.aligned && self.voids != Voids::Cut {
            return Err(
                "--aligned leaves out places without elevation; --voids fill and sea are not supported".to_owned()
            );
        }
        if run.update && (self.world.world.is_some() || self.dem.is_empty()) {
            return Err("--update has no effect without --dem".to_owned());
        }
        if run.update && self.sharding != Sharding::default() {
            return Err("--update does not go with --plan, --shard and --merge".to_owned());
        }
        if run.memory.is_some() && self.world.world.is_some() {
            return Err("--memory has no effect with --world".to_owned());
        }
        if run.dry_run.is_some() && self.sharding != Sharding::default() {
            return Err("--dry-run predicts whole sets; leave out --plan, --shard and --merge".to_owned());
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

/// Takes negative numbers as the values of options, so that the error of `--levels -1` gives the valid range instead of clap's
/// advice on options that begin with a digit.
pub fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let command = command.mut_subcommands(with_negative_numbers);
    command.mut_args(|arg| match arg.get_action().takes_values() && !arg.is_positional() {
        true => arg.allow_negative_numbers(true),
        false => arg,
    })
}

/// The summary of a run, printed at its end.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
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
    /// The number of samples of the finest level without data that were given heights.
    pub filled_samples: u64,
    /// The number of samples of the finest level without data that were left out.
    pub cut_samples: u64,
    /// Measured errors by level, root first, metres.
    pub level_errors_m: Vec<f64>,
    /// The duration of the run in seconds.
    pub seconds: f64,
    /// Notes about the sources, each a sentence.
    pub notes: Vec<String>,
}

impl Summary {
    /// Writes the notes to standard error and the summary as one line to standard output. A closed pipe is not an error.
    pub fn print(&self) -> std::io::Result<()> {
        for note in &self.notes {
            // The set is complete even if the notes cannot be written.
            let _ = writeln!(std::io::stderr(), "note: {note}");
        }
        let mut out = std::io::stdout().lock();
        match writeln!(out, "{self}").and_then(|()| out.flush()) {
            Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
            written => written,
        }
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} tiles on {} levels, {:.1} MB, ", self.tiles, self.levels, self.bytes as f64 / 1e6)?;
        // A shard may have no tiles.
        match self.min_height_m <= self.max_height_m {
            true => write!(f, "heights {:.0} to {:.0} m, ", self.min_height_m, self.max_height_m)?,
            false => write!(f, "no heights, ")?,
        }
        write!(
            f,
            "{} samples without data {}, {:.1} s: {}",
            self.filled_samples + self.cut_samples,
            if self.filled_samples > 0 { "filled" } else { "left out" },
            self.seconds,
            self.out.display()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: an empty shard had "heights inf to -inf m".
    #[test]
    fn summary_without_tiles_has_no_heights() {
        let heights = |min_height_m: f64, max_height_m: f64| {
            let text = Summary { min_height_m, max_height_m, ..Summary::default() }.to_string();
            text.split(", ").nth(2).map(str::to_owned)
        };
        assert_eq!(heights(f64::INFINITY, f64::NEG_INFINITY).as_deref(), Some("no heights"));
        assert_eq!(heights(-2.0, 7.4).as_deref(), Some("heights -2 to 7 m"));
    }
}
