//! Additional roots of a flight: proxies for the set's coarsest content, one for each kind of loading, and a sign with a
//! sequence of images. Cameras whose mask excludes [`MASK`] draw only the set.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};
use glam::DVec3;
use terrane::math::BoundingSphere;
use terrane::pager::ImageSequence;
use terrane::scene::{
    Drawable, Material, Mesh, Node, NodeId, NodeKind, Page, PageId, ProxyLoading, ProxyNode, Scene, SlotState,
};
use terrane::state::{Attribute, StateSet, TextureBinding};
use terrane::viewer::{CompositeViewer, SceneId, SetBounds};

use super::checks::invariants::Failures;
use super::plan::Slides;
use crate::serve::Background;

/// The mask of nodes that do not belong to the set.
pub const MASK: u32 = 1 << 20;
/// The side of an image in pixels.
const SIDE_PX: u32 = 32;

/// Adds nodes as a root with the mask.
fn add_root(viewer: &mut CompositeViewer, scene: SceneId, nodes: Vec<Node>) -> Result<PageId> {
    let group = Node { mask: MASK, ..Node::group(nodes) };
    Ok(viewer.add_root(scene, Page::from_node(group)?)?)
}

/// Three proxies beside a set, in the order of their slots: loaded immediately, when visible, and on request.
pub struct Proxies {
    scene: SceneId,
    root: PageId,
    was_requested: bool,
}

impl Proxies {
    /// Adds proxies for the top content of the set. `None` if it is not a mesh: other contents need additional data to be
    /// read.
    pub fn add(viewer: &mut CompositeViewer, scene: SceneId, bounds: &SetBounds) -> Result<Option<Self>> {
        let set = viewer.scene(scene)?;
        let top = set.roots().first().and_then(|root| set.slots_of_page(*root).next()).and_then(|slot| set.slot(slot));
        let Some(top) = top.filter(|top| top.reader_data.is_none() && top.uri.ends_with(".glb")) else {
            return Ok(None);
        };
        let (uri, content_transform) = (top.uri.clone(), top.content_transform);
        let proxy = |loading, bounds| {
            let proxy = ProxyNode { uri: uri.clone(), bounds, content_transform, loading };
            Node::new(NodeKind::ProxyNode(Box::new(proxy)))
        };
        let nodes = vec![
            proxy(ProxyLoading::Immediately, bounds.sphere),
            proxy(ProxyLoading::DeferToPager, BoundingSphere::EVERYTHING),
            proxy(ProxyLoading::Never, bounds.sphere),
        ];
        Ok(Some(Self { scene, root: add_root(viewer, scene, nodes)?, was_requested: false }))
    }

    fn slots(&self, scene: &Scene) -> Vec<NodeId> {
        scene.slots_of_page(self.root).collect()
    }

    /// Requests one of the proxies, whatever its kind of loading. The request must be refused exactly if it is loaded.
    pub fn load(&mut self, viewer: &mut CompositeViewer, any: usize) -> Result<()> {
        let scene = viewer.scene_mut(self.scene)?;
        let slots = self.slots(scene);
        let slot = *slots.get(any % slots.len().max(1)).context("a root without slots")?;
        let is_free = scene.slot(slot).is_some_and(|s| !matches!(s.state, SlotState::Resident(_)));
        let requested = scene.load_proxy(slot);
        ensure!(requested.is_ok() == is_free, "the slot is free: {is_free}, the request: {requested:?}");
        self.was_requested = true;
        Ok(())
    }

    /// Checks that the proxy for loading on request is not loaded before a request.
    pub fn check(&self, failures: &mut Failures, frame: u32, viewer: &CompositeViewer) -> Result<()> {
        let states = self.states(viewer)?;
        let is_right = self.was_requested || states.last() == Some(&SlotState::Empty);
        failures.check(states.len() == 3 && is_right, "a proxy was loaded without a request", frame, || {
            format!("{states:?}")
        });
        Ok(())
    }

    /// Checks that the immediate proxy is loaded or failed once everything is loaded.
    pub fn check_at_rest(&self, failures: &mut Failures, frame: u32, viewer: &CompositeViewer) -> Result<()> {
        let states = self.states(viewer)?;
        let is_loaded = states.first().is_some_and(|state| *state != SlotState::Empty);
        failures.check(is_loaded, "an immediate proxy is not loaded", frame, || format!("{states:?}"));
        Ok(())
    }

