//! Answers from the cache on disk: taken while they are fresh, asked about when they are not, kept when they are new.

use std::sync::Arc;
use std::time::{Instant, SystemTime};

use reqwest::header::{ETAG, HeaderMap, HeaderName, HeaderValue, IF_MODIFIED_SINCE, IF_NONE_MATCH, LAST_MODIFIED};

use super::exchange::Answer;
use super::{HttpBody, HttpClient, accept_any, blocking, encodings};
use crate::io::cache::Entry;
use crate::io::{DiskCache, IoError, Limits, encoding, shown};

/// What the disk has of a URI.
enum Kept {
    /// To be taken without asking.
    Fresh(Entry, Vec<u8>),
    /// To be asked about; the body is read while the answer is on its way.
    Stale(Entry),
    Nothing,
}

impl HttpClient {
    pub(super) async fn get_cached(
        &self,
        cache: &Arc<DiskCache>,
        uri: &str,
        limits: &Limits,
    ) -> Result<HttpBody, IoError> {
        let entry = match self.look_up(cache, uri, limits).await? {
            Kept::Fresh(entry, bytes) => return Ok(hit(cache, &entry, bytes, false)),
            Kept::Nothing if cache.is_offline() => {
                cache.count_miss();
                return Err(IoError::Offline { uri: uri.to_owned() });
            }
            Kept::Nothing => return self.get_new(cache, uri, None, limits).await.map(|(body, _)| body),
            Kept::Stale(entry) => entry,
        };
        let (answer, kept) =
            tokio::join!(self.get_new(cache, uri, Some(&entry), limits), body_of(cache, uri, &entry, limits));
        let (body, not_modified) = answer?;
        let Some(not_modified) = not_modified else { return Ok(body) };
        // It holds, but it is gone; or what holds is another one.
        let Some(bytes) = kept?.filter(|_| !is_of_another(&entry, &not_modified.headers)) else {
            return self.get_new(cache, uri, None, limits).await.map(|(body, _)| body);
        };
        if !not_modified.freshness.store {
            // It is no longer to be kept.
            let of = uri.to_owned();
            self.write_behind(cache, move |cache| cache.forget(&of)).await;
            return Ok(hit(cache, &entry, bytes, true));
        }
        let mut renewed = entry.clone();
        renewed.checked(SystemTime::now(), Some(not_modified.freshness.of_kept(entry.fresh_for_s)));
        keep_validators(&mut renewed, &not_modified.headers);
        // When it was checked matters only to what is fresh for a while.
        let says_the_same = Entry { checked_s: entry.checked_s, ..renewed.clone() } == entry;
        if renewed.fresh_for_s > 0 || !says_the_same {
            let of = uri.to_owned();
            self.write_behind(cache, move |cache| cache.try_renew(&of, &renewed)).await;
        }
        Ok(hit(cache, &entry, bytes, true))
    }

    /// Asks the server, about what is kept where something is, and keeps what comes; with the answer instead of a body
    /// where it says that the kept one holds.
    async fn get_new(
        &self,
        cache: &Arc<DiskCache>,
        uri: &str,
        kept: Option<&Entry>,
        limits: &Limits,
    ) -> Result<(HttpBody, Option<Answer>), IoError> {
        let asked = Instant::now();
        let mut headers = accept_any();
        kept.into_iter().for_each(|entry| validate(&mut headers, entry));
        let validated_at = kept.and_then(|entry| entry.redirected_to.as_deref());
        let answer = self.exchange(uri, &headers, validated_at, limits).await?;
        let was_asked = headers.contains_key(IF_NONE_MATCH) || headers.contains_key(IF_MODIFIED_SINCE);
        if answer.status == 304 && was_asked {
            return Ok((HttpBody::default(), Some(answer)));
        }
        if !answer.is_whole() {
            return Err(answer.error(uri));
        }
        cache.count_miss();
        let freshness = answer.freshness;
        let network_bytes = answer.body.len() as u64;
        let names = encodings(&answer.headers);
        let bytes = super::undo(uri, answer.body.clone(), names.clone(), limits).await?;
        if freshness.store {
            let mut entry = Entry { uri: shown(uri).into_owned(), encoding: names, ..Entry::default() };
            entry.redirected_to = answer.redirected_to;
            entry.checked(SystemTime::now(), freshness.fresh_for);
            keep_validators(&mut entry, &answer.headers);
            let of = uri.to_owned();
            self.write_behind(cache, move |cache| cache.store(&of, entry, &answer.body, asked)).await;
        } else {
            self.leave_out(cache, uri).await;
        }
        Ok((HttpBody { bytes, network_bytes, asked: true }, None))
    }

