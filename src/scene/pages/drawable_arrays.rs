//! The drawables of a page as flat arrays: their frames, states and boxes, which stay when the payloads are uploaded.

use glam::DVec3;

use super::stored_bounds::{Boxes4, is_usable};
use super::transforms::Transforms;
use crate::math::Aabb;
use crate::scene::geometry::NormalCone;
use crate::scene::nodes::CullCallback;
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
    cull_callbacks: SparseList<CullCallback>,
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

    /// Returns the cull callbacks of the drawables that have one.
    #[inline(always)]
    pub fn cull_callbacks(&self) -> &SparseList<CullCallback> {
        &self.cull_callbacks
    }

    /// Returns true if some drawable of a range has a normal cone or a cull callback, so that the range is not taken as one.
    pub(super) fn needs_tests(&self, drawables: std::ops::Range<usize>) -> bool {
        self.normal_cones.has_any_in(drawables.clone()) || self.cull_callbacks.has_any_in(drawables)
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
    pub(super) fn push(
        &mut self,
        drawable: DrawableRef,
        bounds: Aabb,
        cone: Option<NormalCone>,
        callback: Option<CullCallback>,
    ) {
        let index = self.refs.len() as u32;
        if let Some(cone) = cone {
            self.normal_cones.push(index, cone);
        }
        if let Some(callback) = callback {
            self.cull_callbacks.push(index, callback);
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
