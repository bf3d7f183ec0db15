//! Values of a configuration file with their limits, read by serde. Main thread.
//!
//! serde's own types accept more than the format allows: structs from lists, `null` for optional fields, lists of any
//! length. These types refuse that, and their messages say what was expected.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Unexpected, Visitor};

/// The most windows, views and scenes that a file may have, and the most cameras in one of them.
pub(super) const MAX_ENTRIES: usize = 64;

/// A value that parses but is not allowed: the path of the field and the reason.
#[derive(Debug)]
pub(super) struct Invalid {
    pub field: String,
    pub reason: String,
}

impl Invalid {
    /// Creates an error as a result, for fields that contradict each other.
    pub fn err<T>(field: impl Into<String>, reason: impl Into<String>) -> Result<T, Self> {
        Err(Self { field: field.into(), reason: reason.into() })
    }
}

/// Reads a field that may be missing, but not `null`; for `#[serde(default, deserialize_with = "present")]`.
pub(super) fn present<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// A struct that is read from an object only; serde alone would also take a list of its fields.
#[derive(Debug)]
pub(super) struct Object<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ObjectVisitor<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for ObjectVisitor<T> {
            type Value = T;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<T, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map))
            }
        }
        deserializer.deserialize_map(ObjectVisitor(PhantomData)).map(Self)
    }
}

/// A list of 1 to [`MAX_ENTRIES`] entries.
#[derive(Debug)]
pub(super) struct Entries<T>(pub Vec<T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Entries<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct EntriesVisitor<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for EntriesVisitor<T> {
            type Value = Vec<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a list of 1 to {MAX_ENTRIES} entries")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<T>, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = list.next_element()? {
                    entries.push(entry);
                    if entries.len() > MAX_ENTRIES {
                        return Err(A::Error::invalid_length(entries.len(), &self));
                    }
                }
                if entries.is_empty() { Err(A::Error::invalid_length(0, &self)) } else { Ok(entries) }
            }
        }
        deserializer.deserialize_seq(EntriesVisitor(PhantomData)).map(Self)
    }
}

/// The numbers that a field accepts.
pub(super) trait Limits {
    const MIN: f64;
    const MAX: f64;
    /// True when the field accepts whole numbers only.
    const IS_WHOLE: bool = false;
}

/// A number within limits.
#[derive(Debug)]
pub(super) struct Number<L> {
    pub value: f64,
    limits: PhantomData<L>,
}

impl<'de, L: Limits> Deserialize<'de> for Number<L> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberVisitor<L>(PhantomData<L>);
        impl<L: Limits> Visitor<'_> for NumberVisitor<L> {
            type Value = f64;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                let kind = if L::IS_WHOLE { "whole number" } else { "number" };
                write!(f, "a {kind} from {} to {}", L::MIN, L::MAX)
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<f64, E> {
                let is_allowed = (L::MIN..=L::MAX).contains(&value) && (!L::IS_WHOLE || value.fract() == 0.0);
                if is_allowed { Ok(value) } else { Err(E::invalid_value(Unexpected::Float(value), &self)) }
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<f64, E> {
                self.visit_f64(value as f64)
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<f64, E> {
                self.visit_f64(value as f64)
            }
        }
        let value = deserializer.deserialize_f64(NumberVisitor::<L>(PhantomData))?;
        Ok(Self { value, limits: PhantomData })
    }
}

/// A list of exactly `N` numbers within limits.
#[derive(Debug)]
pub(super) struct Numbers<const N: usize, L> {
    pub values: [f64; N],
    limits: PhantomData<L>,
}

impl<'de, const N: usize, L: Limits> Deserialize<'de> for Numbers<N, L> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumbersVisitor<const N: usize, L>(PhantomData<L>);
        impl<'de, const N: usize, L: Limits> Visitor<'de> for NumbersVisitor<N, L> {
            type Value = [f64; N];

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a list of {N} numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<[f64; N], A::Error> {
                let mut values = [0.0; N];
                for (index, value) in values.iter_mut().enumerate() {
                    let number = list.next_element::<Number<L>>()?;
                    *value = number.ok_or_else(|| A::Error::invalid_length(index, &self))?.value;
                }
                match list.next_element::<IgnoredAny>()? {
                    Some(_) => Err(A::Error::invalid_length(N + 1, &self)),
                    None => Ok(values),
                }
            }
        }
        let values = deserializer.deserialize_seq(NumbersVisitor::<N, L>(PhantomData))?;
        Ok(Self { values, limits: PhantomData })
    }
}

/// Declares the limits of a kind of number.
macro_rules! limits {
    ($($(#[$doc:meta])* $name:ident: $min:expr, $max:expr, $is_whole:literal;)*) => {
        $($(#[$doc])*
        #[derive(Debug)]
        pub(super) struct $name;
        impl $crate::viewer::config::file::values::Limits for $name {
            const MIN: f64 = $min;
            const MAX: f64 = $max;
            const IS_WHOLE: bool = $is_whole;
        })*
    };
}
pub(super) use limits;
