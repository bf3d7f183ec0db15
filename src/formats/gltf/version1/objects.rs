//! [`Objects`]: the objects of one kind with the indices that replace their ids.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};

use crate::formats::lenient::Text;

/// Objects in the order of the file.
pub(super) struct Objects<T> {
    pub list: Vec<T>,
    pub ids: Ids,
}

/// The index of each id.
#[derive(Default)]
pub(super) struct Ids(BTreeMap<String, usize>);

impl Ids {
    /// Returns the index of an object; `None` if it does not exist.
    pub fn get(&self, id: &Text) -> Option<usize> {
        self.0.get(id.0.as_ref()?).copied()
    }
}

impl<T> Objects<T> {
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Adds an object with a new id.
    pub fn push(&mut self, id: &str, object: T) {
        self.ids.0.insert(id.to_owned(), self.list.len());
        self.list.push(object);
    }

    /// Moves an object to index 0. Returns it; `None` if it does not exist.
    pub fn move_to_front(&mut self, id: &str) -> Option<&mut T> {
        let at = *self.ids.0.get(id)?;
        self.list.swap(0, at);
        for index in self.ids.0.values_mut() {
            *index = match *index {
                0 => at,
                index if index == at => 0,
                index => index,
            };
        }
        self.list.first_mut()
    }
}

impl<T> Default for Objects<T> {
    fn default() -> Self {
        Self { list: Vec::new(), ids: Ids::default() }
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Objects<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ObjectsVisitor<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de>> Visitor<'de> for ObjectsVisitor<T> {
            type Value = Objects<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("objects by id")
            }

            fn visit_unit<E>(self) -> Result<Objects<T>, E> {
                Ok(Objects::default())
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Objects<T>, A::Error> {
                let mut objects = Objects::default();
                while let Some((id, object)) = map.next_entry()? {
                    objects.ids.0.insert(id, objects.list.len());
                    objects.list.push(object);
                }
                Ok(objects)
            }
        }

        deserializer.deserialize_any(ObjectsVisitor(PhantomData))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_become_indices() {
        let mut objects: Objects<u32> = serde_json::from_str(r#"{"c":10,"a":11,"b":12}"#).unwrap();
        let get = |objects: &Objects<u32>, id: &str| {
            objects.ids.get(&Text(Some(id.to_owned()))).map(|index| (index, objects.list[index]))
        };
        assert_eq!([get(&objects, "c"), get(&objects, "a"), get(&objects, "x")], [Some((0, 10)), Some((1, 11)), None]);
        assert_eq!(objects.move_to_front("b"), Some(&mut 12));
        assert_eq!(
            [get(&objects, "b"), get(&objects, "a"), get(&objects, "c")],
            [Some((0, 12)), Some((1, 11)), Some((2, 10))]
        );
        assert!(objects.move_to_front("x").is_none() && objects.ids.get(&Text(None)).is_none());
        assert!(serde_json::from_str::<Objects<u32>>("null").unwrap().is_empty());
        assert!(serde_json::from_str::<Objects<u32>>("[1]").is_err());
    }
}
