//! Bounds, frusta, rays, geodesy, colour conversion and random numbers: plain values for every thread and every stage of
//! the frame.
//!
//! World positions are `f64`; values per node are stored as `f32`, relative to a page's frame.

mod bounds;
pub mod color;
mod depth;
mod frustum;
mod geodesy;
mod horizon_point;
mod projection;
pub mod random;
mod ray;
mod surface_parts;

pub use bounds::{Aabb, BoundingSphere, BoundingVolume, OrientedBox, Region};
pub(crate) use bounds::{max_scale, surface_box};
pub use depth::distance_of_depth;
pub use frustum::Frustum;
pub use geodesy::{Ellipsoid, Geodetic, MARS, MOON, RadiiError, WGS84};
pub(crate) use horizon_point::horizon_point;
pub use projection::TransverseMercator;
pub use ray::Ray;
pub(crate) use ray::slab;
pub(crate) use surface_parts::{PartTest, SurfacePart};
