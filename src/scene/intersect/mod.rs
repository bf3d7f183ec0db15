//! Intersections of lines and volumes with everything the scene shows, after osgUtil's intersectors.
//!
//! Everything takes `&Scene`, so any thread that may read the scene can intersect it. Pages keep a [`KdTree`] for each
//! drawable if [`ReadOptions::build_kd_trees`](crate::formats::ReadOptions::build_kd_trees) is set; decode workers build them.
//!
//! ```text
//! IntersectionVisitor   the nodes, tiles and drawables whose bounds the shape meets, nearest first    walk
//!   -> KdTree           of each drawable, in its own frame, by the positions that are drawn            kd_tree
//!     -> Intersection   node path, drawable, primitive, point, normal                                  visitor
//! ```
//!
//! Shapes are given in the world, or at positions of a camera's image ([`WindowView`]); only the latter meet what other
//! projections draw into the image.
//!
//! A [`HeightQuery`] answers queries of threads that do not hold the scene.

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
