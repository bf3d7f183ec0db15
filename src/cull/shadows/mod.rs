//! Cascaded shadow maps of the sun: the casters of each cascade, and the projection of its map. Culling thread.
//!
//! An image with shadows has up to four cascades, each for a part of the depths that the eye sees. The scene is culled once
//! more for each: with the tiles, levels of detail and morphs of the image's own eye, so that what casts a shadow is
//! exactly what receives it. Only the frustum differs: a box along the sun's rays, open towards the sun. These culls
//! request no pages and keep none.

mod casters;
mod fit;
mod light;

pub(super) use light::ShadowLight;
