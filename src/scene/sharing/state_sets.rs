//! State sets and their textures: compared by content, shared by identity. Used by decode workers behind the manager's lock.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::{Arc, Weak};

use super::content_key::ContentKey;
use crate::state::{Attribute, StateSet, StateValue, TextureBinding, TextureObject};

/// The maximum number of sets with the same hash that are compared; further ones are not shared, so that hostile input
/// cannot make the search long.
const MAX_ALIKE: usize = 32;

/// State sets by a hash of their content and textures by key. Behind the manager's lock.
#[derive(Default)]
pub(super) struct States {
    sets: HashMap<u64, Vec<Weak<StateSet>>>,
    /// The number of sets in all lists of `sets`.
    set_count: u64,
    textures: HashMap<ContentKey, Weak<TextureObject>>,
}

/// Counters of one page's sharing.
#[derive(Debug, Default)]
pub(super) struct Shared {
    pub texture_hits: u64,
    pub set_hits: u64,
    pub pruned: u64,
}

/// Hashes what is written to it.
struct Text(DefaultHasher);

impl std::fmt::Write for Text {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

/// Returns a hash that is equal for equal sets with the same textures. Of programs only the names of uniforms are hashed;
/// the comparison distinguishes them.
pub(super) fn hash(set: &StateSet) -> u64 {
    let mut text = Text(DefaultHasher::new());
    let shown = write!(text, "{:?}{:?}{:?}{:?}", set.name, set.bin_value, set.color, set.modes);
    debug_assert!(shown.is_ok());
    set.bin.hash(&mut text.0);
    set.nest_bins.hash(&mut text.0);
    for (attribute, value) in &set.attributes {
        std::mem::discriminant(attribute).hash(&mut text.0);
        let shown = match attribute {
            Attribute::Texture(unit, binding) => {
                Arc::as_ptr(&binding.texture).hash(&mut text.0);
                write!(text, "{unit}{:?}{value:?}", binding.sampler)
            }
            Attribute::Program(_) => write!(text, "{value:?}"),
            other => write!(text, "{other:?}{value:?}"),
        };
        debug_assert!(shown.is_ok());
    }
    for (uniform, _) in &set.uniforms {
        uniform.name.hash(&mut text.0);
    }
    text.0.finish()
}

/// Returns the keys of a set's textures that may be shared, with their indices among its attributes. Reads every texel.
pub(super) fn texture_keys(set: &StateSet) -> Vec<(usize, ContentKey)> {
    let key = |(index, (attribute, _)): (usize, &(Attribute, StateValue))| match attribute {
        // Render targets and image sequences change, so their identity matters.
        Attribute::Texture(_, TextureBinding { texture, .. }) if !texture.texels.is_empty() && !texture.is_changing => {
            Some((index, texture_key(texture)))
        }
        _ => None,
    };
    set.attributes.iter().enumerate().filter_map(key).collect()
}

fn texture_key(texture: &TextureObject) -> ContentKey {
    let what = format!("{:?}{:?}{:?}{:?}", texture.name, texture.dimension, texture.size, texture.format);
    let levels = texture.levels.to_le_bytes();
    let mut parts: Vec<&[u8]> = vec![what.as_bytes(), &levels];
    parts.extend(texture.texels.iter().map(|t| &t[..]));
    ContentKey::of(&parts)
}

impl States {
    pub(super) fn len(&self) -> u64 {
        self.set_count + self.textures.len() as u64
    }

    pub(super) fn prune(&mut self) -> u64 {
        let before = self.len();
        self.textures.retain(|_, t| t.strong_count() > 0);
        self.set_count = 0;
        self.sets.retain(|_, alike| {
            alike.retain(|s| s.strong_count() > 0);
            self.set_count += alike.len() as u64;
            !alike.is_empty()
        });
        before - self.len()
    }

    /// Replaces a set by the first one that equals it. `hash` is the set's [`hash()`].
    pub(super) fn share(&mut self, set: &mut Arc<StateSet>, hash: u64, shared: &mut Shared) {
        let alike = self.sets.entry(hash).or_default();
        if let Some(known) = alike.iter().filter_map(Weak::upgrade).find(|known| **known == **set) {
            shared.set_hits += u64::from(!Arc::ptr_eq(&known, set));
            *set = known;
            return;
        }
        if alike.len() >= MAX_ALIKE {
            // Sets that were dropped must not use up the limit.
            let before = alike.len();
            alike.retain(|s| s.strong_count() > 0);
            let gone = (before - alike.len()) as u64;
            self.set_count -= gone;
            shared.pruned += gone;
        }
        if alike.len() < MAX_ALIKE {
            alike.push(Arc::downgrade(set));
            self.set_count += 1;
        }
    }

