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

#[cfg(test)]
mod tests {
    use super::super::list::Work;
    use super::*;

    #[test]
    fn each_server_has_its_places_and_files_need_none() {
        let list = List::new(2);
        let uris = ["http://b/1", "/files/2.png", "http://a/3", "/files/1.png", "http://a/2", "http://a/1"];
        list.lock().uris = uris.map(Arc::from).to_vec();
        let begun = || list.take_of_servers().unwrap().iter().map(|uri| uri.to_string()).collect::<Vec<_>>();
        assert_eq!(begun(), ["http://a/1", "http://a/2", "http://b/1"]);
        let read = || match list.take() {
            Some(Work::Read(uri)) => uri.to_string(),
            other => panic!("{other:?}"),
        };
        assert_eq!([read(), read()], ["/files/1.png", "/files/2.png"]);
        assert!(begun().is_empty());
        // Until it is taken up it has its place: what came is memory.
        let first = list.lock().taken[0].clone();
        list.has_come(first, Some(Ok(vec![1])));
        assert!(begun().is_empty());
        assert!(matches!(list.take(), Some(Work::Came(uri, Some(Ok(_)))) if &*uri == "http://a/1"));
        assert_eq!(begun(), ["http://a/3"]);
        assert!(list.lock().uris.is_empty() && list.lock().taken.len() == 6);
        list.close();
        assert!(list.take_of_servers().is_none() && list.take().is_none());
    }
}
