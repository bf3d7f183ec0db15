//! [`Arrangement`]: which windows open, where, and what each shows. Main thread, before anything opens.
//!
//! What an application has not arranged itself is arranged as the environment says, in the reference's order:
//!
//! ```text
//! TERRANE_CONFIG_FILE   a file with windows and cameras, or with several views: arrangement_file.rs has its format
//! TERRANE_WINDOW        "x y width height" in pixels, on the screen of TERRANE_SCREEN where that is said too
//! TERRANE_SCREEN        the number of a screen, counted from 0, to be filled; "all": all of them
//! ```

use std::path::Path;

#[cfg(any(feature = "window", test))]
use glam::DVec3;
use glam::{DAffine3, DMat4};

use super::arrangement_file::read_arrangement;
use super::camera::ResizePolicy;
use super::view::Eyes;
use super::viewport::Viewport;
use super::views_setup::ViewsSetup;

/// The environment variable that names a file with windows.
pub const CONFIG_FILE_VARIABLE: &str = "TERRANE_CONFIG_FILE";
/// The environment variable with the place and size of a window.
pub const WINDOW_VARIABLE: &str = "TERRANE_WINDOW";
/// The environment variable that names a screen.
pub const SCREEN_VARIABLE: &str = "TERRANE_SCREEN";

/// Sides of a window that can be asked for, pixels.
const MOST_PX: u32 = 16_384;

/// A camera in a window.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSetup {
    /// Part of the window.
    pub viewport: Viewport,
    /// What a picture of another shape shows, of the master; `None`: the angle of view is that of the longer side. Pictures
    /// of slaves are parts of the master's.
    pub resize: Option<ResizePolicy>,
    /// See [`Slave::projection_offset`](super::Slave::projection_offset).
    pub projection_offset: DMat4,
    /// See [`Slave::view_offset`](super::Slave::view_offset).
    pub view_offset: DAffine3,
    /// Its eyes, where the view is drawn for two.
    pub eyes: Eyes,
}

impl Default for CameraSetup {
    /// Sees what the master sees, in all of its window.
    fn default() -> Self {
        Self {
            viewport: Viewport::Whole,
            resize: None,
            projection_offset: DMat4::IDENTITY,
            view_offset: DAffine3::IDENTITY,
            eyes: Eyes::Both,
        }
    }
}

/// A window and its cameras.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowSetup {
    /// Its title; `None`: that of [`WindowOptions`](super::WindowOptions), with a number behind the first.
    pub title: Option<String>,
    /// Upper left corner, from that of its screen; `None`: where the system puts it.
    pub position_px: Option<[i32; 2]>,
    /// Width and height; `None`: those of [`ViewerConfig`](super::ViewerConfig).
    pub size_px: Option<[u32; 2]>,
    /// Number of its screen, counted from 0; `None`: the system's first one.
    pub screen: Option<usize>,
    /// It fills its screen.
    pub full_screen: bool,
    /// It has a frame and a title bar.
    pub decorated: bool,
    /// It has the first window's device, so that everything is uploaded once; see
    /// [`Viewer::open_window_on`](super::Viewer::open_window_on).
    pub shares_device: bool,
    /// Samples a pixel, 1 or 4; `None`: the configuration's.
    pub samples: Option<u32>,
    /// Waits for the screen; `None`: as the configuration says.
    pub vsync: Option<bool>,
    /// In the order drawn. The first camera of the first window is the master, which has no offsets; all others are its
    /// slaves.
    pub cameras: Vec<CameraSetup>,
}

impl Default for WindowSetup {
    /// A window of the configuration's size with one camera.
    fn default() -> Self {
        Self {
            title: None,
            position_px: None,
            size_px: None,
            screen: None,
            full_screen: false,
            decorated: true,
            shares_device: false,
            samples: None,
            vsync: None,
            cameras: vec![CameraSetup::default()],
        }
    }
}

/// Which windows open.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Arrangement {
    /// What the environment says; where it says nothing, a window of the configuration's size.
    #[default]
    Usual,
    /// These, never none.
    Windows(Vec<WindowSetup>),
    /// A window that fills each screen, parts of one picture as the screens lie beside each other: the master has the
    /// middle one. They share a device. Two screens with stereo in [`StereoMode::HorizontalSplit`](crate::cull::StereoMode)
    /// show an eye each instead, as in OSG. What the reference does where the environment says nothing.
    AllScreens,
    /// Several views in windows: for `run_views`, and refused where a program shows one.
    Views(ViewsSetup),
}

