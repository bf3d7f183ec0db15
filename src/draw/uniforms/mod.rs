//! What shaders read besides leaves: mirrors of their structs, the buffer they lie in, bind groups. Draw thread.

pub(in crate::draw) mod fixed;
pub(in crate::draw) mod frame;
pub(in crate::draw) mod groups;
pub(in crate::draw) mod pulls;
