//! Image sequences show the correct image at each time, even if images load slowly, fail or are paged out. Needs a GPU;
//! a software adapter suffices.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DVec3;
use kit::viewer::offscreen;

use terrane::gpu::GraphicsContext;
use terrane::pager::{
    ImagePager, ImagePagerConfig, ImageSequence, LoopingMode, SequenceImage, SequenceMode, StreamStatus,
};
use terrane::scene::{Drawable, Environment, Material, Mesh, Node, Page, PageId, Sky, Texture};
use terrane::state::{Attribute, Mode, StateSet, StateValue, TextureBinding};
use terrane::viewer::{Slave, ThreadingModel, Viewer, ViewerConfig};

/// Returns the color of image `k`.
fn shade(k: usize) -> [u8; 3] {
    [(20 + 7 * (k % 32)) as u8, (30 + 5 * (k / 32)) as u8, 200]
}

fn write_images(folder: &Path, count: usize, side: u32) -> Vec<String> {
    let write = |k: usize| {
        let file = folder.join(format!("{k:04}.png"));
        image::RgbImage::from_pixel(side, side, image::Rgb(shade(k))).save(&file).unwrap();
        file.display().to_string()
    };
    (0..count).map(write).collect()
}

/// Opens a viewer with sequences side by side, each on a square of the image.
struct Theatre {
    viewer: Viewer,
    root: PageId,
    count: u32,
}

const SIDE_PX: u32 = 64;

impl Theatre {
    /// Returns `None`, and skips the test with a message, without an adapter; with REQUIRE_GPU=1 that is a failure.
    fn open(sequences: &[&ImageSequence], pager: ImagePagerConfig, threading: ThreadingModel) -> Option<Self> {
        let count = sequences.len() as u32;
        let config = ViewerConfig {
            size_px: [SIDE_PX * count, SIDE_PX],
            adapter: kit::adapter(),
            threading,
            ..ViewerConfig::default()
        };
        let mut viewer = offscreen(&config)?;
        let scene = viewer.scene_id();
        viewer.composite_mut().set_image_pager(scene, ImagePager::new(pager).unwrap()).unwrap();
        let mut screens = Vec::new();
        for (place, sequence) in sequences.iter().enumerate() {
            viewer.add_image_sequence(sequence).unwrap();
            let shows = StateSet::default()
                .with_mode(Mode::Lighting, StateValue::OFF)
                .with_mode(Mode::Fog, StateValue::OFF)
                .with(Attribute::Texture(0, TextureBinding::new(sequence.texture())));
            let corner = DVec3::new(2.0 * place as f64 - f64::from(count), 0.0, -1.0);
            let mesh = Mesh::rectangle(corner, DVec3::new(2.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 2.0));
            let screen = Node::geode(vec![Drawable::new(mesh.into(), Material { unlit: true, ..Material::default() })]);
            screens.push(screen.with_state_set(Arc::new(shows)));
        }
        let root = viewer.add_root(Page::from_node(Node::group(screens)).unwrap()).unwrap();
        // The angle of view is that of the width.
        viewer.view_mut().camera.look_at(DVec3::new(0.0, -1.5 * f64::from(count), 0.0), DVec3::ZERO, DVec3::Z);
        viewer.view_mut().environment =
            Environment { sky: Sky::Background([0, 0, 0]), exposure: None, ..Environment::default() };
        // The screens are uploaded in the first frames, whose number depends on the time budget.
        let is_drawn = (0..500).any(|_| {
            viewer.frame_at(0.0).unwrap();
            viewer.finish().unwrap();
            viewer.stats().last().is_some_and(|frame| frame.leaves == count)
        });
        assert!(is_drawn);
        Some(Self { viewer, root, count })
    }

