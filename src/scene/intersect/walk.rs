//! Finds the drawables that a shape may meet, and the positions at which it enters their boxes.
//!
//! The walk visits the same pages, switches, levels of detail and frames as cull, so that it finds what is drawn.

use glam::{DAffine3, DMat3, DVec3};

use super::probe::{Candidate, Probe};
use super::selection::{LodSelection, Rules};
use super::window::WindowView;
use crate::scene::graph::Scene;
use crate::scene::id::{NONE, PageId};
use crate::scene::nodes::{CameraNode, ReferenceFrame, RenderOrder};
use crate::scene::pages::{INACTIVE, Page, RareNode, UNBOUNDED, kind};
use crate::scene::settings::{ComputeNearFar, Inherit, LodRecord, has_parallel_rays, px_per_radian};
use crate::scene::tile_tree::{TileBounds, TileEye, Tiles, flag};

/// The page that is being visited.
struct InPage<'a, L> {
    page: &'a Page,
    place: u32,
    world_from_page: DAffine3,
    /// The shape in the page's frame; `None` if the shape is outside this view, though it may be inside other views below.
    local: Option<L>,
    stands_in: bool,
    ancestor: Option<Ancestor>,
}

/// A content that is drawn instead of unavailable tiles below it.
#[derive(Clone, Copy, PartialEq)]
struct Ancestor {
    place: u32,
    world_from_page: DAffine3,
    stands_in: bool,
}

/// A page that must still be visited.
struct Visit {
    place: u32,
    world_from_page: DAffine3,
    view: View,
    /// True if the page replaces content above it: as in cull, its top tiles are then visited also from outside their request
    /// volumes.
    stands_in: bool,
    /// The nearest resident content above, if the page is a tileset below one that it replaces.
    ancestor: Option<Ancestor>,
}

/// The number of a view that the shape is not in.
const NOWHERE: u32 = u32::MAX;

/// The rules and the view below a Projection or camera.
#[derive(Clone, Copy)]
struct View {
    rules: Rules,
    /// The view, if the shape is a position of an image.
    window: Option<WindowView>,
    /// The shape's number of the view.
    shape: u32,
    /// An index into [`Walk::stages`].
    stage: usize,
    /// True in the image of a camera that shows the scene.
    in_scene_camera: bool,
}

/// The position in the drawing order of a camera that is drawn before or after the surrounding stage.
struct Stage {
    above: usize,
    is_after: bool,
    order: i32,
}

/// The maximum number of views in one image that are followed.
const MAX_VIEWS: usize = 1024;

struct Walk<'a, P: Probe> {
    scene: &'a Scene,
    view: View,
    probe: &'a mut P,
    pages: Vec<Visit>,
    /// The ancestors that were visited instead of unavailable tiles, and the shape's number of the view.
    ancestors: Vec<(Ancestor, u32)>,
    /// The drawing order; number 0 is the image itself.
    stages: Vec<Stage>,
    views: usize,
    found: &'a mut Vec<Candidate>,
}

/// Finds the drawables that a shape may meet, in the order in which it enters their boxes.
pub fn candidates<P: Probe>(scene: &Scene, rules: &Rules, probe: &mut P, found: &mut Vec<Candidate>) {
    found.clear();
    let view = View { rules: *rules, window: probe.window(), shape: 0, stage: 0, in_scene_camera: false };
    let stages = vec![Stage { above: 0, is_after: false, order: 0 }];
    let mut walk = Walk { scene, view, probe, pages: Vec::new(), ancestors: Vec::new(), stages, views: 1, found };
    walk.roots(DAffine3::IDENTITY);
    while let Some(Visit { place, world_from_page, view, stands_in, ancestor }) = walk.pages.pop() {
        let Some(page) = scene.page_at(place) else { continue };
        walk.view = view;
        let local = walk.probe.local(view.shape, &world_from_page);
        if local.is_some() {
            let here = InPage { page, place, world_from_page, local, stands_in, ancestor };
            walk.nodes(&here, 0, page.node_count() as u32);
        }
    }
    if walk.stages.len() > 1 {
        let layers = layers(&walk.stages);
        for candidate in walk.found.iter_mut() {
            candidate.layer = layers.get(candidate.layer as usize).copied().unwrap_or(u32::MAX);
        }
    }
    found.sort_by(|a, b| a.layer.cmp(&b.layer).then(a.enters.total_cmp(&b.enters)));
}

