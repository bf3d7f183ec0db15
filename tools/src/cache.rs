//! `terrane cache`: what is in the cache on disk, emptying and checking it.

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args as ClapArgs, Subcommand};
use terrane::io::{CacheConfig, DiskCache};

use crate::net;

#[derive(Clone, Debug, ClapArgs)]
pub struct CacheArgs {
    #[command(subcommand)]
    pub command: CacheCommand,
}

#[derive(Clone, Debug, Subcommand)]
pub enum CacheCommand {
    /// Say how much is in it
    Info(FolderArgs),
    /// Remove everything
    Clear(FolderArgs),
    /// Read everything and remove what is not as it was written
    Verify(FolderArgs),
}

#[derive(Clone, Debug, ClapArgs)]
pub struct FolderArgs {
    /// The cache's folder [default: terrane/http in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// One JSON document instead of text
    #[arg(long)]
    pub json: bool,
}

impl FolderArgs {
    fn open(&self) -> Result<DiskCache> {
        let folder = net::folder(self.cache.clone())?;
        // Looking is no reason to make one.
        if !folder.is_dir() {
            anyhow::bail!("{}: there is no cache", folder.display());
        }
        Ok(DiskCache::open(&CacheConfig::new(folder))?)
    }
}

pub fn run(args: &CacheArgs) -> Result<()> {
    let text = match &args.command {
        CacheCommand::Info(folder) => {
            let cache = folder.open()?;
            let info = cache.info()?;
            if folder.json {
                serde_json::to_string_pretty(&info)?
            } else {
                let mebibytes = info.bytes as f64 / f64::from(1 << 20);
                format!(
                    "{}: {} entries ({} fresh), {} bodies, {mebibytes:.1} MiB",
                    cache.folder().display(),
                    info.entries,
                    info.fresh,
                    info.bodies
                )
            }
        }
        CacheCommand::Clear(folder) => {
            let cache = folder.open()?;
            let bytes = cache.clear()?;
            if folder.json {
                serde_json::json!({ "bytes": bytes }).to_string()
            } else {
                format!("{}: {:.1} MiB removed", cache.folder().display(), bytes as f64 / f64::from(1 << 20))
            }
        }
        CacheCommand::Verify(folder) => {
            let cache = folder.open()?;
            let found = cache.verify()?;
            if folder.json {
                serde_json::to_string_pretty(&found)?
            } else {
                format!(
                    "{}: {} files whole, {} broken and {} without their other half removed",
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
