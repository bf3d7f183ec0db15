//! Which occluders a view has: those of the pages that it draws, wherever in the scene they hang.
//!
//! The scene lists its pages with occluders, so that none cost nothing. Whether one is drawn is asked from the node up,
//! over masks, switches, levels of detail and tiles to the root, and only for those large enough to be used.

use glam::{DAffine3, DVec3};

use super::{Occluders, Sight};
use crate::cull::cameras::CameraPlace;
use crate::cull::fade::{LodFades, TilePart};
use crate::cull::tiles::shows_children;
use crate::cull::view::View;
use crate::cull::visitor::eye_in;
use crate::scene::{CullAction, CullInfo, OccluderPage, OccluderRecord, Page, RareNode, Scene, UNBOUNDED, flag, kind};

/// A page on the way from the top down to one with occluders.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::cull) struct Link {
    place: u32,
    /// The node of the page above where it hangs.
    hangs_at: u32,
    eye_from_page: DAffine3,
    /// Where the tiles of one of its transforms are seen, those that were last asked for.
    tiles: Option<(u32, DAffine3)>,
}

/// What is asked about nodes.
pub(in crate::cull) struct Collector<'a> {
    pub scene: &'a Scene,
    pub view: &'a View,
    /// Only what is below this camera is drawn.
    pub camera: Option<&'a CameraPlace>,
    pub fades: &'a LodFades,
    pub frame: u32,
}

impl Occluders {
    /// Takes the occluders that a view shows.
    pub fn collect(&mut self, collector: &Collector) {
        let view = collector.view;
        let sight = Sight::new(&view.clip_from_eye, view.planes);
        let mut chain = std::mem::take(&mut self.chain);
        chain.clear();
        for OccluderPage { place, sphere, .. } in collector.scene.occluder_pages() {
            if !collector.find_chain(*place, &mut chain) {
                continue;
            }
            let Some(link) = chain.last() else { continue };
            // Before anything of the page is read: most are out of the view, or too small.
            if !self.may_use(&sight, &sphere.transformed(&link.eye_from_page)) {
                continue;
            }
            let Some(page) = collector.scene.page_at(*place) else { continue };
            let mut hangs_in_view = None;
            for OccluderRecord { node, transform, occluder } in page.occluders() {
                let eye_from_page = collector.eye_from_page(page, link, *node);
                let eye_from_node = eye_from_page * page.transforms().page_from_node(*transform);
                self.offer(&sight, &eye_from_node, occluder, || match collector.shows(page, link, *node) {
                    Shows::No => false,
                    Shows::BelowCamera => true,
                    Shows::InPage => *hangs_in_view.get_or_insert_with(|| collector.hangs_in_view(&chain)),
                });
            }
        }
        self.chain = chain;
    }
}

/// What is above a node in its page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shows {
    No,
    /// It is drawn where the page is.
    InPage,
    /// The camera that is culled for is above it.
    BelowCamera,
}

