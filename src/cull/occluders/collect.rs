//! Collects the occluders that a view shows, wherever in the scene they hang. Culling thread.
//!
//! The scene lists its pages with occluders, so that scenes without any pay nothing. Whether an occluder is drawn is
//! found from its node upwards, over masks, switches, levels of detail and tiles to the root, and only for those large
//! enough to be used.

use glam::{DAffine3, DVec3};

use super::volumes::{Occluders, Sight};
use crate::cull::fading::{LodFades, TilePart};
use crate::cull::tiles::shows_children;
use crate::cull::views::View;
use crate::cull::visitor::{CameraVisit, cull_info, eye_in};
use crate::scene::{OccluderPage, OccluderRecord, Page, RareNode, Scene, flag, kind};

/// The pages from a root down to one with occluders, outermost first.
pub(super) type Chain = Vec<Link>;

/// One page of a [`Chain`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Link {
    /// Slot of the page in the scene's page table.
    slot: u32,
    /// The node of the page above that the page hangs at.
    hangs_at: u32,
    eye_from_page: DAffine3,
    /// The transform of tile trees that was needed last, with its matrix from the trees to the eye.
    tiles: Option<(u32, DAffine3)>,
}

/// The view whose occluders are collected.
pub(in crate::cull) struct Collector<'a> {
    pub scene: &'a Scene,
    pub view: &'a View,
    /// The camera whose children alone are drawn; `None` for the whole scene.
    pub camera: Option<&'a CameraVisit>,
    pub fades: &'a LodFades,
    pub frame: u32,
}

/// Whether a node is drawn, as far as the nodes above it in its page decide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shows {
    /// Some node above hides it.
    No,
    /// It is drawn if its page is.
    InPage,
    /// It lies below the camera that is culled for, which shows it.
    BelowCamera,
}

