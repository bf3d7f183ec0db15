//! `terrane bench`: the engine's parts on the scenes of the peer programs, with their field names.

pub mod cull;