/// Returns the layer of each stage: the number of stages drawn after it.
fn layers(stages: &[Stage]) -> Vec<u32> {
    // The sort key of a stage: for each stage above, whether it is drawn before or after, its order number and its index.
    let path = |stage: usize| {
        let mut path = Vec::new();
        let mut at = stage;
        while let Some(Stage { above, is_after, order }) = stages.get(at).filter(|_| at != 0) {
            path.push((if *is_after { 1 } else { -1 }, *order, at));
            at = *above;
        }
        path.reverse();
        // The stage itself is drawn between those before and those after it.
        path.push((0, 0, 0));
        path
    };
    let mut in_order: Vec<_> = (0..stages.len()).map(|stage| (path(stage), stage)).collect();
    in_order.sort();
    let mut layers = vec![0; stages.len()];
    for (after, (_, stage)) in in_order.iter().rev().enumerate() {
        if let Some(layer) = layers.get_mut(*stage) {
            *layer = after as u32;
        }
    }
    layers
}

impl<P: Probe> Walk<'_, P> {
    /// Visits nodes `first..last`, whole subtrees.
    fn nodes(&mut self, here: &InPage<P::Local>, first: u32, last: u32) {
        let page = here.page;
        let mut node = first;
        while node < last {
            let index = node as usize;
            let record = page.nodes()[index];
            let end = node + record.skip;
            let sphere = page.spheres()[index];
            let is_hidden = page.masks().get(index).is_some_and(|mask| mask & self.view.rules.mask == 0);
            // The bounds of nodes that are not culled are not used.
            let is_missed = record.flags & INACTIVE == 0
                && (sphere.w < 0.0
                    || match &here.local {
                        Some(local) if sphere.w < UNBOUNDED => {
                            let center = page.origin() + sphere.truncate().as_dvec3();
                            P::enters_sphere(local, center, sphere.w.into()).is_none()
                        }
                        local => local.is_none(),
                    });
            if is_hidden || is_missed {
                node = end;
                continue;
            }
            node = match record.kind {
                kind::GEODE | kind::GROUP => {
                    for drawable in record.first_drawable..page.nodes()[index + 1].first_drawable {
                        if let Some(enters) = self.enters_drawable(here, drawable) {
                            let transform = page.drawable_refs()[drawable as usize].transform;
                            let world_from_drawable =
                                here.world_from_page * page.transforms().page_from_node(transform);
                            self.find(enters, here.place, drawable, world_from_drawable);
                        }
                    }
                    node + 1
                }
                kind::TRANSFORM => node + 1,
                kind::TILE => {
                    self.tiles(here, page.payloads()[index]);
                    end
                }
                kind::SWITCH => {
                    let shown = &page.switches()[page.payloads()[index] as usize];
                    self.children(here, node, |child| shown.get(child).copied().unwrap_or(false));
                    end
                }
                kind::LOD => {
                    let lod = &page.lods()[page.payloads()[index] as usize];
                    let measure = self.lod_measure(here, node, lod).unwrap_or_else(|| lod.nearest());
                    self.children(here, node, |child| lod.shows(child, measure));
                    end
                }
                _ => {
                    if self.special(here, node) {
                        end
                    } else {
                        node + 1
                    }
                }
            };
        }
    }

    fn find(&mut self, enters: f64, place: u32, drawable: u32, world_from_drawable: DAffine3) {
        let View { shape: view, stage, .. } = self.view;
        // The position along another view's shape cannot be compared with this one's.
        let enters = if view == 0 { enters } else { f64::NEG_INFINITY };
        self.found.push(Candidate { enters, place, drawable, world_from_drawable, view, layer: stage as u32 });
    }

    fn children(&mut self, here: &InPage<P::Local>, node: u32, is_shown: impl Fn(usize) -> bool) {
        let nodes = here.page.nodes();
        let end = node + nodes[node as usize].skip;
        let (mut child, mut index) = (node + 1, 0);
        while child < end {
            let next = child + nodes[child as usize].skip;
            if is_shown(index) {
                self.nodes(here, child, next);
            }
            (child, index) = (next, index + 1);
        }
    }

    fn enters_drawable(&self, here: &InPage<P::Local>, drawable: u32) -> Option<f64> {
        let local = here.local.as_ref()?;
        let four = here.page.boxes().get(drawable as usize / 4)?;
        let lane = drawable as usize % 4;
        let half = four.half.map(|h| f64::from(h[lane]));
        if half[0] >= f64::from(UNBOUNDED) {
            return Some(f64::NEG_INFINITY);
        }
        let center = here.page.origin() + DVec3::from_array(four.center.map(|c| f64::from(c[lane])));
        P::enters_box(local, center, &DMat3::IDENTITY, DVec3::from_array(half))
    }

    /// Returns the value that a LOD node compares with its ranges; `None` if no eye decides.
    fn lod_measure(&self, here: &InPage<P::Local>, node: u32, lod: &LodRecord) -> Option<f64> {
        let eye = self.view.rules.eye.filter(|_| self.view.rules.lods == LodSelection::AsSeen)?;
        let eye_in_page = in_frame(&here.world_from_page, eye.position());
        let page = here.page;
        let eye_in_node = page.transforms().point_in_node(page.enclosing_transform(node), eye_in_page);
        Some(lod.measure(eye_in_node.distance(lod.center), eye.lod_scale, &eye.ranges()))
    }

    /// Visits a node of a rare kind. Returns false if its children must be visited like those of a group.
    fn special(&mut self, here: &InPage<P::Local>, node: u32) -> bool {
        let page = here.page;
        let Some(special) = page.rare_nodes().get(page.payloads()[node as usize] as usize) else { return false };
        match special {
            RareNode::Billboard { mode, auto_scale, positions, .. } => {
                let Some(eye) = self.view.rules.eye else { return false };
                let world_from_node =
                    here.world_from_page * page.transforms().page_from_node(page.enclosing_transform(node));
                let eye_in_node = in_frame(&world_from_node, eye.position());
                let eye_from_node = eye.world_from_eye.inverse() * world_from_node;
                for (drawable, position) in (page.nodes()[node as usize].first_drawable..).zip(positions) {
                    let Some(enters) = self.enters_drawable(here, drawable) else { continue };
                    let scale = auto_scale.map_or(1.0, |scale| {
                        scale.scale_at(&eye_from_node, *position, eye.px_per_radian, eye.is_parallel)
                    });
                    let eye_from_drawable = mode.eye_from_drawable(&eye_from_node, eye_in_node, *position)
                        * DAffine3::from_scale(DVec3::splat(scale));
                    let world_from_drawable = eye.world_from_eye * eye_from_drawable;
                    self.find(enters, here.place, drawable, world_from_drawable);
                }
                false
            }
            RareNode::AbsoluteTransform => {
                if let Some(eye) = self.view.rules.eye {
                    let above = page.transforms().page_from_node(page.enclosing_transform(node));
                    self.below(here, node, eye.world_from_eye * above.inverse());
                }
                true
            }
            RareNode::Camera { camera, .. } => {
                self.camera(here, node, camera);
                true
            }
            RareNode::Projection { clip_from_eye, .. } => {
                if let Some(window) = self.view.window {
                    let window = WindowView { clip_from_eye: *clip_from_eye, ..window };
                    self.in_view(here, node, window, self.view, here.world_from_page);
                }
                true
            }
            _ => false,
        }
    }

    fn camera(&mut self, here: &InPage<P::Local>, node: u32, camera: &CameraNode) {
        let is_elsewhere = camera.target.as_ref().is_some_and(|target| target.size_px().is_some());
        if is_elsewhere && camera.order != RenderOrder::Nested {
            return; // the image goes to a texture
        }
        if camera.shows_scene && self.view.in_scene_camera {
            return; // as cull
        }
        let page = here.page;
        let above = page.transforms().page_from_node(page.enclosing_transform(node));
        let view = self.view_of(camera);
        if camera.projection.is_none() && camera.viewport_px.is_none() {
            // Maps the world of the camera to this one.
            let (world_from_page, world_from_root) = match (camera.frame, self.view.rules.eye) {
                (ReferenceFrame::Absolute, Some(eye)) => {
                    let moved = eye.world_from_eye * camera.view;
                    (moved * above.inverse(), moved)
                }
                (ReferenceFrame::Absolute, None) => return,
                (ReferenceFrame::Relative, _) => {
                    let world_from_node = here.world_from_page * above;
                    let moved = world_from_node * camera.view;
                    (moved * above.inverse(), moved * world_from_node.inverse())
                }
            };
            let outer = std::mem::replace(&mut self.view, view);
            self.below(here, node, world_from_page);
            if camera.shows_scene {
                self.roots(world_from_root);
            }
            self.view = outer;
            return;
        }
        // Only a position of an image can be converted to another view.
        let Some(window) = self.view.window else { return };
        // Like cull: an absolute camera has a separate world below, a relative one moves the eye.
        let (world_from_eye, world_from_page) = match camera.frame {
            ReferenceFrame::Absolute => (camera.view.inverse(), above.inverse()),
            ReferenceFrame::Relative => {
                let world_from_node = here.world_from_page * above;
                let moved = world_from_node * camera.view.inverse() * world_from_node.inverse();
                (moved * window.world_from_eye, here.world_from_page)
            }
        };
        let fits_depth = match camera.inherit.has(Inherit::NEAR_FAR) {
            true => window.fits_depth,
            false => camera.settings.compute_near_far != ComputeNearFar::Off,
        };
        let window = WindowView {
            world_from_eye,
            clip_from_eye: camera.projection.unwrap_or(window.clip_from_eye),
            viewport_px: camera.viewport_px.unwrap_or(window.viewport_px),
            fits_depth,
        };
        self.in_view(here, node, window, view, world_from_page);
    }

    /// Queues the scene's roots, transformed, for a visit in the current view.
    fn roots(&mut self, world_from_root: DAffine3) {
        if world_from_root.is_finite() {
            let view = self.view;
            let visit = |root: &PageId| Visit {
                place: root.slot,
                world_from_page: world_from_root,
                view,
                stands_in: false,
                ancestor: None,
            };
            self.pages.extend(self.scene.roots().iter().rev().map(visit));
        }
    }

    /// Returns the current view with the masks, levels of detail and drawing order that a camera does not inherit.
    fn view_of(&mut self, camera: &CameraNode) -> View {
        let mut view = self.view;
        view.in_scene_camera |= camera.shows_scene;
        if !camera.inherit.has(Inherit::CULL_MASK) {
            view.rules.mask = camera.settings.cull_mask;
        }
        if let Some(eye) = view.rules.eye.as_mut().filter(|_| !camera.inherit.has(Inherit::LOD_SCALE)) {
            (eye.lod_scale, eye.max_sse_px) = (camera.settings.lod_scale, camera.settings.max_sse_px);
        }
        let (is_after, order) = match camera.order {
            RenderOrder::Nested => return view,
            // A camera that keeps the depths draws into the same layer.
            RenderOrder::PostRender(_) if !camera.clear_depth => return view,
            RenderOrder::PostRender(order) => (true, order),
            RenderOrder::PreRender(order) => (false, order),
        };
        // Shapes in the world are ordered only by the position along them.
        if view.window.is_some() && self.stages.len() < MAX_VIEWS {
            self.stages.push(Stage { above: view.stage, is_after, order });
            view.stage = self.stages.len() - 1;
        }
        view
    }

    /// Visits the children of a node under another view.
    fn in_view(
        &mut self,
        here: &InPage<P::Local>,
        node: u32,
        window: WindowView,
        mut view: View,
        world_from_page: DAffine3,
    ) {
        if self.views >= MAX_VIEWS {
            return;
        }
        let shape = self.probe.open_view(&window).unwrap_or(NOWHERE);
        self.views += 1;
        (view.shape, view.window) = (shape, Some(window));
        if let Some(eye) = &mut view.rules.eye {
            eye.world_from_eye = window.world_from_eye;
            eye.is_parallel = has_parallel_rays(&window.clip_from_eye);
            let [_, _, width, height] = window.viewport_px;
            eye.px_per_radian = px_per_radian(&window.clip_from_eye, [width, height]);
        }
        let outer = std::mem::replace(&mut self.view, view);
        self.below(here, node, world_from_page);
        if view.in_scene_camera && !outer.in_scene_camera {
            self.roots(DAffine3::IDENTITY);
        }
        self.view = outer;
    }

    /// Visits the children of a node with another map of the page.
    fn below(&mut self, here: &InPage<P::Local>, node: u32, world_from_page: DAffine3) {
        let local = self.probe.local(self.view.shape, &world_from_page);
        if local.is_some() || self.view.shape == NOWHERE {
            let end = node + here.page.nodes()[node as usize].skip;
            let (page, place) = (here.page, here.place);
            let below = InPage { page, place, world_from_page, local, stands_in: false, ancestor: None };
            self.nodes(&below, node + 1, end);
        }
    }

    /// Walks a tile tree: visits REPLACE tiles of the wanted level and ADD tiles down to it.
    fn tiles(&mut self, here: &InPage<P::Local>, first: u32) {
        let tiles = here.page.tiles();
        let Ok(root) = tiles.roots().binary_search_by_key(&first, |r| r.tile) else { return };
        let world_from_tile =
            here.world_from_page * here.page.transforms().page_from_node(tiles.roots()[root].transform);
        let Some(local) = self.probe.local(self.view.shape, &world_from_tile) else { return };
        let eye = self.view.rules.eye.map(|eye| tiles.grid().eye(in_frame(&world_from_tile, eye.position())));
        let base_depth = self.scene.base_depth(self.scene.page_id_at(here.place));
        let mut tile = first;
        while tile != NONE {
            let index = tile as usize;
            let (record, bounds) = (&tiles.records()[index], &tiles.bounds()[index]);
            let hidden =
                here.page.masks().get(tiles.nodes()[index] as usize).is_some_and(|m| m & self.view.rules.mask == 0);
            let outside_request = record.has(flag::REQUEST_VOLUME)
                && eye.is_some_and(|eye| !tiles.may_be_requested(tile, eye.position))
                && !stands_in(tiles, tile, here.stands_in);
            if hidden || outside_request || !enters_tile::<P>(&local, tiles, bounds) {
                tile = tiles.behind(tile);
                continue;
            }
            let resident = record.has(flag::RESIDENT);
            let may_be_replaced = eye.is_none_or(|eye| tiles.may_be_replaced(record, eye.position));
            let wants =
                record.has_children() && may_be_replaced && self.wants_children(tiles, tile, eye.as_ref(), base_depth);
            // Cull draws ready children of the ground beside parts of the tile above those that are missing.
            let is_ground = tiles.ground().is_some();
            let ready = record.not_ready_children == 0 || (is_ground && tiles.has_resident_child(record));
            let (draws, descends) = if record.has(flag::PROXY | flag::EXTERNAL) {
                (resident, true)
            } else if !record.has(flag::CONTENT) {
                (false, wants || self.view.rules.lods != LodSelection::AsSeen)
            } else if record.has(flag::ADD) {
                (resident, wants)
            } else if wants && ready {
                (false, true)
            } else {
                // A coarser or finer tile is better than none, but if an eye decides, nothing is drawn here.
                (resident, !resident && (ready || self.view.rules.lods != LodSelection::AsSeen))
            };
            // Cull draws an ancestor instead of an unavailable tile, cut to the tile's volume. Here the whole ancestor is
            // visited.
            let shows_children = descends && ready && record.has_children();
            let is_unavailable =
                (record.has(flag::UNAVAILABLE) || (is_ground && !resident)) && !draws && !shows_children;
            let above = (is_unavailable || record.has(flag::EXTERNAL))
                .then(|| replaced_above(here, tiles, tile, &world_from_tile))
                .flatten();
            if is_unavailable {
                self.visit_ancestor(above);
            } else if draws {
                self.pages.push(Visit {
                    place: tiles.resident(index),
                    world_from_page: world_from_tile * tiles.content_transform(index),
                    view: self.view,
                    stands_in: stands_in(tiles, tile, here.stands_in),
                    ancestor: above,
                });
            }
            tile = if descends && record.has_children() { record.first_child } else { tiles.behind(tile) };
        }
    }

    /// Visits a content instead of an unavailable tile, once.
    fn visit_ancestor(&mut self, ancestor: Option<Ancestor>) {
        let Some(ancestor) = ancestor else { return };
        let key = (ancestor, self.view.shape);
        if !self.ancestors.contains(&key) {
            self.ancestors.push(key);
            let Ancestor { place, world_from_page, stands_in } = ancestor;
            self.pages.push(Visit { place, world_from_page, view: self.view, stands_in, ancestor: None });
        }
    }

    fn wants_children(&self, tiles: &Tiles, tile: u32, eye_in_tile: Option<&TileEye>, base_depth: u32) -> bool {
        let record = &tiles.records()[tile as usize];
        match (self.view.rules.lods, self.view.rules.eye, eye_in_tile) {
            (LodSelection::Level(level), ..) => base_depth + u32::from(record.depth) < level,
            (LodSelection::AsSeen, Some(eye), Some(eye_in_tile)) => {
                let bounds = &tiles.bounds()[tile as usize];
                let (range2, distance2) = tiles.range_and_distance(tile, record, bounds, eye_in_tile, &eye.ranges());
                distance2 < range2
            }
            _ => true,
        }
    }
}

