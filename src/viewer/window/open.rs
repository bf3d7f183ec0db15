//! Opens the windows of an [`Arrangement`], with their contexts and cameras. Main thread, in the event loop.

use std::sync::Arc;

use glam::DVec2;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event_loop::ActiveEventLoop;
use winit::monitor::MonitorHandle;
use winit::window::{CursorIcon, Fullscreen, Window};

use super::parent::{ParentWindow, child_attributes};
use super::slave_window::SlaveWindow;
use crate::cull::{Stereo, StereoMode};
use crate::gpu::ContextTraits;
use crate::viewer::ViewerError;
use crate::viewer::config::{Arrangement, CameraSetup, WindowSetup, across_screens, one_eye_per_screen};
use crate::viewer::display::reason_of;
use crate::viewer::frame::ViewerConfig;
use crate::viewer::ids::ContextId;
use crate::viewer::input::{MouseCursor, WindowCommand};
use crate::viewer::view::{Slave, View};
use crate::viewer::viewer::Viewer;

/// Executes a command on a window. Returns the new size when it changed at once, for which winit sends no event.
pub(in crate::viewer) fn obey(window: &Window, command: WindowCommand) -> Option<[u32; 2]> {
    match command {
        WindowCommand::ToggleFullScreen => {
            window.set_fullscreen(window.fullscreen().is_none().then_some(Fullscreen::Borderless(None)));
            None
        }
        WindowCommand::Resize([width, height]) => {
            window.set_fullscreen(None);
            let now = window.request_inner_size(PhysicalSize::new(width.max(1), height.max(1)))?;
            Some([now.width, now.height])
        }
        WindowCommand::SetCursor(cursor) => {
            window.set_cursor_visible(cursor != MouseCursor::None);
            window.set_cursor(icon_of(cursor));
            None
        }
        WindowCommand::WarpPointer(DVec2 { x, y }) => {
            if let Err(error) = window.set_cursor_position(PhysicalPosition::new(x, y)) {
                log::debug!("the pointer cannot be moved: {error}");
            }
            None
        }
    }
}

fn icon_of(cursor: MouseCursor) -> CursorIcon {
    match cursor {
        MouseCursor::Inherit | MouseCursor::None | MouseCursor::Arrow => CursorIcon::Default,
        MouseCursor::Help => CursorIcon::Help,
        MouseCursor::Wait => CursorIcon::Wait,
        MouseCursor::Text => CursorIcon::Text,
        MouseCursor::Crosshair => CursorIcon::Crosshair,
        MouseCursor::Hand => CursorIcon::Pointer,
        MouseCursor::Grab => CursorIcon::Grab,
        MouseCursor::Grabbing => CursorIcon::Grabbing,
        MouseCursor::Move => CursorIcon::Move,
        MouseCursor::UpDown => CursorIcon::NsResize,
        MouseCursor::LeftRight => CursorIcon::EwResize,
        MouseCursor::UpperLeftLowerRight => CursorIcon::NwseResize,
        MouseCursor::UpperRightLowerLeft => CursorIcon::NeswResize,
        MouseCursor::NotAllowed => CursorIcon::NotAllowed,
    }
}

/// Returns the windows of an arrangement on this display, followed by those of the application's slaves.
pub(in crate::viewer) fn windows(
    event_loop: &ActiveEventLoop,
    arrangement: &Arrangement,
    slaves: Vec<SlaveWindow>,
    stereo: Option<&Stereo>,
) -> Vec<WindowSetup> {
    let mut windows = match arrangement {
        Arrangement::Windows(windows) => windows.clone(),
        // `run_window` has refused several views before.
        Arrangement::Usual | Arrangement::Views(_) => Vec::new(),
        Arrangement::AllScreens => {
            let place = |monitor: MonitorHandle| {
                let (PhysicalPosition { x, y }, PhysicalSize { width, height }) = (monitor.position(), monitor.size());
                [x, y, width as i32, height as i32]
            };
            let screens: Vec<_> = event_loop.available_monitors().map(place).collect();
            let split = stereo.filter(|stereo| stereo.mode == StereoMode::HorizontalSplit);
            split.and_then(|_| one_eye_per_screen(&screens)).unwrap_or_else(|| across_screens(&screens))
        }
    };
    if windows.is_empty() {
        windows.push(WindowSetup::default());
    }
    windows.extend(slaves.into_iter().map(WindowSetup::from));
    windows
}