    fn states(&self, viewer: &CompositeViewer) -> Result<Vec<SlotState>> {
        let scene = viewer.scene(self.scene)?;
        Ok(self.slots(scene).into_iter().filter_map(|slot| Some(scene.slot(slot)?.state)).collect())
    }
}

/// A sign above the middle of a set, and the server of its images.
pub struct Sign {
    scene: SceneId,
    root: PageId,
    images: u64,
    /// `None` if the images are on disk.
    server: Option<Background>,
}

/// Writes the images of a sequence into a folder and returns their names.
pub fn write_images(slides: &Slides, folder: &Path) -> Result<Vec<String>> {
    let write = |k: u32| {
        let (name, color) = (format!("{k}.png"), image::Rgb([(20 * k) as u8, 120, 220]));
        let file = folder.join(&name);
        image::RgbImage::from_pixel(SIDE_PX, SIDE_PX, color).save(&file).with_context(|| file.display().to_string())?;
        Ok(name)
    };
    (0..slides.images).map(write).collect()
}

impl Sign {
    /// Adds the sign to a scene and plays the sequence.
    pub fn add(
        viewer: &mut CompositeViewer,
        scene: SceneId,
        bounds: &SetBounds,
        slides: &Slides,
        uris: Vec<String>,
        server: Option<Background>,
    ) -> Result<Self> {
        let sequence = ImageSequence::from_files("sign", uris);
        sequence.set_length(slides.length_s);
        sequence.set_looping_mode(slides.looping);
        sequence.set_mode(slides.mode);
        sequence.set_pre_load_frames(slides.ahead);
        sequence.set_time_multiplier(slides.multiplier);
        sequence.play();
        viewer.add_image_sequence(scene, &sequence)?;
        let side_m = 0.1 * bounds.sphere.radius_m;
        let corner = bounds.middle_m + DVec3::Z * (bounds.half_size_m.z + side_m);
        let mesh = Mesh::rectangle(corner, DVec3::X * side_m, DVec3::Z * side_m);
        let texture = TextureBinding::new(sequence.texture());
        let shows = StateSet::default().with(Attribute::Texture(0, texture));
        let sign = Node::geode(vec![Drawable::new(mesh.into(), Material { unlit: true, ..Material::default() })]);
        let placed = Node::transform(bounds.frame.world_from_local, vec![sign.with_state_set(Arc::new(shows))]);
        let root = add_root(viewer, scene, vec![placed])?;
        Ok(Self { scene, root, images: u64::from(slides.images), server })
    }

    /// Turns faults of the images' server on or off.
    pub fn set_faulty(&self, is_faulty: bool) {
        if let Some(server) = &self.server {
            server.set_faulty(is_faulty);
        }
    }

    /// Checks that each image is counted once, and that no image on disk fails.
    pub fn check(&self, failures: &mut Failures, frame: u32, viewer: &CompositeViewer) -> Result<()> {
        let pager = viewer.image_pager(self.scene)?.context("no image pager")?;
        let s = *pager.stats();
        let stats = || format!("{s:?}, {:?}", pager.errors());
        failures.check(s.images_peak <= self.images, "more images than the sequence has", frame, stats);
        failures.check(s.waiting + s.in_flight + s.images <= self.images, "images requested twice", frame, stats);
        failures.check(s.loaded == s.images + s.paged_out, "images lost", frame, stats);
        failures.check(s.failed == 0 || self.server.is_some(), "a valid image failed to load", frame, stats);
        let reported: u64 = pager.errors().iter().map(|error| error.count).sum();
        failures.check(reported == s.failed, "errors of images not reported", frame, stats);
        Ok(())
    }

    /// Returns true once an image has been shown or has failed.
    pub fn has_shown(&self, viewer: &CompositeViewer) -> Result<bool> {
        let s = *viewer.image_pager(self.scene)?.context("no image pager")?.stats();
        Ok(s.shown > 0 || s.failed > 0)
    }

    /// Removes the sign from its scene.
    pub fn remove(self, viewer: &mut CompositeViewer) -> Result<()> {
        ensure!(viewer.remove_root(self.scene, self.root)?.is_some(), "the root of the sign could not be removed");
        Ok(())
    }
}
