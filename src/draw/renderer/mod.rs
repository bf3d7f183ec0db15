//! The renderer: executes a stage, and the stages before and after it, on a context. Draw thread only.
//!
//! ```text
//! draw_views      acquire      the image of the window
//!                 rehearse     views that later frames draw with other pipelines
//!                 prepare      every pass of every stage: runs, uniforms, pipelines, targets
//!                 upload       leaves, uniforms, arguments of indirect calls; bind groups
//!                 record       all passes into one encoder, and submit it
//!                 throttle     wait while the adapter is two frames behind
//!                 deliver      results that were read back
//! ```

mod drawn_stages;
mod frames_in_flight;
mod pass_plan;
mod prepare;
mod prewarm;
mod record;
mod rehearsal;
mod views;

use std::sync::Arc;

use crate::cull::RenderStage;
use crate::draw::callbacks::info::FrameClock;
use crate::draw::passes::Passes;
use crate::draw::resources::Resources;
use crate::draw::stats::DrawStats;
use crate::draw::targets::table::Targets;
use crate::gpu::{Acquired, GpuError, GraphicsContext};
use crate::scene::{Environment, Texture};
use crate::state::TextureObject;
use drawn_stages::DrawnStages;
use frames_in_flight::FramesInFlight;
use pass_plan::PassPlan;
pub(crate) use prewarm::StageKinds;
pub use prewarm::ViewChange;
use rehearsal::Rehearsals;
pub(crate) use rehearsal::draws_alike;
use views::StageViews;

/// A camera's view in a frame: its stage under its own light and sky.
#[derive(Clone, Copy, Debug)]
pub struct CameraView<'a> {
    /// The camera's stage.
    pub stage: &'a RenderStage,
    /// Sun, sky and fog.
    pub environment: &'a Environment,
}

/// Executes render stages on one [`GraphicsContext`], on the thread that owns both: the only one that may use the device's queue.
/// Colours are linear until the last pass, positions relative to the eye in metres.
pub struct Renderer {
    resources: Resources,
    passes: Passes,
    targets: Targets,
    /// The views of the stage that is being prepared.
    views: StageViews,
    /// The stages of the frame in the order drawn; `None` for refused ones.
    plans: Vec<Option<PassPlan>>,
    drawn_into: DrawnStages,
    rehearsals: Rehearsals,
    /// The ordered pipelines that earlier draws have counted.
    counted_by_thread: u32,
    frames_in_flight: FramesInFlight,
    /// Command buffers of the compile thread, which are submitted before the frame.
    uploads: Vec<wgpu::CommandBuffer>,
    /// Leaves of stages that the last frame has drawn alike wait for their pipelines, and are left out until then.
    pub(crate) hides_unready: bool,
    /// Times that programs see; the caller sets them before each draw.
    pub clock: FrameClock,
    /// Numbers of the context and of the frame that are drawn next, for the timeline.
    pub(crate) timed: (u32, u32),
}

impl Renderer {
    /// Creates a renderer for a context. No pipeline is created yet, and no memory is used but for some texels.
    pub fn new(ctx: &mut GraphicsContext) -> Self {
        let resources = Resources::new(ctx);
        let device = ctx.device();
        Self {
            resources,
            passes: Passes::new(device),
            targets: Targets::new(device),
            views: StageViews::default(),
            plans: Vec::new(),
            drawn_into: DrawnStages::default(),
            rehearsals: Rehearsals::default(),
            counted_by_thread: 0,
            frames_in_flight: FramesInFlight::default(),
            uploads: Vec::new(),
            hides_unready: false,
            clock: FrameClock::default(),
            timed: (0, 0),
        }
    }

    /// Writes an image to a texture of state sets, which takes the image's size. Later draws show it.
    pub(crate) fn show_image(
        &mut self,
        ctx: &GraphicsContext,
        texture: &Arc<TextureObject>,
        image: &Texture,
    ) -> Result<(), String> {
        self.resources.state_groups.show(ctx, texture, image)
    }

