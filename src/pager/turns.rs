//! Who is to have the next place, so that nobody waits for another one's end. Update thread.
//!
//! [`Turns`]: of scenes.
//! Requests of all scenes are ordered by priority. A scene whose pictures ask for more and more, because its camera moves
//! on, say, would take all places for as long as what it asks for is the more urgent; so a scene that was passed over a few
//! times has the next place.
//!
//! [`LongWaits`]: of what was asked for. A view that moves on may ask for ever more that is more urgent than what another
//! view of the same scene lacks; so some places go to what was asked for longest ago.

use std::collections::{BTreeMap, VecDeque};

use crate::scene::{NodeId, SceneNumber};

/// A scene with something to load, or to merge, has one place of so many and one at least.
const PASSED_OVER: u32 = 4;

/// How often each scene was passed over.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns {
    behind: BTreeMap<SceneNumber, u32>,
}

impl Turns {
    /// So many places went to these scenes while those of `waiting` waited.
    pub fn took(&mut self, taken: &BTreeMap<SceneNumber, u32>, waiting: impl Iterator<Item = SceneNumber>) {
        let all: u32 = taken.values().sum();
        let mut behind = BTreeMap::new();
        for scene in waiting {
            let of_scene = || if taken.contains_key(&scene) { 0 } else { self.of(scene).saturating_add(all) };
            behind.entry(scene).or_insert_with(of_scene);
        }
        self.behind = behind;
    }

    fn of(&self, scene: SceneNumber) -> u32 {
        self.behind.get(&scene).copied().unwrap_or(0)
    }

    pub fn forget(&mut self, scene: SceneNumber) {
        self.behind.remove(&scene);
    }

    /// Puts what is ordered with the most urgent first so that no scene is passed over for long.
    pub fn arrange<T>(&self, ordered: Vec<T>, scene_of: impl Fn(&T) -> SceneNumber) -> Vec<T> {
        let first = ordered.first().map(&scene_of);
        if ordered.iter().all(|item| Some(scene_of(item)) == first) {
            return ordered;
        }
        let mut arranged = Vec::with_capacity(ordered.len());
        // Of each scene, what is left of its own with its place, and how often it was passed over.
        let mut queues: BTreeMap<SceneNumber, (VecDeque<(usize, T)>, u32)> = BTreeMap::new();
        for (place, item) in ordered.into_iter().enumerate() {
            let scene = scene_of(&item);
            let behind = self.of(scene);
            queues.entry(scene).or_insert_with(|| (VecDeque::new(), behind)).0.push_back((place, item));
        }
        loop {
            // The one that waits longest, if one has waited for long; else the most urgent.
            let turn = |(queue, behind): &(VecDeque<(usize, T)>, u32)| {
                let waited = if *behind >= PASSED_OVER { *behind } else { 0 };
                queue.front().map(|(place, _)| (std::cmp::Reverse(waited), *place))
            };
            let next = queues.iter().filter_map(|(scene, queue)| Some((turn(queue)?, *scene))).min();
            let Some((_, next)) = next else { return arranged };
            for (scene, (queue, behind)) in &mut queues {
                if *scene != next {
                    *behind += 1;
                } else if let Some((_, item)) = queue.pop_front() {
                    arranged.push(item);
                    *behind = 0;
                }
            }
        }
    }
}

/// Of so many places one goes to what waits longest.
const LONG_WAIT_SHARE: u32 = 8;
/// Once it was asked for in so many frames.
const LONG_WAIT_FRAMES: u32 = 120;

/// How many places have gone since the last that went to a long wait.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LongWaits {
    gone: u32,
}

impl LongWaits {
    /// So many places have gone.
    pub fn took(&mut self, places: u32) {
        self.gone = (self.gone % LONG_WAIT_SHARE + places % LONG_WAIT_SHARE) % LONG_WAIT_SHARE;
    }

