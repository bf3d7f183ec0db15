//! The transforms of a page, composed into the page's frame. Decode workers build them, update changes them, culls read
//! them.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DVec3};

/// A linear part and its inverse, shared by all transforms with the same linear part.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linear {
    pub page_from_node: DMat3,
    /// The inverse; zero if the linear part is singular.
    pub node_from_page: DMat3,
}

/// `page_from_node` of every transform node in depth-first order; entry 0 is the page's own frame.
///
/// Each linear part is stored once: a terrain page has one rotation (or few) and many translations. Culls therefore
/// multiply matrices only when the linear part changes, and read 28 bytes a transform.
#[derive(Debug)]
pub(crate) struct Transforms {
    translations: Vec<[f64; 3]>,
    linear_of: Vec<u32>,
    linears: Vec<Linear>,
    /// The index of the enclosing transform.
    parents: Vec<u32>,
    /// `parent_from_node` as the application gave it.
    locals: Vec<DAffine3>,
    /// Linear parts by their bits.
    known: HashMap<[u64; 9], u32>,
}

impl Transforms {
    pub fn new() -> Self {
        let mut transforms = Self {
            translations: Vec::new(),
            linear_of: Vec::new(),
            linears: Vec::new(),
            parents: Vec::new(),
            locals: Vec::new(),
            known: HashMap::new(),
        };
        transforms.push(0, DAffine3::IDENTITY);
        transforms
    }

    /// Returns the number of transforms, counting the page's own frame.
    pub fn len(&self) -> usize {
        self.locals.len()
    }

    /// Returns the translation of each transform.
    #[inline(always)]
    pub fn translations(&self) -> &[[f64; 3]] {
        &self.translations
    }

    /// Returns the index of the linear part of each transform.
    #[inline(always)]
    pub fn linear_of(&self) -> &[u32] {
        &self.linear_of
    }

    /// Returns the distinct linear parts.
    #[inline(always)]
    pub fn linears(&self) -> &[Linear] {
        &self.linears
    }

    /// Appends a transform below another and returns its index.
    pub fn push(&mut self, parent: u32, parent_from_node: DAffine3) -> u32 {
        let index = self.locals.len() as u32;
        self.locals.push(parent_from_node);
        self.parents.push(parent);
        self.translations.push([0.0; 3]);
        self.linear_of.push(0);
        self.compose(index);
        index
    }

    /// Computes `page_from_node` of one transform from its parent's.
    fn compose(&mut self, index: u32) {
        let i = index as usize;
        let composed = if i == 0 { self.locals[0] } else { self.page_from_node(self.parents[i]) * self.locals[i] };
        self.translations[i] = composed.translation.to_array();
        self.linear_of[i] = self.linear_index(&composed.matrix3);
    }

    fn linear_index(&mut self, linear: &DMat3) -> u32 {
        // Adding zero turns -0.0 into 0.0, so that equal matrices have equal bits.
        let key = linear.to_cols_array().map(|v| (v + 0.0).to_bits());
        *self.known.entry(key).or_insert_with(|| {
            let inverse = linear.inverse();
            let node_from_page = if inverse.is_finite() { inverse } else { DMat3::ZERO };
            self.linears.push(Linear { page_from_node: *linear, node_from_page });
            self.linears.len() as u32 - 1
        })
    }

    /// Returns the composed map of a transform.
    pub fn page_from_node(&self, index: u32) -> DAffine3 {
        let i = index as usize;
        DAffine3 {
            matrix3: self.linears[self.linear_of[i] as usize].page_from_node,
            translation: DVec3::from_array(self.translations[i]),
        }
    }

    /// Converts a point of the page's frame to the frame of a transform.
    pub fn point_in_node(&self, index: u32, point_in_page: DVec3) -> DVec3 {
        let i = index as usize;
        let offset = point_in_page - DVec3::from_array(self.translations[i]);
        self.linears[self.linear_of[i] as usize].node_from_page * offset
    }

    /// Replaces a local map and composes the transforms in `index..end`, its subtree, again.
    pub fn set(&mut self, index: u32, parent_from_node: DAffine3, end: u32) {
        self.locals[index as usize] = parent_from_node;
        if self.linears.len() > 64 + 2 * self.locals.len() {
            self.forget_unused();
        }
        for i in index..end {
            self.compose(i);
        }
    }

    /// Drops linear parts that no transform has any more.
    fn forget_unused(&mut self) {
        self.known.clear();
        let old = std::mem::take(&mut self.linears);
        for i in 0..self.linear_of.len() {
            let linear = old[self.linear_of[i] as usize].page_from_node;
            self.linear_of[i] = self.linear_index(&linear);
        }
    }

    /// Releases spare memory; called once the page is complete.
    pub fn shrink(&mut self) {
        self.translations.shrink_to_fit();
        self.linear_of.shrink_to_fit();
        self.linears.shrink_to_fit();
        self.parents.shrink_to_fit();
        self.locals.shrink_to_fit();
    }

    /// Returns the bytes of CPU memory of all arrays.
    pub fn size_bytes(&self) -> u64 {
        (self.locals.len() * (24 + 4 + 4 + size_of::<DAffine3>())
            + self.linears.len() * (size_of::<Linear>() + size_of::<([u64; 9], u32)>())) as u64
    }
}
