//! data-gen.
