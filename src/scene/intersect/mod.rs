//! Intersections: where lines and volumes meet what the scene shows, after osgUtil's intersectors.
//!
//! Everything takes `&Scene`: any thread that may read the scene may ask. What a page keeps for it is a [`KdTree`] for
//! each drawable, built by decode workers where
//! [`ReadOptions::build_kd_trees`](crate::io::ReadOptions::build_kd_trees) says so.

mod kd_tree;
mod primitives;

pub use kd_tree::KdTree;