/// An arrangement that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{source_name}: {field}{}{reason}", if field.is_empty() { "" } else { ": " })]
pub struct ArrangementError {
    /// The file or the variable.
    pub source_name: String,
    /// What in it, as `windows[1].size_px`; empty where it is all of it.
    pub field: String,
    /// What was wrong.
    pub reason: String,
}

impl Arrangement {
    /// What the environment says; `None` where it says nothing.
    pub fn from_environment() -> Result<Option<Self>, ArrangementError> {
        Self::from_variables(|name| std::env::var_os(name).map(|value| value.to_string_lossy().into_owned()))
    }

    /// What variables say, in the order above; those that are empty count as not set.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, ArrangementError> {
        let said = |name: &str| variable(name).filter(|value| !value.trim().is_empty());
        if let Some(file) = said(CONFIG_FILE_VARIABLE) {
            return Self::read(Path::new(file.trim())).map(Some);
        }
        let wrong = |name: &str, value: &str, expected: &str| ArrangementError {
            source_name: name.to_owned(),
            field: String::new(),
            reason: format!("`{value}` is not {expected}"),
        };
        let mut is_all = false;
        let screen = match said(SCREEN_VARIABLE) {
            Some(value) if value.trim().eq_ignore_ascii_case("all") => {
                is_all = true;
                None
            }
            Some(value) => match value.trim().parse::<usize>() {
                Ok(screen) => Some(screen),
                Err(_) => return Err(wrong(SCREEN_VARIABLE, &value, "the number of a screen, nor `all`")),
            },
            None => None,
        };
        if let Some(value) = said(WINDOW_VARIABLE) {
            let numbers: Result<Vec<i32>, _> = value.split_whitespace().map(str::parse).collect();
            let is_side = |side: i32| u32::try_from(side).ok().filter(|side| (1..=MOST_PX).contains(side));
            let Some((x, y, width, height)) = numbers.ok().and_then(|n| match n[..] {
                [x, y, width, height] => Some((x, y, is_side(width)?, is_side(height)?)),
                _ => None,
            }) else {
                return Err(wrong(WINDOW_VARIABLE, &value, "`x y width height` in pixels"));
            };
            let window = WindowSetup {
                position_px: Some([x, y]),
                size_px: Some([width, height]),
                screen,
                ..WindowSetup::default()
            };
            return Ok(Some(Self::Windows(vec![window])));
        }
        if is_all {
            return Ok(Some(Self::AllScreens));
        }
        let filling = |screen| WindowSetup { screen: Some(screen), full_screen: true, ..WindowSetup::default() };
        Ok(screen.map(|screen| Self::Windows(vec![filling(screen)])))
    }

    /// Reads a file of windows, or of windows and views.
    pub fn read(file: &Path) -> Result<Self, ArrangementError> {
        read_arrangement(file)
    }
}

/// A window on each of two screens, left and right, one for each eye; `None` where there are not two.
#[cfg(any(feature = "window", test))]
pub(super) fn an_eye_each(screens: &[[i32; 4]]) -> Option<Vec<WindowSetup>> {
    let &[a, b] = screens else { return None };
    let [left, right] = if a <= b { [0, 1] } else { [1, 0] };
    let window = |screen: usize, eyes: Eyes| WindowSetup {
        screen: Some(screen),
        full_screen: true,
        shares_device: eyes == Eyes::Right,
        cameras: vec![CameraSetup { eyes, ..CameraSetup::default() }],
        ..WindowSetup::default()
    };
    Some(vec![window(left, Eyes::Left), window(right, Eyes::Right)])
}

