//! Update and event callbacks of nodes, and of their drawables, state sets and uniforms. Called on the main thread, in the event
//! and update phases.
//!
//! A callback gets the scene, whose pages hold the callbacks: the only circle between files of this folder.

use std::any::Any;
use std::sync::{Arc, Mutex, PoisonError};

use crate::scene::graph::Scene;
use crate::scene::id::{NodeId, PageId};
use crate::state::{StateSet, UniformValue};

/// How a traversal continues after a node's callback.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Traverse {
    /// The callbacks below the node follow, as if it had called OSG's `traverse`.
    #[default]
    Below,
    /// The callbacks below the node, also in pages attached there, are left out this time.
    Skip,
}

/// The arguments of an update callback.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UpdateInfo {
    /// The frame number.
    pub frame: u32,
    /// Seconds since the first frame.
    pub reference_time_s: f64,
    /// Seconds of the application's time.
    pub simulation_time_s: f64,
}

/// A callback of a node, with arguments of type `I`; OSG's `NodeCallback`. Clones share the closure's state.
pub struct NodeCallback<I: ?Sized>(Arc<Mutex<OnNode<I>>>);

type OnNode<I> = dyn FnMut(&mut Scene, NodeId, &I) -> Traverse + Send;

/// A callback that is called for its node once a frame.
pub type UpdateCallback = NodeCallback<UpdateInfo>;

/// A callback that is called for its node once for each event; see `viewer::event_callback`, which knows the type of events.
pub type EventCallback = NodeCallback<dyn Any>;

impl<I: ?Sized + 'static> NodeCallback<I> {
    /// Creates a callback that may change the scene.
    pub fn new(call: impl FnMut(&mut Scene, NodeId, &I) -> Traverse + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(call)))
    }

    /// Creates a callback of one of a Geode's drawables, by its index among them, for the Geode; OSG's callback of a drawable.
    /// It gets the Geode and the index, as [`Scene::set_mesh`] takes them.
    pub fn on_drawable(drawable: usize, mut call: impl FnMut(&mut Scene, NodeId, usize, &I) + Send + 'static) -> Self {
        Self::new(move |scene, geode, info| {
            call(scene, geode, drawable, info);
            Traverse::Below
        })
    }

    /// Returns a callback that calls this one and then another one, unless this one leaves out what is below; OSG's nested
    /// callbacks.
    pub fn then(self, nested: Self) -> Self {
        Self::new(move |scene, node, info| match self.call(scene, node, info) {
            Traverse::Below => nested.call(scene, node, info),
            Traverse::Skip => Traverse::Skip,
        })
    }

    /// Calls the callback for its node. A callback that is running already (because it called the traversal itself), or that
    /// has panicked, is not called.
    pub(crate) fn call(&self, scene: &mut Scene, node: NodeId, info: &I) -> Traverse {
        self.0.try_lock().map_or(Traverse::Below, |mut call| call(scene, node, info))
    }
}

impl<I: ?Sized> Clone for NodeCallback<I> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<I: ?Sized> std::fmt::Debug for NodeCallback<I> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("NodeCallback")
    }
}

/// A state set of a page that callbacks change; OSG's callbacks of state sets and uniforms.
///
/// State sets are immutable once they are used, so each change replaces the last one by a new one, wherever the page uses
/// it. Clones are the same set. The callbacks belong to a node, usually the one that has the state set:
///
/// ```
/// # use terrane::scene::{CallbackStateSet, Node, UpdateInfo};
/// # use terrane::state::{StateSet, UniformValue};
/// let state = CallbackStateSet::new(StateSet::default().with_uniform("wind", UniformValue::Float(0.0)));
/// let mut trees = Node::group(vec![]).with_state_set(state.current());
/// trees.update_callback = Some(state.on_uniform("wind", |wind, info: &UpdateInfo| {
///     *wind = UniformValue::Float(info.simulation_time_s.sin() as f32);
/// }));
/// ```
#[derive(Clone, Debug)]
pub struct CallbackStateSet(Arc<Mutex<Arc<StateSet>>>);

impl CallbackStateSet {
    /// Takes a state set. One page may use it, in any number of nodes.
    pub fn new(state_set: StateSet) -> Self {
        Self(Arc::new(Mutex::new(Arc::new(state_set))))
    }

    /// Returns the present state set, to give it to nodes before their page is built.
    pub fn current(&self) -> Arc<StateSet> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Changes the state set where a page uses it, from the next cull on. Returns false, and changes nothing, if the page does
    /// not use it, for example because it was replaced by [`Scene::replace_state_set`].
    pub fn change(&self, scene: &mut Scene, page: PageId, change: impl FnOnce(&mut StateSet)) -> bool {
        let current = self.current();
        let mut changed = (*current).clone();
        change(&mut changed);
        if changed == *current {
            return scene.page(page).is_some_and(|page| page.has_state_set(&current));
        }
        let changed = Arc::new(changed);
        let is_used = scene.replace_state_set(page, &current, changed.clone());
        if is_used {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = changed;
        }
        is_used
    }

    /// Returns a callback for a node that changes the state set; OSG's callback of a state set.
    pub fn on_state_set<I: ?Sized + 'static>(
        &self,
        mut call: impl FnMut(&mut StateSet, &I) + Send + 'static,
    ) -> NodeCallback<I> {
        let state = self.clone();
        NodeCallback::new(move |scene, node, info| {
            state.change(scene, node.page, |set| call(set, info));
            Traverse::Below
        })
    }

    /// Returns a callback for a node that changes a uniform of the state set; OSG's callback of a uniform. It is not called
    /// while the state set has no uniform of the name.
    pub fn on_uniform<I: ?Sized + 'static>(
        &self,
        name: &str,
        mut call: impl FnMut(&mut UniformValue, &I) + Send + 'static,
    ) -> NodeCallback<I> {
        let name: Arc<str> = name.into();
        self.on_state_set(move |set, info| {
            if let Some((uniform, _)) = set.uniforms.iter_mut().find(|(uniform, _)| *uniform.name == *name) {
                call(&mut uniform.value, info);
            }
        })
    }
}
