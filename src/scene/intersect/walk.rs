//! The way of a shape through the scene: which drawables it may meet, and where it enters their boxes.
//!
//! Follows cull: the same pages, switches, levels of detail and frames, so that what is met is what is drawn.

use glam::{DAffine3, DMat3, DVec3};

use super::visitor::{EyePoint, LodSelection};
use crate::scene::page::{NONE, Page, Special, UNBOUNDED, kind};
use crate::scene::tiles::{TileBounds, TileRecord, Tiles, flag};
use crate::scene::{CameraNode, INACTIVE, ReferenceFrame, Scene};

/// A shape in the world that can be moved into other frames.
pub trait Probe {
    /// The shape in a frame.
    type Local;

    /// The shape in the frame that `world_from_frame` comes from; `None` where that map has no inverse.
    fn local(&self, world_from_frame: &DAffine3) -> Option<Self::Local>;

    /// Where along the shape it enters a sphere; `None` where it misses.
    fn enters_sphere(local: &Self::Local, center: DVec3, radius_m: f64) -> Option<f64>;

    /// Where along the shape it enters a box with unit axes (columns); `None` where it misses.
    fn enters_box(local: &Self::Local, center: DVec3, axes: &DMat3, half: DVec3) -> Option<f64>;
}

/// A drawable whose box is met.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Where the shape enters its box.
    pub enters: f64,
    /// Place of its page in the scene's table.
    pub place: u32,
    pub drawable: u32,
    pub world_from_drawable: DAffine3,
}

/// What decides which nodes are visited.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    pub mask: u32,
    pub lods: LodSelection,
    pub eye: Option<EyePoint>,
}

/// A page, seen by the shape.
struct InPage<'a, L> {
    page: &'a Page,
    place: u32,
    world_from_page: DAffine3,
    local: L,
}

struct Walk<'a, P: Probe> {
    scene: &'a Scene,
    rules: &'a Rules,
    probe: &'a P,
    pages: Vec<(u32, DAffine3)>,
    found: &'a mut Vec<Candidate>,
}

/// Finds the drawables that a shape may meet, in the order in which it enters their boxes.
pub fn candidates<P: Probe>(scene: &Scene, rules: &Rules, probe: &P, found: &mut Vec<Candidate>) {
    found.clear();
    let pages = scene.roots().iter().rev().map(|root| (root.slot, DAffine3::IDENTITY)).collect();
    let mut walk = Walk { scene, rules, probe, pages, found };
    while let Some((place, world_from_page)) = walk.pages.pop() {
        let Some(page) = scene.page_at(place) else { continue };
        if let Some(local) = probe.local(&world_from_page) {
            walk.nodes(&InPage { page, place, world_from_page, local }, 0, page.node_count() as u32);
        }
    }
    found.sort_by(|a, b| a.enters.total_cmp(&b.enters));
}

