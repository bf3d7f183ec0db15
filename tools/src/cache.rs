//! `terrane cache`: inspects, clears, verifies and fills the cache on disk.

use std::io::Write as _;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args as ClapArgs, Subcommand};
use terrane::fetch::{CacheConfig, CacheInfo, DiskCache};
use terrane::formats::{self, FillOptions};
use terrane::math::{Region, WGS84};
use terrane_data_gen::Progress;

use crate::net::{self, NetArgs, Opened};

#[derive(Clone, Debug, ClapArgs)]
pub struct CacheArgs {
    #[command(subcommand)]
    pub command: CacheCommand,
}

#[derive(Clone, Debug, Subcommand)]
pub enum CacheCommand {
    /// Print the number of entries and their size
    Info(FolderArgs),
    /// Remove all entries
    Clear(FolderArgs),
    /// Read all entries and remove corrupt ones
    Verify(FolderArgs),
    /// Fetch a part of a tile set for offline use; a stopped run continues where it ended
    Fill(Box<FillArgs>),
}

#[derive(Clone, Debug, ClapArgs)]
pub struct FillArgs {
    /// http(s) URL or s3://, gs://, az:// URI of a folder, tileset.json or archive
    pub source: String,
    /// Only tiles that overlap this region, in degrees
    #[arg(long, value_name = "WEST,SOUTH,EAST,NORTH", allow_hyphen_values = true)]
    pub region: Option<RegionArg>,
    /// Only these levels of the tree, such as 0-5 or 7; the root has level 0
    #[arg(long, value_name = "FIRST-LAST")]
    pub level: Option<Levels>,
    /// Maximum number of requests in flight
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub jobs: u32,
    /// Revalidate cached entries with the server
    #[arg(long)]
    pub refresh: bool,
    #[command(flatten)]
    pub net: NetArgs,
}

impl CacheArgs {
    /// Returns the arguments for servers, and the source that they are for.
    pub fn net(&self) -> Option<(&NetArgs, &str)> {
        match &self.command {
            CacheCommand::Fill(args) => Some((&args.net, &args.source)),
            _ => None,
        }
    }
}

/// A region: west, south, east and north in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionArg(pub [f64; 4]);

impl FromStr for RegionArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[west, south, east, north])
                if [west, east].iter().all(|d| d.abs() <= 180.0)
                    && south >= -90.0
                    && south <= north
                    && north <= 90.0 =>
            {
                Ok(Self([west, south, east, north]))
            }
            _ => Err("expected WEST,SOUTH,EAST,NORTH in degrees, such as 7.5,46.2,8,46.6".to_owned()),
        }
    }
}

/// The first and the last level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Levels(pub u32, pub u32);

impl FromStr for Levels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        match (first.trim().parse(), last.trim().parse()) {
            (Ok(first), Ok(last)) if first <= last => Ok(Self(first, last)),
            _ => Err("expected levels, such as 0-5 or 7".to_owned()),
        }
    }
}

#[derive(Clone, Debug, ClapArgs)]
pub struct FolderArgs {
    /// Folder of the cache [default: terrane/http in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Print one JSON document instead of text
    #[arg(long)]
    pub json: bool,
}

impl FolderArgs {
    fn open(&self) -> Result<DiskCache> {
        let folder = net::folder(self.cache.clone())?;
        // `DiskCache::open` would create a missing folder.
        if !folder.is_dir() {
            bail!("{}: no cache in this folder", folder.display());
        }
        Ok(DiskCache::open(&CacheConfig::new(folder))?)
    }
}

