//! [`ShownEnvironment`]: the environment that a view is drawn with, which is an earlier one than the application has set while
//! the pipelines of a change are created. Main thread.

use crate::draw::draws_alike;
use crate::scene::Environment;

/// A change that waits for its pipelines.
#[derive(Debug)]
struct Change {
    /// The environment whose pipelines are created.
    wanted: Environment,
    /// The frame that rehearses it, and the number of its results that are missing.
    rehearsal: Option<(u32, usize)>,
    /// The number of pipelines that the last rehearsal lacked.
    missing: u32,
    /// The number of pipelines that a device of the view was creating when it last drew a frame.
    in_creation: u32,
    /// The last rehearsal lacked nothing.
    is_ready: bool,
}

/// The environment that a view is drawn with.
#[derive(Debug, Default)]
pub(in crate::viewer) struct ShownEnvironment {
    /// `None` before the first frame.
    shown: Option<Environment>,
    change: Option<Change>,
    /// The latest frame that is drawn, and the number of pipelines that it lacked in all contexts of the view.
    awaited: (u32, u32),
    /// The application has asked for a frame.
    is_asked: bool,
    /// [`PagedScene::own_merged`](crate::viewer::paging::PagedScene::own_merged) in the last frame.
    own_merged: u32,
    /// The frame that it got, until the result is known: it may have left something out.
    asked: Option<u32>,
}

impl ShownEnvironment {
    /// Returns the environment to draw with; `set` is the application's.
    pub(in crate::viewer) fn of(&self, set: &Environment) -> Environment {
        self.shown.unwrap_or(*set)
    }

    /// Returns true while a change waits for its pipelines, or frames leave out what lacks one.
    pub(in crate::viewer) fn is_changing(&self) -> bool {
        self.change.is_some() || self.awaited.1 > 0 || self.asked.is_some()
    }

    /// Notes that the application has asked for a frame: the scene may have changed.
    pub(in crate::viewer) fn note_request(&mut self) {
        self.is_asked = true;
    }

    /// Begins a frame, which may leave out what lacks a pipeline. `own_merged` changes when a page of the application has
    /// received its upload.
    pub(in crate::viewer) fn begin_frame(&mut self, frame: u32, hides_unready: bool, own_merged: u32) {
        let has_new = std::mem::replace(&mut self.own_merged, own_merged) != own_merged;
        if (std::mem::take(&mut self.is_asked) || has_new) && hides_unready {
            self.asked = Some(frame);
        }
    }

    /// Takes the number of pipelines that a frame lacked in one context of the view.
    pub(in crate::viewer) fn note_awaited(&mut self, frame: u32, count: u32) {
        let others = if self.awaited.0 == frame { self.awaited.1 } else { 0 };
        self.awaited = (frame, others.saturating_add(count));
        self.asked = self.asked.filter(|asked| *asked > frame);
    }

    /// Takes the application's environment for the next frame. If `waits`, a change that needs other pipelines waits for them;
    /// until then the view is drawn with the whole previous environment.
    pub(in crate::viewer) fn follow(&mut self, set: &Environment, waits: bool) {
        let shown = self.shown.get_or_insert(*set);
        if !waits || draws_alike(shown, set) {
            (*shown, self.change) = (*set, None);
            return;
        }
        match &self.change {
            Some(change) if draws_alike(&change.wanted, set) => {
                if change.is_ready {
                    (*shown, self.change) = (*set, None);
                    return;
                }
            }
            // Results of the earlier change are not its own.
            _ => {
                let wanted = *set;
                self.change = Some(Change { wanted, rehearsal: None, missing: 0, in_creation: 0, is_ready: false });
            }
        }
        // `up_in_world` follows from the camera's position, not from the application.
        shown.up_in_world = set.up_in_world;
    }

    /// Returns true if the next frame should rehearse the application's environment.
    pub(in crate::viewer) fn wants_rehearsal(&self) -> bool {
        self.change.as_ref().is_some_and(|change| change.rehearsal.is_none() && change.in_creation == 0)
    }

    /// Notes that a frame rehearses the change in a number of contexts.
    pub(in crate::viewer) fn begin_rehearsal(&mut self, frame: u32, contexts: usize) {
        if let Some(change) = &mut self.change {
            (change.rehearsal, change.missing) = (Some((frame, contexts)), 0);
        }
    }

