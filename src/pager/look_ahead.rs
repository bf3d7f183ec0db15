//! [`PathLooks`]: when to look ahead along a path that is known, and what is wanted there. Main thread.
//!
//! Looks go along the path, each a step after the last, up to some time ahead of the picture; what a look found is
//! wanted until its moment comes. Steps are as long as pictures are alike: while looks find much that the ones before
//! did not, steps halve, and while they find little, they grow. A path begins with a look far along it: over a slow
//! network what is wanted there cannot wait until looks have come so far.

use std::collections::{HashMap, VecDeque};

use crate::cull::PageRequest;
use crate::scene::NodeId;

/// Looks in one frame at most, besides the far one: the first ones catch up with the time ahead.
const LOOKS_A_FRAME: u32 = 2;
/// Requests kept of a look, the most urgent.
const MOST_REQUESTS: usize = 128;
/// A look that finds more than so many new ones was too far from the last.
const MANY: usize = 8;
/// A step is not longer than this share of the time ahead.
const LONGEST_STEP: f64 = 1.0 / 3.0;

/// Looks ahead along a path.
#[derive(Debug, Default)]
pub struct PathLooks {
    /// The picture's time at the last frame.
    now_s: f64,
    /// Up to where was looked.
    looked_s: f64,
    step_s: f64,
    /// The far look of the beginning was made.
    has_begun: bool,
    /// The time of the look that was given last.
    at_s: f64,
    /// What looks found, by their time: what others had not found, or for later.
    found: VecDeque<(f64, Vec<PageRequest>)>,
    /// The earliest time of each.
    known: HashMap<NodeId, f64>,
    looks_in_frame: u32,
}

