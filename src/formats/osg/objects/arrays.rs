//! Arrays of a geometry, with their bindings. Decode threads.

use std::sync::Arc;

use crate::formats::osg::input::Values;

/// An array with what its elements belong to.
#[derive(Clone, Debug)]
pub(in crate::formats::osg) struct BoundArray {
    pub array: Arc<ArrayObject>,
    /// The indices of the elements, in versions below 112.
    pub indices: Option<Arc<ArrayObject>>,
    /// `None` lets the number of elements decide.
    pub binding: Option<Binding>,
    /// Integers are scaled to 0..1 or -1..1.
    pub is_normalized: bool,
}

/// The kind of thing that each element of an array belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats::osg) enum Binding {
    Off,
    Overall,
    PerPrimitiveSet,
    PerPrimitive,
    PerVertex,
}

/// An array.
#[derive(Debug)]
pub(in crate::formats::osg) struct ArrayObject {
    /// Values of an element.
    pub width: usize,
    pub values: Values,
    pub binding: Option<Binding>,
    pub is_normalized: bool,
}

impl ArrayObject {
    /// Returns the number of elements.
    pub fn count(&self) -> usize {
        self.values.len() / self.width
    }

    /// Returns true if the arrays hold the same for a texture.
    pub fn has_equal_values(&self, other: &Self) -> bool {
        (self.width, self.is_normalized) == (other.width, other.is_normalized) && self.values == other.values
    }

    /// Returns a value of an element; 0 for those that it lacks.
    pub fn get(&self, element: usize, component: usize) -> f64 {
        if component < self.width { self.values.get(element * self.width + component) } else { 0.0 }
    }

    /// Returns the first values of an element; 0 for those that it lacks.
    #[inline]
    pub fn first<const N: usize>(&self, element: usize) -> [f64; N] {
        match N <= self.width {
            true => self.values.array(element * self.width),
            false => std::array::from_fn(|component| self.get(element, component)),
        }
    }
}