    async fn look_up(&self, cache: &Arc<DiskCache>, uri: &str, limits: &Limits) -> Result<Kept, IoError> {
        let (client, cache, of, limits) = (self.clone(), cache.clone(), uri.to_owned(), *limits);
        blocking(uri, move || {
            let Some(entry) = cache.entry(&of) else { return Kept::Nothing };
            if !client.takes(&cache, &entry) {
                return Kept::Stale(entry);
            }
            match read_body(&cache, &of, &entry, &limits) {
                Some(bytes) => Kept::Fresh(entry, bytes),
                None => Kept::Nothing,
            }
        })
        .await
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

    /// What is kept of a URI, however old, compression undone.
    pub(super) async fn load(
        &self,
        cache: &Arc<DiskCache>,
        uri: &str,
        limits: &Limits,
    ) -> Result<Option<(Entry, Vec<u8>)>, IoError> {
        let (cache, of, limits) = (cache.clone(), uri.to_owned(), *limits);
        blocking(uri, move || {
            let entry = cache.entry(&of)?;
            let bytes = read_body(&cache, &of, &entry, &limits)?;
            Some((entry, bytes))
        })
        .await
    }

    /// A new answer is not to be kept, and what is kept of before holds no longer.
    pub(super) async fn leave_out(&self, cache: &Arc<DiskCache>, uri: &str) {
        let of = uri.to_owned();
        self.write_behind(cache, move |cache| cache.leave_out(&of)).await;
    }

    /// Writes on a thread that may wait, after the answer is on its way.
    pub(super) async fn write_behind(&self, cache: &Arc<DiskCache>, write: impl FnOnce(&DiskCache) + Send + 'static) {
        let Ok(permit) = self.inner.writes.clone().acquire_owned().await else { return };
        let cache = cache.clone();
        tokio::task::spawn_blocking(move || {
            write(&cache);
            drop(permit);
        });
    }
}

async fn body_of(
    cache: &Arc<DiskCache>,
    uri: &str,
    entry: &Entry,
    limits: &Limits,
) -> Result<Option<Vec<u8>>, IoError> {
    let (cache, of, entry, limits) = (cache.clone(), uri.to_owned(), entry.clone(), *limits);
    blocking(uri, move || read_body(&cache, &of, &entry, &limits)).await
}

/// The body of an entry, compression undone; what cannot be undone is dropped.
fn read_body(cache: &DiskCache, uri: &str, entry: &Entry, limits: &Limits) -> Option<Vec<u8>> {
    let body = cache.body(uri, entry, limits)?;
    let bytes = encoding::decode(uri, body, &entry.encoding, limits);
    if bytes.is_err() {
        cache.forget(uri);
    }
    bytes.ok()
}

pub(super) fn hit(cache: &DiskCache, entry: &Entry, bytes: Vec<u8>, asked: bool) -> HttpBody {
    cache.count_hit(entry.size, asked);
    HttpBody { bytes, network_bytes: 0, asked }
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

/// "Not modified" that is said of another body than the kept one (RFC 9111, 4.3.4): a date alone may fit both.
fn is_of_another(kept: &Entry, headers: &HeaderMap) -> bool {
    fn opaque(tag: &str) -> &str {
        tag.strip_prefix("W/").unwrap_or(tag)
    }
    let told = headers.get(ETAG).and_then(|tag| tag.to_str().ok());
    matches!((&kept.etag, told), (Some(kept), Some(told)) if opaque(kept) != opaque(told))
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
