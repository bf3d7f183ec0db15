//! Styles of the 3D Tiles Styling language, version 1.0: which features of tiles are shown, in which colour, and how large
//! points are.
//!
//! [`Style`] is parsed once, by the application. Decode threads evaluate it for each feature of a content and change the
//! drawables: a style costs nothing in a frame.

mod apply;
mod colors;
mod error;
mod expression;
mod functions;
mod look;
mod looks;
mod parser;
#[expect(clippy::module_inception, reason = "the folder is named after its type")]
mod style;
mod subject;
mod text;
mod value;

pub(super) use apply::{Styled, apply};
pub use error::StyleError;
pub use style::Style;
