//! DNS queries on one thread per host name.
//!
//! The system's resolver cannot be cancelled and may take half a minute. On the runtime's few blocking threads, unresponsive
//! DNS servers would delay all reads from the cache and the shutdown of the runtime.

use std::collections::HashMap;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use tokio::sync::oneshot;

type Addresses = Result<Vec<SocketAddr>, Arc<io::Error>>;

/// The queries in flight by host name, with the requests that wait for each. Locked briefly by the HTTP thread and by the
/// threads of the queries.
#[derive(Debug, Default)]
struct Queries(Mutex<HashMap<String, Vec<oneshot::Sender<Addresses>>>>);

impl Queries {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, Vec<oneshot::Sender<Addresses>>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn answer(&self, name: &str, addresses: &Addresses) {
        for sender in self.lock().remove(name).unwrap_or_default() {
            // Sending fails if the request was cancelled.
            let _ = sender.send(addresses.clone());
        }
    }
}

/// Resolves host names with the system's resolver.
#[derive(Debug)]
pub(super) struct DnsResolver {
    queries: Arc<Queries>,
    resolve: fn(&str) -> io::Result<Vec<SocketAddr>>,
}

impl Default for DnsResolver {
    fn default() -> Self {
        Self { queries: Arc::default(), resolve: |name| Ok((name, 0).to_socket_addrs()?.collect()) }
    }
}

impl DnsResolver {
    /// Starts a query, or joins the one in flight for the same name.
    fn query(&self, name: &str) -> oneshot::Receiver<Addresses> {
        let (sender, receiver) = oneshot::channel();
        let mut queries = self.queries.lock();
        let senders = queries.entry(name.to_owned()).or_default();
        senders.push(sender);
        let is_first = senders.len() == 1;
        drop(queries);
        if is_first {
            let (queries, resolve, of) = (self.queries.clone(), self.resolve, name.to_owned());
            let work = move || queries.answer(&of, &resolve(&of).map_err(Arc::new));
            // If no thread can be started, the query fails.
            if let Err(e) = std::thread::Builder::new().name("name look-up".to_owned()).spawn(work) {
                self.queries.answer(name, &Err(Arc::new(e)));
            }
        }
        receiver
    }
}

impl Resolve for DnsResolver {
    fn resolve(&self, name: Name) -> Resolving {
        let addresses = self.query(name.as_str());
        Box::pin(async move { Ok(Box::new(addresses.await??.into_iter()) as Addrs) })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::*;

    static QUERIES: AtomicUsize = AtomicUsize::new(0);
    type Gate = (Mutex<Sender<()>>, Mutex<Receiver<()>>);
    static GATE: LazyLock<Gate> = LazyLock::new(|| {
        let (sender, receiver) = channel();
        (sender.into(), receiver.into())
    });

    fn resolve(name: &str) -> io::Result<Vec<SocketAddr>> {
        QUERIES.fetch_add(1, Ordering::SeqCst);
        match name {
            "silent" => {
                GATE.1.lock().unwrap().recv().unwrap();
                Err(io::Error::other("no answer"))
            }
            _ => Ok(vec![([127, 0, 0, 1], 0).into()]),
        }
    }

    #[test]
    fn a_slow_name_delays_no_other_and_has_one_query_in_flight() {
        let resolver = DnsResolver { resolve, ..DnsResolver::default() };
        let silent: Vec<_> = (0..100).map(|_| resolver.query("silent")).collect();
        let answer = |query: oneshot::Receiver<Addresses>| query.blocking_recv().unwrap();
        assert_eq!(answer(resolver.query("there")).unwrap(), [([127, 0, 0, 1], 0).into()]);
        GATE.0.lock().unwrap().send(()).unwrap();
        assert!(silent.into_iter().all(|query| answer(query).unwrap_err().to_string() == "no answer"));
        assert_eq!(QUERIES.load(Ordering::SeqCst), 2);
        assert!(answer(resolver.query("there")).is_ok());
        assert_eq!(QUERIES.load(Ordering::SeqCst), 3, "results are not cached");
    }
}
