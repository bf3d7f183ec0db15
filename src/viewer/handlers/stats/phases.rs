//! The phases of a frame with their colours.

use egui::Color32;

use crate::viewer::FrameStats;

/// Name, colour and duration in milliseconds of a phase.
pub(super) type Phase = (&'static str, Color32, fn(&FrameStats) -> f64);

/// The phases in the order they are stacked.
pub(super) const PHASES: [Phase; 6] = [
    ("event", Color32::from_rgb(150, 150, 160), |s| s.event_ms),
    ("update", Color32::from_rgb(80, 150, 230), |s| (s.update_ms - s.merge_ms).max(0.0)),
    ("merge", Color32::from_rgb(120, 210, 240), |s| s.merge_ms),
    ("cull", Color32::from_rgb(110, 200, 110), |s| s.cull_ms),
    ("compile", Color32::from_rgb(230, 170, 60), |s| s.compile_ms),
    ("draw", Color32::from_rgb(230, 100, 90), |s| s.draw_ms),
];
