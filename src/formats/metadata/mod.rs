//! The parts of the 3D Metadata specification that tile trees depend on: schemas, and columns of numbers in property tables.

mod columns;
mod schema;

pub(super) use columns::NumberColumn;
pub(super) use schema::{Property, Schema};
