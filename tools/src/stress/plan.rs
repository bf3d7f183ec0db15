//! The plan of a seed: settings, faults, camera paths and events. It is drawn before the flight begins, so that the timing
//! of threads does not affect it.

use std::time::Duration;

use terrane::gpu::CompileBudget;
use terrane::pager::{LoopingMode, PagerConfig, SequenceMode};
use terrane::viewer::ThreadingModel;

use super::random::Random;

/// Maximum number of views.
pub const MAX_VIEWS: usize = 4;
/// Maximum number of open contexts.
pub const MAX_CONTEXTS: usize = 3;
/// Maximum number of scenes.
pub const MAX_SCENES: usize = 2;

/// The source of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    Disk,
    /// The local server.
    Server,
}

/// The protocol of the local server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    Http1,
    Http2,
    /// Encrypted HTTP/1.1.
    Tls1,
    /// Encrypted HTTP/2.
    Tls2,
}

impl Protocol {
    /// Returns the name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Http1 => "http/1.1",
            Self::Http2 => "h2c",
            Self::Tls1 => "tls/1.1",
            Self::Tls2 => "h2",
        }
    }

    pub fn is_encrypted(self) -> bool {
        matches!(self, Self::Tls1 | Self::Tls2)
    }
}

/// The kind of drawing of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drawing {
    /// wgpu's noop backend draws nothing.
    None,
    /// The background has a key colour, to detect holes.
    Holes,
    /// The background is the sky. Images are checked for black or transparent pixels.
    Sky,
}

/// The latency, bandwidth and shares of faults of the server.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults {
    pub latency_ms: f64,
    pub jitter_ms: f64,
    /// Bytes per second of a connection; 0 for no limit.
    pub bandwidth: f64,
    pub error: f64,
    pub truncate: f64,
    pub corrupt: f64,
    pub stall: f64,
    pub reset: f64,
    pub silent: f64,
    pub page: f64,
}

impl Faults {
    /// Returns the share of answers with a fault.
    pub fn shares(&self) -> f64 {
        self.error + self.truncate + self.corrupt + self.stall + self.reset + self.silent + self.page
    }

    fn random(random: &mut Random) -> Self {
        let mut faults = Self {
            latency_ms: if random.percent(60) { random.between(0.1, 25.0) } else { 0.0 },
            jitter_ms: if random.percent(40) { random.between(0.1, 25.0) } else { 0.0 },
            bandwidth: if random.percent(30) { random.between(2e5, 5e6) } else { 0.0 },
            ..Self::default()
        };
        if random.percent(65) {
            let mut rate = || if random.percent(50) { random.between(0.0, 0.12) } else { 0.0 };
            faults.error = rate();
            faults.truncate = rate();
            faults.corrupt = rate();
            faults.reset = rate();
            faults.page = rate();
            faults.stall = 0.3 * rate();
            faults.silent = 0.3 * rate();
        }
        faults
    }
}

/// The pose of a camera relative to the set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Offset from the middle in half extents.
    pub east: f64,
    pub north: f64,
    /// Height above the highest ground in radii of the set.
    pub height: f64,
    /// Radians clockwise from north; `pitch` is in radians above the horizon.
    pub heading: f64,
    pub pitch: f64,
}

impl Pose {
    fn random(random: &mut Random) -> Self {
        Self {
            east: random.between(-1.0, 1.0),
            north: random.between(-1.0, 1.0),
            // The logarithm is uniform, so low and high poses are equally frequent.
            height: 10f64.powf(random.between(-2.5, 0.6)),
            heading: random.between(0.0, std::f64::consts::TAU),
            pitch: if random.percent(90) { random.between(-1.5, -0.1) } else { random.between(0.0, 1.5) },
        }
    }

    /// Draws a pose that sees the ground.
    fn above_ground(random: &mut Random) -> Self {
        Self {
            east: random.between(-0.8, 0.8),
            north: random.between(-0.8, 0.8),
            height: 10f64.powf(random.between(-2.0, 0.0)),
            heading: random.between(0.0, std::f64::consts::TAU),
            pitch: random.between(-1.5, -0.5),
        }
    }

    /// Interpolates between two poses.
    fn towards(&self, other: &Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + (b - a) * share;
        Self {
            east: mix(self.east, other.east),
            north: mix(self.north, other.north),
            // The height changes by the same factor in each step.
            height: self.height.powf(1.0 - share) * other.height.powf(share),
            heading: mix(self.heading, other.heading),
            pitch: mix(self.pitch, other.pitch),
        }
    }
}

