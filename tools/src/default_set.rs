//! The small set that `terrane fly` makes for itself when it is given none.

use std::path::PathBuf;

use anyhow::{Context as _, Result};

/// The set's folder in the user's cache; makes it, with progress, when it is not there yet.
pub fn ensure() -> Result<String> {
    let folder = cache_folder().context("no cache folder: set XDG_CACHE_HOME or HOME")?.join("terrane");
    let set = terrane_data_gen::default_set(&folder)?;
    Ok(set.display().to_string())
}

/// The user's cache folder as the platform has it.
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