    /// Returns the color in the middle of each square at a time.
    fn look(&mut self, time_s: f64) -> Vec<[u8; 3]> {
        self.viewer.frame_at(time_s).unwrap();
        let picture = self.viewer.read_back().unwrap();
        (0..self.count)
            .map(|k| {
                let [r, g, b, _] = picture.get_pixel(SIDE_PX * k + SIDE_PX / 2, SIDE_PX / 2).0;
                [r, g, b]
            })
            .collect()
    }

    /// Returns which of `count` images each square shows.
    fn all_shown(&mut self, time_s: f64, count: usize) -> Vec<Option<usize>> {
        let is = |k: usize, seen: [u8; 3]| shade(k).iter().zip(seen).all(|(a, b)| a.abs_diff(b) <= 2);
        self.look(time_s).into_iter().map(|seen| (0..count).find(|k| is(*k, seen))).collect()
    }

    /// Returns which of `count` images the first square shows.
    fn shown(&mut self, time_s: f64, count: usize) -> Option<usize> {
        self.all_shown(time_s, count)[0]
    }

    fn pager(&self) -> &ImagePager {
        self.viewer.image_pager().unwrap()
    }
}

fn blocking() -> ImagePagerConfig {
    ImagePagerConfig { blocking: true, ..ImagePagerConfig::default() }
}

fn playing(files: Vec<String>, looping: LoopingMode, length_s: f64) -> ImageSequence {
    let sequence = ImageSequence::from_files("test", files);
    sequence.set_looping_mode(looping);
    sequence.set_length(length_s);
    sequence.play();
    sequence
}

#[test]
fn looping_modes_show_the_correct_images_in_all_threading_models() {
    let folder = tempfile::tempdir().unwrap();
    let files = write_images(folder.path(), 4, 8);
    let expected: [(LoopingMode, [usize; 10]); 3] = [
        (LoopingMode::Looping, [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]),
        (LoopingMode::NoLooping, [0, 1, 2, 3, 3, 3, 3, 3, 3, 3]),
        (LoopingMode::Swing, [0, 1, 2, 3, 3, 2, 1, 0, 0, 1]),
    ];
    for threading in ThreadingModel::ALL {
        let sequences = expected.map(|(looping, _)| {
            let sequence = playing(files.clone(), looping, 4.0);
            sequence.seek(0.5);
            sequence
        });
        let Some(mut theatre) = Theatre::open(&sequences.each_ref(), blocking(), threading) else { return };
        for k in 0..10 {
            let seen = theatre.all_shown(k as f64, 4);
            assert_eq!(seen, expected.map(|(_, images)| Some(images[k])), "at {k} s, {threading}");
        }
    }
}

#[test]
fn pause_seek_and_time_multiplier_work() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = playing(write_images(folder.path(), 10, 8), LoopingMode::Looping, 10.0);
    let Some(mut theatre) = Theatre::open(&[&sequence], blocking(), ThreadingModel::default()) else { return };
    sequence.seek(0.5);
    assert_eq!([0.0, 2.0].map(|t| theatre.shown(t, 10)), [Some(0), Some(2)]);
    assert!(theatre.viewer.check_need_to_do_frame(), "a playing sequence requests frames");
    sequence.pause();
    assert_eq!([3.0, 60.0].map(|t| theatre.shown(t, 10)), [Some(2), Some(2)]);
    assert!(!theatre.viewer.check_need_to_do_frame(), "a paused one does not");
    sequence.seek(7.5);
    assert_eq!(theatre.shown(61.0, 10), Some(7));
    sequence.play();
    sequence.set_time_multiplier(-2.0);
    assert_eq!([61.0, 62.0, 63.0].map(|t| theatre.shown(t, 10)), [Some(7), Some(5), Some(3)]);
    sequence.rewind();
    assert_eq!(theatre.shown(64.0, 10), Some(0));
    assert_eq!(sequence.status(), StreamStatus::Playing);
}

