//! [`PagedScene`]: a scene with what fills it, pages it and keeps it uploaded; osgViewer's Scene. Main thread.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use super::ViewerError;
use super::home::{LOWEST_GROUND_M, SetBounds, root_volume};
use super::rendering::Rendering;
use super::viewer::{FrameStamp, UpdateCallback};
use crate::cull::PageRequest;
use crate::io::ReadOptions;
use crate::math::{BoundingVolume, Ellipsoid};
use crate::pager::{DatabasePager, ImagePager, ImagePagerConfig, ImageSequence, PagerConfig};
use crate::scene::{DataVariance, DrawSlot, Drawable, Geometry, Page, PageId, Scene, UpdateInfo};

/// A page that the application made and whose drawables were sent to be uploaded.
struct Own {
    page: PageId,
    /// For contexts that are opened later; empty where there may be none.
    drawables: Vec<Drawable>,
}

/// The tile set that was loaded.
struct Loaded {
    root: PageId,
    /// Where it came from.
    uri: Arc<str>,
    /// Metres above the ellipsoid that its ground has at least.
    lowest_ground_m: f64,
}

pub(super) struct PagedScene {
    /// Tells its uploads from those of other scenes.
    owner: u16,
    /// The main thread's alone but while cameras are culled.
    scene: Arc<Scene>,
    /// Place of its pager among the viewer's.
    pub(super) pager: usize,
    pub(super) pager_config: PagerConfig,
    /// Made when the first sequence comes.
    pub(super) image_pager: Option<ImagePager>,
    /// Extent of the tile set that was loaded last; without one, of the first root.
    pub(super) bounds: Option<SetBounds>,
    loaded: Option<Loaded>,
    /// The application's roots that have tiles: nothing says how low their ground is.
    with_tiles: HashSet<PageId>,
    /// By the number under which it was compiled, which is never used again.
    own: BTreeMap<u32, Own>,
    /// The numbers under which pages were compiled.
    own_numbers: HashMap<PageId, u32>,
    next_own: u32,
    /// Devices and numbers of what is being uploaded of these.
    own_uploads: HashSet<(u32, u32)>,
    keeps_drawables: bool,
    pub(super) update_callbacks: Vec<UpdateCallback>,
    /// Of all cameras in the last frame.
    pub(super) requests: Vec<PageRequest>,
    /// What cameras will want.
    pub(super) requests_ahead: Vec<PageRequest>,
    /// Tiles that the last frame's pictures lacked.
    pub(super) wanted_missing: u32,
    /// Tiles and Lods that the last frame's pictures showed between two levels of detail.
    pub(super) fading: u32,
}

impl PagedScene {
    pub(super) fn new(owner: u16, pager: usize, pager_config: PagerConfig, keeps_drawables: bool) -> Self {
        Self {
            owner,
            scene: Arc::new(Scene::new()),
            pager,
            pager_config,
            image_pager: None,
            bounds: None,
            loaded: None,
            with_tiles: HashSet::new(),
            own: BTreeMap::new(),
            own_numbers: HashMap::new(),
            next_own: 0,
            own_uploads: HashSet::new(),
            keeps_drawables,
            update_callbacks: Vec::new(),
            requests: Vec::new(),
            requests_ahead: Vec::new(),
            wanted_missing: 0,
            fading: 0,
        }
    }

    pub(super) fn owner(&self) -> u16 {
        self.owner
    }

    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// For a cull, which drops it before the frame ends.
    pub(super) fn shared(&self) -> Arc<Scene> {
        self.scene.clone()
    }

    /// The scene, between two frames; `None` once a thread has died with it, of which the frame gives the error.
    pub(super) fn changeable(&mut self) -> Option<&mut Scene> {
        Arc::get_mut(&mut self.scene)
    }

    /// The scene, between two frames.
    pub(super) fn scene_mut(&mut self) -> &mut Scene {
        alone(&mut self.scene)
    }

    /// The tile set that was loaded and is there.
    fn loaded(&self) -> Option<&Loaded> {
        self.loaded.as_ref().filter(|loaded| self.scene.roots().contains(&loaded.root))
    }

    /// Where it came from.
    pub(super) fn root_uri(&self) -> Option<&str> {
        self.loaded().map(|loaded| &*loaded.uri)
    }

