//! Random scenes: graphs of all kinds of nodes under all kinds of state, the same for the same seed.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4, EulerRot};
use image::{Rgba, RgbaImage};
use terrane::cull::CullCamera;
use terrane::math::Aabb;
use terrane::math::random::SplitMix64;
use terrane::scene::{
    AlphaMode, Billboard, BillboardMode, CameraNode, ClipNode, Drawable, Environment, Geometry, LightSource,
    LocalLights, Material, Mesh, MeshVertex, Node, NodeKind, ReferenceFrame, RenderOrder, Scene, TexGenNode, Topology,
};
use terrane::state::{
    AlphaFunc, Attribute, BinDetails, BlendEquation, BlendFactor, BlendFunc, ColorControl, ColorMask, CompareFunction,
    CullFace, DataVariance, Depth, Fog, FogMode, FrontFace, Light, LightModel, Mode, PolygonOffset, Scissor, SortMode,
    StateSet, StateValue, Stencil, StencilFace, StencilOperation, SurfaceMaterial, TexGen, TextureBinding,
    TextureFormat, TextureObject,
};

use kit::rig::Rig;
use kit::shapes::with_mips;
use kit::terrain::Terrain;

/// The number of seeds of each test with TERRANE_LONG_TESTS=1.
const LONG_SAMPLE: u64 = 40;

/// Returns the seeds of RANDOM_SCENES=FIRST..END, or a sample of those from `first` on.
pub fn seeds(first: u64, sample: u64) -> std::ops::Range<u64> {
    let Ok(asked) = std::env::var("RANDOM_SCENES") else {
        return first..first + if kit::long_tests() { LONG_SAMPLE } else { sample };
    };
    let (first, end) = asked.split_once("..").expect("RANDOM_SCENES=FIRST..END");
    first.parse().unwrap()..end.parse().unwrap()
}

/// Random numbers from a seed.
pub struct Random(SplitMix64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed.wrapping_mul(SplitMix64::GOLDEN_GAMMA) ^ 0x5851_f42d_4c95_7f2d))
    }

    fn next(&mut self) -> u64 {
        self.0.next_u64()
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.next_unit()
    }

    /// Returns a number from 0 to below `end`.
    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    pub fn percent(&mut self, percent: u64) -> bool {
        self.next() % 100 < percent
    }

    pub fn one_of<T: Clone>(&mut self, all: &[T]) -> T {
        all[(self.next() % all.len() as u64) as usize].clone()
    }

    fn point(&mut self, reach: f64) -> DVec3 {
        DVec3::new(self.between(-reach, reach), self.between(-reach, reach), self.between(-reach, reach))
    }

    fn color(&mut self) -> [f32; 3] {
        [0; 3].map(|_| self.between(0.1, 1.0) as f32)
    }

    fn turn(&mut self) -> DQuat {
        DQuat::from_euler(EulerRot::XYZ, self.between(0.0, 6.3), self.between(0.0, 6.3), self.between(0.0, 6.3))
    }

    /// Returns a scale that is sometimes mirrored or uneven.
    pub fn place(&mut self, reach: f64) -> DAffine3 {
        let scale = match self.below(4) {
            0 => DVec3::new(self.between(0.4, 1.6), -self.between(0.4, 1.6), self.between(0.4, 1.6)),
            1 => DVec3::new(self.between(0.4, 1.6), self.between(0.4, 1.6), self.between(0.4, 1.6)),
            _ => DVec3::ONE,
        };
        DAffine3::from_scale_rotation_translation(scale, self.turn(), self.point(reach))
    }
}

/// The generator of a random scene.
pub struct Maker {
    pub random: Random,
    /// True if leaves hide what is behind them in any order of drawing.
    is_opaque: bool,
    sets: Vec<Arc<StateSet>>,
    shapes: Vec<Drawable>,
    lights: u8,
    /// True for content that a camera of the scene draws.
    drawn: Arc<TextureObject>,
}

const FUNCTIONS: [CompareFunction; 5] = [
    CompareFunction::Less,
    CompareFunction::LessOrEqual,
    CompareFunction::Greater,
    CompareFunction::NotEqual,
    CompareFunction::Always,
];

