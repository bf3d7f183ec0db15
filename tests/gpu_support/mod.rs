//! What the GPU tests share: one context a test program, terrain made of arithmetic, pictures to compare.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on shall panic")]
#![allow(dead_code, reason = "each test program uses a part of it")]

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use glam::{DAffine3, DMat3, DVec3};
use image::RgbaImage;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::draw::{DrawStats, Environment, Fog, Renderer, Sky};
use terrane::gpu::{
    AdapterChoice, CompileBudget, CompileOperation, Compiled, ContextTraits, GpuError, GraphicsContext,
};
use terrane::math::{Aabb, Geodetic, WGS84};
use terrane::scene::{
    Drawable, Geometry, HeightTile, Material, Mesh, MeshVertex, Node, Page, Scene, Texture, Topology,
};

/// Pixels of a color that no test draws on purpose.
pub const MAGENTA: [u8; 3] = [255, 0, 255];

/// Red, green and blue of a pixel.
pub fn pixel(picture: &RgbaImage, x: u32, y: u32) -> [u8; 3] {
    let [r, g, b, _] = picture.get_pixel(x, y).0;
    [r, g, b]
}

/// A context, its renderer and a visitor.
pub struct Rig {
    pub ctx: GraphicsContext,
    pub renderer: Renderer,
    pub visitor: CullVisitor,
    pub stage: RenderStage,
    ticket: u64,
}

/// The program's rig; `None`, said aloud, where there is no adapter (a failure with REQUIRE_GPU=1).
pub fn rig(test: &str) -> Option<MutexGuard<'static, Rig>> {
    static RIG: OnceLock<Option<Mutex<Rig>>> = OnceLock::new();
    let rig = RIG.get_or_init(|| new_rig([256, 256]).map(Mutex::new));
    match rig {
        Some(rig) => Some(rig.lock().unwrap_or_else(PoisonError::into_inner)),
        None => {
            eprintln!("{test}: skipped: no adapter");
            None
        }
    }
}

pub fn new_rig(size_px: [u32; 2]) -> Option<Rig> {
    let traits =
        ContextTraits { size_px, adapter: AdapterChoice::Software, validation: false, ..ContextTraits::default() };
    match GraphicsContext::new_offscreen(&traits) {
        Ok(mut ctx) => {
            let renderer = Renderer::new(&mut ctx);
            Some(Rig::new(ctx, renderer))
        }
        Err(GpuError::NoAdapter { reason }) => {
            assert!(std::env::var("REQUIRE_GPU").is_err(), "REQUIRE_GPU is set, but: {reason}");
            None
        }
        Err(e) => panic!("{e}"),
    }
}

impl Rig {
    pub fn new(ctx: GraphicsContext, renderer: Renderer) -> Self {
        Self { ctx, renderer, visitor: CullVisitor::new(), stage: RenderStage::new(), ticket: 0 }
    }

    /// Uploads drawables at once.
    pub fn compile(&mut self, drawables: Vec<Drawable>) -> Compiled {
        self.ticket += 1;
        self.ctx.compile(CompileOperation { ticket: self.ticket, drawables });
        self.ctx.run_compiles(&CompileBudget::UNLIMITED);
        let mut compiled = self.ctx.take_compiled();
        assert_eq!(compiled.len(), 1);
        let compiled = compiled.remove(0);
        assert_eq!(compiled.ticket, self.ticket);
        compiled
    }

    /// A scene of one page with everything uploaded.
    pub fn scene(&mut self, root: Node) -> Scene {
        let mut page = Page::from_node(root).unwrap();
        let compiled = self.compile(page.take_drawables());
        assert!(compiled.errors.is_empty(), "{:?}", compiled.errors);
        page.set_draw_slots(0, compiled.slots);
        let mut scene = Scene::new();
        scene.add_root(page);
        scene
    }

    /// Gives a scene's drawables back.
    pub fn release(&mut self, mut scene: Scene) {
        for id in scene.roots().to_vec() {
            for (_, slots) in scene.remove_root(id).unwrap().take_draw_slots() {
                self.ctx.release(&slots);
            }
        }
    }

    /// Culls and draws.
    pub fn draw(&mut self, scene: &Scene, camera: &CullCamera, environment: &Environment) -> DrawStats {
        self.ctx.resize(camera.viewport_px).unwrap();
        self.visitor.environment = Some(*environment);
        self.visitor.cull(scene, camera, &mut self.stage);
        let stats = self.renderer.draw(&mut self.ctx, &self.stage, environment).unwrap();
        let errors = self.ctx.take_device_errors();
        assert!(errors.is_empty(), "{errors:?}");
        stats
    }

