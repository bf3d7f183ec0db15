//! [`PathLooks`]: when to look ahead along a path that is known, and what is wanted there. Main thread.
//!
//! Looks go along the path, each a step after the last, up to some time ahead of the picture; what a look found is
//! wanted until its moment comes. Steps are as long as pictures are alike: while looks find much that the ones before
//! did not, steps halve, and while they find little, they grow.

use std::collections::{HashMap, VecDeque};

use crate::cull::PageRequest;
use crate::scene::NodeId;

/// Looks in one frame at most: the first ones catch up with the time ahead.
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
            self.looked_s = now_s;
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
        self.step_s = self.step_s.min(ahead_s * LONGEST_STEP).max(frame_s);
        let next_s = self.looked_s + self.step_s;
        (next_s <= self.now_s + ahead_s).then(|| {
            self.looks_in_frame += 1;
            self.looked_s = next_s;
            next_s
        })
    }

    /// Takes what a picture would lack at the time that [`Self::next`] gave.
    pub fn found(&mut self, requests: &[PageRequest]) {
        let count = self.found_at(self.looked_s, requests);
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
    use super::*;
    use crate::scene::{Node, Page, Scene};

    fn requests(slots: impl IntoIterator<Item = u32>) -> Vec<PageRequest> {
        let page = Scene::new().add_root(Page::from_node(Node::group(Vec::new())).unwrap());
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
            assert!(times.is_sorted() && *last <= f64::from(i) * 0.01 + 1.0);
        }
        assert!(times.windows(2).skip(10).all(|w| w[1] - w[0] < 0.011), "{times:?}");
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
            assert!(count <= 1, "frame {i}");
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
