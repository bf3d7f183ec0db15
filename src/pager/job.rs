//! What is to be loaded, and what goes from thread to thread with it.

use std::sync::Arc;

use glam::DAffine3;

use super::scenes::Scope;
use super::states::Stage;
use crate::io::{Fetched, IoError};
#[cfg(feature = "http")]
use crate::io::{companions, server};
use crate::scene::{NodeId, Page};

/// One content to load.
#[derive(Clone, Debug)]
pub(super) struct Job {
    /// Names this load; an answer with another number is late.
    pub ticket: u64,
    pub slot: NodeId,
    pub uri: Arc<str>,
    pub reader_data: Option<Arc<str>>,
    /// Tilesets above.
    pub above: Above,
    /// Its scene's.
    pub scope: Arc<Scope>,
    /// Wanted later, when it was listed.
    pub is_ahead: bool,
    /// Where the threads are with it; clones of the job have the same.
    pub stage: Arc<Stage>,
}

#[cfg(feature = "http")]
impl Job {
    /// The servers that the content and what comes with it are asked of: the content's first, each once. For the HTTP
    /// thread alone.
    pub fn servers(&self) -> &[String] {
        self.stage.servers.get_or_init(|| {
            let mut servers = vec![server(&self.uri).to_owned()];
            for companion in companions(&self.uri, self.reader_data.as_ref()) {
                let of = server(&companion);
                if !servers.iter().any(|known| known == of) {
                    servers.push(of.to_owned());
                }
            }
            servers
        })
    }
}

/// The tilesets above what is in a page.
#[derive(Clone, Debug)]
pub(super) struct Above {
    /// Their URIs, for cycles; empty where the page is no tileset's.
    pub chain: Arc<[Arc<str>]>,
    /// The product of their tiles' transforms.
    pub set_from_page: DAffine3,
}

/// Bytes on their way to a decode worker.
pub(super) struct Loaded {
    pub job: Job,
    pub bytes: Result<Vec<u8>, IoError>,
    pub companions: Vec<Fetched>,
    pub bytes_read: u64,
    pub bytes_http: u64,
}

/// The answer to a job.
pub(super) struct Answer {
    pub job: Job,
    /// `None` when the job was aborted.
    pub page: Option<Result<Page, IoError>>,
    pub bytes_read: u64,
    pub bytes_http: u64,
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::sync::LazyLock;

    use crate::io::{Limits, ReadOptions};
    use crate::scene::{Node, PageId, Scene};

    static PAGE: LazyLock<PageId> =
        LazyLock::new(|| Scene::new().add_root(Page::from_node(Node::group(Vec::new())).unwrap()));
    static SCOPE: LazyLock<Arc<Scope>> = LazyLock::new(|| {
        Arc::new(Scope {
            options: ReadOptions::for_root("/set/tileset.json", Limits::default()),
            #[cfg(feature = "http")]
            client: crate::io::HttpClient::new(&crate::io::HttpConfig::default()).unwrap(),
        })
    });

    pub(in crate::pager) fn job(ticket: u64, uri: &str) -> Job {
        Job {
            ticket,
            slot: NodeId { page: *PAGE, index: ticket as u32 },
            scope: SCOPE.clone(),
            uri: uri.into(),
            reader_data: None,
            above: Above { chain: Arc::new([]), set_from_page: DAffine3::IDENTITY },
            is_ahead: false,
            stage: Arc::default(),
        }
    }
}
