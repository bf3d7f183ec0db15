//! [`WaitingJobs`]: the jobs that no thread has taken, by urgency.
//!
//! The order is kept while jobs come, change and go: each queue is an ordered set of numbers. So a change costs O(log n), a take
//! O(log n) for each lane and scene, no job is copied, and nothing is ever sorted or filled again.
//!
//! Two rules change the order of urgency. Requests of all scenes compete; a scene whose camera moves would take all slots
//! for as long as its requests are more urgent. So a scene that was passed over a few times gets the next slot. Within a
//! scene, a view that moves may keep requesting tiles that are more urgent than what another view lacks; so some slots go to
//! the oldest requests.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashMap};

use super::request::Request;
use super::ticket::Ticket;
#[cfg(feature = "http")]
use crate::fetch::server;

/// A scene with requests gets the next slot after it was passed over this many times.
const MAX_PASSED_OVER: u32 = 4;
/// One in this many slots goes to the oldest request.
const AGED_SHARE: u32 = 8;

/// How urgent a request is; the greater is served first. What a frame lacks now comes before every prefetch, and within
/// both the higher priority comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Urgency(u64);

impl Urgency {
    /// Returns the urgency of a priority. All priorities are ordered, as by [`f32::total_cmp`].
    pub fn new(priority: f32, is_prefetch: bool) -> Self {
        let bits = priority.to_bits();
        let ascending = if bits >> 31 == 1 { !bits } else { bits | 1 << 31 };
        Self(u64::from(!is_prefetch) << 32 | u64::from(ascending))
    }

    /// Returns true for a prefetch.
    pub fn is_prefetch(self) -> bool {
        self.0 >> 32 == 0
    }

    /// Returns an urgency that is greater than that of a lower rank.
    fn of_rank(rank: usize, is_prefetch: bool) -> Self {
        Self(u64::from(!is_prefetch) << 32 | u64::from(rank as u32))
    }
}

/// The kind of jobs that a thread takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    Files,
    #[cfg(feature = "http")]
    Servers,
}

/// A job that waits.
struct Waiting<J> {
    job: J,
    urgency: Urgency,
    /// The frame in which it was first requested.
    first_frame: u32,
    /// Index of its lane.
    lane: usize,
}

/// The sort key of a job in its queue: the most urgent comes last, and of equally urgent ones the one requested first.
type Urgent = (Urgency, Reverse<Ticket>);

/// The jobs of a scene in a lane, without prefetches.
#[derive(Default)]
struct SceneQueue {
    urgent: BTreeSet<Urgent>,
    /// By the frame of the first request, oldest first.
    oldest: BTreeSet<(u32, Ticket)>,
}

/// The jobs that need the same servers. A thread takes from a lane only if all of them have a free slot, so that a full
/// server holds up no job that does not need it.
struct Lane<S> {
    /// The servers, the content's own first; none for files.
    servers: Vec<String>,
    scenes: BTreeMap<S, SceneQueue>,
    prefetches: BTreeSet<Urgent>,
    /// The number of jobs.
    len: usize,
}

/// Index of the lane of files.
const FILES: usize = 0;

/// The fairness of a scene.
#[derive(Clone, Copy, Default)]
struct Turn {
    /// Jobs that are not prefetches.
    waiting: usize,
    /// Slots that other scenes got since this one got its last.
    passed_over: u32,
}

/// The waiting jobs. The request list's mutex guards them.
pub(super) struct WaitingJobs<J: Request> {
    /// Boxed, so that the table moves pointers and not jobs when it grows: tens of thousands may appear at once.
    jobs: HashMap<Ticket, Box<Waiting<J>>>,
    /// The first is that of files. An empty one is reused.
    lanes: Vec<Lane<J::Scene>>,
    /// Indices of the lanes of servers by [`lane_key`].
    lane_of: HashMap<String, usize>,
    free_lanes: Vec<usize>,
    /// The scenes that have jobs.
    turns: BTreeMap<J::Scene, Turn>,
    /// Slots since the last one that went to an old request.
    slots: u32,
}

/// Returns the key of the lane for jobs that need these servers.
fn lane_key(servers: &[String]) -> String {
    servers.join(" ")
}

fn new_lane<S: Ord>(servers: Vec<String>) -> Lane<S> {
    Lane { servers, scenes: BTreeMap::new(), prefetches: BTreeSet::new(), len: 0 }
}

/// Returns the lanes of a source that have jobs.
fn lanes_of<S>(lanes: &[Lane<S>], source: Source) -> impl Iterator<Item = &Lane<S>> {
    let (files, servers) = lanes.split_at(FILES + 1);
    let of_source = if source == Source::Files { files } else { servers };
    of_source.iter().filter(|lane| lane.len > 0)
}

impl<J: Request> Waiting<J> {
    /// Adds the job to the queues of its lane.
    fn enqueue(&self, lanes: &mut [Lane<J::Scene>]) {
        let (lane, ticket) = (&mut lanes[self.lane], self.job.ticket());
        let urgent = (self.urgency, Reverse(ticket));
        if self.urgency.is_prefetch() {
            lane.prefetches.insert(urgent);
        } else {
            let queue = lane.scenes.entry(self.job.scene()).or_default();
            queue.urgent.insert(urgent);
            queue.oldest.insert((self.first_frame, ticket));
        }
    }

