//! [`PagedScene`]: a scene with its loaded tile set, the application's own pages and what the last culls lacked;
//! osgViewer's Scene. Main thread.

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

use super::cull_findings::CullFindings;
use super::loaded_root::LoadedRoot;
use super::own_pages::OwnPages;
use crate::formats::{OverlaySet, ReadOptions};
use crate::math::{BoundingVolume, Ellipsoid};
use crate::pager::{DatabasePager, ImagePager, ImagePagerConfig, ImageSequence, PagerConfig};
use crate::scene::{DrawSlot, Page, PageId, ReaderData, Scene, UpdateInfo};
use crate::state::DataVariance;
use crate::viewer::ViewerError;
use crate::viewer::clock::FrameStamp;
use crate::viewer::ids::PagerId;
use crate::viewer::rendering::{Rendering, UploadOwner};
use crate::viewer::view::set_bounds::{SetBounds, part_of_globe, root_volume};

/// A callback that changes the scene in the update phase of each frame, on the main thread.
pub type SceneUpdate = Box<dyn FnMut(&mut Scene, &FrameStamp) + Send>;

/// The tile set that was loaded into a scene.
struct LoadedSet {
    root: PageId,
    uri: Arc<str>,
    /// A lower bound of its ground, metres above the ellipsoid.
    lowest_ground_m: f64,
}

/// A scene of a viewer.
pub(in crate::viewer) struct PagedScene {
    /// Shared with the culls during a frame; between frames the main thread holds the only reference.
    scene: Arc<Scene>,
    /// The pager that serves it.
    pager: PagerId,
    pager_config: PagerConfig,
    /// Created with the first image sequence.
    image_pager: Option<ImagePager>,
    /// The extent of the tile set that was loaded last, or of the first root.
    bounds: Option<SetBounds>,
    loaded: Option<LoadedSet>,
    /// The application's roots that have tiles; the height of their ground is unknown.
    roots_with_tiles: HashSet<PageId>,
    own: OwnPages,
    update_callbacks: Vec<SceneUpdate>,
    findings: CullFindings,
}

impl PagedScene {
    /// Creates an empty scene for a pager. `owner` distinguishes the scene's uploads from those of other scenes.
    pub(in crate::viewer) fn new(owner: u16, pager: PagerId, pager_config: PagerConfig, keeps_drawables: bool) -> Self {
        Self {
            scene: Arc::new(Scene::new()),
            pager,
            pager_config,
            image_pager: None,
            bounds: None,
            loaded: None,
            roots_with_tiles: HashSet::new(),
            own: OwnPages::new(owner, keeps_drawables),
            update_callbacks: Vec::new(),
            findings: CullFindings::default(),
        }
    }

    pub(in crate::viewer) fn owner(&self) -> u16 {
        self.own.owner()
    }

    pub(in crate::viewer) fn pager(&self) -> PagerId {
        self.pager
    }

    pub(in crate::viewer) fn bounds(&self) -> Option<&SetBounds> {
        self.bounds.as_ref()
    }

    pub(in crate::viewer) fn findings(&self) -> &CullFindings {
        &self.findings
    }

    pub(in crate::viewer) fn findings_mut(&mut self) -> &mut CullFindings {
        &mut self.findings
    }

    pub(in crate::viewer) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns a reference for a cull, which drops it before the frame ends.
    pub(in crate::viewer) fn shared(&self) -> Arc<Scene> {
        self.scene.clone()
    }

    /// Returns the scene between two frames; `None` when a thread has died with a reference to it. The frame reports
    /// that error.
    pub(in crate::viewer) fn changeable(&mut self) -> Option<&mut Scene> {
        Arc::get_mut(&mut self.scene)
    }

    /// Returns the scene between two frames.
    pub(in crate::viewer) fn scene_mut(&mut self) -> &mut Scene {
        unshared(&mut self.scene)
    }

