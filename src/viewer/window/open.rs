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
use crate::viewer::composite::CompositeViewer;
use crate::viewer::config::{Arrangement, CameraSetup, Screen, WindowSetup, across_screens, one_eye_per_screen};
use crate::viewer::display::reason_of;
use crate::viewer::frame::ViewerConfig;
use crate::viewer::ids::{ContextId, SlaveId, ViewId};
use crate::viewer::input::{MouseCursor, WindowCommand};
use crate::viewer::view::View;
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
        // The event loops carry them out.
        WindowCommand::Close(_) | WindowCommand::SetUp(_) => None,
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
            let place =
                |Screen { position_px: [x, y], size_px: [width, height], .. }| [x, y, width as i32, height as i32];
            let screens: Vec<_> = Screen::all(event_loop).into_iter().map(place).collect();
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

/// Returns the traits of a window's context.
pub(in crate::viewer) fn traits_of(config: &ViewerConfig, setup: &WindowSetup, window: &Window) -> ContextTraits {
    let monitor = window.current_monitor();
    let at = window.outer_position().unwrap_or_default();
    let origin = monitor.as_ref().map_or(PhysicalPosition::new(0, 0), MonitorHandle::position);
    let number = |monitor| setup.screen.or_else(|| number_of(window, monitor)).unwrap_or(0);
    ContextTraits {
        screen: u32::try_from(monitor.as_ref().map_or(0, number)).unwrap_or(u32::MAX),
        position_px: [at.x - origin.x, at.y - origin.y],
        ..setup.traits(config, size_of(window))
    }
}

/// Returns the number of a screen.
fn number_of(window: &Window, monitor: &MonitorHandle) -> Option<usize> {
    window.available_monitors().position(|of| of == *monitor)
}

/// A window and its context.
pub(in crate::viewer) type WindowOfContext = (Arc<Window>, ContextId);

/// Opens windows for a view that is shown already: the first one gets its master camera, and their other cameras replace its
/// slaves. After an error nothing has changed.
pub(in crate::viewer) fn set_up(
    event_loop: &ActiveEventLoop,
    viewer: &mut CompositeViewer,
    (view, config, title): (ViewId, &ViewerConfig, &str),
    arrangement: &Arrangement,
) -> Result<Vec<WindowOfContext>, ViewerError> {
    if let Arrangement::Views(_) = arrangement {
        let reason = "an arrangement of several views cannot be set up for one view".to_owned();
        return Err(ViewerError::Window(reason));
    }
    let setups = windows(event_loop, arrangement, Vec::new(), config.stereo.as_ref());
    let mut opened: Vec<WindowOfContext> = Vec::new();
    let shared = viewer.view(view)?.contexts().next().or_else(|| viewer.contexts().next());
    for (index, setup) in setups.iter().enumerate() {
        let result = create(event_loop, setup, index, title, config.size_px).and_then(|window| {
            let traits = traits_of(config, setup, &window);
            let context = match shared {
                Some(shared) => viewer.open_window_on(shared, Arc::clone(&window), &traits)?,
                None => viewer.open_window(Arc::clone(&window), &traits)?,
            };
            Ok((window, context))
        });
        match result {
            Ok(window) => opened.push(window),
            Err(error) => {
                for (_, context) in opened {
                    viewer.close_context(context)?;
                }
                return Err(error);
            }
        }
    }
    let slaves: Vec<SlaveId> = viewer.view(view)?.slaves().map(|(id, _)| id).collect();
    for slave in slaves {
        viewer.remove_slave(view, slave)?;
    }
    for (index, (setup, (window, context))) in setups.iter().zip(&opened).enumerate() {
        let mut slaves = &setup.cameras[..];
        if index == 0 {
            viewer.move_view(view, *context)?;
            if let Some((master, others)) = slaves.split_first() {
                set_master(viewer.view_mut(view)?, master, size_of(window));
                slaves = others;
            }
        }
        add_slaves(viewer, view, *context, slaves)?;
    }
    Ok(opened)
}

/// Adds a context with its cameras for a window beside the first one.
pub(in crate::viewer) fn add_beside(
    viewer: &mut Viewer,
    config: &ViewerConfig,
    setup: &WindowSetup,
    window: &Arc<Window>,
) -> Result<ContextId, ViewerError> {
    let traits = traits_of(config, setup, window);
    let first = viewer.context();
    let context = match setup.shares_device {
        true => viewer.composite_mut().open_window_on(first, Arc::clone(window), &traits)?,
        false => viewer.open_window(Arc::clone(window), &traits)?,
    };
    let view = viewer.view_id();
    add_slaves(viewer.composite_mut(), view, context, &setup.cameras)?;
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

/// Adds slave cameras of a view in a context.
pub(in crate::viewer) fn add_slaves(
    viewer: &mut CompositeViewer,
    view: ViewId,
    context: ContextId,
    cameras: &[CameraSetup],
) -> Result<(), ViewerError> {
    for camera in cameras {
        viewer.add_slave(view, camera.slave_in(context))?;
    }
    Ok(())
}
