//! [`StatsHandler`]: shows the cost of frames over the image.

use super::selection::{RECENT_FRAMES, StatsPage};
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;
use crate::viewer::{GuiActionAdapter, Samples};

#[derive(Clone, Copy, Debug)]
enum Action {
    Cycle,
    Print,
}

const KEYS: Bindings<Action> = Bindings(&[
    (&[Key::Char('s'), Key::Tab], Action::Cycle, "next page of the stats: frame rate, frame, drawing, pager, none"),
    (&[Key::Char('S')], Action::Print, "print the stats"),
]);

/// Shows statistics, one page more with each key press; OSG's `StatsHandler`.
#[derive(Clone, Copy, Debug, Default)]
pub struct StatsHandler {
    /// The page that is shown.
    pub page: StatsPage,
}

impl GuiEventHandler for StatsHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        match KEYS.action(event) {
            Some(Action::Cycle) => {
                self.page = match self.page {
                    StatsPage::None => StatsPage::FrameRate,
                    StatsPage::FrameRate => StatsPage::Frame,
                    StatsPage::Frame => StatsPage::Drawing,
                    StatsPage::Drawing => StatsPage::Pager,
                    StatsPage::Pager => StatsPage::None,
                };
            }
            Some(Action::Print) => print(viewer),
            None => return false,
        }
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }

    fn shows_overlay(&self) -> bool {
        self.page != StatsPage::None
    }

    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, viewer: &GuiActionAdapter<'_>) {
        super::page::lay_out(ui, viewer, self.page);
    }
}

/// Writes the medians to the log, and shows them.
fn print(viewer: &mut GuiActionAdapter<'_>) {
    let median = |value: fn(&crate::viewer::FrameStats) -> f64| {
        Samples::new(viewer.stats().iter().rev().filter(|s| s.drawn).take(RECENT_FRAMES).map(value)).median()
    };
    let text = format!(
        "frame {:.2} ms: event {:.2}, update {:.2}, merge {:.2}, cull {:.2}, draw {:.2}, compile {:.2}; \
         {:.0} leaves, {:.0} draw calls, {:.0} triangles",
        median(|s| s.frame_ms),
        median(|s| s.event_ms),
        median(|s| s.update_ms),
        median(|s| s.merge_ms),
        median(|s| s.cull_ms),
        median(|s| s.draw_ms),
        median(|s| s.compile_ms),
        median(|s| f64::from(s.leaves)),
        median(|s| f64::from(s.draw_calls)),
        median(|s| s.triangles as f64),
    );
    log::info!("{text}");
    viewer.notify(text);
}
