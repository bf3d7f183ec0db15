//! Trees and rocks on a tile: instances of a few meshes, as glb with EXT_mesh_gpu_instancing.
//!
//! Sites are places on a lattice that all levels of a set share, so that a tile has those that lie in it. The ground decides
//! what stands there; it stands on the surface of the tile's own level.

mod models;

use terrane::formats::writers::glb_container;
use terrane::math::random::mix64;
use terrane::math::{Geodetic, WGS84};

use super::World;
use super::relief::smooth;
use super::surface::{Lattice, Patch};
use crate::pyramid::CELLS;
use models::Kind;

/// The largest cells of a level with trees and rocks, in metres.
pub(super) const MAX_CELL_M: f64 = 60.0;
/// The largest distance between sites in metres.
const MAX_SPACING_M: f64 = 20.0;
/// The share of sites in a dense forest that have a tree.
const FOREST: f32 = 0.35;
/// The height of the tallest tree in metres.
pub(super) const TALLEST_M: f64 = 32.0;

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
    instances: [Vec<Instance>; Kind::ALL.len()],
}

/// The lattice of the sites of a set, as a multiple of the steps of level 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sites {
    pub steps: f64,
}

impl Sites {
    /// Returns the lattice of a set: that of the first level whose cells are small enough, split until sites are close.
    pub fn new(root: &Lattice) -> Self {
        let mut steps = root.steps;
        while steps * MAX_SPACING_M < root.step_m() * root.steps {
            steps *= 2.0;
        }
        Self { steps }
    }
}

impl Scatter {
    /// Chooses what stands on a patch, whose colours were painted.
    pub fn new(world: &World, patch: &Patch, sites: Sites) -> Self {
        let lattice = patch.lattice();
        let cells = CELLS as f64;
        // Sites whose place may lie in the tile, as numbers of steps of the lattice of sites.
        let scale = sites.steps / lattice.steps;
        let range = |first: i64| {
            let low = (first as f64 * scale).floor() as i64;
            low..((first as f64 + cells) * scale).ceil() as i64
        };
        let middle = CELLS as i64 / 2;
        let origin = Geodetic {
            longitude: lattice.longitude(middle),
            latitude: lattice.latitude(middle),
            height_m: f64::from(patch.surface_m(middle, middle)),
        };
        let local_from_ecef = WGS84.ecef_from_enu(&origin).inverse();
        let mut scatter = Self { origin, instances: Default::default() };
        for (row, column) in range(lattice.row).flat_map(|row| range(lattice.column).map(move |column| (row, column))) {
            let bits = mix64(mix64(world.seed ^ row as u64).wrapping_add(column as u64));
            let more = mix64(bits);
            let unit = |bits: u64, shift: u32| ((bits >> shift) & 0xffff) as f64 / 65_536.0;
            // The place in cells of the tile.
            let x = (column as f64 + unit(bits, 0)) / scale - lattice.column as f64;
            let y = (row as f64 + unit(bits, 16)) / scale - lattice.row as f64;
            if !(0.0..cells).contains(&x) || !(0.0..cells).contains(&y) {
                continue;
            }
            let ground = patch.site(world, x, y);
            let chance = unit(bits, 32) as f32;
            // Rocks lie where it is steep and bare, few of them anywhere.
            let rocky = ground.bare * (0.02 + 0.2 * smooth(0.25, 0.6, ground.slope));
            let kind = match () {
                () if !ground.is_dry || ground.slope > 1.2 => continue,
                () if chance < FOREST * ground.wood && ground.celsius < 9.0 => Kind::Conifer,
                () if chance < FOREST * ground.wood => Kind::Broadleaf,
                () if (1.0 - chance) < rocky => Kind::Rock,
                () => continue,
            };
            let size = unit(more, 0) as f32;
            let place = Geodetic {
                longitude: lattice.at_longitude(x),
                latitude: lattice.at_latitude(y),
                height_m: f64::from(ground.surface_m),
            };
            let [east, north, up] = local_from_ecef.transform_point3(WGS84.ecef(&place)).to_array();
            // Roots reach below the ground, which is not level.
            let sunk_m = 0.4 * f64::from(ground.slope.min(1.0));
            scatter.instances[kind as usize].push(Instance {
                at_m: [east, up - sunk_m, -north].map(|c| c as f32),
                half_turn: (unit(more, 16) * std::f64::consts::PI) as f32,
                scale: kind.scale(size),
            });
        }
        scatter
    }

    /// Returns the number of instances of each kind: conifers, broadleaf trees, rocks.
    pub fn counts(&self) -> [usize; 3] {
        self.instances.each_ref().map(Vec::len)
    }

    /// Returns the instances as glb.
    pub fn glb(&self) -> Vec<u8> {
        models::glb(self)
    }
}