    /// Returns the loaded tile set, unless its root was removed.
    fn loaded(&self) -> Option<&LoadedSet> {
        self.loaded.as_ref().filter(|loaded| self.scene.roots().contains(&loaded.root))
    }

    /// Returns the URI of the loaded tile set.
    pub(in crate::viewer) fn root_uri(&self) -> Option<&str> {
        self.loaded().map(|loaded| &*loaded.uri)
    }

    /// Returns an ellipsoid below all ground of the scene; it hides everything behind the horizon.
    pub(in crate::viewer) fn horizon(&self) -> Option<Ellipsoid> {
        let lowest_m = match &self.loaded {
            Some(loaded) if self.roots_with_tiles.is_empty() => loaded.lowest_ground_m,
            _ => self.bounds.as_ref()?.ellipsoid.ground_m()[0],
        };
        self.bounds.as_ref()?.horizon_below(lowest_m)
    }

    /// Fails when the scene has a loaded tile set already.
    pub(in crate::viewer) fn check_has_no_set(&self) -> Result<(), ViewerError> {
        match self.root_uri() {
            Some(uri) => Err(ViewerError::HasTileset { uri: crate::fetch::shown(uri).into_owned() }),
            None => Ok(()),
        }
    }

    /// Adds the root of a tile set, whose files the scene's pager may read.
    pub(in crate::viewer) fn add_set(
        &mut self,
        page: Page,
        uri: Arc<str>,
        region: Option<BoundingVolume>,
        rendering: &mut Rendering,
    ) -> Result<PageId, ViewerError> {
        let (bounds, lowest_ground_m) = match part_of_globe(&page) {
            // The ground goes on around the part.
            Some(part) => {
                let [lowest_m, _] = page.ellipsoid().ground_m();
                (SetBounds::on(page.ellipsoid(), part.bounding_sphere(), Some(part)), lowest_m)
            }
            None => {
                let volume = region.or_else(|| root_volume(&page));
                let bounds = SetBounds::on(page.ellipsoid(), page.bounding_sphere(), volume);
                (bounds, bounds.lowest_ground_m())
            }
        };
        let root = self.add_page(page, rendering)?;
        self.loaded = Some(LoadedSet { root, uri, lowest_ground_m });
        // The tile set decides the extent, whatever roots the application has beside it.
        self.bounds = Some(bounds);
        Ok(root)
    }

    /// Adds a page of the application as a root.
    pub(in crate::viewer) fn add_root(&mut self, page: Page, rendering: &mut Rendering) -> Result<PageId, ViewerError> {
        self.bounds.get_or_insert_with(|| SetBounds::on(page.ellipsoid(), page.bounding_sphere(), root_volume(&page)));
        let has_tiles = !page.tiles().records().is_empty();
        let root = self.add_page(page, rendering)?;
        if has_tiles {
            self.roots_with_tiles.insert(root);
        }
        Ok(root)
    }

    /// Adds a root and uploads its drawables.
    fn add_page(&mut self, mut page: Page, rendering: &mut Rendering) -> Result<PageId, ViewerError> {
        if self.pager_config.build_kd_trees {
            page.build_kd_trees();
        }
        let kinds = self.scene.draw_kinds(None, &page).into();
        let drawables = page.take_drawables();
        let root = self.scene_mut().add_root(page);
        if !drawables.is_empty() {
            // The application adds pages when it can wait.
            rendering.devices_mut().for_each(|device| device.prewarm_now(&kinds));
            self.own.upload(root, drawables, rendering)?;
        }
        Ok(root)
    }

    /// Removes a root and releases its draw slots; `None` when it is not a root, or while pages are attached to it.
    pub(in crate::viewer) fn remove_root(&mut self, id: PageId, rendering: &mut Rendering) -> Option<Page> {
        let mut page = self.scene_mut().remove_root(id)?;
        self.roots_with_tiles.remove(&id);
        self.loaded = self.loaded.take().filter(|loaded| loaded.root != id);
        for (device, slots) in page.take_draw_slots() {
            rendering.release(device, slots);
        }
        self.own.remove(id, &mut page, unshared(&mut self.scene));
        Some(page)
    }