#[test]
fn missing_file_keeps_the_last_image_and_is_one_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = write_images(folder.path(), 4, 8);
    files[2] = folder.path().join("missing.png").display().to_string();
    std::fs::write(folder.path().join("0003.png"), b"<html>not found</html>").unwrap();
    let sequence = playing(files, LoopingMode::Looping, 4.0);
    sequence.seek(0.5);
    let Some(mut theatre) = Theatre::open(&[&sequence], blocking(), ThreadingModel::default()) else { return };
    let seen: Vec<_> = (0..9).map(|k| theatre.shown(f64::from(k), 4)).collect();
    assert_eq!(seen, [0, 1, 1, 1, 0, 1, 1, 1, 0].map(Some));
    let (stats, errors) = (*theatre.pager().stats(), theatre.pager().errors());
    assert_eq!((stats.failed, stats.loaded, errors.len()), (2, 2, 2), "each file is read once: {stats:?} {errors:?}");
    assert!(errors.iter().any(|e| e.uri.ends_with("missing.png") && e.count == 1), "{errors:?}");
    let report = theatre.viewer.report().unwrap();
    assert_eq!(report.images.map(|i| (i.loaded, i.failed)), Some((2, 2)));
    assert_eq!(report.errors.len(), 2);
}

#[test]
fn thousand_images_stay_within_a_budget_of_eight() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = playing(write_images(folder.path(), 1000, 16), LoopingMode::NoLooping, 1000.0);
    sequence.set_pre_load_frames(5);
    let one: u64 = [16u64, 8, 4, 2, 1].iter().map(|s| s * s * 4).sum();
    let config = ImagePagerConfig { max_images: 8, ..blocking() };
    let Some(mut theatre) = Theatre::open(&[&sequence], config, ThreadingModel::SingleThreaded) else { return };
    for k in 0..1000usize {
        let time_s = k as f64 + 0.5;
        if k % 50 == 0 {
            assert_eq!(theatre.shown(time_s, 1000), Some(k));
        } else {
            theatre.viewer.frame_at(time_s).unwrap();
        }
        let stats = *theatre.pager().stats();
        assert!(stats.images + stats.in_flight <= 8 && stats.bytes <= 8 * one, "image {k}: {stats:?}");
    }
    let stats = *theatre.pager().stats();
    assert!(stats.loaded >= 1000 && stats.loaded <= 1100, "too many images were read twice: {stats:?}");
    assert!(stats.images_peak <= 8 && stats.bytes_peak <= 8 * one && stats.paged_out >= 992, "{stats:?}");
    assert_eq!((stats.shown, stats.late, stats.failed), (1000, 0, 0));

    // Bytes are limited like the number, and preloaded images as well.
    let sequence = playing(write_images(folder.path(), 100, 16), LoopingMode::Looping, 100.0);
    sequence.set_mode(SequenceMode::PreLoadAllImages);
    let config = ImagePagerConfig { max_bytes: 10 * one, ..blocking() };
    let Some(mut theatre) = Theatre::open(&[&sequence], config, ThreadingModel::SingleThreaded) else { return };
    for k in 0..250usize {
        theatre.viewer.frame_at(k as f64 + 0.5).unwrap();
        let stats = *theatre.pager().stats();
        assert!(stats.bytes <= 10 * one, "{stats:?}");
    }
    assert_eq!(theatre.shown(250.5, 100), Some(50));
}

