//! [`SetBounds`]: position and size of a tile set, and what follows from them: the local frame, the first camera, the default
//! path, the density of the haze. Computed once when a root is loaded, on the main thread.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use crate::formats;
use crate::math::{BoundingSphere, BoundingVolume, Ellipsoid, OrientedBox, Region, WGS84};
use crate::scene::{DistanceFog, Environment, Page};
use crate::viewer::camera::{Camera, world_from_eye};
use crate::viewer::camera_path::{AnimationPath, ControlPoint};

/// A set counts as body-centred when the centre of its bounding sphere is farther than this from the origin, equatorial radii:
/// 1,000 km on the earth.
const GEOREFERENCED_BEYOND: f64 = 1.0e6 / 6_378_137.0;

/// A set around the origin is a globe if the radius of its bounding sphere is in this range, equatorial radii: from 6,300 km to
/// 20,000 km on the earth.
const GLOBE_RADII: [f64; 2] = [6.3e6 / 6_378_137.0, 2.0e7 / 6_378_137.0];

/// The longest side of terrain that counts as a part of its body, radians: larger terrain is looked at as a globe.
const MAX_PART_RADIANS: f64 = 1.0;

/// The axes east (x), north (y) and up (z) at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    /// A rotation and a translation to the point.
    pub world_from_local: DAffine3,
    /// The ellipsoid of the world, if it is body-centred and turns with the body, as ECEF does; `None` for a local one.
    pub ellipsoid: Option<Ellipsoid>,
}

impl LocalFrame {
    /// Returns the frame at a point: east, north and up on the ellipsoid, or the axes of the world.
    pub fn at(point: DVec3, ellipsoid: Option<Ellipsoid>) -> Self {
        let matrix3 = match ellipsoid {
            Some(ellipsoid) if point.length() > 1.0 => ellipsoid.ecef_from_enu(&ellipsoid.geodetic(point)).matrix3,
            _ => DMat3::IDENTITY,
        };
        Self { world_from_local: DAffine3 { matrix3, translation: point }, ellipsoid }
    }

    /// Returns true if the world is body-centred.
    pub fn is_georeferenced(&self) -> bool {
        self.ellipsoid.is_some()
    }

    /// Returns the unit up vector in the world.
    pub fn up(&self) -> DVec3 {
        self.world_from_local.matrix3.z_axis
    }

    /// Returns a unit direction in the world. `heading` is in radians clockwise from north, `pitch` in radians above the
    /// horizon.
    pub fn direction(&self, heading: f64, pitch: f64) -> DVec3 {
        let (sin_h, cos_h) = heading.sin_cos();
        let (sin_p, cos_p) = pitch.sin_cos();
        self.world_from_local.matrix3 * DVec3::new(sin_h * cos_p, cos_h * cos_p, sin_p)
    }
}

/// The extent of a tile set in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetBounds {
    /// The bounding sphere.
    pub sphere: BoundingSphere,
    /// The volume that the root declares, if any.
    pub volume: Option<BoundingVolume>,
    /// The frame at the sphere's centre.
    pub frame: LocalFrame,
    /// Half the extent east, north and up in the local frame, in metres.
    pub half_size_m: DVec3,
    /// The middle of that box in the local frame; the box of the volume need not be centred on the sphere.
    pub middle_m: DVec3,
    /// The ellipsoid of the set's body; unused for sets in a local frame.
    pub ellipsoid: Ellipsoid,
}

/// A pose relative to a set, from which its centre is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFrom {
    /// The direction of view, in radians clockwise from north.
    pub heading: f64,
    /// Radians above the horizon; negative values look down.
    pub pitch: f64,
    /// The distance to the centre in metres; `None` is 2.2 radii of the bounding sphere.
    pub range_m: Option<f64>,
}

impl Default for ViewFrom {
    fn default() -> Self {
        Self { heading: 0.0, pitch: -35f64.to_radians(), range_m: None }
    }
}

impl SetBounds {
    /// Creates bounds from a sphere alone.
    pub fn from_sphere(sphere: BoundingSphere) -> Self {
        Self::new(sphere, None)
    }

    /// Creates bounds from a sphere and the volume that the root declares, of a set on WGS84 or on the ellipsoid of that region.
    pub fn new(sphere: BoundingSphere, volume: Option<BoundingVolume>) -> Self {
        let ellipsoid = match volume {
            Some(BoundingVolume::Region(region)) => region.ellipsoid,
            _ => WGS84,
        };
        Self::on(ellipsoid, sphere, volume)
    }

