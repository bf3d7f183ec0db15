//! Measures the tiles of a set while it is read, depth first: what a tile draws is compared with the tiles above it, which are
//! in memory, and its edges with those of neighbours that wait. Threads share the distances of a finest tile. Blocking jobs;
//! not for frames.
//!
//! ```text
//! place    positions of a set as places on a map with heights
//! surface  the triangles of a content without skirts, with its edges, and distances from it
//! grid     finds the triangles at a place
//! edges    the edges of tiles that wait for their neighbours
//! levels   the result by level
//! ```

mod edges;
mod grid;
mod levels;
mod place;
mod surface;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DAffine3, Vec3};

use self::edges::{Edges, difference_to_coarser_m};
use self::levels::{LevelSums, extend, raise};
use self::surface::{Surface, drawables};
use crate::fetch::shown;
use crate::formats::height;
use crate::formats::image::ImageFiles;
use crate::math::BoundingVolume;
use crate::scene::{Geometry, Node, NodeKind, ReaderData, Refine, Texture};

pub use self::levels::{LevelMeasures, Problem, Spread};
pub use self::place::MapFrame;

/// Distances up to this are rounding, metres.
const SLACK_M: f64 = 0.01;
/// Positions may be rounded to 16 bits of the size of a tile: half a step, as a share of its radius, with some room.
const SLACK_SHARE: f64 = 2e-5;
/// The maximum number of vertices of a tile whose distance from another one is measured, where that is not vertical.
const MAX_POINTS: usize = 2_000;

/// The number of vertices from which on threads share them: with fewer, their start takes longer.
const MIN_SHARED_POINTS: usize = 8_000;

/// The kind of problem of a content that its tile's volume does not contain.
const OUTSIDE: &str = "content outside of the bounding volume of its tile";

/// The declarations of a tile.
pub(super) struct Declared {
    pub uri: Arc<str>,
    pub level: u32,
    /// In the frame of the set. `None` if it is unknown.
    pub volume: Option<BoundingVolume>,
    /// `None` if the tile has no error, or is always refined.
    pub error_m: Option<f64>,
    pub refine: Refine,
    /// True if tiles below refine it.
    pub has_children: bool,
    /// True for a further content of a tile, such as trees on its ground, which is not compared with other tiles.
    pub is_further: bool,
}

/// A tile of a set, as its file declares it and, if contents were read, as it was measured.
#[derive(Clone, Debug)]
pub struct SurveyedTile {
    /// The URI of its content; that of its tileset if it has none.
    pub uri: Arc<str>,
    /// The level; see [`LevelInfo::level`](crate::formats::LevelInfo::level).
    pub level: u32,
    /// The frame of the rectangle.
    pub frame: MapFrame,
    /// The rectangle of the map around it: the smallest x and y, then the largest. The largest longitude is beyond pi across
    /// the antimeridian.
    pub rectangle: Option<[f64; 4]>,
    /// The declared geometric error, metres.
    pub error_m: Option<f64>,
    /// The measured distance from the finest tiles below, metres.
    pub measured_m: Option<f64>,
    /// Bytes of its content and imagery, where they are known.
    pub bytes: u64,
    /// True if the tile has a content.
    pub has_content: bool,
    /// True if a [`Problem`] was found.
    pub has_problem: bool,
}

/// A tile whose descendants are being read.
struct OpenTile {
    declared: Declared,
    surface: Option<Surface>,
    to_next_m: Option<f64>,
    to_finest_m: Option<f64>,
    /// The part of it that was measured vertically. Other distances are as large as what a coarser tile leaves out.
    vertical_to_finest_m: Option<f64>,
    bytes: u64,
    has_content: bool,
    has_problem: bool,
}

/// Measures the tiles of a set.
pub(super) struct Measuring {
    frame: MapFrame,
    /// True if the format declares no errors: they are computed from the level.
    has_own_errors: bool,
    levels: BTreeMap<u32, LevelSums>,
    problems: BTreeMap<&'static str, Problem>,
    /// From the root to the current tile.
    path: Vec<OpenTile>,
    edges: Edges,
    processors: usize,
}

