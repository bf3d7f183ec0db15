//! Progress of a long job on standard error: a bar on a terminal, otherwise a line every few seconds. Any thread may
//! report progress.

use std::io::Write as _;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Jobs that finish sooner than this print no lines.
const FIRST_LINE_AFTER: Duration = Duration::from_secs(2);
/// The time between two lines without a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(5);
/// The least share of the work that must be done before the rest is estimated.
const MIN_ESTIMATED_SHARE: f64 = 0.02;

/// The progress of one job. Dropping it clears the bar.
pub struct Progress {
    bar: ProgressBar,
    name: &'static str,
    unit: &'static str,
    started: Instant,
    /// The time of the next line; `None` on a terminal, which shows the bar instead.
    next_line: Option<Mutex<Instant>>,
}

impl Progress {
    /// Starts a job of `total` steps; 0 if the number is unknown. `unit` names the steps in the plural ("tiles").
    pub fn new(name: &'static str, total: u64, unit: &'static str) -> Self {
        let bar = if total == 0 { ProgressBar::new_spinner() } else { ProgressBar::new(total) };
        let bar = bar.with_style(Self::style(total)).with_message(name);
        let started = Instant::now();
        let next_line = bar.is_hidden().then(|| Mutex::new(started + FIRST_LINE_AFTER));
        bar.tick();
        Self { bar, name, unit, started, next_line }
    }

    /// Changes the number of steps of the whole job, for jobs that find their steps while they run.
    pub fn set_total(&mut self, total: u64) {
        if self.bar.length().unwrap_or(0) == 0 && total > 0 {
            self.bar.set_style(Self::style(total));
        }
        self.bar.set_length(total);
    }

    fn style(total: u64) -> ProgressStyle {
        let template = if total == 0 { "{msg}: {pos} {elapsed}" } else { "{msg}: [{bar:40}] {pos}/{len} {eta} left" };
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
    }

    /// Counts `steps` more steps as done.
    pub fn advance(&self, steps: u64) {
        self.bar.inc(steps);
        self.print_line();
    }

    /// Sets the number of steps that are done. A job that turns out to have more than it began with is longer.
    pub fn set_done(&self, steps: u64) {
        if self.bar.length().is_some_and(|length| 0 < length && length < steps) {
            self.bar.set_length(steps);
        }
        self.bar.set_position(steps);
        self.print_line();
    }

    fn print_line(&self) {
        let Some(next_line) = &self.next_line else { return };
        let now = Instant::now();
        {
            let mut next_line = next_line.lock().unwrap_or_else(PoisonError::into_inner);
            if now < *next_line {
                return;
            }
            *next_line = now + LINE_INTERVAL;
        }
        // Work goes on without a reader of standard error.
        let _ = writeln!(std::io::stderr(), "{}", self.line(now - self.started));
    }

    /// Returns one line, such as `tiles: 1200 of 5461 tiles, 22 %, 31 s left`.
    fn line(&self, elapsed: Duration) -> String {
        let (done, name, unit) = (self.bar.position(), self.name, self.unit);
        match self.bar.length() {
            Some(total) if total > 0 => {
                let share = done as f64 / total as f64;
                let left = match share {
                    // The first steps wait for sources to be read, so that an estimate would be far too long.
                    share if share >= MIN_ESTIMATED_SHARE => {
                        format!(", {:.0} s left", elapsed.as_secs_f64() * (1.0 - share).max(0.0) / share)
                    }
                    _ => String::new(),
                };
                format!("{name}: {done} of {total} {unit}, {:.0} %{left}", 100.0 * share)
            }
            _ => format!("{name}: {done} {unit}, {} s", elapsed.as_secs()),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_contain_count_percentage_and_remaining_time() {
        let progress = Progress::new("writing", 200, "tiles");
        progress.set_done(50);
        assert_eq!(progress.line(Duration::from_secs(10)), "writing: 50 of 200 tiles, 25 %, 30 s left");
        let begun = Progress::new("writing", 200, "tiles");
        begun.set_done(1);
        assert_eq!(begun.line(Duration::from_secs(10)), "writing: 1 of 200 tiles, 0 %");
        let unknown = Progress::new("waiting", 0, "tiles loaded");
        unknown.advance(7);
        assert_eq!(unknown.line(Duration::from_secs(4)), "waiting: 7 tiles loaded, 4 s");
    }
}