    /// Has the change rehearsed again: the contexts of the view have changed.
    pub(in crate::viewer) fn forget_rehearsal(&mut self) {
        if let Some(change) = &mut self.change {
            (change.rehearsal, change.is_ready) = (None, false);
        }
    }

    /// Takes the result of a frame in one context of the view: the number of pipelines that a rehearsal lacked, `None` if the
    /// context has rehearsed none; and the number of pipelines that its device creates.
    pub(in crate::viewer) fn drawn(&mut self, frame: u32, missing: Option<u32>, in_creation: u32) {
        let Some(change) = &mut self.change else { return };
        change.in_creation = in_creation;
        let Some((rehearsed, results)) = change.rehearsal.filter(|(rehearsed, _)| *rehearsed == frame) else { return };
        // A frame that was not drawn is rehearsed again.
        change.missing = change.missing.saturating_add(missing.unwrap_or(1));
        change.rehearsal = Some((rehearsed, results.saturating_sub(1))).filter(|(_, results)| *results > 0);
        change.is_ready = change.rehearsal.is_none() && change.missing == 0;
    }

    /// Forgets what was shown, since another device has none of its pipelines: the next frame shows what the application has
    /// set.
    pub(in crate::viewer) fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Sky, SunShadows};
    use glam::DVec3;

    fn shadowed() -> Environment {
        Environment { shadows: Some(SunShadows::default()), ..Environment::default() }
    }

    #[test]
    fn change_takes_effect_whole_once_all_contexts_have_its_pipelines() {
        let mut view = ShownEnvironment::default();
        let before = Environment::default();
        view.follow(&before, true);
        assert_eq!((view.of(&before), view.is_changing()), (before, false), "the first frame waits for nothing");
        // A change that needs no other pipelines is shown at once.
        let evening = Environment { sun_direction: DVec3::X, ..before };
        view.follow(&evening, true);
        assert_eq!(view.of(&evening), evening);

        let wanted = Environment { exposure: None, ..shadowed() };
        for frame in [5, 7] {
            view.follow(&wanted, true);
            assert!(view.wants_rehearsal() && view.is_changing());
            view.begin_rehearsal(frame, 2);
            // A frame that was in flight says nothing of the rehearsal.
            view.drawn(frame - 1, None, 0);
            view.drawn(frame, Some(if frame == 5 { 3 } else { 0 }), 0);
            assert!(!view.wants_rehearsal());
            view.follow(&wanted, true);
            assert_eq!(view.of(&wanted), evening, "one context is missing");
            view.drawn(frame, Some(0), if frame == 5 { 3 } else { 0 });
            if frame == 5 {
                view.follow(&wanted, true);
                assert_eq!(view.of(&wanted), evening, "pipelines are missing");
                assert!(!view.wants_rehearsal(), "they are being created");
                view.drawn(6, None, 0);
            }
        }
        view.follow(&wanted, true);
        assert_eq!((view.of(&wanted), view.is_changing()), (wanted, false));
    }

    #[test]
    fn later_change_replaces_one_that_waits() {
        let (mut view, before) = (ShownEnvironment::default(), Environment::default());
        view.follow(&before, true);
        view.follow(&shadowed(), true);
        view.begin_rehearsal(2, 1);
        let plain = Environment { sky: Sky::Background([0; 3]), ..before };
        view.follow(&plain, true);
        view.drawn(2, Some(0), 0);
        view.follow(&plain, true);
        assert_eq!(view.of(&plain), before, "that was the result of the first change");
        view.begin_rehearsal(3, 1);
        view.drawn(3, None, 0);
        view.follow(&plain, true);
        assert!(view.of(&plain) == before && view.wants_rehearsal(), "the frame was not drawn");
        view.begin_rehearsal(4, 1);
        view.drawn(4, Some(0), 0);
        // A further change that needs no other pipelines takes effect with it.
        let dusk = Environment { sun_direction: DVec3::Y, ..plain };
        view.follow(&dusk, true);
        assert_eq!(view.of(&dusk), dusk);
        // A change that is taken back is forgotten; one that need not wait takes effect at once.
        view.follow(&shadowed(), true);
        view.follow(&dusk, true);
        assert_eq!((view.of(&dusk), view.is_changing()), (dusk, false));
        view.follow(&shadowed(), true);
        view.follow(&shadowed(), false);
        assert_eq!((view.of(&dusk), view.is_changing()), (shadowed(), false));
        view.follow(&dusk, true);
        view.reset();
        assert_eq!((view.of(&dusk), view.is_changing()), (dusk, false));
    }
}
