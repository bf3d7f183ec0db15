//! Answers from the cache on disk: taken while they are fresh, asked about when they are not, kept when they are new.

use std::sync::Arc;
use std::time::SystemTime;

use reqwest::header::{ETAG, HeaderMap, HeaderName, HeaderValue, IF_MODIFIED_SINCE, IF_NONE_MATCH, LAST_MODIFIED};

use super::{HttpBody, HttpClient, accept_any, blocking, encodings};
use crate::io::cache::{Entry, Freshness};
use crate::io::{DiskCache, IoError, Limits, encoding, shown};

impl HttpClient {
    pub(super) async fn get_cached(
        &self,
        cache: &Arc<DiskCache>,
        uri: &str,
        limits: &Limits,
    ) -> Result<HttpBody, IoError> {
        let mut headers = accept_any();
        let kept = match self.load(cache, uri, limits).await? {
            Some((entry, bytes)) if cache.is_offline() || entry.is_fresh(SystemTime::now()) => {
                return Ok(hit(cache, &entry, bytes, false));
            }
            None if cache.is_offline() => {
                cache.count_miss();
                return Err(IoError::Offline { uri: uri.to_owned() });
            }
            kept => kept,
        };
        if let Some((entry, _)) = &kept {
            validate(&mut headers, entry);
        }
        let answer = self.exchange(uri, &headers, limits).await?;
        let freshness = Freshness::of(&answer.headers, SystemTime::now());
        if answer.status == 304
            && let Some((mut entry, bytes)) = kept
        {
            entry.checked(SystemTime::now(), freshness.fresh_for);
            keep_validators(&mut entry, &answer.headers);
            let (of, renewed) = (uri.to_owned(), entry.clone());
            self.write_behind(cache, move |cache| cache.try_renew(&of, &renewed)).await;
            return Ok(hit(cache, &entry, bytes, true));
        }
        if !answer.is_whole() {
            return Err(answer.error(uri));
        }
        cache.count_miss();
        let network_bytes = answer.body.len() as u64;
        let names = encodings(&answer.headers);
        let bytes = super::undo(uri, answer.body.clone(), names.clone(), limits).await?;
        if freshness.store {
            let mut entry = Entry { uri: shown(uri).into_owned(), encoding: names, ..Entry::default() };
            entry.checked(SystemTime::now(), freshness.fresh_for);
            keep_validators(&mut entry, &answer.headers);
            let of = uri.to_owned();
            self.write_behind(cache, move |cache| cache.store(&of, entry, &answer.body)).await;
        }
        Ok(HttpBody { bytes, network_bytes })
    }

    /// The content as it is kept, however old.
    pub(crate) async fn kept(&self, uri: &str, limits: &Limits) -> Option<Vec<u8>> {
        self.load(self.cache()?, uri, limits).await.ok()?.map(|(_, bytes)| bytes)
    }

    /// Something is kept of a URI.
    pub(crate) async fn is_kept(&self, uri: &str) -> bool {
        let Some(cache) = self.cache().cloned() else { return false };
        let of = uri.to_owned();
        blocking(uri, move || cache.has(&of)).await.unwrap_or(false)
    }

    /// What is kept of a URI, compression undone; what cannot be undone is dropped.
    pub(super) async fn load(
        &self,
        cache: &Arc<DiskCache>,
        uri: &str,
        limits: &Limits,
    ) -> Result<Option<(Entry, Vec<u8>)>, IoError> {
        let (cache, of, limits) = (cache.clone(), uri.to_owned(), *limits);
        blocking(uri, move || {
            let (entry, body) = cache.load(&of, &limits)?;
            match encoding::decode(&of, body, &entry.encoding, &limits) {
                Ok(bytes) => Some((entry, bytes)),
                Err(_) => {
                    cache.forget(&of);
                    None
                }
            }
        })
        .await
    }

    /// Writes on a thread that may wait, after the answer is on its way.
    pub(super) async fn write_behind(&self, cache: &Arc<DiskCache>, write: impl FnOnce(&DiskCache) + Send + 'static) {
        let Ok(permit) = self.inner.stores.clone().acquire_owned().await else { return };
        let cache = cache.clone();
        tokio::task::spawn_blocking(move || {
            write(&cache);
            drop(permit);
        });
    }
}

pub(super) fn hit(cache: &DiskCache, entry: &Entry, bytes: Vec<u8>, asked: bool) -> HttpBody {
    cache.count_hit(entry.size, asked);
    HttpBody { bytes, network_bytes: 0 }
}

fn validate(headers: &mut HeaderMap, entry: &Entry) {
    let mut set = |name: HeaderName, text: &Option<String>| {
        if let Some(value) = text.as_ref().and_then(|t| HeaderValue::from_str(t).ok()) {
            headers.insert(name, value);
        }
    };
    set(IF_NONE_MATCH, &entry.etag);
    set(IF_MODIFIED_SINCE, &entry.last_modified);
}

pub(super) fn keep_validators(entry: &mut Entry, headers: &HeaderMap) {
    let text = |name: HeaderName| headers.get(name).and_then(|v| v.to_str().ok()).map(str::to_owned);
    if let Some(etag) = text(ETAG) {
        entry.etag = Some(etag);
    }
    if let Some(date) = text(LAST_MODIFIED) {
        entry.last_modified = Some(date);
    }
}
