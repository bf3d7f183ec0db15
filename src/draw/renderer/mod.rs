//! The renderer: executes a stage, and those before and after it, on a context.
//!
//! Draw thread only. First everything is prepared (runs, uniforms, pipelines, targets), uploaded at once, then all
//! passes are recorded into one encoder:
//!
//! ```text
//! record(stage)   initial callback, stages before, casters of shadows, pass, copies to be read back, stages after, final callback
//!         pass    clear, pre callback, opaque runs, occlusion queries, sky, what writes no depth, post callback
//! ```

pub(super) mod prepare;
mod prewarm;
mod record;
pub(super) mod shadows;
mod upload;
mod views;

use std::collections::{HashSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use crate::cull::RenderStage;
use crate::draw::answers::{PictureReads, Queries, Read};
use crate::draw::atmosphere::Atmosphere;
use crate::draw::batch::Batch;
use crate::draw::composite::Composite;
use crate::draw::pipelines::Pipelines;
use crate::draw::plan::{StagePlan, Targets};
use crate::draw::resolve::DepthResolve;
use crate::draw::shadow_maps::ShadowMaps;
use crate::draw::spread::Spread;
use crate::draw::state::Statics;
use crate::draw::uniforms::frame::LeafUniform;
use crate::draw::uniforms::groups::Groups;
use crate::draw::uniforms::pulls::Pulls;
use crate::gpu::{Acquired, FrameTimer, GpuError, GraphicsContext};
use crate::scene::{Environment, Texture};
use crate::state::TextureObject;
use prewarm::DrawnInto;
use shadows::CasterPlan;
use views::{LitView, ViewFrame};

/// Frames the processor may be ahead of the adapter, in each target.
const FRAMES_IN_FLIGHT: usize = 2;
/// A frame that takes longer than this has hung.
const FRAME_TIMEOUT: Duration = Duration::from_secs(60);
/// Errors kept until somebody asks.
const MOST_ERRORS: usize = 64;

/// What a draw did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DrawStats {
    /// Leaves drawn; those that cast shadows, boxes of queries and backgrounds are none of them.
    pub leaves: u32,
    /// Leaves that no pixel would have shown, and that were not drawn ([`crate::cull::CullingMode::SAMPLES`]).
    pub unsampled_leaves: u32,
    /// Leaves drawn into shadow maps, once for each cascade.
    pub shadow_leaves: u32,
    /// Leaves that the adapter's largest buffer had no room for, or its memory; those that cast shadows give way first.
    pub leaves_dropped: u32,
    /// The same of those that cast shadows, once for each cascade.
    pub shadow_leaves_dropped: u32,
    /// Draw calls for shadows, which [`Self::draw_calls`] counts too.
    pub shadow_draw_calls: u32,
    /// Draw calls, the sky's among them; several runs drawn by one indirect call count once.
    pub draw_calls: u32,
    /// Pipelines, bind groups, buffers, viewports, scissors and references set.
    pub state_changes: u32,
    /// Those not set because they were set already.
    pub state_changes_skipped: u32,
    /// Triangles submitted.
    pub triangles: u64,
    /// Points submitted.
    pub points: u64,
    /// Passes: the stages that were drawn, and cascades of their shadows.
    pub passes: u32,
    /// Eyes with air of their own beyond the most there may be: they have that of the eye at nearly the same height.
    pub airs_refused: u32,
    /// Stages that were not drawn: what they draw into cannot be, or what all of them are drawn from, which
    /// [`Renderer::take_errors`] says. The picture's own is the whole frame.
    pub stages_refused: u32,
    /// Pipelines made in this draw; each takes long at its first use. What a drawable of the application's own makes for
    /// a target counts as one.
    pub pipelines_created: u32,
    /// Time of all passes on the adapter, of the latest frame whose timestamps have arrived; `None` without
    /// timestamps, and on software adapters, which stop at each of them, unless a timeline is recorded. `None` too where
    /// not all passes of that frame were measured: of 2,048 at most, and not in the first frame that has many more than
    /// those before. [`Renderer::pass_ms`] has them one by one.
    pub gpu_ms: Option<f64>,
    /// The window showed nothing, so nothing was drawn.
    pub skipped: bool,
}

