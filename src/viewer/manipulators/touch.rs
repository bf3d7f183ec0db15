//! What several fingers do together: the shift, stretch and turn of the picture that takes each finger's place to
//! where it is now (of more than two fingers, the nearest such to all of them), and how it goes on when they go.
//!
//! Each move of a finger is applied at once, so that frame rates do not matter, and what is applied adds up to the
//! whole way of the fingers, however it is cut.

use glam::{DVec2, DVec4};

use super::inertia::{Throw, place_of};
use crate::viewer::events::{EventKind, GuiEventAdapter, TouchPhase};

/// Fingers that count; those that come later are not looked at.
const MOST_FINGERS: usize = 10;
/// Nearer to their middle than this, in picture heights, fingers neither stretch nor turn: their distance is noise.
const LEAST_SPREAD: f64 = 0.01;
/// One event never stretches by more than this power of e.
const MOST_STRETCH: f64 = 3.0;

/// A piece of what several fingers do, in picture heights from the middle, y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinch {
    /// The middle of the fingers before.
    pub from: DVec2,
    /// The middle of the fingers now.
    pub to: DVec2,
    /// The picture becomes larger by e to this.
    pub stretch: f64,
    /// Radians that the picture turns about the middle, counterclockwise.
    pub twist: f64,
}

impl Pinch {
    /// The middle's way.
    pub fn shift(&self) -> DVec2 {
        self.to - self.from
    }

    fn motion(&self) -> DVec4 {
        self.shift().extend(self.stretch).extend(self.twist)
    }
}

/// What an event of fingers means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Touched {
    /// Nothing: it is another event, or one of a single finger, which is the pointer.
    No,
    /// What went on comes to rest; there is nothing to apply.
    Rests,
    /// Several fingers moved.
    Pinched(Pinch),
}

/// Follows the fingers, and goes on after them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fingers {
    down: [Option<(u64, DVec2)>; MOST_FINGERS],
    throw: Throw<DVec4>,
    /// The middle of what is thrown.
    about: DVec2,
}

impl Fingers {
    /// Looks at an event.
    pub fn handle(&mut self, event: &GuiEventAdapter) -> Touched {
        let EventKind::Touch { id, phase, position_px } = event.kind else {
            if let EventKind::Push(_) | EventKind::DoubleClick(_) = event.kind {
                self.throw.stop();
            }
            return Touched::No;
        };
        let at = position_px.is_finite().then(|| place_of(position_px, &event.state));
        let known = self.down.iter().position(|finger| finger.is_some_and(|(down, _)| down == id));
        match (phase, known) {
            (TouchPhase::Began, _) => {
                let place = known.or_else(|| self.down.iter().position(Option::is_none));
                if let (Some(at), Some(finger)) = (at, place.and_then(|place| self.down.get_mut(place))) {
                    *finger = Some((id, at));
                }
                self.throw.stop();
                Touched::Rests
            }
            (_, None) => Touched::No,
            (TouchPhase::Moved, Some(place)) => match at.and_then(|at| self.moved(place, id, at)) {
                Some(pinch) => {
                    self.throw.moved(pinch.motion(), event.time_s);
                    Touched::Pinched(pinch)
                }
                None => Touched::No,
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
                    // The others go on from where they are.
                    _ => self.throw.stop(),
                }
                pinch.map_or(Touched::No, Touched::Pinched)
            }
            (TouchPhase::Cancelled, Some(place)) => {
                self.lift(place);
                self.throw.stop();
                Touched::Rests
            }
        }
    }

    /// What is thrown moves on for a time.
    pub fn advance(&mut self, dt_s: f64) -> Option<Pinch> {
        let motion = self.throw.advance(dt_s)?;
        let from = self.about;
        self.about += motion.truncate().truncate();
        Some(Pinch { from, to: self.about, stretch: motion.z, twist: motion.w })
    }

    /// Comes to rest. Fingers that are down count no more until they come again: whoever is not asked meanwhile does
    /// not hear that they went.
    pub fn stop(&mut self) {
        *self = Self::default();
    }

    /// Something is thrown.
    pub fn is_moving(&self) -> bool {
        self.throw.is_free()
    }

    /// Fingers that are down.
    pub fn count(&self) -> usize {
        self.down.iter().flatten().count()
    }

    fn lift(&mut self, place: usize) {
        if let Some(finger) = self.down.get_mut(place) {
            *finger = None;
        }
    }

    fn middle(&self) -> DVec2 {
        self.down.iter().flatten().map(|(_, at)| *at).sum::<DVec2>() / self.count().max(1) as f64
    }

    /// Puts a finger elsewhere; what it did to the picture together with the others.
    fn moved(&mut self, place: usize, id: u64, at: DVec2) -> Option<Pinch> {
        let before = self.down;
        let from = self.middle();
        if let Some(finger) = self.down.get_mut(place) {
            *finger = Some((id, at));
        }
        if self.count() < 2 || before == self.down {
            return None;
        }
        let to = self.middle();
        // Least squares: the best stretch is the ratio of the spreads' projections, the best turn the angle of the sum.
        let (mut dot, mut cross, mut square_before, mut square_now) = (0.0, 0.0, 0.0, 0.0);
        for ((_, a), (_, b)) in before.iter().flatten().zip(self.down.iter().flatten()) {
            let (a, b) = (*a - from, *b - to);
            dot += a.dot(b);
            cross += a.perp_dot(b);
            square_before += a.length_squared();
            square_now += b.length_squared();
        }
        let least = LEAST_SPREAD * LEAST_SPREAD * self.count() as f64;
        let stretch = 0.5 * (square_now.max(least) / square_before.max(least)).ln();
        let twist = if square_before > least && square_now > least { cross.atan2(dot) } else { 0.0 };
        self.about = to;
        Some(Pinch { from, to, stretch: stretch.clamp(-MOST_STRETCH, MOST_STRETCH), twist })
    }
}
