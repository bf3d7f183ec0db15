//! [`SurfaceHealth`]: the recovery of a window's surface that does not deliver an image. Draw thread; plain values.

use std::collections::VecDeque;

use crate::gpu::GpuError;

/// A window is given up after its surface was created again in this many frames in a row and stayed lost.
const MAX_LOST_FRAMES: u32 = 8;

/// The answer of a surface to the request for an image, without the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceAnswer {
    /// An image.
    Optimal,
    /// An image, although the window has changed since the surface was configured.
    Suboptimal,
    /// The image did not arrive in time.
    Timeout,
    /// The window is hidden.
    Occluded,
    /// The window has changed, so that the surface must be configured again.
    Outdated,
    /// The surface is lost, but not its device.
    Lost,
    /// wgpu's validation refused the request, which is a bug of the engine.
    Validation,
}

impl SurfaceAnswer {
    pub(super) fn split(answer: wgpu::CurrentSurfaceTexture) -> (Self, Option<wgpu::SurfaceTexture>) {
        use wgpu::CurrentSurfaceTexture as Answer;
        match answer {
            Answer::Success(image) => (Self::Optimal, Some(image)),
            Answer::Suboptimal(image) => (Self::Suboptimal, Some(image)),
            Answer::Timeout => (Self::Timeout, None),
            Answer::Occluded => (Self::Occluded, None),
            Answer::Outdated => (Self::Outdated, None),
            Answer::Lost => (Self::Lost, None),
            Answer::Validation => (Self::Validation, None),
        }
    }
}

/// The next step after an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SurfaceAction {
    /// Draw into the image.
    Draw,
    /// Skip the window in this frame.
    Skip,
    /// Configure the surface and request the image again.
    Configure,
    /// Create the surface again, configure it and request the image again.
    Recreate,
}

/// The state of a surface over several frames.
#[derive(Debug, Default)]
pub(super) struct SurfaceHealth {
    /// True if the surface must be configured before the next request.
    is_suboptimal: bool,
    /// True if the surface was configured and is suboptimal all the same, as some windows always are.
    stays_suboptimal: bool,
    /// The number of frames in a row in which the surface was lost.
    lost_frames: u32,
    /// The next answers of a test, which replace those of the surface.
    pub(super) pretended: VecDeque<SurfaceAnswer>,
}

impl SurfaceHealth {
    /// Returns true, once, if the surface must be configured before the next request.
    pub(super) fn take_configure(&mut self) -> bool {
        std::mem::take(&mut self.is_suboptimal)
    }

    /// Notes that the window has another size.
    pub(super) fn resized(&mut self) {
        (self.is_suboptimal, self.stays_suboptimal) = (false, false);
    }

    /// Returns the step after an answer. `is_retry` means that the surface was repaired in this frame already. Returns an
    /// error if the window should be given up.
    pub(super) fn next(&mut self, answer: SurfaceAnswer, is_retry: bool) -> Result<SurfaceAction, GpuError> {
        let next = match answer {
            SurfaceAnswer::Optimal => {
                *self = Self { pretended: std::mem::take(&mut self.pretended), ..Self::default() };
                SurfaceAction::Draw
            }
            SurfaceAnswer::Suboptimal => {
                self.is_suboptimal = !self.stays_suboptimal;
                self.stays_suboptimal = true;
                self.lost_frames = 0;
                SurfaceAction::Draw
            }
            SurfaceAnswer::Timeout | SurfaceAnswer::Occluded => SurfaceAction::Skip,
            SurfaceAnswer::Outdated if is_retry => SurfaceAction::Skip,
            SurfaceAnswer::Outdated => SurfaceAction::Configure,
            SurfaceAnswer::Lost if is_retry => {
                self.lost_frames += 1;
                if self.lost_frames >= MAX_LOST_FRAMES {
                    let reason = format!("lost, and still lost after it was created again in {MAX_LOST_FRAMES} frames");
                    return Err(GpuError::Surface { reason });
                }
                SurfaceAction::Skip
            }
            SurfaceAnswer::Lost => SurfaceAction::Recreate,
            SurfaceAnswer::Validation => {
                return Err(GpuError::Surface { reason: "wgpu's validation refused to deliver an image".to_owned() });
            }
        };
        Ok(next)
    }
}

#[cfg(test)]
mod tests {
    use super::SurfaceAnswer::{Lost, Occluded, Optimal, Outdated, Suboptimal, Timeout, Validation};
    use super::*;

    fn next(health: &mut SurfaceHealth, answer: SurfaceAnswer, is_retry: bool) -> SurfaceAction {
        health.next(answer, is_retry).unwrap()
    }

    #[test]
    fn each_answer_has_its_action() {
        let mut health = SurfaceHealth::default();
        for (answer, first, again) in [
            (Optimal, SurfaceAction::Draw, SurfaceAction::Draw),
            (Suboptimal, SurfaceAction::Draw, SurfaceAction::Draw),
            (Timeout, SurfaceAction::Skip, SurfaceAction::Skip),
            (Occluded, SurfaceAction::Skip, SurfaceAction::Skip),
            (Outdated, SurfaceAction::Configure, SurfaceAction::Skip),
            (Lost, SurfaceAction::Recreate, SurfaceAction::Skip),
        ] {
            assert_eq!(next(&mut health, answer, false), first, "{answer:?}");
            assert_eq!(next(&mut health, answer, true), again, "{answer:?} again");
        }
        let refused = health.next(Validation, false).unwrap_err().to_string();
        assert!(refused.contains("validation"), "{refused}");
    }

    #[test]
    fn persistently_suboptimal_surface_is_configured_once_until_it_changes() {
        let mut health = SurfaceHealth::default();
        let configured = |health: &mut SurfaceHealth, answer| {
            next(health, answer, false);
            health.take_configure()
        };
        assert!(configured(&mut health, Suboptimal));
        assert!(!configured(&mut health, Suboptimal) && !configured(&mut health, Suboptimal));
        assert!(!configured(&mut health, Optimal));
        assert!(configured(&mut health, Suboptimal) && !configured(&mut health, Suboptimal));
        health.resized();
        assert!(configured(&mut health, Suboptimal));
    }

    #[test]
    fn window_is_given_up_after_max_lost_frames() {
        let mut health = SurfaceHealth::default();
        let mut frames = || {
            let mut count = 0;
            loop {
                count += 1;
                assert_eq!(next(&mut health, Lost, false), SurfaceAction::Recreate);
                if count == 5 {
                    // A late frame does not reset the count.
                    assert_eq!(next(&mut health, Timeout, false), SurfaceAction::Skip);
                }
                match health.next(Lost, true) {
                    Ok(next) => assert_eq!(next, SurfaceAction::Skip),
                    Err(error) => return (count, error.to_string()),
                }
            }
        };
        let (count, error) = frames();
        assert_eq!(count, MAX_LOST_FRAMES);
        assert!(error.contains("still lost"), "{error}");
        next(&mut health, Optimal, false);
        assert_eq!(next(&mut health, Lost, true), SurfaceAction::Skip, "an image resets the count");
    }
}
