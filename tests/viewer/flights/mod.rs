//! Whole flights: no hole, and the same tiles each time; and views of other bodies than the earth.

mod bodies;
mod globe;
mod holes;
mod replay;