    pub fn picture(&mut self, scene: &Scene, camera: &CullCamera, environment: &Environment) -> RgbaImage {
        self.draw(scene, camera, environment);
        self.read_back()
    }

    pub fn read_back(&mut self) -> RgbaImage {
        self.renderer.read_back(&mut self.ctx).unwrap()
    }
}

/// No haze, no tone mapping, a magenta background, z up.
pub fn plain() -> Environment {
    Environment {
        sky: Sky::Background(MAGENTA),
        fog: Fog { enabled: false, density_per_m: 0.0 },
        exposure: None,
        ..Environment::default()
    }
}

/// A camera at a place, looking at another.
pub fn camera(size_px: [u32; 2], eye: DVec3, target: DVec3, up: DVec3) -> CullCamera {
    let aspect = f64::from(size_px[0]) / f64::from(size_px[1]);
    let view = glam::dcamera::rh::view::look_at_mat4(eye, target, up);
    CullCamera {
        eye_from_world: DAffine3::from_mat4(view),
        clip_from_eye: glam::dcamera::rh::proj::directx::perspective_infinite_reverse(1.0, aspect, 0.1),
        viewport_px: size_px,
        ..CullCamera::default()
    }
}

/// A camera whose picture's plane at z = 0 spans -1 to 1 in x and y (nearly: a perspective one, far away).
pub fn unit_camera(size_px: u32) -> CullCamera {
    let distance = 10.0f64;
    let view = glam::dcamera::rh::view::look_at_mat4(DVec3::new(0.0, 0.0, distance), DVec3::ZERO, DVec3::Y);
    let fovy = 2.0 * (1.0 / distance).atan();
    CullCamera {
        eye_from_world: DAffine3::from_mat4(view),
        clip_from_eye: glam::dcamera::rh::proj::directx::perspective_infinite_reverse(fovy, 1.0, 0.1),
        viewport_px: [size_px, size_px],
        ..CullCamera::default()
    }
}

/// An upright rectangle at a depth, facing +z, in one unlit color.
pub fn quad(center: [f32; 3], half: [f32; 2], color: [f32; 4]) -> Drawable {
    let corner = |sx: f32, sy: f32| MeshVertex {
        position: [center[0] + sx * half[0], center[1] + sy * half[1], center[2]],
        uv: [0.5 + 0.5 * sx, 0.5 - 0.5 * sy],
        normal: [0, 0, 127, 0],
        color: [255; 4],
    };
    let vertices = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let material = Material { base_color: color, unlit: true, ..Material::default() };
    Drawable::new(Geometry::Mesh(Arc::new(mesh(vertices, vec![0, 1, 2, 0, 2, 3]))), material)
}

pub fn mesh(vertices: Vec<MeshVertex>, indices: Vec<u32>) -> Mesh {
    let bounds = Aabb::from_points(vertices.iter().map(|v| DVec3::from_array(v.position.map(f64::from))));
    Mesh { vertices, indices: indices.into(), topology: Topology::Triangles, bounds, ..Mesh::default() }
}

/// Smooth hash noise on a unit lattice, 0 to 1.
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

/// Terrain over a square of longitudes and latitudes, cut into tiles level by level.
pub struct Terrain {
    pub west: f64,
    pub south: f64,
    /// Radians a side of the root tile.
    pub width: f64,
    pub relief_m: f64,
    /// Geometric error of the root; each level halves it.
    pub root_error_m: f64,
    pub textured: bool,
}

impl Terrain {
    /// Metres, at a place in units of the root tile; rounded so that equal places are equal bits.
    pub fn height_m(&self, u: f64, v: f64) -> f64 {
        let mut sum = 0.0;
        for octave in 0..7 {
            let scale = f64::from(1 << octave);
            let ridge = 1.0 - (2.0 * value_noise(u * 4.0 * scale + 7.0, v * 4.0 * scale + 3.0) - 1.0).abs();
            sum += ridge * ridge / scale.powf(1.1);
        }
        (self.relief_m * sum * 0.6 * 32.0).round() / 32.0
    }

    pub fn geodetic(&self, u: f64, v: f64) -> Geodetic {
        Geodetic {
            longitude: self.west + u * self.width,
            latitude: self.south + v * self.width,
            height_m: self.height_m(u, v),
        }
    }

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

