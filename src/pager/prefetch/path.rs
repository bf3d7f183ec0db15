//! [`PathLooks`]: prefetching along a known path. Main thread.
//!
//! A look is a cull from the pose at a later time of the path; it finds the contents that a frame there would lack. Looks
//! follow each other along the path in steps, up to some time ahead of the frame. What a look found is requested until its
//! moment has passed. Steps adapt to how much frames differ: while looks find much that is new, steps halve; while they
//! find little, steps grow. A path begins with a look far ahead, because over a slow network contents needed there cannot
//! wait until the steps have reached it.

use std::collections::{HashMap, VecDeque};

use crate::cull::PageRequest;
use crate::scene::NodeId;

/// Maximum number of looks in one frame, besides the far one: at first they catch up with the time ahead.
const MAX_LOOKS_PER_FRAME: u32 = 2;
/// Requests kept of a look; the most urgent ones.
const MAX_REQUESTS: usize = 128;
/// If a look finds more new requests than this, the step before it was too long.
const MAX_NEW_PER_STEP: usize = 8;
/// The maximum step as a share of the time ahead.
const MAX_STEP_SHARE: f64 = 1.0 / 3.0;

/// Decides when to look ahead along a path, and keeps what the looks found.
#[derive(Debug, Default)]
pub struct PathLooks {
    /// Time of the path at the last frame, seconds.
    now_s: f64,
    /// Time of the farthest look in steps, seconds.
    looked_s: f64,
    step_s: f64,
    /// True once the far look at the beginning was made.
    has_begun: bool,
    /// Time of the look that [`Self::next`] returned last, seconds.
    at_s: f64,
    /// Requests by the time of their look: those that no look had found, or only for a later time.
    found: VecDeque<(f64, Vec<PageRequest>)>,
    /// The earliest time at which each slot is needed.
    known: HashMap<NodeId, f64>,
    looks_in_frame: u32,
}

impl PathLooks {
    /// Begins the frame at `now_s` seconds of the path and forgets looks whose moment has passed. A time before the last
    /// frame or beyond all looks restarts.
    pub fn start_frame(&mut self, now_s: f64) {
        let continues = now_s >= self.now_s && now_s <= self.looked_s;
        if !continues {
            self.found.clear();
            self.known.clear();
            (self.looked_s, self.has_begun) = (now_s, false);
        }
        while let Some((at_s, past)) = self.found.pop_front_if(|(at_s, _)| *at_s <= now_s) {
            for request in past {
                if self.known.get(&request.slot) == Some(&at_s) {
                    self.known.remove(&request.slot);
                }
            }
        }
        self.now_s = now_s;
        self.looks_in_frame = 0;
    }

    /// Returns the time of the path at which to look now, if any: at most `ahead_s` after the frame's time. A frame takes
    /// `frame_s`. Call it again after [`Self::found`].
    pub fn next(&mut self, ahead_s: f64, frame_s: f64) -> Option<f64> {
        if !(ahead_s > 0.0 && frame_s > 0.0) || self.looks_in_frame >= MAX_LOOKS_PER_FRAME {
            return None;
        }
        let longest_s = ahead_s * MAX_STEP_SHARE;
        self.step_s = self.step_s.min(longest_s).max(frame_s);
        let is_far = !std::mem::replace(&mut self.has_begun, true) && longest_s > self.step_s;
        let next_s = self.looked_s + if is_far { longest_s } else { self.step_s };
        // At the time of a coming frame: poses between frames may want other contents.
        let frames = ((next_s - self.now_s) / frame_s).round();
        (frames <= (ahead_s / frame_s + 0.01).floor()).then(|| {
            let at_s = self.now_s + frames * frame_s;
            self.at_s = at_s;
            if !is_far {
                self.looks_in_frame += 1;
                self.looked_s = at_s;
            }
            at_s
        })
    }