impl Maker {
    pub fn new(seed: u64, is_opaque: bool) -> Self {
        let mut random = Random::new(seed);
        let drawn = TextureObject::target("drawn", [32, 32], TextureFormat::Rgba8Srgb);
        let shapes = (0..10).map(|_| shape(&mut random, is_opaque)).collect();
        let mut maker = Self { random, is_opaque, sets: Vec::new(), shapes, lights: 0, drawn };
        maker.sets = (0..9).map(|_| Arc::new(maker.state_set())).collect();
        maker
    }

    /// Returns a scene of about a hundred nodes, within 20 metres of the origin.
    pub fn scene(&mut self) -> Node {
        let children = 4 + self.random.below(8);
        self.scene_of(children, 3)
    }

    /// Returns a scene of about a dozen nodes, which needs few pipelines.
    pub fn small_scene(&mut self) -> Node {
        self.scene_of(3, 2)
    }

    fn scene_of(&mut self, children: u64, depth: u32) -> Node {
        let mut children: Vec<Node> = (0..children).map(|_| self.node(depth)).collect();
        if self.random.percent(50) {
            children.push(self.camera_to_texture());
        }
        if self.random.percent(20) {
            let terrain =
                Terrain { west: 0.1, south: 0.7, width: 4e-6, relief_m: 3.0, root_error_m: 1.0, textured: true };
            let mut tile = terrain.tile(1, 0, 1);
            tile.kind = NodeKind::Transform(DAffine3::from_rotation_translation(self.random.turn(), DVec3::ZERO));
            children.push(tile);
        }
        let mut root = Node::group(children);
        if self.random.percent(30) {
            root.state_set = Some(self.random.one_of(&self.sets));
        }
        root
    }

    fn node(&mut self, depth: u32) -> Node {
        let mut node = match self.random.below(if depth == 0 { 3 } else { 14 }) {
            0 | 1 => self.geode(),
            2 => self.billboard(),
            3 | 4 => self.group(depth, NodeKind::Group),
            5..8 => {
                let kind = NodeKind::Transform(self.random.place(8.0));
                self.group(depth, kind)
            }
            8 => {
                let shown = (0..4).map(|_| self.random.percent(70)).collect();
                self.group(depth, NodeKind::Switch(shown))
            }
            9 => {
                let ranges_m = vec![[0.0, 25.0], [0.0, 1e9], [25.0, 1e9], [10.0, 40.0]];
                let center = self.random.point(4.0);
                self.group(depth, NodeKind::Lod { center, ranges_m })
            }
            10 if self.lights < 7 => self.light(depth),
            11 if !self.is_opaque => self.clip_node(depth),
            12 if !self.is_opaque => {
                let kind = NodeKind::TexGenNode(Box::new(TexGenNode { unit: 0, texgen: self.texgen() }));
                self.group(depth, kind)
            }
            13 if !self.is_opaque => self.camera(depth),
            _ => self.group(depth, NodeKind::Group),
        };
        if self.random.percent(40) {
            node.state_set = Some(self.random.one_of(&self.sets));
        }
        if self.random.percent(4) {
            node.culling_active = false;
        }
        node
    }

    fn group(&mut self, depth: u32, kind: NodeKind) -> Node {
        let children = (0..1 + self.random.below(4)).map(|_| self.node(depth - 1)).collect();
        Node { children, ..Node::new(kind) }
    }

    /// Equal shapes are moved apart, because the order decides which of two at one position is visible.
    fn geode(&mut self) -> Node {
        if self.random.percent(60) {
            let geode = Node::geode(vec![self.random.one_of(&self.shapes)]);
            return Node::transform(self.random.place(4.0), vec![geode]);
        }
        let count = 1 + self.random.below(3);
        Node::geode((0..count).map(|_| shape(&mut self.random, self.is_opaque)).collect())
    }

    fn billboard(&mut self) -> Node {
        let axis = self.random.point(1.0);
        let mode = self.random.one_of(&[
            BillboardMode::PointRotEye,
            BillboardMode::PointRotWorld,
            BillboardMode::AxialRot { axis },
        ]);
        let drawables =
            (0..1 + self.random.below(3)).map(|_| (self.random.point(5.0), self.random.one_of(&self.shapes))).collect();
        Node::new(NodeKind::Billboard(Box::new(Billboard { mode, drawables, ..Billboard::default() })))
    }

