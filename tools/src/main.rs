//! terrane.
fn main() {}