    /// Creates bounds of a set on an ellipsoid.
    pub fn on(ellipsoid: Ellipsoid, sphere: BoundingSphere, volume: Option<BoundingVolume>) -> Self {
        let usable = sphere.center.is_finite() && sphere.radius_m.is_finite() && sphere.radius_m > 0.0;
        let sphere = if usable { sphere } else { BoundingSphere::new(DVec3::ZERO, 1.0) };
        let frame = match is_globe(&ellipsoid, &sphere) {
            // There is no up at the middle of the body: the axes are those of the world.
            true => LocalFrame { ellipsoid: Some(ellipsoid), ..LocalFrame::at(sphere.center, None) },
            false => LocalFrame::at(sphere.center, Some(ellipsoid).filter(|_| is_far(&ellipsoid, &sphere))),
        };
        let local_from_world = frame.world_from_local.inverse();
        let local_box = volume.and_then(|v| v.oriented_box()).map(|b| b.transformed(&local_from_world).aabb());
        let (middle_m, half_size_m) = match local_box {
            Some(b) if b.center().is_finite() && b.half_size().is_finite() => (b.center(), b.half_size()),
            _ => (DVec3::ZERO, DVec3::splat(sphere.radius_m / 3f64.sqrt())),
        };
        Self { sphere, volume, frame, half_size_m, middle_m, ellipsoid }
    }

    /// Returns an ellipsoid below the set's lowest ground, which hides what lies behind the horizon; `None` for a set that is
    /// not on one.
    pub fn horizon_ellipsoid(&self) -> Option<Ellipsoid> {
        self.horizon_below(self.lowest_ground_m())
    }

    /// Does the same as [`Self::horizon_ellipsoid`] for a given lowest ground in metres above the ellipsoid.
    pub(in crate::viewer) fn horizon_below(&self, lowest_m: f64) -> Option<Ellipsoid> {
        let ellipsoid = self.frame.ellipsoid?;
        let [lowest, _] = ellipsoid.ground_m();
        let shrunk = |radius_m: f64| radius_m + lowest_m.max(lowest);
        Some(Ellipsoid { semi_major_m: shrunk(ellipsoid.semi_major_m), semi_minor_m: shrunk(ellipsoid.semi_minor_m) })
    }

    /// Returns a lower bound of the ground's height in metres above the ellipsoid; at most 0.
    pub(in crate::viewer) fn lowest_ground_m(&self) -> f64 {
        match self.volume {
            Some(BoundingVolume::Region(region)) => region.min_height_m.min(0.0),
            _ => self.ellipsoid.ground_m()[0],
        }
    }

    /// Returns the height of a point in metres above the top of the bounds; negative below it.
    pub fn height_above_top_m(&self, point: DVec3) -> f64 {
        if let (Some(BoundingVolume::Region(region)), Some(ellipsoid)) = (self.volume, self.frame.ellipsoid) {
            return ellipsoid.geodetic(point).height_m - region.max_height_m;
        }
        let local = self.frame.world_from_local.inverse().transform_point3(point);
        local.z - (self.middle_m.z + self.half_size_m.z)
    }

    /// Returns the pose of an eye that looks at the centre of the sphere.
    pub fn first_camera(&self, view: &ViewFrom) -> DAffine3 {
        let range_m = view.range_m.unwrap_or(2.2 * self.sphere.radius_m);
        let direction = self.frame.direction(view.heading, view.pitch);
        world_from_eye(self.sphere.center - direction * range_m, direction, self.frame.up())
    }

    /// Returns the closest pose that shows all of the bounds, from the south and 35 degrees above the horizon.
    pub fn home_camera(&self, camera: &Camera, size_px: [u32; 2]) -> DAffine3 {
        let tan_y = (0.5 * camera.fovy(size_px)).tan();
        let tan_x = tan_y * camera.aspect(size_px);
        let view = ViewFrom::default();
        let direction = self.frame.direction(view.heading, view.pitch);
        let (target, range_m) = if self.volume.is_none() {
            (self.sphere.center, self.sphere.radius_m / tan_x.min(tan_y).atan().sin())
        } else {
            let pose = world_from_eye(DVec3::ZERO, direction, self.frame.up());
            let eye_from_local = pose.matrix3.transpose() * self.frame.world_from_local.matrix3;
            let corner = |i: u32| {
                let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
                let at = eye_from_local * (self.half_size_m * DVec3::new(sign(0), sign(1), sign(2)));
                at.z + (at.x.abs() / tan_x).max(at.y.abs() / tan_y)
            };
            let middle = self.frame.world_from_local.transform_point3(self.middle_m);
            (middle, (0..8).map(corner).fold(0.0, f64::max))
        };
        world_from_eye(target - direction * (1.02 * range_m).max(1e-3), direction, self.frame.up())
    }

