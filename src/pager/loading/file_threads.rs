//! [`FileThreads`]: the threads that read local files, and the watch over them.
//!
//! A read can hang for ever: a network drive whose server is gone, a failing disk. It cannot be stopped, and its thread hangs
//! with it. The watch answers such a job with an error after a time limit, and starts another thread in place of the one that
//! hangs, up to [`MAX_HUNG_THREADS`] of them. Once all threads hang, it answers the jobs that wait, so that none waits for
//! ever. A thread whose read ends after all drops what it has read, and goes on if threads are missing.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};

use super::job::{LoadJob, LoadedBytes, total_bytes};
use super::request_list::RequestList;
use super::thread_set::{ThreadSet, follow_core};
use crate::fetch::{ByteBudget, FileReader, IoError, Loaded, Permit};
use crate::formats::{Fetched, MAX_DEPENDENCY_ROUNDS};
use crate::pager::config::PagerError;

/// Threads that hang and are replaced. They cost address space and no time, but a set on a broken disk must not start one for
/// each of its tiles.
const MAX_HUNG_THREADS: usize = 8;
/// How long the end of the pager waits for reads.
const MAX_JOIN_TIME: Duration = Duration::from_secs(1);
/// Limits of the interval at which the watch looks.
const WATCH_INTERVALS: [Duration; 2] = [Duration::from_millis(5), Duration::from_secs(1)];

/// The state that the file threads and their watch share.
pub(super) struct FileThreads<J: LoadJob> {
    list: Arc<RequestList<J>>,
    files: FileReader,
    /// Holds what was read.
    bodies: ByteBudget,
    /// The time limit for reading one file.
    timeout: Duration,
    /// The number of threads that should read.
    readers: usize,
    /// The way to the decoders; `None` once closed. A thread has it only while it sends, so that a thread that hangs does not
    /// keep the decoders waiting.
    sender: Mutex<Option<Sender<LoadedBytes<J>>>>,
    /// Written by the file threads, read by the watch. Locked briefly.
    reads: Mutex<Reads<J>>,
    /// The file threads, those that hang included.
    threads: Mutex<ThreadSet>,
}

struct Reads<J> {
    under_way: Vec<Read<J>>,
    /// Identifies the next job.
    next: u64,
    /// Threads that do not hang.
    running: usize,
    hung: usize,
}

/// A job that a file thread has.
struct Read<J> {
    id: u64,
    job: J,
    /// The file that is being read and the time at which its read began; `None` between reads.
    file: Option<(Arc<str>, Instant)>,
    /// Holds its bytes once it has room for them.
    permit: Option<Permit>,
}

/// The watch has answered the job.
struct GivenUp;

impl<J: LoadJob> FileThreads<J> {
    /// Creates a set without threads.
    pub fn new(
        list: Arc<RequestList<J>>,
        sender: Sender<LoadedBytes<J>>,
        files: FileReader,
        bodies: ByteBudget,
        readers: usize,
        timeout: Duration,
    ) -> Arc<Self> {
        Arc::new(Self {
            list,
            files,
            bodies,
            timeout,
            readers,
            sender: Mutex::new(Some(sender)),
            reads: Mutex::new(Reads { under_way: Vec::new(), next: 0, running: 0, hung: 0 }),
            threads: Mutex::default(),
        })
    }

    /// Starts the threads. Their owner must call [`Self::close`] and [`Self::join`] in the end.
    ///
    /// # Errors
    /// [`PagerError::Thread`] if a thread cannot be started.
    pub fn start(self: &Arc<Self>) -> Result<(), PagerError> {
        (0..self.readers).try_for_each(|_| self.add_thread())
    }

    fn add_thread(self: &Arc<Self>) -> Result<(), PagerError> {
        let mut reads = self.reads();
        let number = reads.running + reads.hung;
        reads.running += 1;
        drop(reads);
        let this = self.clone();
        let name = format!("{}-file-{number}", J::THREAD_PREFIX);
        let started = lock(&self.threads).spawn(name, move || this.run());
        if started.is_err() {
            self.reads().running -= 1;
        }
        started
    }

    /// Looks for reads that take too long until `closed` closes.
    pub fn watch(self: &Arc<Self>, closed: &Receiver<()>) {
        let [shortest, longest] = WATCH_INTERVALS;
        let interval = (self.timeout / 8).clamp(shortest, longest);
        while closed.recv_timeout(interval) == Err(RecvTimeoutError::Timeout) {
            self.give_up_hung_reads();
        }
    }