    fn light(&mut self, depth: u32) -> Node {
        let place = self.random.point(10.0);
        let random = &mut self.random;
        // The order decides which of two lights with a number wins, so numbers are unique.
        let number = if self.is_opaque { self.lights } else { random.below(3) as u8 };
        self.lights = (self.lights + 1).min(7);
        let light = Light {
            number,
            position: place.extend(random.below(2) as f64).to_array(),
            direction: random.point(1.0).to_array(),
            diffuse: random.color(),
            specular: random.color(),
            spot_cutoff: random.one_of(&[std::f32::consts::PI, 0.8]),
            ..Light::default()
        };
        if random.percent(50) {
            return self.group(depth, NodeKind::LocalLights(LocalLights { lights: vec![light] }));
        }
        let frame = random.one_of(&[ReferenceFrame::Relative, ReferenceFrame::Absolute]);
        self.group(depth, NodeKind::LightSource(Box::new(LightSource { light, frame })))
    }

    fn clip_node(&mut self, depth: u32) -> Node {
        let normal = self.random.point(1.0).normalize_or(DVec3::Z);
        let planes: Vec<(u8, DVec4)> =
            vec![(self.random.below(3) as u8, normal.extend(self.random.between(-1.0, 5.0)))];
        self.group(depth, NodeKind::ClipNode(Box::new(ClipNode { planes, frame: ReferenceFrame::Relative })))
    }

    /// Returns a camera with another view of its children, in a part of the image.
    fn camera(&mut self, depth: u32) -> Node {
        let random = &mut self.random;
        let order = random.one_of(&[RenderOrder::Nested, RenderOrder::PostRender(0), RenderOrder::PostRender(-1)]);
        let frame = random.one_of(&[ReferenceFrame::Relative, ReferenceFrame::Absolute]);
        let mut camera = CameraNode { frame, clear_color: None, ..CameraNode::new(order) };
        camera.clear_depth = random.percent(50);
        camera.view = match frame {
            ReferenceFrame::Relative => random.place(2.0),
            ReferenceFrame::Absolute => looking_at(random.point(12.0)),
        };
        if random.percent(60) {
            camera.projection = Some(projection(random.between(0.6, 1.4)));
        }
        if random.percent(60) {
            camera.viewport_px = Some([random.below(40) as u32, random.below(40) as u32, 40, 40]);
        }
        let children = (0..1 + self.random.below(4)).map(|_| self.node(depth - 1)).collect();
        Node::camera(camera, children)
    }

    /// Returns cameras that draw the textures of some state sets.
    fn camera_to_texture(&mut self) -> Node {
        let view = looking_at(self.random.point(10.0));
        let mut camera = CameraNode::to_texture(self.drawn.clone(), view, projection(1.0));
        camera.clear_color = Some([0.2, 0.4, 0.8, 1.0]);
        let geodes = (0..3).map(|_| Node::transform(self.random.place(3.0), vec![self.node(0)])).collect();
        Node::camera(camera, geodes)
    }

    fn texgen(&mut self) -> TexGen {
        let [s, t] = [0; 2].map(|_| self.random.point(0.2).extend(0.5).as_vec4().to_array());
        let planes = TexGen::planes(s, t);
        self.random.one_of(&[
            TexGen::ObjectLinear(planes),
            TexGen::EyeLinear(planes),
            TexGen::SphereMap,
            TexGen::NormalMap,
            TexGen::ReflectionMap,
        ])
    }

    fn value(&mut self) -> StateValue {
        let on = if self.random.percent(75) { StateValue::ON } else { StateValue::OFF };
        match self.random.below(6) {
            0 => on | StateValue::OVERRIDE,
            1 => on | StateValue::PROTECTED,
            _ => on,
        }
    }