    /// Returns a path of thirty seconds that starts at a given pose, approaches from the south, flies low over the
    /// middle, climbs and orbits the set once.
    pub fn default_path(&self, first: &DAffine3) -> AnimationPath {
        let half = self.half_size_m.truncate().min_element().max(1e-6);
        let top = self.middle_m.z + self.half_size_m.z;
        // Low, but above the top of the bounds, whose height includes the curvature of the earth.
        let low = top + 0.04 * half;
        let at = |x: f64, y: f64, z: f64| DVec3::new(self.middle_m.x + half * x, self.middle_m.y + half * y, z);
        let mut points = vec![ControlPoint::from_pose(0.0, first)];
        let mut add = |time_s: f64, eye: DVec3, target: DVec3| {
            let pose = self.frame.world_from_local * world_from_eye(eye, target - eye, DVec3::Z);
            points.push(ControlPoint::from_pose(time_s, &pose));
        };
        add(5.0, at(0.0, -1.0, low + 0.5 * half), at(0.0, 0.1, top - 0.2 * half));
        add(8.0, at(0.0, -0.6, low + 0.06 * half), at(0.0, 0.3, top - 0.1 * half));
        for step in 0..=6 {
            let y = -0.5 + 0.9 * f64::from(step) / 6.0;
            add(9.0 + f64::from(step), at(0.02 * f64::from(step), y, low), at(0.0, y + 0.9, top - 0.15 * half));
        }
        let turns = 24;
        for step in 0..=turns {
            let angle = std::f64::consts::TAU * f64::from(step) / f64::from(turns) + std::f64::consts::FRAC_PI_2;
            let rise = (f64::from(step) / 8.0).min(1.0);
            let eye = at(0.9 * angle.cos(), 0.9 * angle.sin(), low + half * (0.25 + 0.45 * rise));
            add(18.0 + 0.5 * f64::from(step), eye, at(0.0, 0.0, self.middle_m.z));
        }
        AnimationPath::new(points).expect("the path has at least one point")
    }

    /// Returns a fog density per metre that leaves the whole set visible from the first camera: an optical depth of 0.35 at
    /// that distance. It is at most that of clear air.
    pub fn fog_density_per_m(&self) -> f64 {
        (0.35 / (2.2 * self.sphere.radius_m)).min(DistanceFog::CLEAR_AIR_PER_M.into())
    }

    /// Returns the direction towards the sun in the world: south-east, 40 degrees above the horizon.
    pub fn sun_direction(&self) -> DVec3 {
        self.frame.direction(135f64.to_radians(), 40f64.to_radians())
    }

    /// Returns the direction towards the sun for a first view: on a whole globe it shines over the left shoulder, so that
    /// the side in sight has day and its relief is lit from the side.
    pub(in crate::viewer) fn sun_behind(&self, world_from_eye: &DAffine3) -> DVec3 {
        match is_globe(&self.ellipsoid, &self.sphere) {
            true => (world_from_eye.matrix3 * DVec3::new(-0.4, 0.15, 1.0)).normalize(),
            false => self.sun_direction(),
        }
    }
}

/// The night light of a whole globe, whose user wants to recognise land on all sides.
const NIGHT_LIGHT_OF_GLOBE: f32 = 0.4;

/// Returns an environment whose sun, sky and haze fit a set. On a whole globe the nights are light.
pub fn environment_for(bounds: &SetBounds) -> Environment {
    let base = Environment::on(bounds.ellipsoid);
    Environment {
        sun_direction: bounds.sun_direction(),
        up_in_world: bounds.frame.up(),
        night_light: if is_globe(&bounds.ellipsoid, &bounds.sphere) { NIGHT_LIGHT_OF_GLOBE } else { base.night_light },
        fog: DistanceFog { density_per_m: bounds.fog_density_per_m() as f32, ..base.fog },
        ..base
    }
}

