//! Trees and rocks on a tile: instances of a few meshes, as glb with EXT_mesh_gpu_instancing.
//!
//! Sites are places on a lattice that all levels of a set share, so that a tile has those that lie in it. Fine levels have a
//! second lattice, of shrubs and stones. The ground decides what stands there; it stands on the surface of the tile's own
//! level.

mod models;

use terrane::formats::writers::glb_container;
use terrane::math::random::mix64;
use terrane::math::{Ellipsoid, Geodetic};

use super::World;
use super::relief::smooth;
use super::surface::{Lattice, Patch, Site};
use crate::pyramid::CELLS;
use models::Kind;

/// The largest cells of a level with trees and rocks, in metres.
pub(super) const MAX_CELL_M: f64 = 60.0;
/// The largest distance between sites in metres.
const MAX_SPACING_M: f64 = 20.0;
/// The largest cells of a level with shrubs and stones, in metres, and the largest distance between the sites of these.
const MAX_FINE_CELL_M: f64 = 8.0;
const MAX_FINE_SPACING_M: f64 = 5.0;
/// Shrubs and stones have other numbers than trees.
const FINE_SEED: u64 = 0x5ca7_7e12;
/// The share of sites in a dense forest that have a tree.
const FOREST: f32 = 0.35;
/// The height of the tallest tree in metres.
pub(super) const TALLEST_M: f64 = 32.0;

/// More than the widest tree or rock reaches from its position in metres.
pub(super) const WIDEST_M: f64 = 8.0;

/// An instance: its place in the frame of the tile (east, up, south), its turn around the vertical, and its size.
#[derive(Clone, Copy, Debug)]
struct Instance {
    at_m: [f32; 3],
    half_turn: f32,
    scale: f32,
}

/// The instances of a tile by kind, and the frame that they are in.
#[derive(Debug)]
pub(super) struct Scatter {
    origin: Geodetic,
    ellipsoid: Ellipsoid,
    instances: [Vec<Instance>; Kind::ALL.len()],
}

/// The lattice of the sites of a set, as a multiple of the steps of level 0.
#[derive(Clone, Copy, Debug)]
struct Sites {
    steps: f64,
}

impl Sites {
    /// Returns the lattice of a set: that of level 0, split until sites are close.
    fn new(root: &Lattice, spacing_m: f64) -> Self {
        let mut steps = root.steps;
        while steps * spacing_m < root.step_m() * root.steps {
            steps *= 2.0;
        }
        Self { steps }
    }

    /// Returns the sites in a patch: their places in cells, and random bits.
    fn within(self, lattice: Lattice, seed: u64) -> impl Iterator<Item = ([f64; 2], u64)> {
        let cells = CELLS as f64;
        // Sites whose place may lie in the tile, as numbers of steps of the lattice of sites.
        let scale = self.steps / lattice.steps;
        let range = move |first: i64| {
            let low = (first as f64 * scale).floor() as i64;
            low..((first as f64 + cells) * scale).ceil() as i64
        };
        let all = range(lattice.row).flat_map(move |row| range(lattice.column).map(move |column| (row, column)));
        all.filter_map(move |(row, column)| {
            let bits = mix64(mix64(seed ^ row as u64).wrapping_add(column as u64));
            let x = (column as f64 + unit(bits, 0)) / scale - lattice.column as f64;
            let y = (row as f64 + unit(bits, 16)) / scale - lattice.row as f64;
            ((0.0..cells).contains(&x) && (0.0..cells).contains(&y)).then_some(([x, y], bits))
        })
    }
}

/// Returns 16 bits as a number within 0..1.
fn unit(bits: u64, shift: u32) -> f64 {
    ((bits >> shift) & 0xffff) as f64 / 65_536.0
}

/// Returns what stands on a site, by a random number.
fn chosen(ground: &Site, chance: f32, is_fine: bool) -> Option<Kind> {
    // Rocks lie where it is steep and bare, few of them anywhere.
    let rocky = ground.bare * (0.02 + 0.2 * smooth(0.25, 0.6, ground.slope));
    let is_rock = (1.0 - chance) < rocky;
    match is_fine {
        _ if !ground.is_dry || ground.slope > 1.2 => None,
        true if chance < 0.3 * ground.green => Some(Kind::Shrub),
        true if is_rock => Some(Kind::Stone),
        false if chance < FOREST * ground.wood && ground.celsius < 9.0 => Some(Kind::Conifer),
        false if chance < FOREST * ground.wood => Some(Kind::Broadleaf),
        false if is_rock => Some(Kind::Rock),
        _ => None,
    }
}

impl Scatter {
    /// Chooses what stands on a patch, whose colours were painted. `root` is the lattice of the set's level 0.
    pub fn new(world: &World, patch: &Patch, root: &Lattice) -> Self {
        let lattice = patch.lattice();
        let middle = CELLS as i64 / 2;
        let origin = Geodetic {
            longitude: lattice.longitude(middle),
            latitude: lattice.latitude(middle),
            height_m: f64::from(patch.surface_m(middle, middle)),
        };
        let mut scatter = Self { origin, ellipsoid: world.ellipsoid, instances: Default::default() };
        scatter.add(world, patch, Sites::new(root, MAX_SPACING_M), false);
        if lattice.step_m() <= MAX_FINE_CELL_M {
            scatter.add(world, patch, Sites::new(root, MAX_FINE_SPACING_M), true);
        }
        scatter
    }

    /// Adds what stands on the sites of a lattice.
    fn add(&mut self, world: &World, patch: &Patch, sites: Sites, is_fine: bool) {
        let lattice = patch.lattice();
        let local_from_ecef = self.ellipsoid.ecef_from_enu(&self.origin).inverse();
        let seed = if is_fine { world.seed ^ FINE_SEED } else { world.seed };
        for ([x, y], bits) in sites.within(lattice, seed) {
            let more = mix64(bits);
            let ground = patch.site(world, x, y);
            let Some(kind) = chosen(&ground, unit(bits, 32) as f32, is_fine) else { continue };
            let size = unit(more, 0) as f32;
            let place = Geodetic {
                longitude: lattice.at_longitude(x),
                latitude: lattice.at_latitude(y),
                height_m: f64::from(ground.surface_m),
            };
            let [east, north, up] = local_from_ecef.transform_point3(self.ellipsoid.ecef(&place)).to_array();
            // Roots reach below the ground, which is not level.
            let sunk_m = if is_fine { 0.05 } else { 0.4 * f64::from(ground.slope.min(1.0)) };
            self.instances[kind as usize].push(Instance {
                at_m: [east, up - sunk_m, -north].map(|c| c as f32),
                half_turn: (unit(more, 16) * std::f64::consts::PI) as f32,
                scale: kind.scale(size),
            });
        }
    }

    /// Returns the number of instances of each kind: conifers, broadleaf trees, rocks, shrubs, stones.
    pub fn counts(&self) -> [usize; 5] {
        self.instances.each_ref().map(Vec::len)
    }

    /// Returns the instances as glb.
    pub fn glb(&self) -> Vec<u8> {
        models::glb(self)
    }
}
