//! [`Output`]: the folder of a new set, which is written beside it and moved there when it is complete.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use terrane_data_gen::PartialFolder;

/// The folder of a new set.
pub struct Output(PathBuf);

impl Output {
    /// Checks that the folder is empty or missing, or that it holds a set that may be replaced.
    pub fn new(out: &Path, overwrite: bool) -> Result<Self> {
        let shown = out.display();
        let path = std::path::absolute(out).with_context(|| format!("{shown}"))?;
        ensure!(!path.is_symlink() || path.exists(), "{shown}: is a link whose target does not exist");
        match std::fs::read_dir(&path).map(|mut entries| entries.next().is_some()) {
            Ok(false) => {}
            Ok(true) if !overwrite => bail!("{shown}: already exists; --overwrite replaces it"),
            Ok(true) => {
                let is_set = path.join("tileset.json").is_file();
                ensure!(is_set, "{shown} holds no tile set; --overwrite replaces tile sets only");
            }
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self(path)),
            Err(error) => return Err(error).with_context(|| format!("{shown}")),
        }
        let path = path.canonicalize().with_context(|| format!("{shown}"))?;
        Ok(Self(path))
    }

    /// Fails if a source is in the folder that will be replaced.
    pub fn check_sources<S: AsRef<Path>>(&self, sources: impl IntoIterator<Item = S>) -> Result<()> {
        for source in sources {
            let source = source.as_ref();
            let is_inside = source.canonicalize().is_ok_and(|path| path.starts_with(&self.0));
            ensure!(!is_inside, "{}: would be replaced by the new set", source.display());
        }
        Ok(())
    }

    /// Writes the set with a function of a temporary folder. If it fails, nothing is changed.
    pub fn write<T>(&self, write: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
        let partial = PartialFolder::fresh(&self.0)?;
        let value = write(partial.path())?;
        partial.put_in_place(&self.0)?;
        Ok(value)
    }
}
