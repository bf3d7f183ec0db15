//! How fast bytes go over a connection. Its thread alone: of HTTP/2, all answers are tasks on that thread.

use std::time::{Duration, Instant};

/// Most bytes between two looks at the clock.
const PIECE: usize = 64 << 10;
/// Pieces a second at least, where the bandwidth is bounded.
const PIECES_PER_S: f64 = 50.0;

/// The line of a connection, which all its answers share.
pub(super) struct Line {
    /// Bytes a second; 0 for as many as go.
    bandwidth: f64,
    /// All that was sent is there by then.
    free_at: Instant,
}

impl Line {
    pub(super) fn new(bandwidth: f64) -> Self {
        Self { bandwidth, free_at: Instant::now() }
    }

    /// Bytes of a piece, at most.
    pub(super) fn piece(&self) -> usize {
        if self.bandwidth > 0.0 { ((self.bandwidth / PIECES_PER_S) as usize).clamp(1, PIECE) } else { PIECE }
    }

    /// A body begins: what the line did not carry before is lost.
    pub(super) fn begin(&mut self) {
        self.free_at = self.free_at.max(Instant::now());
    }

    /// The wait until so many more bytes are there: the last one no sooner than the bandwidth lets it.
    pub(super) fn carry(&mut self, bytes: usize) -> Duration {
        if self.bandwidth <= 0.0 {
            return Duration::ZERO;
        }
        // A bandwidth as small as any is no overflow.
        let more = Duration::from_secs_f64((bytes as f64 / self.bandwidth).min(1e9));
        self.free_at += more;
        self.free_at.saturating_duration_since(Instant::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_share_a_line() {
        let mut line = Line::new(1000.0);
        assert_eq!(line.piece(), 20);
        line.begin();
        let (first, second) = (line.carry(100), line.carry(100));
        assert!(first <= Duration::from_millis(100) && first > Duration::from_millis(50), "{first:?}");
        assert!(second > Duration::from_millis(150), "{second:?}");
        // Another body begins while the first one is on its way.
        line.begin();
        assert!(line.carry(100) > Duration::from_millis(250));
        let mut wide = Line::new(0.0);
        assert_eq!((wide.piece(), wide.carry(usize::MAX)), (PIECE, Duration::ZERO));
    }
}
