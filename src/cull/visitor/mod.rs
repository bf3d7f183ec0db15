//! The traversal of the scene: from a camera to the leaves, requests and positioned state of a render stage. Culling thread.
//!
//! [`CullVisitor`] runs one [`Traversal`] per stage. A traversal takes pages from the queue and scans the nodes of each:
//!
//! | file | content |
//! |---|---|
//! | `cull_visitor`, `cameras` | the culls of a frame, and those of the cameras in the graph |
//! | `traversal` | the state of one cull, and the visits of pages |
//! | `nodes`, `drawables`, `rare_nodes`, `camera_nodes` | the steps of a traversal, by kind of node |
//! | `page_queue`, `page_context` | the pages to visit, and the page under scan |
//! | `page_states`, `matrices` | the states and matrices of leaves |
//! | `near_far`, `camera_queue` | what is completed after the scan |

mod camera_nodes;
mod camera_queue;
mod cameras;
mod cull_visitor;
mod drawables;
mod matrices;
mod near_far;
mod nodes;
mod page_context;
mod page_queue;
mod page_states;
mod rare_nodes;
mod traversal;

pub(super) use camera_queue::{CameraVisit, NestedCamera};
pub use cull_visitor::CullVisitor;
pub(super) use page_context::{cull_info, eye_in};
pub(super) use page_queue::{AttachmentFrame, PageVisit, Purpose, QueuedPage};
pub(super) use traversal::Traversal;
