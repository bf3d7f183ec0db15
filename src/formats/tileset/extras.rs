//! [`Extras`]: the property `terrane` of the `extras` of a tileset or tile. Other properties may be any JSON of any size; they
//! are parsed without being kept.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};

/// `extras.terrane`, or `None` if it is missing.
#[derive(Debug)]
pub(crate) struct Extras<T>(pub Option<T>);

impl<T> Default for Extras<T> {
    fn default() -> Self {
        Self(None)
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Extras<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ExtrasVisitor(PhantomData))
    }
}

struct ExtrasVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for ExtrasVisitor<T> {
    type Value = Extras<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("extras")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut own = None;
        while let Some(key) = map.next_key::<String>()? {
            if key == "terrane" {
                own = map.next_value()?;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        Ok(Extras(own))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
        while seq.next_element::<IgnoredAny>()?.is_some() {}
        Ok(Extras::default())
    }

    fn visit_bool<E>(self, _: bool) -> Result<Self::Value, E> {
        Ok(Extras::default())
    }

    fn visit_i64<E>(self, _: i64) -> Result<Self::Value, E> {
        Ok(Extras::default())
    }

    fn visit_u64<E>(self, _: u64) -> Result<Self::Value, E> {
        Ok(Extras::default())
    }

    fn visit_f64<E>(self, _: f64) -> Result<Self::Value, E> {
        Ok(Extras::default())
    }

    fn visit_str<E>(self, _: &str) -> Result<Self::Value, E> {
        Ok(Extras::default())
    }

    fn visit_unit<E>(self) -> Result<Self::Value, E> {
        Ok(Extras::default())
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Deserialize)]
    struct Tile {
        #[serde(default)]
        extras: Extras<Own>,
    }

    #[derive(Deserialize)]
    struct Own {
        side: Option<u32>,
    }

    fn side(json: &str) -> Result<Option<Option<u32>>, serde_json::Error> {
        Ok(serde_json::from_str::<Tile>(json)?.extras.0.map(|own| own.side))
    }

    #[test]
    fn the_property_terrane_is_found_in_any_extras() {
        for foreign in ["true", "-1", "1", "1.5", "\"terrane\"", "null", "[1, {\"terrane\": 1}]", "{}", "{\"a\": [{}]}"]
        {
            assert_eq!(side(&format!("{{\"extras\": {foreign}}}")).unwrap(), None, "{foreign}");
        }
        assert_eq!(side("{}").unwrap(), None);
        assert_eq!(side("{\"extras\": {\"terrane\": null}}").unwrap(), None);
        assert_eq!(side("{\"extras\": {\"a\": 1, \"terrane\": {\"b\": 2}}}").unwrap(), Some(None));
        assert_eq!(side("{\"extras\": {\"terrane\": {\"side\": 5}, \"a\": []}}").unwrap(), Some(Some(5)));
        assert!(side("{\"extras\": {\"terrane\": {\"side\": -5}}}").is_err());
        assert!(side("{\"extras\": {\"terrane\": 7}}").is_err());
    }
}
