//! Several targets on one device: the contexts of a viewer that share it. Draw thread, which draws into one after the
//! other; opened and closed while it rests.

use std::sync::Arc;

use super::context::MakeSurface;
use super::target::Target;
use super::{ContextTraits, DEPTH_FORMAT, GpuError, GraphicsContext, MOST_COLORS, TargetFormats};

/// What is drawn into, and what it takes to make it again.
pub(super) struct Face {
    pub(super) target: Target,
    pub(super) traits: ContextTraits,
    /// Makes the window's surface once more, on another instance; `None` offscreen.
    pub(super) make_surface: Option<MakeSurface>,
}

impl Face {
    /// What pipelines of its pictures must know.
    pub(super) fn formats(&self) -> TargetFormats {
        let mut colors = [None; MOST_COLORS];
        colors[0] = Some(self.target.format());
        let samples = if self.traits.samples > 1 { 4 } else { 1 };
        TargetFormats { colors, depth: DEPTH_FORMAT, samples, keeps_alpha: false }
    }
}

/// Makes surfaces of a window.
pub(super) fn surface_maker(
    target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
) -> MakeSurface {
    Arc::new(move |instance: &wgpu::Instance| {
        instance.create_surface(target.clone()).map_err(|e| GpuError::Surface { reason: e.to_string() })
    })
}

impl GraphicsContext {
    /// Another target of textures of its own, after those that are there. Of the traits the device's count.
    pub(crate) fn add_offscreen(&mut self, traits: &ContextTraits) -> Result<(), GpuError> {
        self.add_face(traits, None)
    }

    /// As [`Self::add_offscreen`], a window's. The adapter must be able to show something in it.
    pub(crate) fn add_window(
        &mut self,
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<(), GpuError> {
        self.add_face(traits, Some(surface_maker(target)))
    }

    fn add_face(&mut self, traits: &ContextTraits, make_surface: Option<MakeSurface>) -> Result<(), GpuError> {
        self.check_lost()?;
        let surface = make_surface.as_ref().map(|make| make(&self.instance)).transpose()?;
        if surface.as_ref().is_some_and(|surface| !self.adapter.is_surface_supported(surface)) {
            let reason = format!("{}, whose device is to be shared, cannot show anything in it", self.adapter_name());
            return Err(GpuError::Surface { reason });
        }
        let target = Target::new(&self.adapter, &self.device, surface, traits)?;
        self.faces.push(Face { target, traits: *traits, make_surface });
        Ok(())
    }

    /// Closes a target; not the last one. Those after it move up.
    pub(crate) fn remove_face(&mut self, place: usize) {
        if self.faces.len() > 1 && place < self.faces.len() {
            self.faces.remove(place);
            self.face = 0;
        }
    }

    /// Draws into another target from now on.
    pub(crate) fn select_face(&mut self, place: usize) {
        debug_assert!(place < self.faces.len(), "there is no target {place}");
        self.face = place.min(self.faces.len() - 1);
    }

    /// How many there are.
    pub(crate) fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// True while the first one is drawn into.
    pub(crate) fn is_first_face(&self) -> bool {
        self.face == 0
    }
}
