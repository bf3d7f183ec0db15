//! [`Screen`]: a screen of the display; OSG's screen settings. Main thread.

use winit::event_loop::ActiveEventLoop;
use winit::monitor::MonitorHandle;

/// A screen of the display. Its number is its index in the list of all.
#[derive(Clone, Debug, PartialEq)]
pub struct Screen {
    /// The name that the window system gives it, if any.
    pub name: Option<String>,
    /// The upper left corner on the desktop, pixels.
    pub position_px: [i32; 2],
    /// The resolution: width and height in pixels.
    pub size_px: [u32; 2],
    /// Images per second; `None` where the window system does not tell.
    pub refresh_rate_hz: Option<f64>,
    /// Pixels per logical unit of the desktop, 1 on usual screens.
    pub scale_factor: f64,
}

impl Screen {
    /// Returns the screens of the display, in the order of the numbers in [`WindowSetup::screen`](super::WindowSetup::screen).
    pub fn all(event_loop: &ActiveEventLoop) -> Vec<Self> {
        event_loop.available_monitors().map(|monitor| Self::of(&monitor)).collect()
    }

    fn of(monitor: &MonitorHandle) -> Self {
        let (position, size) = (monitor.position(), monitor.size());
        Self {
            name: monitor.name(),
            position_px: [position.x, position.y],
            size_px: [size.width, size.height],
            refresh_rate_hz: monitor.refresh_rate_millihertz().map(|rate| f64::from(rate) / 1000.0),
            scale_factor: monitor.scale_factor(),
        }
    }
}
