//! Stand-ins: the content of an ancestor, drawn within the volume of a tile whose load failed, or of a globe's tile that has
//! just come into sight, so that its siblings need not wait for it. Culling thread.

use glam::Vec3;

use super::walk_context::WalkContext;
use crate::cull::fading::Fade;
use crate::cull::stage::{CutVolume, DrawnPart};
use crate::cull::visitor::{QueuedPage, Traversal};
use crate::scene::{Tiles, flag};

/// The least margin around the volume, as a share of the tile's radius. The margin is the error of the coarser surface if
/// that is more, since this surface may lie outside of the tile's volume.
const MIN_MARGIN: f32 = 0.01;

/// The width of the backdrop around the volume: a share of the tile's radius, and a multiple of the coarser surface's error.
/// Where that surface ends above a neighbour's, a ray that passes between the two has crossed it nearby.
const BACKDROP_RADII: f32 = 1.0;
const BACKDROP_ERRORS: f32 = 4.0;

/// A resident content above a tile.
struct Ancestor {
    tile: u32,
    /// Index of the attachment frame that its page hangs in.
    attachment: u32,
    /// State graph node above it.
    state: u32,
    /// Its geometric error in metres; 0 if it has none.
    error_m: f32,
}

impl Traversal<'_> {
    /// Draws the nearest resident ancestor of a tile, cut to the tile's volume, and a wider part of it behind everything
    /// else, which closes the gaps along the cut. Draws nothing if there is none, or if its content is drawn beside its
    /// children's in any case. Shadow maps get nothing, since a coarse surface would throw shadows on the finer ones beside it.
    #[cold]
    #[inline(never)]
    pub(super) fn stand_in(&mut self, walk: &WalkContext, tile: u32) {
        if !walk.requests {
            return;
        }
        let Some(ancestor) = self.resident_above(walk, tile) else { return };
        let bounds = &walk.tiles.bounds()[tile as usize];
        let margin_m = ancestor.error_m.max(MIN_MARGIN * bounds.radius_m());
        let backdrop_m = margin_m + BACKDROP_RADII * bounds.radius_m() + BACKDROP_ERRORS * ancestor.error_m;
        let center = walk.tiles.grid().center(bounds);
        let eye_from_frame = self.queue.frame(walk.view.attachment).eye_from_frame;
        let axes = walk.tiles.axes_of(bounds);
        let volume = |margin_m: f32| {
            let half_m = (Vec3::from_array(bounds.half_m()) + margin_m).as_dvec3();
            CutVolume::new(&eye_from_frame, center, axes, half_m, bounds.is_sphere())
        };
        self.counters.stand_ins += 1;
        for part in [DrawnPart::Within(volume(margin_m)), DrawnPart::Backdrop(volume(backdrop_m))] {
            self.queue.push(QueuedPage {
                first: ancestor.tile,
                end: ancestor.tile + 1,
                attachment: ancestor.attachment,
                state: self.states.part(ancestor.state, part, self.stage),
                fade: Fade::NONE,
                mask: self.views.current().planes.mask,
            });
        }
    }

    /// Returns the nearest ancestor with resident content that its children replace, across pages.
    fn resident_above(&mut self, walk: &WalkContext, tile: u32) -> Option<Ancestor> {
        if let Some(found) = walk.tiles.resident_from(walk.tiles.parents()[tile as usize]) {
            let record = &walk.tiles.records()[found as usize];
            let state = self.states.path_state(walk.page, walk.state_path(found, record));
            return ancestor(walk.tiles, found, walk.view.attachment, state);
        }
        let (mut page_at, mut attachment) = (walk.page_id.slot, walk.view.attachment);
        loop {
            attachment = self.queue.frame(attachment).above;
            let (holder, tile) = self.scene.tile_above(page_at)?;
            let tiles = self.scene.page_at(holder)?.tiles();
            if let Some(found) = tiles.resident_from(tile as u32) {
                return ancestor(tiles, found, attachment, self.queue.frame(attachment).state);
            }
            page_at = holder;
        }
    }
}

/// Describes a tile that was found; `None` if its content is drawn in any case.
fn ancestor(tiles: &Tiles, tile: u32, attachment: u32, state: u32) -> Option<Ancestor> {
    let record = &tiles.records()[tile as usize];
    if record.has(flag::ADD) {
        return None;
    }
    let has_error = !record.has(flag::DISTANCE);
    let error_m = if has_error { tiles.bounds()[tile as usize].metric_m() } else { 0.0 };
    Some(Ancestor { tile, attachment, state, error_m })
}
