//! Levels of detail of tile trees: fades between them, and stand-ins for failed tiles.

mod fade;
mod stand_ins;
