//! Height above the terrain, for any thread.
//!
//! The scene itself can be read only between two updates. The thread that holds the scene publishes snapshots of the
//! ground to a [`HeightQuery`], as often as it likes; all other threads query the last snapshot.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use glam::{DAffine3, DMat3, DVec3};

use super::kd_tree::{KdTree, divide};
use super::probe::{Candidate, Probe};
use super::selection::LodSelection;
use super::surface::Surface;
use super::visitor::IntersectionVisitor;
use super::walk::candidates;
use crate::math::{BoundingSphere, Ellipsoid, Ray};
use crate::scene::geometry::Geometry;
use crate::scene::graph::Scene;

/// The direction upwards, and the surface of height 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Vertical {
    /// Up is z, and z is the height: for scenes that are not on the earth.
    Flat,
    /// Up is the normal of an ellipsoid around the origin, and heights are above it: for scenes around the centre of a body, with
    /// [`Scene::ellipsoid`].
    Ellipsoid(Ellipsoid),
}

impl Vertical {
    /// Returns the unit vector upwards at a point of the world, and the point's height in metres.
    pub fn up_and_height_m(&self, point: DVec3) -> (DVec3, f64) {
        match self {
            Self::Flat => (DVec3::Z, point.z),
            Self::Ellipsoid(ellipsoid) => {
                let place = ellipsoid.geodetic(point);
                (ellipsoid.up(&place), place.height_m)
            }
        }
    }

    /// Returns the depth down to which ground is searched, which excludes the other side of the earth.
    fn depth_m(&self, height_m: f64) -> f64 {
        match self {
            Self::Flat => f64::INFINITY,
            Self::Ellipsoid(ellipsoid) => height_m.max(0.0) + 0.5 * ellipsoid.semi_minor_m,
        }
    }
}

/// A point on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPoint {
    /// The point in the world, metres.
    pub point: DVec3,
    /// The unit normal of the ground in the world, on the upper side.
    pub normal: DVec3,
    /// The height above the ellipsoid or the plane z = 0, metres.
    pub height_m: f64,
    /// The height of the query's point above the ground, metres; negative below.
    pub above_m: f64,
}

/// The published ground, which any thread can query.
///
/// Clones share the snapshot. [`Self::publish`] is called by the thread that holds the scene, after update. It costs nothing
/// while the scene is unchanged, and otherwise about 0.3 us per drawable of the level. All other methods can be called on
/// any thread at any time; they hold a lock only while an `Arc` is cloned, and never delay the frame.
///
/// Requires the drawables' [`KdTree`]s (see [`PagerConfig::build_kd_trees`](crate::pager::PagerConfig::build_kd_trees)) or
/// payloads. A snapshot keeps its trees in memory until the next one is published, whatever the pager expires.
#[derive(Clone, Debug)]
pub struct HeightQuery {
    vertical: Vertical,
    traversal_mask: u32,
    lod_selection: LodSelection,
    /// The last snapshot; written by `publish`, read by any thread.
    published: Arc<Mutex<Arc<GroundSnapshot>>>,
}

impl HeightQuery {
    /// Creates a query without ground.
    pub fn new(vertical: Vertical) -> Self {
        Self {
            vertical,
            traversal_mask: u32::MAX,
            lod_selection: LodSelection::Highest,
            published: Arc::new(Mutex::new(Arc::new(GroundSnapshot::empty(vertical)))),
        }
    }

    /// Sets the traversal mask: only nodes with `mask & traversal_mask != 0` are ground.
    pub fn with_traversal_mask(mut self, traversal_mask: u32) -> Self {
        self.traversal_mask = traversal_mask;
        self
    }

    /// Sets the level of detail. There is no eye, so `AsSeen` is the highest level.
    pub fn with_lod_selection(mut self, lod_selection: LodSelection) -> Self {
        self.lod_selection = lod_selection;
        self
    }

    /// Publishes a snapshot of the scene. Returns false if the scene has not changed since the last one.
    pub fn publish(&self, scene: &Scene) -> bool {
        let before = self.snapshot();
        let of = Some((self.traversal_mask, self.lod_selection, scene.revision()));
        if before.of == of {
            return false;
        }
        let mut visitor = IntersectionVisitor::new();
        visitor.traversal_mask = self.traversal_mask;
        visitor.lod_selection = self.lod_selection;
        let after = Arc::new(GroundSnapshot::new(scene, &visitor, self.vertical, of));
        *self.published.lock().unwrap_or_else(PoisonError::into_inner) = after;
        true
    }