impl<P: Probe> Walk<'_, P> {
    /// Visits nodes `first..last`, whole subtrees.
    fn nodes(&mut self, here: &InPage<P::Local>, first: u32, last: u32) {
        let page = here.page;
        let mut node = first;
        while node < last {
            let index = node as usize;
            let record = page.nodes[index];
            let end = node + record.skip;
            let sphere = page.spheres[index];
            let is_hidden = page.masks.get(index).is_some_and(|mask| mask & self.rules.mask == 0);
            // Bounds of nodes that are not culled say nothing.
            let is_missed = record.flags & INACTIVE == 0
                && (sphere.w < 0.0
                    || sphere.w < UNBOUNDED
                        && P::enters_sphere(&here.local, page.origin + sphere.truncate().as_dvec3(), sphere.w.into())
                            .is_none());
            if is_hidden || is_missed {
                node = end;
                continue;
            }
            node = match record.kind {
                kind::GEODE | kind::GROUP => {
                    for drawable in record.first_drawable..page.nodes[index + 1].first_drawable {
                        if let Some(enters) = self.enters_drawable(here, drawable) {
                            let transform = page.drawable_refs[drawable as usize].transform;
                            let world_from_drawable = here.world_from_page * page.transforms.page_from_node(transform);
                            self.found.push(Candidate { enters, place: here.place, drawable, world_from_drawable });
                        }
                    }
                    node + 1
                }
                kind::TRANSFORM => node + 1,
                kind::TILE => {
                    self.tiles(here, page.payloads[index]);
                    end
                }
                kind::SWITCH => {
                    let shown = &page.switches[page.payloads[index] as usize];
                    self.children(here, node, |child| shown.get(child).copied().unwrap_or(false));
                    end
                }
                kind::LOD => {
                    let lod = &page.lods[page.payloads[index] as usize];
                    let at = self.lod_distance(here, node, lod.center);
                    // Without an eye what is shown nearest.
                    let least = lod.ranges_m.iter().map(|r| r[0]).fold(f64::INFINITY, f64::min);
                    let distance_m = at.unwrap_or(least);
                    self.children(here, node, |child| {
                        lod.ranges_m.get(child).is_some_and(|r| r[0] <= distance_m && distance_m < r[1])
                    });
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

    fn children(&mut self, here: &InPage<P::Local>, node: u32, is_shown: impl Fn(usize) -> bool) {
        let nodes = &here.page.nodes;
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
        let four = here.page.boxes.get(drawable as usize / 4)?;
        let lane = drawable as usize % 4;
        let half = four.half.map(|h| f64::from(h[lane]));
        if half[0] >= f64::from(UNBOUNDED) {
            return Some(f64::NEG_INFINITY);
        }
        let center = here.page.origin + DVec3::from_array(four.center.map(|c| f64::from(c[lane])));
        P::enters_box(&here.local, center, &DMat3::IDENTITY, DVec3::from_array(half))
    }

    /// Distance that a LOD node compares; `None` where no eye decides.
    fn lod_distance(&self, here: &InPage<P::Local>, node: u32, center: DVec3) -> Option<f64> {
        let eye = self.rules.eye.filter(|_| self.rules.lods == LodSelection::AsSeen)?;
        let eye_in_page = in_frame(&here.world_from_page, eye.position());
        let page = here.page;
        let eye_in_node = page.transforms.point_in_node(page.enclosing_transform(node), eye_in_page);
        Some(eye_in_node.distance(center) * eye.lod_scale)
    }

    /// Visits a node of a rarer kind. False: its children are visited like those of a group.
    fn special(&mut self, here: &InPage<P::Local>, node: u32) -> bool {
        let page = here.page;
        let Some(special) = page.specials.get(page.payloads[node as usize] as usize) else { return false };
        match special {
            Special::Billboard { mode, positions } => {
                let Some(eye) = self.rules.eye else { return false };
                let world_from_node =
                    here.world_from_page * page.transforms.page_from_node(page.enclosing_transform(node));
                let eye_in_node = in_frame(&world_from_node, eye.position());
                let eye_from_node = eye.world_from_eye.inverse() * world_from_node;
                for (drawable, position) in (page.nodes[node as usize].first_drawable..).zip(positions) {
                    let Some(enters) = self.enters_drawable(here, drawable) else { continue };
                    let eye_from_drawable = mode.eye_from_drawable(&eye_from_node, eye_in_node, *position);
                    let world_from_drawable = eye.world_from_eye * eye_from_drawable;
                    self.found.push(Candidate { enters, place: here.place, drawable, world_from_drawable });
                }
                false
            }
            Special::AbsoluteTransform => {
                if let Some(eye) = self.rules.eye {
                    let above = page.transforms.page_from_node(page.enclosing_transform(node));
                    self.below(here, node, eye.world_from_eye * above.inverse());
                }
                true
            }
            Special::Camera { camera, .. } => {
                self.camera(here, node, camera);
                true
            }
            // Another picture: a place in the world says nothing about where it is there.
            Special::Projection { .. } => true,
            _ => false,
        }
    }

    fn camera(&mut self, here: &InPage<P::Local>, node: u32, camera: &CameraNode) {
        if camera.target.is_some() || camera.projection.is_some() || camera.viewport_px.is_some() {
            return; // another picture
        }
        let page = here.page;
        let above = page.transforms.page_from_node(page.enclosing_transform(node));
        match (camera.frame, self.rules.eye) {
            (ReferenceFrame::Absolute, Some(eye)) => {
                self.below(here, node, eye.world_from_eye * camera.view * above.inverse());
            }
            (ReferenceFrame::Absolute, None) => {}
            (ReferenceFrame::Relative, _) => {
                self.below(here, node, here.world_from_page * above * camera.view * above.inverse());
            }
        }
    }

    /// Visits the children of a node as if the page lay elsewhere.
    fn below(&mut self, here: &InPage<P::Local>, node: u32, world_from_page: DAffine3) {
        if let Some(local) = self.probe.local(&world_from_page) {
            let end = node + here.page.nodes[node as usize].skip;
            self.nodes(&InPage { page: here.page, place: here.place, world_from_page, local }, node + 1, end);
        }
    }

    /// Walks a tile tree: of REPLACE tiles what is drawn at the wanted level, of ADD tiles all down to it.
    fn tiles(&mut self, here: &InPage<P::Local>, first: u32) {
        let tiles = &here.page.tiles;
        let Ok(root) = tiles.roots.binary_search_by_key(&first, |r| r.tile) else { return };
        let world_from_tile = here.world_from_page * here.page.transforms.page_from_node(tiles.roots[root].transform);
        let Some(local) = self.probe.local(&world_from_tile) else { return };
        let eye = self.rules.eye.map(|eye| in_frame(&world_from_tile, eye.position()));
        let base_depth = self.scene.base_depth(self.scene.page_id_at(here.place));
        let last = first + tiles.records[first as usize].skip;
        let mut tile = first;
        while tile < last {
            let index = tile as usize;
            let (record, bounds) = (&tiles.records[index], &tiles.bounds[index]);
            let hidden = here.page.masks.get(tiles.nodes[index] as usize).is_some_and(|m| m & self.rules.mask == 0);
            let outside_request =
                record.has(flag::REQUEST_VOLUME) && eye.is_some_and(|eye| !tiles.may_be_requested(tile, eye));
            if hidden || outside_request || !enters_tile::<P>(&local, tiles, bounds, record) {
                tile += record.skip;
                continue;
            }
            let resident = record.has(flag::RESIDENT);
            let wants = record.has_children() && self.wants_children(tiles, tile, eye, base_depth);
            let ready = record.not_ready_children == 0;
            let (draws, descends) = if record.has(flag::PROXY | flag::EXTERNAL) {
                (resident, true)
            } else if !record.has(flag::CONTENT) {
                (false, true)
            } else if record.has(flag::ADD) {
                (resident, wants)
            } else if wants && ready {
                (false, true)
            } else {
                // Something is better than nothing, but where an eye decides nothing is drawn there.
                (resident, !resident && (ready || self.rules.lods != LodSelection::AsSeen))
            };
            if draws {
                let content = &tiles.content_transforms[tiles.content_transform_of[index] as usize];
                self.pages.push((record.resident, world_from_tile * *content));
            }
            tile += if descends { 1 } else { record.skip };
        }
    }

    fn wants_children(&self, tiles: &Tiles, tile: u32, eye_in_tile: Option<DVec3>, base_depth: u32) -> bool {
        let record = &tiles.records[tile as usize];
        match (self.rules.lods, self.rules.eye, eye_in_tile) {
            (LodSelection::Level(level), ..) => base_depth + u32::from(record.depth) < level,
            (LodSelection::AsSeen, Some(eye), Some(eye_in_tile)) => {
                let bounds = &tiles.bounds[tile as usize];
                let offset = bounds.offset_from(eye_in_tile);
                let (range2, distance2) =
                    tiles.range_and_distance(tile, record, bounds, offset, eye_in_tile, eye.ranges());
                distance2 < range2
            }
            _ => true,
        }
    }
}

fn enters_tile<P: Probe>(local: &P::Local, tiles: &Tiles, bounds: &TileBounds, record: &TileRecord) -> bool {
    let center = DVec3::from_array(bounds.center);
    if bounds.radius_m >= UNBOUNDED {
        return true;
    }
    if record.has(flag::SPHERE) {
        return P::enters_sphere(local, center, bounds.radius_m.into()).is_some();
    }
    let axes = tiles.axes_of(bounds).map(|axis| DVec3::from_array(axis.map(f64::from)));
    let half = DVec3::from_array(bounds.half_m.map(f64::from));
    // The axes are f32: at the ends of a long box off by this much.
    let half = half + half.max_element() * f64::from(f32::EPSILON);
    P::enters_box(local, center, &DMat3::from_cols(axes[0], axes[1], axes[2]), half).is_some()
}

/// A point of the world in a frame; the translation is subtracted first.
fn in_frame(world_from_frame: &DAffine3, point: DVec3) -> DVec3 {
    world_from_frame.matrix3.inverse() * (point - world_from_frame.translation)
}

/// The node that holds a drawable.
pub fn node_of_drawable(page: &Page, drawable: u32) -> u32 {
    (page.nodes.partition_point(|n| n.first_drawable <= drawable) as u32).checked_sub(1).unwrap_or(NONE)
}