    /// Accepts the requests of a cull at the time that [`Self::next`] returned.
    pub fn found(&mut self, requests: &[PageRequest]) {
        let count = self.found_at(self.at_s, requests);
        if self.at_s > self.looked_s {
            return;
        }
        self.step_s *= if count > MAX_NEW_PER_STEP { 0.5 } else { 1.5 };
    }

    /// Accepts the requests of a cull at any time; returns how many are new. A slot that was expected to be needed later
    /// counts as new.
    pub(super) fn found_at(&mut self, at_s: f64, requests: &[PageRequest]) -> usize {
        let is_new = |r: &&PageRequest| self.known.get(&r.slot).is_none_or(|known_s| at_s < *known_s);
        let mut new: Vec<PageRequest> = requests.iter().filter(is_new).copied().collect();
        new.sort_unstable_by(|a, b| b.priority.total_cmp(&a.priority));
        new.truncate(MAX_REQUESTS);
        self.known.extend(new.iter().map(|request| (request.slot, at_s)));
        let (index, count) = (self.found.partition_point(|(found_s, _)| *found_s <= at_s), new.len());
        self.found.insert(index, (at_s, new));
        count
    }

    /// Restarts the looks at the frame's time, after the path has changed. Requests stay until their moment.
    pub(super) fn look_anew(&mut self) {
        self.looked_s = self.now_s;
    }

    /// Restarts as [`Self::look_anew`] does, with a far look as at a path's beginning.
    pub(crate) fn begin_anew(&mut self) {
        self.look_anew();
        self.has_begun = false;
    }

    /// Returns what coming frames will lack, with the number of frames until then; a frame takes `frame_s`.
    pub fn requests(&self, frame_s: f64) -> impl Iterator<Item = PageRequest> {
        self.found.iter().flat_map(move |(at_s, found)| {
            let frames = frames_until(at_s - self.now_s, frame_s);
            found.iter().map(move |request| request.ahead(frames))
        })
    }
}