    /// Returns the last snapshot, for several queries with consistent results.
    pub fn snapshot(&self) -> Arc<GroundSnapshot> {
        self.published.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Calls [`GroundSnapshot::ground_at`] of the last snapshot.
    pub fn ground_at(&self, point: DVec3) -> Option<GroundPoint> {
        self.snapshot().ground_at(point)
    }

    /// Calls [`GroundSnapshot::highest_ground_at`] of the last snapshot.
    pub fn highest_ground_at(&self, point: DVec3) -> Option<GroundPoint> {
        self.snapshot().highest_ground_at(point)
    }

    /// Calls [`GroundSnapshot::height_above_terrain_m`] of the last snapshot.
    pub fn height_above_terrain_m(&self, point: DVec3) -> Option<f64> {
        self.snapshot().height_above_terrain_m(point)
    }

    /// Calls [`GroundSnapshot::terrain_height_m`] of the last snapshot.
    pub fn terrain_height_m(&self, point: DVec3) -> Option<f64> {
        self.snapshot().terrain_height_m(point)
    }
}

/// A drawable of the ground.
#[derive(Debug)]
struct Piece {
    surface: PieceSurface,
    world_from_drawable: DAffine3,
}

#[derive(Debug)]
enum PieceSurface {
    Tree(Arc<KdTree>),
    Payload(Geometry),
}

impl Piece {
    fn surface(&self) -> Surface<'_> {
        match &self.surface {
            PieceSurface::Tree(tree) => Surface::Tree(tree),
            PieceSurface::Payload(geometry) => Surface::Payload(geometry),
        }
    }

    /// Returns a sphere around the drawable in the world.
    fn sphere(&self) -> BoundingSphere {
        let local = match &self.surface {
            PieceSurface::Tree(tree) => tree.bounding_sphere(),
            PieceSurface::Payload(geometry) => geometry.bounds().bounding_sphere(),
        };
        local.transformed(&self.world_from_drawable)
    }
}

/// The ground at the time of publication. Any thread.
#[derive(Debug)]
pub struct GroundSnapshot {
    vertical: Vertical,
    /// The settings of the query and the revision of the scene.
    of: Option<(u32, LodSelection, u64)>,
    pieces: Vec<Piece>,
    /// The search index, built by the first query, so that the publishing thread need not.
    index: OnceLock<Index>,
}

/// A shape that meets everything, to collect all drawables.
struct Everywhere;

impl Probe for Everywhere {
    type Local = ();

    fn local(&self, _: u32, _: &DAffine3) -> Option<()> {
        Some(())
    }

    fn enters_sphere((): &(), _: DVec3, _: f64) -> Option<f64> {
        Some(0.0)
    }

    fn enters_box((): &(), _: DVec3, _: &DMat3, _: DVec3) -> Option<f64> {
        Some(0.0)
    }
}

impl GroundSnapshot {
    fn empty(vertical: Vertical) -> Self {
        Self { vertical, of: None, pieces: Vec::new(), index: OnceLock::new() }
    }

    fn new(
        scene: &Scene,
        visitor: &IntersectionVisitor,
        vertical: Vertical,
        of: Option<(u32, LodSelection, u64)>,
    ) -> Self {
        let mut found = Vec::new();
        candidates(scene, &visitor.rules(), &mut Everywhere, &mut found);
        let piece = |c: &Candidate| {
            let page = scene.page_at(c.place)?;
            let surface = match (page.kd_tree(c.drawable), page.drawables().get(c.drawable as usize)) {
                (Some(tree), _) => PieceSurface::Tree(tree.clone()),
                (None, Some(drawable)) => PieceSurface::Payload(drawable.geometry.clone()),
                (None, None) => return None,
            };
            Some(Piece { surface, world_from_drawable: c.world_from_drawable })
        };
        Self { vertical, of, pieces: found.iter().filter_map(piece).collect(), index: OnceLock::new() }
    }

    /// Returns true if the scene has not changed since this snapshot.
    pub fn is_of(&self, scene: &Scene) -> bool {
        self.of.is_some_and(|(.., revision)| revision == scene.revision())
    }

    /// Returns the number of drawables of the ground.
    pub fn drawable_count(&self) -> usize {
        self.pieces.len()
    }

    /// Returns the ground below a point of the world, or the lowest ground above if there is none below. `None` if there is no
    /// ground along the vertical, or the point is not finite.
    pub fn ground_at(&self, point: DVec3) -> Option<GroundPoint> {
        let (up, height_m) = self.up_and_height_m(point)?;
        let down = Ray { max_ratio: self.vertical.depth_m(height_m), ..Ray::infinite(point, -up) };
        let found = self.nearest(&down).map(|(ratio, normal)| (-ratio, normal));
        let (along, normal) = found.or_else(|| self.nearest(&Ray::infinite(point, up)))?;
        Some(self.ground(point + up * along, normal, up, -along))
    }

    /// Returns the highest ground on the vertical of a point of the world, whatever the height of the point.
    pub fn highest_ground_at(&self, point: DVec3) -> Option<GroundPoint> {
        let (up, height_m) = self.up_and_height_m(point)?;
        let all = self.index().nodes.first()?;
        // The search starts above everything.
        let rise_m = all.center.distance(point) + all.radius_m + 1.0;
        let start = point + up * rise_m;
        let depth_m = rise_m + self.vertical.depth_m(height_m);
        let (ratio, normal) = self.nearest(&Ray { max_ratio: depth_m, ..Ray::infinite(start, -up) })?;
        Some(self.ground(start - up * ratio, normal, up, ratio - rise_m))
    }

