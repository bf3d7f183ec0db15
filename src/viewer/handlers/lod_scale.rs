//! [`LodScaleHandler`]: more or less detail.

use crate::viewer::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;

const KEYS: Bindings<f64> = Bindings(&[
    (&[Key::Char('*'), Key::Char('>')], 1.0 / STEP, "more detail"),
    (&[Key::Char('/'), Key::Char('<')], STEP, "less detail"),
]);

/// The factor of one step, as in OSG.
const STEP: f64 = 1.1;

/// Changes the camera's LOD scale; a larger scale refines later. OSG's `LODScaleHandler`.
#[derive(Clone, Copy, Debug, Default)]
pub struct LodScaleHandler;

impl GuiEventHandler for LodScaleHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        let Some(factor) = KEYS.action(event) else { return false };
        let scale = &mut viewer.camera.settings.lod_scale;
        *scale = (*scale * factor).clamp(0.05, 20.0);
        let text = format!("LOD scale {scale:.2}");
        viewer.notify(text);
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }
}