    /// The earth below all ground that is there, which hides what lies behind the horizon.
    pub(super) fn horizon(&self) -> Option<Ellipsoid> {
        let lowest_m = match &self.loaded {
            Some(loaded) if self.with_tiles.is_empty() => loaded.lowest_ground_m,
            _ => LOWEST_GROUND_M,
        };
        self.bounds.as_ref()?.body_below(lowest_m)
    }

    /// No tile set is there already.
    pub(super) fn check_shows_none(&self) -> Result<(), ViewerError> {
        match self.root_uri() {
            Some(uri) => Err(ViewerError::HasTileset { uri: crate::io::shown(uri).into_owned() }),
            None => Ok(()),
        }
    }

    /// Hangs the root of a tile set in the scene, whose pager has its scope.
    pub(super) fn hang_set(
        &mut self,
        page: Page,
        uri: Arc<str>,
        region: Option<BoundingVolume>,
        rendering: &mut Rendering,
    ) -> Result<PageId, ViewerError> {
        let bounds = SetBounds::new(page.bounding_sphere(), region.or_else(|| root_volume(&page)));
        let root = self.hang(page, rendering)?;
        self.loaded = Some(Loaded { root, uri, lowest_ground_m: bounds.lowest_ground_m() });
        // Whatever the application has beside it.
        self.bounds = Some(bounds);
        Ok(root)
    }

    pub(super) fn add_root(&mut self, page: Page, rendering: &mut Rendering) -> Result<PageId, ViewerError> {
        self.bounds.get_or_insert_with(|| SetBounds::new(page.bounding_sphere(), root_volume(&page)));
        let has_tiles = !page.tiles().records().is_empty();
        let root = self.hang(page, rendering)?;
        if has_tiles {
            self.with_tiles.insert(root);
        }
        Ok(root)
    }

    /// Hangs a root in the scene and sends what it has to be drawn.
    fn hang(&mut self, mut page: Page, rendering: &mut Rendering) -> Result<PageId, ViewerError> {
        if self.pager_config.build_kd_trees {
            page.build_kd_trees();
        }
        let kinds = self.scene.draw_kinds(None, &page).into();
        let drawables = page.take_drawables();
        let root = self.scene_mut().add_root(page);
        if !drawables.is_empty() {
            rendering.devices_mut().for_each(|context| context.prewarm(&kinds));
            let kept = if self.keeps_drawables { drawables.clone() } else { Vec::new() };
            let number = self.next_own;
            self.next_own += 1;
            rendering.compile_own(self.owner, number, drawables)?;
            self.own_uploads.extend(rendering.device_ids().map(|device| (device, number)));
            self.own.insert(number, Own { page: root, drawables: kept });
            self.own_numbers.insert(root, number);
        }
        Ok(root)
    }

    pub(super) fn remove_root(&mut self, id: PageId, rendering: &mut Rendering) -> Option<Page> {
        let mut page = self.scene_mut().remove_root(id)?;
        self.with_tiles.remove(&id);
        self.loaded = self.loaded.take().filter(|loaded| loaded.root != id);
        for (context, slots) in page.take_draw_slots() {
            rendering.release(context, slots);
        }
        // What is still on its way to a device finds no page, and is released.
        if let Some(mut own) = self.own_numbers.remove(&id).and_then(|number| self.own.remove(&number)) {
            // Meshes that the devices were not told of yet.
            for rewritten in self.scene_mut().rewritten_mut().extract_if(.., |rewritten| rewritten.page == id) {
                if let Some(drawable) = own.drawables.get_mut(rewritten.drawable as usize) {
                    drawable.geometry = Geometry::Mesh(rewritten.mesh);
                }
            }
            page.put_drawables(own.drawables);
        }
        Some(page)
    }

    /// Gives back what all its pages have on devices, with no upload for them under way.
    pub(super) fn close(mut self, rendering: &mut Rendering) {
        rendering.release_compiled(self.owner, true);
        for (device, slots) in self.scene_mut().take_draw_slots() {
            rendering.release(device, slots);
        }
    }

    /// A pager of files in a folder and below.
    pub(super) fn pager_of_files(&self, folder: &Path) -> Result<DatabasePager, ViewerError> {
        // The scope of a root is the folder it lies in.
        let root = folder.join("tileset.json").display().to_string();
        let options = ReadOptions::for_root(&root, self.pager_config.limits);
        Ok(DatabasePager::new(self.pager_config.clone(), options)?)
    }

    pub(super) fn is_height_set(&self) -> bool {
        let root = self.loaded().map(|loaded| loaded.root).or_else(|| self.scene.roots().first().copied());
        root.is_some_and(|root| {
            self.scene.slots_of_page(root).any(|id| self.scene.slot(id).is_some_and(|s| s.reader_data.is_some()))
        })
    }

