//! Requests through the disk cache: fresh entries are used, stale ones are revalidated, new answers are stored.

use std::sync::Arc;
use std::time::{Instant, SystemTime};

use reqwest::header::{ETAG, HeaderMap, HeaderName, HeaderValue, IF_MODIFIED_SINCE, IF_NONE_MATCH};

use super::body::{HttpBody, accept_all_encodings, content_encodings, decode_body};
use super::cache_access::{CachePolicy, HttpCache, Lookup, copy_validators};
use super::exchange::Answer;
use super::transport::Transport;
use crate::fetch::cache::Entry;
use crate::fetch::{IoError, Limits, shown};

/// Returns the content of a URI from the cache or from its server.
pub(super) async fn get(
    transport: &Transport,
    cache: &HttpCache,
    policy: CachePolicy,
    uri: &str,
    limits: &Limits,
) -> Result<HttpBody, IoError> {
    let permit = transport.permit();
    let entry = match cache.look_up(uri, policy, limits, permit).await? {
        Lookup::Fresh(entry, bytes) => return Ok(cache.hit(&entry, bytes, false)),
        Lookup::Miss if cache.disk().is_offline() => {
            cache.disk().count_miss();
            return Err(IoError::Offline { uri: uri.to_owned() });
        }
        Lookup::Miss => return download(transport, cache, uri, limits).await,
        Lookup::Stale(entry) => entry,
    };
    // The body is read while the answer is in flight.
    let (answer, cached) = tokio::join!(
        request(transport, cache, uri, Some(&entry), limits),
        cache.load_body(uri, &entry, limits, permit)
    );
    let not_modified = match answer? {
        Response::New(body) => return Ok(body),
        Response::NotModified(answer) => answer,
    };
    // The entry still holds, but its body is missing, or the server means another body.
    let Some(bytes) = cached?.filter(|_| !is_for_another_body(&entry, &not_modified.headers)) else {
        return download(transport, cache, uri, limits).await;
    };
    if !not_modified.freshness.store {
        cache.forget(uri).await;
        return Ok(cache.hit(&entry, bytes, true));
    }
    let mut renewed = entry.clone();
    renewed.checked(SystemTime::now(), Some(not_modified.freshness.after_revalidation(entry.fresh_for_s)));
    copy_validators(&mut renewed, &not_modified.headers);
    // The time of the check alone matters only for entries that are fresh for a while.
    let is_same = Entry { checked_s: entry.checked_s, ..renewed.clone() } == entry;
    if renewed.fresh_for_s > 0 || !is_same {
        cache.renew(uri, renewed).await;
    }
    Ok(cache.hit(&entry, bytes, true))
}

/// The result of a request that may have been conditional.
enum Response {
    New(HttpBody),
    /// The server confirmed the cached body (status 304).
    NotModified(Box<Answer>),
}

/// Requests a URI unconditionally and stores the answer.
async fn download(transport: &Transport, cache: &HttpCache, uri: &str, limits: &Limits) -> Result<HttpBody, IoError> {
    match request(transport, cache, uri, None, limits).await? {
        Response::New(body) => Ok(body),
        // Excluded: only a conditional request accepts status 304.
        Response::NotModified(answer) => Err(answer.error(uri)),
    }
}

/// Requests a URI, conditionally if it has a cached entry, and stores a new answer.
async fn request(
    transport: &Transport,
    cache: &HttpCache,
    uri: &str,
    cached: Option<&Entry>,
    limits: &Limits,
) -> Result<Response, IoError> {
    let requested_at = Instant::now();
    let mut headers = accept_all_encodings();
    cached.into_iter().for_each(|entry| add_validators(&mut headers, entry));
    let validated_at = cached.and_then(|entry| entry.redirected_to.as_deref());
    let answer = transport.exchange(uri, &headers, validated_at, limits).await?;
    let is_conditional = headers.contains_key(IF_NONE_MATCH) || headers.contains_key(IF_MODIFIED_SINCE);
    if answer.status == 304 && is_conditional {
        return Ok(Response::NotModified(Box::new(answer)));
    }
    if answer.is_no_content() {
        cache.remove_entry(uri).await;
        return Ok(Response::New(HttpBody::no_content()));
    }
    if !answer.is_whole() {
        return Err(answer.error(uri));
    }
    cache.disk().count_miss();
    let freshness = answer.freshness;
    let network_bytes = answer.body.len() as u64;
    let encodings = content_encodings(&answer.headers);
    let bytes = decode_body(uri, answer.body.clone(), encodings.clone(), limits, transport.permit()).await?;
    let location = answer.redirected_to.as_deref().map(Arc::from);
    if freshness.store {
        let mut entry = Entry { uri: shown(uri).into_owned(), encoding: encodings, ..Entry::default() };
        entry.redirected_to = answer.redirected_to;
        entry.checked(SystemTime::now(), freshness.fresh_for);
        copy_validators(&mut entry, &answer.headers);
        cache.store(uri, entry, answer.body, requested_at, transport.permit().budget()).await;
    } else {
        cache.remove_entry(uri).await;
    }
    Ok(Response::New(HttpBody { bytes, network_bytes, asked: true, location, is_no_content: false }))
}

/// Makes a request conditional on the validators of a cached entry.
fn add_validators(headers: &mut HeaderMap, entry: &Entry) {
    let mut set = |name: HeaderName, text: &Option<String>| {
        if let Some(value) = text.as_ref().and_then(|t| HeaderValue::from_str(t).ok()) {
            headers.insert(name, value);
        }
    };
    set(IF_NONE_MATCH, &entry.etag);
    set(IF_MODIFIED_SINCE, &entry.last_modified);
}

/// Returns true if "not modified" was sent for another body than the cached one (RFC 9111, 4.3.4). A date alone may fit
/// both.
fn is_for_another_body(cached: &Entry, headers: &HeaderMap) -> bool {
    fn opaque(tag: &str) -> &str {
        tag.strip_prefix("W/").unwrap_or(tag)
    }
    let received = headers.get(ETAG).and_then(|tag| tag.to_str().ok());
    matches!((&cached.etag, received), (Some(cached), Some(received)) if opaque(cached) != opaque(received))
}