    /// Removes the job from the queues of its lane.
    fn dequeue(&self, lanes: &mut [Lane<J::Scene>]) {
        let (lane, ticket) = (&mut lanes[self.lane], self.job.ticket());
        let urgent = (self.urgency, Reverse(ticket));
        if self.urgency.is_prefetch() {
            lane.prefetches.remove(&urgent);
        } else if let Some(queue) = lane.scenes.get_mut(&self.job.scene()) {
            queue.urgent.remove(&urgent);
            queue.oldest.remove(&(self.first_frame, ticket));
            if queue.urgent.is_empty() {
                lane.scenes.remove(&self.job.scene());
            }
        }
    }
}

impl<J: Request> WaitingJobs<J> {
    pub fn new() -> Self {
        Self {
            jobs: HashMap::new(),
            lanes: vec![new_lane(Vec::new())],
            lane_of: HashMap::new(),
            free_lanes: Vec::new(),
            turns: BTreeMap::new(),
            slots: 0,
        }
    }

    /// Returns the number of jobs.
    pub fn len(&self) -> usize {
        self.jobs.len()
    }

    /// Returns true if jobs of servers wait.
    #[cfg(feature = "http")]
    pub fn has_remote(&self) -> bool {
        self.jobs.len() > self.lanes[FILES].len
    }

    /// Removes all jobs.
    pub fn clear(&mut self) {
        let slots = self.slots;
        *self = Self { slots, ..Self::new() };
    }

    /// Adds jobs, the most urgent last. None of them counts as old.
    pub fn insert_ranked(&mut self, jobs: impl IntoIterator<Item = J>) {
        for (rank, job) in jobs.into_iter().enumerate() {
            let urgency = Urgency::of_rank(rank, job.is_prefetch());
            self.insert(job, urgency, u32::MAX);
        }
    }

    /// Adds a job that was first requested in a frame, in place of one with its ticket.
    pub fn insert(&mut self, mut job: J, urgency: Urgency, first_frame: u32) {
        let (ticket, scene) = (job.ticket(), job.scene());
        self.remove(ticket);
        let lane = self.first_lane(&job);
        job.set_prefetch(urgency.is_prefetch());
        if !urgency.is_prefetch() {
            self.turns.entry(scene).or_default().waiting += 1;
        }
        self.lanes[lane].len += 1;
        let waiting = Box::new(Waiting { job, urgency, first_frame, lane });
        waiting.enqueue(&mut self.lanes);
        self.jobs.insert(ticket, waiting);
    }

    /// Returns the lane of a job as far as its own address tells: where its companions come from is found out when it is
    /// first about to be taken.
    fn first_lane(&mut self, job: &J) -> usize {
        // Without a client the file threads answer that remote contents are unsupported.
        #[cfg(feature = "http")]
        if job.is_remote() {
            let own = server(job.uri());
            return match self.lane_of.get(own) {
                Some(lane) => *lane,
                None => self.add_lane(vec![own.to_owned()]),
            };
        }
        let _ = job;
        FILES
    }

    #[cfg(feature = "http")]
    fn add_lane(&mut self, servers: Vec<String>) -> usize {
        let key = lane_key(&servers);
        let lane = match self.free_lanes.pop() {
            Some(free) => {
                self.lanes[free] = new_lane(servers);
                free
            }
            None => {
                self.lanes.push(new_lane(servers));
                self.lanes.len() - 1
            }
        };
        self.lane_of.insert(key, lane);
        lane
    }

    /// Changes urgencies. Jobs that do not wait are left out.
    pub fn set_urgencies(&mut self, changes: &[(Ticket, Urgency)]) {
        for &(ticket, urgency) in changes {
            let Some(waiting) = self.jobs.get_mut(&ticket) else { continue };
            let was_prefetch = waiting.urgency.is_prefetch();
            waiting.dequeue(&mut self.lanes);
            waiting.urgency = urgency;
            waiting.job.set_prefetch(urgency.is_prefetch());
            waiting.enqueue(&mut self.lanes);
            let scene = waiting.job.scene();
            match (was_prefetch, urgency.is_prefetch()) {
                (true, false) => self.turns.entry(scene).or_default().waiting += 1,
                (false, true) => self.leave_turn(scene),
                _ => {}
            }
        }
    }

    /// Returns the most urgent jobs that are no prefetches, at most `max` of each lane and scene.
    pub fn most_urgent(&self, max: usize) -> impl Iterator<Item = &J> {
        let queues = self.lanes.iter().flat_map(|lane| lane.scenes.values());
        let tickets = queues.flat_map(move |queue| queue.urgent.iter().rev().take(max));
        tickets.filter_map(|(_, Reverse(ticket))| self.jobs.get(ticket)).map(|waiting| &waiting.job)
    }

