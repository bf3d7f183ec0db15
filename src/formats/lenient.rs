//! Deserializing JSON that others wrote: `null` means absent, and a value of the wrong kind spoils only itself.
//!
//! serde refuses a whole file for one member of the wrong type. These functions and types take any JSON value instead, so
//! that the reader can refuse the tile that has it. Decode threads.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserialize, DeserializeOwned, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

/// Parses JSON. Of members of one name the last counts, as in browsers; serde refuses them in a structure.
pub(super) fn from_json<T: DeserializeOwned>(text: &[u8]) -> Result<T, serde_json::Error> {
    serde_json::from_slice(text).or_else(|error| {
        let distinct = serde_json::from_slice::<Value>(text).ok();
        distinct.and_then(|json| T::deserialize(json).ok()).ok_or(error)
    })
}

/// Deserializes a value, and takes `null` as the default.
pub(super) fn or_default<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de> + Default,
{
    Option::deserialize(deserializer).map(Option::unwrap_or_default)
}

/// Deserializes a list and leaves out the elements that are `null`; `null` itself is an empty list.
pub(super) fn list<'de, D, T>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct ListVisitor<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for ListVisitor<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a list or null")
        }

        fn visit_unit<E>(self) -> Result<Self::Value, E> {
            Ok(Vec::new())
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
            let mut list = Vec::new();
            while let Some(element) = seq.next_element::<Option<T>>()? {
                list.extend(element);
            }
            Ok(list)
        }
    }

    deserializer.deserialize_any(ListVisitor(PhantomData))
}

/// An object. Every other JSON value is the default, which the reader refuses by name where a member is needed.
struct Object<T>(T);

impl<'de, T: Deserialize<'de> + Default> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Objects::deserialize(deserializer)? {
            Objects::One(object) => Ok(Self(object)),
            Objects::List(_) | Objects::Other => Ok(Self(T::default())),
        }
    }
}

/// An object, a list of objects, or another JSON value.
enum Objects<T> {
    One(T),
    List(Vec<T>),
    Other,
}

impl<'de, T: Deserialize<'de> + Default> Deserialize<'de> for Objects<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ObjectsVisitor<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de> + Default> Visitor<'de> for ObjectsVisitor<T> {
            type Value = Objects<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("objects")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Objects::One)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
                let mut list = Vec::new();
                while let Some(element) = seq.next_element::<Option<Object<T>>>()? {
                    list.extend(element.map(|Object(element)| element));
                }
                Ok(Objects::List(list))
            }

            fn visit_f64<E>(self, _: f64) -> Result<Self::Value, E> {
                Ok(Objects::Other)
            }

            fn visit_i64<E>(self, _: i64) -> Result<Self::Value, E> {
                Ok(Objects::Other)
            }

            fn visit_u64<E>(self, _: u64) -> Result<Self::Value, E> {
                Ok(Objects::Other)
            }

            fn visit_str<E>(self, _: &str) -> Result<Self::Value, E> {
                Ok(Objects::Other)
            }

            fn visit_bool<E>(self, _: bool) -> Result<Self::Value, E> {
                Ok(Objects::Other)
            }

            fn visit_unit<E>(self) -> Result<Self::Value, E> {
                Ok(Objects::List(Vec::new()))
            }
        }

        deserializer.deserialize_any(ObjectsVisitor(PhantomData))
    }
}

/// Deserializes an object; all other JSON is the default.
pub(super) fn object<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de> + Default,
{
    Object::deserialize(deserializer).map(|Object(object)| object)
}

/// Deserializes an object, which `null` means to be absent; all other JSON is the default.
pub(super) fn optional_object<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de> + Default,
{
    Option::<Object<T>>::deserialize(deserializer).map(|found| found.map(|Object(object)| object))
}

/// Deserializes a list of objects without its elements that are `null`; `null` itself is an empty list. An element that is
/// no object is the default, and so is the only element of anything that is no list.
pub(super) fn objects<'de, D, T>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de> + Default,
{
    Objects::deserialize(deserializer).map(|objects| match objects {
        Objects::List(list) => list,
        Objects::One(_) | Objects::Other => vec![T::default()],
    })
}

/// Deserializes a list of texts. Elements of another form are left out, and all other JSON is an empty list.
pub(super) fn texts<'de, D>(deserializer: D) -> Result<Vec<String>, D::Error>
where
    D: Deserializer<'de>,
{
    let texts = valid_or_default::<D, Vec<Value>>(deserializer)?;
    Ok(texts.into_iter().filter_map(|text| if let Value::String(text) = text { Some(text) } else { None }).collect())
}

