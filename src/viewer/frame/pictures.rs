//! [`PictureRequests`]: the frames that are read back, and the images that came of them. Main thread; the image of a frame
//! arrives with the answer of its draw thread, up to two frames later.

use image::RgbaImage;

/// A callback for a frame that was read back: the number of the frame and its image.
pub type OnPicture = Box<dyn FnOnce(u32, RgbaImage)>;

/// A callback that waits for the image of a frame in a context.
struct Capture {
    context: u32,
    frame: u32,
    then: OnPicture,
}

/// Requests for images, of the application ([`Self::want`]) and of handlers ([`Self::capture`]).
#[derive(Default)]
pub(in crate::viewer) struct PictureRequests {
    /// Contexts whose next frame is read back.
    wanted: Vec<u32>,
    /// Contexts and frames that were wanted, are being drawn and have not been answered.
    in_flight: Vec<(u32, u32)>,
    /// Contexts, frames and images that the application has not taken.
    arrived: Vec<(u32, u32, RgbaImage)>,
    captures: Vec<Capture>,
}

impl PictureRequests {
    /// Has the next frame of a context read back.
    pub(in crate::viewer) fn want(&mut self, context: u32) {
        if !self.wanted.contains(&context) {
            self.wanted.push(context);
        }
    }

    /// Calls `then` with the image of a frame that has not been drawn.
    pub(in crate::viewer) fn capture(&mut self, context: u32, frame: u32, then: OnPicture) {
        self.captures.push(Capture { context, frame, then });
    }

    /// Takes the images of a context that have arrived, with their frames.
    pub(in crate::viewer) fn take(&mut self, context: u32) -> Vec<(u32, RgbaImage)> {
        let of_context = self.arrived.extract_if(.., |(of, _, _)| *of == context);
        of_context.map(|(_, frame, picture)| (frame, picture)).collect()
    }

    /// Returns true while a requested image has not arrived.
    pub(in crate::viewer) fn is_waiting(&self) -> bool {
        !(self.captures.is_empty() && self.wanted.is_empty() && self.in_flight.is_empty())
    }

    /// Assigns the wanted images to a frame that is about to be drawn.
    pub(super) fn begin_frame(&mut self, frame: u32) {
        self.in_flight.extend(self.wanted.drain(..).map(|context| (context, frame)));
    }

    /// Returns true when a frame of a context must be read back.
    pub(super) fn reads_back(&self, context: u32, frame: u32) -> bool {
        self.in_flight.contains(&(context, frame))
            || self.captures.iter().any(|of| (of.context, of.frame) == (context, frame))
    }

    /// Hands an image to those who asked for it.
    pub(super) fn deliver(&mut self, context: u32, frame: u32, picture: RgbaImage) {
        for capture in self.captures.extract_if(.., |of| (of.context, of.frame) == (context, frame)) {
            (capture.then)(frame, picture.clone());
        }
        if let Some(index) = self.in_flight.iter().position(|of| *of == (context, frame)) {
            self.in_flight.swap_remove(index);
            self.arrived.push((context, frame, picture));
        }
    }

    /// A frame gave no image, because it was lost or its window skipped it: captures wait for `next_frame` instead.
    pub(super) fn postpone(&mut self, context: u32, frame: u32, next_frame: u32) {
        for capture in self.captures.iter_mut().filter(|of| (of.context, of.frame) == (context, frame)) {
            capture.frame = next_frame;
        }
        self.in_flight.retain(|of| *of != (context, frame));
    }

    /// Drops the requests for a frame whose image cannot be read; the next frame would fail in the same way.
    pub(super) fn fail(&mut self, context: u32, frame: u32) {
        self.captures.retain(|of| (of.context, of.frame) != (context, frame));
        self.in_flight.retain(|of| *of != (context, frame));
    }

    /// Makes all captures wait for `next_frame` or a later one, because no frame is in flight any more.
    pub(super) fn restart(&mut self, next_frame: u32) {
        self.captures.iter_mut().for_each(|capture| capture.frame = next_frame.max(capture.frame));
        self.in_flight.clear();
    }

    /// Drops the requests for a context that was closed; images that arrived before stay.
    pub(super) fn forget_context(&mut self, context: u32) {
        self.wanted.retain(|of| *of != context);
        self.in_flight.retain(|(of, _)| *of != context);
        self.captures.retain(|of| of.context != context);
    }
}