    pub fn state_set(&mut self) -> StateSet {
        let mut set = StateSet::default();
        let random = &mut self.random;
        if random.percent(40) {
            let [r, g, b] = random.color();
            set.color = Some([r, g, b, if self.is_opaque { 1.0 } else { random.between(0.3, 1.0) as f32 }]);
        }
        if random.percent(35) {
            let number = if self.is_opaque { 0 } else { random.one_of(&[-2, -1, 0, 1, 5, 10, 11]) };
            set.bin = Some(BinDetails::new(number, self.sort_mode()));
            set.nest_bins = self.random.percent(80);
        }
        let always = self.of_opaque();
        let wild = if self.is_opaque { Vec::new() } else { self.of_others() };
        for attribute in always.into_iter().chain(wild) {
            if self.random.percent(15) {
                let value = self.value();
                set.set_attribute_and_modes(attribute, value);
            }
        }
        for mode in [Mode::Lighting, Mode::Light(0), Mode::Light(1), Mode::Light(2), Mode::Fog, Mode::Texture(0)] {
            if self.random.percent(15) {
                let value = self.value();
                set.set_mode(mode, value);
            }
        }
        set
    }

    pub fn sort_mode(&mut self) -> SortMode {
        self.random.one_of(&[
            SortMode::ByState,
            SortMode::ByStateThenFrontToBack,
            SortMode::FrontToBack,
            SortMode::BackToFront,
            SortMode::TraversalOrder,
        ])
    }

    /// Returns attributes with which the nearest leaf is visible in any order of drawing.
    fn of_opaque(&mut self) -> Vec<Attribute> {
        let texture = TextureBinding::new(if self.random.percent(50) { self.drawn.clone() } else { checkers() });
        let texgen = self.texgen();
        let random = &mut self.random;
        vec![
            Attribute::CullFace(random.one_of(&[CullFace::Back, CullFace::Front])),
            Attribute::FrontFace(FrontFace::Clockwise),
            Attribute::SurfaceMaterial(SurfaceMaterial {
                ambient: random.color(),
                specular: random.color(),
                shininess: 8.0,
                ..SurfaceMaterial::default()
            }),
            Attribute::LightModel(LightModel {
                ambient: random.color(),
                local_viewer: random.percent(50),
                two_sided: random.percent(50),
                color_control: random.one_of(&[ColorControl::SingleColor, ColorControl::SeparateSpecularColor]),
            }),
            Attribute::Fog({
                let mode = random.one_of(&[
                    FogMode::Linear { start_m: 5.0, end_m: 60.0 },
                    FogMode::Exp { density_per_m: 0.03 },
                    FogMode::Exp2 { density_per_m: 0.03 },
                ]);
                let color = random.color();
                Fog { mode, color, is_displayed: color[0] > 0.5 }
            }),
            Attribute::TexGen(0, texgen),
            Attribute::Texture(0, texture),
        ]
    }

    /// Returns attributes whose result depends on the order.
    fn of_others(&mut self) -> Vec<Attribute> {
        let random = &mut self.random;
        let factors = [BlendFactor::One, BlendFactor::SrcAlpha, BlendFactor::OneMinusSrcAlpha, BlendFactor::DstColor];
        let operations = [StencilOperation::Keep, StencilOperation::Increment, StencilOperation::Invert];
        let mut face = || StencilFace {
            function: random.one_of(&FUNCTIONS),
            fail: random.one_of(&operations),
            depth_fail: random.one_of(&operations),
            pass: random.one_of(&operations),
        };
        let stencil = Stencil { front: face(), back: face(), ..Stencil::both(StencilFace::default(), 1) };
        vec![
            Attribute::BlendFunc(BlendFunc::new(random.one_of(&factors), random.one_of(&factors))),
            Attribute::BlendEquation(random.one_of(&[BlendEquation::Add, BlendEquation::Max])),
            Attribute::Depth(Depth {
                function: random.one_of(&FUNCTIONS),
                write: random.percent(60),
                range: random.one_of(&[[0.0, 1.0], [0.0, 0.5]]),
            }),
            Attribute::PolygonOffset(PolygonOffset { factor: random.between(-2.0, 2.0) as f32, units: 4.0 }),
            Attribute::ColorMask(ColorMask([random.percent(80), random.percent(80), random.percent(80), true])),
            Attribute::AlphaFunc(AlphaFunc { function: random.one_of(&FUNCTIONS), reference: 0.5 }),
            Attribute::Stencil(stencil),
            Attribute::Scissor(Scissor { x: random.below(30) as u32, y: 7, width: 70, height: 64 }),
        ]
    }
}

