//! The HTTP thread of an image pager: one client and one runtime, requests of all servers side by side.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Runtime;
use tokio::task::JoinSet;

use super::list::{Bytes, List};
use crate::io::{HttpClient, IoError, Limits};
use crate::timeline;

/// At the end, bodies on their way to the cache have so long.
const LAST_STORES: Duration = Duration::from_secs(2);

/// Runs until the list closes. Requests still under way are dropped then.
pub(super) fn run(runtime: &Runtime, list: &Arc<List>, client: &HttpClient, limits: &Limits) {
    runtime.block_on(async {
        let mut tasks: JoinSet<Bytes> = JoinSet::new();
        let mut uris = HashMap::new();
        while let Some(begun) = list.take_of_servers() {
            for uri in begun {
                let task = tasks.spawn(fetch(list.clone(), client.clone(), uri.clone(), *limits));
                uris.insert(task.id(), uri);
            }
            tokio::select! {
                () = list.http_bell.notified() => {}
                Some(done) = tasks.join_next_with_id(), if !tasks.is_empty() => {
                    let (task, bytes) = match done {
                        Ok((task, bytes)) => (task, Ok(bytes)),
                        Err(error) => (error.id(), Err(error)),
                    };
                    if let Some(uri) = uris.remove(&task) {
                        let panicked = |_| Some(Err(IoError::invalid(&uri, "the request panicked")));
                        let bytes = bytes.unwrap_or_else(panicked);
                        list.has_come(uri, bytes);
                    }
                }
            }
        }
        // What came is worth keeping, but nobody waits long for it.
        let _ = tokio::time::timeout(LAST_STORES, client.flush()).await;
    });
}

async fn fetch(list: Arc<List>, client: HttpClient, uri: Arc<str>, limits: Limits) -> Bytes {
    let _span = timeline::span_of("fetch image", || uri.clone());
    tokio::select! {
        body = client.get(&uri, &limits) => Some(body.map(|body| body.bytes)),
        () = list.is_given_up(&uri) => None,
    }
}