    /// Releases everything that its pages have on devices. No upload for them may be in flight.
    pub(in crate::viewer) fn close(mut self, rendering: &mut Rendering) {
        rendering.release_compiled(UploadOwner::Pages(self.owner()));
        for (device, slots) in self.scene_mut().take_draw_slots() {
            rendering.release(device, slots);
        }
    }

    /// Returns the overlays of the scene.
    pub(in crate::viewer) fn overlays(&self) -> Option<&Arc<OverlaySet>> {
        self.pager_config.overlays.as_ref()
    }

    /// Sets the overlays of pagers that are created from now on.
    pub(in crate::viewer) fn set_overlays(&mut self, overlays: Option<Arc<OverlaySet>>) {
        self.pager_config.overlays = overlays;
    }

    /// Creates a pager that may read the files in a folder and below.
    pub(in crate::viewer) fn new_folder_pager(&self, folder: &Path) -> Result<DatabasePager, ViewerError> {
        // The scope of a root is the folder that holds it.
        let root = folder.join("tileset.json").display().to_string();
        let ellipsoid = self.pager_config.ellipsoid;
        let options = ReadOptions { ellipsoid, ..ReadOptions::for_root(&root, self.pager_config.limits) };
        Ok(DatabasePager::new(self.pager_config.clone(), options)?)
    }

    /// Reads a root with the scene's pager settings.
    pub(in crate::viewer) fn read_root(&self, source: &str, rendering: &Rendering) -> Result<LoadedRoot, ViewerError> {
        LoadedRoot::read_for(source, &self.pager_config, rendering.block_formats())
    }

    /// Returns true when the tiles of the loaded set, or of the first root, are height tiles.
    pub(in crate::viewer) fn is_height_set(&self) -> bool {
        let root = self.loaded().map(|loaded| loaded.root).or_else(|| self.scene.roots().first().copied());
        root.is_some_and(|root| {
            let is_height =
                |id| self.scene.slot(id).and_then(|slot| slot.reader_data).is_some_and(ReaderData::has_heights);
            self.scene.slots_of_page(root).any(is_height)
        })
    }

    /// Returns true when the last frame showed everything that was wanted, the application's pages included.
    pub(in crate::viewer) fn is_complete(&self) -> bool {
        self.findings.is_complete() && !self.is_uploading()
    }

    /// Returns true while pages of the application are being uploaded.
    pub(in crate::viewer) fn is_uploading(&self) -> bool {
        self.own.is_uploading()
    }

    /// Adds a callback for each update phase.
    pub(in crate::viewer) fn on_update(&mut self, callback: SceneUpdate) {
        self.update_callbacks.push(callback);
    }

    /// Returns true when callbacks may change the scene in each frame.
    pub(in crate::viewer) fn has_update_callbacks(&self) -> bool {
        !self.update_callbacks.is_empty() || self.scene.has_update_callbacks()
    }

    /// Runs the application's part of the update phase: its callbacks, then those of the nodes.
    pub(in crate::viewer) fn update(&mut self, stamp: &FrameStamp) {
        for callback in &mut self.update_callbacks {
            callback(unshared(&mut self.scene), stamp);
        }
        if let Some(scene) = self.changeable().filter(|scene| scene.has_update_callbacks()) {
            scene.update_traversal(&UpdateInfo {
                frame: stamp.frame,
                reference_time_s: stamp.reference_time_s,
                simulation_time_s: stamp.simulation_time_s,
            });
        }
    }

    pub(in crate::viewer) fn image_pager(&self) -> Option<&ImagePager> {
        self.image_pager.as_ref()
    }

    pub(in crate::viewer) fn image_pager_mut(&mut self) -> Option<&mut ImagePager> {
        self.image_pager.as_mut()
    }