impl DrawStats {
    fn add(&mut self, other: &Self) {
        self.draw_calls += other.draw_calls;
        self.state_changes += other.state_changes;
        self.state_changes_skipped += other.state_changes_skipped;
        self.triangles += other.triangles;
        self.points += other.points;
        self.pipelines_created += other.pipelines_created;
        self.passes += 1;
    }
}

/// Times of the frame for programs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameClock {
    /// Seconds since the first frame.
    pub reference_time_s: f64,
    /// Seconds since the frame before.
    pub delta_s: f64,
    /// Seconds in the application's time.
    pub simulation_time_s: f64,
}

/// A whole picture: what a camera has culled, under its own light and sky.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    /// The camera's stage.
    pub stage: &'a RenderStage,
    /// Sun, sky and fog.
    pub environment: &'a Environment,
}

/// Executes render stages on one [`GraphicsContext`].
pub struct Renderer {
    pipelines: Pipelines,
    groups: Groups,
    targets: Targets,
    atmosphere: Atmosphere,
    /// Made for the first frame, as what binds it.
    leaf_buffer: Option<wgpu::Buffer>,
    /// By place of the air's tables.
    frame_bind_groups: Vec<wgpu::BindGroup>,
    /// The same for passes that draw into the shadow maps.
    caster_bind_group: Option<wgpu::BindGroup>,
    shadow_maps: ShadowMaps,
    /// Something that the bind groups have is another one.
    binds_anew: bool,
    /// Of this frame.
    shadow_leaves: u32,
    leaves_dropped: u32,
    shadow_leaves_dropped: u32,
    /// Leaves that may still cast shadows in this frame.
    caster_room: usize,
    airs_refused: u32,
    stages_refused: u32,
    has_indirect: bool,
    /// Made when there first are runs to be drawn by one call.
    indirect: Option<wgpu::Buffer>,
    indirect_bytes: Vec<u8>,
    /// In the adapter's largest buffer, and in this frame's.
    most_leaves: usize,
    leaf_room: usize,
    batch: Batch,
    pulls: Pulls,
    statics: Vec<Statics>,
    /// Eyes of the views inside a stage, and what is around them; only while it is prepared.
    views: Vec<LitView>,
    /// What these are drawn with, alike.
    view_frames: Vec<ViewFrame>,
    /// Of the last frame.
    drawn_into: Vec<DrawnInto>,
    plans: Vec<StagePlan>,
    /// Of all plans.
    casters: Vec<CasterPlan>,
    /// Leaf, query and statics of boxes to be tested, of all plans.
    query_boxes: Vec<(u32, u32, u32)>,
    timer: Option<FrameTimer>,
    queries: Option<Queries>,
    pictures: PictureReads,
    /// Made when there first are two eyes.
    composite: Option<Composite>,
    /// Made for the first camera that goes on with multisampled colours.
    spread: Option<Spread>,
    /// Made for the first camera that keeps multisampled depth.
    resolve: Option<DepthResolve>,
    in_flight: VecDeque<wgpu::SubmissionIndex>,
    /// Recorded by a compile thread; submitted before the frame.
    uploads: Vec<wgpu::CommandBuffer>,
    /// Times that programs see; set by the caller before each draw.
    pub clock: FrameClock,
    /// Numbers of the context and of the frame that are drawn next, for the timeline.
    pub(crate) timed: (u32, u32),
    errors: Vec<String>,
    /// What was said already.
    said: HashSet<String>,
}