impl Collector<'_> {
    /// Offers the occluders that the view shows; `chain` is scratch memory.
    pub(super) fn collect(&self, into: &mut Occluders, chain: &mut Chain) {
        let view = self.view;
        let sight = Sight::new(&view.camera.clip_from_eye, view.planes);
        chain.clear();
        for OccluderPage { place: slot, sphere, .. } in self.scene.occluder_pages() {
            if !self.find_chain(*slot, chain) {
                continue;
            }
            let Some(link) = chain.last() else { continue };
            // Tested before the page is read: most pages are out of the view, or their occluders are too small.
            if !into.may_use(&sight, &sphere.transformed(&link.eye_from_page)) {
                continue;
            }
            let Some(page) = self.scene.page_at(*slot) else { continue };
            let mut hangs_in_view = None;
            for OccluderRecord { node, transform, occluder } in page.occluders() {
                let eye_from_page = self.eye_from_page(page, link, *node);
                let eye_from_node = eye_from_page * page.transforms().page_from_node(*transform);
                into.offer(&sight, &eye_from_node, occluder, || match self.shows(page, link, *node) {
                    Shows::No => false,
                    Shows::BelowCamera => true,
                    Shows::InPage => *hangs_in_view.get_or_insert_with(|| self.hangs_in_view(chain)),
                });
            }
        }
    }

    /// Fills in the pages from a root to a page. Returns false for a page that is not attached. Most pages hang in the same
    /// page as the one before, whose links are then kept.
    fn find_chain(&self, slot: u32, chain: &mut Chain) -> bool {
        let slot_of = |at: u32| self.scene.slot_at(at).filter(|_| self.camera.is_none_or(|c| c.page.slot != at));
        let link = |slot: u32| Link { slot, hangs_at: slot_of(slot).map_or(0, |s| s.index), ..Link::default() };
        let holder = slot_of(slot).map(|slot| slot.page.slot);
        let is_known = chain.len() > 1 && chain.get(chain.len() - 2).map(|above| above.slot) == holder;
        if is_known {
            chain.pop();
            chain.push(link(slot));
            return self.find_last(chain);
        }
        chain.clear();
        let mut at = slot;
        chain.push(link(at));
        while let Some(slot) = slot_of(at) {
            at = slot.page.slot;
            chain.push(link(at));
        }
        chain.reverse();
        let Some(top) = chain.first_mut() else { return false };
        top.eye_from_page = match self.camera {
            None => self.view.camera.eye_from_world,
            Some(camera) if camera.page.slot == top.slot => camera.page.eye_from_page,
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

    /// Computes `eye_from_page` of the last page of a chain from that of the page above.
    fn find_last(&self, chain: &mut [Link]) -> bool {
        let [.., above, last] = chain else { return false };
        let Some(page) = self.scene.page_at(above.slot) else { return false };
        let Some((root, tile)) = tile_and_root(page, last.hangs_at) else { return false };
        let transform = page.tiles().roots()[root].transform;
        let eye_from_tiles = match above.tiles {
            Some((of, known)) if of == transform => known,
            _ => {
                let eye_from_page = self.eye_from_page(page, above, last.hangs_at);
                let eye_from_tiles = eye_from_page * page.transforms().page_from_node(transform);
                // Inside and outside of a camera the same transform is seen from two eyes.
                let is_split = self.camera.is_some_and(|c| c.page.slot == above.slot);
                above.tiles = (!is_split).then_some((transform, eye_from_tiles));
                eye_from_tiles
            }
        };
        last.eye_from_page = eye_from_tiles * page.tiles().content_transform(tile as usize);
        true
    }

    /// Returns `eye_from_page` as it holds at a node: below an absolute transform it is another.
    fn eye_from_page(&self, page: &Page, link: &Link, node: u32) -> DAffine3 {
        let special = |node: u32| page.rare_nodes().get(*page.payloads().get(node as usize)? as usize);
        if page.rare_nodes().len() > page.occluders().len() {
            for (above, _) in page.path_to_root(node) {
                if self.camera.is_some_and(|c| c.page.slot == link.slot && c.node == above) {
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

    /// Returns true if the page at the end of a chain is drawn.
    fn hangs_in_view(&self, chain: &[Link]) -> bool {
        for pair in chain.windows(2).rev() {
            let [above, below] = pair else { return false };
            let Some(page) = self.scene.page_at(above.slot) else { return false };
            match self.shows(page, above, below.hangs_at) {
                Shows::No => return false,
                Shows::BelowCamera => return true,
                Shows::InPage => {}
            }
        }
        self.camera.is_none()
    }

    /// Finds whether some node between a node and its page's root hides it.
    fn shows(&self, page: &Page, link: &Link, node: u32) -> Shows {
        let mut eye_in_tiles = None;
        for (node, child) in page.path_to_root(node) {
            if self.camera.is_some_and(|c| c.page.slot == link.slot && c.node == node) {
                return Shows::BelowCamera;
            }
            let record = &page.nodes()[node as usize];
            let is_seen =
                page.masks().get(node as usize).unwrap_or(&u32::MAX) & self.view.camera.settings.cull_mask != 0;
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
        let Some((callback, _)) = page.cull_callback(node) else { return true };
        // Tiles below a tile are walked without their callbacks.
        if page.tile_of(page.parents()[node as usize]).is_some() {
            return true;
        }
        let eye = eye_in(&self.eye_from_page(page, link, node));
        (callback.0)(&cull_info(page, node, eye, self.frame)).visits()
    }

    fn lod_shows(&self, page: &Page, link: &Link, node: u32, child: u32) -> bool {
        let index = page.payloads()[node as usize] as usize;
        let lod = &page.lods()[index];
        let eye_in_page = eye_in(&self.eye_from_page(page, link, node));
        let eye = page.transforms().point_in_node(page.enclosing_transform(node), eye_in_page);
        let measure = lod.measure(eye.distance(lod.center), self.view.camera.settings.lod_scale, &self.view.ranges);
        let child = page.child_index(node, child);
        let is_in_range = lod.shows(child, measure);
        let page_id = self.scene.page_id_at(link.slot);
        is_in_range && (!self.fades_in_time() || self.fades.lod_is_settled(page_id, index, child))
    }

    fn fades_in_time(&self) -> bool {
        self.view.camera.settings.lod_fade_s > 0.0
    }

    fn eye_in_tiles(&self, page: &Page, link: &Link, node: u32) -> DVec3 {
        let transform = tile_and_root(page, node).map_or(0, |(root, _)| page.tiles().roots()[root].transform);
        eye_in(&(self.eye_from_page(page, link, node) * page.transforms().page_from_node(transform)))
    }

    /// Returns true if the walk of the tile tree draws a tile's content or, for `below`, the tiles below it.
    fn tile_shows(&self, page: &Page, link: &Link, node: u32, below: bool, eye: DVec3) -> bool {
        let (tiles, tile) = (page.tiles(), page.payloads()[node as usize]);
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
        let page_id = self.scene.page_id_at(link.slot);
        is_shown && (!self.fades_in_time() || self.fades.tile_is_settled(page_id, tile, part))
    }
}

/// Returns the tile of a node, and the index of the page's tile tree that it is in.
fn tile_and_root(page: &Page, node: u32) -> Option<(usize, u32)> {
    let tile = page.tile_of(node)? as u32;
    let root = page.tiles().roots().partition_point(|r| r.tile <= tile).checked_sub(1)?;
    Some((root, tile))
}
