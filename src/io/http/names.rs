//! Looking up servers' names: on a thread for each name that is being looked up, and none that others wait for.
//!
//! The system's look-up cannot be given up and may take half a minute. On the runtime's few threads that may wait, some
//! silent name servers would hold up everything that is read from the cache, and the runtime's end.

use std::collections::HashMap;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use tokio::sync::oneshot;

type Found = Result<Vec<SocketAddr>, Arc<io::Error>>;

/// Names that are being looked up, with those who wait for each. Taken for moments.
#[derive(Debug, Default)]
struct Waiting(Mutex<HashMap<String, Vec<oneshot::Sender<Found>>>>);

impl Waiting {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, Vec<oneshot::Sender<Found>>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn answer(&self, name: &str, found: &Found) {
        for sender in self.lock().remove(name).unwrap_or_default() {
            // Given up meanwhile.
            let _ = sender.send(found.clone());
        }
    }
}

/// The system's look-up.
#[derive(Debug)]
pub(super) struct Names {
    waiting: Arc<Waiting>,
    look_up: fn(&str) -> io::Result<Vec<SocketAddr>>,
}

impl Default for Names {
    fn default() -> Self {
        Self { waiting: Arc::default(), look_up: |name| Ok((name, 0).to_socket_addrs()?.collect()) }
    }
}

impl Names {
    /// Waits with whoever asked for the same name before.
    fn ask(&self, name: &str) -> oneshot::Receiver<Found> {
        let (sender, receiver) = oneshot::channel();
        let mut names = self.waiting.lock();
        let senders = names.entry(name.to_owned()).or_default();
        senders.push(sender);
        let is_first = senders.len() == 1;
        drop(names);
        if is_first {
            let (waiting, look_up, of) = (self.waiting.clone(), self.look_up, name.to_owned());
            let work = move || waiting.answer(&of, &look_up(&of).map_err(Arc::new));
            // Without a thread the name is not found.
            if let Err(e) = std::thread::Builder::new().name("name look-up".to_owned()).spawn(work) {
                self.waiting.answer(name, &Err(Arc::new(e)));
            }
        }
        receiver
    }
}

impl Resolve for Names {
    fn resolve(&self, name: Name) -> Resolving {
        let found = self.ask(name.as_str());
        Box::pin(async move { Ok(Box::new(found.await??.into_iter()) as Addrs) })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::*;

    static LOOKED_UP: AtomicUsize = AtomicUsize::new(0);
    type Gate = (Mutex<Sender<()>>, Mutex<Receiver<()>>);
    static GATE: LazyLock<Gate> = LazyLock::new(|| {
        let (sender, receiver) = channel();
        (sender.into(), receiver.into())
    });

    fn look_up(name: &str) -> io::Result<Vec<SocketAddr>> {
        LOOKED_UP.fetch_add(1, Ordering::SeqCst);
        match name {
            "silent" => {
                GATE.1.lock().unwrap().recv().unwrap();
                Err(io::Error::other("no answer"))
            }
            _ => Ok(vec![([127, 0, 0, 1], 0).into()]),
        }
    }

    #[test]
    fn a_silent_name_holds_up_no_other_and_is_looked_up_once_at_a_time() {
        let names = Names { look_up, ..Names::default() };
        let silent: Vec<_> = (0..100).map(|_| names.ask("silent")).collect();
        let answer = |asked: oneshot::Receiver<Found>| asked.blocking_recv().unwrap();
        assert_eq!(answer(names.ask("there")).unwrap(), [([127, 0, 0, 1], 0).into()]);
        GATE.0.lock().unwrap().send(()).unwrap();
        assert!(silent.into_iter().all(|asked| answer(asked).unwrap_err().to_string() == "no answer"));
        assert_eq!(LOOKED_UP.load(Ordering::SeqCst), 2);
        assert!(answer(names.ask("there")).is_ok());
        assert_eq!(LOOKED_UP.load(Ordering::SeqCst), 3, "what was found is not kept");
    }
}
