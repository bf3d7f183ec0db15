//! Whole flights: no hole, and the same tiles each time.

mod globe;
mod holes;
mod replay;
