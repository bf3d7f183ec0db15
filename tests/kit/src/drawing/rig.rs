//! The GPU rig: a context on [`crate::adapter`] with its renderer and a cull visitor, and cameras for it.

use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::draw::{DrawStats, Renderer};
use terrane::gpu::{AdapterChoice, CompileBudget, CompileOperation, Compiled, ContextTraits, GraphicsContext};
use terrane::scene::{DistanceFog, Drawable, Environment, Node, Page, Scene, Sky};

use crate::frames::MAGENTA;
use crate::skip::{or_skip, skipped};

/// A context with its renderer, a cull visitor and the stage that it fills.
pub struct Rig {
    /// The context.
    pub ctx: GraphicsContext,
    /// The context's renderer.
    pub renderer: Renderer,
    /// The visitor of all culls.
    pub visitor: CullVisitor,
    /// Result of the last cull.
    pub stage: RenderStage,
    ticket: u64,
}

impl Rig {
    /// Creates a rig of a context, with a renderer.
    pub fn new(mut ctx: GraphicsContext) -> Self {
        let renderer = Renderer::new(&mut ctx);
        Self { ctx, renderer, visitor: CullVisitor::new(), stage: RenderStage::new(), ticket: 0 }
    }

    /// Uploads drawables within the call.
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

    /// Returns a scene of one page whose drawables are uploaded.
    pub fn scene(&mut self, root: Node) -> Scene {
        let mut page = Page::from_node(root).unwrap();
        let compiled = self.compile(page.take_drawables());
        assert!(compiled.errors.is_empty(), "{:?}", compiled.errors);
        page.set_draw_slots(0, compiled.slots);
        let mut scene = Scene::new();
        scene.add_root(page);
        scene
    }

    /// Releases the uploaded drawables of a scene and frees their memory at once.
    pub fn release(&mut self, mut scene: Scene) {
        for id in scene.roots().to_vec() {
            for (_, slots) in scene.remove_root(id).unwrap().take_draw_slots() {
                self.ctx.release(&slots);
            }
        }
        self.ctx.flush_released();
    }

    /// Culls and draws a frame; panics if the device reports an error.
    pub fn draw(&mut self, scene: &Scene, camera: &CullCamera, environment: &Environment) -> DrawStats {
        self.ctx.resize(camera.viewport_px).unwrap();
        self.visitor.environment = Some(*environment);
        self.visitor.cull(scene, camera, &mut self.stage);
        let stats = self.renderer.draw(&mut self.ctx, &self.stage, environment).unwrap();
        let errors = self.ctx.take_device_errors();
        assert!(errors.is_empty(), "{errors:?}");
        stats
    }

    /// Draws a frame and reads it back.
    pub fn picture(&mut self, scene: &Scene, camera: &CullCamera, environment: &Environment) -> RgbaImage {
        self.draw(scene, camera, environment);
        self.read_back()
    }

    /// Reads back the last frame.
    pub fn read_back(&mut self) -> RgbaImage {
        self.renderer.read_back(&mut self.ctx).unwrap()
    }
}

/// Locks the process's only rig; returns `None`, and skips the test, if there is no adapter.
///
/// Tests that use it run one at a time. A test that needs a new context takes [`new_rig`].
pub fn rig(test: &str) -> Option<MutexGuard<'static, Rig>> {
    static RIG: OnceLock<Option<Mutex<Rig>>> = OnceLock::new();
    let rig = RIG.get_or_init(|| new_rig([256, 256]).map(Mutex::new));
    match rig {
        Some(rig) => Some(rig.lock().unwrap_or_else(PoisonError::into_inner)),
        None => {
            skipped(format!("{test}: no adapter"));
            None
        }
    }
}

/// Creates a rig on [`crate::adapter`]; returns `None`, and skips the test, if there is none.
pub fn new_rig(size_px: [u32; 2]) -> Option<Rig> {
    rig_with(&ContextTraits { validation: false, ..traits(size_px) })
}

/// Creates a rig with given traits; returns `None`, and skips the test, if there is no adapter.
pub fn rig_with(traits: &ContextTraits) -> Option<Rig> {
    or_skip(GraphicsContext::new_offscreen(traits)).map(Rig::new)
}

/// Returns the traits of a context on [`crate::adapter`].
pub fn traits(size_px: [u32; 2]) -> ContextTraits {
    ContextTraits { size_px, adapter: crate::adapter(), ..ContextTraits::default() }
}

/// Returns the traits of a context on wgpu's backend that executes nothing.
pub fn noop_traits(size_px: [u32; 2]) -> ContextTraits {
    ContextTraits { size_px, adapter: AdapterChoice::Noop, validation: false, ..ContextTraits::default() }
}

/// Returns an environment without haze and tone mapping, with a magenta background and z up.
pub fn plain() -> Environment {
    Environment {
        sky: Sky::Background(MAGENTA),
        fog: DistanceFog { enabled: false, density_per_m: 0.0 },
        exposure: None,
        ..Environment::default()
    }
}

/// Returns a camera at `eye` that looks at `target`, with a field of view of one radian.
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

/// Returns a camera whose image spans -1 to 1 in x and y of the plane z = 0. It is a perspective camera at a distance
/// of 10.
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
