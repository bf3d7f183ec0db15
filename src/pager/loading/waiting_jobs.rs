//! [`WaitingJobs`]: the jobs that no thread has taken, by urgency.
//!
//! The order is kept while jobs come, change and go. Each queue is a binary heap of numbers. A job that changes its urgency
//! gets another entry, and a thread that meets an outdated entry drops it. So a change costs O(log n), a take O(log n) for
//! each lane and scene, and no job is copied. When more than a quarter of all urgencies change at once, as they do while the
//! camera moves, the heaps are filled again in one pass over the numbers.
//!
//! Two rules change the order of urgency. Requests of all scenes compete; a scene whose camera moves would take all slots
//! for as long as its requests are more urgent. So a scene that was passed over a few times gets the next slot. Within a
//! scene, a view that moves may keep requesting tiles that are more urgent than what another view lacks; so some slots go to
//! the oldest requests.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};

use super::request::Request;
use super::ticket::Ticket;
#[cfg(feature = "http")]
use crate::fetch::server;

/// A scene with requests gets the next slot after it was passed over this many times.
const MAX_PASSED_OVER: u32 = 4;
/// One in this many slots goes to the oldest request.
const AGED_SHARE: u32 = 8;
/// Outdated entries may outnumber the jobs by this many before the heaps are filled again.
const MAX_OUTDATED: usize = 1024;

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

/// An entry of a heap; of equally urgent jobs the one requested first comes first.
type Urgent = (Urgency, Reverse<Ticket>);
type UrgentFirst = BinaryHeap<Urgent>;

/// The jobs of a scene in a lane, without prefetches.
#[derive(Default)]
struct SceneQueue {
    urgent: UrgentFirst,
    /// The frame of the first request, oldest first.
    oldest: BinaryHeap<Reverse<(u32, Ticket)>>,
}

/// The jobs that need the same servers. A thread takes from a lane only if all of them have a free slot, so that a full
/// server holds up no job that does not need it.
struct Lane<S> {
    /// The servers, the content's own first; none for files.
    servers: Vec<String>,
    scenes: BTreeMap<S, SceneQueue>,
    prefetches: UrgentFirst,
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
    jobs: HashMap<Ticket, Waiting<J>>,
    /// The first is that of files. An empty one is reused.
    lanes: Vec<Lane<J::Scene>>,
    /// Indices of the lanes of servers by [`lane_key`].
    lane_of: HashMap<String, usize>,
    free_lanes: Vec<usize>,
    /// The scenes that have jobs.
    turns: BTreeMap<J::Scene, Turn>,
    /// Slots since the last one that went to an old request.
    slots: u32,
    /// Entries added since the heaps were last filled.
    entries: usize,
}

/// Returns the key of the lane for jobs that need these servers.
fn lane_key(servers: &[String]) -> String {
    servers.join(" ")
}

fn new_lane<S: Ord>(servers: Vec<String>) -> Lane<S> {
    Lane { servers, scenes: BTreeMap::new(), prefetches: BinaryHeap::new(), len: 0 }
}

/// Returns the lanes of a source that have jobs, with their indices.
fn lanes_of<S>(lanes: &mut [Lane<S>], source: Source) -> impl Iterator<Item = (usize, &mut Lane<S>)> {
    let has_source = move |index: usize| (index == FILES) == (source == Source::Files);
    lanes.iter_mut().enumerate().filter(move |(index, lane)| lane.len > 0 && has_source(*index))
}

