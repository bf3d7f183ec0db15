//! Drawables of the application: their order, the data passed to them, and their errors.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use glam::{DAffine3, DMat4, DVec3, Vec4};
use image::RgbaImage;
use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{Rig, new_rig, plain, rig, unit_camera};
use kit::shadows::small_maps;
use kit::shapes::quad;

use terrane::draw::{CompiledDrawable, CustomDrawable, DRAWABLE_PRELUDE, DrawableInfo, custom_geometry};
use terrane::gpu::{CompileBudget, CompileInfo, CompileOperation, CustomError, TargetFormats};
use terrane::math::Aabb;
use terrane::scene::{
    AlphaMode, CameraNode, CullSettings, Drawable, Environment, Material, Node, NodeKind, Page, Scene,
};
use terrane::state::{
    Attribute, BinDetails, CompareFunction, Mode, Scissor, SortMode, StateSet, StateValue, Stencil, StencilFace,
    StencilOperation, TextureBinding, TextureFormat, TextureObject, UniformValue,
};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];

/// A drawable that draws a square of half a metre around its origin in the colour of its leaf.
const SQUARE: &str = "
struct Varying { @builtin(position) clip: vec4<f32>, @location(0) color: vec4<f32> }

@vertex
fn vs_square(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Varying {
    let corner = vec2<f32>(f32(vertex & 1u), f32(vertex >> 1u)) - 0.5;
    let leaf = leaves[instance];
    let in_eye = point_in_eye(leaf, vec3<f32>(corner, 0.0));
    return Varying(frame.clip_from_eye * vec4<f32>(in_eye, 1.0), leaf.color);
}

@fragment
fn fs_square(in: Varying) -> @location(0) vec4<f32> {
    return in.color;
}
";

/// The calls that a square has received, in order.
type Said = Arc<Mutex<Vec<String>>>;
/// True to report an error while drawing.
type Tell = Arc<dyn Fn(&DrawableInfo<'_>) -> String + Send + Sync>;

#[derive(Clone)]
struct Square {
    said: Said,
    wgsl: String,
    tell: Tell,
    /// The faults of the square.
    fails: &'static str,
    compile_time: Duration,
    alive: Arc<AtomicU32>,
}

impl Square {
    fn new() -> Self {
        Self {
            said: Said::default(),
            wgsl: SQUARE.into(),
            tell: Arc::new(|info| format!("draw {}", info.instances.len())),
            fails: "",
            compile_time: Duration::ZERO,
            alive: Arc::default(),
        }
    }

    fn telling(tell: impl Fn(&DrawableInfo<'_>) -> String + Send + Sync + 'static) -> Self {
        Self { tell: Arc::new(tell), ..Self::new() }
    }

    fn say(&self, what: String) {
        self.said.lock().unwrap().push(what);
    }

    fn drawable(&self, color: [u8; 3]) -> Drawable {
        let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
        let material = Material { base_color: [r, g, b, 1.0], ..Material::default() };
        Drawable::new(custom_geometry(self.clone()), material)
    }

    /// Takes the calls so far.
    fn heard(&self) -> Vec<String> {
        std::mem::take(&mut self.said.lock().unwrap())
    }

    /// Takes the calls so far with one `prepare` in a row: the shared rig prepares drawables for the kinds of targets of
    /// earlier tests too.
    fn heard_shared(&self) -> Vec<String> {
        let mut heard = self.heard();
        heard.dedup_by(|a, b| a == b && a == "prepare");
        heard
    }
}

impl CustomDrawable for Square {
    fn name(&self) -> &str {
        "a square"
    }

    fn bounds(&self) -> Aabb {
        Aabb { min: DVec3::new(-0.5, -0.5, 0.0), max: DVec3::new(0.5, 0.5, 0.0) }
    }

    fn compile(&self, info: &CompileInfo<'_>) -> Result<Box<dyn CompiledDrawable>, CustomError> {
        self.say("compile".into());
        std::thread::sleep(self.compile_time);
        if self.fails == "compile" {
            return Err("no square today".into());
        }
        let module = info.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("square"),
            source: wgpu::ShaderSource::Wgsl(format!("{DRAWABLE_PRELUDE}{}", self.wgsl).into()),
        });
        self.alive.fetch_add(1, Relaxed);
        Ok(Box::new(CompiledSquare { of: self.clone(), module, pipelines: Vec::new() }))
    }
}

struct CompiledSquare {
    of: Square,
    module: wgpu::ShaderModule,
    pipelines: Vec<(TargetFormats, wgpu::RenderPipeline)>,
}

impl Drop for CompiledSquare {
    fn drop(&mut self) {
        self.of.alive.fetch_sub(1, Relaxed);
    }
}

impl CompiledDrawable for CompiledSquare {
    fn size_bytes(&self) -> u64 {
        1_000
    }

    fn prepare(&mut self, info: &CompileInfo<'_>, target: &TargetFormats) -> Result<(), CustomError> {
        self.of.say("prepare".into());
        let layout = info.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(info.frame_layout)],
            immediate_size: 0,
        });
        let entry = if self.of.fails == "prepare" { "fs_missing" } else { "fs_square" };
        let targets: Vec<_> = target.colors.iter().map(|f| f.map(wgpu::ColorTargetState::from)).collect();
        let pipeline = info.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: None,
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: None,
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState { topology: wgpu::PrimitiveTopology::TriangleStrip, ..Default::default() },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: target.depth,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::GreaterEqual),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: wgpu::MultisampleState { count: target.samples, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some(entry),
                compilation_options: Default::default(),
                targets: &targets[..targets.iter().rposition(Option::is_some).map_or(0, |last| last + 1)],
            }),
            multiview_mask: None,
            cache: None,
        });
        self.pipelines.push((*target, pipeline));
        Ok(())
    }

    fn draw(&mut self, info: &DrawableInfo<'_>, pass: &mut wgpu::RenderPass<'_>) -> Result<(), CustomError> {
        self.of.say((self.of.tell)(info));
        if self.of.fails == "draw" {
            return Err("out of paint".into());
        }
        let pipeline = self.pipelines.iter().find(|(target, _)| *target == info.target).map(|(_, pipeline)| pipeline);
        pass.set_pipeline(pipeline.ok_or("not prepared")?);
        pass.draw(0..4, info.instances.clone());
        if self.of.fails == "to tidy up" {
            pass.set_viewport(3.0, 5.0, 7.0, 9.0, 0.2, 0.3);
            pass.set_scissor_rect(1, 1, 2, 2);
            pass.set_stencil_reference(77);
            pass.set_blend_constant(wgpu::Color { r: 0.1, g: 0.2, b: 0.3, a: 0.4 });
        }
        Ok(())
    }
}