/// Regression: the images evicted each other, and the frame that waited for both never ended.
#[test]
fn images_that_do_not_fit_together_do_not_block_the_frame() {
    let folder = tempfile::tempdir().unwrap();
    let files = write_images(folder.path(), 2, 64);
    let sequences = [0, 1].map(|k| playing(vec![files[k].clone()], LoopingMode::Looping, 1.0));
    let (done, ended) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let all: Vec<_> = sequences.iter().collect();
        // The budget holds an image with its mips, but not two.
        let config = ImagePagerConfig { max_bytes: 64 * 64 * 4 * 3 / 2, ..blocking() };
        let seen = Theatre::open(&all, config, ThreadingModel::SingleThreaded).map(|mut theatre| {
            let shown = theatre.look(1.0);
            (shown, *theatre.pager().stats())
        });
        let _ = done.send(seen);
    });
    let Some((shown, stats)) = ended.recv_timeout(kit::MAX_WAIT).expect("a frame ends") else { return };
    let is_there = |k: usize| shade(k).iter().zip(shown[k]).all(|(a, b)| a.abs_diff(b) <= 2);
    assert!(is_there(0) || is_there(1), "{shown:?}");
    assert!(stats.bytes_peak <= 64 * 64 * 4 * 3 / 2 && stats.failed == 0, "{stats:?}");
}

/// Regression: each loaded image evicted the other, which was requested again, endlessly.
#[test]
fn images_of_unequal_sizes_that_do_not_fit_together_do_not_block() {
    let folder = tempfile::tempdir().unwrap();
    let (done, ended) = std::sync::mpsc::channel();
    // All levels of both together have 79,488 bytes.
    let max_bytes = 79_000;
    let sequences = [("0000.png", 64), ("0001.png", 104)].map(|(name, side)| {
        let file = folder.path().join(name);
        image::RgbImage::from_pixel(side, side, image::Rgb(shade(side as usize))).save(&file).unwrap();
        playing(vec![file.display().to_string()], LoopingMode::Looping, 1.0)
    });
    std::thread::spawn(move || {
        let all: Vec<_> = sequences.iter().collect();
        let config = ImagePagerConfig { max_bytes, ..blocking() };
        let seen = Theatre::open(&all, config, ThreadingModel::SingleThreaded).map(|mut theatre| {
            let shown = theatre.look(1.0);
            (shown, *theatre.pager().stats())
        });
        let _ = done.send(seen);
    });
    let Some((shown, stats)) = ended.recv_timeout(kit::MAX_WAIT).expect("a frame ends") else { return };
    assert!(shade(64).iter().zip(shown[0]).all(|(a, b)| a.abs_diff(b) <= 2), "{shown:?}");
    assert_eq!((stats.loaded, stats.paged_out, stats.images, stats.failed), (2, 1, 1, 0), "{stats:?}");
    assert!(stats.bytes_peak <= max_bytes, "{stats:?}");
}

#[test]
fn synchronous_sequences_share_files_and_stop_loading_when_invisible() {
    let folder = tempfile::tempdir().unwrap();
    let files = write_images(folder.path(), 6, 8);
    let sequences = [(); 3].map(|()| playing(files.clone(), LoopingMode::Looping, 6.0));
    sequences[2].set_mode(SequenceMode::PageAndDiscardUsedImages);
    let all: Vec<_> = sequences.iter().collect();
    let Some(mut theatre) = Theatre::open(&all, blocking(), ThreadingModel::default()) else { return };
    for k in 0..12 {
        let seen = theatre.look(f64::from(k));
        assert!(seen[0] == seen[1] && seen[1] == seen[2], "at {k}: {seen:?}");
    }
    assert_eq!(theatre.pager().stats().loaded, 6, "a file is read once for all sequences");
    theatre.viewer.remove_root(theatre.root);
    for k in 12..16 {
        theatre.viewer.frame_at(f64::from(k)).unwrap();
    }
    let until = Instant::now() + kit::MAX_WAIT;
    while theatre.viewer.check_need_to_do_frame() {
        assert!(Instant::now() < until, "invisible sequences request frames");
        theatre.viewer.frame_at(20.0).unwrap();
    }
}