/// Returns the nearest ancestor with resident content that its children replace, across pages.
fn replaced_above<L>(here: &InPage<'_, L>, tiles: &Tiles, tile: u32, world_from_tile: &DAffine3) -> Option<Ancestor> {
    let Some(above) = tiles.resident_from(tiles.parents()[tile as usize]) else { return here.ancestor };
    (!tiles.records()[above as usize].has(flag::ADD)).then(|| Ancestor {
        place: tiles.resident(above as usize),
        world_from_page: *world_from_tile * tiles.content_transform(above as usize),
        stands_in: stands_in(tiles, above, here.stands_in),
    })
}

/// Returns true if a tile replaces content above it. `page_stands_in` tells whether the page does.
fn stands_in(tiles: &Tiles, mut tile: u32, page_stands_in: bool) -> bool {
    loop {
        tile = tiles.parents()[tile as usize];
        let Some(above) = tiles.records().get(tile as usize) else { return page_stands_in };
        if above.has(flag::CONTENT | flag::PROXY | flag::EXTERNAL) {
            return !above.has(flag::PROXY | flag::EXTERNAL | flag::ADD);
        }
    }
}

fn enters_tile<P: Probe>(local: &P::Local, tiles: &Tiles, bounds: &TileBounds) -> bool {
    let center = tiles.grid().center(bounds);
    if bounds.radius_m() >= UNBOUNDED {
        return true;
    }
    if bounds.is_sphere() {
        return P::enters_sphere(local, center, bounds.radius_m().into()).is_some();
    }
    let axes = tiles.axes_of(bounds).map(|axis| DVec3::from_array(axis.map(f64::from)));
    let half = DVec3::from_array(bounds.half_m().map(f64::from));
    // The axes are f32, which moves the ends of a long box by this much.
    let half = half + half.max_element() * f64::from(f32::EPSILON);
    P::enters_box(local, center, &DMat3::from_cols(axes[0], axes[1], axes[2]), half).is_some()
}

/// Converts a point of the world to a frame; the translation is subtracted first, for precision.
fn in_frame(world_from_frame: &DAffine3, point: DVec3) -> DVec3 {
    world_from_frame.matrix3.inverse() * (point - world_from_frame.translation)
}

/// Returns the node that holds a drawable.
pub fn node_of_drawable(page: &Page, drawable: u32) -> u32 {
    (page.nodes().partition_point(|n| n.first_drawable <= drawable) as u32).checked_sub(1).unwrap_or(NONE)
}