impl Measuring {
    pub fn new(frame: MapFrame, has_own_errors: bool) -> Self {
        let (levels, problems, path) = Default::default();
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        Self { frame, has_own_errors, levels, problems, path, edges: Edges::default(), processors }
    }

    /// Returns the number of edges that were not compared, since too many others waited.
    pub fn edges_left_out(&self) -> u64 {
        self.edges.dropped
    }

    /// Begins a tile below the current one.
    pub fn open(&mut self, declared: Declared) {
        if let Some(error_m) = declared.error_m {
            let range = &mut self.level(declared.level).measures.geometric_error_m;
            extend(range, [error_m; 2]);
        }
        let above = self.path.iter().rev().find_map(|tile| tile.declared.error_m);
        let excess = above.zip(declared.error_m).filter(|(above_m, own_m)| own_m > &(above_m * (1.0 + 1e-6)));
        let has_problem = excess.is_some();
        if let Some((above_m, own_m)) = excess {
            let detail = format!("{own_m} m below {above_m} m");
            self.problem("geometricError larger than that of the tile above", &declared.uri, detail);
        }
        self.path.push(OpenTile {
            declared,
            surface: None,
            to_next_m: None,
            to_finest_m: None,
            vertical_to_finest_m: None,
            bytes: 0,
            has_content: false,
            has_problem,
        });
    }

    /// Counts the bytes of a content of the current tile that is not read.
    pub fn add_bytes(&mut self, bytes: u64) {
        if let Some(tile) = self.path.last_mut() {
            tile.bytes += bytes;
            tile.has_content = true;
        }
    }

    /// Measures a content of the current tile. `data` is that of a height tile.
    pub fn add_content(
        &mut self,
        node: &Node,
        set_from_node: &DAffine3,
        data: Option<&ReaderData>,
        files: &ImageFiles,
        bytes: u64,
    ) {
        self.add_bytes(bytes);
        let Some(mut tile) = self.path.pop() else { return };
        tile.declared.has_children |= has_tiles(node);
        let textures = textures(node, files);
        let surface = self.surface(node, set_from_node, data);
        let level = self.level(tile.declared.level);
        level.add(bytes, surface.as_ref().map(Surface::triangle_count));
        for name in textures {
            *level.measures.textures.entry(name).or_default() += 1;
        }
        match surface {
            Some(surface) => self.add_surface(&mut tile, surface),
            None => self.check_vertices(&mut tile, node, set_from_node),
        }
        self.path.push(tile);
    }

    fn surface(&self, node: &Node, set_from_node: &DAffine3, data: Option<&ReaderData>) -> Option<Surface> {
        let heights = drawables(node, set_from_node).into_iter().find_map(|(drawable, set_from_tile)| {
            let Geometry::Height(tile) = &drawable.geometry else { return None };
            Some((tile.clone(), set_from_tile))
        });
        let Some((tile, set_from_tile)) = heights else { return Surface::of_meshes(node, set_from_node, self.frame) };
        let region = data.and_then(ReaderData::text).and_then(height::region);
        Surface::of_heights(&tile, &set_from_tile, region, self.frame)
    }

    /// Checks that a content without triangles, such as a point cloud, lies in the volume of its tile.
    fn check_vertices(&mut self, tile: &mut OpenTile, node: &Node, set_from_node: &DAffine3) {
        let Some(volume) = &tile.declared.volume else { return };
        let mut largest_m: f64 = 0.0;
        for (drawable, set_from_drawable) in drawables(node, set_from_node) {
            let Geometry::Mesh(mesh) = &drawable.geometry else { continue };
            for vertex in mesh.indices.iter().filter_map(|index| mesh.vertices.get(*index as usize)) {
                let position = Vec3::from_array(vertex.position).as_dvec3();
                let place = self.frame.place(set_from_drawable.transform_point3(position));
                largest_m = largest_m.max(self.frame.outside_m(volume, &place));
            }
        }
        if largest_m > SLACK_M + SLACK_SHARE * volume.bounding_sphere().radius_m {
            tile.has_problem = true;
            self.problem(OUTSIDE, &tile.declared.uri, format!("{largest_m:.3} m outside"));
        }
    }

