//! [`event_callback`]: wraps a closure on events into a node's callback.

use crate::scene::{EventCallback, NodeId, Scene, Traverse};
use crate::viewer::events::GuiEventAdapter;

/// Creates an event callback of a node, for [`Node::event_callback`](crate::scene::Node::event_callback).
pub fn event_callback(
    mut call: impl FnMut(&mut Scene, NodeId, &GuiEventAdapter) -> Traverse + Send + 'static,
) -> EventCallback {
    EventCallback::new(move |scene, node, event| {
        event.downcast_ref().map_or(Traverse::Below, |event| call(scene, node, event))
    })
}
