//! [`StateSetManipulator`]: wireframe, lighting, textures and back-face culling of the whole view.

use std::sync::Arc;

use crate::state::{Attribute, Mode, PolygonMode, StateSet, StateValue, TEXTURE_UNITS};
use crate::viewer::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;

#[derive(Clone, Copy, Debug)]
enum Action {
    Polygons,
    Lighting,
    Textures,
    BackFaces,
}

const KEYS: Bindings<Action> = Bindings(&[
    (&[Key::Char('w')], Action::Polygons, "filled, lines, points"),
    (&[Key::Char('l')], Action::Lighting, "lighting"),
    (&[Key::Char('t')], Action::Textures, "textures"),
    (&[Key::Char('b')], Action::BackFaces, "culling of back faces"),
]);

/// Overrides state above all roots, in addition to the application's state set there; OSG's `StateSetManipulator`.
#[derive(Clone, Debug, Default)]
pub struct StateSetManipulator {
    polygons: PolygonMode,
    is_unlit: bool,
    is_untextured: bool,
    shows_back_faces: bool,
    /// The application's state set while an override is active.
    application: Option<Arc<StateSet>>,
    /// The state set with overrides that replaces it.
    overridden: Option<Arc<StateSet>>,
}

impl StateSetManipulator {
    fn has_no_override(&self) -> bool {
        self.polygons == PolygonMode::Fill && !self.is_unlit && !self.is_untextured && !self.shows_back_faces
    }

    /// Returns the application's state set with the overrides; the application's own when there is no override.
    fn state_set(&mut self, current: Option<&Arc<StateSet>>) -> Option<Arc<StateSet>> {
        // The application may have set another state set meanwhile.
        if !self.overridden.as_ref().zip(current).is_some_and(|(overridden, current)| Arc::ptr_eq(overridden, current))
        {
            self.application = current.cloned();
        }
        self.overridden = None;
        if self.has_no_override() {
            return self.application.take();
        }
        let mut set = match &self.application {
            Some(application) => (**application).clone(),
            None => StateSet { name: "toggles".to_owned(), ..StateSet::default() },
        };
        let off = StateValue::OFF | StateValue::OVERRIDE;
        if self.polygons != PolygonMode::Fill {
            set.set_attribute(Attribute::PolygonMode(self.polygons), StateValue::ON | StateValue::OVERRIDE);
        }
        if self.is_unlit {
            set.set_mode(Mode::Lighting, off);
        }
        if self.is_untextured {
            for unit in 0..TEXTURE_UNITS {
                set.set_mode(Mode::Texture(unit as u8), off);
            }
        }
        if self.shows_back_faces {
            set.set_mode(Mode::CullFace, off);
        }
        self.overridden = Some(Arc::new(set));
        self.overridden.clone()
    }
}

impl GuiEventHandler for StateSetManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        let Some(action) = KEYS.action(event) else { return false };
        let on_off = |is_off: bool| if is_off { "off" } else { "on" };
        let text = match action {
            Action::Polygons => {
                self.polygons = match self.polygons {
                    PolygonMode::Fill => PolygonMode::Line,
                    PolygonMode::Line => PolygonMode::Point,
                    PolygonMode::Point => PolygonMode::Fill,
                };
                let names = match self.polygons {
                    PolygonMode::Fill => "filled",
                    PolygonMode::Line => "lines",
                    PolygonMode::Point => "points",
                };
                format!("triangles {names}")
            }
            Action::Lighting => {
                self.is_unlit = !self.is_unlit;
                format!("lighting {}", on_off(self.is_unlit))
            }
            Action::Textures => {
                self.is_untextured = !self.is_untextured;
                format!("textures {}", on_off(self.is_untextured))
            }
            Action::BackFaces => {
                self.shows_back_faces = !self.shows_back_faces;
                format!("culling of back faces {}", on_off(self.shows_back_faces))
            }
        };
        let state_set = self.state_set(viewer.state_set());
        viewer.set_state_set(state_set);
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
