//! [`InputState`]: pointer, buttons and modifier keys at the time of an event.

use glam::DVec2;

use super::button::MouseButton;

/// The buttons that are down; all buttons beyond left, middle and right count as one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ButtonMask(u8);

impl ButtonMask {
    /// Returns true when no button is down.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns true while the button is down.
    pub fn contains(self, button: MouseButton) -> bool {
        self.0 & Self::bit(button) != 0
    }

    /// Returns the mask with a button set to down or up.
    #[must_use]
    pub fn with(self, button: MouseButton, down: bool) -> Self {
        Self(if down { self.0 | Self::bit(button) } else { self.0 & !Self::bit(button) })
    }

    fn bit(button: MouseButton) -> u8 {
        match button {
            MouseButton::Left => 1,
            MouseButton::Middle => 2,
            MouseButton::Right => 4,
            MouseButton::Other(_) => 8,
        }
    }
}

/// The modifier keys that are down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Modifiers {
    /// Shift.
    pub shift: bool,
    /// Control.
    pub control: bool,
    /// Alt or Option.
    pub alt: bool,
    /// Windows or Command key.
    pub logo: bool,
}

/// The direction of y in pointer positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum YOrientation {
    /// Y is measured from the upper edge, as window systems do.
    #[default]
    IncreasingDownwards,
    /// Y is measured from the lower edge, as OSG's viewports do.
    IncreasingUpwards,
}

/// Pointer, buttons, modifiers and input range. Each event carries a copy of the state just after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputState {
    /// The pointer's position, pixels.
    pub position: DVec2,
    /// The minimum position of the pointer, pixels.
    pub min: DVec2,
    /// The maximum position of the pointer, pixels.
    pub max: DVec2,
    /// The direction of y in these positions.
    pub y_orientation: YOrientation,
    /// The buttons that are down.
    pub buttons: ButtonMask,
    /// The modifier keys that are down.
    pub modifiers: Modifiers,
}

impl Default for InputState {
    fn default() -> Self {
        Self {
            position: DVec2::ZERO,
            min: DVec2::ZERO,
            max: DVec2::ONE,
            y_orientation: YOrientation::default(),
            buttons: ButtonMask::default(),
            modifiers: Modifiers::default(),
        }
    }
}

impl InputState {
    /// Returns the pointer's position in the input range: -1 at the left and lower edges, 1 at the right and upper edges; 0
    /// when the range is empty.
    pub fn normalized(&self) -> DVec2 {
        let size = self.max - self.min;
        let share = |at: f64, min: f64, size: f64| if size > 0.0 { 2.0 * (at - min) / size - 1.0 } else { 0.0 };
        let y = share(self.position.y, self.min.y, size.y);
        DVec2::new(
            share(self.position.x, self.min.x, size.x),
            match self.y_orientation {
                YOrientation::IncreasingDownwards => -y,
                YOrientation::IncreasingUpwards => y,
            },
        )
    }

    /// Returns the pointer's position with y in the given direction, pixels.
    pub fn position_in(&self, orientation: YOrientation) -> DVec2 {
        if orientation == self.y_orientation {
            self.position
        } else {
            DVec2::new(self.position.x, self.max.y - (self.position.y - self.min.y))
        }
    }
}
