//! Overlays of handlers: over each view, in any context, and on a device that replaces a lost one. Images need a GPU; a
//! software adapter suffices.

use std::path::Path;
use terrane::scene::Sky;

use image::RgbaImage;
use kit::skip::or_skip;
use kit::viewer::{Settle, offscreen};

use terrane::gpu::{ContextTraits, GraphicsContext};
use terrane::viewer::handlers::{StatsHandler, StatsPage};
use terrane::viewer::{CompositeViewer, ContextId, ThreadingModel, ViewArea, Viewer, ViewerConfig};

const BACKGROUND: [u8; 3] = [200, 40, 40];

fn config(threading: ThreadingModel, size_px: [u32; 2]) -> ViewerConfig {
    ViewerConfig { size_px, threading, adapter: kit::adapter(), max_contexts: 3, ..ViewerConfig::default() }
}

fn stats() -> StatsHandler {
    StatsHandler { page: StatsPage::FrameRate }
}

fn keep(name: &str, picture: &RgbaImage) {
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(Path::new(&folder).join(format!("overlay-{name}.png"))).unwrap();
    }
}

/// Returns the pixels of a part that are not background, and how many of them are as bright as text.
fn over(picture: &RgbaImage, [x, y, width, height]: [u32; 4]) -> [usize; 2] {
    let part = image::imageops::crop_imm(picture, x, y, width, height).to_image();
    let is_over = part.pixels().filter(|p| p.0[..3] != BACKGROUND);
    let is_text = |p: &&image::Rgba<u8>| p.0[..3].iter().all(|c| *c > 100);
    [is_over.clone().count(), is_over.filter(is_text).count()]
}

fn picture(viewer: &mut CompositeViewer, context: ContextId) -> RgbaImage {
    // A page fades in.
    viewer.settle(16);
    viewer.read_back(context).unwrap()
}

#[test]
fn each_view_has_an_overlay_over_its_part() {
    use ThreadingModel::{CullDrawThreadPerContext, CullThreadPerCameraDrawThreadPerContext};
    let models: &[ThreadingModel] = match kit::long_tests() {
        true => &ThreadingModel::ALL,
        false => &[CullDrawThreadPerContext, CullThreadPerCameraDrawThreadPerContext],
    };
    for &threading in models {
        let config = config(threading, [400, 160]);
        let Some(context) = or_skip(GraphicsContext::new_offscreen(&config.traits())) else { return };
        let mut viewer = CompositeViewer::new(&config).unwrap();
        let first = viewer.open_context(context).unwrap();
        let traits = ContextTraits { size_px: [240, 120], ..config.traits() };
        // One context is on the same device, and one has a separate device.
        let second = viewer.open_offscreen_on(first, &traits).unwrap();
        let third = viewer.open_context(GraphicsContext::new_offscreen(&traits).unwrap()).unwrap();
        let scene = viewer.add_scene().unwrap();
        let halves = [ViewArea::Shares([0.0, 0.0, 0.5, 1.0]), ViewArea::Shares([0.5, 0.0, 0.5, 1.0])];
        let parts = [(first, halves[0]), (first, halves[1]), (second, ViewArea::Whole), (third, ViewArea::Whole)];
        let views = parts.map(|(context, part)| viewer.add_view(scene, context, part).unwrap());
        for id in views {
            let view = viewer.view_mut(id).unwrap();
            view.environment.sky = Sky::Background(BACKGROUND);
            view.environment.fog.enabled = false;
        }
        let [left, right, all] = [[0, 0, 200, 160], [200, 0, 200, 160], [0, 0, 240, 120]];
        let places = [(first, left), (first, right), (second, all), (third, all)];
        // The views switch their overlay on one after the other.
        for shown in 0..=views.len() {
            let pictures = [first, second, third].map(|context| (context, picture(&mut viewer, context)));
            for (place, (context, part)) in places.into_iter().enumerate() {
                let picture = &pictures.iter().find(|(of, _)| *of == context).unwrap().1;
                keep(&format!("{threading}-{shown}-{}", if place < 2 { 0 } else { place }), picture);
                let [pixels, text] = over(picture, part);
                if place < shown {
                    let most = (part[2] * part[3]) as usize;
                    assert!(
                        pixels > 1000 && pixels < most && text > 30,
                        "{threading}: {place} of {shown}: {pixels}, {text}"
                    );
                    // The overlay is at the upper left of its part.
                    assert!(over(picture, [part[0], part[1], 60, 30])[0] > 1000, "{threading}: {place} of {shown}");
                } else {
                    assert_eq!(pixels, 0, "{threading}: {place} of {shown}");
                }
            }
            if let Some(id) = views.get(shown) {
                viewer.view_mut(*id).unwrap().add_event_handler(stats());
            }
        }
        // The overlay is removed with its view. A smaller window has no room for it, and later it is drawn again.
        viewer.remove_view(views[0]).unwrap();
        let without = picture(&mut viewer, first);
        assert_eq!(over(&without, left)[1], 0, "{threading}: a removed view");
        assert!(over(&without, right)[1] > 30, "{threading}: the other view keeps its overlay");
        viewer.resize_context(second, [1, 1]).unwrap();
        viewer.frame().unwrap();
        viewer.resize_context(second, [240, 120]).unwrap();
        assert!(over(&picture(&mut viewer, second), all)[1] > 30, "{threading}: the old size again");
        // Closing a context removes the overlays of its views; the others stay.
        viewer.close_context(third).unwrap();
        assert!(over(&picture(&mut viewer, second), all)[1] > 30, "{threading}: after another closed");
    }
}

#[test]
fn overlay_is_drawn_on_a_new_device() {
    for threading in ThreadingModel::ALL {
        let Some(mut viewer) = offscreen(&config(threading, [240, 120])) else { return };
        viewer.view_mut().environment.sky = Sky::Background(BACKGROUND);
        viewer.view_mut().environment.fog.enabled = false;
        viewer.view_mut().add_event_handler(stats());
        let context = viewer.context();
        let shown = |viewer: &mut Viewer, name: &str| {
            viewer.settle(16);
            viewer.finish().unwrap();
            let picture = viewer.read_back().unwrap();
            keep(&format!("{threading}-{name}"), &picture);
            over(&picture, [0, 0, 240, 120])
        };
        let before = shown(&mut viewer, "before");
        assert!(before[0] > 1000 && before[1] > 30, "{threading}: {before:?}");
        viewer.composite_mut().lose_device(context).unwrap();
        viewer.settle(16);
        let after = shown(&mut viewer, "after");
        assert!(after[0] > 1000 && after[1] > 30, "{threading}: {after:?} after the loss, {before:?} before");
    }
}
