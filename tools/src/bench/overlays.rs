//! Measures frames while imagery arrives: a fast flight over the ellipsoid under images of a map server on this machine, which
//! draws them. A frame is the whole loop on one thread: events, update, cull, and draw to submitted commands.
//!
//! The control is the same flight without an overlay: its ratio of the slowest percent to the median is that of the machine and
//! of the tiles below the images. Frames are 60 Hz apart, with uploads and merges in the time between them, as in a window.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use glam::{DAffine3, DVec3};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbaImage};
use serde_json::{Value, json};
use terrane::formats::OverlaySet;
use terrane::gpu::AdapterChoice;
use terrane::math::{Geodetic, WGS84};
use terrane::viewer::{LoadedRoot, ThreadingModel, Viewer, ViewerConfig};

use super::measurement::{percentile, print_line, thread_s};
use crate::overlays::OverlayArg;

/// Pictures that differ; every tile has bytes of its own.
const PICTURES: u32 = 16;
const TILE_PX: u32 = 256;
const SIZE_PX: [u32; 2] = [640, 360];
const FRAME: Duration = Duration::from_nanos(1_000_000_000 / 60);
/// How long the first view may take.
const TIMEOUT: Duration = Duration::from_secs(60);
const MIN_FRAMES: usize = 30;
/// The height of the eye above the ellipsoid in metres, its speed in metres per second, at which images arrive in most frames,
/// and how far ahead it looks.
const HEIGHT_M: f64 = 2_000.0;
const SPEED_M_S: f64 = 6_000.0;
const LOOK_AT_M: f64 = 6_000.0;
const LATITUDE_DEG: f64 = 46.0;

/// Measures both flights on both adapters, each for about `seconds`, and prints a line for each.
pub fn run(seconds: f64) -> Result<()> {
    let server = Server::start()?;
    for (name, adapter) in [("noop", AdapterChoice::Noop), ("software", AdapterChoice::Software)] {
        for overlay in [false, true] {
            print_line(measure(&server, (name, adapter), overlay, seconds)?);
        }
    }
    Ok(())
}

