//! [`SceneTurns`]: merges that are fair between scenes. Update thread.
//!
//! Pages of all scenes are ordered by urgency; a scene whose camera moves would take all the time for as long as its pages
//! are more urgent. So a scene that was passed over a few times gets the next merge. The request list does the same with its
//! slots (`loading/waiting_jobs.rs`).

use std::cmp::Reverse;
use std::collections::{BTreeMap, VecDeque};

use crate::scene::SceneNumber;

/// A scene with requests gets the next slot after it was passed over this many times.
const MAX_PASSED_OVER: u32 = 4;

/// How often each scene was passed over.
#[derive(Clone, Debug, Default)]
pub(in crate::pager) struct SceneTurns {
    passed_over: BTreeMap<SceneNumber, u32>,
}

impl SceneTurns {
    /// Notes how many slots each scene took while the scenes of `waiting` had requests.
    pub fn took(&mut self, taken: &BTreeMap<SceneNumber, u32>, waiting: impl Iterator<Item = SceneNumber>) {
        let all: u32 = taken.values().sum();
        let mut passed_over = BTreeMap::new();
        for scene in waiting {
            let count = || if taken.contains_key(&scene) { 0 } else { self.count(scene).saturating_add(all) };
            passed_over.entry(scene).or_insert_with(count);
        }
        self.passed_over = passed_over;
    }

    fn count(&self, scene: SceneNumber) -> u32 {
        self.passed_over.get(&scene).copied().unwrap_or(0)
    }

    /// Forgets a scene that is no longer served.
    pub fn forget(&mut self, scene: SceneNumber) {
        self.passed_over.remove(&scene);
    }

    /// Reorders items, the most urgent first, so that no scene is passed over for long. Items of one scene keep their
    /// order.
    pub fn arrange<T>(&self, ordered: Vec<T>, scene_of: impl Fn(&T) -> SceneNumber) -> Vec<T> {
        let first = ordered.first().map(&scene_of);
        if ordered.iter().all(|item| Some(scene_of(item)) == first) {
            return ordered;
        }
        let mut arranged = Vec::with_capacity(ordered.len());
        // For each scene, its remaining items with their ranks, and how often it was passed over.
        let mut queues: BTreeMap<SceneNumber, (VecDeque<(usize, T)>, u32)> = BTreeMap::new();
        for (rank, item) in ordered.into_iter().enumerate() {
            let scene = scene_of(&item);
            let count = self.count(scene);
            queues.entry(scene).or_insert_with(|| (VecDeque::new(), count)).0.push_back((rank, item));
        }
        loop {
            // The scene that was passed over most often, if often enough; otherwise the one with the most urgent item.
            let turn = |(queue, count): &(VecDeque<(usize, T)>, u32)| {
                let overdue = if *count >= MAX_PASSED_OVER { *count } else { 0 };
                queue.front().map(|(rank, _)| (Reverse(overdue), *rank))
            };
            let next = queues.iter().filter_map(|(scene, queue)| Some((turn(queue)?, *scene))).min();
            let Some((_, next)) = next else { return arranged };
            for (scene, (queue, count)) in &mut queues {
                if *scene != next {
                    *count += 1;
                } else if let Some((_, item)) = queue.pop_front() {
                    arranged.push(item);
                    *count = 0;
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

    /// Returns this many items of each scene, numbered within it.
    fn items(counts: [usize; 3]) -> Vec<(SceneNumber, usize)> {
        let scenes = scenes();
        (0..3).flat_map(|s| (0..counts[s]).map(move |i| (scenes[s], i))).collect()
    }

    #[test]
    fn single_scene_keeps_its_order() {
        let items = items([50, 0, 0]);
        assert_eq!(SceneTurns::default().arrange(items.clone(), |(scene, _)| *scene), items);
    }

    #[test]
    fn no_scene_waits_for_the_end_of_another() {
        let items = items([100, 10, 3]);
        let [busy, other, third] = [items[0].0, items[100].0, items[110].0];
        let arranged = SceneTurns::default().arrange(items.clone(), |(scene, _)| *scene);
        assert_eq!(arranged.len(), 113);
        for scene in [busy, other, third] {
            let of: Vec<usize> = arranged.iter().filter(|(s, _)| *s == scene).map(|(_, i)| *i).collect();
            assert!(of.is_sorted(), "each scene in its own order");
        }
        let ranks = |of: SceneNumber| -> Vec<usize> {
            arranged.iter().enumerate().filter(|(_, (scene, _))| *scene == of).map(|(rank, _)| rank).collect()
        };
        assert_eq!(ranks(busy)[..4], [0, 1, 2, 3], "the more urgent first");
        for scene in [other, third] {
            let ranks = ranks(scene);
            assert!(ranks[0] <= 5 && ranks.windows(2).all(|two| two[1] - two[0] <= 6), "{ranks:?}");
        }
    }

    /// Regression: a list that was rewritten before its first turn began with the same scene each time.
    #[test]
    fn passed_over_scenes_are_remembered_between_lists() {
        let items = items([20, 5, 0]);
        let (busy, other) = (items[0].0, items[20].0);
        let mut turns = SceneTurns::default();
        let mut firsts = Vec::new();
        for _ in 0..10 {
            let first = turns.arrange(items.clone(), |(scene, _)| *scene)[0].0;
            firsts.push(first);
            turns.took(&BTreeMap::from([(first, 1)]), items.iter().map(|(scene, _)| *scene));
        }
        assert_eq!(firsts.iter().filter(|scene| **scene == other).count(), 2, "{firsts:?}");
        assert_eq!(firsts[..5], [busy, busy, busy, busy, other]);
        // A scene without requests is not owed a turn.
        turns.took(&BTreeMap::from([(busy, 9)]), [busy].into_iter());
        assert_eq!(turns.arrange(items, |(scene, _)| *scene)[0].0, busy);
    }
}