impl Renderer {
    /// A renderer for a context; makes no pipeline yet, and takes no memory but for some texels.
    pub fn new(ctx: &mut GraphicsContext) -> Self {
        let groups = Groups::new(ctx);
        let device = ctx.device();
        let pipelines = Pipelines::new(ctx);
        let limits = device.limits();
        let most_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        Self {
            caster_bind_group: None,
            frame_bind_groups: Vec::new(),
            shadow_maps: ShadowMaps::new(device),
            binds_anew: false,
            shadow_leaves: 0,
            leaves_dropped: 0,
            shadow_leaves_dropped: 0,
            caster_room: 0,
            airs_refused: 0,
            stages_refused: 0,
            atmosphere: Atmosphere::new(device),
            pipelines,
            groups,
            targets: Targets::new(device),
            leaf_buffer: None,
            has_indirect: device.features().contains(wgpu::Features::INDIRECT_FIRST_INSTANCE),
            indirect: None,
            indirect_bytes: Vec::new(),
            leaf_room: 0,
            most_leaves: usize::try_from(most_bytes / size_of::<LeafUniform>() as u64).unwrap_or(usize::MAX),
            batch: Batch::default(),
            pulls: Pulls::default(),
            statics: Vec::new(),
            views: Vec::new(),
            view_frames: Vec::new(),
            drawn_into: Vec::new(),
            plans: Vec::new(),
            casters: Vec::new(),
            query_boxes: Vec::new(),
            timer: FrameTimer::new(ctx),
            queries: None,
            pictures: PictureReads::default(),
            composite: None,
            spread: None,
            resolve: None,
            in_flight: VecDeque::with_capacity(FRAMES_IN_FLIGHT + 1),
            uploads: Vec::new(),
            clock: FrameClock::default(),
            timed: (0, 0),
            errors: Vec::new(),
            said: HashSet::new(),
        }
    }

    /// Writes an image to a texture of state sets, which takes its size: what is drawn from now on shows it.
    pub(crate) fn show_image(
        &mut self,
        ctx: &GraphicsContext,
        texture: &Arc<TextureObject>,
        image: &Texture,
    ) -> Result<(), String> {
        self.groups.show(ctx, texture, image)
    }

    /// What could not be drawn as it should since the last call, each said (and logged) once: programs that do not
    /// compile, textures that do not fit, targets that cannot be drawn into.
    pub fn take_errors(&mut self) -> Vec<String> {
        std::mem::take(&mut self.errors)
    }

    pub(crate) fn complain(&mut self, error: String) {
        if self.said.len() >= 16 * MOST_ERRORS {
            // What is wrong from now on is worth saying, if some of it again.
            self.said.clear();
        }
        if !error.is_empty() && self.said.insert(error.clone()) {
            log::error!("{error}");
            if self.errors.len() < MOST_ERRORS {
                self.errors.push(error);
            }
        }
    }

    /// Milliseconds on the adapter by pass, in the order drawn, of the latest frame that is known.
    pub fn pass_ms(&mut self) -> &[f64] {
        let context = self.timed.0;
        self.timer.as_mut().map_or(&[], |timer| {
            timer.read();
            timer.latest_ms(context)
        })
    }

    /// Draws a stage into the context's target, and the stages before and after it into theirs: clears, executes the
    /// bins in order, puts the sky behind what is opaque. The picture can then be drawn over
    /// ([`GraphicsContext::color_view`]), read back, or presented. Waits while the adapter is two frames behind.
    pub fn draw(
        &mut self,
        ctx: &mut GraphicsContext,
        stage: &RenderStage,
        environment: &Environment,
    ) -> Result<DrawStats, GpuError> {
        self.draw_pictures(ctx, std::iter::once(Picture { stage, environment }))
    }