fn measure(server: &Server, (name, adapter): (&str, AdapterChoice), overlay: bool, seconds: f64) -> Result<Value> {
    let mut config = ViewerConfig {
        size_px: SIZE_PX,
        threading: ThreadingModel::SingleThreaded,
        adapter,
        validation: false,
        ..ViewerConfig::default()
    };
    if overlay {
        // Each flight has addresses of its own.
        let template = format!("{}/{}/{{z}}/{{x}}/{{y}}.jpg,levels=0-18", server.url, server.flight());
        let OverlayArg(overlay) = template.parse().map_err(anyhow::Error::msg)?;
        config.pager.overlays = Some(Arc::new(OverlaySet::new(vec![overlay])?));
    }
    let root = LoadedRoot::ellipsoid(&config.pager)?;
    let mut viewer = Viewer::new_offscreen(&config)?;
    viewer.set_root(root)?;
    viewer.view_mut().camera.world_from_eye = camera(0.0);
    let started = Instant::now();
    while !viewer.is_settled() || viewer.frame_stamp().frame < 2 {
        let due = Instant::now() + FRAME;
        viewer.frame()?;
        viewer.work_until(due);
        ensure!(started.elapsed() < TIMEOUT, "the first view does not settle: {:?}", viewer.pager().map(|p| p.stats()));
    }
    let (served, merged) = (server.served(), merged(&viewer));
    let (mut frames, mut arrived, mut late) = (Frames::default(), 0, 0);
    let (start, mut due, mut known) = (Instant::now(), Instant::now(), merged);
    while start.elapsed().as_secs_f64() < seconds || frames.wall_ms.len() < MIN_FRAMES {
        viewer.view_mut().camera.world_from_eye = camera(start.elapsed().as_secs_f64());
        frames.measure(|| viewer.frame())?;
        due = (due + FRAME).max(Instant::now());
        viewer.work_until(due);
        late += u32::from(Instant::now().saturating_duration_since(due) > FRAME / 10);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let now = self::merged(&viewer);
        arrived += usize::from(std::mem::replace(&mut known, now) != now);
    }
    viewer.finish()?;
    if overlay && adapter == AdapterChoice::Software {
        ensure!(is_draped(&viewer.read_back()?), "the images are not drawn");
    }
    let (images, tiles) = (server.served() - served, known - merged);
    let failed = viewer.pager().map_or(0, |pager| pager.stats().failed);
    ensure!(tiles > 0 && failed == 0, "{tiles} tiles arrived, {failed} failed");
    let flown = frames.wall_ms.len();
    let last = || viewer.stats().iter().rev().take(flown);
    let empty = last().filter(|frame| frame.leaves == 0).count();
    ensure!(empty == 0, "{empty} frames drew nothing");
    let pipelines: u32 = last().map(|frame| frame.pipelines_created).sum();
    let of = |value: fn(&terrane::viewer::FrameStats) -> f64, p: f64| {
        round(percentile(&mut last().map(value).collect::<Vec<_>>(), p))
    };
    let Frames { mut wall_ms, mut cpu_ms } = frames;
    let missed = wall_ms.iter().filter(|ms| **ms > FRAME.as_secs_f64() * 1e3).count();
    let (median, slow) = (percentile(&mut wall_ms, 0.5), percentile(&mut wall_ms, 0.99));
    let (cpu_median, cpu_slow) = (percentile(&mut cpu_ms, 0.5), percentile(&mut cpu_ms, 0.99));
    Ok(json!({
        "bench": "overlays", "adapter": name, "overlay": if overlay { "arriving" } else { "none" },
        "frames": wall_ms.len(), "frames_with_arrivals": arrived, "late": late, "images": images, "merged": tiles,
        "frame_p50_ms": round(median), "frame_p99_ms": round(slow), "frame_max_ms": round(percentile(&mut wall_ms, 1.0)),
        "p99_to_p50": round(slow / median), "missed": missed,
        "cpu_p50_ms": round(cpu_median), "cpu_p99_ms": round(cpu_slow), "cpu_p99_to_p50": round(cpu_slow / cpu_median),
        "update_p99_ms": of(|f| f.update_ms, 0.99), "cull_p99_ms": of(|f| f.cull_ms, 0.99),
        "draw_p99_ms": of(|f| f.draw_ms, 0.99), "compile_p99_ms": of(|f| f.compile_ms, 0.99),
        "pipelines_created": pipelines,
    }))
}

/// The times of frames in milliseconds: by the clock, and of the processor on this thread.
#[derive(Default)]
struct Frames {
    wall_ms: Vec<f64>,
    cpu_ms: Vec<f64>,
}

impl Frames {
    fn measure<E>(&mut self, frame: impl FnOnce() -> Result<(), E>) -> Result<(), E> {
        let (start, cpu) = (Instant::now(), thread_s());
        let done = frame();
        self.cpu_ms.push((thread_s() - cpu) * 1e3);
        self.wall_ms.push(start.elapsed().as_secs_f64() * 1e3);
        done
    }
}

fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn merged(viewer: &Viewer) -> u64 {
    viewer.pager().map_or(0, |pager| pager.stats().merged)
}

/// Returns the camera's pose after a time in seconds.
fn camera(time_s: f64) -> DAffine3 {
    let latitude = LATITUDE_DEG.to_radians();
    let circle_m = WGS84.prime_vertical_radius_m(latitude) * latitude.cos();
    let at = |metres: f64, height_m: f64| Geodetic { longitude: metres / circle_m, latitude, height_m };
    let eye = at(SPEED_M_S * time_s, HEIGHT_M);
    let (position, up) = (WGS84.ecef(&eye), WGS84.up(&eye));
    let target: DVec3 = WGS84.ecef(&at(SPEED_M_S * time_s + LOOK_AT_M, 0.0));
    DAffine3::from_mat4(glam::dcamera::rh::view::look_at_mat4(position, target, up)).inverse()
}

/// Returns true if the lower half of a picture has the colours of the server's images, which are saturated.
fn is_draped(picture: &RgbaImage) -> bool {
    let ground = picture.enumerate_pixels().filter(|(_, y, _)| *y > SIZE_PX[1] / 2);
    let (mut saturated, mut all) = (0, 0);
    for (_, _, pixel) in ground {
        let [r, g, b, _] = pixel.0;
        saturated += u32::from(r.max(g).max(b) - r.min(g).min(b) > 30);
        all += 1;
    }
    2 * saturated > all
}

