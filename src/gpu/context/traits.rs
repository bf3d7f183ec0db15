//! [`ContextTraits`]: the wanted properties of a context; OpenSceneGraph's `Traits`. Plain values.

/// The adapter to draw with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The fastest one; a software adapter if there is no other.
    #[default]
    Any,
    /// A CPU adapter (lavapipe, WARP), whose images do not depend on the machine.
    Software,
    /// wgpu's backend that executes nothing: measures the cost of recording alone, and serves tests without a GPU.
    Noop,
}

/// The wanted properties of a context; OpenSceneGraph's `Traits`.
#[derive(Clone, Copy, Debug)]
pub struct ContextTraits {
    /// Width and height of the target in pixels.
    pub size_px: [u32; 2],
    /// The adapter to draw with.
    pub adapter: AdapterChoice,
    /// Samples per pixel of the target: 1, 2, 4, 8 or 16. An adapter that lacks the number takes the next larger one that it
    /// has, or its largest; all have 1 and 4.
    pub samples: u32,
    /// Window images wait for the vertical blank. Without it they do not, if the platform can, and may tear.
    pub vsync: bool,
    /// The number of the screen that a window is on, counted from 0, and the window's upper left corner on it in pixels. They
    /// order the contexts of a viewer, and do not move windows.
    pub screen: u32,
    /// See [`Self::screen`].
    pub position_px: [i32; 2],
    /// The least bits of alpha in the target's images. Textures have 8; a window takes a format that has them. Opening fails
    /// without one. Frames are opaque whatever their alpha.
    pub min_alpha_bits: u32,
    /// Starts a compile thread for the device, which copies uploads and records their commands, while the draw thread only
    /// allocates slots and submits: OpenSceneGraph's compile contexts. It is faster if cores are idle and much is uploaded
    /// at once; otherwise uploads take the same time within [`CompileBudget`](crate::gpu::CompileBudget).
    pub compile_thread: bool,
    /// The maximum number of samples along the steepest direction of images of meshes and height tiles, 1 to 16. `None` means
    /// 16, and 1 on software drivers, which filter slowly. Adapters without anisotropic filtering take one sample.
    pub max_anisotropy: Option<u16>,
    /// Enables the driver's validation layers, which check every call. Ten times slower; never measure time with it.
    pub validation: bool,
}

impl Default for ContextTraits {
    fn default() -> Self {
        Self {
            size_px: [1280, 720],
            adapter: AdapterChoice::Any,
            samples: 1,
            vsync: true,
            screen: 0,
            position_px: [0, 0],
            min_alpha_bits: 0,
            compile_thread: false,
            max_anisotropy: None,
            validation: false,
        }
    }
}
