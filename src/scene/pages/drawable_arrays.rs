//! The drawables of a page as flat arrays: their frames, states and boxes, which stay when the payloads are uploaded.

use glam::DVec3;

use super::stored_bounds::{Boxes4, is_usable};
use super::transforms::Transforms;
use crate::math::Aabb;
use crate::scene::geometry::NormalCone;
use crate::scene::sparse_list::SparseList;

/// The frame and state of a drawable.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrawableRef {
    pub state_path: u32,
    pub transform: u32,
}

/// Parallel arrays with an entry for each drawable.
#[derive(Debug, Default)]
pub(crate) struct DrawableArrays {
    refs: Vec<DrawableRef>,
    /// Boxes in the page's frame, relative to its origin, four to an element.
    boxes: Vec<Boxes4>,
    /// Boxes in the frames of their transforms, from which `boxes` are fitted again.
    local_boxes: Vec<Aabb>,
    normal_cones: SparseList<NormalCone>,
    /// True if some drawable has no transform above it.
    uses_page_frame: bool,
}

impl DrawableArrays {
    #[inline(always)]
    pub fn refs(&self) -> &[DrawableRef] {
        &self.refs
    }

    /// Returns the boxes in the page's frame, four drawables to an element.
    #[inline(always)]
    pub fn boxes(&self) -> &[Boxes4] {
        &self.boxes
    }

    /// Returns the normal cones of the drawables that have one.
    #[inline(always)]
    pub fn normal_cones(&self) -> &SparseList<NormalCone> {
        &self.normal_cones
    }

    /// Returns true if some drawable has no transform above it.
    #[inline(always)]
    pub fn uses_page_frame(&self) -> bool {
        self.uses_page_frame
    }

    /// Returns the number of drawables.
    pub fn len(&self) -> usize {
        self.refs.len()
    }

    /// Appends a drawable with its box in the frame of its transform.
    pub(super) fn push(&mut self, drawable: DrawableRef, bounds: Aabb, cone: Option<NormalCone>) {
        if let Some(cone) = cone {
            self.normal_cones.push(self.refs.len() as u32, cone);
        }
        self.uses_page_frame |= drawable.transform == 0;
        self.refs.push(drawable);
        self.local_boxes.push(bounds);
    }

    /// Replaces the box of a drawable in the frame of its transform. [`Self::fit`] must follow.
    pub(super) fn set_local_box(&mut self, drawable: usize, bounds: Aabb) {
        self.local_boxes[drawable] = bounds;
    }

    /// Removes the normal cone of a drawable whose mesh has changed.
    pub(super) fn forget_normal_cone(&mut self, drawable: u32) {
        self.normal_cones.set(drawable, None);
    }

    /// Returns the box of a drawable in the page's frame; `None` if its bound is not usable.
    pub fn box_in_page(&self, drawable: usize, transforms: &Transforms) -> Option<Aabb> {
        let local = &self.local_boxes[drawable];
        if !is_usable(local) {
            return None;
        }
        let in_page = local.transformed(&transforms.page_from_node(self.refs[drawable].transform));
        is_usable(&in_page).then_some(in_page)
    }

    /// Computes the boxes in the page's frame of a range of drawables.
    pub(super) fn fit(&mut self, drawables: std::ops::Range<usize>, transforms: &Transforms, origin: DVec3) {
        self.boxes.resize(self.refs.len().div_ceil(4), Boxes4::EMPTY);
        for drawable in drawables {
            let in_page = self.box_in_page(drawable, transforms);
            self.boxes[drawable / 4].set(drawable % 4, in_page.as_ref(), origin);
        }
    }

    /// Returns the bytes of CPU memory of all arrays.
    pub fn size_bytes(&self) -> usize {
        self.boxes.len() * size_of::<Boxes4>() + self.refs.len() * (size_of::<DrawableRef>() + size_of::<Aabb>())
    }
}
