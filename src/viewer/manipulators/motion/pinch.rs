//! [`Pinch`]: the gesture of several fingers on a touch screen or pad. Main thread.
//!
//! It is the shift, stretch and rotation of the image that best moves the fingers' old positions to their new ones. With two
//! fingers the fit is exact, with more it is a least-squares fit. Each event is applied at once, so the result does not
//! depend on the frame rate.

use glam::{DVec2, DVec4};

use super::image_plane::image_position;
use super::throw::Throw;
use crate::viewer::events::{EventKind, GuiEventAdapter, TouchPhase};

/// The most fingers tracked at once; further ones are ignored.
const MAX_FINGERS: usize = 10;
/// The minimum distance of fingers from their centre, image heights. Closer fingers neither stretch nor rotate the image,
/// because their distance is noise.
const MIN_SPREAD: f64 = 0.01;
/// The maximum stretch of one event, as a power of e.
const MAX_STRETCH: f64 = 3.0;

/// A piece of a gesture, in image heights from the image's centre, y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinch {
    /// The fingers' centre before.
    pub from: DVec2,
    /// The fingers' centre now.
    pub to: DVec2,
    /// The image grows by e to this power.
    pub stretch: f64,
    /// The rotation of the image about the centre, radians counterclockwise.
    pub twist: f64,
}

impl Pinch {
    /// Returns the motion of the centre.
    pub fn shift(&self) -> DVec2 {
        self.to - self.from
    }

    fn motion(&self) -> DVec4 {
        self.shift().extend(self.stretch).extend(self.twist)
    }
}

/// The effect of an event on a gesture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TouchResult {
    /// The event is no touch, or touches with a single finger, which acts as the pointer.
    Ignored,
    /// The current motion stops; there is nothing to apply.
    Stopped,
    /// Several fingers moved.
    Pinched(Pinch),
}

/// Tracks several fingers, and continues their gesture after the release.
#[derive(Clone, Copy, Debug, Default)]
pub struct PinchTracker {
    down: [Option<(u64, DVec2)>; MAX_FINGERS],
    throw: Throw<DVec4>,
    /// The centre of the released gesture.
    center: DVec2,
}

impl PinchTracker {
    /// Handles an event.
    pub fn handle(&mut self, event: &GuiEventAdapter) -> TouchResult {
        let EventKind::Touch { id, phase, position_px } = event.kind else {
            if let EventKind::Push(_) | EventKind::DoubleClick(_) = event.kind {
                self.throw.stop();
            }
            return TouchResult::Ignored;
        };
        let at = position_px.is_finite().then(|| image_position(position_px, &event.state));
        let known = self.down.iter().position(|finger| finger.is_some_and(|(down, _)| down == id));
        match (phase, known) {
            (TouchPhase::Began, _) => {
                let place = known.or_else(|| self.down.iter().position(Option::is_none));
                if let (Some(at), Some(finger)) = (at, place.and_then(|place| self.down.get_mut(place))) {
                    *finger = Some((id, at));
                }
                self.throw.stop();
                TouchResult::Stopped
            }
            (_, None) => TouchResult::Ignored,
            (TouchPhase::Moved, Some(place)) => match at.and_then(|at| self.moved(place, id, at)) {
                Some(pinch) => {
                    self.throw.moved(pinch.motion(), event.time_s);
                    TouchResult::Pinched(pinch)
                }
                None => TouchResult::Ignored,
            },
            (TouchPhase::Ended, Some(place)) => {
                let pinch = at.and_then(|at| self.moved(place, id, at));
                if let Some(pinch) = pinch {
                    self.throw.moved(pinch.motion(), event.time_s);
                }
                self.lift(place);
                match self.count() {
                    0 => {}
                    1 => self.throw.release(event.time_s),
                    // The remaining fingers continue from where they are.
                    _ => self.throw.stop(),
                }
                pinch.map_or(TouchResult::Ignored, TouchResult::Pinched)
            }
            (TouchPhase::Cancelled, Some(place)) => {
                self.lift(place);
                self.throw.stop();
                TouchResult::Stopped
            }
        }
    }

    /// Returns the gesture of the next `dt_s` seconds after the release.
    pub fn advance(&mut self, dt_s: f64) -> Option<Pinch> {
        let motion = self.throw.advance(dt_s)?;
        let from = self.center;
        self.center += motion.truncate().truncate();
        Some(Pinch { from, to: self.center, stretch: motion.z, twist: motion.w })
    }

    /// Stops all motion and forgets the fingers that are down, because an inactive manipulator does not receive their
    /// release.
    pub fn stop(&mut self) {
        *self = Self::default();
    }

    /// Returns true while a released gesture continues.
    pub fn is_moving(&self) -> bool {
        self.throw.is_moving()
    }

    /// Returns the number of fingers that are down.
    pub fn count(&self) -> usize {
        self.down.iter().flatten().count()
    }

    fn lift(&mut self, place: usize) {
        if let Some(finger) = self.down.get_mut(place) {
            *finger = None;
        }
    }

    fn centroid(&self) -> DVec2 {
        self.down.iter().flatten().map(|(_, at)| *at).sum::<DVec2>() / self.count().max(1) as f64
    }

    /// Moves a finger; returns what that does to the image together with the other fingers.
    fn moved(&mut self, place: usize, id: u64, at: DVec2) -> Option<Pinch> {
        let before = self.down;
        let from = self.centroid();
        if let Some(finger) = self.down.get_mut(place) {
            *finger = Some((id, at));
        }
        if self.count() < 2 || before == self.down {
            return None;
        }
        let to = self.centroid();
        // Least squares: the stretch is the ratio of the spreads, the rotation the angle of the summed products.
        let (mut dot, mut cross, mut square_before, mut square_now) = (0.0, 0.0, 0.0, 0.0);
        for ((_, a), (_, b)) in before.iter().flatten().zip(self.down.iter().flatten()) {
            let (a, b) = (*a - from, *b - to);
            dot += a.dot(b);
            cross += a.perp_dot(b);
            square_before += a.length_squared();
            square_now += b.length_squared();
        }
        let min_square = MIN_SPREAD * MIN_SPREAD * self.count() as f64;
        let stretch = 0.5 * (square_now.max(min_square) / square_before.max(min_square)).ln();
        let twist = if square_before > min_square && square_now > min_square { cross.atan2(dot) } else { 0.0 };
        self.center = to;
        Some(Pinch { from, to, stretch: stretch.clamp(-MAX_STRETCH, MAX_STRETCH), twist })
    }
}
