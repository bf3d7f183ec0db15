//! The display on which windows open: detection, its event loop, and errors that say what is missing. Main thread.

use winit::error::{EventLoopError, OsError};
use winit::event_loop::EventLoop;

use super::ViewerError;

/// True on systems where environment variables name the display.
const BY_VARIABLES: bool =
    cfg!(any(target_os = "linux", target_os = "freebsd", target_os = "openbsd", target_os = "netbsd"));

/// The environment variables that name a display, in order of precedence.
const VARIABLES: [&str; 3] = ["WAYLAND_DISPLAY", "WAYLAND_SOCKET", "DISPLAY"];

/// Returns true when there is a display on which a window could open.
pub fn has_display() -> bool {
    !BY_VARIABLES || named_display(false, value_of).is_some()
}

fn value_of(variable: &str) -> Option<String> {
    std::env::var_os(variable).map(|value| value.to_string_lossy().into_owned()).filter(|value| !value.is_empty())
}

/// Returns the variable that names the display, and its value; with `is_x11` only `DISPLAY` counts.
fn named_display(is_x11: bool, value_of: impl Fn(&str) -> Option<String>) -> Option<(&'static str, String)> {
    let variables = if is_x11 { &VARIABLES[2..] } else { &VARIABLES[..] };
    variables.iter().find_map(|name| value_of(name).map(|value| (*name, value)))
}

/// Creates the event loop. With `is_x11` it uses X11, because the window opens inside a window of X11.
pub(super) fn event_loop(is_x11: bool) -> Result<EventLoop<()>, ViewerError> {
    // winit panics when a library that it loads at run time is missing.
    #[cfg(target_os = "linux")]
    if let Some(library) = named_display(is_x11, value_of).and_then(|(name, _)| missing_library(name == "DISPLAY")) {
        return Err(unreachable_display(is_x11, &format!("the keyboard library {library} is missing")));
    }
    let event_loop = std::panic::catch_unwind(|| new_event_loop(is_x11))
        .map_err(|_| unreachable_display(is_x11, "the window system's libraries failed"))?;
    event_loop.map_err(|error| match error {
        EventLoopError::Os(error) => unreachable_display(is_x11, &reason_of(&error)),
        error => unreachable_display(is_x11, &error.to_string()),
    })
}

/// Returns the first missing library that winit requires, with the name of its Debian package.
#[cfg(target_os = "linux")]
fn missing_library(is_x11: bool) -> Option<&'static str> {
    if xkbcommon_dl::xkbcommon_option().is_none() {
        return Some("libxkbcommon (Debian: libxkbcommon0)");
    }
    let is_missing = is_x11 && xkbcommon_dl::x11::xkbcommon_x11_option().is_none();
    is_missing.then_some("libxkbcommon-x11 (Debian: libxkbcommon-x11-0)")
}

fn new_event_loop(is_x11: bool) -> Result<EventLoop<()>, EventLoopError> {
    let mut builder = EventLoop::builder();
    #[cfg(target_os = "linux")]
    {
        use winit::platform::x11::EventLoopBuilderExtX11 as _;
        if is_x11 {
            builder.with_x11();
        }
        // Tests do not run on the main thread.
        #[cfg(feature = "testing")]
        builder.with_any_thread(true);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = is_x11;
    builder.build()
}

fn unreachable_display(is_x11: bool, reason: &str) -> ViewerError {
    let display = match named_display(is_x11, value_of) {
        Some((name, value)) => format!("the display of {name}=`{value}`"),
        None if !BY_VARIABLES => "the display".to_owned(),
        None if is_x11 => "an X11 display, which DISPLAY does not name,".to_owned(),
        None => "a display, which neither WAYLAND_DISPLAY nor DISPLAY names,".to_owned(),
    };
    ViewerError::Display { display, reason: reason.to_owned() }
}

/// Returns the system's error text without the source location that winit prepends.
pub(super) fn reason_of(error: &OsError) -> String {
    without_source_location(&error.to_string()).to_owned()
}

fn without_source_location(text: &str) -> &str {
    // `path:line: reason`
    let split = text.strip_prefix("os error at ").and_then(|place| place.split_once(".rs:"));
    match split.and_then(|(_, rest)| rest.split_once(": ")) {
        Some((line, reason)) if !line.is_empty() && line.bytes().all(|b| b.is_ascii_digit()) => reason,
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_variable_is_the_one_that_winit_uses() {
        let of = |set: &'static [(&str, &str)]| {
            move |name: &str| set.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned())
        };
        let both = of(&[("DISPLAY", ":7"), ("WAYLAND_DISPLAY", "wayland-1")]);
        assert_eq!(named_display(false, both), Some(("WAYLAND_DISPLAY", "wayland-1".to_owned())));
        let both = of(&[("DISPLAY", ":7"), ("WAYLAND_SOCKET", "5")]);
        assert_eq!(named_display(false, both), Some(("WAYLAND_SOCKET", "5".to_owned())));
        assert_eq!(named_display(true, both), Some(("DISPLAY", ":7".to_owned())));
        assert_eq!(named_display(false, of(&[])), None);
        assert_eq!(named_display(true, of(&[("WAYLAND_DISPLAY", "wayland-1")])), None);
    }

    #[test]
    fn only_the_source_location_is_removed() {
        let with_place = "os error at /home/me/winit/src/x11.rs:765: no: connection";
        assert_eq!(without_source_location(with_place), "no: connection");
        assert_eq!(without_source_location(r"os error at C:\a b\mod.rs:7: gone"), "gone");
        for other in ["Failed to open", "os error at the end", "os error at a.rs:x: y", "os error at a.rs:12"] {
            assert_eq!(without_source_location(other), other);
        }
    }
}