    /// Returns errors of drawing since the last call: programs that do not compile, textures that do not fit, targets that
    /// cannot be drawn into. Each is reported, and logged, once.
    pub fn take_errors(&mut self) -> Vec<String> {
        self.resources.errors.take()
    }

    /// Logs an error and keeps it for [`Self::take_errors`], unless it was reported before.
    pub(crate) fn report_once(&mut self, error: String) {
        self.resources.errors.report_once(error);
    }

    /// Returns the time of each pass on the adapter in milliseconds, in the order drawn, of the latest frame whose
    /// timestamps have arrived.
    pub fn pass_ms(&mut self) -> &[f64] {
        let context = self.timed.0;
        self.resources.timer.as_mut().map_or(&[], |timer| {
            timer.read();
            timer.latest_ms(context)
        })
    }

    /// Draws a stage into the context's target, and the stages before and after it into theirs: clears, executes the
    /// bins in order, and puts the sky behind the opaque ones. Afterwards more can be drawn over the image
    /// ([`GraphicsContext::color_view`]), and it can be read back or presented. Waits while the adapter is two frames
    /// behind.
    pub fn draw(
        &mut self,
        ctx: &mut GraphicsContext,
        stage: &RenderStage,
        environment: &Environment,
    ) -> Result<DrawStats, GpuError> {
        self.draw_views(ctx, std::iter::once(CameraView { stage, environment }))
    }

