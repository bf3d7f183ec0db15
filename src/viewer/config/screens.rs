//! Windows side by side: one image across all screens or across a wall of windows, or one eye on each of two screens.
//!
//! Screens are given as x, y, width and height in the desktop's pixels.

use glam::{DMat4, DVec3};

use super::arrangement::Arrangement;
use super::window_setup::{CameraSetup, MAX_SIDE_PX, WindowSetup};
use crate::viewer::view::Eyes;

/// Returns a window for the left eye on the left screen and one for the right eye on the right screen; `None` unless there
/// are exactly two screens.
#[cfg_attr(not(feature = "window"), allow(dead_code, reason = "used by windows"))]
pub(in crate::viewer) fn one_eye_per_screen(screens: &[[i32; 4]]) -> Option<Vec<WindowSetup>> {
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

/// Returns a full-screen window for each screen. The middle screen comes first and has the master camera; the slaves on
/// the others extend its image across the desktop.
#[cfg_attr(not(feature = "window"), allow(dead_code, reason = "used by windows"))]
pub(in crate::viewer) fn across_screens(screens: &[[i32; 4]]) -> Vec<WindowSetup> {
    let window = |(screen, projection_offset, is_master): (usize, DMat4, bool)| WindowSetup {
        screen: Some(screen),
        full_screen: true,
        shares_device: !is_master,
        cameras: vec![CameraSetup { projection_offset, ..CameraSetup::default() }],
        ..WindowSetup::default()
    };
    let windows: Vec<WindowSetup> = parts_of_image(screens).into_iter().map(window).collect();
    if windows.is_empty() { vec![WindowSetup::default()] } else { windows }
}

impl Arrangement {
    /// Returns the windows of a wall: columns and rows of windows of the same size in pixels without borders, side by side on a
    /// screen from its upper left corner on. All are parts of one image, as with [`Self::AllScreens`]: the middle window has the
    /// master camera and its angle of view, and all share a device. A wall has at least one column and one row.
    pub fn wall([columns, rows]: [u32; 2], size_px: [u32; 2], screen: Option<usize>) -> Self {
        let [width, height] = size_px.map(|side| side.clamp(1, MAX_SIDE_PX).cast_signed());
        let [columns, rows] = [columns, rows].map(|count| count.clamp(1, 64).cast_signed());
        // By columns, as the windows across screens are sorted from left to right.
        let places = (0..columns).flat_map(|column| (0..rows).map(move |row| [column * width, row * height]));
        let places: Vec<[i32; 4]> = places.map(|[x, y]| [x, y, width, height]).collect();
        let window = |(place, projection_offset, is_master): (usize, DMat4, bool)| WindowSetup {
            position_px: places.get(place).map(|[x, y, ..]| [*x, *y]),
            size_px: Some([width, height].map(i32::cast_unsigned)),
            screen,
            decorated: false,
            shares_device: !is_master,
            cameras: vec![CameraSetup { projection_offset, ..CameraSetup::default() }],
            ..WindowSetup::default()
        };
        Self::Windows(parts_of_image(&places).into_iter().map(window).collect())
    }
}

/// Returns the parts of one image that rectangles show as they lie beside each other, the middle one first. Each part has the
/// index of its rectangle, the offset of its projection from that of the middle one, and true if it is the middle one.
fn parts_of_image(places: &[[i32; 4]]) -> Vec<(usize, DMat4, bool)> {
    let mut left_to_right: Vec<usize> = (0..places.len()).collect();
    left_to_right.sort_by_key(|place| places[*place]);
    let middle = left_to_right.len() / 2;
    let Some(master) = left_to_right.get(middle).copied() else { return Vec::new() };
    left_to_right.remove(middle);
    let center = |place: usize| {
        let [x, y, width, height] = places[place].map(f64::from);
        [x + 0.5 * width, y + 0.5 * height]
    };
    let size = |place: usize| [places[place][2], places[place][3]].map(|side| f64::from(side.max(1)));
    let slaves = left_to_right.into_iter().map(|place| {
        let ([x, y], [mx, my]) = (center(place), center(master));
        let ([width, height], [mw, mh]) = (size(place), size(master));
        // The centre of this part in the master's clip space, whose y axis points up.
        let center_in_master = DVec3::new(2.0 * (x - mx) / mw, -2.0 * (y - my) / mh, 0.0);
        let scale = DVec3::new(mw / width, mh / height, 1.0);
        (place, DMat4::from_scale(scale) * DMat4::from_translation(-center_in_master), false)
    });
    std::iter::once((master, DMat4::IDENTITY, true)).chain(slaves).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn screens_side_by_side_show_one_image() {
        // The middle screen is larger, and the left one is mounted lower.
        let screens = [[1000, 0, 2000, 1000], [0, 250, 1000, 500], [3000, 0, 1000, 1000]];
        let windows = across_screens(&screens);
        assert_eq!(windows.iter().map(|w| w.screen).collect::<Vec<_>>(), [Some(0), Some(1), Some(2)]);
        assert!(!windows[0].shares_device && windows[1].shares_device && windows.iter().all(|w| w.full_screen));
        let offset = |window: usize| windows[window].cameras[0].projection_offset;
        assert_eq!(offset(0), DMat4::IDENTITY);
        // The desktop point that both screens touch: on the master's left edge, at the left screen's upper right corner.
        let left = offset(1).project_point3(DVec3::new(-1.0, 0.5, 0.0));
        assert!((left - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-12, "{left}");
        let right = offset(2).project_point3(DVec3::new(1.0, -1.0, 0.0));
        assert!((right - DVec3::new(-1.0, -1.0, 0.0)).length() < 1e-12, "{right}");
        assert_eq!(one_eye_per_screen(&screens), None);
        let windows = one_eye_per_screen(&[[1000, 0, 10, 10], [0, 0, 10, 10]]).unwrap();
        let eyes: Vec<_> = windows.iter().map(|w| (w.screen, w.cameras[0].eyes)).collect();
        assert_eq!(eyes, [(Some(1), Eyes::Left), (Some(0), Eyes::Right)]);
        assert_eq!(across_screens(&[]), [WindowSetup::default()]);
        assert_eq!(across_screens(&[[0, 0, 640, 480]]).len(), 1);
    }

    #[test]
    fn windows_of_a_wall_lie_side_by_side() {
        let Arrangement::Windows(windows) = Arrangement::wall([3, 2], [100, 50], Some(1)) else { panic!() };
        let mut places: Vec<_> = windows.iter().map(|w| w.position_px.unwrap()).collect();
        // The window at the middle of the list has the master camera.
        assert_eq!(places[0], [100, 50]);
        places.sort_unstable();
        assert_eq!(places, [[0, 0], [0, 50], [100, 0], [100, 50], [200, 0], [200, 50]]);
        assert!(windows.iter().all(|w| w.size_px == Some([100, 50]) && w.screen == Some(1) && !w.decorated));
        assert!(windows.iter().enumerate().all(|(place, w)| w.shares_device == (place > 0)));
        // Corners that windows share are the same point of the master's image.
        for window in &windows {
            let [x, y] = window.position_px.unwrap().map(f64::from);
            let upper_left = DVec3::new((x - 100.0) / 50.0 - 1.0, 1.0 - (y - 50.0) / 25.0, 0.0);
            let shown = window.cameras[0].projection_offset.project_point3(upper_left);
            assert!((shown - DVec3::new(-1.0, 1.0, 0.0)).length() < 1e-12, "{shown}");
        }
        let Arrangement::Windows(one) = Arrangement::wall([0, 0], [0, 0], None) else { panic!() };
        assert_eq!((one.len(), one[0].size_px), (1, Some([1, 1])));
    }
}
