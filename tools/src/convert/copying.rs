//! [`copy_folder`]: copies the files of a set from a disk that may hang.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use terrane_data_gen::Progress;

/// Bytes that are read at once; the time limit holds for each.
const BLOCK_BYTES: usize = 1 << 20;
/// Steps that may wait to be counted.
const MAX_STEPS: usize = 64;

/// A step that the thread that copies has done.
enum Step {
    /// It begins to read a file or a folder.
    Begun(PathBuf),
    /// It has read a block of this size, in bytes.
    Block(usize),
    FileCopied,
    End(Result<()>),
}

/// Copies a folder with everything in it but links. Returns the number of bytes.
///
/// # Errors
/// Fails if a file cannot be read or written, or if none of its blocks is copied within `limit`.
pub fn copy_folder(from: &Path, to: &Path, limit: Duration, progress: &Progress) -> Result<u64> {
    let (source, target) = (from.to_path_buf(), to.to_path_buf());
    watched(from, limit, progress, move |steps| copy(&source, &target, steps))
}

/// Runs the work of copying on a thread, which is left alone once it hangs.
fn watched(
    from: &Path,
    limit: Duration,
    progress: &Progress,
    work: impl FnOnce(&Steps) -> Result<()> + Send + 'static,
) -> Result<u64> {
    let (sender, steps) = sync_channel(MAX_STEPS);
    let run = move || {
        let done = work(&Steps(sender.clone()));
        // Fails only if the caller has stopped waiting.
        let _ = sender.send(Step::End(done));
    };
    std::thread::Builder::new().name("copy".to_owned()).spawn(run).context("the system starts no more threads")?;
    let (mut file, mut bytes) = (from.to_path_buf(), 0);
    loop {
        match steps.recv_timeout(limit) {
            Ok(Step::Begun(path)) => file = path,
            Ok(Step::Block(size)) => bytes += size as u64,
            Ok(Step::FileCopied) => progress.advance(1),
            Ok(Step::End(done)) => return done.map(|()| bytes),
            Err(_) => bail!("{}: timed out after {} s (reading the file)", file.display(), limit.as_secs_f64()),
        }
    }
}

/// The way from the thread that copies to the one that waits.
struct Steps(SyncSender<Step>);

impl Steps {
    /// Fails once no one waits any more.
    fn send(&self, step: Step) -> Result<()> {
        self.0.send(step).ok().context("the copy was given up")
    }
}

fn copy(from: &Path, to: &Path, steps: &Steps) -> Result<()> {
    let name = |path: &Path| path.display().to_string();
    steps.send(Step::Begun(from.to_path_buf()))?;
    std::fs::create_dir_all(to).with_context(|| name(to))?;
    for entry in std::fs::read_dir(from).with_context(|| name(from))? {
        let entry = entry.with_context(|| name(from))?;
        let (source, target) = (entry.path(), to.join(entry.file_name()));
        // Links may lead out of the set, and are left out as the reader of the set does.
        let kind = entry.file_type().with_context(|| name(&source))?;
        if kind.is_dir() {
            copy(&source, &target, steps)?;
        } else if kind.is_file() {
            steps.send(Step::Begun(source.clone()))?;
            copy_file(&source, &target, steps)?;
            steps.send(Step::FileCopied)?;
        }
    }
    Ok(())
}

fn copy_file(from: &Path, to: &Path, steps: &Steps) -> Result<()> {
    let mut source = File::open(from).with_context(|| from.display().to_string())?;
    let mut target = File::create(to).with_context(|| to.display().to_string())?;
    let mut block = Vec::new();
    loop {
        block.clear();
        let part = (&mut source).take(BLOCK_BYTES as u64).read_to_end(&mut block);
        if part.with_context(|| from.display().to_string())? == 0 {
            return Ok(());
        }
        target.write_all(&block).with_context(|| to.display().to_string())?;
        steps.send(Step::Block(block.len()))?;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn file_that_hangs_is_named_after_the_time_limit() {
        let progress = Progress::new("copying", 0, "files");
        let (release, hangs) = channel::<()>();
        let error = watched(Path::new("/set"), Duration::from_millis(20), &progress, move |steps| {
            steps.send(Step::Begun("/set/a.glb".into()))?;
            let _ = hangs.recv();
            Ok(())
        });
        assert_eq!(error.unwrap_err().to_string(), "/set/a.glb: timed out after 0.02 s (reading the file)");
        drop(release);
    }

    #[test]
    fn folder_is_copied_with_all_its_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("from"), folder.path().join("to"));
        std::fs::create_dir_all(from.join("b")).unwrap();
        let large: Vec<u8> = (0..BLOCK_BYTES + 7).map(|i| (i % 251) as u8).collect();
        for (name, bytes) in [("a", &large[..]), ("b/c", b"small"), ("b/empty", b"")] {
            std::fs::write(from.join(name), bytes).unwrap();
        }
        let progress = Progress::new("copying", 0, "files");
        let bytes = copy_folder(&from, &to, Duration::from_secs(60), &progress).unwrap();
        assert_eq!(bytes, large.len() as u64 + 5);
        assert_eq!(std::fs::read(to.join("a")).unwrap(), large);
        assert!(std::fs::read(to.join("b/c")).unwrap() == b"small" && to.join("b/empty").is_file());
    }
}
