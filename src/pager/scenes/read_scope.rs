//! [`ReadScope`]: the files and servers that the contents of a scene may read. It travels with its jobs to the threads.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use glam::DAffine3;

#[cfg(feature = "http")]
use super::shared_files::SharedFiles;
use crate::fetch::IoError;
#[cfg(feature = "http")]
use crate::fetch::{HttpClient, RootScope, server};
use crate::formats::ReadOptions;
use crate::math::Ellipsoid;
use crate::scene::BlockFormats;

/// The files and servers that the contents of a scene may read, and the client that asks servers.
#[derive(Debug)]
pub(in crate::pager) struct ReadScope {
    pub options: ReadOptions,
    /// Replaces the formats of the options for everything but roots.
    pub block_formats: Arc<SharedBlockFormats>,
    /// Reaches what the set may reach.
    #[cfg(feature = "http")]
    pub client: HttpClient,
    /// Reaches what each overlay may reach, by its server.
    #[cfg(feature = "http")]
    overlay_clients: Vec<(String, HttpClient)>,
    /// Files that several contents refer to.
    #[cfg(feature = "http")]
    pub shared_files: SharedFiles,
}

impl ReadScope {
    /// Creates a scope. `client` is the pager's, which reaches everything.
    pub fn new(
        options: ReadOptions,
        block_formats: Arc<SharedBlockFormats>,
        #[cfg(feature = "http")] client: &HttpClient,
    ) -> Self {
        Self {
            #[cfg(feature = "http")]
            client: client.within(&options.root),
            #[cfg(feature = "http")]
            overlay_clients: {
                let addresses = options.overlays.iter().flat_map(|set| set.remote_addresses());
                let client_of =
                    |address: String| (server(&address).to_owned(), client.within(&RootScope::of(&address)));
                addresses.map(client_of).collect()
            },
            options,
            block_formats,
            #[cfg(feature = "http")]
            shared_files: SharedFiles::default(),
        }
    }

    /// Returns true if an address is an image or a document of an overlay, which the application has named itself.
    #[cfg(feature = "http")]
    pub fn is_of_overlay(&self, uri: &str) -> bool {
        self.options.overlays.as_ref().is_some_and(|set| set.has_asked(uri))
    }

    /// Returns the client for what a content refers to. An overlay may be on a server that the set may not reach.
    #[cfg(feature = "http")]
    pub fn client_of(&self, uri: &str) -> &HttpClient {
        let mut of_overlays = self.overlay_clients.iter().filter(|_| self.is_of_overlay(uri));
        of_overlays.find(|(known, _)| known == server(uri)).map_or(&self.client, |(_, client)| client)
    }

    /// Returns a server of the overlays, if one is remote.
    #[cfg(feature = "http")]
    pub fn overlay_server(&self) -> Option<&str> {
        self.overlay_clients.first().map(|(server, _)| &**server)
    }

    /// Removes a remote file that could not be decoded from the HTTP cache if it is no content at all, such as an error
    /// page with status 200.
    pub fn forget_no_content(&self, error: &IoError) {
        #[cfg(feature = "http")]
        if error.is_no_content() && crate::fetch::is_remote(error.uri()) {
            self.shared_files.forget(error.uri());
            self.client.forget(error.uri());
        }
        #[cfg(not(feature = "http"))]
        let _ = error;
    }
}

/// The families of compressed formats that all contexts of a pager sample. Written by the update thread, read by decode
/// threads when they begin a content.
#[derive(Debug, Default)]
pub(in crate::pager) struct SharedBlockFormats(AtomicU8);

impl SharedBlockFormats {
    /// Returns the families. Relaxed: a page in formats of other contexts is recognized when it arrives.
    pub fn get(&self) -> BlockFormats {
        let bits = self.0.load(Ordering::Relaxed);
        BlockFormats { bc: bits & 1 != 0, etc2: bits & 2 != 0, astc: bits & 4 != 0 }
    }

    /// Sets the families.
    pub fn set(&self, formats: BlockFormats) {
        let BlockFormats { bc, etc2, astc } = formats;
        self.0.store(u8::from(bc) | u8::from(etc2) << 1 | u8::from(astc) << 2, Ordering::Relaxed);
    }
}

/// The tilesets above the contents of a page.
#[derive(Clone, Debug)]
pub(in crate::pager) struct TilesetAncestors {
    /// Their URIs, to detect cycles; empty if the page is not part of a tileset.
    pub chain: Arc<[Arc<str>]>,
    /// The product of the transforms of their tiles.
    pub set_from_page: DAffine3,
    /// The ellipsoid of the root.
    pub ellipsoid: Ellipsoid,
}

impl TilesetAncestors {
    /// Returns the ancestors of a page that is not part of a tileset.
    #[cfg(test)]
    pub fn none() -> Self {
        Self { chain: Arc::new([]), set_from_page: DAffine3::IDENTITY, ellipsoid: crate::math::WGS84 }
    }

    /// Returns the ancestors of the contents inside the tileset `uri`, which has these ancestors itself and lies on an ellipsoid.
    pub fn below(self, uri: &Arc<str>, ellipsoid: Ellipsoid) -> Self {
        let chain = self.chain.iter().cloned().chain([uri.clone()]).collect();
        Self { chain, ellipsoid, ..self }
    }
}
