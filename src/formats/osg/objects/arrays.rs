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

impl BoundArray {
    /// Returns the number of elements, by the indices if there are some.
    pub fn count(&self) -> usize {
        self.indices.as_ref().map_or(self.array.count(), |indices| indices.count())
    }

    /// Passes the first values of elements to `put`; integers are divided by their largest value if `scales`.
    #[inline]
    pub fn for_each<const N: usize>(
        &self,
        elements: impl Iterator<Item = usize>,
        scales: bool,
        mut put: impl FnMut([f64; N]),
    ) {
        let one = if scales { self.array.values.number().one() } else { 1.0 };
        let in_array = |element| match &self.indices {
            Some(indices) => indices.get(element, 0).max(0.0) as usize,
            None => element,
        };
        self.array.for_each(elements.map(in_array), |mut values: [f64; N]| {
            if one != 1.0 {
                values.iter_mut().for_each(|value| *value /= one);
            }
            put(values);
        });
    }
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

    /// Passes the first values of elements to `put`; 0 for those that an element lacks. The type of the numbers is looked at
    /// once and not for each element: arrays are most of a file.
    #[inline]
    pub fn for_each<const N: usize>(&self, elements: impl Iterator<Item = usize>, mut put: impl FnMut([f64; N])) {
        let first = |element| std::array::from_fn(|component| self.get(element, component));
        match &self.values {
            Values::F32(values) if N <= self.width => elements.for_each(|element| {
                let own = values.get(element.saturating_mul(self.width)..).and_then(<[f32]>::first_chunk::<N>);
                let Some(own) = own else { return put(first(element)) };
                // A loop, since `map` of arrays is a call for each element.
                let mut all = [0.0; N];
                all.iter_mut().zip(own).for_each(|(to, from)| *to = f64::from(*from));
                put(all);
            }),
            _ => elements.for_each(|element| put(first(element))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::osg::input::Number;

    #[test]
    fn elements_have_the_values_of_their_arrays() {
        let all = [
            Values::F32(vec![1.0, 2.5, -3.0, 4.0, 5.0]),
            Values::F64(vec![1.0, 2.5, -3.0, 4.0, 5.0]),
            Values::Whole(Number::U32, vec![1, -1, 3, 4, 5]),
        ];
        for (values, width) in all.iter().flat_map(|values| [1, 2, 3, 4].map(|width| (values, width))) {
            let array = ArrayObject { width, values: values.clone(), binding: None, is_normalized: false };
            // The last are incomplete, or beyond the end.
            let elements = [1, 0, 2, 2, usize::MAX / 8];
            let mut got: Vec<[f64; 3]> = Vec::new();
            array.for_each(elements.into_iter(), |element| got.push(element));
            let one_by_one = elements.map(|element| [0, 1, 2].map(|component| array.get(element, component)));
            assert_eq!(got, one_by_one, "{values:?} by {width}");
        }
    }

    #[test]
    fn bound_arrays_are_scaled_and_indexed() {
        let array = |width, values| Arc::new(ArrayObject { width, values, binding: None, is_normalized: false });
        let mut bound = BoundArray {
            array: array(2, Values::Whole(Number::U8, vec![255, 0, 51, 102])),
            indices: None,
            binding: None,
            is_normalized: true,
        };
        let values = |bound: &BoundArray, scales| {
            let mut all: Vec<[f64; 2]> = Vec::new();
            bound.for_each(0..2, scales, |values| all.push(values));
            all
        };
        assert_eq!(values(&bound, false), [[255.0, 0.0], [51.0, 102.0]]);
        assert_eq!(values(&bound, true), [[1.0, 0.0], [0.2, 0.4]]);
        bound.indices = Some(array(1, Values::Whole(Number::I16, vec![1, -7])));
        assert_eq!(values(&bound, false), [[51.0, 102.0], [255.0, 0.0]]);
    }
}
