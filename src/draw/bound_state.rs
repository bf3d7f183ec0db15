//! State that is set on a pass beside pipelines and buffers: viewports, scissors, references, uniforms. Draw thread.

/// State that wgpu sets on the pass itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::draw) struct DynamicState {
    /// x, y, width, height in pixels; least and greatest depth from 0 to 1.
    pub(in crate::draw) viewport: [f32; 6],
    /// x, y, width, height in pixels, inside the target.
    pub(in crate::draw) scissor: [u32; 4],
    pub(in crate::draw) stencil_reference: u32,
    /// The blend constant, where the blend function uses one.
    pub(in crate::draw) blend_color: Option<[f32; 4]>,
}

/// State of a run that neither its pipeline nor its buffers hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::draw) struct BoundState {
    pub(in crate::draw) dynamics: DynamicState,
    /// Byte offsets of the frame's and the stage's uniforms in the uniform buffer.
    pub(in crate::draw) frame: [u32; 2],
    /// Index of the bind group 0 with the air tables of the view.
    pub(in crate::draw) air: u8,
    /// Index of bind group 2, and the byte offset of its uniforms where it has some.
    pub(in crate::draw) group: Option<(u32, Option<u32>)>,
    /// Index of bind group 3 of a program.
    pub(in crate::draw) attribute: Option<u32>,
}

/// New states are compared with this many of the states before them: equal ones are mostly neighbours.
const RECENT_STATES: usize = 4;

/// The bound states of a frame, by index.
#[derive(Debug, Default)]
pub(in crate::draw) struct BoundStates(Vec<BoundState>);

impl BoundStates {
    /// Removes the states of the last frame.
    pub(in crate::draw) fn start_frame(&mut self) {
        self.0.clear();
    }

    /// Appends a state and returns its index.
    pub(in crate::draw) fn push(&mut self, state: BoundState) -> u32 {
        self.0.push(state);
        self.0.len() as u32 - 1
    }

    /// Returns the index of an equal state among the latest few from `first` on, or appends the state.
    pub(in crate::draw) fn find_recent_or_push(&mut self, state: BoundState, first: u32) -> u32 {
        let recent = self.0.len().saturating_sub(RECENT_STATES).max(first as usize);
        match self.0[recent..].iter().rposition(|s| *s == state) {
            Some(index) => (recent + index) as u32,
            None => self.push(state),
        }
    }

    /// Returns the index of an equal state of this frame, or appends the state.
    pub(in crate::draw) fn find_or_push(&mut self, state: BoundState) -> u32 {
        match self.0.iter().rposition(|s| *s == state) {
            Some(index) => index as u32,
            None => self.push(state),
        }
    }

    pub(in crate::draw) fn get(&self, index: u32) -> Option<&BoundState> {
        self.0.get(index as usize)
    }
}