/// Drops outdated entries from the front of a heap and returns the first that is not; `lane` is the lane of the heap.
fn first_urgent<J>(heap: &mut UrgentFirst, jobs: &HashMap<Ticket, Waiting<J>>, lane: usize) -> Option<Urgent> {
    while let Some(&(urgency, Reverse(ticket))) = heap.peek() {
        if jobs.get(&ticket).is_some_and(|job| job.urgency == urgency && job.lane == lane) {
            return Some((urgency, Reverse(ticket)));
        }
        heap.pop();
    }
    None
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
            entries: 0,
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
        self.jobs.insert(ticket, Waiting { job, urgency, first_frame, lane });
        self.push(ticket, true);
        self.compact();
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

    /// Adds the entries of a job to its heaps; that of its age once.
    fn push(&mut self, ticket: Ticket, is_new: bool) {
        let Some(Waiting { job, urgency, first_frame, lane }) = self.jobs.get(&ticket) else { return };
        let urgent = (*urgency, Reverse(ticket));
        self.entries += 1;
        if urgency.is_prefetch() {
            self.lanes[*lane].prefetches.push(urgent);
            return;
        }
        let queue = self.lanes[*lane].scenes.entry(job.scene()).or_default();
        queue.urgent.push(urgent);
        if is_new {
            queue.oldest.push(Reverse((*first_frame, ticket)));
        }
    }

    /// Changes urgencies. Jobs that do not wait are left out.
    pub fn set_urgencies(&mut self, changes: &[(Ticket, Urgency)]) {
        let fills = changes.len() > self.jobs.len() / 4;
        for &(ticket, urgency) in changes {
            let Some(waiting) = self.jobs.get_mut(&ticket) else { continue };
            let was_prefetch = waiting.urgency.is_prefetch();
            waiting.urgency = urgency;
            let changes_class = urgency.is_prefetch() != was_prefetch;
            if changes_class {
                waiting.job.set_prefetch(urgency.is_prefetch());
                let scene = waiting.job.scene();
                if was_prefetch {
                    self.turns.entry(scene).or_default().waiting += 1;
                } else {
                    self.leave_turn(scene);
                }
            }
            if !fills {
                self.push(ticket, changes_class);
            }
        }
        if fills {
            self.fill();
        }
        self.compact();
    }

    /// Fills the heaps again if most entries may be outdated.
    fn compact(&mut self) {
        if self.entries > 2 * self.jobs.len() + MAX_OUTDATED {
            self.fill();
        }
    }

    /// Fills all heaps from the jobs, in one pass.
    fn fill(&mut self) {
        for lane in &mut self.lanes {
            lane.prefetches.clear();
            lane.scenes.retain(|scene, queue| {
                queue.urgent.clear();
                queue.oldest.clear();
                self.turns.contains_key(scene)
            });
        }
        self.entries = 0;
        let Self { jobs, lanes, entries, .. } = self;
        for (ticket, Waiting { job, urgency, first_frame, lane }) in jobs {
            *entries += 1;
            let (lane, urgent) = (&mut lanes[*lane], (*urgency, Reverse(*ticket)));
            if urgency.is_prefetch() {
                lane.prefetches.push(urgent);
            } else {
                let queue = lane.scenes.entry(job.scene()).or_default();
                queue.urgent.push(urgent);
                queue.oldest.push(Reverse((*first_frame, *ticket)));
            }
        }
    }

    /// Removes a job. Returns it if it waited.
    pub fn remove(&mut self, ticket: Ticket) -> Option<J> {
        let Waiting { job, urgency, lane, .. } = self.jobs.remove(&ticket)?;
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
        if lane.len == 0 {
            lane.prefetches.clear();
            lane.scenes.clear();
            if index != FILES {
                self.lane_of.remove(&lane_key(&lane.servers));
                self.free_lanes.push(index);
            }
        }
    }

    /// Takes the job that is next in turn among those that may be taken. `may_take` decides for a lane's servers and for
    /// prefetches or other jobs. Requests from before the frame `aged_before` are old.
    pub fn take(&mut self, source: Source, aged_before: u32, may_take: impl Fn(&[String], bool) -> bool) -> Option<J> {
        loop {
            let ticket = self.first(source, aged_before, &may_take)?;
            #[cfg(feature = "http")]
            if source == Source::Servers && self.move_to_servers(ticket) {
                continue;
            }
            let waiting = self.jobs.get(&ticket)?;
            if !waiting.urgency.is_prefetch() {
                let taken = waiting.job.scene();
                for (scene, turn) in &mut self.turns {
                    turn.passed_over = if *scene == taken { 0 } else { turn.passed_over.saturating_add(1) };
                }
                self.slots = (self.slots + 1) % AGED_SHARE;
            }
            return self.remove(ticket);
        }
    }

    /// Returns true if [`Self::take`] would take a job.
    pub fn has_next(&mut self, source: Source, may_take: impl Fn(&[String], bool) -> bool) -> bool {
        self.first(source, 0, &may_take).is_some()
    }

    /// Moves a job to the lane of all its servers. Returns true if that is another one than it is in.
    #[cfg(feature = "http")]
    fn move_to_servers(&mut self, ticket: Ticket) -> bool {
        let Some(waiting) = self.jobs.get(&ticket) else { return false };
        let (servers, from) = (waiting.job.servers(), waiting.lane);
        if servers == self.lanes[from].servers {
            return false;
        }
        let servers = servers.to_vec();
        let to = self.lane_of.get(&lane_key(&servers)).copied();
        let to = to.unwrap_or_else(|| self.add_lane(servers));
        if let Some(waiting) = self.jobs.get_mut(&ticket) {
            waiting.lane = to;
        }
        self.lanes[to].len += 1;
        self.leave_lane(from);
        self.push(ticket, true);
        true
    }

    /// Returns the job that is next in turn.
    fn first(
        &mut self,
        source: Source,
        aged_before: u32,
        may_take: &impl Fn(&[String], bool) -> bool,
    ) -> Option<Ticket> {
        let Self { jobs, lanes, turns, slots, .. } = self;
        // How overdue the scene is, what is most urgent there, and the scene.
        let mut next: Option<(u32, Urgent, J::Scene)> = None;
        for (index, lane) in lanes_of(lanes, source) {
            if !may_take(&lane.servers, false) {
                continue;
            }
            lane.scenes.retain(|scene, queue| {
                let Some(urgent) = first_urgent(&mut queue.urgent, jobs, index) else { return false };
                let passed_over = turns.get(scene).map_or(0, |turn| turn.passed_over);
                let overdue = if passed_over >= MAX_PASSED_OVER { passed_over } else { 0 };
                next = next.max(Some((overdue, urgent, *scene)));
                true
            });
        }
        let Some((overdue, (_, Reverse(most_urgent)), in_turn)) = next else {
            let ahead = lanes_of(lanes, source).filter(|(_, lane)| may_take(&lane.servers, true));
            let first = ahead.filter_map(|(index, lane)| first_urgent(&mut lane.prefetches, jobs, index)).max();
            return first.map(|(_, Reverse(ticket))| ticket);
        };
        let is_aged_turn = *slots == AGED_SHARE - 1 && aged_before > 0;
        if !is_aged_turn {
            return Some(most_urgent);
        }
        let mut oldest: Option<(u32, Ticket)> = None;
        for (index, lane) in lanes_of(lanes, source) {
            if !may_take(&lane.servers, false) {
                continue;
            }
            for (_, queue) in lane.scenes.iter_mut().filter(|(scene, _)| overdue == 0 || **scene == in_turn) {
                while let Some(&Reverse((first_frame, ticket))) = queue.oldest.peek() {
                    if jobs.get(&ticket).is_some_and(|job| job.lane == index && !job.urgency.is_prefetch()) {
                        let old = Some((first_frame, ticket)).filter(|_| first_frame < aged_before);
                        oldest = [oldest, old].into_iter().flatten().min();
                        break;
                    }
                    queue.oldest.pop();
                }
            }
        }
        Some(oldest.map_or(most_urgent, |(_, ticket)| ticket))
    }

    /// Returns the jobs in no order, for tests.
    #[cfg(test)]
    pub fn iter(&self) -> impl Iterator<Item = &J> {
        self.jobs.values().map(|waiting| &waiting.job)
    }
}