    /// A tile as a node: the tile in its frame under the transform to the world.
    pub fn tile(&self, level: u32, x: u32, y: u32) -> Node {
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
            coarser_errors_m: (0..level.min(6)).map(|n| self.error_m(level - 1 - n) as f32).collect(),
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

    /// World position above a place.
    pub fn world(&self, u: f64, v: f64, above_m: f64) -> DVec3 {
        let mut g = self.geodetic(u, v);
        g.height_m += above_m;
        WGS84.ecef(&g)
    }

    pub fn up(&self, u: f64, v: f64) -> DVec3 {
        WGS84.up(&self.geodetic(u, v))
    }

    /// Tiles for an eye: refined where the error projects to more than the camera's limit, as cull does it.
    pub fn tiles_for(&self, camera: &CullCamera, eye: DVec3, most_level: u32) -> Node {
        let mut nodes = Vec::new();
        let mut stack = vec![(0u32, 0u32, 0u32)];
        while let Some((level, x, y)) = stack.pop() {
            let range = self.error_m(level) * camera.px_per_radian() / camera.settings.max_sse_px;
            if level < most_level && self.distance_m(level, x, y, eye) < range {
                stack.extend([(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (level + 1, 2 * x + dx, 2 * y + dy)));
            } else {
                nodes.push(self.tile(level, x, y));
            }
        }
        Node::group(nodes)
    }

    /// Distance from the eye to the nearest vertex of a tile, a little less to be on the safe side.
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

/// A texture with box-filtered mips.
pub fn with_mips(width: u32, height: u32, pixels: Vec<u8>) -> Texture {
    let mut mips = vec![pixels];
    let (mut w, mut h) = (width as usize, height as usize);
    while w > 1 || h > 1 {
        let (nw, nh) = ((w / 2).max(1), (h / 2).max(1));
        let above = mips.last().unwrap();
        let mut level = Vec::with_capacity(nw * nh * 4);
        for y in 0..nh {
            for x in 0..nw {
                for c in 0..4 {
                    let texel = |dx: usize, dy: usize| {
                        u32::from(above[((2 * y + dy).min(h - 1) * w + (2 * x + dx).min(w - 1)) * 4 + c])
                    };
                    level.push(((texel(0, 0) + texel(1, 0) + texel(0, 1) + texel(1, 1)) / 4) as u8);
                }
            }
        }
        mips.push(level);
        (w, h) = (nw, nh);
    }
    Texture { width, height, mips, wrap: Default::default() }
}

/// Number of pixels of a color.
pub fn count(picture: &RgbaImage, rgb: [u8; 3]) -> usize {
    picture.pixels().filter(|p| p.0[..3] == rgb).count()
}

/// Compares with the reference of that name. `UPDATE_IMAGES=1` accepts; a failure leaves the picture and the
/// difference beside the reference.
pub fn assert_picture(name: &str, picture: &RgbaImage) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/images");
    let reference_path = folder.join(format!("{name}.png"));
    if std::env::var("UPDATE_IMAGES").is_ok_and(|v| v == "1") {
        std::fs::create_dir_all(&folder).unwrap();
        picture.save(&reference_path).unwrap();
        return;
    }
    let reference = image::open(&reference_path)
        .unwrap_or_else(|e| panic!("{}: {e}; UPDATE_IMAGES=1 makes it", reference_path.display()))
        .to_rgba8();
    assert_eq!(picture.dimensions(), reference.dimensions(), "{name}");
    let mut differences: Vec<u8> = picture
        .pixels()
        .zip(reference.pixels())
        .map(|(a, b)| (0..3).map(|c| a.0[c].abs_diff(b.0[c])).max().unwrap())
        .collect();
    let picture_of_differences = RgbaImage::from_fn(picture.width(), picture.height(), |x, y| {
        let d = differences[(y * picture.width() + x) as usize].saturating_mul(8);
        image::Rgba([d, d, d, 255])
    });
    differences.sort_unstable();
    let mean = differences.iter().map(|d| f64::from(*d)).sum::<f64>() / differences.len() as f64;
    let percentile_99 = differences[differences.len() * 99 / 100];
    let max = *differences.last().unwrap();
    // Adapters may differ in single pixels at edges, and by rounding elsewhere.
    if mean > 0.5 || percentile_99 > 6 || max > 160 {
        picture.save(folder.join(format!("{name}.actual.png"))).unwrap();
        picture_of_differences.save(folder.join(format!("{name}.diff.png"))).unwrap();
        panic!("{name} differs: mean {mean:.2}, 99th percentile {percentile_99}, max {max}; see {name}.diff.png");
    }
}