/// Returns true for the sphere around a set that covers its body.
pub(in crate::viewer) fn is_globe(ellipsoid: &Ellipsoid, sphere: &BoundingSphere) -> bool {
    let [least_m, most_m] = GLOBE_RADII.map(|radii| radii * ellipsoid.semi_major_m);
    !is_far(ellipsoid, sphere) && (least_m..=most_m).contains(&sphere.radius_m)
}

/// Returns true for a sphere that is not around the middle of the body.
fn is_far(ellipsoid: &Ellipsoid, sphere: &BoundingSphere) -> bool {
    sphere.center.length() > GEOREFERENCED_BEYOND * ellipsoid.semi_major_m
}

/// Returns the volume of all ground of a body between two heights, metres.
pub(in crate::viewer) fn whole_body(ellipsoid: Ellipsoid, [min_height_m, max_height_m]: [f64; 2]) -> BoundingVolume {
    let half_turn = std::f64::consts::PI;
    let (west, east) = (-half_turn, half_turn);
    let (south, north) = (-0.5 * half_turn, 0.5 * half_turn);
    BoundingVolume::Region(Region { west, south, east, north, min_height_m, max_height_m, ellipsoid })
}

/// Returns the volume that a viewer of terrain on a globe wants to see, where its layer.json declares a part of the body.
/// Its heights are not known before tiles are loaded: a twentieth of the extent stands for them.
pub(in crate::viewer) fn part_of_globe(page: &Page) -> Option<BoundingVolume> {
    let ellipsoid = page.ellipsoid();
    let extent = formats::terrain_extent(page).filter(|_| is_globe(&ellipsoid, &page.bounding_sphere()))?;
    part_of_body(ellipsoid, extent).map(BoundingVolume::Region)
}

fn part_of_body(ellipsoid: Ellipsoid, [west, south, east, north]: [f64; 4]) -> Option<Region> {
    let width = (east - west).rem_euclid(std::f64::consts::TAU);
    let height = north - south;
    let is_part = width > 0.0 && height > 0.0 && width.max(height) <= MAX_PART_RADIANS;
    let diagonal_m = ellipsoid.semi_major_m * (width * (0.5 * (south + north)).cos()).hypot(height);
    let max_height_m = (0.05 * diagonal_m).min(ellipsoid.ground_m()[1]);
    is_part.then_some(Region { west, south, east, north, min_height_m: 0.0, max_height_m, ellipsoid })
}