    /// Does the same as [`Self::draw`] for several views in parts of the same target. Each is drawn into the viewport of
    /// its stage, one after the other, and all of them are submitted together.
    pub fn draw_views<'a>(
        &mut self,
        ctx: &mut GraphicsContext,
        views: impl Iterator<Item = CameraView<'a>> + Clone,
    ) -> Result<DrawStats, GpuError> {
        let _span = crate::trace::span("draw");
        let acquire = crate::trace::span("acquire");
        if ctx.acquire()? == Acquired::Skip {
            return Ok(DrawStats { skipped: true, ..Default::default() });
        }
        drop(acquire);
        ctx.before_submit(&mut self.uploads);
        for texture in ctx.take_compiled_textures() {
            self.resources.state_groups.textures.uploaded(&texture);
        }
        for target in self.drawn_into.targets() {
            if let Some(formats) = self.resources.pipelines.target_formats(target) {
                ctx.add_target_formats(formats);
            }
        }
        let shared = ctx;
        let ctx = &*shared;
        let created_before = self.created_pipelines();
        self.rehearse(ctx);
        self.prepare(ctx, views.clone());
        self.upload(ctx);
        self.record(ctx, views);
        let mut stats = self.resources.stats;
        stats.unsampled_leaves = self.resources.batch.unsampled();
        stats.pipelines_created += self.created_pipelines() - created_before;
        let thread = &self.resources.pipelines.pipeline_thread;
        stats.pipelines_created_by_thread =
            thread.created() - std::mem::replace(&mut self.counted_by_thread, thread.created());
        stats.pipelines_in_creation = thread.open();
        let wait = crate::trace::span("wait for adapter");
        self.frames_in_flight.throttle(ctx)?;
        drop(wait);
        let passes_ms = self.pass_ms();
        stats.gpu_ms = (!passes_ms.is_empty()).then(|| passes_ms.iter().sum());
        self.passes.queries.deliver();
        self.passes.readback.deliver();
        shared.set_texture_bytes(self.resources.state_groups.textures.bytes());
        Ok(stats)
    }

    /// Returns the number of pipelines created on the draw thread so far.
    fn created_pipelines(&self) -> u32 {
        self.resources.pipelines.created() + self.passes.created_pipelines()
    }

    /// Returns the image drawn last, top row first. Waits for the adapter. A window's image can be read between draw and
    /// present if the platform lets images be copied.
    pub fn read_back(&mut self, ctx: &mut GraphicsContext) -> Result<image::RgbaImage, GpuError> {
        let _span = crate::trace::span("read back");
        ctx.read_back()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::cull::{CullCamera, CullVisitor};
    use crate::draw::batch::bucket::Content;
    use crate::gpu::{AdapterChoice, CompileBudget, CompileOperation, ContextTraits};
    use crate::scene::{AlphaMode, CullingMode, Drawable, Material, Mesh, Node, Page, Scene};
    use crate::state::{Attribute, BinDetails, CullFace, Scissor, SortMode, StateSet, SurfaceMaterial};
    use glam::{DAffine3, DVec3};

    /// Returns how often a value changes along the runs; the first value counts.
    fn changes<T: PartialEq>(values: impl Iterator<Item = T>) -> u32 {
        let mut last = None;
        let mut count = 0;
        for value in values {
            if last.as_ref() != Some(&value) {
                count += 1;
                last = Some(value);
            }
        }
        count
    }

    #[test]
    fn state_is_set_as_rarely_as_the_order_allows() {
        let traits = ContextTraits { size_px: [64, 64], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut renderer = Renderer::new(&mut ctx);
        // Small and large meshes, some of them blended, under state sets with random differences.
        let mut seed = 12345u32;
        let mut random = |below: u32| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 16) % below
        };
        let sets: Vec<_> = (0..24)
            .map(|i| {
                let mut set = StateSet::default();
                if random(2) == 0 {
                    set = set.with(Attribute::CullFace(CullFace::Front));
                }
                if random(3) == 0 {
                    let material = SurfaceMaterial { shininess: i as f32, ..SurfaceMaterial::default() };
                    set = set.with(Attribute::SurfaceMaterial(material));
                }
                if random(3) == 0 {
                    set = set.with(Attribute::Scissor(Scissor { x: i, y: 0, width: 9, height: 9 }));
                }
                if random(3) == 0 {
                    let sort = [SortMode::ByState, SortMode::BackToFront, SortMode::FrontToBack][random(3) as usize];
                    set.bin = Some(BinDetails::new(random(3) as i32 - 1, sort));
                }
                Arc::new(set)
            })
            .collect();
        let nodes = (0..600)
            .map(|_| {
                let mesh = Mesh::sphere(DVec3::ZERO, 0.1, 3 + 4 * random(6));
                let alpha = if random(5) == 0 { AlphaMode::Blend } else { AlphaMode::Opaque };
                let material = Material { alpha, double_sided: random(2) == 0, ..Material::default() };
                let position =
                    DVec3::new(f64::from(random(9)) - 4.0, f64::from(random(9)) - 4.0, -12.0 - f64::from(random(40)));
                let geode = Node::geode(vec![Drawable::new(mesh.into(), material)]);
                let geode = geode.with_state_set(sets[random(24) as usize].clone());
                Node::transform(DAffine3::from_translation(position), vec![geode])
            })
            .collect();
        let mut page = Page::from_node(Node::group(nodes)).unwrap();
        ctx.compile(CompileOperation { ticket: 0, drawables: page.take_drawables() });
        ctx.run_compiles(&CompileBudget::UNLIMITED);
        page.set_draw_slots(0, ctx.take_compiled().remove(0).slots);
        let mut scene = Scene::new();
        scene.add_root(page);
        let mut stage = RenderStage::new();
        CullVisitor::new().cull(&scene, &CullCamera::default(), &mut stage);
        let environment = Environment { sky: crate::scene::Sky::Background([0; 3]), ..Environment::default() };
        renderer.draw(&mut ctx, &stage, &environment).unwrap();
        let stats = renderer.draw(&mut ctx, &stage, &environment).unwrap();
        assert!(renderer.take_errors().is_empty());
        assert!(stats.unsampled_leaves > 50, "some are small: {stats:?}");
        assert_eq!((stats.leaves + stats.unsampled_leaves) as usize, stage.leaf_count());

        let (batch, states) = (&renderer.resources.batch, &renderer.resources.bound_states);
        let buckets = || batch.runs().iter().map(|run| *batch.bucket(run.bucket));
        let bound = || buckets().map(|(b, _)| *states.get(b.bound).unwrap());
        let is_pulled = |content| matches!(content, Content::PulledMesh { .. });
        let direct = || buckets().filter(|(b, _)| !is_pulled(b.content));
        let pulled = || buckets().filter(|(b, _)| is_pulled(b.content));
        let initial = std::iter::once([0u32, 0, 64, 64]);
        let scissors = changes(initial.chain(bound().map(|s| s.dynamics.scissor))) - 1;
        let expected = changes(buckets().map(|(_, pipeline)| pipeline))
            + changes(buckets().map(|(b, _)| (b.content == Content::Height, b.block)))
            + changes(direct().map(|(b, _)| b.vertex_chunk))
            + changes(direct().map(|(b, _)| b.index_chunk))
            + changes(pulled().map(|(b, _)| (b.vertex_chunk, b.index_chunk)))
            // The colour that packed vertices share is set once.
            + u32::from(direct().any(|(b, _)| b.pipeline.is_white()))
            + changes(bound().map(|s| s.frame))
            + changes(bound().filter_map(|s| s.group))
            + scissors;
        assert!(expected > 40, "the scene has many states: {expected}");
        assert_eq!(stats.state_changes, expected);

        // Leaves that the adapter's buffer has no room for are dropped, which is reported.
        renderer.resources.leaf_buffer.limit(150);
        let mut camera = CullCamera::default();
        camera.settings.culling = CullingMode::VIEW_FRUSTUM;
        CullVisitor::new().cull(&scene, &camera, &mut stage);
        let stats = renderer.draw(&mut ctx, &stage, &environment).unwrap();
        assert_eq!((stats.leaves, stats.leaves_dropped as usize), (150, stage.leaf_count() - 150));
        let errors = renderer.take_errors();
        assert!(matches!(&errors[..], [e] if e.contains("more leaves than")), "{errors:?}");
        // It is reported once, although the number of dropped leaves differs. New errors are reported after many others.
        renderer.resources.leaf_buffer.limit(149);
        renderer.draw(&mut ctx, &stage, &environment).unwrap();
        assert!(renderer.take_errors().is_empty());
        (0..2000).for_each(|i| renderer.report_once(format!("another {i}")));
        renderer.take_errors();
        renderer.report_once("last".to_owned());
        assert_eq!(renderer.take_errors(), ["last"]);

        // Shadow casters are dropped before visible leaves.
        let lit = Environment { shadows: Some(crate::scene::SunShadows::default()), ..environment };
        let mut visitor = CullVisitor::new();
        visitor.environment = Some(lit);
        visitor.cull(&scene, &camera, &mut stage);
        let own = stage.leaf_count();
        renderer.resources.leaf_buffer.limit(usize::MAX);
        let all = renderer.draw(&mut ctx, &stage, &lit).unwrap();
        assert!(all.shadow_leaves > 20 && all.leaves_dropped + all.shadow_leaves_dropped == 0, "{all:?}");
        renderer.resources.leaf_buffer.limit(own + 11);
        let some = renderer.draw(&mut ctx, &stage, &lit).unwrap();
        assert_eq!((some.leaves, some.leaves_dropped, some.shadow_leaves), (all.leaves, 0, 10));
        assert_eq!(some.shadow_leaves_dropped, all.shadow_leaves - 10);
        renderer.resources.leaf_buffer.limit(own);
        let few = renderer.draw(&mut ctx, &stage, &lit).unwrap();
        assert_eq!((few.leaves, few.leaves_dropped, few.shadow_leaves), (all.leaves, 0, 0));
        let errors = renderer.take_errors();
        assert!(matches!(&errors[..], [e] if e.contains("cast no shadow")), "{errors:?}");
    }
}
