//! The parts of a renderer that all of its passes share. Draw thread.

use crate::draw::batch::Batch;
use crate::draw::batch::indirect::IndirectBuffer;
use crate::draw::bound_state::BoundStates;
use crate::draw::callbacks::attribute_groups::AttributeGroups;
use crate::draw::error_log::ErrorLog;
use crate::draw::pipelines::Pipelines;
use crate::draw::stats::DrawStats;
use crate::draw::uniforms::frame_groups::FrameGroups;
use crate::draw::uniforms::leaf_buffer::LeafBuffer;
use crate::draw::uniforms::state_groups::StateGroups;
use crate::draw::uniforms::vertex_pulling::VertexPulling;
use crate::gpu::{FrameTimer, GraphicsContext};

/// Pipelines, buffers, bind groups and counts of a renderer. Each part keeps its own invariants; this only owns them.
pub(in crate::draw) struct Resources {
    pub(in crate::draw) pipelines: Pipelines,
    /// Bind groups 0: the frame's uniforms, leaves, air tables and shadow maps.
    pub(in crate::draw) frame_groups: FrameGroups,
    /// Bind groups 2, and the buffer of all uniforms.
    pub(in crate::draw) state_groups: StateGroups,
    /// Bind groups 3 of pulled meshes.
    pub(in crate::draw) vertex_pulling: VertexPulling,
    /// Bind groups 3 of programs.
    pub(in crate::draw) attribute_groups: AttributeGroups,
    /// The leaves, runs and buckets of the frame.
    pub(in crate::draw) batch: Batch,
    pub(in crate::draw) bound_states: BoundStates,
    pub(in crate::draw) leaf_buffer: LeafBuffer,
    pub(in crate::draw) indirect: IndirectBuffer,
    /// `None` if the adapter has no timestamps.
    pub(in crate::draw) timer: Option<FrameTimer>,
    /// Counts of the current draw.
    pub(in crate::draw) stats: DrawStats,
    pub(in crate::draw) errors: ErrorLog,
}

impl Resources {
    pub(in crate::draw) fn new(ctx: &mut GraphicsContext) -> Self {
        let state_groups = StateGroups::new(ctx);
        Self {
            pipelines: Pipelines::new(ctx),
            frame_groups: FrameGroups::default(),
            state_groups,
            vertex_pulling: VertexPulling::default(),
            attribute_groups: AttributeGroups::default(),
            batch: Batch::default(),
            bound_states: BoundStates::default(),
            leaf_buffer: LeafBuffer::new(&ctx.device().limits()),
            indirect: IndirectBuffer::new(ctx.device()),
            timer: FrameTimer::new(ctx),
            stats: DrawStats::default(),
            errors: ErrorLog::default(),
        }
    }

    /// Forgets the last frame, and frees what was not used for long.
    pub(in crate::draw) fn start_frame(&mut self) {
        self.stats = DrawStats::default();
        self.batch.start_frame();
        let programs_freed = self.pipelines.start_frame();
        self.state_groups.start_frame(programs_freed);
        self.attribute_groups.start_frame(programs_freed);
        self.bound_states.start_frame();
        self.vertex_pulling.start_frame();
    }

    /// Prepares something that is drawn without what lacks its pipeline, which is ordered and counted. If `hides` is false,
    /// missing pipelines are created at once. In a rehearsal, which orders all that is missing, it changes nothing.
    pub(in crate::draw) fn hide_unready<R>(&mut self, hides: bool, prepare: impl FnOnce(&mut Self) -> R) -> R {
        if !hides || self.pipelines.pipeline_thread.is_ordering() {
            return prepare(self);
        }
        self.pipelines.pipeline_thread.begin();
        let prepared = prepare(self);
        self.stats.pipelines_awaited += self.pipelines.pipeline_thread.end();
        prepared
    }

    /// Reports errors of pipelines that were created since the last call.
    pub(in crate::draw) fn report_pipeline_errors(&mut self) {
        for error in self.pipelines.take_errors() {
            self.errors.report_once(error);
        }
    }
}