/// Returns the volume that a page's root tile declares.
pub(in crate::viewer) fn root_volume(page: &Page) -> Option<BoundingVolume> {
    let root = page.tiles().roots().first()?;
    let bounds = page.tiles().bounds().get(root.tile as usize)?;
    let page_from_tile = page.transforms().page_from_node(root.transform);
    let center = page.tiles().grid().center(bounds);
    Some(if bounds.is_sphere() {
        BoundingVolume::Sphere(BoundingSphere::new(center, bounds.radius_m().into()).transformed(&page_from_tile))
    } else {
        let [x, y, z] = page.tiles().axes_of(bounds).map(|axis| Vec3::from_array(axis).as_dvec3());
        let half = Vec3::from_array(bounds.half_m()).as_dvec3();
        let half_axes = DMat3::from_cols(x * half.x, y * half.y, z * half.z);
        BoundingVolume::Box(OrientedBox { center, half_axes }.transformed(&page_from_tile))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alps() -> SetBounds {
        let region = Region {
            west: 0.139,
            south: 0.81,
            east: 0.141,
            north: 0.812,
            min_height_m: 300.0,
            max_height_m: 4000.0,
            ellipsoid: WGS84,
        };
        let volume = BoundingVolume::Region(region);
        SetBounds::new(volume.bounding_sphere(), Some(volume))
    }

    #[test]
    fn first_camera_looks_north_and_down_at_the_centre() {
        for bounds in [alps(), SetBounds::from_sphere(BoundingSphere::new(DVec3::new(5.0, 6.0, 7.0), 10.0))] {
            let pose = bounds.first_camera(&ViewFrom::default());
            let local = bounds.frame.world_from_local.inverse().transform_point3(pose.translation);
            let range = 2.2 * bounds.sphere.radius_m;
            let (sin, cos) = 35f64.to_radians().sin_cos();
            assert!(local.distance(DVec3::new(0.0, -range * cos, range * sin)) < 1e-6 * range);
            assert!(pose.matrix3.y_axis.dot(bounds.frame.up()) > 0.8);
        }
    }

    #[test]
    fn default_path_stays_above_the_bounds() {
        let bounds = alps();
        let path = bounds.default_path(&bounds.first_camera(&ViewFrom::default()));
        for step in 0..=300 {
            let pose = path.world_from_eye(0.1 * f64::from(step));
            assert!(bounds.height_above_top_m(pose.translation) > 0.0, "at {step}");
            assert!((pose.matrix3.determinant() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn air_of_no_set_is_hazier_than_clear_air() {
        for radius_m in [1.0, 3_000.0, 50_000.0, 6.4e6] {
            let bounds = SetBounds::from_sphere(BoundingSphere::new(DVec3::ZERO, radius_m));
            let extinction = DistanceFog::AIR_PER_M + f64::from(environment_for(&bounds).fog.density_per_m);
            assert!(3.912 / extinction > 99_900.0, "{radius_m} m: {extinction} per metre");
        }
    }

    #[test]
    fn first_view_of_a_globe_looks_at_its_day() {
        let globe = SetBounds::from_sphere(BoundingSphere::new(DVec3::ZERO, 6.4e6));
        for heading in [0.0, 1.0, 3.0, 5.0] {
            let pose = globe.first_camera(&ViewFrom { heading, ..ViewFrom::default() });
            let (sun, eye) = (globe.sun_behind(&pose), pose.translation.normalize());
            assert!(sun.is_normalized() && sun.dot(eye) > 0.8, "{heading}: {}", sun.dot(eye));
        }
        assert_eq!(environment_for(&globe).night_light, NIGHT_LIGHT_OF_GLOBE);
        // The light of terrain does not depend on where it is seen from.
        let alps = alps();
        assert_eq!(alps.sun_behind(&alps.first_camera(&ViewFrom::default())), alps.sun_direction());
        assert_eq!(environment_for(&alps).night_light, Environment::NIGHT_LIGHT);
    }

    #[test]
    fn globe_is_earth_centred() {
        let globe = SetBounds::from_sphere(BoundingSphere::new(DVec3::new(3e3, 0.0, -9e3), 9e6));
        assert!(globe.frame.is_georeferenced() && globe.horizon_ellipsoid().is_some());
        assert_eq!(globe.frame.up(), DVec3::Z);
        let pose = globe.first_camera(&ViewFrom::default());
        assert!(pose.translation.length() > 1.9e7 && pose.matrix3.z_axis.dot(pose.translation) > 0.0);
        assert!(!SetBounds::from_sphere(BoundingSphere::new(DVec3::ZERO, 6.2e6)).frame.is_georeferenced());
    }

    #[test]
    fn part_of_the_earth_is_looked_at_and_a_globe_is_not() {
        // Half a degree at 47 degrees north, 67 km across.
        let part = part_of_body(WGS84, [8f64, 47.0, 8.5, 47.5].map(f64::to_radians)).unwrap();
        assert!((3.3e3..3.4e3).contains(&part.max_height_m) && part.min_height_m == 0.0, "{part:?}");
        let bounds = SetBounds::new(BoundingVolume::Region(part).bounding_sphere(), Some(BoundingVolume::Region(part)));
        let eye = WGS84.geodetic(bounds.first_camera(&ViewFrom::default()).translation);
        assert!((eye.longitude.to_degrees() - 8.25).abs() < 0.01 && (2e4..8e4).contains(&eye.height_m), "{eye:?}");
        // Across the antimeridian.
        assert!(part_of_body(WGS84, [3.1, -0.2, -3.1, 0.2]).is_some());
        let half_turn = std::f64::consts::PI;
        for globe in [[-half_turn, -0.5 * half_turn, half_turn, 0.5 * half_turn], [0.0, -0.7, 0.5, 0.7], [0.1; 4]] {
            assert!(part_of_body(WGS84, globe).is_none(), "{globe:?}");
        }
    }

    #[test]
    fn invalid_bounds_still_give_a_finite_camera() {
        for sphere in [BoundingSphere::EMPTY, BoundingSphere::new(DVec3::NAN, 1.0)] {
            let bounds = SetBounds::from_sphere(sphere);
            assert!(bounds.first_camera(&ViewFrom::default()).is_finite());
        }
    }
}
