//! Google's Photorealistic 3D Tiles: a key in the query of each request. The first answer adds a session to the addresses
//! below it, which they inherit ([`resolve`](crate::fetch::resolve)).
//!
//! Source: the Map Tiles API reference, "3D Tiles".

use super::{ServiceKind, ServiceSource};
use crate::fetch::{Credential, IoError};

/// The address of the Map Tiles API.
pub const GOOGLE_SERVER: &str = "https://tile.googleapis.com";

/// Returns the source of Photorealistic 3D Tiles for a key of the Map Tiles API. `server` is [`GOOGLE_SERVER`], or one that
/// speaks the same protocol.
///
/// # Errors
/// Fails if `server` is no URL.
pub fn google_tiles(server: &str, key: &str) -> Result<ServiceSource, IoError> {
    let uri = format!("{}/v1/3dtiles/root.json", server.trim_end_matches('/'));
    let credentials = vec![Credential::query(&uri, "key", key)?];
    Ok(ServiceSource { kind: ServiceKind::Tiles, uri, credentials, attributions: vec!["Google".to_owned()] })
}
