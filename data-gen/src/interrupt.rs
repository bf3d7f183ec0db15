//! Ctrl-C and SIGTERM: says what an interrupted run leaves, and ends the program.
//!
//! A separate thread waits for signals. Runs tell it about their temporary folders.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// A temporary folder of a run.
struct Unfinished {
    folder: PathBuf,
    /// True if the same command continues with its files.
    is_continued: bool,
}

/// The folders of runs in this process, in the order in which they were created. Written by runs, read by the thread that waits
/// for signals.
static UNFINISHED: Mutex<Vec<Unfinished>> = Mutex::new(Vec::new());

/// Adds the folder of a run.
pub(crate) fn add(folder: &Path, is_continued: bool) {
    let mut unfinished = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
    unfinished.push(Unfinished { folder: folder.to_path_buf(), is_continued });
}

/// Removes the folder of a run that has ended.
pub(crate) fn remove(folder: &Path) {
    let mut unfinished = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
    unfinished.retain(|run| run.folder != folder);
}

/// Makes Ctrl-C and SIGTERM end the program with exit code 130 and a line on standard error, which begins with the program's
/// name: what an unfinished run leaves, and how to continue it. Folders that no run continues are removed. Call it once, before
/// a run.
#[cfg(unix)]
pub fn exit_on_interrupt(program: &'static str) -> std::io::Result<()> {
    use std::io::{IsTerminal as _, Write as _};

    use signal_hook::consts::{SIGINT, SIGTERM};

    /// The exit code that shells use for a program that Ctrl-C has ended.
    const INTERRUPTED: i32 = 130;

    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM])?;
    let wait = move || {
        if signals.forever().next().is_none() {
            return;
        }
        // No run changes its folders from here on.
        let unfinished = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
        let mut stderr = std::io::stderr();
        // Below the progress bar.
        let start = if stderr.is_terminal() { "\n" } else { "" };
        // Without a reader of standard error only the exit code tells.
        let _ = writeln!(stderr, "{start}{program}: {}", end(&unfinished));
        std::process::exit(INTERRUPTED);
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(wait).map(drop)
}

/// Does nothing: signals are those of Unix.
#[cfg(not(unix))]
pub fn exit_on_interrupt(_: &'static str) -> std::io::Result<()> {
    Ok(())
}

/// Removes folders that no run continues. Returns what is left.
#[cfg(any(unix, test))]
fn end(unfinished: &[Unfinished]) -> String {
    // A folder inside of another one is a part of it.
    match unfinished.first() {
        None => "interrupted".to_owned(),
        Some(Unfinished { folder, is_continued: true }) => {
            format!("interrupted; the same command continues (parts are in {})", folder.display())
        }
        Some(Unfinished { folder, is_continued: false }) => {
            // Other threads still write, so that a folder may get a file while it is removed.
            let is_removed = (0..8).any(|_| std::fs::remove_dir_all(folder).is_ok()) || !folder.exists();
            match is_removed {
                true => "interrupted; nothing was written".to_owned(),
                false => format!("interrupted; the next run for the same set removes {}", folder.display()),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interrupt_keeps_only_what_a_run_continues() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(".set.partial-1");
        std::fs::create_dir_all(path.join("0/0")).unwrap();
        let run = |is_continued| [Unfinished { folder: path.clone(), is_continued }];
        let expected = format!("interrupted; the same command continues (parts are in {})", path.display());
        assert_eq!((end(&run(true)), path.exists()), (expected, true));
        assert_eq!((&*end(&run(false)), path.exists()), ("interrupted; nothing was written", false));
        assert_eq!(end(&[]), "interrupted");
    }
}
