//! [`Flights`]: equal requests at the same time are one request. HTTP thread.
//!
//! Several scenes, or several contents of a scene, may want the same URI. The first request asks; the others wait for its
//! answer, or its error. If the first one is dropped, because its content is no longer wanted, one that waits asks anew, so
//! that each lives as long as its own content is wanted.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::body::HttpBody;
use super::cache_access::CachePolicy;
use super::shared_read::SharedRead;
use crate::fetch::{IoError, Limits, RootScope};

/// The properties by which requests of one client are equal. All requests of a client carry the same credentials.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct FlightKey {
    pub uri: String,
    /// Another tile set may reach other servers.
    pub scope: Option<RootScope>,
    pub policy: CachePolicy,
    pub limits: Limits,
}

type Flight = Arc<SharedRead<HttpBody>>;

/// The requests of a client that are under way. Locked briefly.
#[derive(Debug, Default)]
pub(super) struct Flights(Mutex<HashMap<FlightKey, Flight>>);

impl Flights {
    /// Returns the answer to an equal request that is under way, or the answer that `ask` gives. Only the request that asked
    /// counts the bytes from the network.
    pub async fn get(
        &self,
        key: FlightKey,
        ask: impl AsyncFnOnce() -> Result<HttpBody, IoError>,
    ) -> Result<HttpBody, IoError> {
        let flight = self.lock().entry(key.clone()).or_default().clone();
        let mut has_asked = false;
        {
            let _leaves = Departure { flights: self, key: &key, flight: &flight };
            let ask = async || {
                has_asked = true;
                ask().await
            };
            flight.get_or_read(ask).await?;
        }
        // The body is copied only for requests that waited.
        let body = match Arc::try_unwrap(flight) {
            Ok(flight) => flight.into_value(),
            Err(flight) => flight.get().cloned(),
        };
        let body = body.expect("it has been read");
        Ok(if has_asked { body } else { HttpBody { network_bytes: 0, asked: false, ..body } })
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<FlightKey, Flight>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One request's part in a flight, until it has the answer or is dropped.
struct Departure<'a> {
    flights: &'a Flights,
    key: &'a FlightKey,
    flight: &'a Flight,
}

impl Drop for Departure<'_> {
    /// Ends the flight for later requests once it has an answer, or with its last request.
    fn drop(&mut self) {
        let mut flights = self.flights.lock();
        let is_current = flights.get(self.key).is_some_and(|current| Arc::ptr_eq(current, self.flight));
        // The map has one reference, and this request another.
        if is_current && (self.flight.is_done() || Arc::strong_count(self.flight) == 2) {
            flights.remove(self.key);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    fn key(uri: &str) -> FlightKey {
        FlightKey { uri: uri.to_owned(), scope: None, policy: CachePolicy::UseFresh, limits: Limits::default() }
    }

    fn body(text: &str) -> HttpBody {
        HttpBody { bytes: text.into(), network_bytes: 4, asked: true, ..HttpBody::default() }
    }

    #[test]
    fn equal_requests_are_one_and_later_ones_ask_again() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let (flights, asked) = (Flights::default(), AtomicU32::new(0));
        let ask = async || {
            asked.fetch_add(1, Ordering::Relaxed);
            tokio::task::yield_now().await;
            Ok(body("tile"))
        };
        let refuse = async || {
            asked.fetch_add(1, Ordering::Relaxed);
            tokio::task::yield_now().await;
            Err(IoError::NotFound { uri: "http://h/b".to_owned() })
        };
        runtime.block_on(async {
            let get = || flights.get(key("http://h/a"), ask);
            let (first, second, other) = tokio::join!(get(), get(), flights.get(key("http://h/b"), refuse));
            assert_eq!(first, Ok(body("tile")));
            assert_eq!(second, Ok(HttpBody { network_bytes: 0, asked: false, ..body("tile") }));
            assert!(other.is_err());
            assert_eq!(asked.load(Ordering::Relaxed), 2);
            let (first, second) = tokio::join!(flights.get(key("b"), refuse), flights.get(key("b"), refuse));
            assert!(first.is_err() && first == second);
            assert_eq!(asked.load(Ordering::Relaxed), 3);
            assert_eq!(get().await, Ok(body("tile")));
            let with_limits = FlightKey { limits: Limits { max_depth: 1, ..Limits::default() }, ..key("http://h/a") };
            let (first, second) = tokio::join!(get(), flights.get(with_limits, ask));
            assert!(first == second && asked.load(Ordering::Relaxed) == 6, "other limits are another request");
        });
        assert!(flights.lock().is_empty(), "nothing is kept");
    }

    #[test]
    fn waiting_request_takes_over_from_a_dropped_one() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let flights = Flights::default();
        runtime.block_on(async {
            let mut first = Box::pin(flights.get(key("a"), async || std::future::pending().await));
            let mut second = Box::pin(flights.get(key("a"), async || Ok(body("tile"))));
            tokio::select! {
                biased;
                _ = &mut first => panic!("it never has an answer"),
                _ = &mut second => panic!("it waits for the first"),
                () = tokio::task::yield_now() => {}
            }
            drop(first);
            assert_eq!(second.await, Ok(body("tile")));
            let alone = Box::pin(flights.get(key("a"), async || std::future::pending().await));
            tokio::select! {
                biased;
                _ = alone => panic!("it never has an answer"),
                () = tokio::task::yield_now() => {}
            }
        });
        assert!(flights.lock().is_empty(), "nothing is kept");
    }
}