fn at(x: f64, y: f64, z: f64, drawables: Vec<Drawable>) -> Node {
    Node::transform(DAffine3::from_translation(DVec3::new(x, y, z)), vec![Node::geode(drawables)])
}

fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    picture
}

fn in_bin(number: i32, set: StateSet) -> Arc<StateSet> {
    Arc::new(StateSet { bin: Some(BinDetails::new(number, SortMode::ByState)), ..set })
}

#[test]
fn custom_drawables_are_drawn_like_others() {
    let Some(mut rig) = rig("custom_drawables_are_drawn_like_others") else { return };
    let rig = &mut *rig;
    let square = Square::new();
    let usual = |[r, g, b]: [u8; 3]| quad([0.0; 3], [0.5, 0.5], [r, g, b, 255].map(|c| f32::from(c) / 255.0));
    let scene = |green: Drawable| {
        vec![
            at(-0.3, 0.2, -0.5, vec![usual(RED)]),
            at(0.1, 0.0, 0.0, vec![green]),
            at(0.4, -0.3, 0.5, vec![usual(BLUE)]),
        ]
    };
    let picture = draw(rig, scene(square.drawable(GREEN)));
    assert_eq!(picture, draw(rig, scene(usual(GREEN))), "hidden and hiding like a mesh");
    assert!([RED, GREEN, BLUE].iter().all(|c| count(&picture, *c) > 200));
    // It is compiled for the context's target before its first frame.
    assert_eq!(square.heard_shared(), ["compile", "prepare", "draw 1"]);
    assert_eq!(square.alive.load(Relaxed), 0, "released");

    // Outside of the frustum it is not called.
    draw(rig, vec![at(9.0, 0.0, 0.0, vec![square.drawable(GREEN)])]);
    assert_eq!(square.heard_shared(), ["compile", "prepare"]);
    assert!(rig.renderer.take_errors().is_empty());
}