    fn add_surface(&mut self, tile: &mut OpenTile, surface: Surface) {
        let Declared { uri, level, volume, error_m, has_children, is_further, .. } = &tile.declared;
        let frame = self.frame;
        let measures = &mut self.level(*level).measures;
        extend(&mut measures.heights_m, surface.heights_m());
        surface.skirt_m.into_iter().for_each(|depth_m| extend(&mut measures.skirt_m, depth_m));

        let is_outside = |volume: &BoundingVolume| {
            let slack_m = SLACK_M + SLACK_SHARE * volume.bounding_sphere().radius_m;
            let outside = surface.vertices.iter().map(|vertex| frame.outside_m(volume, vertex));
            Some(outside.fold(0.0, f64::max)).filter(|largest_m| *largest_m > slack_m)
        };
        let mut found: Vec<(&'static str, String)> = Vec::new();
        if let Some(outside_m) = volume.as_ref().and_then(is_outside) {
            found.push((OUTSIDE, format!("{outside_m:.3} m outside")));
        } else if let Some(above) = self.path.last()
            && let Some(outside_m) = above.declared.volume.as_ref().and_then(is_outside)
        {
            found.push((
                "content outside of the bounding volume of the tile above",
                format!("{outside_m:.3} m outside"),
            ));
        }

        let differences =
            if *is_further { Vec::new() } else { self.edges.add(*level, uri, &surface, error_m.unwrap_or(0.0)) };
        for difference in differences {
            let edges::Difference { largest_m, error_m, skirt_m, neighbour } = difference;
            let measures = &mut self.levels.entry(*level).or_default().measures;
            measures.edges += 1;
            raise(&mut measures.edge_m, largest_m);
            let allowed_m = error_m.max(skirt_m) + SLACK_M;
            if surface.is_height_field && largest_m > allowed_m {
                let detail = format!("{largest_m:.3} m at the edge with {}", shown(&neighbour));
                found.push(("edge that differs from that of a neighbour by more than errors and skirts", detail));
            }
        }

        // A leaf is compared with all tiles above that it replaces, another tile with the next one.
        let replaced = self.path.iter_mut().rev().take_while(|above| above.declared.refine == Refine::Replace);
        let mut compared: Vec<&mut OpenTile> =
            replaced.filter(|above| above.surface.is_some() && !is_further).collect();
        compared.truncate(if *has_children { 1 } else { usize::MAX });
        let coarse: Vec<&Surface> = compared.iter().filter_map(|above| above.surface.as_ref()).collect();
        if let Some(next) = coarse.first()
            && let Some(difference_m) = difference_to_coarser_m(&surface, next)
        {
            raise(&mut self.levels.entry(*level).or_default().measures.edge_to_coarser_m, difference_m);
        }
        let are_fields: Vec<bool> =
            coarse.iter().map(|coarse| coarse.is_height_field && surface.is_height_field).collect();
        let errors_m = largest_distances_m(&surface, &coarse, self.processors);
        for (number, (above, error_m)) in compared.iter_mut().zip(errors_m).enumerate() {
            let Some(error_m) = error_m else { continue };
            if number == 0 {
                raise(&mut above.to_next_m, error_m);
            }
            if !has_children {
                raise(&mut above.to_finest_m, error_m);
            }
            if !has_children && are_fields[number] {
                raise(&mut above.vertical_to_finest_m, error_m);
            }
        }
        let uri = uri.clone();
        for (kind, detail) in found {
            tile.has_problem = true;
            self.problem(kind, &uri, detail);
        }
        // Leaves are compared with no other tile.
        tile.surface = Some(surface);
    }

    /// Ends the current tile, after all tiles below it.
    pub fn close(&mut self) -> Option<SurveyedTile> {
        let tile = self.path.pop()?;
        let OpenTile { declared, surface, to_next_m, to_finest_m, vertical_to_finest_m, .. } = tile;
        let (bytes, has_content, mut has_problem) = (tile.bytes, tile.has_content, tile.has_problem);
        let measures = &mut self.level(declared.level).measures;
        to_next_m.into_iter().for_each(|error_m| raise(&mut measures.error_to_next_m, error_m));
        to_finest_m.into_iter().for_each(|error_m| raise(&mut measures.error_to_finest_m, error_m));
        let measured = vertical_to_finest_m.filter(|_| self.has_own_errors);
        if let Some((declared_m, measured_m)) = declared.error_m.zip(measured) {
            let radius_m = declared.volume.as_ref().map_or(0.0, |volume| volume.bounding_sphere().radius_m);
            let slack_m = SLACK_M + if radius_m.is_finite() { 0.05 * SLACK_SHARE * radius_m } else { 0.0 };
            if measured_m > declared_m * 1.001 + slack_m {
                has_problem = true;
                let detail = format!("{declared_m:.3} m declared, {measured_m:.3} m measured");
                self.problem("geometricError smaller than the measured error", &declared.uri, detail);
            }
        }
        let of_volume = || self.frame.rectangle(declared.volume.as_ref()?);
        let rectangle = surface.map(|surface| surface.rectangle).or_else(of_volume);
        let Declared { uri, level, error_m, .. } = declared;
        let (frame, measured_m) = (self.frame, to_finest_m);
        Some(SurveyedTile { uri, level, frame, rectangle, error_m, measured_m, bytes, has_content, has_problem })
    }

    /// Returns the measures and the problems of all tiles.
    pub fn finish(self) -> (Vec<LevelMeasures>, Vec<Problem>) {
        let levels = self.levels.into_iter().map(|(level, sums)| LevelMeasures { level, ..sums.finish() });
        (levels.collect(), self.problems.into_values().collect())
    }

    fn level(&mut self, level: u32) -> &mut LevelSums {
        self.levels.entry(level).or_default()
    }

    fn problem(&mut self, kind: &'static str, uri: &str, detail: String) {
        let first = || Problem { kind: kind.to_owned(), count: 0, uri: shown(uri).into_owned(), detail };
        self.problems.entry(kind).or_insert_with(first).count += 1;
    }
}

/// Returns for each coarser tile what [`largest_distance_m`] does, on as many threads as there are processors, one tile at a
/// time.
fn largest_distances_m(fine: &Surface, coarse: &[&Surface], processors: usize) -> Vec<Option<f64>> {
    let points: usize = coarse.iter().map(|coarse| fine.vertices.len() + coarse.vertices.len()).sum();
    let others = coarse.len().min(processors).saturating_sub(1);
    if points < MIN_SHARED_POINTS || others == 0 {
        return coarse.iter().map(|coarse| largest_distance_m(fine, coarse)).collect();
    }
    let next = AtomicUsize::new(0);
    let work = || {
        let numbers = std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed));
        let own = numbers.map_while(|number| Some((number, largest_distance_m(fine, coarse.get(number)?))));
        own.collect::<Vec<_>>()
    };
    let mut found = std::thread::scope(|scope| {
        // Without further threads this one does all.
        let start = |_| std::thread::Builder::new().name("measure".to_owned()).spawn_scoped(scope, work).ok();
        let threads: Vec<_> = (0..others).filter_map(start).collect();
        let mut found = work();
        for thread in threads {
            found.extend(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        }
        found
    });
    found.sort_by_key(|(number, _)| *number);
    found.into_iter().map(|(_, error_m)| error_m).collect()
}

