//! [`ParentWindow`]: a window of another toolkit, or of another program, in which a viewer's window opens. Supported under X11,
//! Windows and macOS; Wayland has no such mechanism.
//!
//! The viewer's window is a child of the other window: it is moved, hidden and closed with it. Under X11 (by XEmbed, for
//! hosts that support it) it also fills the host. The viewer opens a second connection to the X server and listens for changes
//! of the host's size, so the host need not cooperate. On other systems the window has
//! [`ViewerConfig::size_px`](crate::viewer::ViewerConfig::size_px) until the host sends
//! ([`WindowCommand::Resize`](crate::viewer::WindowCommand::Resize)). Main thread.

use std::sync::Arc;

use winit::raw_window_handle::{HasWindowHandle, RawWindowHandle};

use crate::viewer::ViewerError;

/// A window of another toolkit or program, to open a viewer's window in.
#[derive(Clone)]
pub struct ParentWindow {
    pub(in crate::viewer) handle: Handle,
}

/// The window system's handle of the window.
#[cfg_attr(not(target_os = "linux"), allow(dead_code, reason = "X11 window ids are refused on other systems"))]
#[derive(Clone)]
pub(in crate::viewer) enum Handle {
    /// The id of the window in the X server.
    X11(u32),
    /// The host, which stays alive as long as this handle.
    #[cfg(any(target_os = "windows", target_os = "macos"))]
    Host(Arc<dyn HasWindowHandle>),
}

impl ParentWindow {
    /// Takes the id of a window in the X server of `DISPLAY`, as returned by GTK's socket, Qt's `winId` and Tk's `winfo id`.
    pub fn x11(window: u32) -> Self {
        Self { handle: Handle::X11(window) }
    }

    /// Takes the window of a host in this process, and keeps the host alive. Fails with [`ViewerError::ParentWindow`] when
    /// the window system does not support child windows of other toolkits.
    pub fn of(host: Arc<impl HasWindowHandle + 'static>) -> Result<Self, ViewerError> {
        let handle = host.window_handle().map_err(|e| {
            let reason = format!("the host's window has no handle: {e}");
            ViewerError::ParentWindow { system: "the host", reason }
        })?;
        match handle.as_raw() {
            #[cfg(target_os = "linux")]
            RawWindowHandle::Xlib(handle) => u32::try_from(handle.window).map(Self::x11).map_err(|_| {
                let reason = format!("there is no window {}", handle.window);
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

/// Makes window attributes those of a child of its host.
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
        // SAFETY: the handle is borrowed from the host's window, which `parent` keeps alive while the child opens.
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

pub(in crate::viewer) use child::attributes as child_attributes;

/// A change of the parent window.
#[cfg_attr(not(target_os = "linux"), allow(dead_code, reason = "parent windows are followed under X11 only"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::viewer) enum ParentChange {
    /// Its size has changed.
    Resized([u32; 2]),
    /// It was closed.
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

    /// A parent window whose size and end are followed over a connection of our own.
    pub(in crate::viewer) struct Followed {
        connection: RustConnection,
        window: u32,
        pub(in crate::viewer) size_px: [u32; 2],
    }

    impl Followed {
        /// Fails when there is no such window.
        pub(in crate::viewer) fn new(parent: &ParentWindow, _: [u32; 2]) -> Result<Self, ViewerError> {
            let Handle::X11(window) = parent.handle;
            let wrong = |what: String| ViewerError::Window(format!("cannot open in the window {window:#x}: {what}"));
            let (connection, _) = x11rb::connect(None).map_err(|e| wrong(e.to_string()))?;
            let events = ChangeWindowAttributesAux::new().event_mask(EventMask::STRUCTURE_NOTIFY);
            let asked = connection.change_window_attributes(window, &events).map_err(|e| wrong(e.to_string()))?;
            asked.check().map_err(|e| wrong(format!("there is no such window: {e}")))?;
            let size = connection.get_geometry(window).map_err(|e| wrong(e.to_string()))?;
            let size = size.reply().map_err(|e| wrong(e.to_string()))?;
            Ok(Self { connection, window, size_px: [size.width.into(), size.height.into()] })
        }

        /// Returns the change since the last call, without waiting.
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
                    // The connection to the server broke, so every window is gone.
                    Err(_) => return Some(ParentChange::Gone),
                }
            }
            let is_new = size_px != self.size_px;
            self.size_px = size_px;
            is_new.then_some(ParentChange::Resized(size_px))
        }

        /// Gives the keyboard focus to the child window; window managers do not do that for windows inside others.
        pub(in crate::viewer) fn focus(&self, inside: &ParentWindow) {
            let Handle::X11(inside) = inside.handle;
            let asked = self.connection.set_input_focus(InputFocus::PARENT, inside, x11rb::CURRENT_TIME);
            if let Err(error) = asked.and_then(|_| self.connection.flush()) {
                log::warn!("cannot set the keyboard focus: {error}");
            }
        }

        /// Returns true when the server does not know the window any more.
        pub(in crate::viewer) fn is_gone(&self) -> bool {
            self.connection.get_geometry(self.window).map_or(true, |asked| asked.reply().is_err())
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod followed {
    use super::{ParentChange, ParentWindow};
    use crate::viewer::ViewerError;

    /// A parent window that is not followed: the host sends its size, and closing it closes the child.
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

pub(in crate::viewer) use followed::Followed;

#[cfg(all(test, target_os = "linux"))]
#[allow(clippy::arc_with_non_send_sync, reason = "window handles of other systems are bound to one thread")]
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
        #[allow(unsafe_code, reason = "the handle is made up, and never used")]
        fn window_handle(&self) -> Result<WindowHandle<'_>, HandleError> {
            // SAFETY: no window is opened in it.
            self.0.clone().map(|raw| unsafe { WindowHandle::borrow_raw(raw) })
        }
    }

    fn of(handle: impl Into<RawWindowHandle>) -> Result<ParentWindow, ViewerError> {
        ParentWindow::of(Arc::new(Host(Ok(handle.into()))))
    }

    #[test]
    fn x11_windows_are_accepted_by_id_and_others_refused_by_name() {
        let xcb = of(XcbWindowHandle::new(NonZeroU32::new(77).unwrap())).unwrap();
        assert!(matches!(xcb.handle, Handle::X11(77)));
        let xlib = of(XlibWindowHandle::new(78)).unwrap();
        assert!(matches!(xlib.handle, Handle::X11(78)));
        let dangling = NonNull::dangling();
        for (host, says) in [
            (of(WaylandWindowHandle::new(dangling)), "window of Wayland"),
            (of(AppKitWindowHandle::new(dangling)), "window of macOS"),
            (of(WebWindowHandle::new(1)), "window of this kind"),
            (of(XlibWindowHandle::new(u64::MAX)), "there is no window 18446744073709551615"),
            (ParentWindow::of(Arc::new(Host(Err(HandleError::Unavailable)))), "has no handle"),
        ] {
            let error = host.err().unwrap();
            assert!(matches!(error, ViewerError::ParentWindow { .. }) && error.to_string().contains(says), "{error}");
        }
    }
}
