//! Services that ask for a key: Cesium ion and Google's Photorealistic 3D Tiles. They say where a tile set is, which
//! credentials its requests carry, and whom to name beside it. Calls block; they are made before a set is opened.

mod google;
mod ion;

pub use google::{GOOGLE_SERVER, google_tiles};
#[cfg(feature = "testing")]
pub use ion::fuzz_ion_endpoint;
pub use ion::{ION_SERVER, IonAsset};

use super::Credential;

/// The kind of data that a service offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServiceKind {
    /// A tile set: 3D Tiles.
    Tiles,
    /// Terrain: the address of a layer.json.
    Terrain,
    /// Imagery: the folder of a tile map (TMS).
    Imagery,
}

/// The address of a service's data, and the credentials of its requests.
#[derive(Clone, Debug)]
pub struct ServiceSource {
    /// The kind of the data.
    pub kind: ServiceKind,
    /// Its URL.
    pub uri: String,
    /// The credentials of its requests, for [`HttpConfig::credentials`](super::HttpConfig::credentials).
    pub credentials: Vec<Credential>,
    /// The names of its owners, as plain text, which the terms of services ask to be shown.
    pub attributions: Vec<String>,
}