/// Deserializes a value, and takes JSON of another form as the default.
pub(super) fn valid_or_default<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: DeserializeOwned + Default,
{
    Value::deserialize(deserializer).map(|json| T::deserialize(json).unwrap_or_default())
}

/// Deserializes an object, and leaves out the members that have another form. All other JSON is an empty object.
pub(super) fn valid_entries<'de, D, T>(deserializer: D) -> Result<BTreeMap<String, T>, D::Error>
where
    D: Deserializer<'de>,
    T: DeserializeOwned,
{
    let members = valid_or_default::<D, BTreeMap<String, Value>>(deserializer)?;
    Ok(members.into_iter().filter_map(|(name, json)| Some((name, T::deserialize(json).ok()?))).collect())
}

/// A number; NaN for every other JSON value, except for text that spells a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Number(pub f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberVisitor;

        impl<'de> Visitor<'de> for NumberVisitor {
            type Value = Number;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Number, E> {
                Ok(Number(value))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }

            fn visit_str<E>(self, value: &str) -> Result<Number, E> {
                Ok(Number(value.trim().parse().unwrap_or(f64::NAN)))
            }

            fn visit_bool<E>(self, _: bool) -> Result<Number, E> {
                Ok(Number(f64::NAN))
            }

            fn visit_unit<E>(self) -> Result<Number, E> {
                Ok(Number(f64::NAN))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Number, A::Error> {
                while seq.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Number(f64::NAN))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Number, A::Error> {
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Number(f64::NAN))
            }
        }

        deserializer.deserialize_any(NumberVisitor)
    }
}

/// A list of numbers. Every other JSON value is an empty list.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Numbers(pub Vec<f64>);

impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumbersVisitor;

        impl<'de> Visitor<'de> for NumbersVisitor {
            type Value = Numbers;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Numbers, A::Error> {
                let mut numbers = Vec::with_capacity(seq.size_hint().unwrap_or(12).min(16));
                while let Some(Number(number)) = seq.next_element()? {
                    numbers.push(number);
                }
                Ok(Numbers(numbers))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Numbers, A::Error> {
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Numbers::default())
            }

            fn visit_f64<E>(self, _: f64) -> Result<Numbers, E> {
                Ok(Numbers::default())
            }

            fn visit_i64<E>(self, _: i64) -> Result<Numbers, E> {
                Ok(Numbers::default())
            }

            fn visit_u64<E>(self, _: u64) -> Result<Numbers, E> {
                Ok(Numbers::default())
            }

            fn visit_str<E>(self, _: &str) -> Result<Numbers, E> {
                Ok(Numbers::default())
            }

            fn visit_bool<E>(self, _: bool) -> Result<Numbers, E> {
                Ok(Numbers::default())
            }

            fn visit_unit<E>(self) -> Result<Numbers, E> {
                Ok(Numbers::default())
            }
        }

        deserializer.deserialize_any(NumbersVisitor)
    }
}

/// Text, or a number as text; `None` for every other JSON value.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Text(pub Option<String>);

impl<'de> Deserialize<'de> for Text {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TextVisitor;

        impl<'de> Visitor<'de> for TextVisitor {
            type Value = Text;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("text")
            }

