//! The limit of bandwidth of a connection. Only the thread of the connection uses it: with HTTP/2 all answers are tasks on
//! that thread.

use std::time::{Duration, Instant};

/// Maximum number of bytes that are sent at once.
const MAX_PIECE_BYTES: usize = 64 << 10;
/// Minimum number of pieces per second with a limited bandwidth.
const MIN_PIECES_PER_S: f64 = 50.0;

/// Delays the pieces of all answers of a connection.
pub(super) struct BandwidthLimit {
    /// Bytes per second; 0 for no limit.
    bandwidth: f64,
    /// The time at which everything that was sent has arrived.
    free_at: Instant,
}

impl BandwidthLimit {
    /// Creates a limit in bytes per second; 0 for no limit.
    pub(super) fn new(bandwidth: f64) -> Self {
        Self { bandwidth, free_at: Instant::now() }
    }

    /// Returns the maximum size of a piece in bytes.
    pub(super) fn max_piece_bytes(&self) -> usize {
        if self.bandwidth > 0.0 {
            ((self.bandwidth / MIN_PIECES_PER_S) as usize).clamp(1, MAX_PIECE_BYTES)
        } else {
            MAX_PIECE_BYTES
        }
    }

    /// Starts a body. Bandwidth that was not used before is lost.
    pub(super) fn start_body(&mut self) {
        self.free_at = self.free_at.max(Instant::now());
    }

    /// Returns the delay before the next `bytes` may be sent. The last of them arrives no sooner than the bandwidth allows.
    pub(super) fn delay_for(&mut self, bytes: usize) -> Duration {
        if self.bandwidth <= 0.0 {
            return Duration::ZERO;
        }
        // The limit avoids an overflow with a tiny bandwidth.
        let more = Duration::from_secs_f64((bytes as f64 / self.bandwidth).min(1e9));
        self.free_at += more;
        self.free_at.saturating_duration_since(Instant::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_share_the_bandwidth() {
        let mut limit = BandwidthLimit::new(1000.0);
        assert_eq!(limit.max_piece_bytes(), 20);
        limit.start_body();
        let (first, second) = (limit.delay_for(100), limit.delay_for(100));
        assert!(first <= Duration::from_millis(100) && first > Duration::from_millis(50), "{first:?}");
        assert!(second > Duration::from_millis(150), "{second:?}");
        // Another body starts while the first one is being sent.
        limit.start_body();
        assert!(limit.delay_for(100) > Duration::from_millis(250));
        let mut wide = BandwidthLimit::new(0.0);
        assert_eq!((wide.max_piece_bytes(), wide.delay_for(usize::MAX)), (MAX_PIECE_BYTES, Duration::ZERO));
    }
}