    /// Removes a job. Returns it if it waited.
    pub fn remove(&mut self, ticket: Ticket) -> Option<J> {
        let waiting = self.jobs.remove(&ticket)?;
        waiting.dequeue(&mut self.lanes);
        let Waiting { job, urgency, lane, .. } = *waiting;
        if !urgency.is_prefetch() {
            self.leave_turn(job.scene());
        }
        self.leave_lane(lane);
        Some(job)
    }

    /// Counts a job of a scene less. A scene without jobs is owed nothing.
    fn leave_turn(&mut self, scene: J::Scene) {
        if let Some(turn) = self.turns.get_mut(&scene) {
            turn.waiting -= 1;
            if turn.waiting == 0 {
                self.turns.remove(&scene);
            }
        }
    }

    /// Counts a job of a lane less. An empty lane of servers is reused.
    fn leave_lane(&mut self, index: usize) {
        let lane = &mut self.lanes[index];
        lane.len -= 1;
        if lane.len == 0 && index != FILES {
            self.lane_of.remove(&lane_key(&lane.servers));
            self.free_lanes.push(index);
        }
    }

    /// Takes the job that is next in turn among those that may be taken. `may_take` decides for a lane's servers and for
    /// prefetches or other jobs. Requests from before the frame `aged_before` are old.
    pub fn take(&mut self, source: Source, aged_before: u32, may_take: impl Fn(&[String], bool) -> bool) -> Option<J> {
        let ticket = loop {
            let ticket = self.first(source, aged_before, &may_take)?;
            if !self.move_to_servers(source, ticket) {
                break ticket;
            }
        };
        let waiting = self.jobs.get(&ticket)?;
        if !waiting.urgency.is_prefetch() {
            let taken = waiting.job.scene();
            for (scene, turn) in &mut self.turns {
                turn.passed_over = if *scene == taken { 0 } else { turn.passed_over.saturating_add(1) };
            }
            self.slots = (self.slots + 1) % AGED_SHARE;
        }
        self.remove(ticket)
    }

    /// Returns true if [`Self::take`] would take a job.
    pub fn has_next(&self, source: Source, may_take: impl Fn(&[String], bool) -> bool) -> bool {
        self.first(source, 0, &may_take).is_some()
    }

    /// Returns false: files have one lane.
    #[cfg(not(feature = "http"))]
    fn move_to_servers(&mut self, _source: Source, _ticket: Ticket) -> bool {
        false
    }

    /// Moves a job of servers to the lane of all its servers. Returns true if that is another one than it is in.
    #[cfg(feature = "http")]
    fn move_to_servers(&mut self, source: Source, ticket: Ticket) -> bool {
        if source != Source::Servers {
            return false;
        }
        let Some(waiting) = self.jobs.get(&ticket) else { return false };
        let (servers, from) = (waiting.job.servers(), waiting.lane);
        if servers == self.lanes[from].servers {
            return false;
        }
        let servers = servers.to_vec();
        let to = self.lane_of.get(&lane_key(&servers)).copied();
        let to = to.unwrap_or_else(|| self.add_lane(servers));
        if let Some(waiting) = self.jobs.get_mut(&ticket) {
            waiting.dequeue(&mut self.lanes);
            waiting.lane = to;
            waiting.enqueue(&mut self.lanes);
        }
        self.lanes[to].len += 1;
        self.leave_lane(from);
        true
    }

    /// Returns the job that is next in turn.
    fn first(&self, source: Source, aged_before: u32, may_take: &impl Fn(&[String], bool) -> bool) -> Option<Ticket> {
        let open = |is_prefetch| lanes_of(&self.lanes, source).filter(move |lane| may_take(&lane.servers, is_prefetch));
        let queues = || open(false).flat_map(|lane| lane.scenes.iter());
        // How overdue the scene is, what is most urgent there, and the scene.
        let next = queues().filter_map(|(scene, queue)| {
            let passed_over = self.turns.get(scene).map_or(0, |turn| turn.passed_over);
            let overdue = if passed_over >= MAX_PASSED_OVER { passed_over } else { 0 };
            Some((overdue, *queue.urgent.last()?, *scene))
        });
        let Some((overdue, (_, Reverse(most_urgent)), in_turn)) = next.max() else {
            let first = open(true).filter_map(|lane| lane.prefetches.last()).max();
            return first.map(|(_, Reverse(ticket))| *ticket);
        };
        if self.slots != AGED_SHARE - 1 || aged_before == 0 {
            return Some(most_urgent);
        }
        let in_turn = queues().filter(|(scene, _)| overdue == 0 || **scene == in_turn);
        let oldest = in_turn.filter_map(|(_, queue)| queue.oldest.first()).min();
        let old = oldest.filter(|(first_frame, _)| *first_frame < aged_before);
        Some(old.map_or(most_urgent, |(_, ticket)| *ticket))
    }

    /// Returns the jobs in no order, for tests.
    #[cfg(test)]
    pub fn iter(&self) -> impl Iterator<Item = &J> {
        self.jobs.values().map(|waiting| &waiting.job)
    }
}