            fn visit_str<E>(self, value: &str) -> Result<Text, E> {
                Ok(Text(Some(value.to_owned())))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Text, E> {
                // Debug writes 1.0 and not 1.
                Ok(Text(Some(format!("{value:?}"))))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Text, E> {
                Ok(Text(Some(value.to_string())))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Text, E> {
                Ok(Text(Some(value.to_string())))
            }

            fn visit_bool<E>(self, _: bool) -> Result<Text, E> {
                Ok(Text(None))
            }

            fn visit_unit<E>(self) -> Result<Text, E> {
                Ok(Text(None))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Text, A::Error> {
                while seq.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Text(None))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Text, A::Error> {
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Text(None))
            }
        }

        deserializer.deserialize_any(TextVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [&str; 7] = ["null", "true", "-1", "1.5", "\"a\"", "[1, null, \"2\"]", "{\"a\": [1]}"];

    #[test]
    fn last_of_repeated_members_counts() {
        #[derive(Debug, serde::Deserialize)]
        struct Named {
            name: Text,
        }
        let named = |text: &str| from_json::<Named>(text.as_bytes());
        assert_eq!(named(r#"{"name":"a","name":"b"}"#).unwrap().name.0.as_deref(), Some("b"));
        assert!(named(r#"{"name":"a","name":"b""#).unwrap_err().to_string().contains("duplicate field `name`"));
        assert!(named("{}").unwrap_err().to_string().contains("missing field"));
    }

    #[test]
    fn every_json_value_is_taken() {
        let numbers = KINDS.map(|json| serde_json::from_str::<Number>(json).unwrap().0);
        assert_eq!((numbers[2], numbers[3]), (-1.0, 1.5));
        assert!([0, 1, 4, 5, 6].iter().all(|kind| numbers[*kind].is_nan()), "{numbers:?}");
        let lists = KINDS.map(|json| serde_json::from_str::<Numbers>(json).unwrap().0);
        assert!(lists[5][0] == 1.0 && lists[5][1].is_nan() && lists[5][2] == 2.0, "{lists:?}");
        assert!([0, 1, 2, 3, 4, 6].iter().all(|kind| lists[*kind].is_empty()), "{lists:?}");
        let texts = KINDS.map(|json| serde_json::from_str::<Text>(json).unwrap().0);
        assert_eq!(texts.map(|text| text.unwrap_or_default()), ["", "", "-1", "1.5", "a", "", ""]);
        assert_eq!(serde_json::from_str::<Text>("1.0").unwrap().0.as_deref(), Some("1.0"));
    }

    #[test]
    fn null_elements_are_left_out() {
        #[derive(serde::Deserialize)]
        struct Lists {
            #[serde(default, deserialize_with = "list")]
            a: Vec<u32>,
            #[serde(default, deserialize_with = "or_default")]
            b: u32,
        }
        let read = |json: &str| serde_json::from_str::<Lists>(json).map(|lists| (lists.a, lists.b));
        assert_eq!(read(r#"{"a":[1,null,2],"b":null}"#).unwrap(), (vec![1, 2], 0));
        assert_eq!(read(r#"{"a":null,"b":7}"#).unwrap(), (vec![], 7));
        assert_eq!(read("{}").unwrap(), (vec![], 0));
        assert!(read(r#"{"a":7}"#).is_err());
    }

    #[test]
    fn other_values_are_default_objects() {
        #[derive(serde::Deserialize, Default)]
        struct Part {
            a: Option<u32>,
        }
        #[derive(serde::Deserialize)]
        struct Parts {
            #[serde(default, deserialize_with = "object")]
            one: Part,
            #[serde(default, deserialize_with = "optional_object")]
            maybe: Option<Part>,
            #[serde(default, deserialize_with = "objects")]
            many: Vec<Part>,
            #[serde(default, deserialize_with = "texts")]
            words: Vec<String>,
        }
        let read = |json: &str| {
            let parts: Parts = serde_json::from_str(json).unwrap();
            let many: Vec<_> = parts.many.into_iter().map(|part| part.a).collect();
            (parts.one.a, parts.maybe.map(|part| part.a), many, parts.words)
        };
        let good = r#"{"one":{"a":1},"maybe":{"a":2},"many":[{"a":3},null,7,[{"a":4}]],"words":["x",1,null,"y"]}"#;
        let words = vec!["x".to_owned(), "y".to_owned()];
        assert_eq!(read(good), (Some(1), Some(Some(2)), vec![Some(3), None, None], words));
        assert_eq!(read("{}"), (None, None, vec![], vec![]));
        let null = r#"{"one":null,"maybe":null,"many":null,"words":null}"#;
        assert_eq!(read(null), (None, None, vec![], vec![]));
        for other in ["true", "-1", "1.5", "\"a\"", "[1]"] {
            let json = format!(r#"{{"one":{other},"maybe":{other},"many":{other},"words":{other}}}"#);
            assert_eq!(read(&json), (None, Some(None), vec![None], vec![]), "{other}");
        }
        assert_eq!(read(r#"{"many":{"a":1}}"#).2, vec![None], "an object is no list");
    }

    #[test]
    fn values_of_another_form_are_left_out() {
        #[derive(serde::Deserialize)]
        struct Values {
            #[serde(default, deserialize_with = "valid_or_default")]
            a: Option<u32>,
            #[serde(default, deserialize_with = "valid_entries")]
            b: BTreeMap<String, u32>,
        }
        let read = |json: &str| serde_json::from_str::<Values>(json).map(|values| (values.a, values.b)).unwrap();
        assert_eq!(read(r#"{"a":7,"b":{"x":1,"y":"2","z":null}}"#), (Some(7), [("x".to_owned(), 1)].into()));
        for other in ["null", "true", "-1", "[7]", "{\"a\":[7]}"] {
            assert_eq!(read(&format!(r#"{{"a":{other},"b":{other}}}"#)), (None, BTreeMap::new()), "{other}");
        }
        assert_eq!(read("{}"), (None, BTreeMap::new()));
    }
}
