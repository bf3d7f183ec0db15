//! [`Turns`]: which scene of a pager is to have the next place, so that none waits for another one's end. Update thread.
//!
//! Requests of all scenes are ordered by priority. A scene whose pictures ask for more and more, because its camera moves
//! on, say, would take all places for as long as what it asks for is the more urgent; so a scene that was passed over a few
//! times has the next place.

use std::collections::{BTreeMap, VecDeque};

use crate::scene::SceneNumber;

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