    /// The last frame showed everything that was wanted of it, the application's pages too.
    pub(super) fn shows_all(&self) -> bool {
        self.wanted_missing == 0 && !self.is_uploading()
    }

    /// Pages that the application made are on their way to a device.
    pub(super) fn is_uploading(&self) -> bool {
        !self.own_uploads.is_empty()
    }

    /// The application's turn with the scene.
    pub(super) fn update(&mut self, stamp: &FrameStamp) {
        for callback in &mut self.update_callbacks {
            callback(alone(&mut self.scene), stamp);
        }
        if let Some(scene) = self.changeable().filter(|scene| scene.has_update_callbacks()) {
            scene.update_traversal(&UpdateInfo {
                frame: stamp.frame,
                reference_time_s: stamp.reference_time_s,
                simulation_time_s: stamp.simulation_time_s,
            });
        }
    }

    /// Takes a sequence of images, with an image pager like the pager of tiles where there is none yet.
    pub(super) fn add_image_sequence(&mut self, sequence: &ImageSequence) -> Result<(), ViewerError> {
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

    /// The image pager's turn: tells the contexts of images that textures show from this frame on.
    pub(super) fn page_images(&mut self, rendering: &mut Rendering, simulation_time_s: f64) -> Result<(), ViewerError> {
        let Some(pager) = &mut self.image_pager else { return Ok(()) };
        let _span = crate::timeline::span("images");
        for change in pager.update(simulation_time_s) {
            for context in rendering.devices_mut() {
                context.show(change.clone())?;
            }
        }
        Ok(())
    }

    /// Gives pages that the application made the slots of their uploaded drawables.
    pub(super) fn merge_own(&mut self, rendering: &mut Rendering) {
        if self.own_uploads.is_empty() {
            return;
        }
        let scene = alone(&mut self.scene);
        for (context, number, compiled) in rendering.take_compiled_own(self.owner) {
            self.own_uploads.remove(&(context, number));
            for error in &compiled.errors {
                log::error!("a drawable of a root cannot be drawn: {error}");
            }
            match self.own.get(&number).and_then(|own| scene.page_mut(own.page)) {
                Some(page) => page.set_draw_slots(context, compiled.slots),
                // Removed meanwhile.
                None => rendering.release(context, compiled.slots),
            }
        }
    }

    /// Tells the contexts of meshes that update has changed; whether draw reads what the next update writes in place.
    pub(super) fn send_rewritten(&mut self, rendering: &mut Rendering) -> Result<bool, ViewerError> {
        let scene = alone(&mut self.scene);
        let mut is_dynamic = false;
        for rewritten in std::mem::take(scene.rewritten_mut()) {
            let Some(page) = scene.page(rewritten.page) else { continue };
            let slots = |context: u32| page.draw_slots_of(context);
            let own = self.own_numbers.get(&rewritten.page).copied();
            // The application's own are there or on their way, but for those that were not kept for a later device.
            let comes = |device| own.is_none_or(|number| self.own_uploads.contains(&(device, number)));
            if rendering.device_ids().any(|device| slots(device).is_empty() && comes(device)) {
                scene.rewritten_mut().push(rewritten);
                continue;
            }
            is_dynamic |= rewritten.variance == DataVariance::Dynamic;
            for context in rendering.devices_mut() {
                match slots(context.number()).get(rewritten.drawable as usize) {
                    Some(slot) if *slot != DrawSlot::NONE => context.rewrite(*slot, rewritten.mesh.clone())?,
                    _ => {}
                }
            }
            // A dynamic one is to be the application's alone, which will write it again.
            let kept = own.and_then(|number| self.own.get_mut(&number));
            if let Some(drawable) = kept.and_then(|own| own.drawables.get_mut(rewritten.drawable as usize))
                && rewritten.variance == DataVariance::Static
            {
                drawable.geometry = Geometry::Mesh(rewritten.mesh);
            }
        }
        Ok(is_dynamic)
    }

    /// Uploads the application's pages to a device that was opened after others.
    pub(super) fn device_opened(&mut self, rendering: &mut Rendering, device: u32) -> Result<(), ViewerError> {
        for (number, own) in &self.own {
            if !own.drawables.is_empty() {
                rendering.compile_own_in(device, self.owner, *number, own.drawables.clone())?;
                self.own_uploads.insert((device, *number));
            }
        }
        if let Some(images) = &mut self.image_pager {
            images.show_again();
        }
        Ok(())
    }

    /// Forgets what a device had that is gone.
    pub(super) fn device_closed(&mut self, device: u32) {
        alone(&mut self.scene).forget_context(device);
        self.own_uploads.retain(|(of, _)| *of != device);
    }
}

/// Between two frames nobody else has it: whoever culls drops it before it answers, and who died had its task dropped.
fn alone(scene: &mut Arc<Scene>) -> &mut Scene {
    Arc::get_mut(scene).expect("culls have dropped the scene before a frame ends")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{BoundingSphere, Region, WGS84};
    use crate::scene::{Material, Mesh, Node, NodeKind, ProxyLoading, ProxyNode};

    #[test]
    fn roots_that_are_gone_are_forgotten() {
        let mut rendering = Rendering::new(false, false);
        let mut paged = PagedScene::new(0, 0, PagerConfig::default(), true);
        let page = || {
            let mesh = Mesh::sphere(glam::DVec3::ZERO, 1.0, 4);
            let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default());
            Page::from_node(Node::geode(vec![drawable])).unwrap()
        };
        let stays = paged.add_root(page(), &mut rendering).unwrap();
        let number = |paged: &PagedScene, page| paged.own_numbers.get(&page).copied();
        let before = number(&paged, stays);
        for _ in 0..100 {
            let root = paged.add_root(page(), &mut rendering).unwrap();
            assert!(number(&paged, root) > before && paged.own.len() == 2 && paged.own_numbers.len() == 2);
            assert!(paged.remove_root(root, &mut rendering).is_some());
        }
        assert_eq!((paged.own.len(), paged.own_numbers.len(), number(&paged, stays)), (1, 1, before));
        // What comes back is as it was last.
        let mesh = Arc::new(Mesh::sphere(glam::DVec3::ZERO, 2.0, 6));
        let node = crate::scene::NodeId { page: stays, index: 0 };
        paged.scene_mut().set_mesh(node, 0, mesh.clone(), DataVariance::Static).unwrap();
        let back = paged.remove_root(stays, &mut rendering).unwrap().take_drawables();
        assert!(matches!(&back[..], [Drawable { geometry: Geometry::Mesh(m), .. }] if Arc::ptr_eq(m, &mesh)));
    }