/// A window for each screen (x, y, width and height in the desktop's pixels): the middle one first, the others seeing
/// what is beside it.
#[cfg(any(feature = "window", test))]
pub(super) fn across(screens: &[[i32; 4]]) -> Vec<WindowSetup> {
    let mut places: Vec<usize> = (0..screens.len()).collect();
    places.sort_by_key(|place| screens[*place]);
    let middle = places.len() / 2;
    let Some(master) = places.get(middle).copied() else { return vec![WindowSetup::default()] };
    places.remove(middle);
    let center = |screen: usize| {
        let [x, y, width, height] = screens[screen].map(f64::from);
        [x + 0.5 * width, y + 0.5 * height]
    };
    let size = |screen: usize| [screens[screen][2], screens[screen][3]].map(|side| f64::from(side.max(1)));
    let window = |screen: usize, projection_offset: DMat4| WindowSetup {
        screen: Some(screen),
        full_screen: true,
        shares_device: screen != master,
        cameras: vec![CameraSetup { projection_offset, ..CameraSetup::default() }],
        ..WindowSetup::default()
    };
    let beside = places.into_iter().map(|screen| {
        let ([x, y], [mx, my]) = (center(screen), center(master));
        let ([width, height], [mw, mh]) = (size(screen), size(master));
        // Where its middle is in the master's clip space, whose y goes up.
        let at = DVec3::new(2.0 * (x - mx) / mw, -2.0 * (y - my) / mh, 0.0);
        let grows = DVec3::new(mw / width, mh / height, 1.0);
        window(screen, DMat4::from_scale(grows) * DMat4::from_translation(-at))
    });
    std::iter::once(window(master, DMat4::IDENTITY)).chain(beside).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Result<Option<Arrangement>, ArrangementError> {
        let find = |name: &str| variables.iter().find(|(of, _)| *of == name).map(|(_, value)| (*value).to_owned());
        Arrangement::from_variables(find)
    }

    #[test]
    fn variables_are_asked_in_the_references_order() {
        assert_eq!(of(&[]), Ok(None));
        assert_eq!(of(&[("TERRANE_WINDOW", " "), ("TERRANE_SCREEN", "")]), Ok(None));
        let window = WindowSetup {
            position_px: Some([-10, 20]),
            size_px: Some([640, 480]),
            screen: Some(1),
            ..WindowSetup::default()
        };
        let both = [("TERRANE_WINDOW", "-10 20  640 480"), ("TERRANE_SCREEN", "1")];
        assert_eq!(of(&both), Ok(Some(Arrangement::Windows(vec![window]))));
        let filling = WindowSetup { screen: Some(1), full_screen: true, ..WindowSetup::default() };
        assert_eq!(of(&both[1..]), Ok(Some(Arrangement::Windows(vec![filling]))));
        assert_eq!(of(&[("TERRANE_SCREEN", "ALL")]), Ok(Some(Arrangement::AllScreens)));
        // The file comes before all of them, and one that cannot be read is an error, not the next in order.
        let with_file = [("TERRANE_CONFIG_FILE", "/no/such/file"), both[0]];
        assert_eq!(of(&with_file).unwrap_err().source_name, "/no/such/file");
        for wrong in ["1 2 3", "1 2 3 0", "1 2 3 -4", "1 2 3 4 5", "a b c d", "1 2 99999 4", "1.5 2 3 4"] {
            let error = of(&[("TERRANE_WINDOW", wrong)]).unwrap_err();
            assert!(error.to_string().starts_with("TERRANE_WINDOW: `"), "{error}");
        }
        assert!(of(&[("TERRANE_SCREEN", "-1")]).unwrap_err().to_string().contains("number of a screen"));
    }

    #[test]
    fn screens_side_by_side_are_one_picture() {
        // The middle one is larger and stands lower.
        let screens = [[1000, 0, 2000, 1000], [0, 250, 1000, 500], [3000, 0, 1000, 1000]];
        let windows = across(&screens);
        assert_eq!(windows.iter().map(|w| w.screen).collect::<Vec<_>>(), [Some(0), Some(1), Some(2)]);
        assert!(!windows[0].shares_device && windows[1].shares_device && windows.iter().all(|w| w.full_screen));
        let offset = |window: usize| windows[window].cameras[0].projection_offset;
        assert_eq!(offset(0), DMat4::IDENTITY);
        // The corner of the desktop that both touch: the master's left edge, at the left screen's upper right corner.
        let left = offset(1).project_point3(DVec3::new(-1.0, 0.5, 0.0));
        assert!((left - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-12, "{left}");
        let right = offset(2).project_point3(DVec3::new(1.0, -1.0, 0.0));
        assert!((right - DVec3::new(-1.0, -1.0, 0.0)).length() < 1e-12, "{right}");
        assert_eq!(an_eye_each(&screens), None);
        let windows = an_eye_each(&[[1000, 0, 10, 10], [0, 0, 10, 10]]).unwrap();
        let eyes: Vec<_> = windows.iter().map(|w| (w.screen, w.cameras[0].eyes)).collect();
        assert_eq!(eyes, [(Some(1), Eyes::Left), (Some(0), Eyes::Right)]);
        assert_eq!(across(&[]), [WindowSetup::default()]);
        assert_eq!(across(&[[0, 0, 640, 480]]).len(), 1);
    }
}
