//! DNS queries on one thread per host name, and [`PoolResolver`], which leaves out addresses that a pool may not connect to.
//!
//! The system's resolver cannot be cancelled and may take half a minute. On the runtime's few blocking threads, unresponsive
//! DNS servers would delay all reads from the cache and the shutdown of the runtime.

use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs as _};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use tokio::sync::oneshot;

use super::address::local_kind;

/// The addresses of a name, or the error of the resolver.
pub(super) type Addresses = Result<Vec<SocketAddr>, Arc<io::Error>>;

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
pub(in crate::fetch::http) struct DnsResolver {
    queries: Arc<Queries>,
    resolve: fn(&str) -> io::Result<Vec<SocketAddr>>,
}

impl Default for DnsResolver {
    fn default() -> Self {
        Self { queries: Arc::default(), resolve: |name| Ok((name, 0).to_socket_addrs()?.collect()) }
    }
}

impl DnsResolver {
    /// Creates a resolver that asks a function instead of the system.
    #[cfg(test)]
    pub fn new(resolve: fn(&str) -> io::Result<Vec<SocketAddr>>) -> Self {
        Self { resolve, ..Self::default() }
    }

    /// Starts a query, or joins the one in flight for the same name.
    pub(super) fn query(&self, name: &str) -> oneshot::Receiver<Addresses> {
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

/// The addresses that a pool of connections may lead to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reach {
    /// Addresses of the public internet.
    Public,
    /// All other addresses: private, loopback, link-local and so on.
    Local,
    Any,
}

impl Reach {
    fn contains(self, address: IpAddr) -> bool {
        self == Self::Any || local_kind(address).is_some() == (self == Self::Local)
    }
}

/// A name has only addresses that its pool must not connect to.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the {kind} address {address} is not allowed")]
pub(in crate::fetch::http) struct RefusedAddress {
    /// The first address.
    pub address: IpAddr,
    /// The kind of the address, such as `loopback`.
    pub kind: &'static str,
}

/// The resolver of one pool.
#[derive(Debug)]
pub(super) struct PoolResolver {
    pub dns: Arc<DnsResolver>,
    pub reach: Reach,
}

impl Resolve for PoolResolver {
    fn resolve(&self, name: Name) -> Resolving {
        let (addresses, reach) = (self.dns.query(name.as_str()), self.reach);
        Box::pin(async move {
            let all = addresses.await??;
            let allowed: Vec<SocketAddr> = all.iter().copied().filter(|at| reach.contains(at.ip())).collect();
            match all.first().map(SocketAddr::ip) {
                Some(address) if allowed.is_empty() => {
                    let kind = local_kind(address).unwrap_or("public");
                    Err(RefusedAddress { address, kind }.into())
                }
                _ => Ok(Box::new(allowed.into_iter()) as Addrs),
            }
        })
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
        let resolver = DnsResolver::new(resolve);
        let silent: Vec<_> = (0..100).map(|_| resolver.query("silent")).collect();
        let answer = |query: oneshot::Receiver<Addresses>| query.blocking_recv().unwrap();
        assert_eq!(answer(resolver.query("there")).unwrap(), [([127, 0, 0, 1], 0).into()]);
        GATE.0.lock().unwrap().send(()).unwrap();
        assert!(silent.into_iter().all(|query| answer(query).unwrap_err().to_string() == "no answer"));
        assert_eq!(QUERIES.load(Ordering::SeqCst), 2);
        assert!(answer(resolver.query("there")).is_ok());
        assert_eq!(QUERIES.load(Ordering::SeqCst), 3, "results are not cached");
    }

    #[test]
    fn pools_get_only_addresses_that_they_may_connect_to() {
        fn mixed(_: &str) -> io::Result<Vec<SocketAddr>> {
            Ok(vec![([10, 0, 0, 1], 0).into(), ([8, 8, 8, 8], 0).into(), ([127, 0, 0, 1], 0).into()])
        }
        let dns = Arc::new(DnsResolver::new(mixed));
        let addresses = |reach| {
            let resolver = PoolResolver { dns: dns.clone(), reach };
            let resolving = resolver.resolve("a.example".parse().unwrap());
            let found = pollster::block_on(resolving).unwrap();
            found.map(|at| at.ip().to_string()).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(addresses(Reach::Public), "8.8.8.8");
        assert_eq!(addresses(Reach::Local), "10.0.0.1 127.0.0.1");
        assert_eq!(addresses(Reach::Any), "10.0.0.1 8.8.8.8 127.0.0.1");
    }
}
