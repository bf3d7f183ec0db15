//! `terrane convert`, `merge` and `crop`: make 3D Tiles 1.1 of other sets.

mod copying;
mod merge;
mod out;

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use clap::Args as ClapArgs;
use terrane::fetch::{is_remote, root_uri, shown};
use terrane::formats::{self, ConvertError, ConvertOptions, Converted, Counts};
use terrane::math::{Region, WGS84};
use terrane_data_gen::Progress;

use self::out::Output;
use crate::cache::RegionArg;
use crate::net::NetArgs;
use crate::values::{Positive, shown_bytes};

pub use self::merge::{MergeArgs, merge};

#[derive(Clone, Debug, ClapArgs)]
pub struct ConvertArgs {
    /// Folder, tileset.json, layer.json, metadata.xml, .osgb, .glb or other model, archive, http(s) URL, s3://, gs:// or az://
    /// URI, ion:ASSET_ID, google
    pub source: String,
    /// Folder of the new set
    pub out: PathBuf,
    #[command(flatten)]
    how: HowArgs,
}

#[derive(Clone, Debug, ClapArgs)]
pub struct CropArgs {
    /// Set of any format that `terrane convert` reads
    pub source: String,
    /// Folder of the new set
    pub out: PathBuf,
    /// Only tiles that overlap this region, in degrees; each is kept as a whole
    #[arg(long, value_name = "W,S,E,N", allow_hyphen_values = true, required_unless_present = "metres")]
    region: Option<RegionArg>,
    /// Only tiles that overlap this rectangle of a set that is not on the earth, in metres of its x and y
    #[arg(long, value_name = "X0,Y0,X1,Y1", allow_hyphen_values = true, value_parser = rectangle,
        conflicts_with = "region")]
    metres: Option<Rectangle>,
    #[command(flatten)]
    how: HowArgs,
}

/// The arguments of both commands.
#[derive(Clone, Debug, ClapArgs)]
struct HowArgs {
    /// Compress vertices and indices (EXT_meshopt_compression)
    #[arg(long)]
    meshopt: bool,
    /// Replace the tile set in OUT
    #[arg(long)]
    overwrite: bool,
    /// Do not decode the written contents to count what they hold
    #[arg(long)]
    no_check: bool,
    /// Error in pixels at which the viewer refines, for levels that switch at a distance
    #[arg(long, value_name = "PX", default_value = "16")]
    sse: Positive,
    /// Number of threads [default: one for each core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Print one JSON document instead of text
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    net: NetArgs,
}

impl ConvertArgs {
    /// Returns the arguments for servers, and the source that they are for.
    pub fn net(&self) -> (&NetArgs, &str) {
        (&self.how.net, &self.source)
    }
}

impl CropArgs {
    /// Returns the arguments for servers, and the source that they are for.
    pub fn net(&self) -> (&NetArgs, &str) {
        (&self.how.net, &self.source)
    }
}

/// Converts a set.
pub fn run(args: &ConvertArgs) -> Result<()> {
    convert(&args.source, &args.out, &args.how, ConvertOptions::default(), formats::convert)
}

/// The smallest x and y, then the largest, metres.
#[derive(Clone, Copy, Debug)]
struct Rectangle([f64; 4]);

fn rectangle(text: &str) -> Result<Rectangle, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x0, y0, x1, y1]) if x0 < x1 && y0 < y1 && (x1 - x0).is_finite() && (y1 - y0).is_finite() => {
            Ok(Rectangle([x0, y0, x1, y1]))
        }
        _ => Err("expected the smallest x and y, then the largest, in metres, such as 0,0,500,250".to_owned()),
    }
}

/// Copies the part of a set over a region, or converts it.
pub fn crop(args: &CropArgs) -> Result<()> {
    let region = args.region.map(|RegionArg(degrees)| {
        let [west, south, east, north] = degrees.map(f64::to_radians);
        Region { west, south, east, north, min_height_m: 0.0, max_height_m: 0.0, ellipsoid: WGS84 }
    });
    let rectangle_m = args.metres.map(|Rectangle(metres)| metres);
    let part = ConvertOptions { region, rectangle_m, ..ConvertOptions::default() };
    convert(&args.source, &args.out, &args.how, part, formats::crop)
}

/// [`formats::convert`] or [`formats::crop`].
type Job = fn(&str, &Path, &ConvertOptions, &mut dyn FnMut(&Converted)) -> Result<Converted, ConvertError>;

fn convert(source: &str, out: &Path, how: &HowArgs, part: ConvertOptions, job: Job) -> Result<()> {
    let output = Output::new(out, how.overwrite)?;
    if !is_remote(source) {
        // Fails on a disk that hangs.
        root_uri(source)?;
        output.check_sources([source])?;
    }
    let opened = how.net.open(source)?;
    let options = ConvertOptions {
        meshopt: how.meshopt,
        max_sse_px: how.sse.0,
        check: !how.no_check,
        threads: how.jobs.map(usize::from),
        limits: how.net.limits(),
        http: opened.http,
        ..part
    };
    let progress = Progress::new("converting", 0, "contents");
    let converted = output.write(|folder| {
        let mut show = |converted: &Converted| progress.set_done(converted.source.contents());
        Ok(job(&opened.source, folder, &options, &mut show)?)
    })?;
    drop(progress);
    let text = match how.json {
        true => serde_json::to_string_pretty(&converted)? + "\n",
        false => text(&converted, how.no_check),
    };
    std::io::stdout().write_all(text.as_bytes()).context("stdout")?;
    let Converted { source: read, written, failed, .. } = &converted;
    ensure!(*failed == 0, "{}: {failed} could not be read; the set has the others", shown(source));
    let is_same = how.no_check || read == written;
    ensure!(is_same, "{}: the written set differs from the source", shown(source));
    Ok(())
}

/// A row of the printed table: its name and what it counts.
type Row = (&'static str, fn(&Counts) -> u64);

fn text(converted: &Converted, is_unchecked: bool) -> String {
    let Converted { source, written, files, bytes, copied, errors, failed, left_out } = converted;
    let mut lines = vec![format!("files     {files}, {}", shown_bytes(*bytes))];
    if *copied > 0 {
        lines.push(format!("copied    {copied} as they are"));
    }
    lines.push(format!("          {:>14} {:>14}", "source", "written"));
    let rows: [Row; 8] = [
        ("contents", Counts::contents),
        ("levels", |counts| counts.levels.len() as u64),
        ("triangles", |counts| counts.triangles),
        ("segments", |counts| counts.segments),
        ("points", |counts| counts.points),
        ("splats", |counts| counts.splats),
        ("textures", |counts| counts.textures),
        ("pixels", |counts| counts.texture_pixels),
    ];
    for (number, (name, count)) in rows.into_iter().enumerate() {
        let (of_source, of_written) = (count(source), count(written));
        if is_unchecked && number > 1 {
            lines.push(format!("{name:<9} {of_source:>14} {:>14}", "-"));
        } else if of_source != 0 || of_written != 0 {
            lines.push(format!("{name:<9} {of_source:>14} {of_written:>14}"));
        }
    }
    lines.extend(left_out.iter().map(|(kind, count)| format!("left out  {kind}: {count}")));
    lines.extend(errors.iter().map(|(uri, reason)| format!("error     {uri}: {reason}")));
    if let more @ 1.. = failed - errors.len() as u64 {
        lines.push(format!("          and {more} more"));
    }
    lines.join("\n") + "\n"
}
