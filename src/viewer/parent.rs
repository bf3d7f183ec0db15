//! [`ParentWindow`]: a window of another toolkit, or of another program, in which a viewer's window opens. Under X11,
//! Windows and macOS; Wayland knows no such thing.
//!
//! The viewer's window is the other one's child: it moves, is hidden and closed with it. Under X11 (where XEmbed names it so
//! to hosts that know it) it fills the host too: X tells whoever asks when a window changes its size or goes, so the viewer
//! asks over a connection of its own, without a word from the host. Elsewhere it has
//! [`ViewerConfig::size_px`](super::ViewerConfig::size_px) until the host says otherwise
//! ([`WindowCommand::Resize`](super::WindowCommand::Resize)). Main thread.

use std::sync::Arc;

use winit::raw_window_handle::{HasWindowHandle, RawWindowHandle};

use super::ViewerError;

/// A window to open in.
#[derive(Clone)]
pub struct ParentWindow {
    pub(super) handle: Handle,
}

/// How this system knows the window.
#[cfg_attr(not(target_os = "linux"), allow(dead_code, reason = "numbers of X11 are refused there"))]
#[derive(Clone)]
pub(super) enum Handle {
    /// By its number in the X server.
    X11(u32),
    /// By what is alive as long as this is.
    #[cfg(any(target_os = "windows", target_os = "macos"))]
    Host(Arc<dyn HasWindowHandle>),
}

impl ParentWindow {
    /// The window of a number in the X server of `DISPLAY`: what GTK's socket, Qt's `winId` and Tk's `winfo id` give.
    pub fn x11(window: u32) -> Self {
        Self { handle: Handle::X11(window) }
    }

    /// The window of a host in this process, which lives as long as this. [`ViewerError::ParentWindow`] where windows of
    /// its window system have no children.
    pub fn of(host: Arc<impl HasWindowHandle + 'static>) -> Result<Self, ViewerError> {
        let handle = host.window_handle().map_err(|e| {
            let reason = format!("the host's window has no handle: {e}");
            ViewerError::ParentWindow { system: "the host", reason }
        })?;
        match handle.as_raw() {
            #[cfg(target_os = "linux")]
            RawWindowHandle::Xlib(handle) => u32::try_from(handle.window).map(Self::x11).map_err(|_| {
                let reason = format!("it has none of the number {}", handle.window);
                ViewerError::ParentWindow { system: "X11", reason }
            }),
            #[cfg(target_os = "linux")]
            RawWindowHandle::Xcb(handle) => Ok(Self::x11(handle.window.get())),
            #[cfg(target_os = "windows")]
            RawWindowHandle::Win32(_) => Ok(Self { handle: Handle::Host(host) }),
            #[cfg(target_os = "macos")]
            RawWindowHandle::AppKit(_) => Ok(Self { handle: Handle::Host(host) }),
            other => {
                let reason = "windows open in those of X11, Windows and macOS only, each on its own system".to_owned();
                Err(ViewerError::ParentWindow { system: system_of(&other), reason })
            }
        }
    }
}

fn system_of(handle: &RawWindowHandle) -> &'static str {
    match handle {
        RawWindowHandle::Wayland(_) => "Wayland",
        RawWindowHandle::Xlib(_) | RawWindowHandle::Xcb(_) => "X11",
        RawWindowHandle::Win32(_) | RawWindowHandle::WinRt(_) => "Windows",
        RawWindowHandle::AppKit(_) => "macOS",
        _ => "this kind",
    }
}

/// A window's attributes, as a child of its host.
#[cfg(any(target_os = "windows", target_os = "macos"))]
mod child {
    use winit::window::WindowAttributes;

    use super::Handle;
    use crate::viewer::ViewerError;

    #[allow(unsafe_code, reason = "winit cannot know whether a handle is that of a window")]
    pub(in crate::viewer) fn attributes(
        attributes: WindowAttributes,
        parent: &Handle,
    ) -> Result<WindowAttributes, ViewerError> {
        let Handle::Host(host) = parent else {
            let reason = "there is no X server on this system".to_owned();
            return Err(ViewerError::ParentWindow { system: "X11", reason });
        };
        let handle = host.window_handle().map_err(|e| {
            let reason = format!("the host's window has no handle: {e}");
            ViewerError::ParentWindow { system: "the host", reason }
        })?;
        // SAFETY: the handle is borrowed from the host's window, which is alive: `parent` shares it with whoever opens.
        Ok(unsafe { attributes.with_parent_window(Some(handle.as_raw())) })
    }
}

#[cfg(target_os = "linux")]
mod child {
    use winit::platform::x11::WindowAttributesExtX11 as _;
    use winit::window::WindowAttributes;

    use super::Handle;
    use crate::viewer::ViewerError;