/// An event before a frame. Its numbers choose among the objects that exist then, modulo their count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    Model(ThreadingModel),
    StopThreads,
    Resize {
        context: usize,
        size_px: [u32; 2],
    },
    OpenContext,
    CloseContext(usize),
    AddView {
        context: usize,
        scene: usize,
        part: bool,
    },
    RemoveView(usize),
    AddSlave {
        view: usize,
        context: usize,
        shift: f64,
    },
    RemoveSlave(usize),
    Pause {
        scene: usize,
        is_paused: bool,
    },
    TakeRequests {
        scene: usize,
        takes: bool,
    },
    Clear(usize),
    Sse {
        view: usize,
        px: f64,
    },
    /// Announces the path of a view to the pager. A wrong announcement is the path of another view.
    Announce {
        view: usize,
        path_of: usize,
    },
    /// Withdraws the announcement of a view.
    Withdraw(usize),
    /// Requests one of the proxies.
    LoadProxy(usize),
    /// Waits for this many milliseconds.
    Sleep(u64),
    Finish,
    /// Removes the second scene with its views.
    RemoveScene,
    AddScene,
}

/// A sequence of images beside the set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slides {
    pub images: u32,
    pub length_s: f64,
    pub looping: LoopingMode,
    pub mode: SequenceMode,
    /// The number of images that are loaded ahead.
    pub ahead: usize,
    /// The speed of time relative to the simulation.
    pub multiplier: f64,
}

impl Slides {
    fn random(random: &mut Random) -> Self {
        Self {
            images: random.whole(1, 12) as u32,
            length_s: random.between(0.1, 3.0),
            looping: random.one_of(&[LoopingMode::NoLooping, LoopingMode::Looping, LoopingMode::Swing]),
            mode: random.one_of(&[
                SequenceMode::PreLoadAllImages,
                SequenceMode::PageAndRetainImages,
                SequenceMode::PageAndDiscardUsedImages,
            ]),
            ahead: random.whole(0, 12) as usize,
            multiplier: random.one_of(&[1.0, 1.0, -1.0, 5.0]),
        }
    }
}

/// Everything that a seed determines. Each field is one decision.
#[derive(Clone, Debug)]
pub struct Plan {
    pub seed: u64,
    pub transport: Transport,
    pub drawing: Drawing,
    pub faults: Faults,
    pub pager: PagerConfig,
    /// True if budgets are smaller than what the views want.
    pub is_tiny: bool,
    pub has_cache: bool,
    pub model: ThreadingModel,
    pub compile_budget: CompileBudget,
    pub size_px: [u32; 2],
    pub scenes: usize,
    pub sse_px: f64,
    pub frames: u32,
    /// The poses by view and frame.
    pub poses: Vec<Vec<Pose>>,
    /// The final pose of each view.
    pub last_poses: Vec<Pose>,
    /// Events with the number of the frame that follows them.
    pub events: Vec<(u32, Event)>,
    /// Microseconds between frames.
    pub between_us: u64,
    /// The interval of image checks in frames.
    pub image_interval: u32,
    /// True if all scenes share one pager.
    pub share_pager: bool,
    /// The factor of `CullSettings::skip_sse_factor`; 1 skips no level.
    pub skip_sse_factor: f64,
    /// True if contexts have a compile thread, which fills staging memory.
    pub compile_contexts: bool,
    pub look_ahead_s: f64,
    /// True if the first scene has proxies beside its set.
    pub has_proxies: bool,
    /// The image sequence of the first scene, if it has one.
    pub slides: Option<Slides>,
    pub protocol: Protocol,
}

impl Plan {
    /// Draws the plan of a seed. `frames` replaces the random number of frames; `draws` is the percentage of seeds that are
    /// drawn by an adapter.
    pub fn new(seed: u64, frames: Option<u32>, draws: u64) -> Self {
        let mut random = Random::new(seed);
        let r = &mut random;
        let transport = if r.percent(70) { Transport::Server } else { Transport::Disk };
        let faults = Faults::random(r);
        let drawing = match (r.percent(draws), r.percent(70)) {
            (false, _) => Drawing::None,
            (true, true) => Drawing::Holes,
            (true, false) => Drawing::Sky,
        };
        let frames = frames.unwrap_or(r.whole(40, 120) as u32);
        let is_tiny = r.percent(35);
        let blocking = r.percent(6);
        let pager = pager(r, is_tiny, blocking);
        let model = r.one_of(&ThreadingModel::ALL);
        let compile_budget = r.one_of(&[
            CompileBudget { time: Duration::from_millis(3), bytes: 16 << 20 },
            CompileBudget { time: Duration::ZERO, bytes: 0 },
            CompileBudget { time: Duration::from_micros(200), bytes: 64 << 10 },
        ]);
        let poses = (0..MAX_VIEWS).map(|_| flight(r, frames)).collect();
        let last_poses = (0..MAX_VIEWS).map(|_| Pose::above_ground(r)).collect();
        let events = events(r, frames);
        let mut plan = Self {
            seed,
            transport,
            drawing,
            faults,
            pager,
            is_tiny,
            has_cache: r.percent(30),
            model,
            compile_budget,
            size_px: [r.whole(48, 160) as u32, r.whole(32, 120) as u32],
            scenes: r.whole(1, 2) as usize,
            sse_px: 10f64.powf(r.between(-0.7, 0.9)),
            frames,
            poses,
            last_poses,
            events,
            between_us: r.one_of(&[0, 300, 2000, 5000]),
            image_interval: r.whole(1, 6) as u32,
            share_pager: r.percent(60),
            skip_sse_factor: r.one_of(&[1.0, 1.0, 2.0, 4.0, 16.0]),
            compile_contexts: r.percent(40),
            look_ahead_s: r.one_of(&[0.0, 1.0, 3.0]),
            has_proxies: r.percent(60),
            slides: if r.percent(40) { Some(Slides::random(r)) } else { None },
            // New decisions are drawn last, so that seeds keep the others.
            protocol: r.one_of(&[Protocol::Http1, Protocol::Http2, Protocol::Tls1, Protocol::Tls2]),
        };
        if r.percent(40) {
            let event = |r: &mut Random| (r.whole(2, 120) as u32, r.one_of(&[Event::RemoveScene, Event::AddScene]));
            plan.events.extend((0..r.whole(1, 6)).map(|_| event(r)));
        }
        plan
    }

