//! What a flight has beside its set, as roots of the application: proxies for the set's coarsest content, one of each way
//! to be loaded, and a sign that shows a sequence of images. Cameras without their mask see the set alone.

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

use super::check::Failures;
use super::plan::Slides;
use crate::serve::Background;

/// Bits of nodes that are no set's.
pub const MASK: u32 = 1 << 20;
/// Pixels of an image's side.
const SIDE_PX: u32 = 32;

/// Adds nodes as a root, in the mask.
fn hang(viewer: &mut CompositeViewer, scene: SceneId, nodes: Vec<Node>) -> Result<PageId> {
    let group = Node { mask: MASK, ..Node::group(nodes) };
    Ok(viewer.add_root(scene, Page::from_node(group)?)?)
}

/// Proxies beside a set, in the order of their slots: loaded at once, when they are seen, and when they are asked for.
pub struct Proxies {
    scene: SceneId,
    root: PageId,
    was_asked: bool,
}

impl Proxies {
    /// For what the set has on top; none where that is no mesh, which needs nothing else to be read.
    pub fn hang(viewer: &mut CompositeViewer, scene: SceneId, bounds: &SetBounds) -> Result<Option<Self>> {
        let of = viewer.scene(scene)?;
        let top = of.roots().first().and_then(|root| of.slots_of_page(*root).next()).and_then(|slot| of.slot(slot));
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
        Ok(Some(Self { scene, root: hang(viewer, scene, nodes)?, was_asked: false }))
    }

    fn slots(&self, scene: &Scene) -> Vec<NodeId> {
        scene.slots_of_page(self.root).collect()
    }

    /// One of them is to be loaded, whatever it says; refused where it is there.
    pub fn load(&mut self, viewer: &mut CompositeViewer, any: usize) -> Result<()> {
        let scene = viewer.scene_mut(self.scene)?;
        let slots = self.slots(scene);
        let slot = *slots.get(any % slots.len().max(1)).context("a root without its slots")?;
        let is_free = scene.slot(slot).is_some_and(|s| !matches!(s.state, SlotState::Resident(_)));
        let asked = scene.load_proxy(slot);
        ensure!(asked.is_ok() == is_free, "a free place: {is_free}, asked: {asked:?}");
        self.was_asked = true;
        Ok(())
    }

    /// What is only loaded when asked for is not there before.
    pub fn check(&self, failures: &mut Failures, frame: u32, viewer: &CompositeViewer) -> Result<()> {
        let states = self.states(viewer)?;
        let is_right = self.was_asked || states.last() == Some(&SlotState::Empty);
        failures.check(states.len() == 3 && is_right, "a proxy that nobody asked for", frame, || format!("{states:?}"));
        Ok(())
    }

    /// What is loaded at once is there, unless it failed for good.
    pub fn check_at_rest(&self, failures: &mut Failures, frame: u32, viewer: &CompositeViewer) -> Result<()> {
        let states = self.states(viewer)?;
        let is_there = states.first().is_some_and(|state| *state != SlotState::Empty);
        failures.check(is_there, "a proxy that is not loaded at once", frame, || format!("{states:?}"));
        Ok(())
    }

    fn states(&self, viewer: &CompositeViewer) -> Result<Vec<SlotState>> {
        let scene = viewer.scene(self.scene)?;
        Ok(self.slots(scene).into_iter().filter_map(|slot| Some(scene.slot(slot)?.state)).collect())
    }
}

/// A sign over the middle of a set, and the server that its images come from.
pub struct Sign {
    scene: SceneId,
    root: PageId,
    images: u64,
    /// None where they come from the disk.
    server: Option<Background>,
}

/// Writes the images of a sequence into a folder; their names.
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
    pub fn hang(
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
        let root = hang(viewer, scene, vec![placed])?;
        Ok(Self { scene, root, images: u64::from(slides.images), server })
    }

    pub fn set_faulty(&self, is_faulty: bool) {
        if let Some(server) = &self.server {
            server.set_faulty(is_faulty);
        }
    }

    /// Every image is counted, none is there twice, and none of the disk fails.
    pub fn check(&self, failures: &mut Failures, frame: u32, viewer: &CompositeViewer) -> Result<()> {
        let pager = viewer.image_pager(self.scene)?.context("an image pager")?;
        let s = *pager.stats();
        let told = || format!("{s:?}, {:?}", pager.errors());
        failures.check(s.images_peak <= self.images, "more images than there are", frame, told);
        failures.check(s.waiting + s.in_flight + s.images <= self.images, "images asked for twice", frame, told);
        failures.check(s.loaded == s.images + s.paged_out, "images lost", frame, told);
        failures.check(s.failed == 0 || self.server.is_some(), "a good image that failed", frame, told);
        let reported: u64 = pager.errors().iter().map(|error| error.count).sum();
        failures.check(reported == s.failed, "failures of images not reported", frame, told);
        Ok(())
    }

    /// It shows one of its images, or lost some.
    pub fn has_shown(&self, viewer: &CompositeViewer) -> Result<bool> {
        let s = *viewer.image_pager(self.scene)?.context("an image pager")?.stats();
        Ok(s.shown > 0 || s.failed > 0)
    }

    /// Takes it out of its scene.
    pub fn take_down(self, viewer: &mut CompositeViewer) -> Result<()> {
        ensure!(viewer.remove_root(self.scene, self.root)?.is_some(), "a root that does not go");
        Ok(())
    }
}
