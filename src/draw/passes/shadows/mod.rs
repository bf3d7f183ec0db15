//! The sun's shadows: the texture of the shadow maps, and the pass that draws casters into it. Draw thread.

pub(in crate::draw) mod casters;
mod maps;