/// Returns the largest distance between a tile and a coarser one, at the vertices of both, metres; `None` if they do not lie
/// above each other.
fn largest_distance_m(fine: &Surface, coarse: &Surface) -> Option<f64> {
    let mut largest: Option<f64> = None;
    let mut add =
        |distance_m: Option<f64>| distance_m.into_iter().for_each(|distance_m| raise(&mut largest, distance_m));
    if !(fine.is_height_field && coarse.is_height_field) {
        let step = fine.vertices.len().div_ceil(MAX_POINTS).max(1);
        fine.vertices.iter().step_by(step).for_each(|vertex| add(coarse.distance_m(vertex)));
        return largest;
    }
    for (vertex, axes) in fine.vertices.iter().zip(&fine.axes) {
        add(coarse.vertical_distance_m(vertex, axes));
    }
    if !(fine.is_samples && coarse.is_samples) {
        for (vertex, axes) in coarse.vertices.iter().zip(&coarse.axes).filter(|(vertex, _)| fine.contains(vertex)) {
            add(fine.vertical_distance_m(vertex, axes));
        }
    }
    largest
}

/// Returns true if a content has tiles, as those of OpenSceneGraph's databases.
fn has_tiles(node: &Node) -> bool {
    matches!(node.kind, NodeKind::PagedLod(_) | NodeKind::ProxyNode(_)) || node.children.iter().any(has_tiles)
}

