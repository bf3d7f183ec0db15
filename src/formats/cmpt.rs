//! Composite tiles (3D Tiles 1.0, `cmpt`): a header, then tiles of other formats one after another. Decode threads.

use crate::fetch::IoError;

/// Magic, version, length, and the number of inner tiles.
const HEADER_BYTES: usize = 16;
/// Magic, version and length: what the headers of all inner tiles begin with.
const INNER_HEADER_BYTES: usize = 12;
/// The maximum depth of composites inside composites.
const MAX_DEPTH: u32 = 8;

/// Returns the bytes of the tiles in a composite that is inside `depth` others.
pub(super) fn parts<'a>(uri: &str, bytes: &'a [u8], depth: u32) -> Result<Vec<&'a [u8]>, IoError> {
    let bad = |reason: String| IoError::invalid(uri, format!("cmpt: {reason}"));
    if depth >= MAX_DEPTH {
        return Err(bad(format!("composites are nested more than {MAX_DEPTH} deep")));
    }
    let [Some(version), Some(length), Some(count)] = [4, 8, 12].map(|at| word(bytes, at)) else {
        return Err(bad("truncated header".to_owned()));
    };
    if version != 1 {
        return Err(IoError::unsupported(uri, format!("cmpt version {version}")));
    }
    // Some writers count the header or padding wrongly; the inner lengths decide.
    let mut rest = &bytes[HEADER_BYTES..];
    if length as usize > bytes.len() {
        return Err(bad(format!("{length} bytes in the header, the file has {}", bytes.len())));
    }
    // The number in the header allocates nothing.
    let mut parts = Vec::new();
    for number in 0..count {
        let inner_length = word(rest, 8).ok_or_else(|| bad(format!("tile {number} of {count} is missing")))? as usize;
        if inner_length < INNER_HEADER_BYTES || inner_length > rest.len() {
            return Err(bad(format!("tile {number} has {inner_length} bytes, {} follow", rest.len())));
        }
        let (inner, after) = rest.split_at(inner_length);
        parts.push(inner);
        rest = after;
    }
    Ok(parts)
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cmpt(tiles: &[Vec<u8>]) -> Vec<u8> {
        let length = HEADER_BYTES + tiles.iter().map(Vec::len).sum::<usize>();
        let mut bytes = b"cmpt".to_vec();
        bytes.extend([1, length as u32, tiles.len() as u32].iter().flat_map(|word| word.to_le_bytes()));
        bytes.extend(tiles.concat());
        bytes
    }

    /// Returns the number of tiles in a composite and in those inside it that are no composites.
    fn count(bytes: &[u8], depth: u32) -> Result<usize, IoError> {
        let parts = parts("/set/a.cmpt", bytes, depth)?;
        let own = |part: &&[u8]| if part.starts_with(b"cmpt") { count(part, depth + 1) } else { Ok(1) };
        parts.iter().map(own).sum()
    }

    fn tile() -> Vec<u8> {
        [b"pnts".as_slice(), &1_u32.to_le_bytes(), &16_u32.to_le_bytes(), &[0; 4]].concat()
    }

    #[test]
    fn nested_composites_are_read_to_a_bounded_depth() {
        let count = |bytes: &[u8]| count(bytes, 0);
        assert_eq!(count(&cmpt(&[])).unwrap(), 0);
        assert_eq!(count(&cmpt(&[tile(), tile()])).unwrap(), 2);
        assert_eq!(count(&cmpt(&[tile(), cmpt(&[tile(), cmpt(&[tile()])])])).unwrap(), 3);
        let nested = |depth| (0..depth).fold(tile(), |inner, _| cmpt(&[inner]));
        assert_eq!(count(&nested(MAX_DEPTH)).unwrap(), 1);
        let error = count(&nested(MAX_DEPTH + 1)).unwrap_err().to_string();
        assert!(error.contains("nested"), "{error}");
    }

    #[test]
    fn broken_composites_are_refused() {
        let whole = cmpt(&[tile(), tile()]);
        for length in 4..whole.len() {
            assert!(count(&whole[..length], 0).is_err(), "{length} bytes");
        }
        let changed = |at: usize, value: u32| {
            let mut bytes = whole.clone();
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
            count(&bytes, 0).unwrap_err().to_string()
        };
        assert!(changed(4, 2).contains("version 2"));
        assert!(changed(12, u32::MAX).contains("tile 2 of"));
        assert!(changed(24, 3).contains("3 bytes"));
        assert!(changed(24, u32::MAX).contains("bytes"));
    }
}
