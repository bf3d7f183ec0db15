//! [`LoneDrawable`]: what a cull needs of a page that is one drawable, as most contents of tiles are.
//!
//! Lies in the scene's table of pages. A frame that begins some milliseconds after the last finds little of the scene in
//! its core's caches, and a page's arrays are some twenty lines of memory, each found by the one before; this is three or
//! four beside each other. Made when the page is hung in, forgotten when the page may change. Update thread makes it; culls
//! read it.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::page::{DrawSlot, NodeRecord, PLAIN, Page};
use crate::state::StateSet;

/// Of a page with one drawable below groups and transforms, at most one state set above it, and one context for which it
/// was compiled. All others are scanned.
#[derive(Debug)]
pub(crate) struct LoneDrawable {
    pub page_from_drawable: DAffine3,
    /// Middle of its box, page frame.
    pub center: DVec3,
    /// Half sizes of its box along the page's axes.
    pub half_m: [f32; 3],
    /// The context and the slot there.
    pub context: u32,
    pub slot: DrawSlot,
    /// Nodes of the page.
    pub nodes: u32,
    /// The state set and the page's path to it.
    pub state: Option<(u32, Arc<StateSet>)>,
}

impl LoneDrawable {
    /// `None` for every other page.
    pub fn of(page: &Page) -> Option<Self> {
        let (_, nodes) = page.nodes.split_last()?;
        let is_plain = |node: &NodeRecord| node.flags == PLAIN;
        let (&[drawable], &[(context, ref slots)]) = (&page.drawable_refs[..], &page.draw_slots[..]) else {
            return None;
        };
        if !nodes.iter().all(is_plain) || !page.clusters.is_empty() || !page.masks.is_empty() {
            return None;
        }
        let state = match drawable.state_path {
            0 => None,
            path => {
                let link = page.paths.get(path as usize).filter(|link| link.parent == 0)?;
                Some((path, page.state_sets.get(link.set as usize)?.clone()))
            }
        };
        let bounds = page.boxes.first()?;
        let center = bounds.center.map(|axis| f64::from(axis.x));
        Some(Self {
            page_from_drawable: page.transforms.page_from_node(drawable.transform),
            center: page.origin + DVec3::from_array(center),
            half_m: bounds.half.map(|axis| axis.x),
            context,
            slot: *slots.first()?,
            nodes: nodes.len() as u32,
            state,
        })
    }
}
