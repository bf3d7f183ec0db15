//! The job of loading an image.

use std::sync::Arc;

#[cfg(feature = "http")]
use crate::fetch;
use crate::fetch::{IoError, Limits, Loaded};
use crate::formats::{self, Fetched};
use crate::pager::loading::job::LoadJob;
use crate::pager::loading::request::Request;
use crate::pager::loading::ticket::Ticket;
use crate::scene::Texture;
use crate::trace::{self, Span};

/// The limits and the client with which all images of a pager are read.
#[derive(Debug)]
pub(super) struct ImageReader {
    pub limits: Limits,
    #[cfg(feature = "http")]
    pub client: fetch::HttpClient,
}

/// One image to load.
#[derive(Clone, Debug)]
pub(super) struct ImageJob {
    ticket: Ticket,
    uri: Arc<str>,
    reader: Arc<ImageReader>,
    #[cfg(feature = "http")]
    servers: Arc<[String]>,
}

impl ImageJob {
    pub fn new(ticket: Ticket, uri: Arc<str>, reader: Arc<ImageReader>) -> Self {
        Self {
            ticket,
            #[cfg(feature = "http")]
            servers: Arc::new([fetch::server(&uri).to_owned()]),
            uri,
            reader,
        }
    }

    /// Returns the same job as a new attempt.
    pub fn again(&self, ticket: Ticket) -> Self {
        Self { ticket, ..self.clone() }
    }
}

impl Request for ImageJob {
    type Scene = ();

    fn ticket(&self) -> Ticket {
        self.ticket
    }

    fn uri(&self) -> &str {
        &self.uri
    }

    fn scene(&self) {}

    fn is_prefetch(&self) -> bool {
        false
    }

    fn set_prefetch(&mut self, _: bool) {}

    #[cfg(feature = "http")]
    fn servers(&self) -> &[String] {
        &self.servers
    }
}

impl LoadJob for ImageJob {
    type Content = Arc<Texture>;
    const THREAD_PREFIX: &'static str = "pager-image";

    fn address(&self) -> &Arc<str> {
        &self.uri
    }

    #[cfg(feature = "http")]
    fn client(&self) -> &fetch::HttpClient {
        &self.reader.client
    }

    fn read_span(&self) -> Span {
        trace::span_of("read image", || self.uri.clone())
    }

    #[cfg(feature = "http")]
    fn request_span(&self) -> Span {
        trace::span_of("fetch image", || self.uri.clone())
    }

    fn decode_span(&self) -> Span {
        trace::span_of("image", || self.uri.clone())
    }

    fn content_bytes(image: &Arc<Texture>) -> u64 {
        image.size_bytes()
    }

    fn decode(&self, loaded: Loaded, _companions: Vec<Fetched>) -> Result<Arc<Texture>, IoError> {
        formats::decode_image(&self.uri, &loaded.bytes, &self.reader.limits).inspect_err(|_error| {
            // The HTTP cache keeps nothing that is no image, such as an error page with status 200.
            #[cfg(feature = "http")]
            if _error.is_no_content() && fetch::is_remote(_error.uri()) {
                self.reader.client.forget(_error.uri());
            }
        })
    }
}
