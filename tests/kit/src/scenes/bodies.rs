//! Tile sets on other bodies than the earth: level squares at places of an ellipsoid.

use std::path::Path;

use glam::DMat4;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::math::{Ellipsoid, Geodetic};

/// A square that is level at its middle, in the plane that touches the ellipsoid's normal there.
#[derive(Clone, Copy, Debug)]
pub struct Square {
    /// The body.
    pub ellipsoid: Ellipsoid,
    /// The place and height of the middle.
    pub middle: Geodetic,
    /// Half of its side.
    pub half_m: f64,
}

impl Square {
    /// Returns a region around the square: west, south, east, north, lowest and highest height. Its heights are those of the middle
    /// and a tenth of the side more and less.
    pub fn region(&self) -> [f64; 6] {
        let Self { ellipsoid, middle: Geodetic { longitude, latitude, height_m }, half_m } = *self;
        let radius_m = ellipsoid.semi_major_m.min(ellipsoid.semi_minor_m);
        let (x, y) = (1.1 * half_m / (radius_m * latitude.cos()), 1.1 * half_m / radius_m);
        let room_m = 0.2 * half_m;
        [longitude - x, latitude - y, longitude + x, latitude + y, height_m - room_m, height_m + room_m]
    }

    /// Writes the content as `NAME.glb`, and returns the JSON of its tile.
    pub fn tile(&self, folder: &Path, name: &str) -> String {
        // Content has y up.
        let half = self.half_m as f32;
        let positions = vec![[-half, 0.0, half], [half, 0.0, half], [half, 0.0, -half], [-half, 0.0, -half]];
        let square = GlbMesh { positions, indices: vec![0, 1, 2, 0, 2, 3], base_color: [1.0; 4], ..GlbMesh::default() };
        std::fs::write(folder.join(format!("{name}.glb")), write_glb(&square)).unwrap();
        let transform = DMat4::from(self.ellipsoid.ecef_from_enu(&self.middle)).to_cols_array();
        format!(
            r#"{{"boundingVolume":{{"region":{:?}}},"geometricError":0,"transform":{transform:?},
            "content":{{"uri":"{name}.glb"}}}}"#,
            self.region()
        )
    }
}

/// Writes a tileset of a body. `body` is the value of 3DTILES_ellipsoid; none if it is empty. The root adds the tiles `children`, all of
/// which are in `region`.
pub fn write_set(file: &Path, body: &str, region: [f64; 6], children: &[String]) {
    let extension = match body {
        "" => String::new(),
        body => format!(r#""extensionsUsed":["3DTILES_ellipsoid"],"extensions":{{"3DTILES_ellipsoid":{body}}},"#),
    };
    let json = format!(
        r#"{{"asset":{{"version":"1.1"}},{extension}"geometricError":1e7,"root":{{"refine":"ADD","geometricError":1e6,
        "boundingVolume":{{"region":{region:?}}},"children":[{}]}}}}"#,
        children.join(",")
    );
    std::fs::write(file, json).unwrap();
}

/// The value of 3DTILES_ellipsoid for the Moon.
pub const MOON: &str = r#"{"body":"Moon","radii":[1737400,1737400,1737400]}"#;
