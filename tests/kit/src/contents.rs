//! Writes contents of 3D Tiles 1.0.

/// Returns JSON that spaces pad to a multiple of eight bytes.
pub fn padded(text: &str) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(bytes.len().next_multiple_of(8), b' ');
    bytes
}

/// Returns a b3dm with a feature table and a glb.
pub fn b3dm_bytes(table: &str, glb: &[u8]) -> Vec<u8> {
    b3dm_with_batches(table, "", glb)
}

/// Returns a b3dm with a feature table, a batch table in JSON and a glb.
pub fn b3dm_with_batches(table: &str, batches: &str, glb: &[u8]) -> Vec<u8> {
    let (table, batches) = (padded(table), padded(batches));
    let mut out = b"b3dm".to_vec();
    for word in [1, 28 + table.len() + batches.len() + glb.len(), table.len(), 0, batches.len(), 0] {
        out.extend((word as u32).to_le_bytes());
    }
    [out, table, batches, glb.to_vec()].concat()
}

/// Returns a pnts with a feature table and its binary part.
pub fn pnts_bytes(table: &str, points: &[u8]) -> Vec<u8> {
    pnts_with_batches(table, points, "")
}

/// Returns a pnts with a feature table, its binary part and a batch table in JSON.
pub fn pnts_with_batches(table: &str, points: &[u8], batches: &str) -> Vec<u8> {
    let (table, batches) = (padded(table), padded(batches));
    let mut out = b"pnts".to_vec();
    let length = 28 + table.len() + points.len() + batches.len();
    for word in [1, length, table.len(), points.len(), batches.len(), 0] {
        out.extend((word as u32).to_le_bytes());
    }
    [out, table, points.to_vec(), batches].concat()
}

/// Returns a composite of tiles.
pub fn cmpt_bytes(tiles: &[Vec<u8>]) -> Vec<u8> {
    let length = 16 + tiles.iter().map(Vec::len).sum::<usize>();
    let mut bytes = b"cmpt".to_vec();
    bytes.extend([1, length as u32, tiles.len() as u32].iter().flat_map(|word| word.to_le_bytes()));
    bytes.extend(tiles.concat());
    bytes
}