/// Returns an eye 15 to 35 metres away.
pub fn eye(random: &mut Random) -> DVec3 {
    random.point(1.0).normalize_or(DVec3::X) * random.between(15.0, 35.0)
}

fn looking_at(eye: DVec3) -> DAffine3 {
    DAffine3::from_mat4(glam::dcamera::rh::view::look_at_mat4(eye, DVec3::ZERO, DVec3::new(0.01, 0.02, 1.0)))
}

fn projection(fovy: f64) -> DMat4 {
    glam::dcamera::rh::proj::directx::perspective_infinite_reverse(fovy, 1.0, 0.1)
}

fn checkers() -> Arc<TextureObject> {
    let texels = (0..64).flat_map(|i| if (i + i / 8) & 1 == 0 { [255, 220, 90, 255] } else { [30, 60, 160, 255] });
    TextureObject::image("checkers", [8, 8], texels.collect())
}

fn shape(random: &mut Random, is_opaque: bool) -> Drawable {
    let place = random.point(3.0);
    let size = random.between(0.5, 3.0);
    let mesh = match random.below(7) {
        0 => Mesh::sphere(place, size, 18),
        1 => Mesh::cuboid(&Aabb { min: place - DVec3::splat(size), max: place + DVec3::new(size, 0.3, size) }),
        2 => Mesh::polyline(&[0; 6].map(|_| place + random.point(size))),
        3 => Mesh::rectangle(place, random.point(size), random.point(size)),
        4 => Mesh { topology: Topology::Points, ..triangles(random, 9, place, size) },
        5 => triangles(random, 40, place, size),
        _ => triangles(random, 3, place, size),
    };
    let [r, g, b] = random.color();
    let (alpha, a) = match random.below(4) {
        0 if !is_opaque => (AlphaMode::Blend, random.between(0.3, 0.9) as f32),
        1 if !is_opaque => (AlphaMode::Mask(0.5), 1.0),
        _ => (AlphaMode::Opaque, 1.0),
    };
    let texture = random.percent(40).then(|| {
        let texel =
            |i: u32| [(i * 37 % 256) as u8, (i * 91 % 256) as u8, 200, if i.is_multiple_of(3) { 90 } else { 255 }];
        Arc::new(with_mips(8, 8, (0..64).flat_map(texel).collect()))
    });
    let material = Material {
        base_color: [r, g, b, a],
        texture,
        alpha,
        double_sided: random.percent(50),
        unlit: random.percent(30),
        ..Material::default()
    };
    let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), material);
    if random.percent(30) { drawable.with_cluster_culling() } else { drawable }
}

fn triangles(random: &mut Random, count: u32, place: DVec3, size: f64) -> Mesh {
    let has_normals = random.percent(50);
    let has_colors = random.percent(40);
    let vertices = (0..3 * count)
        .map(|_| {
            let n = (random.point(1.0).normalize_or(DVec3::Z) * 127.0).round();
            let [r, g, b] = random.color().map(|c| (255.0 * c) as u8);
            MeshVertex {
                position: (place + random.point(size)).as_vec3().to_array(),
                uv: [random.between(0.0, 1.0) as f32, random.between(0.0, 1.0) as f32],
                normal: if has_normals { [n.x as i8, n.y as i8, n.z as i8, 0] } else { [0; 4] },
                color: if has_colors { [r, g, b, 255] } else { [255; 4] },
            }
        })
        .collect();
    Mesh::new(vertices, (0..3 * count).collect(), Topology::Triangles)
}

/// Gives every node a unique name.
pub fn named(node: &mut Node, number: &mut u32) {
    node.name = number.to_string();
    *number += 1;
    node.children.iter_mut().for_each(|child| named(child, number));
}

/// Returns the node of a number in depth-first order.
fn nth<'a>(node: &'a mut Node, left: &mut u64) -> Option<&'a mut Node> {
    if *left == 0 {
        return Some(node);
    }
    *left -= 1;
    node.children.iter_mut().find_map(|child| nth(child, left))
}

