//! [`OutTile`]: a tile of the output with its bounds, its geometric error and its JSON. Any thread.

use glam::{DAffine3, DMat3, DMat4};
use serde_json::{Value, json};

use super::items::Refinement;
use crate::math::{Aabb, BoundingSphere, BoundingVolume, OrientedBox, Region, max_scale};
use crate::scene::Refine;

/// The share of a distance by which a tile is refined outside of its sphere, if the distance ends inside of the sphere.
const MIN_OUTSIDE: f64 = 0.05;
/// A root without content is refined until the set appears smaller than this share of the allowed error.
const ROOT_DIAMETERS: f64 = 16.0;

/// The viewer that distances become errors for.
#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorScale {
    pub max_sse_px: f64,
    pub px_per_radian: f64,
}

impl ErrorScale {
    /// Returns the geometric error of a tile that is refined if the eye is nearer to the centre of its sphere than a distance.
    ///
    /// A viewer refines if `error * px_per_radian / d > max_sse_px`, where `d` is the distance to the volume (3D Tiles 1.1,
    /// "Geometric error"). From outside, `d` is the distance to the centre less the radius; so
    /// `error = max_sse_px / px_per_radian * (distance - radius)`.
    pub fn error_m(&self, distance_m: f64, radius_m: f64) -> f64 {
        let outside_m = (distance_m - radius_m).max(MIN_OUTSIDE * distance_m);
        self.max_sse_px / self.px_per_radian * outside_m
    }
}

/// A tile whose children are not complete yet.
#[derive(Debug)]
pub(super) struct Draft {
    pub name: String,
    /// Maps the tile, and its content, to the frame of the set.
    pub set_from_tile: DAffine3,
    /// The declared volume in the frame of the tile.
    pub declared: Option<BoundingVolume>,
    pub request_volume: Option<BoundingVolume>,
    /// The box around the content in the frame of the tile.
    pub content_box: Aabb,
    /// The name of the content's file.
    pub content: Option<String>,
    pub refine: Refine,
    /// When it is refined, metres of the tile's frame.
    pub refinement: Refinement,
}

/// A tile of the output.
#[derive(Debug)]
pub(super) struct OutTile {
    pub name: String,
    set_from_tile: DAffine3,
    /// In the frame of the tile; a region in that of the set.
    bounds: BoundingVolume,
    /// The box around the contents of this tile and of all below it, in the frame of the tile.
    hull: Aabb,
    request_volume: Option<BoundingVolume>,
    /// Metres of the set's frame.
    error_m: f64,
    refine: Refine,
    content: Option<String>,
    children: Vec<OutTile>,
    /// The number of tiles, this one and those below it in the same file.
    pub count: usize,
}

impl Draft {
    /// Returns the tile with its children; `None` if nothing is left of it.
    pub fn finish(self, children: Vec<OutTile>, errors: &ErrorScale) -> Option<OutTile> {
        let scale = max_scale(&self.set_from_tile.matrix3);
        let tile_from_set = self.set_from_tile.inverse();
        let hulls =
            children.iter().map(|child| child.hull.transformed(&child.in_frame(&tile_from_set, self.set_from_tile)));
        let hull = hulls.fold(self.content_box, |all, one| all.union(&one));
        if hull.is_empty() {
            return None;
        }
        let below_m = children.iter().map(|child| child.error_m).fold(0.0, f64::max);
        let (bounds, error_m) = match self.refinement {
            Refinement::Nearer { center, distance_m } => {
                // Spheres around spheres would grow with each level.
                let radius_m = hull.corners().iter().map(|corner| corner.distance(center)).fold(0.0, f64::max);
                let sphere = BoundingSphere::new(center, radius_m);
                // Errors do not grow downwards, so a tile is refined no later than those below it.
                let own_m = scale * errors.error_m(distance_m, sphere.radius_m);
                (BoundingVolume::Sphere(sphere), own_m.max(below_m))
            }
            Refinement::Error { error_m } => (self.volume(&hull, &children), scale * error_m),
            Refinement::Always => {
                let bounds = self.volume(&hull, &children);
                let always_m = if children.is_empty() { 0.0 } else { scale * diameter_m(&bounds) };
                (bounds, always_m.max(2.0 * below_m))
            }
        };
        let count = 1 + children.iter().map(|child| child.count).sum::<usize>();
        let Self { name, set_from_tile, request_volume, refine, content, .. } = self;
        Some(OutTile { name, set_from_tile, bounds, hull, request_volume, error_m, refine, content, children, count })
    }