#[test]
fn images_of_the_application_and_of_other_sizes_are_shown() {
    let image = |k: usize, side: u32| {
        let [r, g, b] = shade(k);
        let texels = [r, g, b, 255].repeat((side * side) as usize);
        SequenceImage::Image(Arc::new(Texture::rgba8(side, side, vec![texels])))
    };
    let sequence = ImageSequence::new("own", vec![image(0, 4), image(1, 16), image(2, 2)]);
    sequence.set_frame_rate(1.0);
    sequence.play();
    let Some(mut theatre) = Theatre::open(&[&sequence], blocking(), ThreadingModel::default()) else { return };
    assert_eq!([0.0, 1.0, 2.0, 3.0].map(|t| theatre.shown(t, 3)), [Some(0), Some(1), Some(2), Some(0)]);
    // An unsupported image is an error, and the last image stays.
    let broken = Texture::rgba8(4, 4, vec![vec![0; 3]]);
    sequence.add_image(SequenceImage::Image(Arc::new(broken)));
    sequence.set_frame_rate(1.0);
    sequence.seek(2.5);
    assert_eq!([10.0, 11.0].map(|t| theatre.shown(t, 3)), [Some(2), Some(2)]);
    assert_eq!(theatre.viewer.report().unwrap().errors.len(), 1);
}

#[test]
fn without_blocking_frames_continue_and_images_are_shown_when_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = playing(write_images(folder.path(), 30, 8), LoopingMode::Looping, 30.0);
    let config = ImagePagerConfig::default();
    let Some(mut theatre) = Theatre::open(&[&sequence], config, ThreadingModel::default()) else { return };
    let until = Instant::now() + kit::MAX_WAIT;
    let mut time_s = 0.0;
    while theatre.pager().stats().shown < 30 {
        assert!(Instant::now() < until, "{:?}", theatre.pager().stats());
        theatre.viewer.frame_at(time_s).unwrap();
        time_s += 0.25;
        std::thread::sleep(Duration::from_millis(1));
    }
    sequence.pause();
    let expected = |position_s: f64| Some((position_s.rem_euclid(30.0) + 1e-6) as usize);
    while theatre.viewer.check_need_to_do_frame() {
        theatre.viewer.frame_at(time_s).unwrap();
    }
    assert_eq!(theatre.shown(time_s, 30), expected(sequence.position()));
}

#[cfg(feature = "http")]
#[test]
fn images_load_over_http_and_a_hung_server_delays_no_other() {
    use kit::server::{How, Reply, Request, Server};
    use terrane::fetch::HttpConfig;
    let folder = tempfile::tempdir().unwrap();
    let bodies: Vec<Vec<u8>> = write_images(folder.path(), 4, 8).iter().map(|f| std::fs::read(f).unwrap()).collect();
    let server = Server::start(move |request: &Request| {
        let number = request.path().trim_matches(|c: char| !c.is_ascii_digit()).parse::<usize>().unwrap_or(9);
        match bodies.get(number) {
            // The third server never answers.
            Some(_) if number == 2 => Reply::ok("").how(How::Silent),
            Some(body) => Reply::ok(body.clone()),
            None => Reply::new(404, ""),
        }
    });
    let sequence = playing((0..4).map(|k| format!("{}/{k}.png", server.url)).collect(), LoopingMode::Looping, 4.0);
    let http = HttpConfig { first_byte_timeout: Duration::from_secs(60), ..HttpConfig::default() };
    let config = ImagePagerConfig { http, ..ImagePagerConfig::default() };
    let Some(mut theatre) = Theatre::open(&[&sequence], config, ThreadingModel::default()) else { return };
    sequence.pause();
    let until = Instant::now() + kit::MAX_WAIT;
    for (position_s, shown) in [(0.5, 0), (1.5, 1), (3.5, 3), (0.5, 0)] {
        sequence.seek(position_s);
        while theatre.shown(1.0, 4) != Some(shown) {
            assert!(Instant::now() < until, "{:?} {:?}", theatre.pager().stats(), theatre.pager().errors());
            std::thread::sleep(Duration::from_millis(2));
        }
    }
    sequence.seek(2.5);
    let start = Instant::now();
    for _ in 0..20 {
        assert_eq!(theatre.shown(1.0, 4), Some(0), "the last good image stays");
    }
    let stats = *theatre.pager().stats();
    assert!(stats.late >= 20 && stats.in_flight == 1 && stats.loaded == 3, "{stats:?}");
    drop(theatre);
    assert!(start.elapsed() < Duration::from_secs(20), "dropping does not wait for the server: {:?}", start.elapsed());
}