    pub(in crate::viewer) fn set_image_pager(&mut self, pager: ImagePager) {
        self.image_pager = Some(pager);
    }

    /// Adds an image sequence; the first one creates an image pager with the settings of the tile pager.
    pub(in crate::viewer) fn add_image_sequence(&mut self, sequence: &ImageSequence) -> Result<(), ViewerError> {
        let pager = match &mut self.image_pager {
            Some(pager) => pager,
            None => {
                let of = &self.pager_config;
                let config = ImagePagerConfig {
                    limits: of.limits,
                    retry_after: of.retry_after,
                    max_tries: of.max_tries,
                    blocking: of.blocking,
                    #[cfg(feature = "http")]
                    http: of.http.clone(),
                    ..ImagePagerConfig::default()
                };
                self.image_pager.insert(ImagePager::new(config)?)
            }
        };
        pager.add(sequence);
        Ok(())
    }

    /// Runs the image pager and sends the devices the images that textures show from this frame on.
    pub(in crate::viewer) fn page_images(
        &mut self,
        rendering: &mut Rendering,
        simulation_time_s: f64,
    ) -> Result<(), ViewerError> {
        let Some(pager) = &mut self.image_pager else { return Ok(()) };
        let _span = crate::trace::span("images");
        for change in pager.update(simulation_time_s) {
            for device in rendering.devices_mut() {
                device.show(change.clone())?;
            }
        }
        Ok(())
    }

    /// Returns a number that changes when a page of the application has received its upload.
    pub(in crate::viewer) fn own_merged(&self) -> u32 {
        self.own.merged()
    }

    /// Gives the application's pages the draw slots of uploads that have finished.
    pub(in crate::viewer) fn merge_own(&mut self, rendering: &mut Rendering) {
        self.own.merge_uploaded(unshared(&mut self.scene), rendering);
    }

    /// Sends the devices the meshes that update has changed. Returns true when draw reads data that the next update
    /// overwrites.
    pub(in crate::viewer) fn send_rewritten(&mut self, rendering: &mut Rendering) -> Result<bool, ViewerError> {
        let scene = unshared(&mut self.scene);
        let mut is_dynamic = false;
        for rewritten in std::mem::take(scene.rewritten_mut()) {
            let Some(page) = scene.page(rewritten.page) else { continue };
            let slots = |device: u32| page.draw_slots_of(device);
            let is_expected = |device| self.own.is_on_or_bound_for(rewritten.page, device);
            if rendering.device_ids().any(|device| slots(device).is_empty() && is_expected(device)) {
                // The page has not arrived on some device; it is tried again in the next frame.
                scene.rewritten_mut().push(rewritten);
                continue;
            }
            is_dynamic |= rewritten.variance == DataVariance::Dynamic;
            for device in rendering.devices_mut() {
                match slots(device.number()).get(rewritten.drawable as usize) {
                    Some(slot) if *slot != DrawSlot::NONE => device.rewrite(*slot, rewritten.mesh.clone())?,
                    _ => {}
                }
            }
            self.own.keep_rewritten(rewritten.page, rewritten.drawable, rewritten.mesh, rewritten.variance);
        }
        Ok(is_dynamic)
    }

    /// Uploads the application's pages to a device that was opened after others.
    pub(in crate::viewer) fn device_opened(
        &mut self,
        rendering: &mut Rendering,
        device: u32,
    ) -> Result<(), ViewerError> {
        self.own.upload_to(device, rendering)?;
        if let Some(images) = &mut self.image_pager {
            images.show_again();
        }
        Ok(())
    }

    /// Forgets what a device had that is gone.
    pub(in crate::viewer) fn device_closed(&mut self, device: u32) {
        self.scene_mut().forget_context(device);
        self.own.device_closed(device);
    }
}

