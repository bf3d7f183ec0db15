//! Styles of the 3D Tiles Styling language.

mod contents;
mod language;
mod pixels;
