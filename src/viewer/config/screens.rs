//! Windows that fill several screens: one image across all of them, or one eye on each of two.
//!
//! Screens are given as x, y, width and height in the desktop's pixels.

use glam::{DMat4, DVec3};

use super::window_setup::{CameraSetup, WindowSetup};
use crate::viewer::view::Eyes;

/// Returns a window for the left eye on the left screen and one for the right eye on the right screen; `None` unless there
/// are exactly two screens.
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
pub(in crate::viewer) fn across_screens(screens: &[[i32; 4]]) -> Vec<WindowSetup> {
    let mut left_to_right: Vec<usize> = (0..screens.len()).collect();
    left_to_right.sort_by_key(|screen| screens[*screen]);
    let middle = left_to_right.len() / 2;
    let Some(master) = left_to_right.get(middle).copied() else { return vec![WindowSetup::default()] };
    left_to_right.remove(middle);
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
    let slaves = left_to_right.into_iter().map(|screen| {
        let ([x, y], [mx, my]) = (center(screen), center(master));
        let ([width, height], [mw, mh]) = (size(screen), size(master));
        // The centre of this screen in the master's clip space, whose y axis points up.
        let center_in_master = DVec3::new(2.0 * (x - mx) / mw, -2.0 * (y - my) / mh, 0.0);
        let scale = DVec3::new(mw / width, mh / height, 1.0);
        window(screen, DMat4::from_scale(scale) * DMat4::from_translation(-center_in_master))
    });
    std::iter::once(window(master, DMat4::IDENTITY)).chain(slaves).collect()
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
}
