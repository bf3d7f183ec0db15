//! State sets that the application changes: shown at once, or when another thread has created their pipelines.

use std::sync::Arc;

use glam::DVec3;
use image::RgbaImage;
use kit::rig::plain;
use kit::shadows::{ground, small_maps};
use kit::shapes::ball;
use kit::viewer::{Settle, offscreen};
use terrane::pager::PagerConfig;
use terrane::scene::{Environment, Node, Page, PageId};
use terrane::state::{Attribute, ColorMask, StateSet, Stencil, SurfaceMaterial};
use terrane::viewer::{NewStates, ThreadingModel, Viewer, ViewerConfig};

/// A viewer on the ground and a ball, and the state set of the ball.
struct Run {
    viewer: Viewer,
    root: PageId,
    set: Arc<StateSet>,
}

impl Run {
    fn new(new_states: NewStates, threading: ThreadingModel, blocking: bool) -> Option<Self> {
        let config = ViewerConfig {
            size_px: [64, 48],
            threading,
            adapter: kit::adapter(),
            validation: false,
            new_states,
            pager: PagerConfig { blocking, ..PagerConfig::default() },
            ..ViewerConfig::default()
        };
        let mut viewer = offscreen(&config)?;
        let set = Arc::new(StateSet::default());
        let balls = Node::group(vec![ball(DVec3::new(0.0, 0.0, 1.0), 1.0, [0.9, 0.3, 0.2, 1.0])]);
        let nodes = vec![Node::geode(vec![ground(20.0)]), balls.with_state_set(set.clone())];
        let root = viewer.add_root(Page::from_node(Node::group(nodes)).unwrap()).unwrap();
        viewer.view_mut().camera.look_at(DVec3::new(0.0, -7.0, 5.0), DVec3::ZERO, DVec3::Z);
        let sun_direction = DVec3::new(0.5, 0.2, 1.0).normalize();
        viewer.view_mut().environment = Environment { sun_direction, shadows: small_maps(), ..plain() };
        viewer.settle(3);
        Some(Self { viewer, root, set })
    }

    /// Gives the ball another state, which also changes how it casts its shadow.
    fn change(&mut self, set: StateSet) {
        let new = Arc::new(set);
        assert!(self.viewer.scene_mut().replace_state_set(self.root, &self.set, new.clone()));
        self.set = new;
        self.viewer.view_mut().request_redraw();
    }

    fn picture(&mut self) -> RgbaImage {
        self.viewer.want_picture();
        self.viewer.frame().unwrap();
        self.viewer.finish().unwrap();
        self.viewer.take_pictures().pop().unwrap().1
    }

    /// Draws while a frame is needed; returns the images, of which the last is drawn when nothing changes any more.
    fn pictures(&mut self) -> Vec<RgbaImage> {
        let mut pictures = Vec::new();
        while self.viewer.check_need_to_do_frame() {
            pictures.push(self.picture());
            assert!(pictures.len() < 20_000, "it does not rest");
        }
        assert!(self.viewer.is_settled());
        pictures.push(self.picture());
        pictures
    }

    /// Gives the ball another state. Returns the image before, the images after, and the numbers of pipelines that these frames and
    /// the pipeline thread have created.
    fn changed(&mut self, set: StateSet) -> (RgbaImage, Vec<RgbaImage>, [u32; 2]) {
        let before = self.picture();
        let frame = self.viewer.frame_stamp().frame;
        self.change(set);
        let pictures = self.pictures();
        (before, pictures, self.created(frame))
    }

    fn created(&self, after: u32) -> [u32; 2] {
        let frames = || self.viewer.stats().iter().filter(|s| s.frame > after);
        [frames().map(|s| s.pipelines_created).sum(), frames().map(|s| s.pipelines_created_by_thread).sum()]
    }
}

fn new_state() -> StateSet {
    StateSet::default()
        .with(Attribute::SurfaceMaterial(SurfaceMaterial::default()))
        .with(Attribute::ColorMask(ColorMask([true, true, false, true])))
}

#[test]
fn new_state_is_shown_when_its_pipelines_are_there_and_no_frame_creates_them() {
    for threading in [ThreadingModel::SingleThreaded, ThreadingModel::DrawThreadPerContext] {
        let Some(mut at_once) = Run::new(NewStates::AtOnce, threading, false) else { return };
        let mut later = Run::new(NewStates::WhenReady, threading, false).unwrap();
        let (shown, expected, [by_frames, by_thread]) = at_once.changed(new_state());
        assert!(expected.iter().all(|picture| *picture == expected[0] && *picture != shown), "shown at once");
        assert!(by_frames > 0 && by_thread == 0, "{threading}: {by_frames} {by_thread}");
        let (before, pictures, [by_frames, by_thread]) = later.changed(new_state());
        assert!(before == shown && pictures.last() == Some(&expected[0]), "{threading}: shown in the end");
        assert!(by_frames == 0 && by_thread > 0, "{threading}: no frame waits: {by_frames} {by_thread}");
    }
}

/// A first stencil changes the depth buffer, and with it the pipelines of all that is in view: nothing may disappear.
#[test]
fn change_of_the_whole_view_hides_nothing() {
    let Some(mut run) = Run::new(NewStates::WhenReady, ThreadingModel::SingleThreaded, false) else { return };
    let (shown, pictures, _) = run.changed(StateSet::default().with(Attribute::Stencil(Stencil::default())));
    assert!(pictures.iter().all(|picture| *picture == shown));
}

#[test]
fn blocking_mode_shows_new_states_at_once() {
    let Some(mut run) = Run::new(NewStates::WhenReady, ThreadingModel::SingleThreaded, true) else { return };
    let (_, pictures, [by_frames, _]) = run.changed(new_state());
    assert!(by_frames > 0 && pictures.iter().all(|picture| *picture == pictures[0]));
}