    /// What was loaded second could lie below the first's ground, and was hidden though nothing stood before it.
    #[test]
    fn the_horizon_is_that_of_the_lowest_ground_that_is_there() {
        let mut rendering = Rendering::new(false, false);
        let mut paged = PagedScene::new(0, 0, PagerConfig::default(), true);
        let bounds = BoundingSphere::new(WGS84.semi_major_m * glam::DVec3::X, 1000.0);
        let proxy = || {
            let (uri, loading) = (Arc::from("set/tile.glb"), ProxyLoading::Never);
            let proxy = ProxyNode { uri, bounds, content_transform: glam::DAffine3::IDENTITY, loading };
            Page::from_node(Node::new(NodeKind::ProxyNode(Box::new(proxy)))).unwrap()
        };
        let set = |min_height_m: f64| {
            let region = Region { west: 0.0, south: 0.0, east: 0.1, north: 0.1, min_height_m, max_height_m: 3000.0 };
            (proxy(), Arc::from("set/tileset.json"), Some(BoundingVolume::Region(region)))
        };
        let lowest_m = |paged: &PagedScene| paged.horizon().map(|body| body.semi_major_m - WGS84.semi_major_m);
        let text = || Page::from_node(Node::group(Vec::new())).unwrap();
        // A page that is not on the earth.
        paged.add_root(text(), &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), None);
        let (page, uri, region) = set(-400.0);
        let land = paged.hang_set(page, uri, region, &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(-400.0));
        paged.add_root(text(), &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(-400.0), "what has no tiles hides nothing");
        let of_unknown_depth = paged.add_root(proxy(), &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(LOWEST_GROUND_M));
        assert!(paged.remove_root(of_unknown_depth, &mut rendering).is_some());
        assert_eq!(lowest_m(&paged), Some(-400.0));
        assert!(paged.remove_root(land, &mut rendering).is_some());
        let (page, uri, region) = set(-4000.0);
        paged.hang_set(page, uri, region, &mut rendering).unwrap();
        assert_eq!(lowest_m(&paged), Some(-4000.0));
    }
}
