//! Update and event callbacks of nodes. Called on the main thread, in the event and update phases.
//!
//! A callback gets the scene, whose pages hold the callbacks: the only circle between files of this folder.

use std::any::Any;
use std::sync::{Arc, Mutex};

use crate::scene::graph::Scene;
use crate::scene::id::NodeId;

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

type OnUpdate = dyn FnMut(&mut Scene, NodeId, &UpdateInfo) -> Traverse + Send;
type OnEvent = dyn FnMut(&mut Scene, NodeId, &dyn Any) -> Traverse + Send;

/// A callback that the traversal can call through a shared reference. A callback that is running already (because it
/// called the traversal itself), or that has panicked, is not called.
pub(crate) trait Call<I: ?Sized>: Clone {
    /// Calls the callback for its node.
    fn call(&self, scene: &mut Scene, node: NodeId, info: &I) -> Traverse;
}

/// A closure that is called for its node once a frame. Clones share the closure's state.
#[derive(Clone)]
pub struct UpdateCallback(Arc<Mutex<OnUpdate>>);

impl UpdateCallback {
    /// Creates a callback that may change the scene.
    pub fn new(call: impl FnMut(&mut Scene, NodeId, &UpdateInfo) -> Traverse + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(call)))
    }
}

/// A closure that is called for its node once for each event; see `viewer::event_callback`, which knows the type of events.
#[derive(Clone)]
pub struct EventCallback(Arc<Mutex<OnEvent>>);

impl EventCallback {
    /// Creates a callback that receives events of any type.
    pub fn new(call: impl FnMut(&mut Scene, NodeId, &dyn Any) -> Traverse + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(call)))
    }
}

impl Call<UpdateInfo> for UpdateCallback {
    fn call(&self, scene: &mut Scene, node: NodeId, info: &UpdateInfo) -> Traverse {
        self.0.try_lock().map_or(Traverse::Below, |mut call| call(scene, node, info))
    }
}

impl Call<dyn Any> for EventCallback {
    fn call(&self, scene: &mut Scene, node: NodeId, info: &dyn Any) -> Traverse {
        self.0.try_lock().map_or(Traverse::Below, |mut call| call(scene, node, info))
    }
}

impl std::fmt::Debug for UpdateCallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("UpdateCallback")
    }
}

impl std::fmt::Debug for EventCallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("EventCallback")
    }
}
