//! State sets and their textures: compared by content, shared by identity.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::{Arc, Weak};

use super::key::ContentKey;
use super::manager::ShareModes;
use crate::state::{Attribute, DataVariance, StateSet, TextureObject};

/// Sets of one hash that are compared; more are left alone, so that nobody can make looking long.
const MOST_ALIKE: usize = 32;

/// State sets by a hash of their content and textures by key. Behind the manager's lock.
#[derive(Default)]
pub(super) struct States {
    sets: HashMap<u64, Vec<Weak<StateSet>>>,
    textures: HashMap<ContentKey, Weak<TextureObject>>,
}

/// Hashes what is written to it.
struct Text(DefaultHasher);

impl std::fmt::Write for Text {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

/// Equal for equal sets. Programs count by their uniforms' names only: comparing tells them apart.
fn hash(set: &StateSet) -> u64 {
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

fn texture_key(texture: &TextureObject) -> ContentKey {
    let what = format!("{:?}{:?}{:?}{:?}", texture.name, texture.dimension, texture.size, texture.format);
    let levels = texture.levels.to_le_bytes();
    let mut parts: Vec<&[u8]> = vec![what.as_bytes(), &levels];
    parts.extend(texture.texels.iter().map(|t| &t[..]));
    ContentKey::of(&parts)
}

impl States {
    pub(super) fn len(&self) -> u64 {
        self.sets.values().map(|s| s.len() as u64).sum::<u64>() + self.textures.len() as u64
    }

    pub(super) fn prune(&mut self) -> u64 {
        let before = self.len();
        self.textures.retain(|_, t| t.strong_count() > 0);
        self.sets.retain(|_, alike| {
            alike.retain(|s| s.strong_count() > 0);
            !alike.is_empty()
        });
        before - self.len()
    }

    /// Puts the set that was there first in the place of an equal one.
    pub(super) fn share(
        &mut self,
        set: &mut Arc<StateSet>,
        modes: &ShareModes,
        texture_hits: &mut u64,
        set_hits: &mut u64,
    ) {
        if modes.textures {
            self.share_textures(set, texture_hits);
        }
        let is_wanted = match set.data_variance {
            DataVariance::Static => modes.static_state_sets,
            DataVariance::Dynamic => modes.dynamic_state_sets,
        };
        if !is_wanted {
            return;
        }
        let alike = self.sets.entry(hash(set)).or_default();
        if let Some(known) = alike.iter().filter_map(Weak::upgrade).find(|known| **known == **set) {
            *set_hits += u64::from(!Arc::ptr_eq(&known, set));
            *set = known;
        } else if alike.len() < MOST_ALIKE {
            alike.push(Arc::downgrade(set));
        }
    }

    fn share_textures(&mut self, set: &mut Arc<StateSet>, hits: &mut u64) {
        let mut others = Vec::new();
        for (place, (attribute, _)) in set.attributes.iter().enumerate() {
            let Attribute::Texture(_, binding) = attribute else { continue };
            // Targets are drawn into: which one it is matters.
            if binding.texture.texels.is_empty() {
                continue;
            }
            let known = self.textures.entry(texture_key(&binding.texture)).or_insert_with(|| {
                // Found again by those that come later.
                Arc::downgrade(&binding.texture)
            });
            match known.upgrade() {
                Some(known) if Arc::ptr_eq(&known, &binding.texture) => {}
                Some(known) => others.push((place, known)),
                None => *known = Arc::downgrade(&binding.texture),
            }
        }
        if others.is_empty() {
            return;
        }
        *hits += others.len() as u64;
        // A copy: whoever else holds the set keeps its textures.
        let mut shared = (**set).clone();
        for (place, texture) in others {
            if let Some((Attribute::Texture(_, binding), _)) = shared.attributes.get_mut(place) {
                binding.texture = texture;
            }
        }
        *set = Arc::new(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Node, Page, Scene, ShareModes, SharedStateManager};
    use crate::state::{Mode, StateValue, TextureBinding};

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
        match &page.state_sets[0].attributes[0].0 {
            Attribute::Texture(_, binding) => &binding.texture,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn equal_sets_of_pages_are_one_and_replacing_one_leaves_the_other() {
        use DataVariance::{Dynamic, Static};
        let manager = SharedStateManager::new(ShareModes::default());
        let (a, b) = (page(&manager, set(7, Static)), page(&manager, set(7, Static)));
        assert!(Arc::ptr_eq(&a.state_sets[0], &b.state_sets[0]));
        let other = page(&manager, set(8, Static));
        assert!(!Arc::ptr_eq(&a.state_sets[0], &other.state_sets[0]));
        let stats = manager.stats();
        assert_eq!((stats.state_set_hits, stats.texture_hits, stats.entries), (1, 1, 4));

        let shared = a.state_sets[0].clone();
        let mut scene = Scene::new();
        let [a, b] = [a, b].map(|page| scene.add_root(page));
        assert!(scene.replace_state_set(a, &shared, Arc::new(set(9, Static))));
        let kept = |id| scene.page(id).map(|p| p.state_sets[0].clone());
        assert_eq!(kept(b).as_ref(), Some(&shared));
        assert_ne!(kept(a).as_ref(), Some(&shared));

        // Sets that change are not shared, their textures are.
        let (c, d) = (page(&manager, set(7, Dynamic)), page(&manager, set(7, Dynamic)));
        assert!(!Arc::ptr_eq(&c.state_sets[0], &d.state_sets[0]) && Arc::ptr_eq(texture(&c), texture(&d)));
        let all = SharedStateManager::new(ShareModes::ALL);
        let (c, d) = (page(&all, set(7, Dynamic)), page(&all, set(7, Dynamic)));
        assert!(Arc::ptr_eq(&c.state_sets[0], &d.state_sets[0]));
        let none = SharedStateManager::new(ShareModes { textures: false, ..ShareModes::default() });
        let (e, f) = (page(&none, set(7, Static)), page(&none, set(7, Static)));
        assert!(!Arc::ptr_eq(texture(&e), texture(&f)));
    }

    #[test]
    fn targets_are_never_shared_and_what_is_gone_is_forgotten() {
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
}
