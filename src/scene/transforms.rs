//! The transforms of a page, composed into the page's frame.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DVec3};

/// A linear part and its inverse, shared by every transform that has the same one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linear {
    pub page_from_node: DMat3,
    /// Zero where the linear part is singular.
    pub node_from_page: DMat3,
}

/// `page_from_node` of every transform node in depth-first order; entry 0 is the page's own frame.
///
/// Linear parts are stored once each: a terrain page has one (or few) rotations and many translations, so
/// that culling multiplies matrices only where the linear part changes, and reads 28 bytes a transform.
#[derive(Debug)]
pub(crate) struct Transforms {
    pub translations: Vec<[f64; 3]>,
    pub linear_of: Vec<u32>,
    pub linears: Vec<Linear>,
    /// Index of the enclosing transform.
    pub parents: Vec<u32>,
    /// `parent_from_node` as given.
    pub locals: Vec<DAffine3>,
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

    pub fn len(&self) -> usize {
        self.locals.len()
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

    /// The composed map of a transform.
    pub fn page_from_node(&self, index: u32) -> DAffine3 {
        let i = index as usize;
        DAffine3 {
            matrix3: self.linears[self.linear_of[i] as usize].page_from_node,
            translation: DVec3::from_array(self.translations[i]),
        }
    }

    /// A point of the page's frame in the frame of a transform.
    pub fn point_in_node(&self, index: u32, point_in_page: DVec3) -> DVec3 {
        let i = index as usize;
        let offset = point_in_page - DVec3::from_array(self.translations[i]);
        self.linears[self.linear_of[i] as usize].node_from_page * offset
    }

    /// Replaces a local map and composes it and the transforms in `index..end` (its subtree) again.
    pub fn set(&mut self, index: u32, parent_from_node: DAffine3, end: u32) {
        self.locals[index as usize] = parent_from_node;
        if self.linears.len() > 64 + 2 * self.locals.len() {
            self.forget_unused();
        }
        for i in index..end {
            self.compose(i);
        }
    }

    /// Drops linear parts that moving transforms left behind.
    fn forget_unused(&mut self) {
        self.known.clear();
        let old = std::mem::take(&mut self.linears);
        for i in 0..self.linear_of.len() {
            let linear = old[self.linear_of[i] as usize].page_from_node;
            self.linear_of[i] = self.linear_index(&linear);
        }
    }

    /// Called once the page is complete.
    pub fn shrink(&mut self) {
        self.translations.shrink_to_fit();
        self.linear_of.shrink_to_fit();
        self.linears.shrink_to_fit();
        self.parents.shrink_to_fit();
        self.locals.shrink_to_fit();
    }

    pub fn size_bytes(&self) -> u64 {
        (self.locals.len() * (24 + 4 + 4 + size_of::<DAffine3>())
            + self.linears.len() * (size_of::<Linear>() + size_of::<([u64; 9], u32)>())) as u64
    }
}
