//! Patches of the earth as tile sets on disk, servers of numbered images, and viewers that look down on them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use image::{Rgb, RgbImage, RgbaImage};
use kit::frames::{keep, pixel};
use kit::rig::plain;
use kit::server::{Reply, Request, Server};
use kit::viewer::{Settle, offscreen};
use serde_json::{Value, json};
use terrane::formats::{OverlaySet, RasterOverlay};
use terrane::math::{Geodetic, WGS84};
use terrane::pager::PagerConfig;
use terrane::viewer::{Viewer, ViewerConfig};

/// Width and height of all pictures.
pub const SIDE: u32 = 256;
/// The attributions of sets and of patches.
pub const COPYRIGHTS: [&str; 2] = ["(c) Set", "(c) Patch"];
/// The angle of view.
const FIELD_OF_VIEW: f64 = std::f64::consts::FRAC_PI_3;

/// Returns the colour of an image by its level, column and row.
pub fn color_of([z, x, y]: [u32; 3]) -> [u8; 3] {
    [(40 + z * 23 % 200) as u8, (30 + x * 37 % 200) as u8, (30 + y * 53 % 200) as u8]
}

/// Returns a PNG of one colour.
pub fn png([r, g, b]: [u8; 3], side: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    RgbImage::from_pixel(side, side, Rgb([r, g, b])).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// Returns level, column and row of a path `/z/x/y.png`; `None` for other paths.
pub fn numbers(path: &str) -> Option<[u32; 3]> {
    let parts: Option<Vec<u32>> = path.strip_suffix(".png")?.split('/').skip(1).map(|part| part.parse().ok()).collect();
    parts?.try_into().ok()
}

/// Returns the reply to a request for a numbered image.
pub fn numbered(request: &Request) -> Reply {
    match numbers(request.path()) {
        Some(tile) => Reply::ok(png(color_of(tile), 256)),
        None => Reply::new(404, ""),
    }
}

/// Returns a server of numbered images and its template.
pub fn numbered_server() -> (Server, String) {
    let server = Server::start(numbered);
    let template = format!("{}/{{z}}/{{x}}/{{y}}.png", server.url);
    (server, template)
}

/// Returns the number of requests for each path.
pub fn requests(server: &Server) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    server.seen().iter().for_each(|request| *counts.entry(request.path().to_owned()).or_default() += 1);
    counts
}

/// Returns the numbers of Web Mercator's tile around a place in degrees, by the usual formula.
pub fn mercator(z: u32, [longitude, latitude]: [f64; 2]) -> [u32; 3] {
    let n = f64::from(1u32 << z);
    let lat = latitude.to_radians();
    let y = (1.0 - (lat.tan() + 1.0 / lat.cos()).ln() / std::f64::consts::PI) / 2.0 * n;
    [z, ((longitude + 180.0) / 360.0 * n).rem_euclid(n) as u32, y.clamp(0.0, n - 1.0) as u32]
}

/// Returns the numbers of the geographic tile around a place in degrees.
pub fn geographic(z: u32, [longitude, latitude]: [f64; 2]) -> [u32; 3] {
    let side = 180.0 / f64::from(1u32 << z);
    [z, ((longitude + 180.0) / side) as u32, ((90.0 - latitude) / side) as u32]
}

/// Returns the geometric error of a tile that is covered by pixels of `pixel_m` metres.
pub fn error_for(pixel_m: f64) -> f64 {
    // Two of the 16 pixels of error.
    pixel_m * 8.0
}

/// Returns the size of Web Mercator's pixels in metres.
pub fn mercator_pixel_m(z: u32, latitude: f64) -> f64 {
    std::f64::consts::TAU * 6_378_137.0 / (256.0 * f64::from(1u32 << z)) * latitude.to_radians().cos()
}

/// A patch of the ellipsoid: west, south, east and north in degrees.
#[derive(Clone, Copy)]
pub struct Patch(pub [f64; 4]);

/// How a patch is coloured without overlays.
#[derive(Clone, Copy, PartialEq)]
pub enum Look {
    White,
    /// A texture of one colour, with its own coordinates.
    Textured([u8; 3]),
}

impl Patch {
    /// Returns the place at shares of the width and of the height, in degrees.
    pub fn place(&self, east: f64, north: f64) -> [f64; 2] {
        let [w, s, e, n] = self.0;
        [w + (e - w) * east, s + (n - s) * north]
    }

    fn point([longitude, latitude]: [f64; 2], height_m: f64) -> DVec3 {
        WGS84.ecef(&Geodetic { longitude: longitude.to_radians(), latitude: latitude.to_radians(), height_m })
    }

    fn frame(&self) -> DAffine3 {
        let [longitude, latitude] = self.place(0.5, 0.5).map(f64::to_radians);
        WGS84.ecef_from_enu(&Geodetic { longitude, latitude, height_m: 0.0 })
    }

