//! The local servers of a flight, and its temporary folder for the cache, images and certificates.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

use crate::serve::{Background, ServeArgs};
use crate::stress::plan::{Plan, Protocol};

/// The temporary folder of a seed. Dropping it removes the folder.
pub struct TempFolder(PathBuf);

impl TempFolder {
    /// Creates the folder.
    pub fn new(seed: u64) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("terrane-stress-{}-{seed}", std::process::id()));
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Self(folder))
    }

    /// Returns the path of a file or folder in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Creates and returns the folder for the images of sequences.
    pub fn images(&self) -> Result<PathBuf> {
        let folder = self.0.join("images");
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(folder)
    }
}

impl Drop for TempFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Starts a server for a folder with the protocol and faults of the plan. An encrypted server writes its certificate to
/// `certificate`.
pub fn start(plan: &Plan, folder: &Path, certificate: &Path) -> Result<Background> {
    let Plan { faults, protocol, .. } = plan;
    Background::start(ServeArgs {
        http1: *protocol == Protocol::Tls1,
        http2: *protocol == Protocol::Http2,
        tls: protocol.is_encrypted().then(|| certificate.to_owned()),
        latency_ms: faults.latency_ms,
        jitter_ms: faults.jitter_ms,
        bandwidth: faults.bandwidth,
        error_rate: faults.error,
        truncate_rate: faults.truncate,
        corrupt_rate: faults.corrupt,
        stall_rate: faults.stall,
        reset_rate: faults.reset,
        silent_rate: faults.silent,
        page_rate: faults.page,
        seed: plan.seed,
        ..ServeArgs::new(folder)
    })
}

/// Splits a local source into the folder to serve and the path in it.
pub fn folder_and_path(source: &str) -> Result<(PathBuf, String)> {
    let path = std::path::absolute(source)?;
    if path.is_dir() {
        return Ok((path, String::new()));
    }
    let name = path.file_name().and_then(|n| n.to_str()).with_context(|| source.to_owned())?.to_owned();
    let folder = path.parent().with_context(|| source.to_owned())?.to_owned();
    Ok((folder, name))
}