impl Collector<'_> {
    /// Fills in the pages above one, and where each is seen; false for one that hangs nowhere. What `chain` holds of the
    /// page before is kept where both hang in one page, as most do.
    fn find_chain(&self, place: u32, chain: &mut Vec<Link>) -> bool {
        let slot_of = |at: u32| self.scene.slot_at(at).filter(|_| self.camera.is_none_or(|c| c.visit.place != at));
        let link = |place: u32| Link { place, hangs_at: slot_of(place).map_or(0, |s| s.index), ..Link::default() };
        let holder = slot_of(place).map(|slot| slot.page.slot);
        let is_known = chain.len() > 1 && chain.get(chain.len() - 2).map(|above| above.place) == holder;
        if is_known {
            chain.pop();
            chain.push(link(place));
            return self.find_last(chain);
        }
        chain.clear();
        let mut at = place;
        chain.push(link(at));
        while let Some(slot) = slot_of(at) {
            at = slot.page.slot;
            chain.push(link(at));
        }
        chain.reverse();
        let Some(top) = chain.first_mut() else { return false };
        top.eye_from_page = match self.camera {
            None => self.view.eye_from_world,
            Some(camera) if camera.visit.place == top.place => camera.visit.eye_from_page,
            Some(_) => {
                chain.clear();
                return false;
            }
        };
        let is_found = (2..=chain.len()).all(|count| self.find_last(&mut chain[..count]));
        if !is_found {
            chain.clear();
        }
        is_found
    }

    /// Where the last page of a chain is seen, from where the one above is.
    fn find_last(&self, chain: &mut [Link]) -> bool {
        let [.., above, last] = chain else { return false };
        let Some(page) = self.scene.page_at(above.place) else { return false };
        let Some((root, tile)) = tile_and_root(page, last.hangs_at) else { return false };
        let transform = page.tiles().roots()[root].transform;
        let eye_from_tiles = match above.tiles {
            Some((of, known)) if of == transform => known,
            _ => {
                let eye_from_page = self.eye_from_page(page, above, last.hangs_at);
                let eye_from_tiles = eye_from_page * page.transforms().page_from_node(transform);
                // Inside and outside of a camera one transform may be seen from two places.
                let is_split = self.camera.is_some_and(|c| c.visit.place == above.place);
                above.tiles = (!is_split).then_some((transform, eye_from_tiles));
                eye_from_tiles
            }
        };
        last.eye_from_page = eye_from_tiles * page.tiles().content_transform(tile as usize);
        true
    }

    /// Where a page is seen from a node of it: below an absolute transform it lies elsewhere.
    fn eye_from_page(&self, page: &Page, link: &Link, node: u32) -> DAffine3 {
        let special = |node: u32| page.rare_nodes().get(*page.payloads().get(node as usize)? as usize);
        if page.rare_nodes().len() > page.occluders().len() {
            for (above, _) in page.path_to_root(node) {
                if self.camera.is_some_and(|c| c.visit.place == link.place && c.node == above) {
                    break;
                }
                let is_special = page.nodes()[above as usize].kind == kind::SPECIAL;
                if is_special && matches!(special(above), Some(RareNode::AbsoluteTransform)) {
                    return page.transforms().page_from_node(page.enclosing_transform(above)).inverse();
                }
            }
        }
        link.eye_from_page
    }

    /// Whether the page at the end of a chain is drawn.
    fn hangs_in_view(&self, chain: &[Link]) -> bool {
        for pair in chain.windows(2).rev() {
            let [above, below] = pair else { return false };
            let Some(page) = self.scene.page_at(above.place) else { return false };
            match self.shows(page, above, below.hangs_at) {
                Shows::No => return false,
                Shows::BelowCamera => return true,
                Shows::InPage => {}
            }
        }
        self.camera.is_none()
    }

    /// Whether nothing between a node and its page's root hides what is there.
    fn shows(&self, page: &Page, link: &Link, node: u32) -> Shows {
        let mut eye_in_tiles = None;
        for (node, child) in page.path_to_root(node) {
            if self.camera.is_some_and(|c| c.visit.place == link.place && c.node == node) {
                return Shows::BelowCamera;
            }
            let record = &page.nodes()[node as usize];
            let is_seen = page.masks().get(node as usize).unwrap_or(&u32::MAX) & self.view.settings.cull_mask != 0;
            let is_shown = is_seen
                && match (record.kind, child) {
                    (kind::SWITCH, Some(child)) => page.switch_shows(node, child),
                    (kind::LOD, Some(child)) => self.lod_shows(page, link, node, child),
                    (kind::TILE, child) => {
                        let eye = *eye_in_tiles.get_or_insert_with(|| self.eye_in_tiles(page, link, node));
                        self.tile_shows(page, link, node, child.is_some(), eye)
                    }
                    (kind::SPECIAL, Some(_)) => {
                        let special = page.rare_nodes().get(page.payloads()[node as usize] as usize);
                        !matches!(special, Some(RareNode::Camera { .. } | RareNode::Projection { .. }))
                    }
                    _ => true,
                };
            if !is_shown || !self.callback_shows(page, link, node) {
                return Shows::No;
            }
        }
        Shows::InPage
    }

    fn callback_shows(&self, page: &Page, link: &Link, node: u32) -> bool {
        let Some(callback) = page.cull_callback(node) else { return true };
        // The walk of a tile tree asks none.
        if page.tile_of(page.parents()[node as usize]).is_some() {
            return true;
        }
        let eye = eye_in(&self.eye_from_page(page, link, node));
        matches!((callback.0)(&cull_info(page, node, eye, self.frame)), CullAction::Traverse)
    }

    fn lod_shows(&self, page: &Page, link: &Link, node: u32, child: u32) -> bool {
        let index = page.payloads()[node as usize] as usize;
        let lod = &page.lods()[index];
        let eye_in_page = eye_in(&self.eye_from_page(page, link, node));
        let eye = page.transforms().point_in_node(page.enclosing_transform(node), eye_in_page);
        let measure = lod.measure(eye.distance(lod.center), self.view.settings.lod_scale, &self.view.ranges);
        let place = page.child_index(node, child);
        let is_in_range = lod.shows(place, measure);
        let generation = self.scene.page_id_at(link.place).generation;
        is_in_range && (!self.fades_in_time() || self.fades.lod_rests(link.place, generation, index, place))
    }

    fn fades_in_time(&self) -> bool {
        self.view.settings.lod_fade_s > 0.0
    }

    fn eye_in_tiles(&self, page: &Page, link: &Link, node: u32) -> DVec3 {
        let transform = tile_and_root(page, node).map_or(0, |(root, _)| page.tiles().roots()[root].transform);
        eye_in(&(self.eye_from_page(page, link, node) * page.transforms().page_from_node(transform)))
    }

    /// Whether a tile that is met shows its content, or the tiles below it: what the tile walk does with it.
    fn tile_shows(&self, page: &Page, link: &Link, node: u32, below: bool, eye: DVec3) -> bool {
        let (tiles, tile) = (&page.tiles(), page.payloads()[node as usize]);
        let Some(record) = tiles.records().get(tile as usize) else { return false };
        if record.has(flag::REQUEST_VOLUME) && !tiles.may_be_requested(tile, eye) {
            return false;
        }
        if record.has(flag::PROXY | flag::EXTERNAL) {
            return true;
        }
        let bounds = &tiles.bounds()[tile as usize];
        let (range2, distance2) =
            tiles.range_and_distance(tile, record, bounds, &tiles.grid().eye(eye), &self.view.ranges);
        let is_near = distance2 < range2 && tiles.may_be_replaced(record, eye);
        if !record.has(flag::CONTENT) {
            return is_near;
        }
        let is_refined = shows_children(record, is_near);
        let part = match below {
            true => TilePart::Below,
            false if record.has(flag::ADD) => TilePart::Added,
            false => TilePart::Own,
        };
        let is_shown = match part {
            TilePart::Own => !is_refined,
            TilePart::Added => true,
            TilePart::Below => is_refined,
        };
        let generation = self.scene.page_id_at(link.place).generation;
        is_shown && (!self.fades_in_time() || self.fades.tile_rests(link.place, generation, tile, part))
    }
}

/// What a node's cull callback is told.
pub(in crate::cull) fn cull_info(page: &Page, node: u32, eye_in_page: DVec3, frame: u32) -> CullInfo {
    let sphere = page.spheres()[node as usize];
    let middle = page.origin() + sphere.truncate().as_dvec3();
    let is_bounded = (0.0..UNBOUNDED).contains(&sphere.w);
    CullInfo { frame, eye_in_page, distance_m: if is_bounded { middle.distance(eye_in_page) } else { f64::INFINITY } }
}

/// The tile of a node, and the tree of the page that it is in.
fn tile_and_root(page: &Page, node: u32) -> Option<(usize, u32)> {
    let tile = page.tile_of(node)? as u32;
    let root = page.tiles().roots().partition_point(|r| r.tile <= tile).checked_sub(1)?;
    Some((root, tile))
}
