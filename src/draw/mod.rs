//! Draw.
mod x;
