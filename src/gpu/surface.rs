//! What a window's surface answers when it is asked for an image, and what is done about it. Draw thread.

use std::collections::VecDeque;

use super::GpuError;

/// After a surface was made anew for so many frames in a row and stayed lost, its window is given up.
const MOST_LOST: u32 = 8;

/// An answer, without its image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceAnswer {
    /// An image.
    Optimal,
    /// An image, and the window is no longer as the surface was configured for.
    Suboptimal,
    /// No image in time.
    Timeout,
    /// The window is not seen.
    Occluded,
    /// The window has changed so that the surface must be configured anew.
    Outdated,
    /// The surface is gone; its device is not.
    Lost,
    /// wgpu found a mistake of ours.
    Validation,
}

impl SurfaceAnswer {
    pub(super) fn split(answer: wgpu::CurrentSurfaceTexture) -> (Self, Option<wgpu::SurfaceTexture>) {
        use wgpu::CurrentSurfaceTexture as Of;
        match answer {
            Of::Success(image) => (Self::Optimal, Some(image)),
            Of::Suboptimal(image) => (Self::Suboptimal, Some(image)),
            Of::Timeout => (Self::Timeout, None),
            Of::Occluded => (Self::Occluded, None),
            Of::Outdated => (Self::Outdated, None),
            Of::Lost => (Self::Lost, None),
            Of::Validation => (Self::Validation, None),
        }
    }
}

/// What comes next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// Draw into the image.
    Draw,
    /// No picture in this frame.
    Skip,
    /// Configure the surface and ask again.
    Configure,
    /// Make the surface anew, configure it and ask again.
    Remake,
}

/// How a surface fared so far.
#[derive(Debug, Default)]
pub(super) struct Health {
    /// To be configured before the next image is asked for.
    is_suboptimal: bool,
    /// It was, and said the same again: some windows always do.
    stays_suboptimal: bool,
    /// Frames in a row in which it was lost.
    lost: u32,
    /// What it answers next instead of asking, for tests.
    pub pretended: VecDeque<SurfaceAnswer>,
}

impl Health {
    /// True when it is to be configured before it is asked.
    pub fn wants_configure(&mut self) -> bool {
        std::mem::take(&mut self.is_suboptimal)
    }

    /// The window has another size.
    pub fn resized(&mut self) {
        (self.is_suboptimal, self.stays_suboptimal) = (false, false);
    }

    /// What an answer asks for; `is_again` where something was done in this frame already.
    pub fn next(&mut self, answer: SurfaceAnswer, is_again: bool) -> Result<Next, GpuError> {
        let next = match answer {
            SurfaceAnswer::Optimal => {
                *self = Self { pretended: std::mem::take(&mut self.pretended), ..Self::default() };
                Next::Draw
            }
            SurfaceAnswer::Suboptimal => {
                self.is_suboptimal = !self.stays_suboptimal;
                self.stays_suboptimal = true;
                self.lost = 0;
                Next::Draw
            }
            SurfaceAnswer::Timeout | SurfaceAnswer::Occluded => Next::Skip,
            SurfaceAnswer::Outdated if is_again => Next::Skip,
            SurfaceAnswer::Outdated => Next::Configure,
            SurfaceAnswer::Lost if is_again => {
                self.lost += 1;
                if self.lost >= MOST_LOST {
                    let reason = format!("lost, and still lost after it was made anew in {MOST_LOST} frames");
                    return Err(GpuError::Surface { reason });
                }
                Next::Skip
            }
            SurfaceAnswer::Lost => Next::Remake,
            SurfaceAnswer::Validation => {
                return Err(GpuError::Surface { reason: "refused by validation".to_owned() });
            }
        };
        Ok(next)
    }
}

#[cfg(test)]
mod tests {
    use super::SurfaceAnswer::{Lost, Occluded, Optimal, Outdated, Suboptimal, Timeout, Validation};
    use super::*;

    fn next(health: &mut Health, answer: SurfaceAnswer, is_again: bool) -> Next {
        health.next(answer, is_again).unwrap()
    }

    #[test]
    fn each_answer_has_its_treatment() {
        let mut health = Health::default();
        for (answer, first, again) in [
            (Optimal, Next::Draw, Next::Draw),
            (Suboptimal, Next::Draw, Next::Draw),
            (Timeout, Next::Skip, Next::Skip),
            (Occluded, Next::Skip, Next::Skip),
            (Outdated, Next::Configure, Next::Skip),
            (Lost, Next::Remake, Next::Skip),
        ] {
            assert_eq!(next(&mut health, answer, false), first, "{answer:?}");
            assert_eq!(next(&mut health, answer, true), again, "{answer:?} again");
        }
        let refused = health.next(Validation, false).unwrap_err().to_string();
        assert!(refused.contains("validation"), "{refused}");
    }

    #[test]
    fn one_that_stays_suboptimal_is_configured_once_until_it_changes() {
        let mut health = Health::default();
        let configured = |health: &mut Health, answer| {
            next(health, answer, false);
            health.wants_configure()
        };
        assert!(configured(&mut health, Suboptimal));
        assert!(!configured(&mut health, Suboptimal) && !configured(&mut health, Suboptimal));
        assert!(!configured(&mut health, Optimal));
        assert!(configured(&mut health, Suboptimal) && !configured(&mut health, Suboptimal));
        health.resized();
        assert!(configured(&mut health, Suboptimal));
    }

    #[test]
    fn a_window_is_given_up_after_some_frames_without_a_surface_and_not_before() {
        let mut health = Health::default();
        let mut frames = || {
            let mut count = 0;
            loop {
                count += 1;
                assert_eq!(next(&mut health, Lost, false), Next::Remake);
                if count == 5 {
                    // Nothing of it is forgotten by a frame that is late.
                    assert_eq!(next(&mut health, Timeout, false), Next::Skip);
                }
                match health.next(Lost, true) {
                    Ok(next) => assert_eq!(next, Next::Skip),
                    Err(error) => return (count, error.to_string()),
                }
            }
        };
        let (count, error) = frames();
        assert_eq!(count, MOST_LOST);
        assert!(error.contains("still lost"), "{error}");
        next(&mut health, Optimal, false);
        assert_eq!(next(&mut health, Lost, true), Next::Skip, "counted from the start");
    }
}
