//! Leaves in draw order: the state graph that numbers their states, and the sort of the bins.

mod depth_keys;
mod sorter;
mod state_graph;

pub(super) use sorter::Sorter;
pub(super) use state_graph::{ROOT, StateGraph};
