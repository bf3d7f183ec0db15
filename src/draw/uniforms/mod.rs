//! The data that shaders read: mirrors of their structs, the buffers that hold them, and the bind groups. Draw thread.
//!
//! | bind group | contents | file |
//! |---|---|---|
//! | 0 | uniforms of frame and stage, leaves, air tables, shadow maps | [`frame_groups`] |
//! | 1 | a block of textures or heights | pools of [`gpu`](crate::gpu) |
//! | 2 | uniforms and textures of a state | [`state_groups`] |
//! | 3 | vertices and indices of pulled meshes | [`vertex_pulling`] |

pub(in crate::draw) mod air;
pub(in crate::draw) mod fixed;
pub(in crate::draw) mod frame;
pub(in crate::draw) mod frame_groups;
pub(in crate::draw) mod leaf_buffer;
pub(in crate::draw) mod stage;
pub(in crate::draw) mod state_groups;
pub(in crate::draw) mod vertex_pulling;
