//! Whole flights: no hole, and the same tiles each time.

mod holes;
mod replay;