    /// As [`Self::draw`], for several pictures in parts of the same target: each in its stage's viewport, one after the
    /// other, all of them handed to the adapter together.
    pub fn draw_pictures<'a>(
        &mut self,
        ctx: &mut GraphicsContext,
        pictures: impl Iterator<Item = Picture<'a>> + Clone,
    ) -> Result<DrawStats, GpuError> {
        let _span = crate::timeline::span("draw");
        let acquire = crate::timeline::span("acquire");
        if ctx.acquire()? == Acquired::Skip {
            return Ok(DrawStats { skipped: true, ..Default::default() });
        }
        drop(acquire);
        ctx.submitted(&mut self.uploads);
        for drawn in &self.drawn_into {
            if let Some(formats) = self.pipelines.target_key(drawn.target) {
                ctx.draws_into(formats);
            }
        }
        let ctx = &*ctx;
        let created_before = self.created();
        self.prepare(ctx, pictures.clone());
        if let Err(error) = self.upload(ctx) {
            self.complain(error);
            self.leave_out();
        }
        let mut stats = self.record(ctx, pictures);
        let fills = self.plans.iter().filter(|plan| plan.fill.is_some()).count();
        let others = self.shadow_leaves as usize + self.query_boxes.len() + fills;
        stats.leaves = self.batch.leaves().len().saturating_sub(others) as u32;
        stats.unsampled_leaves = self.batch.unsampled;
        stats.shadow_leaves = self.shadow_leaves;
        (stats.leaves_dropped, stats.shadow_leaves_dropped) = (self.leaves_dropped, self.shadow_leaves_dropped);
        (stats.airs_refused, stats.stages_refused) = (self.airs_refused, self.stages_refused);
        stats.pipelines_created += self.created() - created_before;
        let wait = crate::timeline::span("wait for adapter");
        self.throttle(ctx)?;
        drop(wait);
        if let Some(timer) = &mut self.timer {
            timer.read();
            let passes = timer.latest_ms(self.timed.0);
            stats.gpu_ms = (!passes.is_empty()).then(|| passes.iter().sum());
        }
        if let Some(queries) = &mut self.queries {
            queries.deliver();
        }
        self.pictures.deliver();
        Ok(stats)
    }

    /// Pipelines made so far.
    fn created(&self) -> u32 {
        let of_spread = self.spread.as_ref().map_or(0, Spread::created);
        self.pipelines.created() + of_spread + self.resolve.as_ref().map_or(0, DepthResolve::created)
    }

    /// Copies what a camera has drawn to whoever wants it.
    fn copy_picture(&mut self, ctx: &GraphicsContext, encoder: &mut wgpu::CommandEncoder, stage: &RenderStage) {
        let Some(camera) = stage.target.camera.as_ref().filter(|_| !stage.target.is_shared) else { return };
        for (part, sink) in camera.read_backs() {
            let read = match Read::of(camera, part) {
                Ok(read) => read,
                Err(error) => {
                    self.complain(error.to_string());
                    continue;
                }
            };
            // What is wrong with it has been said.
            let Some(texture) = self.groups.textures.texture(&read.attachment.texture) else { continue };
            if let Err(error) = self.pictures.copy(ctx.memory(), encoder, texture, read, sink, &stage.camera) {
                self.complain(error);
            }
        }
    }

    /// Lets callbacks run, and waits while too many frames are under way.
    fn throttle(&mut self, ctx: &GraphicsContext) -> Result<(), GpuError> {
        let mut poll = wgpu::PollType::Poll;
        while self.in_flight.len() > FRAMES_IN_FLIGHT * ctx.face_count() {
            poll = wgpu::PollType::Wait { submission_index: self.in_flight.pop_front(), timeout: Some(FRAME_TIMEOUT) };
        }
        ctx.device().poll(poll).map_err(|e| GpuError::DeviceLost { reason: format!("a frame did not end: {e}") })?;
        ctx.check_lost()
    }

    /// The picture last drawn, top row first. Waits for the adapter. A window's picture can be read between draw
    /// and present, where the platform lets images be copied.
    pub fn read_back(&mut self, ctx: &mut GraphicsContext) -> Result<image::RgbaImage, GpuError> {
        let _span = crate::timeline::span("read back");
        ctx.read_back()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::cull::{CullCamera, CullVisitor, CullingMode};
    use crate::gpu::{AdapterChoice, CompileBudget, CompileOperation, ContextTraits};
    use crate::scene::{AlphaMode, Drawable, Material, Mesh, Node, Page, Scene};
    use crate::state::{Attribute, BinDetails, CullFace, Scissor, SortMode, StateSet, SurfaceMaterial};
    use glam::{DAffine3, DVec3};

    /// How often a thing changes along the runs; the first time counts.
    fn changes<T: PartialEq>(things: impl Iterator<Item = T>) -> u32 {
        let mut last = None;
        let mut count = 0;
        for thing in things {
            if last.as_ref() != Some(&thing) {
                count += 1;
                last = Some(thing);
            }
        }
        count
    }

    #[test]
    fn state_is_set_as_seldom_as_the_order_allows() {
        let traits = ContextTraits { size_px: [64, 64], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut renderer = Renderer::new(&mut ctx);
        // Small and large meshes, some blended, under state sets that differ in all sorts of things.
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
                let place =
                    DVec3::new(f64::from(random(9)) - 4.0, f64::from(random(9)) - 4.0, -12.0 - f64::from(random(40)));
                let geode = Node::geode(vec![Drawable::new(mesh.into(), material)]);
                let geode = geode.with_state_set(sets[random(24) as usize].clone());
                Node::transform(DAffine3::from_translation(place), vec![geode])
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
        let environment = Environment { sky: crate::draw::Sky::Background([0; 3]), ..Environment::default() };
        renderer.draw(&mut ctx, &stage, &environment).unwrap();
        let stats = renderer.draw(&mut ctx, &stage, &environment).unwrap();
        assert!(renderer.take_errors().is_empty());
        assert!(stats.unsampled_leaves > 50, "some are small: {stats:?}");
        assert_eq!((stats.leaves + stats.unsampled_leaves) as usize, stage.leaf_count());

        let batch = &renderer.batch;
        let buckets = || batch.runs.iter().map(|r| batch.buckets[r.bucket as usize]);
        let statics = || buckets().map(|(b, _)| renderer.statics[b.statics as usize]);
        let direct = || buckets().filter(|(b, _)| b.stride == 0);
        let initial = std::iter::once([0u32, 0, 64, 64]);
        let scissors = changes(initial.chain(statics().map(|s| s.dynamics.scissor))) - 1;
        let least = changes(buckets().map(|(_, pipeline)| pipeline))
            + changes(buckets().map(|(b, _)| (b.is_height, b.block)))
            + changes(direct().map(|(b, _)| b.vertex_chunk))
            + changes(direct().map(|(b, _)| b.index_chunk))
            + changes(buckets().filter(|(b, _)| b.stride > 0).map(|(b, _)| (b.vertex_chunk, b.index_chunk)))
            // The color that packed vertices share is set once.
            + u32::from(direct().any(|(b, _)| b.pipeline.is_white()))
            + changes(statics().map(|s| s.frame))
            + changes(statics().filter_map(|s| s.group))
            + scissors;
        assert!(least > 40, "a scene that says something: {least}");
        assert_eq!(stats.state_changes, least);

        // What does not fit into the adapter's buffer is dropped and said.
        renderer.most_leaves = 150;
        let mut camera = CullCamera::default();
        camera.settings.culling = CullingMode::VIEW_FRUSTUM;
        CullVisitor::new().cull(&scene, &camera, &mut stage);
        let stats = renderer.draw(&mut ctx, &stage, &environment).unwrap();
        assert_eq!((stats.leaves, stats.leaves_dropped as usize), (150, stage.leaf_count() - 150));
        let errors = renderer.take_errors();
        assert!(matches!(&errors[..], [e] if e.contains("more leaves than")), "{errors:?}");
        // Once, though there are others each time; and what is wrong after very much else is heard.
        renderer.most_leaves = 149;
        renderer.draw(&mut ctx, &stage, &environment).unwrap();
        assert!(renderer.take_errors().is_empty());
        (0..2000).for_each(|i| renderer.complain(format!("another {i}")));
        renderer.take_errors();
        renderer.complain("at last".to_owned());
        assert_eq!(renderer.take_errors(), ["at last"]);

        // What casts shadows gives way to what is seen.
        let lit = Environment { shadows: Some(crate::scene::SunShadows::default()), ..environment };
        let mut visitor = CullVisitor::new();
        visitor.environment = Some(lit);
        visitor.cull(&scene, &camera, &mut stage);
        let own = stage.leaf_count();
        renderer.most_leaves = usize::MAX;
        let all = renderer.draw(&mut ctx, &stage, &lit).unwrap();
        assert!(all.shadow_leaves > 20 && all.leaves_dropped + all.shadow_leaves_dropped == 0, "{all:?}");
        renderer.most_leaves = own + 11;
        let some = renderer.draw(&mut ctx, &stage, &lit).unwrap();
        assert_eq!((some.leaves, some.leaves_dropped, some.shadow_leaves), (all.leaves, 0, 10));
        assert_eq!(some.shadow_leaves_dropped, all.shadow_leaves - 10);
        renderer.most_leaves = own;
        let few = renderer.draw(&mut ctx, &stage, &lit).unwrap();
        assert_eq!((few.leaves, few.leaves_dropped, few.shadow_leaves), (all.leaves, 0, 0));
        let errors = renderer.take_errors();
        assert!(matches!(&errors[..], [e] if e.contains("cast no shadow")), "{errors:?}");
    }
}