/// Threads share one client and the directory of an archive. Regression: each had separate ones.
#[cfg(feature = "http")]
#[test]
fn threads_share_a_client() {
    use std::io::Write as _;
    let folder = tempfile::tempdir().unwrap();
    let mut archive = zip::write::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (k, file) in write_images(folder.path(), 8, 8).iter().enumerate() {
        archive.start_file(format!("{k}.png"), zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(&std::fs::read(file).unwrap()).unwrap();
    }
    let bytes = archive.finish().unwrap().into_inner();
    let delay = Duration::from_millis(50);
    let server = kit::server::Server::start(move |r| {
        kit::server::Reply { delay, ..kit::server::Reply::ok(bytes.clone()) }.ranged(r)
    });
    let sequence =
        playing((0..8).map(|k| format!("{}/a.zip/{k}.png", server.url)).collect(), LoopingMode::Looping, 8.0);
    let Some(mut theatre) = Theatre::open(&[&sequence], ImagePagerConfig::default(), ThreadingModel::default()) else {
        return;
    };
    let end = Instant::now() + kit::MAX_WAIT;
    while theatre.pager().stats().loaded < 8 {
        assert!(Instant::now() < end, "{:?} {:?}", theatre.pager().stats(), theatre.pager().errors());
        theatre.viewer.frame_at(1.0).unwrap();
    }
    let directories = server.seen().iter().filter(|r| r.header("range").unwrap().starts_with("bytes=-")).count();
    assert_eq!((directories, server.count()), (1, 9));
}

/// Three images of a discarding sequence, one thread, and a server that does not answer the first request for the
/// second one.
#[cfg(feature = "http")]
fn with_a_silent_server(check: impl FnOnce(&mut Theatre, &ImageSequence, &dyn Fn(usize) -> bool)) {
    use kit::server::{How, Reply, Server};
    use terrane::fetch::HttpConfig;
    let folder = tempfile::tempdir().unwrap();
    let bodies: Vec<Vec<u8>> = write_images(folder.path(), 3, 8).iter().map(|f| std::fs::read(f).unwrap()).collect();
    let server = Server::start(move |request| match request.path() {
        "/1.png" if request.nth == 0 => Reply::ok("").how(How::Silent),
        path => Reply::ok(bodies[path[1..2].parse::<usize>().unwrap()].clone()),
    });
    let sequence = playing((0..3).map(|k| format!("{}/{k}.png", server.url)).collect(), LoopingMode::Looping, 3.0);
    sequence.set_mode(SequenceMode::PageAndDiscardUsedImages);
    sequence.set_pre_load_frames(0);
    let long = Duration::from_secs(600);
    let http = HttpConfig { first_byte_timeout: long, total_timeout: long, ..HttpConfig::default() };
    // There is one thread.
    let config = ImagePagerConfig { threads: 1, http, ..ImagePagerConfig::default() };
    let Some(mut theatre) = Theatre::open(&[&sequence], config, ThreadingModel::default()) else { return };
    let asked = |nth: usize| server.seen().iter().filter(|r| r.path() == "/1.png").count() == nth;
    check(&mut theatre, &sequence, &asked);
}

/// Draws frames at given times until a condition holds.
#[cfg(feature = "http")]
fn frames_until(theatre: &mut Theatre, time_s: f64, is_so: impl Fn(Option<usize>) -> bool) {
    let end = Instant::now() + kit::MAX_WAIT;
    while !is_so(theatre.shown(time_s, 3)) {
        assert!(Instant::now() < end, "{:?} {:?}", theatre.pager().stats(), theatre.pager().errors());
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Regression: it occupied a thread until the timeout of the server.
#[cfg(feature = "http")]
#[test]
fn unwanted_image_is_cancelled() {
    with_a_silent_server(|theatre, sequence, asked| {
        let mut until = |position_s: f64, is_so: &dyn Fn(Option<usize>) -> bool| {
            sequence.seek(position_s);
            frames_until(theatre, 1.0, is_so);
        };
        sequence.pause();
        until(0.5, &|shown| shown == Some(0));
        until(1.5, &|shown| shown == Some(0) && asked(1));
        until(2.5, &|shown| shown == Some(2));
        until(1.5, &|shown| shown == Some(1) && asked(2));
        let stats = theatre.pager().stats();
        assert_eq!((stats.cancelled, stats.failed, stats.loaded), (1, 0, 3), "{:?}", theatre.pager().errors());
    });
}

/// A sequence waits for a late image, for a limited time.
#[cfg(feature = "http")]
#[test]
fn image_that_is_late_for_long_is_given_up() {
    with_a_silent_server(|theatre, _, asked| {
        frames_until(theatre, 0.5, |shown| shown == Some(0));
        frames_until(theatre, 1.5, |shown| shown == Some(0) && asked(1));
        frames_until(theatre, 2.5, |shown| shown == Some(2));
        frames_until(theatre, 4.5, |shown| shown == Some(1) && asked(2));
        let stats = theatre.pager().stats();
        assert_eq!((stats.cancelled, stats.failed, stats.loaded), (1, 0, 3), "{:?}", theatre.pager().errors());
    });
}

#[test]
fn context_opened_later_shows_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = playing(write_images(folder.path(), 4, 8), LoopingMode::Looping, 4.0);
    let config = ViewerConfig {
        size_px: [SIDE_PX, SIDE_PX],
        adapter: kit::adapter(),
        max_contexts: 2,
        ..ViewerConfig::default()
    };
    let Some(theatre) = Theatre::open(&[&sequence], blocking(), ThreadingModel::default()) else { return };
    drop(theatre);
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    let scene = viewer.scene_id();
    viewer.composite_mut().set_image_pager(scene, ImagePager::new(blocking()).unwrap()).unwrap();
    viewer.add_image_sequence(&sequence).unwrap();
    let shows = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(sequence.texture())));
    let mesh = Mesh::rectangle(DVec3::new(-1.0, 0.0, -1.0), DVec3::new(2.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 2.0));
    let screen = Node::geode(vec![Drawable::new(mesh.into(), Material { unlit: true, ..Material::default() })]);
    viewer.add_root(Page::from_node(screen.with_state_set(Arc::new(shows))).unwrap()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -1.5, 0.0), DVec3::ZERO, DVec3::Z);
    viewer.view_mut().environment =
        Environment { sky: Sky::Background([0, 0, 0]), exposure: None, ..Environment::default() };
    sequence.rewind();
    for time_s in [0.0, 1.5] {
        viewer.frame_at(time_s).unwrap();
    }
    sequence.pause();
    viewer.frame_at(2.0).unwrap();
    let second = viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    viewer.add_slave(Slave::new(second)).unwrap();
    for _ in 0..5 {
        viewer.frame_at(2.0).unwrap();
        viewer.finish().unwrap();
    }
    let middle = |picture: image::RgbaImage| picture.get_pixel(SIDE_PX / 2, SIDE_PX / 2).0;
    let (first, other) =
        (middle(viewer.read_back().unwrap()), middle(viewer.composite_mut().read_back(second).unwrap()));
    assert_eq!(first, other);
    let [r, g, b] = shade(1);
    assert!([r, g, b].iter().zip(first).all(|(a, b)| a.abs_diff(b) <= 2), "{first:?}");
}