#[test]
fn state_set_by_a_drawable_is_restored_for_the_next_leaf() {
    let Some(mut rig) = rig("state_set_by_a_drawable_is_restored_for_the_next_leaf") else { return };
    let rig = &mut *rig;
    let face = StencilFace { pass: StencilOperation::Replace, ..StencilFace::default() };
    let marked = |reference: u8| {
        let stencil = Stencil { reference, front: face, back: face, ..Stencil::default() };
        StateSet::default().with(Attribute::Stencil(stencil))
    };
    let equal_0 = StencilFace { function: CompareFunction::Equal, ..StencilFace::default() };
    let where_0 = Stencil { reference: 0, front: equal_0, back: equal_0, ..Stencil::default() };
    let scene = |fails: &'static str| {
        let square = Square { fails, ..Square::new() };
        let mut nodes = vec![
            at(0.0, 0.0, -1.0, vec![quad([0.0; 3], [1.2, 1.2], [1.0, 0.0, 0.0, 1.0])])
                .with_state_set(in_bin(0, marked(0))),
            at(0.5, 0.5, 0.0, vec![square.drawable(GREEN)]).with_state_set(in_bin(1, StateSet::default())),
            // It is drawn where the stencil is 0, which is everywhere if the reference is set again.
            at(-0.5, -0.5, 0.0, vec![quad([0.0; 3], [0.4, 0.4], [0.0, 0.0, 1.0, 1.0])])
                .with_state_set(in_bin(2, StateSet::default().with(Attribute::Stencil(where_0)))),
        ];
        let scissor = Scissor { x: 0, y: 0, width: 20, height: 64 };
        nodes.push(
            at(-0.5, 0.5, 0.0, vec![quad([0.0; 3], [0.4, 0.4], [0.0, 1.0, 1.0, 1.0])])
                .with_state_set(in_bin(3, StateSet::default().with(Attribute::Scissor(scissor)))),
        );
        nodes
    };
    let tidy = draw(rig, scene(""));
    assert_eq!(pixel(&tidy, 16, 48), BLUE);
    assert_eq!(draw(rig, scene("to tidy up")), tidy);
    assert!(rig.renderer.take_errors().is_empty());
}

#[test]
fn drawable_receives_its_transform_and_state() {
    let Some(mut rig) = rig("drawable_receives_its_transform_and_state") else { return };
    let rig = &mut *rig;
    // The position of the square's corner on the screen by the matrices, and the number from its state set.
    let square = Square::telling(|info| {
        let camera = &info.render.stage.camera;
        assert_eq!(camera.viewport_px, [SIDE, SIDE]);
        assert_eq!(info.viewport_px, [0.0, 0.0, 64.0, 64.0]);
        let number = match info.state.uniform("number").map(|u| &u.value) {
            Some(UniformValue::Int(number)) => *number,
            _ => -1,
        };
        let places = info.eye_from_drawable().map(|eye_from_drawable| {
            let clip = info.clip_from_eye.as_mat4() * eye_from_drawable * Vec4::new(0.0, 0.0, 0.0, 1.0);
            let px = (clip.truncate() / clip.w * 32.0 + 32.0).round();
            format!("{}/{}", px.x, px.y)
        });
        let colors = info.colors().map(|c| format!("{:?}", c.map(|c| c as u8)));
        format!("{number} at {:?} in {:?}", places.collect::<Vec<_>>(), colors.collect::<Vec<_>>())
    });
    let numbered = |number: i32| {
        let mut set = StateSet::default();
        set.set_uniform("number", UniformValue::Int(number), StateValue::ON);
        Arc::new(set)
    };
    let scene = rig.scene(Node::group(vec![
        at(-0.5, 0.0, 0.0, vec![square.drawable(RED)]).with_state_set(numbered(1)),
        at(0.5, 0.5, 0.0, vec![square.drawable(BLUE)]).with_state_set(numbered(2)),
        Node::new(NodeKind::Projection(DMat4::from_scale(DVec3::new(0.5, 0.5, 0.1)))).with_child(at(
            1.0,
            0.0,
            -5.0,
            vec![square.drawable(GREEN)],
        )),
    ]));
    rig.draw(&scene, &unit_camera(SIDE), &plain());
    let mut heard = square.heard_shared();
    heard.retain(|s| s.contains(" at "));
    heard.sort();
    assert_eq!(
        heard,
        [
            "-1 at [\"48/32\"] in [\"[0, 1, 0, 1]\"]",
            "1 at [\"16/32\"] in [\"[1, 0, 0, 1]\"]",
            "2 at [\"48/48\"] in [\"[0, 0, 1, 1]\"]",
        ]
    );
    rig.release(scene);

    // Two leaves of one drawable are two instances in one draw call.
    let places = [[0.5, 0.0], [0.0, -0.5]].map(|[x, y]| at(x, y, 0.0, vec![square.drawable(GREEN)]));
    let mut page = Page::from_node(Node::group(places.to_vec())).unwrap();
    let compiled = rig.compile(page.take_drawables().drain(..1).collect());
    page.set_draw_slots(0, vec![compiled.slots[0]; 2]);
    let mut scene = Scene::new();
    scene.add_root(page);
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    assert_eq!(count(&picture, GREEN), 2 * 32 * 32 - 16 * 16);
    let heard = square.heard_shared();
    assert!(heard[2].starts_with("-1 at [\"48/32\", \"32/16\"] in "), "{heard:?}");
    assert_eq!(heard.len(), 3);
    rig.ctx.release(&compiled.slots);
    rig.ctx.flush_released();
    assert!(rig.renderer.take_errors().is_empty());
}