    pub(in crate::viewer) fn attributes(
        attributes: WindowAttributes,
        parent: &Handle,
    ) -> Result<WindowAttributes, ViewerError> {
        let Handle::X11(window) = parent;
        Ok(attributes.with_embed_parent_window(*window))
    }
}

#[cfg(not(any(target_os = "linux", target_os = "windows", target_os = "macos")))]
mod child {
    use winit::window::WindowAttributes;

    use super::Handle;
    use crate::viewer::ViewerError;

    pub(in crate::viewer) fn attributes(_: WindowAttributes, _: &Handle) -> Result<WindowAttributes, ViewerError> {
        let reason = "windows open in others under Linux, Windows and macOS only".to_owned();
        Err(ViewerError::ParentWindow { system: "X11", reason })
    }
}

pub(super) use child::attributes as child_attributes;

/// What became of a window that is followed.
#[cfg_attr(not(target_os = "linux"), allow(dead_code, reason = "nothing is followed there"))]
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

    use super::{Handle, ParentChange, ParentWindow};
    use crate::viewer::ViewerError;

    /// A window whose size is followed.
    pub(in crate::viewer) struct Followed {
        connection: RustConnection,
        window: u32,
        pub(in crate::viewer) size_px: [u32; 2],
    }

    impl Followed {
        /// An error where there is no such window.
        pub(in crate::viewer) fn new(parent: &ParentWindow, _: [u32; 2]) -> Result<Self, ViewerError> {
            let Handle::X11(window) = parent.handle;
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
        pub(in crate::viewer) fn focus(&self, inside: &ParentWindow) {
            let Handle::X11(inside) = inside.handle;
            let asked = self.connection.set_input_focus(InputFocus::PARENT, inside, x11rb::CURRENT_TIME);
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

    /// A window that is not followed: its size is what the host says, and what is in it is closed with it.
    pub(in crate::viewer) struct Followed {
        pub(in crate::viewer) size_px: [u32; 2],
    }

    impl Followed {
        pub(in crate::viewer) fn new(_: &ParentWindow, size_px: [u32; 2]) -> Result<Self, ViewerError> {
            Ok(Self { size_px })
        }

        pub(in crate::viewer) fn look(&mut self) -> Option<ParentChange> {
            None
        }

        pub(in crate::viewer) fn focus(&self, _: &ParentWindow) {}

        pub(in crate::viewer) fn is_gone(&self) -> bool {
            false
        }
    }
}

pub(super) use followed::Followed;

#[cfg(all(test, target_os = "linux"))]
#[allow(clippy::arc_with_non_send_sync, reason = "handles of other systems are of one thread")]
mod tests {
    use std::num::NonZeroU32;
    use std::ptr::NonNull;

    use winit::raw_window_handle::{
        AppKitWindowHandle, HandleError, WaylandWindowHandle, WebWindowHandle, WindowHandle, XcbWindowHandle,
        XlibWindowHandle,
    };

    use super::*;

    struct Host(Result<RawWindowHandle, HandleError>);

    impl HasWindowHandle for Host {
        #[allow(unsafe_code, reason = "a handle is made of thin air, and nothing is done with it")]
        fn window_handle(&self) -> Result<WindowHandle<'_>, HandleError> {
            // SAFETY: nobody opens anything in it.
            self.0.clone().map(|raw| unsafe { WindowHandle::borrow_raw(raw) })
        }
    }

    fn of(handle: impl Into<RawWindowHandle>) -> Result<ParentWindow, ViewerError> {
        ParentWindow::of(Arc::new(Host(Ok(handle.into()))))
    }

    #[test]
    fn windows_of_x11_are_known_by_their_number_and_others_are_refused_by_name() {
        let xcb = of(XcbWindowHandle::new(NonZeroU32::new(77).unwrap())).unwrap();
        assert!(matches!(xcb.handle, Handle::X11(77)));
        let xlib = of(XlibWindowHandle::new(78)).unwrap();
        assert!(matches!(xlib.handle, Handle::X11(78)));
        let thin_air = NonNull::dangling();
        for (host, says) in [
            (of(WaylandWindowHandle::new(thin_air)), "window of Wayland"),
            (of(AppKitWindowHandle::new(thin_air)), "window of macOS"),
            (of(WebWindowHandle::new(1)), "window of this kind"),
            (of(XlibWindowHandle::new(u64::MAX)), "none of the number 18446744073709551615"),
            (ParentWindow::of(Arc::new(Host(Err(HandleError::Unavailable)))), "has no handle"),
        ] {
            let error = host.err().unwrap();
            assert!(matches!(error, ViewerError::ParentWindow { .. }) && error.to_string().contains(says), "{error}");
        }
    }
}