    /// Makes the flight independent of timing: each frame loads what it wants, one request after the other, without a cache,
    /// and failed loads are retried at once.
    pub fn block(&mut self) {
        self.pager.blocking = true;
        self.pager.retry_after = Duration::ZERO;
        (self.pager.http_in_flight, self.pager.http_in_flight_max) = (1, 1);
        (self.pager.file_threads, self.pager.decode_threads) = (1, 1);
        self.look_ahead_s = 0.0;
        self.share_pager = true;
        self.has_cache = false;
    }

    /// Returns a hash of the plan.
    pub fn digest(&self) -> u64 {
        terrane::math::random::fnv1a(format!("{self:?}").as_bytes())
    }
}

/// Draws the configuration of pagers, with short timeouts.
fn pager(r: &mut Random, is_tiny: bool, blocking: bool) -> PagerConfig {
    let frames = |count: u64| Duration::from_millis(17 * count);
    let mut config = PagerConfig {
        file_threads: r.whole(1, 3) as usize,
        decode_threads: r.whole(1, 3) as usize,
        http_in_flight: r.whole(1, 24) as usize,
        http_in_flight_max: r.one_of(&[0, 32, 128]),
        expiry_time: frames(r.whole(1, 30)),
        stale_time: frames(r.whole(1, 4)),
        abort_time: frames(r.whole(2, 30)),
        merge_time: r.one_of(&[Duration::ZERO, Duration::from_millis(1), Duration::from_millis(20)]),
        retry_after: Duration::from_millis(r.whole(5, 40)),
        max_tries: Some(r.whole(1, 4) as u32),
        build_kd_trees: r.percent(20),
        blocking,
        ..PagerConfig::default()
    };
    config.update_time = config.merge_time;
    if is_tiny {
        match r.whole(0, 3) {
            3 => config.max_bytes_loading = r.whole(2_000, 4_000_000),
            0 => config.max_tiles = r.whole(1, 30) as usize,
            1 => config.max_bytes_gpu = r.whole(200_000, 6_000_000),
            _ => config.max_bytes_cpu = r.whole(2_000, 400_000),
        }
    }
    config.http.connect_timeout = Duration::from_millis(1500);
    config.http.first_byte_timeout = Duration::from_millis(400);
    config.http.read_timeout = Duration::from_millis(400);
    config.http.total_timeout = Duration::from_millis(3000);
    config.http.max_retries = r.whole(0, 2) as u32;
    config.http.retry_backoff = Duration::from_millis(5);
    config.http.max_wait = Duration::from_millis(50);
    config.http.seed = r.next();
    config
}

/// Draws a path of poses: stays, jumps, spins, dives, and straight lines.
fn flight(r: &mut Random, frames: u32) -> Vec<Pose> {
    let mut poses: Vec<Pose> = Vec::new();
    let mut at = Pose::random(r);
    while poses.len() < frames as usize {
        let length = r.whole(1, 30) as usize;
        let to = match r.whole(0, 9) {
            // The camera stays.
            0 | 1 => at,
            // The camera jumps in each frame.
            2 => {
                for _ in 0..length.min(6) {
                    poses.push(Pose::random(r));
                }
                at = Pose::random(r);
                at
            }
            3 => Pose { heading: at.heading + r.between(-12.0, 12.0), ..at },
            4 | 5 => Pose { height: 10f64.powf(r.between(-3.0, 0.6)), pitch: r.between(-1.5, -0.3), ..at },
            // The camera moves far away.
            6 => Pose { height: 60.0, ..at },
            _ => Pose::random(r),
        };
        let from = at;
        poses.extend((1..=length).map(|i| from.towards(&to, i as f64 / length as f64)));
        at = to;
    }
    poses.truncate(frames as usize);
    poses
}