    /// Puts what is ordered with the most urgent first so that what waits long has its share. `asked` is the frame in
    /// which something was asked for first, and what it was asked for.
    pub fn arrange<T: Copy>(&self, ordered: Vec<T>, frame: u32, asked: impl Fn(&T) -> (u32, NodeId)) -> Vec<T> {
        let waits_long = |item: &T| frame.saturating_sub(asked(item).0) > LONG_WAIT_FRAMES;
        let mut long: Vec<(usize, T)> =
            ordered.iter().copied().enumerate().filter(|(_, item)| waits_long(item)).collect();
        if long.is_empty() {
            return ordered;
        }
        long.sort_by_key(|(_, item)| asked(item));
        let mut long = long.into_iter();
        let mut urgent = ordered.iter().copied().enumerate();
        let mut has_place = vec![false; ordered.len()];
        let mut arranged = Vec::with_capacity(ordered.len());
        for place in self.gone.. {
            let is_turn = place % LONG_WAIT_SHARE == LONG_WAIT_SHARE - 1;
            let waits = is_turn.then(|| long.find(|(at, _)| !has_place[*at])).flatten();
            let Some((at, item)) = waits.or_else(|| urgent.find(|(at, _)| !has_place[*at])) else { break };
            has_place[at] = true;
            arranged.push(item);
        }
        arranged
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    fn scenes() -> [SceneNumber; 3] {
        let mut scenes = [(); 3].map(|()| Scene::new().number());
        scenes.sort();
        scenes
    }

    /// As many of each scene.
    fn items(counts: [usize; 3]) -> Vec<(SceneNumber, usize)> {
        let of = scenes();
        (0..3).flat_map(|s| (0..counts[s]).map(move |i| (of[s], i))).collect()
    }

    /// Places in an order of so many, of which those at `long` were asked for long ago, the last first.
    fn arranged(waits: LongWaits, count: u32, long: &[u32]) -> Vec<u32> {
        let page = Scene::new().add_root(crate::scene::Page::from_node(crate::scene::Node::group(Vec::new())).unwrap());
        let asked = |place: &u32| {
            let frame = if long.contains(place) { 1000 - place } else { 5000 };
            (frame, NodeId { page, index: *place })
        };
        waits.arrange((0..count).collect(), 5000, asked)
    }

    #[test]
    fn what_waits_long_has_every_eighth_place() {
        let all: Vec<u32> = (0..40).collect();
        assert_eq!(arranged(LongWaits::default(), 40, &[]), all);
        let arranged_all = arranged(LongWaits::default(), 40, &[25, 30, 35]);
        assert_eq!([7, 15, 23].map(|place: usize| arranged_all[place]), [35, 30, 25], "the longest first");
        assert_eq!(arranged_all[..7], all[..7], "the most urgent else");
        assert!(
            {
                let mut sorted = arranged_all;
                sorted.sort_unstable();
                sorted == all
            },
            "each once"
        );
        // Lists are written anew before a turn comes.
        let mut waits = LongWaits::default();
        let mut firsts = Vec::new();
        for _ in 0..16 {
            firsts.push(arranged(waits, 40, &[39])[0]);
            waits.took(1);
        }
        assert_eq!(firsts.iter().filter(|first| **first == 39).count(), 2, "{firsts:?}");
        // The last is among the urgent too.
        assert_eq!(arranged(LongWaits { gone: 7 }, 3, &[0, 1, 2]), [2, 0, 1]);
    }

    #[test]
    fn one_scene_is_in_its_order() {
        let items = items([50, 0, 0]);
        assert_eq!(Turns::default().arrange(items.clone(), |(scene, _)| *scene), items);
    }

    #[test]
    fn no_scene_waits_for_anothers_end() {
        let items = items([100, 10, 3]);
        let [busy, other, third] = [items[0].0, items[100].0, items[110].0];
        let arranged = Turns::default().arrange(items.clone(), |(scene, _)| *scene);
        assert_eq!(arranged.len(), 113);
        for scene in [busy, other, third] {
            let of: Vec<usize> = arranged.iter().filter(|(s, _)| *s == scene).map(|(_, i)| *i).collect();
            assert!(of.is_sorted(), "each in its own order");
        }
        let places = |of: SceneNumber| -> Vec<usize> {
            arranged.iter().enumerate().filter(|(_, (scene, _))| *scene == of).map(|(place, _)| place).collect()
        };
        assert_eq!(places(busy)[..4], [0, 1, 2, 3], "the more urgent first");
        for scene in [other, third] {
            let places = places(scene);
            assert!(places[0] <= 5 && places.windows(2).all(|two| two[1] - two[0] <= 6), "{places:?}");
        }
    }

    /// A list that is written anew before its first turn comes began with the same scene each time.
    #[test]
    fn what_was_passed_over_is_remembered() {
        let items = items([20, 5, 0]);
        let (busy, other) = (items[0].0, items[20].0);
        let mut turns = Turns::default();
        let mut firsts = Vec::new();
        for _ in 0..10 {
            let first = turns.arrange(items.clone(), |(scene, _)| *scene)[0].0;
            firsts.push(first);
            turns.took(&BTreeMap::from([(first, 1)]), items.iter().map(|(scene, _)| *scene));
        }
        assert_eq!(firsts.iter().filter(|scene| **scene == other).count(), 2, "{firsts:?}");
        assert_eq!(firsts[..5], [busy, busy, busy, busy, other]);
        // Who has nothing is not owed anything.
        turns.took(&BTreeMap::from([(busy, 9)]), [busy].into_iter());
        assert_eq!(turns.arrange(items, |(scene, _)| *scene)[0].0, busy);
    }
}
