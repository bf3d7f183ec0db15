//! Batched 3D Model (3D Tiles 1.0, `b3dm`): a header, tables and a glb.

use glam::DVec3;
use serde::Deserialize;

use super::ignored::Notes;
use super::properties;
use super::properties::feature_table::{self, Global};
use crate::fetch::{IoError, Limits};
use crate::scene::PropertyTable;

#[derive(Default, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
struct FeatureTable {
    rtc_center: Option<Global<[f64; 3]>>,
    batch_length: Option<Global<usize>>,
}

/// The parts of a b3dm.
pub(super) struct B3dm<'a> {
    pub glb: &'a [u8],
    /// The centre that the positions of the glb are relative to.
    pub rtc_center: Option<DVec3>,
    batch_json: &'a [u8],
    batch_binary: &'a [u8],
    /// The number of features.
    batch_length: usize,
}

impl B3dm<'_> {
    /// Returns the properties of the features; `None` if there are none.
    pub fn batch_table(&self, limits: &Limits, notes: &Notes) -> Option<PropertyTable> {
        properties::batch_table(self.batch_json, self.batch_binary, self.batch_length, limits, &|kind| notes.add(kind))
    }
}

/// Finds the parts of a b3dm.
pub(super) fn unwrap<'a>(uri: &str, bytes: &'a [u8], limits: &Limits) -> Result<B3dm<'a>, IoError> {
    let u32_at =
        |at: usize| -> Option<usize> { bytes.get(at..at + 4)?.try_into().ok().map(|b| u32::from_le_bytes(b) as usize) };
    let truncated = || IoError::invalid(uri, "b3dm: truncated header");
    let version = u32_at(4).ok_or_else(truncated)?;
    if version != 1 {
        return Err(IoError::unsupported(uri, format!("b3dm version {version}")));
    }
    let lengths: Vec<usize> = (0..4).map(|i| u32_at(12 + 4 * i)).collect::<Option<_>>().ok_or_else(truncated)?;
    let (&[feature_json, feature_binary, batch_json, batch_binary], mut at) =
        (<&[usize; 4]>::try_from(lengths.as_slice()).map_err(|_| truncated())?, 28usize);
    let mut feature = (at, feature_json);
    let sum = [feature_json, feature_binary, batch_json, batch_binary]
        .iter()
        .try_fold(at, |a, &b| a.checked_add(b))
        .ok_or_else(truncated)?;
    let mut batch = (at.saturating_add(feature_json).saturating_add(feature_binary), batch_json, batch_binary);
    let is_glb = |at: usize| bytes.get(at..).is_some_and(|b| b.starts_with(b"glTF"));
    if is_glb(sum) {
        at = sum;
    } else if let Some(found) = [20usize, 24].into_iter().find_map(|header| {
        // Headers older than version 1.0 have no or half a batch table.
        let table = if header == 20 { feature_binary } else { feature_json.checked_add(feature_binary)? };
        let start = header.checked_add(table)?;
        is_glb(start).then_some(start)
    }) {
        at = found;
        feature = (0, 0);
        batch = (0, 0, 0);
    } else {
        return Err(IoError::invalid(uri, "b3dm: no glb where the header says"));
    }
    let json = bytes.get(feature.0..feature.0 + feature.1).unwrap_or(&[]);
    let binary = bytes.get(feature.0 + feature.1..).and_then(|b| b.get(..feature_binary)).unwrap_or(&[]);
    limits.check_json(uri, json)?;
    let table = match json.iter().all(u8::is_ascii_whitespace) {
        true => FeatureTable::default(),
        false => feature_table::parse(json).map_err(|e| IoError::invalid(uri, format!("b3dm feature table: {e}")))?,
    };
    let rtc = match table.rtc_center {
        Some(center) => {
            let center = center.vector(binary).ok_or_else(|| IoError::invalid(uri, "b3dm: RTC_CENTER is invalid"))?;
            Some(DVec3::from_array(center))
        }
        None => None,
    };
    let batch_length = match table.batch_length {
        Some(length) => length.count(binary).ok_or_else(|| IoError::invalid(uri, "b3dm: BATCH_LENGTH is invalid"))?,
        None => 0,
    };
    let part = |begin: usize, length: usize| bytes.get(begin..begin.saturating_add(length)).unwrap_or(&[]);
    Ok(B3dm {
        glb: bytes.get(at..).unwrap_or(&[]),
        rtc_center: rtc,
        batch_json: part(batch.0, batch.1),
        batch_binary: part(batch.0.saturating_add(batch.1), batch.2),
        batch_length,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_header(lengths: &[u32], rest: &[&[u8]]) -> Vec<u8> {
        let mut bytes = b"b3dm".to_vec();
        bytes.extend([1, 0].iter().chain(lengths).flat_map(|word: &u32| word.to_le_bytes()));
        rest.iter().for_each(|part| bytes.extend(*part));
        bytes.extend(b"glTF");
        bytes
    }

    #[test]
    fn headers_of_all_versions() {
        let of = |lengths: &[u32], rest: &[&[u8]]| {
            unwrap("a", &with_header(lengths, rest), &Limits::default()).map(|b3dm| b3dm.glb.to_vec())
        };
        let table = [b' '; 100];
        assert_eq!(of(&[0, 0, 60, 40], &[&table]).unwrap(), b"glTF");
        // The header has the number of features and the size of their table.
        assert_eq!(of(&[10, 100], &[&table]).unwrap(), b"glTF");
        // The header has the sizes of both parts of the table and the number of features.
        assert_eq!(of(&[60, 40, 10], &[&table]).unwrap(), b"glTF");
        assert!(of(&[60, 41, 10], &[&table]).is_err());
    }

    #[test]
    fn centres_are_in_the_json_or_in_the_binary_part() {
        let center = |json: &str, binary: &[u8]| {
            let lengths = [json.len() as u32, binary.len() as u32, 0, 0];
            unwrap("a", &with_header(&lengths, &[json.as_bytes(), binary]), &Limits::default())
                .map(|b3dm| b3dm.rtc_center)
        };
        let binary: Vec<u8> = [9.0f32, 1.0, 2.5, -3.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let expected = Some(DVec3::new(1.0, 2.5, -3.0));
        assert_eq!(center(r#"{"RTC_CENTER":[1,2.5,-3]}"#, &[]).unwrap(), expected);
        assert_eq!(center(r#"{"RTC_CENTER":{"byteOffset":4}}"#, &binary).unwrap(), expected);
        assert_eq!(center("{\"RTC_CENTER\":[1,2.5,-3]}\0\0\0", &[]).unwrap(), expected);
        assert_eq!(center(r#"{"BATCH_LENGTH":0}"#, &[]).unwrap(), None);
        assert_eq!(center("   ", &[]).unwrap(), None);
        for broken in [
            r#"{"RTC_CENTER":[1,"#,
            r#"{"RTC_CENTER":{"byteOffset":8}}"#,
            r#"{"RTC_CENTER":[1,2]}"#,
            r#"{"RTC_CENTER":"here"}"#,
        ] {
            assert!(center(broken, &binary).is_err(), "{broken}");
        }
    }
}
