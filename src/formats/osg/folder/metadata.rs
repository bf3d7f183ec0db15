//! [`Metadata`]: the reference system and origin that a `metadata.xml` names.

use glam::DVec3;

/// The reference system and origin in a `metadata.xml`.
#[derive(Debug, PartialEq)]
pub(super) struct Metadata {
    /// `EPSG:code`, `ENU:latitude,longitude` or WKT; empty for none.
    pub srs: String,
    /// The origin of the tiles in that system.
    pub origin: DVec3,
}

/// Returns true for XML with the root element of such a file.
pub(in crate::formats) fn is_metadata(bytes: &[u8]) -> bool {
    const ROOT: &[u8] = b"<ModelMetadata";
    let start = &bytes[..bytes.len().min(4096)];
    let text = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start).trim_ascii_start();
    text.starts_with(b"<") && text.windows(ROOT.len()).any(|window| window == ROOT)
}

impl Metadata {
    /// Parses a file.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let text = String::from_utf8_lossy(bytes);
        let srs = element(&text, "SRS").unwrap_or_default();
        let origin = match element(&text, "SRSOrigin") {
            None => DVec3::ZERO,
            Some(numbers) => {
                let parts: Vec<f64> = numbers.split(',').filter_map(|part| part.trim().parse().ok()).collect();
                match parts[..] {
                    [x, y, z] if DVec3::new(x, y, z).is_finite() => DVec3::new(x, y, z),
                    _ => return Err(format!("SRSOrigin {:?} is not three numbers", shortened(&numbers))),
                }
            }
        };
        Ok(Self { srs, origin })
    }
}

/// Returns the text of the first element with a name, entities replaced.
fn element(text: &str, name: &str) -> Option<String> {
    let start = text.find(&format!("<{name}>"))? + name.len() + 2;
    let end = start + text[start..].find(&format!("</{name}>"))?;
    let mut text = text[start..end].trim().to_owned();
    for (entity, character) in [("&quot;", "\""), ("&apos;", "'"), ("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")] {
        text = text.replace(entity, character);
    }
    Some(text)
}

/// Returns the beginning of a text from a file.
pub(super) fn shortened(text: &str) -> String {
    text.chars().take(80).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_system_and_origin_are_read() {
        let xml = "\u{feff}<?xml version=\"1.0\"?>\n<ModelMetadata version=\"1\"><SRS> PROJCS[&quot;a&quot;] </SRS>
            <SRSOrigin>1, -2.5,3e2</SRSOrigin></ModelMetadata>";
        assert!(is_metadata(xml.as_bytes()));
        let parsed = Metadata::parse(xml.as_bytes()).unwrap();
        assert_eq!(parsed, Metadata { srs: "PROJCS[\"a\"]".into(), origin: DVec3::new(1.0, -2.5, 300.0) });
        let empty = Metadata::parse(b"<ModelMetadata/>").unwrap();
        assert_eq!(empty, Metadata { srs: String::new(), origin: DVec3::ZERO });
        for bad in ["1,2", "a,b,c", "1,2,nan", "1,2,3,4"] {
            assert!(Metadata::parse(format!("<SRSOrigin>{bad}</SRSOrigin>").as_bytes()).is_err(), "{bad}");
        }
        for other in [&b"<html>"[..], b"ModelMetadata", b"", b"<ModelMetadat"] {
            assert!(!is_metadata(other));
        }
    }
}
