//! Terrain whose heights are computed from noise, cut into height tiles of any level.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use terrane::cull::CullCamera;
use terrane::math::{Aabb, Geodetic, WGS84};
use terrane::scene::{Drawable, Geometry, HeightTile, Material, Node, Texture};

use crate::shapes::with_mips;

/// Returns smooth hash noise on a unit lattice, 0 to 1.
fn value_noise(x: f64, y: f64) -> f64 {
    let hash = |i: i64, j: i64| {
        let mut h = (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (j as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
        h ^= h >> 29;
        h = h.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h ^= h >> 32;
        (h & 0xffff) as f64 / 65535.0
    };
    let (i, j) = (x.floor(), y.floor());
    let ease = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let (fx, fy) = (ease(x - i), ease(y - j));
    let (i, j) = (i as i64, j as i64);
    let south = hash(i, j) + (hash(i + 1, j) - hash(i, j)) * fx;
    let north = hash(i, j + 1) + (hash(i + 1, j + 1) - hash(i, j + 1)) * fx;
    south + (north - south) * fy
}

/// Terrain over a square of longitudes and latitudes, divided into tiles level by level.
pub struct Terrain {
    /// Western edge, radians.
    pub west: f64,
    /// Southern edge, radians.
    pub south: f64,
    /// Side of the root tile, radians.
    pub width: f64,
    /// Scale of the heights, metres.
    pub relief_m: f64,
    /// Geometric error of the root; each level halves it.
    pub root_error_m: f64,
    /// Whether tiles have a texture.
    pub textured: bool,
}

impl Terrain {
    /// Returns the height in metres at a point in units of the root tile, rounded so that all tiles hold equal bits.
    pub fn height_m(&self, u: f64, v: f64) -> f64 {
        let mut sum = 0.0;
        for octave in 0..7 {
            let scale = f64::from(1 << octave);
            let ridge = 1.0 - (2.0 * value_noise(u * 4.0 * scale + 7.0, v * 4.0 * scale + 3.0) - 1.0).abs();
            sum += ridge * ridge / scale.powf(1.1);
        }
        (self.relief_m * sum * 0.6 * 32.0).round() / 32.0
    }

    /// Returns the point on the ground.
    pub fn geodetic(&self, u: f64, v: f64) -> Geodetic {
        Geodetic {
            longitude: self.west + u * self.width,
            latitude: self.south + v * self.width,
            height_m: self.height_m(u, v),
        }
    }

    /// Returns the geometric error of a level, metres.
    pub fn error_m(&self, level: u32) -> f64 {
        self.root_error_m / f64::from(1u32 << level)
    }

    fn image(&self, u0: f64, v0: f64, size: f64) -> Texture {
        let side = 64usize;
        let mut pixels = Vec::with_capacity(side * side * 4);
        for row in 0..side {
            for column in 0..side {
                let u = u0 + size * (column as f64 + 0.5) / side as f64;
                let v = v0 + size * (1.0 - (row as f64 + 0.5) / side as f64);
                let height = self.height_m(u, v) / self.relief_m;
                let tint = value_noise(u * 200.0, v * 200.0) * 24.0;
                let [r, g, b] = match height {
                    h if h < 0.45 => [70.0, 96.0, 50.0],
                    h if h < 0.8 => [110.0, 104.0, 76.0],
                    h if h < 1.1 => [122.0, 112.0, 104.0],
                    _ => [215.0, 218.0, 225.0],
                };
                pixels.extend([(r + tint) as u8, (g + tint) as u8, (b + tint) as u8, 255]);
            }
        }
        with_mips(side as u32, side as u32, pixels)
    }

    /// Returns the geometric error of a tile, metres. It is small in two of three squares of the second level, and at least 1.5
    /// times that of each tile below.
    fn uneven_error_m(&self, level: u32, x: u32, y: u32) -> f64 {
        let rough = |x: u32, y: u32| (x + y).is_multiple_of(3);
        let is_rough = match level.checked_sub(2) {
            Some(up) => rough(x >> up, y >> up),
            None => {
                let side = 1 << (2 - level);
                (0..side * side).any(|k| rough(x * side + k % side, y * side + k / side))
            }
        };
        self.error_m(level) * if is_rough { 1.0 } else { 0.2 }
    }

    /// Returns the errors of a level at the corners of a tile of that level: the largest of the tiles around each.
    fn uneven_corners_m(&self, level: u32, x: u32, y: u32) -> [f64; 4] {
        let last = (1i64 << level) - 1;
        [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[east, north]: [i64; 2]| {
            let [x, y] = [i64::from(x) + east, i64::from(y) + north];
            let around = [[x - 1, y - 1], [x, y - 1], [x - 1, y], [x, y]];
            let errors = around.map(|[x, y]| {
                let is_there = (0..=last).contains(&x) && (0..=last).contains(&y);
                if is_there { self.uneven_error_m(level, x as u32, y as u32) } else { 0.0 }
            });
            errors.into_iter().fold(0.0, f64::max)
        })
    }

    /// Returns the errors of the levels above a tile, at its corners.
    fn coarser_uneven_errors_m(&self, level: u32, x: u32, y: u32) -> Vec<[f32; 4]> {
        let of_level = |up: u32| {
            let [south_west, south_east, north_west, north_east] = self.uneven_corners_m(level - up, x >> up, y >> up);
            let side = f64::from(1u32 << up);
            [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[east, north]| {
                let [u, v] = [x + east - (x >> up << up), y + north - (y >> up << up)].map(|at| f64::from(at) / side);
                let south = south_west + u * (south_east - south_west);
                let north = north_west + u * (north_east - north_west);
                (south + v * (north - south)) as f32
            })
        };
        (1..=level.min(6)).map(of_level).collect()
    }

    /// Returns a tile as a node: a transform to the world with the height tile below it. All tiles of a level have its error.
    pub fn tile(&self, level: u32, x: u32, y: u32) -> Node {
        self.tile_with(level, x, y, (1..=level.min(6)).map(|up| [self.error_m(level - up) as f32; 4]).collect())
    }

    fn tile_with(&self, level: u32, x: u32, y: u32, coarser_errors_m: Vec<[f32; 4]>) -> Node {
        let side = 65usize;
        let tiles = f64::from(1u32 << level);
        let size = 1.0 / tiles;
        let (u0, v0) = (f64::from(x) * size, f64::from(y) * size);
        let at = |k: f64, origin: f64| origin + size * k / 64.0;
        let mut heights = Vec::with_capacity(67 * 67);
        for j in -1..=side as i32 {
            for i in -1..=side as i32 {
                heights.push(self.height_m(at(f64::from(i), u0), at(f64::from(j), v0)) as f32);
            }
        }
        let longitude = self.west + self.width * (u0 + 0.5 * size);
        let latitude_of = |j: f64| self.south + self.width * at(j, v0);
        let meridian = |latitude: f64| {
            let p = WGS84.ecef(&Geodetic { longitude: 0.0, latitude, height_m: 0.0 });
            (p.x, p.z)
        };
        let (p0, z0) = meridian(latitude_of(32.0));
        let rows = (0..side)
            .map(|j| {
                let latitude = latitude_of(j as f64);
                let (p, z) = meridian(latitude);
                [(p - p0) as f32, (z - z0) as f32, latitude.cos() as f32, latitude.sin() as f32]
            })
            .collect();
        let columns = (0..side)
            .map(|i| {
                let delta = self.width * size * (i as f64 - 32.0) / 64.0;
                [delta.sin() as f32, (1.0 - delta.cos()) as f32]
            })
            .collect();
        let cell = self.width * size / 64.0;
        let cell_m = [(cell * p0) as f32, (cell * WGS84.semi_major_m) as f32];
        let extent_m = cell * 64.0 * WGS84.semi_major_m + 2.0 * self.relief_m;
        let (sin, cos) = longitude.sin_cos();
        let tile = HeightTile {
            side: side as u32,
            heights,
            rows,
            columns,
            p0_m: p0 as f32,
            level,
            coarser_errors_m,
            skirt_m: (2.0 * self.error_m(level)) as f32,
            cell_m,
            texture: self.textured.then(|| Arc::new(self.image(u0, v0, size))),
            bounds: Aabb { min: DVec3::splat(-extent_m), max: DVec3::splat(extent_m) },
        };
        let drawable = Drawable::new(Geometry::Height(Arc::new(tile)), Material::default());
        let world_from_tile = DAffine3 {
            matrix3: DMat3::from_cols(DVec3::new(-sin, cos, 0.0), DVec3::new(cos, sin, 0.0), DVec3::Z),
            translation: DVec3::new(p0 * cos, p0 * sin, z0),
        };
        Node::transform(world_from_tile, vec![Node::geode(vec![drawable])])
    }

    /// Returns the world position `above_m` metres above the ground.
    pub fn world(&self, u: f64, v: f64, above_m: f64) -> DVec3 {
        let mut g = self.geodetic(u, v);
        g.height_m += above_m;
        WGS84.ecef(&g)
    }

    /// Returns the ellipsoid's normal.
    pub fn up(&self, u: f64, v: f64) -> DVec3 {
        WGS84.up(&self.geodetic(u, v))
    }

    /// Returns the tiles for an eye, refined where the error of their level projects to more pixels than the camera allows.
    pub fn tiles_for(&self, camera: &CullCamera, eye: DVec3, max_level: u32) -> Node {
        let tiles = self.selected(camera, eye, max_level, &|level, _, _| self.error_m(level));
        Node::group(tiles.into_iter().map(|[level, x, y]| self.tile(level, x, y)).collect())
    }

    /// Does the same as [`Self::tiles_for`], with an error for each tile. A tile is refined by the largest at its corners.
    pub fn uneven_tiles_for(&self, camera: &CullCamera, eye: DVec3, max_level: u32) -> Node {
        let largest = |level, x, y| self.uneven_corners_m(level, x, y).into_iter().fold(0.0, f64::max);
        let tiles = self.selected(camera, eye, max_level, &largest);
        let tile = |[level, x, y]: [u32; 3]| self.tile_with(level, x, y, self.coarser_uneven_errors_m(level, x, y));
        Node::group(tiles.into_iter().map(tile).collect())
    }

    /// Returns the level, x and y of the tiles that are drawn, if `error_m` is the error of each.
    fn selected(
        &self,
        camera: &CullCamera,
        eye: DVec3,
        max_level: u32,
        error_m: &dyn Fn(u32, u32, u32) -> f64,
    ) -> Vec<[u32; 3]> {
        let mut tiles = Vec::new();
        let mut stack = vec![[0, 0, 0]];
        while let Some([level, x, y]) = stack.pop() {
            let range = error_m(level, x, y) * camera.px_per_radian() / camera.settings.max_sse_px;
            if level < max_level && self.distance_m(level, x, y, eye) < range {
                stack.extend([(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| [level + 1, 2 * x + dx, 2 * y + dy]));
            } else {
                tiles.push([level, x, y]);
            }
        }
        tiles
    }

    /// Returns a lower bound of the distance from the eye to a tile: that to its nearest vertex, less one metre.
    fn distance_m(&self, level: u32, x: u32, y: u32, eye: DVec3) -> f64 {
        let size = 1.0 / f64::from(1u32 << level);
        let mut nearest = f64::INFINITY;
        for j in 0..=64 {
            for i in 0..=64 {
                let (u, v) = ((f64::from(x) + f64::from(i) / 64.0) * size, (f64::from(y) + f64::from(j) / 64.0) * size);
                nearest = nearest.min(self.world(u, v, 0.0).distance(eye));
            }
        }
        nearest - 1.0
    }
}
