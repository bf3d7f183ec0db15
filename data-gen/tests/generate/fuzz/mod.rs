//! Fuzzed readers of everything that the generator reads. `tools/fuzz` runs these parsers as well.

mod places;
mod rasters;