fn fill(args: &FillArgs) -> Result<()> {
    let mut net = args.net.clone();
    ensure!(!net.offline, "--offline sends no requests, so it cannot fill the cache");
    net.cache = Some(net::folder(net.cache)?);
    let Opened { source, http: config, .. } = net.open(&args.source)?;
    let mut options = FillOptions { in_flight: args.jobs as usize, refresh: args.refresh, ..FillOptions::default() };
    if let Some(RegionArg(degrees)) = args.region {
        let [west, south, east, north] = degrees.map(f64::to_radians);
        options.region =
            Some(Region { west, south, east, north, min_height_m: 0.0, max_height_m: 0.0, ellipsoid: WGS84 });
    }
    if let Some(Levels(first, last)) = args.level {
        options.levels = first..=last;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    // Setting a second handler in one process fails, which only happens in tests.
    let _ = ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed));
    let mut progress = Progress::new("filling the cache", 0, "files");
    let done = formats::fill(&source, &config, &options, &mut |filled| {
        progress.set_total(filled.found);
        progress.set_done(filled.kept + filled.fetched + filled.failed);
        if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    drop(progress);
    let done = done?;
    let mut text = format!(
        "{} files: {} already cached, {} fetched ({:.1} MiB), {} failed",
        done.kept + done.fetched + done.failed,
        done.kept,
        done.fetched,
        mebibytes(done.bytes),
        done.failed
    );
    if done.stopped {
        text.push_str("; stopped, the same command continues from here");
    }
    let cache = &done.cache;
    let lost = done.fetched.saturating_sub(cache.stored + cache.too_large);
    for (count, what) in [
        (cache.evicted, "{} least recently used bodies were evicted (--cache-size)"),
        (cache.too_large, "{} are too large for the cache, each more than an eighth of --cache-size"),
        (lost, "{} could not be cached, because the server forbids it or the disk is full"),
    ] {
        if count > 0 {
            text.push_str("; ");
            text.push_str(&what.replace("{}", &count.to_string()));
        }
    }
    writeln!(std::io::stdout(), "{text}").context("stdout")?;
    if let Some((uri, reason)) = done.errors.first() {
        let more = done.failed - 1;
        bail!("{uri}: {reason}{}", if more > 0 { format!(" and {more} more") } else { String::new() });
    }
    ensure!(!done.stopped, "stopped before all files were fetched");
    Ok(())
}

fn mebibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

pub fn run(args: &CacheArgs) -> Result<()> {
    let text = match &args.command {
        CacheCommand::Fill(args) => return fill(args),
        CacheCommand::Info(folder) => {
            let cache = folder.open()?;
            let info = cache.info()?;
            if folder.json {
                serde_json::to_string_pretty(&info)?
            } else {
                let folder = cache.folder().display();
                let CacheInfo { entries, fresh, bodies, bytes, max_bytes } = info;
                let (used, max) = (mebibytes(bytes), mebibytes(max_bytes));
                format!("{folder}: {entries} entries ({fresh} fresh), {bodies} bodies, {used:.1} of {max:.0} MiB")
            }
        }
        CacheCommand::Clear(folder) => {
            let cache = folder.open()?;
            let bytes = cache.clear()?;
            if folder.json {
                serde_json::json!({ "bytes": bytes }).to_string()
            } else {
                format!("{}: {:.1} MiB removed", cache.folder().display(), mebibytes(bytes))
            }
        }
        CacheCommand::Verify(folder) => {
            let cache = folder.open()?;
            let found = cache.verify()?;
            if folder.json {
                serde_json::to_string_pretty(&found)?
            } else {
                format!(
                    "{}: {} valid files; removed {} corrupt ones and {} without their other half",
                    cache.folder().display(),
                    found.whole,
                    found.broken,
                    found.orphans
                )
            }
        }
    };
    writeln!(std::io::stdout(), "{text}").context("stdout")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_and_levels_are_parsed() {
        assert_eq!("-1.5,46, 8,46.6".parse(), Ok(RegionArg([-1.5, 46.0, 8.0, 46.6])));
        for bad in ["", "1,2,3", "0,50,1,40", "0,0,200,1", "0,-91,1,1", "0,nan,1,1", "a,b,c,d"] {
            assert!(bad.parse::<RegionArg>().is_err(), "{bad}");
        }
        assert_eq!(["0-5", "7"].map(str::parse), [Ok(Levels(0, 5)), Ok(Levels(7, 7))]);
        for bad in ["", "5-3", "-1", "a", "1-"] {
            assert!(bad.parse::<Levels>().is_err(), "{bad}");
        }
    }
}
