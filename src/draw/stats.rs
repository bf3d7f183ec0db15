//! Counts of a draw, made on the draw thread where the counted thing happens.

/// Counts and times of one call of [`Renderer::draw`](crate::draw::Renderer::draw). A flat struct of many fields,
/// since callers sum and report each count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DrawStats {
    /// The number of leaves drawn, without shadow casters, boxes of occlusion queries and backgrounds.
    pub leaves: u32,
    /// The number of leaves skipped because they cover no pixel centre
    /// ([`CullingMode::SAMPLES`](crate::scene::CullingMode::SAMPLES)).
    pub unsampled_leaves: u32,
    /// The number of leaves drawn into shadow maps, counted once for each cascade.
    pub shadow_leaves: u32,
    /// The number of leaves dropped because the leaf buffer was full: the adapter's largest buffer or its memory was
    /// too small. Shadow casters are dropped first.
    pub leaves_dropped: u32,
    /// The number of shadow casters dropped for the same reason, counted once for each cascade.
    pub shadow_leaves_dropped: u32,
    /// The number of draw calls for shadow maps; [`Self::draw_calls`] includes them.
    pub shadow_draw_calls: u32,
    /// The number of draw calls, the sky's included. Several runs drawn by one indirect call count once.
    pub draw_calls: u32,
    /// The number of pipelines, bind groups, buffers, viewports, scissors and references set.
    pub state_changes: u32,
    /// The number of state changes skipped because the state was set already.
    pub state_changes_skipped: u32,
    /// The number of triangles submitted.
    pub triangles: u64,
    /// The number of points submitted.
    pub points: u64,
    /// The number of render passes: one for each drawn stage and one for each cascade of its shadows.
    pub passes: u32,
    /// The number of eyes that use the air tables of another eye at nearly the same height, because all sets of tables
    /// were in use.
    pub airs_refused: u32,
    /// The number of stages not drawn because their target or the frame's buffers could not be made;
    /// [`Renderer::take_errors`](crate::draw::Renderer::take_errors) has the reasons.
    pub stages_refused: u32,
    /// The number of pipelines created in this draw; each is slow at its first use. The pipelines that a custom drawable
    /// prepares for a target count as one.
    pub pipelines_created: u32,
    /// The number of pipelines that the pipeline thread has created and that are in use since the draw before.
    pub pipelines_created_by_thread: u32,
    /// The number of bind groups created for the uniforms and textures of states. One is created for each new combination of
    /// textures and samplers, and all again when the buffer of uniforms grows.
    pub state_groups_created: u32,
    /// How often the draw left something out whose pipeline the pipeline thread has not created yet.
    pub pipelines_awaited: u32,
    /// The number of pipelines that the pipeline thread has not created yet.
    pub pipelines_in_creation: u32,
    /// The time of all passes on the adapter in milliseconds, of the latest frame whose timestamps have arrived.
    ///
    /// `None` without timestamp queries, on software adapters unless a timeline is recorded (they stop at each
    /// timestamp), and when not all passes of that frame were measured. At most 2,048 passes are measured, and a frame
    /// with many more passes than the frames before it is not measured. [`Renderer::pass_ms`](crate::draw::Renderer::pass_ms)
    /// has the time of each pass.
    pub gpu_ms: Option<f64>,
    /// True if the window had no image to draw into, so that nothing was drawn.
    pub skipped: bool,
}

impl DrawStats {
    /// Adds the calls and state changes of one render pass, and counts the pass.
    pub(in crate::draw) fn add_pass(&mut self, pass: &Self) {
        self.draw_calls += pass.draw_calls;
        self.state_changes += pass.state_changes;
        self.state_changes_skipped += pass.state_changes_skipped;
        self.triangles += pass.triangles;
        self.points += pass.points;
        self.pipelines_created += pass.pipelines_created;
        self.passes += 1;
    }

    /// Adds the calls and state changes of one render pass into a shadow map, and counts the pass.
    pub(in crate::draw) fn add_shadow_pass(&mut self, pass: &Self) {
        self.shadow_draw_calls += pass.draw_calls;
        self.draw_calls += pass.draw_calls;
        self.state_changes += pass.state_changes;
        self.state_changes_skipped += pass.state_changes_skipped;
        self.passes += 1;
    }
}