/// Returns the number of whole frames of `frame_s` in `seconds`; at least 1.
pub fn frames_until(seconds: f64, frame_s: f64) -> u32 {
    (seconds / frame_s).ceil().clamp(1.0, 1e6) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pager::loading::page_job::tests::job;

    /// Returns requests for slots of one page.
    fn requests(slots: impl IntoIterator<Item = u32>) -> Vec<PageRequest> {
        let page = job(0, "").slot.page;
        let request =
            |index| PageRequest { slot: NodeId { page, index }, priority: 1.0, error_px: 1.0, ahead_frames: 0 };
        slots.into_iter().map(request).collect()
    }

    /// Runs the frame at a time; each look finds what `at` returns. Returns the times of the looks.
    fn frame(looks: &mut PathLooks, now_s: f64, at: impl Fn(f64) -> Vec<PageRequest>) -> Vec<f64> {
        looks.start_frame(now_s);
        std::iter::from_fn(|| {
            let time_s = looks.next(1.0, 0.01)?;
            looks.found(&at(time_s));
            Some(time_s)
        })
        .collect()
    }

    #[test]
    fn looks_are_frequent_where_much_is_new_and_rare_where_nothing_is() {
        // Each hundredth of a second needs ten other slots.
        let busy = |time_s: f64| {
            let first = (time_s * 100.0).round() as u32 * 10;
            requests(first..first + 10)
        };
        let mut looks = PathLooks::default();
        let mut times = Vec::new();
        for i in 0..300 {
            times.extend(frame(&mut looks, f64::from(i) * 0.01, busy));
            let last = times.last().unwrap();
            // All but the far one are in order.
            assert!(times[1..].is_sorted() && *last <= f64::from(i) * 0.01 + 1.0);
        }
        assert!(times.windows(2).skip(40).all(|w| w[1] - w[0] < 0.011), "{times:?}");
        assert!(*times.last().unwrap() > 3.9, "up to the time ahead");
        // Each once, in the order in which they are needed, and none that has passed.
        let wanted: Vec<u32> = looks.requests(0.01).map(|r| r.ahead_frames).collect();
        assert!(wanted.is_sorted() && wanted[0] == 1 && *wanted.last().unwrap() <= 100, "{wanted:?}");
        assert_eq!(wanted.len(), looks.known.len());
        // Without anything new the steps are longest.
        let still: Vec<f64> = (300..600).flat_map(|i| frame(&mut looks, f64::from(i) * 0.01, |_| Vec::new())).collect();
        assert!(still.len() < 20, "{still:?}");
        assert!(looks.requests(0.01).next().is_none() && looks.known.is_empty());
    }

    /// Regression: distant contents were requested when the steps had reached them, two or three frames late.
    #[test]
    fn path_begins_with_a_far_look() {
        let mut looks = PathLooks::default();
        // A slot is needed from a tenth of a second on.
        let at = |time_s: f64| if time_s >= 0.1 { requests([7]) } else { Vec::new() };
        let first = frame(&mut looks, 0.0, at);
        assert!(first.len() == 3 && first[..2] == [0.33, 0.01], "{first:?}");
        assert_eq!(looks.requests(0.01).map(|r| (r.slot.index, r.ahead_frames)).collect::<Vec<_>>(), [(7, 33)]);
        // Nearer looks find out when exactly.
        (1..4).for_each(|i| _ = frame(&mut looks, 0.01 * f64::from(i), at));
        assert!(looks.requests(0.01).any(|r| (7..15).contains(&r.ahead_frames)));
        // A path that jumps begins again.
        assert!(frame(&mut looks, -5.0, at)[0] > -4.7);
    }

    #[test]
    fn slot_found_by_a_nearer_look_is_wanted_sooner() {
        let mut looks = PathLooks::default();
        let moments = |looks: &PathLooks| -> Vec<(u32, u32)> {
            looks.requests(1.0).map(|request| (request.slot.index, request.ahead_frames)).collect()
        };
        looks.start_frame(0.0);
        assert_eq!(looks.found_at(10.0, &requests([7, 8])), 2);
        assert_eq!(looks.found_at(20.0, &requests([7, 9])), 1);
        assert_eq!(looks.found_at(2.0, &requests([7])), 1, "the expected time was too late");
        assert_eq!(moments(&looks), [(7, 2), (7, 10), (8, 10), (9, 20)]);
        // Moments pass in turn.
        looks.looked_s = 100.0;
        looks.start_frame(5.0);
        assert_eq!(looks.found_at(10.0, &requests([7, 8, 9])), 2, "again, and sooner than expected");
        looks.start_frame(15.0);
        assert_eq!(moments(&looks), [(9, 5)]);
    }

    #[test]
    fn missing_slot_is_requested_once_and_a_jump_forgets_it() {
        let mut looks = PathLooks::default();
        let mut frames = 0;
        for i in 0..50 {
            frame(&mut looks, f64::from(i) * 0.01, |_| requests([7]));
            let count = looks.requests(0.01).count();
            // Twice until the moment of the far look has passed.
            assert!(count <= if i < 34 { 2 } else { 1 }, "frame {i}");
            frames += count;
        }
        assert!(frames > 25, "{frames}: when its moment has passed, the frame requests it, and then the next look");
        looks.start_frame(0.495);
        frame(&mut looks, 0.5, |_| requests([7, 8]));
        assert!(looks.requests(0.01).next().is_some());
        looks.start_frame(-10.0);
        assert_eq!(looks.requests(0.01).count(), 0);
        assert!(looks.next(1.0, 0.01).is_some_and(|at_s| at_s < -9.0));
        // There is no look without frames, without time ahead, or for invalid numbers.
        for (ahead_s, frame_s) in [(0.0, 0.01), (1.0, 0.0), (f64::NAN, 0.01), (1.0, f64::NAN)] {
            assert_eq!(PathLooks::default().next(ahead_s, frame_s), None);
        }
        let mut looks = PathLooks::default();
        looks.start_frame(f64::NAN);
        assert_eq!(looks.next(1.0, 0.01), None);
    }
}
