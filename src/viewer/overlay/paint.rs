//! [`OverlayPaint`]: the triangles of one overlay image, handed from the main thread to the draw thread.

use std::sync::Weak;

/// The triangles and texture changes of one overlay image. Each is painted once, in the order laid out.
pub struct OverlayPaint {
    /// Identifies the overlay; the strong reference lives as long as the overlay.
    pub(super) overlay: Weak<()>,
    pub(super) primitives: Vec<egui::ClippedPrimitive>,
    pub(super) textures: egui::TexturesDelta,
    pub(super) screen: egui_wgpu::ScreenDescriptor,
}

impl OverlayPaint {
    /// Returns true when both are images of the same overlay.
    pub(in crate::viewer) fn is_same_overlay(&self, other: &Self) -> bool {
        self.overlay.ptr_eq(&other.overlay)
    }

    /// Prepends the texture changes of an earlier image that was never painted.
    pub(in crate::viewer) fn after(mut self, unpainted: Option<Self>) -> Self {
        if let Some(mut earlier) = unpainted {
            let mut textures = std::mem::take(&mut earlier.textures);
            textures.append(std::mem::take(&mut self.textures));
            self.textures = textures;
        }
        self
    }
}

impl Drop for OverlayPaint {
    fn drop(&mut self) {
        // egui complains about texture changes that were never applied, which happens when a viewer ends.
        self.textures.clear();
    }
}