/// A map server on this machine. Dropping it ends its threads, once their connections are closed.
struct Server {
    url: String,
    shared: Arc<Shared>,
    /// Flights so far.
    flights: AtomicU64,
}

/// The data that the threads of connections share.
struct Shared {
    /// Encoded images.
    pictures: Vec<Vec<u8>>,
    served: AtomicU64,
    is_stopped: AtomicBool,
}

impl Server {
    fn start() -> Result<Self> {
        let pictures = (0..PICTURES).map(picture).collect::<Result<_>>()?;
        let shared = Shared { pictures, served: AtomicU64::new(0), is_stopped: AtomicBool::new(false) };
        let shared = Arc::new(shared);
        let listener = TcpListener::bind("127.0.0.1:0").context("cannot listen on 127.0.0.1")?;
        let url = format!("http://{}", listener.local_addr()?);
        let of_threads = shared.clone();
        let accept = move || {
            for stream in listener.incoming().flatten() {
                if of_threads.is_stopped.load(Ordering::Acquire) {
                    return;
                }
                let shared = of_threads.clone();
                // A client that closes its connection is not an error.
                std::thread::spawn(move || shared.serve(stream).ok());
            }
        };
        std::thread::Builder::new().name("map server".to_owned()).spawn(accept)?;
        Ok(Self { url, shared, flights: AtomicU64::new(0) })
    }

    fn flight(&self) -> u64 {
        self.flights.fetch_add(1, Ordering::Relaxed)
    }

    fn served(&self) -> u64 {
        self.shared.served.load(Ordering::Relaxed)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.is_stopped.store(true, Ordering::Release);
        // The thread looks at the flag when a connection arrives.
        drop(TcpStream::connect(self.url.trim_start_matches("http://")));
    }
}

impl Shared {
    /// Answers the requests of a connection.
    fn serve(&self, stream: TcpStream) -> std::io::Result<()> {
        stream.set_nodelay(true)?;
        let mut writer = stream.try_clone()?;
        let mut lines = BufReader::new(stream).lines();
        while let Some(request) = lines.next() {
            let request = request?;
            for header in lines.by_ref() {
                if header?.is_empty() {
                    break;
                }
            }
            let path = request.split(' ').nth(1).unwrap_or_default();
            let number = path.bytes().fold(0u32, |hash, byte| hash.wrapping_mul(31).wrapping_add(byte.into()));
            let picture = &self.pictures[(number % PICTURES) as usize];
            // Bytes after the end of a JPEG are ignored; they make each file differ from the others.
            let length = picture.len() + path.len();
            let mut answer =
                format!("HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\n\r\n").into_bytes();
            answer.extend_from_slice(picture);
            answer.extend_from_slice(path.as_bytes());
            writer.write_all(&answer)?;
            self.served.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }
}

/// Draws an image that is as costly to decode as a photo, in a colour of its own.
fn picture(number: u32) -> Result<Vec<u8>> {
    let hue = f64::from(number) / f64::from(PICTURES) * std::f64::consts::TAU;
    let channel = |shift: f64| 128.0 + 100.0 * (hue + shift).cos();
    let base = [0.0, 2.1, 4.2].map(channel);
    let mut random = 1 + number;
    let mut pixels = Vec::with_capacity((TILE_PX * TILE_PX * 3) as usize);
    for i in 0..TILE_PX * TILE_PX {
        // Grain, and a frame that shows the edges of tiles.
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let grain = f64::from(random >> 27) - 16.0;
        let is_edge = i % TILE_PX < 2 || i / TILE_PX < 2;
        pixels.extend(base.map(|value| if is_edge { 20 } else { (value + grain).clamp(0.0, 255.0) as u8 }));
    }
    let mut jpeg = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, 80);
    encoder.encode(&pixels, TILE_PX, TILE_PX, ExtendedColorType::Rgb8).context("JPEG")?;
    Ok(jpeg)
}