#[test]
fn errors_are_reported_once_and_the_rest_is_drawn() {
    let Some(mut rig) = rig("errors_are_reported_once_and_the_rest_is_drawn") else { return };
    let rig = &mut *rig;
    let beside = || at(-0.5, 0.0, 0.0, vec![quad([0.0; 3], [0.4, 0.4], [1.0, 0.0, 0.0, 1.0])]);
    for (fails, wgsl, wanted) in [
        ("compile", SQUARE, "\"a square\" cannot be compiled: no square today"),
        ("", "this is no WGSL", "\"a square\" cannot be compiled: "),
        ("prepare", SQUARE, "\"a square\" cannot be drawn into TargetFormats"),
        ("draw", SQUARE, "\"a square\" was not drawn: out of paint"),
    ] {
        let square = Square { fails, wgsl: wgsl.into(), ..Square::new() };
        let nodes = vec![at(0.5, 0.0, 0.0, vec![square.drawable(GREEN)]), beside()];
        let mut page = Page::from_node(Node::group(nodes)).unwrap();
        let compiled = rig.compile(page.take_drawables());
        page.set_draw_slots(0, compiled.slots);
        let mut scene = Scene::new();
        scene.add_root(page);
        let mut errors = compiled.errors;
        for _ in 0..3 {
            // `draw` of the rig fails if the device reports an error.
            let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
            assert!(count(&picture, RED) > 400, "{wanted}");
            assert_eq!(count(&picture, GREEN), 0, "{wanted}");
        }
        errors.extend(rig.renderer.take_errors());
        assert!(matches!(&errors[..], [e] if e.contains(wanted)), "{wanted}: {errors:?}");
        rig.release(scene);
        assert_eq!(square.alive.load(Relaxed), 0);
    }
}

#[test]
fn drawable_is_compiled_within_the_budget() {
    let Some(mut rig) = new_rig([SIDE, SIDE]) else { return };
    let before = rig.ctx.bytes_in_use();
    let square = Square { compile_time: Duration::from_millis(3), ..Square::new() };
    let drawables = (0..5).map(|_| square.drawable(RED)).collect();
    rig.ctx.compile(CompileOperation { ticket: 1, drawables });
    for so_far in 1..=5 {
        let budget = CompileBudget { time: Duration::from_millis(2), bytes: u64::MAX };
        let stats = rig.ctx.run_compiles(&budget);
        assert_eq!((stats.slices, stats.bytes), (1, 1_000));
        assert_eq!(square.alive.load(Relaxed), so_far);
    }
    let compiled = rig.ctx.take_compiled().remove(0);
    assert_eq!((compiled.bytes, rig.ctx.bytes_in_use() - before), (5_000, 5_000));
    rig.ctx.release(&compiled.slots);
    rig.ctx.flush_released();
    assert_eq!((square.alive.load(Relaxed), rig.ctx.bytes_in_use()), (0, before));
}

