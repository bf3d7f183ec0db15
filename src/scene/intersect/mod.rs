//! Intersections: where lines and volumes meet what the scene shows, after osgUtil's intersectors.
//!
//! Everything takes `&Scene`: any thread that may read the scene may ask. What a page keeps for it is a [`KdTree`] for
//! each drawable, built by decode workers where
//! [`ReadOptions::build_kd_trees`](crate::io::ReadOptions::build_kd_trees) says so.
//!
//! ```text
//! IntersectionVisitor   the nodes, tiles and drawables whose bounds the shape meets, nearest first    walk
//!   -> KdTree           of each drawable, in its own frame, by the positions that are drawn            kd_tree
//!     -> Intersection   node path, drawable, primitive, point, normal                                  visitor
//! ```
//!
//! Shapes are given in the world, or at places of a picture ([`WindowView`]); only the latter meet what other
//! projections draw into it.
//!
//! A [`HeightQuery`] answers threads that do not hold the scene.

mod height_query;
mod intersection;
mod kd_tree;
mod line;
mod polytope;
mod primitives;
mod probe;
mod selection;
mod surface;
mod visitor;
mod walk;
mod window;

pub use height_query::{GroundPoint, GroundSnapshot, HeightQuery, Vertical};
pub use intersection::{Intersection, IntersectionLimit, Intersector};
pub use kd_tree::KdTree;
pub use line::{LineSegmentIntersector, RayIntersector};
pub use polytope::{Dimensions, PolytopeIntersector};
pub use selection::{EyePoint, LodSelection};
pub use visitor::IntersectionVisitor;
pub use window::WindowView;