    /// Returns the declared volume, or one around the contents.
    fn volume(&self, hull: &Aabb, children: &[OutTile]) -> BoundingVolume {
        if let Some(declared) = self.declared {
            return declared;
        }
        let regions: Vec<Region> = children.iter().filter_map(OutTile::region).collect();
        if self.content_box.is_empty()
            && regions.len() == children.len()
            && let Some(region) = united(&regions)
        {
            return BoundingVolume::Region(region);
        }
        let half_axes = DMat3::from_diagonal(hull.half_size());
        BoundingVolume::Box(OrientedBox { center: hull.center(), half_axes })
    }
}

impl OutTile {
    /// Returns one tile above several, which is refined from almost everywhere.
    pub fn group(mut tiles: Vec<OutTile>, errors: &ErrorScale) -> Option<OutTile> {
        if tiles.len() == 1 {
            return tiles.pop();
        }
        let draft = Draft {
            name: "0".to_owned(),
            set_from_tile: DAffine3::IDENTITY,
            declared: None,
            request_volume: None,
            content_box: Aabb::EMPTY,
            content: None,
            refine: Refine::Replace,
            refinement: Refinement::Error { error_m: 0.0 },
        };
        let mut root = draft.finish(tiles, errors)?;
        root.error_m = root.distant_error_m();
        Some(root)
    }

    /// Returns an error by which the tile is refined from almost everywhere.
    fn distant_error_m(&self) -> f64 {
        let scale = max_scale(&self.set_from_tile.matrix3);
        (ROOT_DIAMETERS * scale * diameter_m(&self.bounds)).max(self.error_m)
    }

    fn region(&self) -> Option<Region> {
        match self.bounds {
            BoundingVolume::Region(region) => Some(region),
            _ => None,
        }
    }

    /// Returns the map from the frame of the tile to another one.
    fn in_frame(&self, frame_from_set: &DAffine3, set_from_frame: DAffine3) -> DAffine3 {
        if self.set_from_tile == set_from_frame { DAffine3::IDENTITY } else { *frame_from_set * self.set_from_tile }
    }

    /// Returns a tile that refers to a file with this one.
    pub fn reference(&self, file: &str) -> Self {
        Self { name: self.name.clone(), content: Some(file.to_owned()), children: Vec::new(), count: 1, ..*self }
    }

    /// Returns the tileset whose root is this tile. `set_from_parent` is the frame of the tile that refers to it, and `folder`
    /// the one of its file.
    pub fn tileset(&self, is_whole: bool, folder: &str) -> Value {
        let set_from_parent = if is_whole { DAffine3::IDENTITY } else { self.set_from_tile };
        let error_m = if is_whole { self.distant_error_m() } else { self.error_m };
        json!({
            "asset": { "version": "1.1", "generator": "terrane" },
            "geometricError": error_m / max_scale(&set_from_parent.matrix3),
            "root": self.json(&set_from_parent, folder, is_whole),
        })
    }

    fn json(&self, set_from_parent: &DAffine3, folder: &str, is_whole: bool) -> Value {
        let refine = |refine| if refine == Refine::Add { "ADD" } else { "REPLACE" };
        let mut json = json!({
            "boundingVolume": volume_json(&self.bounds),
            "geometricError": self.error_m / max_scale(&self.set_from_tile.matrix3),
            "refine": refine(self.refine),
        });
        if self.set_from_tile != *set_from_parent {
            let parent_from_tile = if is_whole || *set_from_parent == DAffine3::IDENTITY {
                self.set_from_tile
            } else {
                set_from_parent.inverse() * self.set_from_tile
            };
            json["transform"] = json!(DMat4::from(parent_from_tile).to_cols_array());
        }
        if let Some(volume) = &self.request_volume {
            json["viewerRequestVolume"] = volume_json(volume);
        }
        if let Some(content) = &self.content {
            let uri = content.strip_prefix(folder).unwrap_or(content);
            json["content"] = json!({ "uri": uri });
        }
        if !self.children.is_empty() {
            let children = self.children.iter().map(|child| child.json(&self.set_from_tile, folder, false));
            json["children"] = children.collect();
        }
        json
    }
}

fn diameter_m(bounds: &BoundingVolume) -> f64 {
    2.0 * bounds.bounding_sphere().radius_m
}

fn volume_json(volume: &BoundingVolume) -> Value {
    match volume {
        BoundingVolume::Sphere(BoundingSphere { center, radius_m }) => {
            json!({ "sphere": [center.x, center.y, center.z, radius_m] })
        }
        BoundingVolume::Box(OrientedBox { center, half_axes }) => {
            let mut numbers = center.to_array().to_vec();
            numbers.extend(half_axes.to_cols_array());
            json!({ "box": numbers })
        }
        BoundingVolume::Region(r) => {
            json!({ "region": [r.west, r.south, r.east, r.north, r.min_height_m, r.max_height_m] })
        }
    }
}

