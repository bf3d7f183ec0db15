//! The small set that `terrane fly` generates if no source is given, and the user's cache folder.

use std::path::PathBuf;

use anyhow::{Context as _, Result};

/// Returns the folder of the default set in the user's cache. The first call generates the set and shows progress.
pub fn ensure() -> Result<String> {
    let folder = cache_folder().context("no cache folder: set XDG_CACHE_HOME or HOME")?.join("terrane");
    let set = terrane_data_gen::default_set(&folder)?;
    Ok(set.display().to_string())
}

/// Returns the platform's cache folder of the user, `None` if the environment does not name one.
pub fn cache_folder() -> Option<PathBuf> {
    let from = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    from("XDG_CACHE_HOME").or_else(|| {
        if cfg!(windows) {
            from("LOCALAPPDATA")
        } else if cfg!(target_os = "macos") {
            from("HOME").map(|home| home.join("Library/Caches"))
        } else {
            from("HOME").map(|home| home.join(".cache"))
        }
    })
}