/// Returns the file format and size of each texture of a content.
fn textures(node: &Node, files: &ImageFiles) -> Vec<String> {
    let mut known: Vec<Arc<Texture>> = Vec::new();
    for (drawable, _) in drawables(node, &DAffine3::IDENTITY) {
        let material = &drawable.material;
        let maps = material.metallic_roughness.iter().flat_map(|surface| surface.maps()).flatten();
        let own = match &drawable.geometry {
            Geometry::Height(tile) => tile.texture.as_ref(),
            _ => None,
        };
        for texture in own.into_iter().chain(&material.texture).chain(maps) {
            if !known.iter().any(|other| Arc::ptr_eq(other, texture)) {
                known.push(texture.clone());
            }
        }
    }
    let name = |texture: &Arc<Texture>| {
        let file = files.file_of(texture);
        let format = match file.as_deref() {
            Some([0xff, 0xd8, ..]) => "JPEG",
            Some([0x89, b'P', b'N', b'G', ..]) => "PNG",
            Some([b'R', b'I', b'F', b'F', ..]) => "WebP",
            Some([0xab, b'K', b'T', b'X', ..]) => "KTX2",
            Some([b'D', b'D', b'S', ..]) => "DDS",
            _ => "image",
        };
        format!("{format} {} x {}", texture.width, texture.height)
    };
    known.iter().map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::WGS84;
    use crate::scene::{Drawable, Material, Mesh, MeshVertex, Topology};

    /// A square of the globe with `side` vertices along its sides, at the heights of a function of column and row, in degrees.
    fn square(side: usize, height_m: impl Fn(f64, f64) -> f64) -> Surface {
        let frame = MapFrame::Globe(WGS84);
        let share = |k: usize| k as f64 / (side - 1) as f64;
        let origin = frame.place_at([0.2, 0.8], 0.0).position;
        let vertices = (0..side * side).map(|k| (share(k % side), share(k / side))).map(|(u, v)| {
            let place = frame.place_at([0.2 + 1e-3 * u, 0.8 + 1e-3 * v], height_m(u, v));
            MeshVertex { position: (place.position - origin).as_vec3().to_array(), ..MeshVertex::default() }
        });
        let cells = (0..(side - 1) * (side - 1)).map(|k| (k / (side - 1) * side + k % (side - 1)) as u32);
        let above = side as u32;
        let indices = cells.flat_map(|sw| [sw, sw + 1, sw + above + 1, sw, sw + above + 1, sw + above]);
        let mesh = Mesh::new(vertices.collect(), indices.collect(), Topology::Triangles);
        let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default());
        let node = Node::new(NodeKind::Geode(vec![drawable]));
        Surface::of_meshes(&node, &DAffine3::from_translation(origin), frame).unwrap()
    }

    #[test]
    fn distances_from_coarser_tiles_do_not_depend_on_threads() {
        let height_m = |u: f64, v: f64| 100.0 * (9.0 * u).sin() * (7.0 * v).cos();
        let fine = square(65, height_m);
        let coarse = [33, 17, 9, 5].map(|side| square(side, height_m));
        let coarse: Vec<&Surface> = coarse.iter().collect();
        let alone = largest_distances_m(&fine, &coarse, 1);
        assert_eq!(largest_distances_m(&fine, &coarse, 3), alone);
        // The coarser the farther, and every vertex has a triangle below or above it.
        assert!(alone.windows(2).all(|two| two[0] < two[1]), "{alone:?}");
        assert!(
            alone[0].is_some_and(|m| (0.1..2.0).contains(&m)) && alone[3].is_some_and(|m| (20.0..200.0).contains(&m))
        );
        let mut above = fine.vertices.iter().zip(&fine.axes);
        assert!(above.all(|(place, axes)| coarse[3].vertical_distance_m(place, axes).is_some()));
    }
}
