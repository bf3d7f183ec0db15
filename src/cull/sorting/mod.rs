//! Leaves in draw order: the state graph that numbers their states, and the sort of the bins. Culling thread.
//!
//! During the traversal the [`StateGraph`] resolves each chain of state sets once. After it, the [`Sorter`] moves the leaves
//! into the bins of the stage, and sorts each bin by depth or by state as its state sets ask.

mod depth_keys;
mod sorter;
mod state_graph;

pub(super) use sorter::Sorter;
pub(super) use state_graph::{ROOT, StateGraph};