/// Draws the events of a flight. Their frequency is random.
fn events(r: &mut Random, frames: u32) -> Vec<(u32, Event)> {
    let mut events = Vec::new();
    let often = r.one_of(&[2, 8, 25]);
    for frame in 2..frames {
        if !r.percent(often) {
            continue;
        }
        let any = r.whole(0, 99) as usize;
        let event = match r.whole(0, 26) {
            0..=3 => Event::Model(r.one_of(&ThreadingModel::ALL)),
            4 => Event::StopThreads,
            5 | 6 => Event::Resize { context: any, size_px: [r.whole(1, 200) as u32, r.whole(1, 150) as u32] },
            7 => Event::OpenContext,
            8 => Event::CloseContext(any),
            9 | 10 => Event::AddView { context: any, scene: r.whole(0, 9) as usize, part: r.percent(50) },
            11 => Event::RemoveView(any),
            12 => Event::AddSlave { view: any, context: r.whole(0, 9) as usize, shift: r.between(-2.0, 2.0) },
            13 => Event::RemoveSlave(any),
            14 | 15 => Event::Pause { scene: any, is_paused: r.percent(50) },
            16 => Event::TakeRequests { scene: any, takes: r.percent(60) },
            17 => Event::Clear(any),
            18 => Event::Sse { view: any, px: 10f64.powf(r.between(-0.7, 1.5)) },
            19 | 20 => Event::Sleep(r.whole(1, 30)),
            21 | 22 => {
                let path_of = if r.percent(70) { any } else { r.whole(0, 99) as usize };
                Event::Announce { view: any, path_of }
            }
            23 => Event::Withdraw(any),
            24 | 25 => Event::LoadProxy(any),
            _ => Event::Finish,
        };
        events.push((frame, event));
    }
    events
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seed_determines_the_plan() {
        for seed in 0..50 {
            let (a, b) = (Plan::new(seed, None, 30), Plan::new(seed, None, 30));
            assert_eq!(a.digest(), b.digest());
            assert_ne!(a.digest(), Plan::new(seed + 1, None, 30).digest());
            assert!(a.poses.iter().all(|p| p.len() == a.frames as usize), "seed {seed}");
            assert!(a.poses.iter().flatten().all(|p| p.height > 0.0 && p.heading.is_finite()), "seed {seed}");
        }
    }

    #[test]
    fn seeds_cover_all_kinds_of_plans() {
        let plans: Vec<Plan> = (0..200).map(|seed| Plan::new(seed, None, 25)).collect();
        let count = |holds: &dyn Fn(&Plan) -> bool| plans.iter().filter(|p| holds(p)).count();
        assert!(count(&|p| p.transport == Transport::Server && p.faults.shares() > 0.0) > 60);
        assert!(count(&|p| p.is_tiny) > 40 && count(&|p| p.pager.blocking) > 4 && count(&|p| p.scenes == 2) > 60);
        assert!(count(&|p| p.scenes == 2 && p.share_pager) > 30 && count(&|p| p.scenes == 2 && !p.share_pager) > 20);
        assert!(count(&|p| p.drawing == Drawing::Holes) > 15 && count(&|p| p.drawing == Drawing::Sky) > 5);
        let events: Vec<Event> = plans.iter().flat_map(|p| p.events.iter().map(|(_, e)| *e)).collect();
        assert!(events.iter().filter(|e| matches!(e, Event::Model(_))).count() > 100);
        assert!(events.iter().any(|e| matches!(e, Event::CloseContext(_))));
        assert!(events.iter().filter(|e| matches!(e, Event::Announce { .. })).count() > 50);
        assert!(events.iter().filter(|e| matches!(e, Event::LoadProxy(_))).count() > 50);
        assert!(events.iter().filter(|e| matches!(e, Event::RemoveScene)).count() > 50);
        assert!(events.iter().filter(|e| matches!(e, Event::AddScene)).count() > 50);
        assert!(count(&|p| p.skip_sse_factor > 1.0) > 60 && count(&|p| p.compile_contexts) > 50);
        assert!(count(&|p| p.has_proxies) > 80 && count(&|p| p.slides.is_some()) > 50);
        for protocol in [Protocol::Http1, Protocol::Http2, Protocol::Tls1, Protocol::Tls2] {
            assert!(count(&|p| p.transport == Transport::Server && p.protocol == protocol) > 20, "{protocol:?}");
        }
    }
}
