//! Gradient noise in 2D from a hash: any place alone, the same bits on every machine (no fused multiply-add, no
//! transcendental functions). Perlin's improved noise (2002) with eight gradients.

/// A hash of lattice point and seed with good avalanche (SplitMix64's finaliser).
fn hash(x: i64, y: i64, seed: u64) -> u64 {
    let mut h = seed ^ (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    h ^ (h >> 31)
}

const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;
const GRADIENTS: [[f64; 2]; 8] = [
    [1.0, 0.0],
    [DIAGONAL, DIAGONAL],
    [0.0, 1.0],
    [-DIAGONAL, DIAGONAL],
    [-1.0, 0.0],
    [-DIAGONAL, -DIAGONAL],
    [0.0, -1.0],
    [DIAGONAL, -DIAGONAL],
];

/// About -1..1, zero at lattice points, lattice spacing 1.
pub(crate) fn gradient(x: f64, y: f64, seed: u64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let (ix, iy) = (x0 as i64, y0 as i64);
    let corner = |dx: i64, dy: i64| {
        let [gx, gy] = GRADIENTS[(hash(ix + dx, iy + dy, seed) >> 61) as usize];
        gx * (fx - dx as f64) + gy * (fy - dy as f64)
    };
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (u, v) = (fade(fx), fade(fy));
    let bottom = corner(0, 0) + u * (corner(1, 0) - corner(0, 0));
    let top = corner(0, 1) + u * (corner(1, 1) - corner(0, 1));
    1.5 * (bottom + v * (top - bottom))
}

/// Sum of octaves, each at twice the frequency and half the amplitude; about -1..1.
pub(crate) fn fbm(x: f64, y: f64, octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut amplitude, mut frequency) = (0.0, 0.5, 1.0);
    for octave in 0..octaves {
        sum += amplitude * gradient(x * frequency, y * frequency, seed.wrapping_add(u64::from(octave)));
        amplitude *= 0.5;
        frequency *= 2.03;
    }
    sum
}

/// Ridged multifractal, 0..1 (Musgrave, Texturing and Modeling): detail gathers on ridges, valleys stay smooth.
pub(crate) fn ridged(x: f64, y: f64, octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut amplitude, mut frequency, mut weight, mut total) = (0.0, 1.0, 1.0, 1.0, 0.0);
    for octave in 0..octaves {
        let n = 1.0 - gradient(x * frequency, y * frequency, seed.wrapping_add(u64::from(octave))).abs();
        let signal = n * n * weight;
        sum += signal * amplitude;
        total += amplitude;
        weight = (signal * 1.9).clamp(0.0, 1.0);
        amplitude *= 0.48;
        frequency *= 2.07;
    }
    sum / total
}