impl PathLooks {
    /// Goes on to the frame at a time of the path, seconds, and forgets looks whose moment has come. A time that goes
    /// back, or beyond all looks, starts anew.
    pub fn start_frame(&mut self, now_s: f64) {
        let goes_on = now_s >= self.now_s && now_s <= self.looked_s;
        if !goes_on {
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

    /// The time of the path to look from now, if there is one: not farther than `ahead_s` from the frame's time, where a
    /// frame takes `frame_s`. To be asked again after [`Self::found`].
    pub fn next(&mut self, ahead_s: f64, frame_s: f64) -> Option<f64> {
        if !(ahead_s > 0.0 && frame_s > 0.0) || self.looks_in_frame >= LOOKS_A_FRAME {
            return None;
        }
        let longest_s = ahead_s * LONGEST_STEP;
        self.step_s = self.step_s.min(longest_s).max(frame_s);
        let is_far = !std::mem::replace(&mut self.has_begun, true) && longest_s > self.step_s;
        let next_s = self.looked_s + if is_far { longest_s } else { self.step_s };
        // As pictures will be: between two of them others may be wanted.
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

    /// Takes what a picture would lack at the time that [`Self::next`] gave.
    pub fn found(&mut self, requests: &[PageRequest]) {
        let count = self.found_at(self.at_s, requests);
        if self.at_s > self.looked_s {
            return;
        }
        self.step_s *= if count > MANY { 0.5 } else { 1.5 };
    }

    /// Takes what a picture would lack at any time; how much of it is new. What was thought to be wanted later is
    /// wanted sooner.
    pub(super) fn found_at(&mut self, at_s: f64, requests: &[PageRequest]) -> usize {
        let is_new = |r: &&PageRequest| self.known.get(&r.slot).is_none_or(|known_s| at_s < *known_s);
        let mut new: Vec<PageRequest> = requests.iter().filter(is_new).copied().collect();
        new.sort_unstable_by(|a, b| b.priority.total_cmp(&a.priority));
        new.truncate(MOST_REQUESTS);
        self.known.extend(new.iter().map(|request| (request.slot, at_s)));
        let (place, count) = (self.found.partition_point(|(found_s, _)| *found_s <= at_s), new.len());
        self.found.insert(place, (at_s, new));
        count
    }

    /// Looks again from the frame's time on, where the path has become another; what was found stays wanted until its
    /// moment.
    pub(super) fn look_anew(&mut self) {
        self.looked_s = self.now_s;
    }

    /// The same, with a far look as at a path's beginning.
    pub(crate) fn begin_anew(&mut self) {
        self.look_anew();
        self.has_begun = false;
    }

    /// What will be wanted, where a frame takes `frame_s`.
    pub fn requests(&self, frame_s: f64) -> impl Iterator<Item = PageRequest> {
        self.found.iter().flat_map(move |(at_s, found)| {
            let frames = frames_until(at_s - self.now_s, frame_s);
            found.iter().map(move |request| request.ahead(frames))
        })
    }
}

/// Whole frames of so many seconds, one at least.
pub fn frames_until(seconds: f64, frame_s: f64) -> u32 {
    (seconds / frame_s).ceil().clamp(1.0, 1e6) as u32
}

#[cfg(test)]
mod tests {
    use super::super::job::tests::job;
    use super::*;

    /// Slots of one page.
    fn requests(slots: impl IntoIterator<Item = u32>) -> Vec<PageRequest> {
        let page = job(0, "").slot.page;
        let request =
            |index| PageRequest { slot: NodeId { page, index }, priority: 1.0, error_px: 1.0, ahead_frames: 0 };
        slots.into_iter().map(request).collect()
    }

    /// A frame at a time; each look finds what `at` says. The times that were looked at.
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
    fn looks_are_close_where_much_is_new_and_rare_where_nothing_is() {
        // Each hundredth of a second wants ten others.
        let busy = |time_s: f64| {
            let first = (time_s * 100.0).round() as u32 * 10;
            requests(first..first + 10)
        };
        let mut looks = PathLooks::default();
        let mut times = Vec::new();
        for i in 0..300 {
            times.extend(frame(&mut looks, f64::from(i) * 0.01, busy));
            let last = times.last().unwrap();
            // After the far one.
            assert!(times[1..].is_sorted() && *last <= f64::from(i) * 0.01 + 1.0);
        }
        assert!(times.windows(2).skip(40).all(|w| w[1] - w[0] < 0.011), "{times:?}");
        assert!(*times.last().unwrap() > 3.9, "as far ahead as may be");
        // In the order of need, each once, none that is past.
        let wanted: Vec<u32> = looks.requests(0.01).map(|r| r.ahead_frames).collect();
        assert!(wanted.is_sorted() && wanted[0] == 1 && *wanted.last().unwrap() <= 100, "{wanted:?}");
        assert_eq!(wanted.len(), looks.known.len());
        // Nothing new: the longest steps.
        let still: Vec<f64> = (300..600).flat_map(|i| frame(&mut looks, f64::from(i) * 0.01, |_| Vec::new())).collect();
        assert!(still.len() < 20, "{still:?}");
        assert!(looks.requests(0.01).next().is_none() && looks.known.is_empty());
    }

    /// They were asked for when steps had come so far, two or three frames late.
    #[test]
    fn a_path_begins_with_a_far_look() {
        let mut looks = PathLooks::default();
        // What comes a tenth of a second on stays.
        let at = |time_s: f64| if time_s >= 0.1 { requests([7]) } else { Vec::new() };
        let first = frame(&mut looks, 0.0, at);
        assert!(first.len() == 3 && first[..2] == [0.33, 0.01], "{first:?}");
        assert_eq!(looks.requests(0.01).map(|r| (r.slot.index, r.ahead_frames)).collect::<Vec<_>>(), [(7, 33)]);
        // The nearer looks say when.
        (1..4).for_each(|i| _ = frame(&mut looks, 0.01 * f64::from(i), at));
        assert!(looks.requests(0.01).any(|r| (7..15).contains(&r.ahead_frames)));
        // No path that goes on begins, one that jumps does.
        assert!(frame(&mut looks, -5.0, at)[0] > -4.7);
    }

    #[test]
    fn what_is_found_nearer_is_wanted_sooner() {
        let mut looks = PathLooks::default();
        let moments = |looks: &PathLooks| -> Vec<(u32, u32)> {
            looks.requests(1.0).map(|request| (request.slot.index, request.ahead_frames)).collect()
        };
        looks.start_frame(0.0);
        assert_eq!(looks.found_at(10.0, &requests([7, 8])), 2);
        assert_eq!(looks.found_at(20.0, &requests([7, 9])), 1);
        assert_eq!(looks.found_at(2.0, &requests([7])), 1, "what was guessed was too late");
        assert_eq!(moments(&looks), [(7, 2), (7, 10), (8, 10), (9, 20)]);
        // Its moment passes, and those of the others when they come.
        looks.looked_s = 100.0;
        looks.start_frame(5.0);
        assert_eq!(looks.found_at(10.0, &requests([7, 8, 9])), 2, "again, and sooner than was thought");
        looks.start_frame(15.0);
        assert_eq!(moments(&looks), [(9, 5)]);
    }

    #[test]
    fn what_stays_missing_is_asked_for_once_and_a_jump_forgets_it() {
        let mut looks = PathLooks::default();
        let mut frames = 0;
        for i in 0..50 {
            frame(&mut looks, f64::from(i) * 0.01, |_| requests([7]));
            let count = looks.requests(0.01).count();
            // Twice while the far look of the beginning is not past.
            assert!(count <= if i < 34 { 2 } else { 1 }, "frame {i}");
            frames += count;
        }
        assert!(frames > 25, "{frames}: when its moment has come, the picture asks, and then the next look");
        looks.start_frame(0.495);
        frame(&mut looks, 0.5, |_| requests([7, 8]));
        assert!(looks.requests(0.01).next().is_some());
        looks.start_frame(-10.0);
        assert_eq!(looks.requests(0.01).count(), 0);
        assert!(looks.next(1.0, 0.01).is_some_and(|at_s| at_s < -9.0));
        // No frames, no time ahead, no numbers.
        for (ahead_s, frame_s) in [(0.0, 0.01), (1.0, 0.0), (f64::NAN, 0.01), (1.0, f64::NAN)] {
            assert_eq!(PathLooks::default().next(ahead_s, frame_s), None);
        }
        let mut looks = PathLooks::default();
        looks.start_frame(f64::NAN);
        assert_eq!(looks.next(1.0, 0.01), None);
    }
}