    /// Lets the decoders end. The threads end after their current reads.
    pub fn close(&self) {
        *lock(&self.sender) = None;
    }

    /// Pins the threads to a core, each before its next job.
    pub fn set_core(&self, core: usize) {
        lock(&self.threads).set_core(core);
    }

    /// Joins the threads that end soon, and leaves those that hang.
    pub fn join(&self) {
        lock(&self.threads).join_within(MAX_JOIN_TIME);
    }

    fn reads(&self) -> MutexGuard<'_, Reads<J>> {
        lock(&self.reads)
    }

    /// The work of a file thread.
    fn run(&self) {
        while let Some(job) = self.list.take_file() {
            follow_core();
            match self.load(job) {
                Ok(loaded) => {
                    if !self.send(loaded) {
                        return;
                    }
                }
                Err(GivenUp) => {
                    let mut reads = self.reads();
                    reads.hung -= 1;
                    if reads.running == self.readers {
                        return;
                    }
                    reads.running += 1;
                }
            }
        }
    }

    /// Sends to the decoders; returns false if they have ended.
    fn send(&self, loaded: LoadedBytes<J>) -> bool {
        let sender = lock(&self.sender).clone();
        sender.is_some_and(|sender| sender.send(loaded).is_ok())
    }

    /// Reads the content of a job, its companions, and what they refer to.
    fn load(&self, job: J) -> Result<LoadedBytes<J>, GivenUp> {
        let id = self.begin(&job);
        // The thread holds no bytes while it waits, and the watch does not count the wait.
        let size = match job.is_remote() || job.is_in_memory() {
            true => 0,
            // The read reports the error.
            false => self.watched(id, job.address(), || self.files.size(job.address()))?.unwrap_or(0),
        };
        let permit = self.bodies.reserve_blocking(size, job.is_prefetch());
        let mut reads = self.reads();
        reads.under_way.iter_mut().find(|read| read.id == id).ok_or(GivenUp)?.permit = Some(permit.clone());
        drop(reads);
        let span = job.read_span();
        let mut loaded = if job.is_remote() {
            Err(IoError::unsupported(job.uri(), "a server (built without the feature)"))
        } else if job.is_in_memory() {
            Ok(Loaded::default())
        } else {
            self.read(id, &job, job.address())?.map(Loaded::from)
        };
        let mut companions: Vec<Fetched> = Vec::new();
        if let Ok(content) = &loaded
            && let Err(error) = self.read_companions(id, &job, content, &mut companions)?
        {
            (loaded, companions) = (Err(error), Vec::new());
        }
        let bytes_read = total_bytes(&loaded, &companions);
        permit.set_bytes(bytes_read.saturating_add(job.bytes_ahead()));
        if loaded.is_ok() && bytes_read > 0 {
            self.bodies.learn(bytes_read);
        }
        drop(span);
        self.reads().under_way.retain(|read| read.id != id);
        job.mark_decoding();
        Ok(LoadedBytes { job, loaded, companions, bytes_read, bytes_http: 0, permit: Some(permit) })
    }

    /// Reads the companions of a content, and what it refers to.
    fn read_companions(
        &self,
        id: u64,
        job: &J,
        content: &Loaded,
        companions: &mut Vec<Fetched>,
    ) -> Result<Result<(), IoError>, GivenUp> {
        let (mut got, limits) = (content.bytes.len() as u64, self.files.limits());
        let mut uris = job.companions();
        for _ in 0..=MAX_DEPENDENCY_ROUNDS {
            for uri in uris {
                let bytes = self.read(id, job, &uri)?;
                got += bytes.as_ref().map_or(0, Vec::len) as u64;
                companions.push((uri, bytes));
                if let Err(error) = limits.check_files_of_content(job.address(), got) {
                    return Ok(Err(error));
                }
            }
            uris = job.dependencies(content, companions);
            if uris.is_empty() {
                break;
            }
        }
        Ok(Ok(()))
    }

    fn begin(&self, job: &J) -> u64 {
        let mut reads = self.reads();
        let id = reads.next;
        reads.next += 1;
        reads.under_way.push(Read { id, job: job.clone(), file: None, permit: None });
        id
    }

    /// Reads one file of a job.
    fn read(&self, id: u64, job: &J, uri: &Arc<str>) -> Result<Result<Vec<u8>, IoError>, GivenUp> {
        self.watched(id, uri, || match job.root_scope() {
            Some(scope) => self.files.read_within(uri, scope),
            None => self.files.read(uri),
        })
    }

    /// Does work on a file of a job under the eyes of the watch.
    fn watched<T>(&self, id: u64, uri: &Arc<str>, work: impl FnOnce() -> T) -> Result<T, GivenUp> {
        let set_file = |file| {
            let mut reads = self.reads();
            let read = reads.under_way.iter_mut().find(|read| read.id == id).ok_or(GivenUp)?;
            read.file = file;
            Ok(())
        };
        set_file(Some((uri.clone(), Instant::now())))?;
        let done = work();
        set_file(None)?;
        Ok(done)
    }

    /// Answers the jobs whose reads take too long, and starts other threads in place of theirs.
    fn give_up_hung_reads(self: &Arc<Self>) {
        let is_hung = |read: &mut Read<J>| read.file.as_ref().is_some_and(|(_, begun)| begun.elapsed() >= self.timeout);
        let mut reads = self.reads();
        let hung: Vec<Read<J>> = reads.under_way.extract_if(.., is_hung).collect();
        reads.hung += hung.len();
        reads.running -= hung.len();
        let missing =
            self.readers.saturating_sub(reads.running).min(MAX_HUNG_THREADS.saturating_sub(reads.hung - hung.len()));
        drop(reads);
        let seconds = self.timeout.as_secs_f64();
        for Read { job, file, permit, .. } in hung {
            // A thread that hangs for ever must not keep others from loading.
            if let Some(permit) = permit {
                permit.set_bytes(0);
            }
            let uri = file.map_or_else(|| job.uri().to_owned(), |(uri, _)| uri.to_string());
            log::warn!("{uri}: the file is not read within {seconds} s; its thread is left alone");
            self.fail(job, IoError::file_timeout(&uri, self.timeout));
        }
        for _ in 0..missing {
            if let Err(error) = self.add_thread() {
                log::warn!("{error}");
            }
        }
        while self.reads().running == 0
            && let Some(job) = self.list.try_take_file()
        {
            let uri = job.uri().to_owned();
            let reason = format!("not read, since all file threads wait for files longer than {seconds} s");
            self.fail(job, IoError::File { uri, reason, may_pass: true });
        }
    }

    fn fail(&self, job: J, error: IoError) {
        job.mark_decoding();
        // Fails only at the end, when no answer is expected.
        self.send(LoadedBytes::failed(job, error));
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use crossbeam_channel::bounded;

    use super::super::page_job::tests::job;
    use super::*;
    use crate::fetch;

    /// Regression: a codec's panic ended the thread, and its job was never answered.
    #[test]
    fn panic_while_reading_is_an_error_of_that_file() {
        let (list, (sender, read)) = (Arc::new(RequestList::new(4, 4)), bounded(4));
        list.lock().set_jobs([1, 2].map(|number| job(number, &format!("/{number}/{}", fetch::PANICS))));
        let files = FileReader::new(fetch::Limits::default());
        let threads =
            FileThreads::new(list.clone(), sender, files, ByteBudget::new(1 << 20), 1, Duration::from_secs(60));
        threads.start().unwrap();
        for _ in 0..2 {
            let loaded = read.recv_timeout(Duration::from_secs(60)).expect("the thread continues");
            assert_eq!(loaded.loaded.unwrap_err().reason(), fetch::DECODER_PANICKED);
        }
        list.close();
        threads.close();
        threads.join();
    }

    /// Regression: what was parsed ahead of the decoder, up to several times the size of its file, counted in no budget.
    #[test]
    fn objects_that_are_parsed_ahead_count_with_the_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.osgt");
        std::fs::write(
            &file,
            "#Ascii Scene \n#Version 161 \n#Generator OpenSceneGraph 3.6.5 \n\nosg::Geode { UniqueID 1 }",
        )
        .unwrap();
        let (list, (sender, read)) = (Arc::new(RequestList::new(4, 4)), bounded(4));
        list.lock().set_jobs([job(1, file.to_str().unwrap())]);
        let (files, bodies) = (FileReader::new(fetch::Limits::default()), ByteBudget::new(1 << 20));
        let threads = FileThreads::new(list.clone(), sender, files, bodies.clone(), 1, Duration::from_secs(60));
        threads.start().unwrap();
        let loaded = read.recv_timeout(Duration::from_secs(60)).unwrap();
        let ahead = loaded.job.bytes_ahead();
        assert!(ahead > 0 && bodies.total().bytes == loaded.bytes_read + ahead, "{ahead} {:?}", bodies.total());
        drop(loaded);
        assert_eq!(bodies.total().bytes, 0);
        list.close();
        threads.close();
        threads.join();
    }
}
