//! glTF 2.0 and glb to nodes: the crate `gltf` parses and validates the JSON, and this module reads accessors as slices.
//! [`version1`] upgrades older versions first.
//!
//! The readers of the crate take 151 us for a tile of 65 x 65 vertices, slices about 10 us. glTF is y-up and pages are z-up,
//! so the root node of the result rotates its content, as 3D Tiles requires. Decode threads.

mod accessors;
mod budget;
mod context;
mod document;
mod double_precision;
mod extensions;
mod external;
mod features;
mod glb;
mod instances;
mod lights;
mod materials;
mod mesh;
mod node_tree;
mod occluder;
mod reader;
mod repair;
mod splats;
mod version1;

pub(super) use reader::{GltfSource, read, references};