    /// Writes a glTF of the patch with its buffer; returns its name.
    fn write(&self, folder: &Path, name: &str, look: Look) -> String {
        const CELLS: u32 = 16;
        let enu_from_ecef = self.frame().inverse();
        let (mut positions, mut uvs, mut indices): (Vec<f32>, Vec<f32>, Vec<u16>) = Default::default();
        for (j, i) in (0..=CELLS).flat_map(|j| (0..=CELLS).map(move |i| (j, i))) {
            let [east, north] = [i, j].map(|k| f64::from(k) / f64::from(CELLS));
            let at = enu_from_ecef.transform_point3(Self::point(self.place(east, north), 0.0)).as_vec3();
            positions.extend(at.to_array());
            uvs.extend([east as f32, 1.0 - north as f32]);
            if i < CELLS && j < CELLS {
                let first = (j * (CELLS + 1) + i) as u16;
                let above = first + CELLS as u16 + 1;
                indices.extend([first, first + 1, above + 1, first, above + 1, above]);
            }
        }
        let mut buffer: Vec<u8> = bytemuck::cast_slice(&positions).to_vec();
        buffer.extend_from_slice(bytemuck::cast_slice(&uvs));
        buffer.extend_from_slice(bytemuck::cast_slice(&indices));
        let (vertices, position_bytes, uv_bytes) = (positions.len() / 3, positions.len() * 4, uvs.len() * 4);
        let mut pbr = json!({});
        if let Look::Textured(color) = look {
            std::fs::write(folder.join(format!("{name}.png")), png(color, 8)).unwrap();
            pbr = json!({ "baseColorTexture": { "index": 0 } });
        }
        let mut gltf = json!({
            "asset": { "version": "2.0", "copyright": COPYRIGHTS[1] }, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
            "extensionsUsed": ["KHR_materials_unlit"],
            "materials": [{ "pbrMetallicRoughness": pbr, "extensions": { "KHR_materials_unlit": {} } }],
            "meshes": [{ "primitives": [
                { "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "material": 0 }] }],
            "buffers": [{ "byteLength": buffer.len(), "uri": format!("{name}.bin") }],
            "bufferViews": [
                { "buffer": 0, "byteLength": position_bytes },
                { "buffer": 0, "byteOffset": position_bytes, "byteLength": uv_bytes },
                { "buffer": 0, "byteOffset": position_bytes + uv_bytes, "byteLength": indices.len() * 2 }],
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3",
                    "min": [-1e7, -1e7, -1e7], "max": [1e7, 1e7, 1e7] },
                { "bufferView": 1, "componentType": 5126, "count": vertices, "type": "VEC2" },
                { "bufferView": 2, "componentType": 5123, "count": indices.len(), "type": "SCALAR" }],
        });
        if look != Look::White {
            gltf["textures"] = json!([{ "source": 0 }]);
            gltf["images"] = json!([{ "uri": format!("{name}.png") }]);
        }
        std::fs::write(folder.join(format!("{name}.bin")), buffer).unwrap();
        std::fs::write(folder.join(format!("{name}.gltf")), gltf.to_string()).unwrap();
        format!("{name}.gltf")
    }

    /// Writes the content of the patch; returns its tile. `parent` maps the frame of the tile above to ECEF.
    pub fn tile(&self, folder: &Path, name: &str, error_m: f64, look: Look, parent: DAffine3) -> Value {
        let [west, south, east, north] = self.0.map(f64::to_radians);
        // Across the antimeridian, east is less than west.
        let east = if east > std::f64::consts::PI { east - std::f64::consts::TAU } else { east };
        let transform = parent.inverse() * self.frame();
        let matrix = glam::DMat4::from(transform).to_cols_array();
        json!({
            "boundingVolume": { "region": [west, south, east, north, -1000, 1000] },
            "geometricError": error_m, "refine": "REPLACE", "transform": matrix,
            "content": { "uri": self.write(folder, name, look) },
        })
    }

    /// Writes a tile set of the patch alone; returns its path.
    pub fn set(&self, folder: &Path, error_m: f64, look: Look) -> String {
        write_set(folder, self.tile(folder, "patch", error_m, look, DAffine3::IDENTITY))
    }

    /// Returns the frame of the patch's tile.
    pub fn ecef_from_tile(&self) -> DAffine3 {
        self.frame()
    }
}

/// Writes a tile set with a root tile; returns its path.
pub fn write_set(folder: &Path, root: Value) -> String {
    let set = json!({
        "asset": { "version": "1.0", "gltfUpAxis": "Z", "copyright": COPYRIGHTS[0] }, "geometricError": 1e7, "root": root });
    let file = folder.join("tileset.json");
    std::fs::write(&file, set.to_string()).unwrap();
    file.to_str().unwrap().to_owned()
}

/// A viewer that looks down on a patch, north up, and its picture.
pub struct Looking {
    pub viewer: Viewer,
    pub overlays: Arc<OverlaySet>,
    picture: RgbaImage,
}

impl Looking {
    /// Draws a set under overlays until everything is loaded; `None` without an adapter.
    pub fn at(name: &str, set: &str, overlays: Vec<RasterOverlay>, patch: &Patch) -> Option<Self> {
        Self::from_height(name, set, overlays, patch, 1.0)
    }

    /// Does the same from a height that is `share` of the one at which the picture shows the whole patch.
    pub fn from_height(name: &str, set: &str, overlays: Vec<RasterOverlay>, patch: &Patch, share: f64) -> Option<Self> {
        let overlays = Arc::new(OverlaySet::new(overlays).unwrap());
        let mut config = ViewerConfig {
            size_px: [SIDE, SIDE],
            adapter: kit::adapter(),
            pager: PagerConfig { overlays: Some(overlays.clone()), ..PagerConfig::default() },
            ..ViewerConfig::default()
        };
        config.pager.http.allowed_hosts = vec!["127.0.0.1".parse().unwrap()];
        let mut viewer = offscreen(&config)?;
        viewer.load(set).unwrap();
        viewer.view_mut().environment = plain();
        viewer.view_mut().camera.world_from_eye = world_from_eye(patch, share);
        let mut looking = Self { viewer, overlays, picture: RgbaImage::new(0, 0) };
        looking.settle();
        if !name.is_empty() {
            keep(name, &looking.picture);
        }
        Some(looking)
    }

    /// Draws until everything is loaded.
    pub fn settle(&mut self) {
        self.viewer.settle(2);
        self.draw();
    }

    /// Draws one frame.
    pub fn draw(&mut self) {
        self.viewer.want_picture();
        self.viewer.frame().unwrap();
        self.viewer.finish().unwrap();
        self.picture = self.viewer.take_pictures().pop().unwrap().1;
    }

    /// Returns the latest picture.
    pub fn picture(&self) -> &RgbaImage {
        &self.picture
    }

    /// Returns the colour of the pixel at a place in degrees.
    pub fn color(&self, place: [f64; 2]) -> [u8; 3] {
        let world_from_eye = self.viewer.view().camera.world_from_eye;
        let at = world_from_eye.inverse().transform_point3(Patch::point(place, 0.0));
        let per_m = 0.5 * f64::from(SIDE) / (-at.z * (0.5 * FIELD_OF_VIEW).tan());
        let pixel_of = |offset: f64| (0.5 * f64::from(SIDE) + offset * per_m).floor() as u32;
        pixel(&self.picture, pixel_of(at.x), pixel_of(-at.y))
    }

    /// Checks colours at places all over a patch. `expected` returns that of a place, or `None` for one that is not checked.
    pub fn check(&self, patch: &Patch, expected: impl Fn([f64; 2]) -> Option<[u8; 3]>) {
        let mut checked = 0;
        let shares = || (0..12).map(|k| 0.04 + 0.92 * f64::from(k) / 11.0);
        for place in shares().flat_map(|east| shares().map(move |north| patch.place(east, north))) {
            let Some(expected) = expected(place) else { continue };
            let got = self.color(place);
            let is_near = got.iter().zip(expected).all(|(got, expected)| got.abs_diff(expected) <= 2);
            assert!(is_near, "{place:?}: {got:?}, expected {expected:?}");
            checked += 1;
        }
        assert!(checked > 60, "{checked} places");
    }
}

fn world_from_eye(patch: &Patch, share: f64) -> DAffine3 {
    let frame = patch.frame();
    let corners = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.5], [1.0, 0.5], [0.5, 0.0], [0.5, 1.0]];
    let reach = corners.map(|[east, north]| {
        let at = frame.inverse().transform_point3(Patch::point(patch.place(east, north), 0.0));
        at.x.abs().max(at.y.abs())
    });
    let half_m = reach.into_iter().fold(0.0, f64::max);
    let height_m = share * 1.02 * half_m / (0.5 * FIELD_OF_VIEW).tan();
    frame * DAffine3::from_translation(DVec3::new(0.0, 0.0, height_m))
}

/// Returns the colour of the tile around a place, unless the place is close to its edge.
pub fn expected(tile_of: impl Fn([f64; 2]) -> [u32; 3], place: [f64; 2], margin: f64) -> Option<[u8; 3]> {
    let tile = tile_of(place);
    let [x, y] = place;
    let around = [[x - margin, y], [x + margin, y], [x, y - margin], [x, y + margin]];
    around.iter().all(|near| tile_of(*near) == tile).then(|| color_of(tile))
}
