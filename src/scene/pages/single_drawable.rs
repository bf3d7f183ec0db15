//! [`SingleDrawable`]: all that a cull needs of a page with one drawable, which most tile contents are.
//!
//! The scene keeps it in its page table. Between two frames of some milliseconds most of a scene leaves the cache of the
//! core that culls. The arrays of a page take about twenty cache lines, each found through the one before; this takes
//! three or four that lie together. Update makes it when the page is attached and drops it when the page may change; culls
//! read it.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::node_arrays::{NodeRecord, SIMPLE_SUBTREE, kind};
use super::page::Page;
use super::page_payload::DrawSlot;
use crate::scene::geometry::NormalCone;
use crate::state::StateSet;

/// A copy of the only drawable of a page, with its frame, box, state and slot.
#[derive(Debug)]
pub(crate) struct SingleDrawable {
    pub page_from_drawable: DAffine3,
    /// The centre of its box, page frame.
    pub center: DVec3,
    /// Half the size of its box along the page's axes.
    pub half_m: [f32; 3],
    /// The only context that has uploaded the page.
    pub context: u32,
    /// The drawable's slot in that context.
    pub slot: DrawSlot,
    /// The number of nodes of the page.
    pub nodes: u32,
    /// The cone of its normals, if it has one.
    pub cone: Option<NormalCone>,
    /// The state set above the drawable, with the page's path to it.
    pub state: Option<(u32, Arc<StateSet>)>,
}

impl SingleDrawable {
    /// Copies the drawable of a page that has one drawable below groups and transforms, at most one state set above it, and
    /// slots in one context. Returns `None` for every other page, which culls scan.
    pub fn of(page: &Page) -> Option<Self> {
        let (_, nodes) = page.nodes().split_last()?;
        // A normal cone alone makes no subtree less simple.
        let is_simple = |node: &NodeRecord| {
            node.flags & !SIMPLE_SUBTREE == 0 && matches!(node.kind, kind::GROUP | kind::TRANSFORM | kind::GEODE)
        };
        let (&[drawable], &[(context, ref slots)]) = (page.drawable_refs(), page.payload.draw_slots()) else {
            return None;
        };
        let has_callback = !page.drawable_callbacks().is_empty();
        if !nodes.iter().all(is_simple) || has_callback || !page.masks().is_empty() {
            return None;
        }
        let state = match drawable.state_path {
            0 => None,
            path => {
                let link = page.state_paths().get(path as usize).filter(|link| link.parent == 0)?;
                Some((path, page.state_sets().get(link.set as usize)?.clone()))
            }
        };
        let bounds = page.boxes().first()?;
        let center = bounds.center.map(|axis| f64::from(axis.x));
        Some(Self {
            page_from_drawable: page.transforms().page_from_node(drawable.transform),
            center: page.origin() + DVec3::from_array(center),
            half_m: bounds.half.map(|axis| axis.x),
            context,
            slot: *slots.first()?,
            nodes: nodes.len() as u32,
            cone: page.normal_cones().get(0).copied(),
            state,
        })
    }
}