/// Returns the scene for a change. Between frames the main thread holds the only reference: culls drop theirs before they
/// answer, and tasks of threads that died are dropped with their channel.
fn unshared(scene: &mut Arc<Scene>) -> &mut Scene {
    Arc::get_mut(scene).expect("culls have dropped the scene before a frame ends")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{BoundingSphere, Region, WGS84};
    use crate::scene::{Drawable, Geometry, Material, Mesh, Node, NodeKind, ProxyLoading, ProxyNode};

    #[test]
    fn removed_roots_leave_nothing_behind() {
        let mut rendering = Rendering::new(false, false);
        let mut paged = PagedScene::new(0, crate::viewer::ids::ListKey::from_number(0), PagerConfig::default(), true);
        let page = || {
            let mesh = Mesh::sphere(glam::DVec3::ZERO, 1.0, 4);
            let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default());
            Page::from_node(Node::geode(vec![drawable])).unwrap()
        };
        let stays = paged.add_root(page(), &mut rendering).unwrap();
        let number = |paged: &PagedScene, page| paged.own.number_of(page);
        let before = number(&paged, stays);
        for _ in 0..100 {
            let root = paged.add_root(page(), &mut rendering).unwrap();
            assert!(number(&paged, root) > before && paged.own.counts() == (2, 2));
            assert!(paged.remove_root(root, &mut rendering).is_some());
        }
        assert_eq!((paged.own.counts(), number(&paged, stays)), ((1, 1), before));
        // A removed root has its latest mesh.
        let mesh = Arc::new(Mesh::sphere(glam::DVec3::ZERO, 2.0, 6));
        let node = crate::scene::NodeId { page: stays, index: 0 };
        paged.scene_mut().set_mesh(node, 0, mesh.clone(), DataVariance::Static).unwrap();
        let back = paged.remove_root(stays, &mut rendering).unwrap().take_drawables();
        assert!(matches!(&back[..], [Drawable { geometry: Geometry::Mesh(m), .. }] if Arc::ptr_eq(m, &mesh)));
    }

    /// Regression: a set loaded later may lie below the first one's ground, and was wrongly hidden by the horizon.
    #[test]
    fn horizon_follows_the_lowest_ground_of_the_scene() {
        let mut rendering = Rendering::new(false, false);
        let mut paged = PagedScene::new(0, crate::viewer::ids::ListKey::from_number(0), PagerConfig::default(), true);
        let bounds = BoundingSphere::new(WGS84.semi_major_m * glam::DVec3::X, 1000.0);
        let proxy = || {
            let (uri, loading) = (Arc::from("set/tile.glb"), ProxyLoading::Never);
            let proxy = ProxyNode { uri, bounds, content_transform: glam::DAffine3::IDENTITY, loading };
            Page::from_node(Node::new(NodeKind::ProxyNode(Box::new(proxy)))).unwrap()
        };
        let set = |min_height_m: f64| {
            let region = Region {
                west: 0.0,
                south: 0.0,
                east: 0.1,
                north: 0.1,
                min_height_m,
                max_height_m: 3000.0,
                ellipsoid: WGS84,
            };
            (proxy(), Arc::from("set/tileset.json"), Some(BoundingVolume::Region(region)))
        };
        let lowest_m = |paged: &PagedScene| paged.horizon().map(|body| body.semi_major_m - WGS84.semi_major_m);
        let text = || Page::from_node(Node::group(Vec::new())).unwrap();
        // A page away from the earth has no horizon.
        paged.add_root(text(), &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), None);
        let (page, uri, region) = set(-400.0);
        let land = paged.add_set(page, uri, region, &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(-400.0));
        paged.add_root(text(), &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(-400.0), "a page without tiles does not change the horizon");
        let of_unknown_depth = paged.add_root(proxy(), &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(-12_000.0));
        assert!(paged.remove_root(of_unknown_depth, &mut rendering).is_some());
        assert_eq!(lowest_m(&paged), Some(-400.0));
        assert!(paged.remove_root(land, &mut rendering).is_some());
        let (page, uri, region) = set(-4000.0);
        paged.add_set(page, uri, region, &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(-4000.0));
    }
}