    /// Returns the height of a point of the world above the ground along the vertical, metres; negative below the ground. If
    /// there is ground above and below, the ground below counts.
    pub fn height_above_terrain_m(&self, point: DVec3) -> Option<f64> {
        self.ground_at(point).map(|ground| ground.above_m)
    }

    /// Returns the height of the highest ground on the vertical of a point, metres above the ellipsoid or the plane z = 0.
    pub fn terrain_height_m(&self, point: DVec3) -> Option<f64> {
        self.highest_ground_at(point).map(|ground| ground.height_m)
    }

    fn up_and_height_m(&self, point: DVec3) -> Option<(DVec3, f64)> {
        let (up, height_m) = point.is_finite().then(|| self.vertical.up_and_height_m(point))?;
        (up.is_finite() && height_m.is_finite()).then_some((up, height_m))
    }

    fn ground(&self, point: DVec3, normal: DVec3, up: DVec3, above_m: f64) -> GroundPoint {
        let normal = if normal.dot(up) < 0.0 { -normal } else { normal };
        GroundPoint { point, normal, height_m: self.vertical.up_and_height_m(point).1, above_m }
    }

    /// Returns the ratio and the normal in the world of the first intersection of a line.
    fn nearest(&self, whole: &Ray) -> Option<(f64, DVec3)> {
        let mut line = *whole;
        let mut nearest = None;
        self.index().visit(whole, |piece| {
            let Some(piece) = self.pieces.get(piece as usize) else { return };
            let Some(local) = line.moved_back(&piece.world_from_drawable) else { return };
            let mut normal = None;
            piece.surface().intersect_line(&local, |hit| {
                line.max_ratio = hit.ratio;
                normal = Some(hit.normal);
                hit.ratio
            });
            if let Some(normal) = normal {
                let in_world = piece.world_from_drawable.matrix3.inverse().transpose() * normal;
                nearest = Some((line.max_ratio, in_world.normalize_or_zero()));
            }
        });
        nearest
    }

    fn index(&self) -> &Index {
        self.index.get_or_init(|| Index::new(&self.pieces))
    }
}

/// A binary tree of spheres around pieces, divided at the median: node `n` has the children `2n + 1` and `2n + 2`.
#[derive(Debug)]
struct Index {
    nodes: Vec<BoundingSphere>,
    depth: u32,
    order: Vec<u32>,
}

impl Index {
    fn new(pieces: &[Piece]) -> Self {
        let spheres: Vec<BoundingSphere> = pieces.iter().map(Piece::sphere).collect();
        let first = spheres.first().map_or(DVec3::ZERO, |s| s.center);
        let mut middles: Vec<_> = spheres.iter().zip(0..).map(|(s, i)| ((s.center - first).as_vec3(), i)).collect();
        let depth = pieces.len().max(1).next_power_of_two().trailing_zeros();
        divide(&mut middles, depth);
        let order: Vec<u32> = middles.into_iter().map(|(_, i)| i).collect();
        let leaves = 1usize << depth;
        let mut nodes = vec![BoundingSphere::EMPTY; 2 * leaves - 1];
        for leaf in 0..leaves {
            let own = order.get(places(order.len(), depth, leaf)).unwrap_or_default();
            let own = own.iter().filter_map(|i| spheres.get(*i as usize));
            nodes[leaves - 1 + leaf] = own.fold(BoundingSphere::EMPTY, |all, s| all.union(s));
        }
        for node in (0..leaves - 1).rev() {
            nodes[node] = nodes[2 * node + 1].union(&nodes[2 * node + 2]);
        }
        Self { nodes, depth, order }
    }

    fn visit(&self, line: &Ray, mut visit: impl FnMut(u32)) {
        let leaves = 1usize << self.depth;
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            let Some(sphere) = self.nodes.get(node).filter(|s| !s.is_empty()) else { continue };
            // The margin covers the rounding of centres at planetary coordinates.
            if line.enters_sphere(sphere.center, sphere.radius_m * (1.0 + 1e-9) + 1e-6).is_none() {
                continue;
            }
            if node >= leaves - 1 {
                let own = places(self.order.len(), self.depth, node - (leaves - 1));
                self.order.get(own).unwrap_or_default().iter().for_each(|piece| visit(*piece));
            } else {
                open.extend([2 * node + 2, 2 * node + 1]);
            }
        }
    }
}

/// Returns the range of a leaf's pieces in the order.
fn places(count: usize, depth: u32, leaf: usize) -> std::ops::Range<usize> {
    (count * leaf) >> depth..(count * (leaf + 1)) >> depth
}