/// Opens a window inside a window of another toolkit.
pub(in crate::viewer) fn create_in(
    event_loop: &ActiveEventLoop,
    parent: &ParentWindow,
    title: &str,
    [width, height]: [u32; 2],
) -> Result<Arc<Window>, ViewerError> {
    let attributes = Window::default_attributes()
        .with_title(title)
        .with_position(PhysicalPosition::new(0, 0))
        .with_inner_size(PhysicalSize::new(width.max(1), height.max(1)))
        .with_decorations(false);
    let attributes = child_attributes(attributes, &parent.handle)?;
    let window = event_loop.create_window(attributes).map_err(|e| ViewerError::Window(reason_of(&e)))?;
    Ok(Arc::new(window))
}

/// Opens a window. `index` counts the windows from 0.
pub(in crate::viewer) fn create(
    event_loop: &ActiveEventLoop,
    setup: &WindowSetup,
    index: usize,
    title: &str,
    size_px: [u32; 2],
) -> Result<Arc<Window>, ViewerError> {
    let monitor = match setup.screen {
        Some(number) => {
            let monitor = event_loop.available_monitors().nth(number);
            let count = event_loop.available_monitors().count();
            let none =
                || ViewerError::Window(format!("there is no screen {number}; the display has {count}, counted from 0"));
            Some(monitor.ok_or_else(none)?)
        }
        None => event_loop.primary_monitor().or_else(|| event_loop.available_monitors().next()),
    };
    let origin = monitor.as_ref().map_or(PhysicalPosition::new(0, 0), MonitorHandle::position);
    let [mut width, mut height] = setup.size_px.unwrap_or(size_px);
    let mut position = setup.position_px.or(setup.screen.map(|_| [0, 0]));
    if let (true, Some(monitor)) = (setup.full_screen, &monitor) {
        // For displays without a window manager that would fill the screen.
        (width, height) = monitor.size().into();
        position = Some([0, 0]);
    }
    let title = match (&setup.title, index) {
        (Some(title), _) => title.clone(),
        (None, 0) => title.to_owned(),
        (None, index) => format!("{title} {}", index + 1),
    };
    let mut attributes = Window::default_attributes()
        .with_title(title)
        .with_inner_size(PhysicalSize::new(width.max(1), height.max(1)))
        .with_decorations(setup.decorated);
    if let Some([x, y]) = position {
        attributes = attributes.with_position(PhysicalPosition::new(origin.x + x, origin.y + y));
    }
    if setup.full_screen {
        attributes = attributes.with_fullscreen(Some(Fullscreen::Borderless(monitor)));
    }
    let window = event_loop.create_window(attributes).map_err(|e| ViewerError::Window(reason_of(&e)))?;
    Ok(Arc::new(window))
}

/// Returns the size of the area that is drawn into, in pixels.
pub(in crate::viewer) fn size_of(window: &Window) -> [u32; 2] {
    let size = window.inner_size();
    [size.width.max(1), size.height.max(1)]
}

/// Adds a context with its cameras for a window beside the first one.
pub(in crate::viewer) fn add_beside(
    viewer: &mut Viewer,
    config: &ViewerConfig,
    setup: &WindowSetup,
    window: &Arc<Window>,
) -> Result<ContextId, ViewerError> {
    let traits = ContextTraits {
        size_px: size_of(window),
        samples: setup.samples.unwrap_or(config.samples),
        vsync: setup.vsync.unwrap_or(config.vsync),
        ..config.traits()
    };
    let first = viewer.contexts().next().filter(|_| setup.shares_device);
    let context = match first {
        Some(first) => viewer.composite_mut().open_window_on(first, Arc::clone(window), &traits)?,
        None => viewer.open_window(Arc::clone(window), &traits)?,
    };
    add_slaves(viewer, context, &setup.cameras)?;
    Ok(context)
}

/// Gives the master camera its part of a window of the given size.
pub(in crate::viewer) fn set_master(view: &mut View, camera: &CameraSetup, window_px: [u32; 2]) {
    view.set_viewport(camera.viewport);
    view.set_eyes(camera.eyes);
    if let Some(policy) = camera.resize {
        view.camera.set_resize_policy(policy, camera.viewport.image_px(window_px));
    }
}

/// Adds slave cameras in a context.
pub(in crate::viewer) fn add_slaves(
    viewer: &mut Viewer,
    context: ContextId,
    cameras: &[CameraSetup],
) -> Result<(), ViewerError> {
    for camera in cameras {
        let CameraSetup { viewport, projection_offset, view_offset, eyes, .. } = *camera;
        viewer.add_slave(Slave { viewport, projection_offset, view_offset, eyes, ..Slave::new(context) })?;
    }
    Ok(())
}