fn count_nodes(node: &Node) -> u64 {
    1 + node.children.iter().map(count_nodes).sum::<u64>()
}

/// Changes a node of the scene and its counterpart in the graph in the same random way. Meshes change only with
/// `with_meshes`, because a viewer must upload them to its devices.
pub fn change(scene: &mut Scene, root: &mut Node, maker: &mut Maker, with_meshes: bool) {
    let mut left = maker.random.below(count_nodes(root));
    let Some(node) = nth(root, &mut left) else { return };
    let page = scene.roots()[0];
    let id = scene.nodes_named(page, &node.name).next().unwrap();
    let has_children = !node.children.is_empty();
    match &mut node.kind {
        NodeKind::Transform(map) | NodeKind::AbsoluteTransform(map) => {
            *map = maker.random.place(8.0);
            scene.set_transform(id, *map).unwrap();
        }
        NodeKind::Switch(shown) if has_children => {
            let child = maker.random.below(node.children.len() as u64) as usize;
            shown[child] = !shown[child];
            scene.set_switch(id, child, shown[child]).unwrap();
        }
        NodeKind::Camera(camera) => {
            camera.view = maker.random.place(6.0);
            camera.viewport_px = maker.random.percent(50).then_some([10, 20, 60, 50]);
            scene.set_camera(id, (**camera).clone()).unwrap();
        }
        NodeKind::Geode(drawables) if with_meshes && maker.random.percent(60) => {
            let place = maker.random.below(drawables.len() as u64) as usize;
            let drawable = &mut drawables[place];
            let Geometry::Mesh(mesh) = &mut drawable.geometry else { return };
            let count = 1 + maker.random.below(30) as u32;
            let at = maker.random.point(3.0);
            *mesh = Arc::new(Mesh { topology: mesh.topology, ..triangles(&mut maker.random, count, at, 2.0) });
            drawable.cluster = None;
            let variance = maker.random.one_of(&[DataVariance::Static, DataVariance::Dynamic]);
            scene.set_mesh(id, place, mesh.clone(), variance).unwrap();
        }
        _ => {
            let Some(old) = node.state_set.clone() else { return };
            let new = Arc::new(maker.state_set());
            assert!(scene.replace_state_set(page, &old, new.clone()));
            replace_set(root, &old, &new);
        }
    }
}

fn replace_set(node: &mut Node, old: &Arc<StateSet>, new: &Arc<StateSet>) {
    if node.state_set.as_ref().is_some_and(|set| Arc::ptr_eq(set, old)) {
        node.state_set = Some(new.clone());
    }
    node.children.iter_mut().for_each(|child| replace_set(child, old, new));
}

/// Returns the frame of a graph in a separate scene.
pub fn picture(rig: &mut Rig, node: &Node, camera: &CullCamera, environment: &Environment) -> RgbaImage {
    let scene = rig.scene(node.clone());
    let picture = rig.picture(&scene, camera, environment);
    rig.release(scene);
    picture
}

/// The comparisons that found a difference.
#[derive(Default)]
pub struct Differences(Vec<String>);

impl Differences {
    /// Records a comparison if more than `few` pixels differ.
    pub fn compare(&mut self, what: &str, seed: u64, [a, b]: [&RgbaImage; 2], few: usize) {
        let is_other = |(a, b): &(&Rgba<u8>, &Rgba<u8>)| a.0.iter().zip(&b.0).take(3).any(|(a, b)| a.abs_diff(*b) > 3);
        let others = a.pixels().zip(b.pixels()).filter(is_other).count();
        if others > few {
            let folder = std::path::PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
            let names = ["a", "b"].map(|name| folder.join(format!("random_{seed}_{}_{name}.png", self.0.len())));
            a.save(&names[0]).unwrap();
            b.save(&names[1]).unwrap();
            self.0.push(format!("seed {seed}, {what}: {others} pixels; {} and b", names[0].display()));
        }
    }

    pub fn assert_none(&self) {
        assert!(self.0.is_empty(), "{}", self.0.join("\n"));
    }
}
