//! The pagers' types in the draw thread's commands.

use std::sync::Arc;

pub use terrane::pager::CompileContext;
use terrane::scene::Texture;
use terrane::state::TextureObject;

pub struct ImageChange {
    pub texture: Arc<TextureObject>,
    pub image: Arc<Texture>,
}