#[test]
fn drawable_is_compiled_for_all_kinds_of_targets() {
    let Some(mut rig) = new_rig([SIDE, SIDE]) else { return };
    let square = Square::new();
    let texture = TextureObject::target("picture", [SIDE, SIDE], TextureFormat::Rgba16Float);
    let camera = unit_camera(SIDE);
    let rtt = CameraNode::to_texture(texture.clone(), camera.eye_from_world, camera.clip_from_eye);
    let rtt = Node::new(NodeKind::Camera(Box::new(rtt))).with_child(at(0.0, 0.0, 0.0, vec![square.drawable(GREEN)]));
    let shown = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(texture)));
    let screen = Node::geode(vec![quad([0.0; 3], [1.0, 1.0], [1.0; 4])]).with_state_set(Arc::new(shown));
    let scene = rig.scene(Node::group(vec![rtt, screen]));
    let stats = [(); 2].map(|()| rig.draw(&scene, &camera, &plain()));
    assert_eq!(square.heard(), ["compile", "prepare", "prepare", "draw 1", "draw 1"]);
    // One for the texture, and one for the screen.
    assert_eq!(stats.map(|s| s.pipelines_created), [2, 0]);
    assert_eq!(count(&rig.read_back(), GREEN), 32 * 32);
    rig.release(scene);
    // Later uploads are compiled for both targets.
    let compiled = rig.compile(vec![square.drawable(RED)]);
    assert_eq!(square.heard(), ["compile", "prepare", "prepare"]);
    rig.ctx.release(&compiled.slots);
    rig.ctx.flush_released();
    assert!(rig.renderer.take_errors().is_empty());
}

#[test]
fn drawable_casts_no_shadow_is_blended_late_and_does_not_fade() {
    let test = "drawable_casts_no_shadow_is_blended_late_and_does_not_fade";
    let Some(mut rig) = rig(test) else { return };
    let rig = &mut *rig;
    let square = Square::new();
    let mut glass = square.drawable(GREEN);
    glass.material.alpha = AlphaMode::Blend;
    // It is in the transparent bin.
    let scene = rig.scene(Node::group(vec![
        at(0.0, 0.0, 1.0, vec![glass]),
        at(0.0, 0.0, 0.0, vec![quad([0.0; 3], [1.0, 1.0], [0.0, 0.0, 1.0, 1.0])]),
    ]));
    let sunny = Environment { sun_direction: DVec3::new(0.3, 0.2, 1.0).normalize(), shadows: small_maps(), ..plain() };
    rig.draw(&scene, &unit_camera(SIDE), &sunny);
    assert_eq!(rig.stage.bins.len(), 2);
    assert!(!rig.stage.shadows.cascades.is_empty());
    assert_eq!(square.heard_shared(), ["compile", "prepare", "draw 1"]);
    assert!(count(&rig.read_back(), GREEN) > 900);
    rig.release(scene);

    // Between two levels it is fully visible in the first half of the fade and invisible in the second.
    let lod = NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[0.0, 15.0], [15.0, 1e9]] };
    let level = |color| Node::geode(vec![square.drawable(color)]);
    let scene = rig.scene(Node::new(lod).with_child(level(RED)).with_child(level(BLUE)));
    let seen = |rig: &mut Rig, time_s: f64, lod_scale: f64| {
        let settings = CullSettings { lod_scale, lod_fade_s: 1.0, ..CullSettings::default() };
        let camera = terrane::cull::CullCamera { simulation_time_s: time_s, settings, ..unit_camera(SIDE) };
        let picture = rig.picture(&scene, &camera, &plain());
        [RED, BLUE, MAGENTA].map(|c| count(&picture, c))
    };
    let all = (SIDE * SIDE) as usize;
    let squares = all / 4;
    assert_eq!(seen(rig, 0.0, 1.0), [squares, 0, all - squares]);
    let shares = (1..9).map(|i| seen(rig, f64::from(i) * 0.125, 2.0));
    let shares: Vec<_> = shares.collect();
    assert!(shares.iter().all(|[red, blue, _]| red + blue == squares && red * blue == 0), "{shares:?}");
    assert!(shares[1][0] > 0 && shares[7][1] > 0, "{shares:?}");
    rig.release(scene);
    assert!(rig.renderer.take_errors().is_empty());
}
