//! Tile indices: the tiles of all levels in a row, each level along a Hilbert curve.

/// The deepest level whose tile indices fit into 64 bits.
const MAX_ZOOM: u32 = 31;

/// Returns the index of the tile named `z/x/y`: the number of tiles on coarser levels plus its index on the Hilbert curve of
/// its level. Returns `None` for other names.
pub(in crate::fetch::archive) fn tile_id(name: &str) -> Option<u64> {
    let mut parts = name.split('/');
    let (z, x, y) = (parts.next()?, parts.next()?, parts.next()?);
    let y = y.split('.').next()?;
    let digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse::<u64>().ok())?;
    let (z, mut x, mut y) = (digits(z)?, digits(x)?, digits(y)?);
    let z = u32::try_from(z).ok().filter(|z| *z <= MAX_ZOOM)?;
    let side = 1u64 << z;
    if parts.next().is_some() || x >= side || y >= side {
        return None;
    }
    let above = ((1u128 << (2 * z)) - 1) / 3;
    let mut along = 0u64;
    for level in (0..z).rev() {
        let (right, down) = (x >> level & 1, y >> level & 1);
        along += ((3 * right) ^ down) << (2 * level);
        if down == 0 {
            if right == 1 {
                (x, y) = (side - 1 - x, side - 1 - y);
            }
            (x, y) = (y, x);
        }
    }
    u64::try_from(above + u128::from(along)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tile_indices_follow_the_hilbert_curve() {
        for (name, id) in [
            ("0/0/0", Some(0)),
            ("1/0/0", Some(1)),
            ("1/0/1.png", Some(2)),
            ("1/1/1", Some(3)),
            ("1/1/0.jpg.gz", Some(4)),
            ("2/0/0", Some(5)),
            ("12/3423/1763", Some(19_078_479)),
            ("1/2/0", None),
            ("1/0", None),
            ("1/0/0/0", None),
            ("32/0/0", None),
            ("1/+1/0", None),
            ("1/-1/0", None),
            ("1//0", None),
            ("tileset.json", None),
            ("99999999999999999999/0/0", None),
        ] {
            assert_eq!(tile_id(name), id, "{name}");
        }
        // Each tile of a level occurs once, and consecutive indices are adjacent tiles.
        let mut indices: Vec<(u64, i64, i64)> =
            (0..16).flat_map(|x| (0..16).map(move |y| (tile_id(&format!("4/{x}/{y}")).unwrap(), x, y))).collect();
        indices.sort_unstable();
        assert!(indices.iter().map(|p| p.0).eq(85..85 + 256));
        assert!(indices.windows(2).all(|w| (w[0].1 - w[1].1).abs() + (w[0].2 - w[1].2).abs() == 1));
        assert!(tile_id("31/2147483647/2147483647").is_some());
    }
}