    /// Returns earlier textures that equal those of a set, with their indices among its attributes. `keys` are the set's
    /// [`texture_keys`].
    pub(super) fn known_textures(
        &mut self,
        set: &StateSet,
        keys: &[(usize, ContentKey)],
    ) -> Vec<(usize, Arc<TextureObject>)> {
        let mut others = Vec::new();
        for (index, key) in keys {
            let Some((Attribute::Texture(_, binding), _)) = set.attributes.get(*index) else { continue };
            let known = self.textures.entry(*key).or_default();
            match known.upgrade() {
                Some(known) if Arc::ptr_eq(&known, &binding.texture) => {}
                Some(known) => others.push((*index, known)),
                // Later sets find this texture.
                None => *known = Arc::downgrade(&binding.texture),
            }
        }
        others
    }
}

/// Returns a copy of a set with some textures replaced; other owners of the set keep its textures.
pub(super) fn with_textures(set: &StateSet, textures: Vec<(usize, Arc<TextureObject>)>) -> Arc<StateSet> {
    let mut shared = set.clone();
    for (index, texture) in textures {
        if let Some((Attribute::Texture(_, binding), _)) = shared.attributes.get_mut(index) {
            binding.texture = texture;
        }
    }
    Arc::new(shared)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pager::ImageSequence;
    use crate::scene::{Node, Page, Scene, ShareModes, SharedStateManager};
    use crate::state::{DataVariance, Mode, UniformValue};

    fn set(texel: u8, data_variance: DataVariance) -> StateSet {
        let texture = TextureObject::image("brick", [1, 1], vec![texel; 4]);
        StateSet { data_variance, ..StateSet::default() }
            .with(Attribute::Texture(0, TextureBinding::new(texture)))
            .with_mode(Mode::Lighting, StateValue::OFF)
    }

    fn page(manager: &SharedStateManager, set: StateSet) -> Page {
        let mut page = Page::from_node(Node::group(Vec::new()).with_state_set(Arc::new(set))).expect("one group");
        manager.share(&mut page);
        page
    }

    fn texture(page: &Page) -> &Arc<TextureObject> {
        match &page.state_sets()[0].attributes[0].0 {
            Attribute::Texture(_, binding) => &binding.texture,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn equal_sets_of_pages_are_one_and_replacing_one_leaves_the_other() {
        use DataVariance::{Dynamic, Static};
        let manager = SharedStateManager::new(ShareModes::default());
        let (a, b) = (page(&manager, set(7, Static)), page(&manager, set(7, Static)));
        assert!(Arc::ptr_eq(&a.state_sets()[0], &b.state_sets()[0]));
        let other = page(&manager, set(8, Static));
        assert!(!Arc::ptr_eq(&a.state_sets()[0], &other.state_sets()[0]));
        let stats = manager.stats();
        assert_eq!((stats.state_set_hits, stats.texture_hits, stats.entries), (1, 1, 4));

        let shared = a.state_sets()[0].clone();
        let mut scene = Scene::new();
        let [a, b] = [a, b].map(|page| scene.add_root(page));
        assert!(scene.replace_state_set(a, &shared, Arc::new(set(9, Static))));
        let kept = |id| scene.page(id).map(|p| p.state_sets()[0].clone());
        assert_eq!(kept(b).as_ref(), Some(&shared));
        assert_ne!(kept(a).as_ref(), Some(&shared));

        // A set that replaced two others is listed twice.
        let [first, second, both, last] = [1, 2, 3, 4].map(|k| Arc::new(set(k, Static)));
        let twice = Node::group(
            [&first, &second].map(|set| Node { state_set: Some(set.clone()), ..Node::group(vec![]) }).into(),
        );
        let twice = scene.add_root(Page::from_node(twice).unwrap());
        for (old, new) in [(&first, &both), (&second, &both), (&both, &last)] {
            assert!(scene.replace_state_set(twice, old, new.clone()));
        }
        let sets = scene.page(twice).unwrap().state_sets();
        assert!(sets.len() == 2 && sets.iter().all(|set| Arc::ptr_eq(set, &last)));
        assert!(!scene.replace_state_set(twice, &both, first.clone()));

        // Dynamic sets are not shared, but their textures are.
        let (c, d) = (page(&manager, set(7, Dynamic)), page(&manager, set(7, Dynamic)));
        assert!(!Arc::ptr_eq(&c.state_sets()[0], &d.state_sets()[0]) && Arc::ptr_eq(texture(&c), texture(&d)));
        let all = SharedStateManager::new(ShareModes::ALL);
        let (c, d) = (page(&all, set(7, Dynamic)), page(&all, set(7, Dynamic)));
        assert!(Arc::ptr_eq(&c.state_sets()[0], &d.state_sets()[0]));
        let none = SharedStateManager::new(ShareModes { textures: false, ..ShareModes::default() });
        let (e, f) = (page(&none, set(7, Static)), page(&none, set(7, Static)));
        assert!(!Arc::ptr_eq(texture(&e), texture(&f)));
    }

    #[test]
    fn targets_are_not_shared_and_dropped_sets_are_pruned() {
        let manager = SharedStateManager::new(ShareModes::ALL);
        let target = || {
            let target = TextureObject::target("mirror", [4, 4], Default::default());
            StateSet::default().with(Attribute::Texture(0, TextureBinding::new(target)))
        };
        let (a, b) = (page(&manager, target()), page(&manager, target()));
        assert!(!Arc::ptr_eq(texture(&a), texture(&b)));
        let kept = page(&manager, set(1, DataVariance::Static));
        drop((a, b));
        manager.prune_all();
        let stats = manager.stats();
        assert_eq!((stats.entries, stats.pruned), (2, 2), "a set and its texture are left");
        drop(kept);
        manager.prune_all();
        assert_eq!(manager.stats().entries, 0);
    }

    /// Regression: sequences of the same name showed the images of one of them.
    #[test]
    fn textures_of_image_sequences_are_never_shared() {
        let manager = SharedStateManager::new(ShareModes::ALL);
        let [a, b] = [(); 2].map(|()| {
            let shows = TextureBinding::new(ImageSequence::from_files("fire", ["0.png"]).texture());
            page(&manager, StateSet::default().with(Attribute::Texture(0, shows)))
        });
        assert!(!Arc::ptr_eq(texture(&a), texture(&b)) && !Arc::ptr_eq(&a.state_sets()[0], &b.state_sets()[0]));
        assert_eq!(manager.stats().texture_hits, 0);
    }

    #[test]
    fn dropped_sets_do_not_use_up_the_hash_limit() {
        let manager = SharedStateManager::new(ShareModes::default());
        // Only the names of uniforms are hashed.
        let alike = |n: f32| StateSet::default().with_uniform("height", UniformValue::Float(n));
        let kept = page(&manager, alike(-1.0));
        for n in 0..4 * MAX_ALIKE {
            drop(page(&manager, alike(n as f32)));
        }
        assert!(manager.stats().entries <= MAX_ALIKE as u64, "{:?}", manager.stats());
        let [a, b] = [0, 1].map(|_| page(&manager, alike(0.5)));
        assert!(Arc::ptr_eq(&a.state_sets()[0], &b.state_sets()[0]));
        let again = page(&manager, alike(-1.0));
        assert!(Arc::ptr_eq(&kept.state_sets()[0], &again.state_sets()[0]));
        manager.prune_all();
        let stats = manager.stats();
        assert_eq!((stats.entries, stats.pruned), (2, 4 * MAX_ALIKE as u64));
    }

    #[test]
    fn concurrent_workers_get_the_same_set() {
        let manager = SharedStateManager::new(ShareModes::default());
        for round in 0..50u8 {
            let barrier = std::sync::Barrier::new(4);
            let share = || {
                barrier.wait();
                [0, 1].map(|n| page(&manager, set(2 * round + n, DataVariance::Static)))
            };
            let pages: Vec<Page> = std::thread::scope(|scope| {
                let workers: Vec<_> = (0..4).map(|_| scope.spawn(share)).collect();
                workers.into_iter().flat_map(|w| w.join().expect("no panic")).collect()
            });
            for page in &pages[2..] {
                let alike = pages[..2].iter().filter(|p| Arc::ptr_eq(&p.state_sets()[0], &page.state_sets()[0]));
                assert_eq!(alike.count(), 1);
            }
            manager.prune_all();
            assert_eq!(manager.stats().entries, 4, "two sets and their textures");
        }
        manager.prune_all();
        assert_eq!(manager.stats().entries, 0);
    }
}