/// Returns the region around all; `None` if there is none, or if one crosses the antimeridian.
fn united(regions: &[Region]) -> Option<Region> {
    let (first, rest) = regions.split_first()?;
    if regions.iter().any(|region| region.east < region.west) {
        return None;
    }
    Some(rest.iter().fold(*first, |all, one| Region {
        west: all.west.min(one.west),
        south: all.south.min(one.south),
        east: all.east.max(one.east),
        north: all.north.max(one.north),
        min_height_m: all.min_height_m.min(one.min_height_m),
        max_height_m: all.max_height_m.max(one.max_height_m),
        ellipsoid: all.ellipsoid,
    }))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    const ERRORS: ErrorScale = ErrorScale { max_sse_px: 16.0, px_per_radian: 1000.0 };

    fn draft(name: &str, half_m: f64, refinement: Refinement) -> Draft {
        Draft {
            name: name.to_owned(),
            set_from_tile: DAffine3::IDENTITY,
            declared: None,
            request_volume: None,
            content_box: Aabb { min: DVec3::splat(-half_m), max: DVec3::splat(half_m) },
            content: Some(format!("{name}.glb")),
            refine: Refine::Replace,
            refinement,
        }
    }

    fn leaf(name: &str, half_m: f64) -> OutTile {
        draft(name, half_m, Refinement::Error { error_m: 0.0 }).finish(Vec::new(), &ERRORS).unwrap()
    }

    /// The error in pixels at the distance is the allowed one.
    #[test]
    fn tiles_are_refined_at_the_distance() {
        let refinement = Refinement::Nearer { center: DVec3::ZERO, distance_m: 100.0 };
        let tile = draft("0", 1.0, refinement).finish(vec![leaf("0/0", 2.0)], &ERRORS).unwrap();
        let BoundingVolume::Sphere(sphere) = tile.bounds else { panic!("{:?}", tile.bounds) };
        assert!((sphere.radius_m - 12f64.sqrt()).abs() < 1e-12, "it holds the larger child, and no more");
        let sse_px = |distance_m: f64| tile.error_m * ERRORS.px_per_radian / (distance_m - sphere.radius_m);
        assert!((sse_px(100.0) - 16.0).abs() < 1e-9 && sse_px(99.0) > 16.0 && sse_px(101.0) < 16.0);
        assert_eq!(tile.count, 2);
        // The distance ends inside of the sphere.
        assert!(ERRORS.error_m(3.0, 10.0) > 0.0);
    }

    #[test]
    fn json_has_relative_transforms_and_names() {
        let mut child = draft("0/3/1", 1.0, Refinement::Error { error_m: 0.0 });
        child.set_from_tile =
            DAffine3::from_translation(DVec3::new(0.0, 0.0, 7.0)) * DAffine3::from_scale(DVec3::splat(2.0));
        let child = child.finish(Vec::new(), &ERRORS).unwrap();
        let mut tile = draft("0/3", 1.0, Refinement::Error { error_m: 4.0 });
        tile.set_from_tile = DAffine3::from_scale(DVec3::splat(2.0));
        let tile = tile.finish(vec![child], &ERRORS).unwrap();
        let whole = tile.tileset(true, "");
        assert_eq!(whole["root"]["content"]["uri"], "0/3.glb");
        assert_eq!((&whole["root"]["geometricError"], &whole["root"]["transform"][0]), (&json!(4.0), &json!(2.0)));
        assert_eq!(whole["root"]["children"][0]["transform"][14], 3.5);
        let part = tile.tileset(false, "0/");
        assert_eq!(part["root"]["children"][0]["content"]["uri"], "3/1.glb");
        assert!(part["root"].get("transform").is_none());
        let reference = tile.reference("0/3.json").tileset(true, "");
        assert_eq!(
            (&reference["root"]["content"]["uri"], reference["root"].get("children")),
            (&json!("0/3.json"), None)
        );
    }

    #[test]
    fn several_roots_get_one_above_them() {
        let root = OutTile::group(vec![leaf("0/0", 1.0), leaf("0/1", 2.0)], &ERRORS).unwrap();
        assert!(root.error_m > 100.0 && root.content.is_none() && root.count == 3);
        assert!(OutTile::group(Vec::new(), &ERRORS).is_none());
        assert_eq!(OutTile::group(vec![leaf("0/0", 1.0)], &ERRORS).unwrap().name, "0/0");
    }
}
