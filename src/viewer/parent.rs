//! [`ParentWindow`]: a window of another toolkit, or of another program, in which a viewer's window opens. Under X11.
//!
//! The viewer's window is the other one's child (XEmbed names it so to hosts that know it): it moves, is hidden and closed
//! with it, and fills it. X tells whoever asks when a window changes its size or goes, so the viewer asks over a
//! connection of its own, without a word from the host. Main thread.

use winit::raw_window_handle::{HandleError, HasWindowHandle, RawWindowHandle};

use super::ViewerError;

/// A window to open in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ParentWindow {
    /// Number of the window in the X server.
    pub(super) x11: u32,
}

impl ParentWindow {
    /// The window of a number in the X server of `DISPLAY`: what GTK's socket, Qt's `winId` and Tk's `winfo id` give.
    pub fn x11(window: u32) -> Self {
        Self { x11: window }
    }

    /// The window of a host in this process. An error where it is none of X11's.
    pub fn of(host: &impl HasWindowHandle) -> Result<Self, ViewerError> {
        let wrong = |e: HandleError| ViewerError::Window(format!("the host's window has no handle: {e}"));
        match host.window_handle().map_err(wrong)?.as_raw() {
            RawWindowHandle::Xlib(handle) => u32::try_from(handle.window)
                .map(Self::x11)
                .map_err(|_| ViewerError::Window(format!("{} is no window of X11", handle.window))),
            RawWindowHandle::Xcb(handle) => Ok(Self::x11(handle.window.get())),
            other => Err(ViewerError::Window(format!("only windows of X11 can be opened in, not {other:?}"))),
        }
    }
}

/// What became of a window that is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ParentChange {
    /// It has another size.
    Resized([u32; 2]),
    /// It is gone.
    Gone,
}

#[cfg(target_os = "linux")]
mod followed {
    use x11rb::connection::Connection as _;
    use x11rb::protocol::Event;
    use x11rb::protocol::xproto::{ChangeWindowAttributesAux, ConnectionExt as _, EventMask, InputFocus};
    use x11rb::rust_connection::RustConnection;

    use super::{ParentChange, ParentWindow};
    use crate::viewer::ViewerError;

    /// A window whose size is followed.
    pub(in crate::viewer) struct Followed {
        connection: RustConnection,
        window: u32,
        pub(in crate::viewer) size_px: [u32; 2],
    }

    impl Followed {
        /// An error where there is no such window.
        pub(in crate::viewer) fn new(parent: ParentWindow) -> Result<Self, ViewerError> {
            let window = parent.x11;
            let wrong = |what: String| ViewerError::Window(format!("the window {window:#x} to open in: {what}"));
            let (connection, _) = x11rb::connect(None).map_err(|e| wrong(e.to_string()))?;
            let events = ChangeWindowAttributesAux::new().event_mask(EventMask::STRUCTURE_NOTIFY);
            let asked = connection.change_window_attributes(window, &events).map_err(|e| wrong(e.to_string()))?;
            asked.check().map_err(|e| wrong(format!("there is none: {e}")))?;
            let size = connection.get_geometry(window).map_err(|e| wrong(e.to_string()))?;
            let size = size.reply().map_err(|e| wrong(e.to_string()))?;
            Ok(Self { connection, window, size_px: [size.width.into(), size.height.into()] })
        }

        /// What has become of it since the last call; does not wait.
        pub(in crate::viewer) fn look(&mut self) -> Option<ParentChange> {
            let mut size_px = self.size_px;
            loop {
                match self.connection.poll_for_event() {
                    Ok(Some(Event::ConfigureNotify(event))) if event.window == self.window => {
                        size_px = [event.width.into(), event.height.into()];
                    }
                    Ok(Some(Event::DestroyNotify(event))) if event.window == self.window => {
                        return Some(ParentChange::Gone);
                    }
                    Ok(Some(_)) => {}
                    Ok(None) => break,
                    // The server is gone, and every window with it.
                    Err(_) => return Some(ParentChange::Gone),
                }
            }
            let is_new = size_px != self.size_px;
            self.size_px = size_px;
            is_new.then_some(ParentChange::Resized(size_px))
        }

        /// Has keys go to the window inside: no window manager gives them to what is in another window.
        pub(in crate::viewer) fn focus(&self, inside: ParentWindow) {
            let asked = self.connection.set_input_focus(InputFocus::PARENT, inside.x11, x11rb::CURRENT_TIME);
            if let Err(error) = asked.and_then(|_| self.connection.flush()) {
                log::warn!("the keys cannot be asked for: {error}");
            }
        }

        /// True where the server does not know it any more.
        pub(in crate::viewer) fn is_gone(&self) -> bool {
            self.connection.get_geometry(self.window).map_or(true, |asked| asked.reply().is_err())
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod followed {
    use super::{ParentChange, ParentWindow};
    use crate::viewer::ViewerError;

    /// Nothing can be followed here.
    pub(in crate::viewer) struct Followed {
        pub(in crate::viewer) size_px: [u32; 2],
    }

    impl Followed {
        pub(in crate::viewer) fn new(_: ParentWindow) -> Result<Self, ViewerError> {
            Err(ViewerError::Window("windows open in others under X11 only".to_owned()))
        }

        pub(in crate::viewer) fn look(&mut self) -> Option<ParentChange> {
            None
        }

        pub(in crate::viewer) fn focus(&self, _: ParentWindow) {}

        pub(in crate::viewer) fn is_gone(&self) -> bool {
            false
        }
    }
}

pub(super) use followed::Followed;
