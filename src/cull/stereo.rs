//! Stereo: the modes of OSG's display settings, and view and projection of each eye. Plain values.

use glam::{DAffine3, DMat4, DVec3};

use super::CullCamera;

/// The way in which the images of both eyes are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StereoMode {
    /// Takes red from the left eye, green and blue of the right one.
    Anaglyphic,
    /// Left eye in the left half, right eye in the right half.
    HorizontalSplit,
    /// Left eye in the upper half, right eye in the lower half.
    VerticalSplit,
    /// The image of the left eye alone.
    LeftEye,
    /// The image of the right eye alone.
    RightEye,
    /// Rows alternate; the uppermost is the left eye's.
    HorizontalInterlace,
    /// Columns alternate; the leftmost is the left eye's.
    VerticalInterlace,
    /// Pixels alternate; the upper left one is the left eye's.
    Checkerboard,
}

impl StereoMode {
    /// All modes.
    pub const ALL: [Self; 8] = [
        Self::Anaglyphic,
        Self::HorizontalSplit,
        Self::VerticalSplit,
        Self::LeftEye,
        Self::RightEye,
        Self::HorizontalInterlace,
        Self::VerticalInterlace,
        Self::Checkerboard,
    ];

    /// Returns the name in OSG's environment variable `OSG_STEREO_MODE`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Anaglyphic => "ANAGLYPHIC",
            Self::HorizontalSplit => "HORIZONTAL_SPLIT",
            Self::VerticalSplit => "VERTICAL_SPLIT",
            Self::LeftEye => "LEFT_EYE",
            Self::RightEye => "RIGHT_EYE",
            Self::HorizontalInterlace => "HORIZONTAL_INTERLACE",
            Self::VerticalInterlace => "VERTICAL_INTERLACE",
            Self::Checkerboard => "CHECKERBOARD",
        }
    }
}

impl std::str::FromStr for StereoMode {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let upper = text.trim().to_ascii_uppercase().replace('-', "_");
        if upper == "QUAD_BUFFER" {
            return Err("QUAD_BUFFER stereo needs windows with two back buffers, which wgpu does not have".into());
        }
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL.into_iter().find(|m| m.name() == upper).ok_or_else(|| format!("`{text}` is none of {}", names()))
    }
}

/// Two eyes before a screen; OSG's display settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stereo {
    /// The way in which the images are combined.
    pub mode: StereoMode,
    /// Distance between the eyes, metres.
    pub eye_separation_m: f64,
    /// Distance from the eyes to the screen, metres.
    pub screen_distance_m: f64,
    /// Distance in the world at which objects seem to lie in the screen's plane, metres. The world is scaled by its ratio
    /// to `screen_distance_m`.
    pub fusion_distance_m: f64,
    /// Left and right eye are swapped.
    pub swaps_eyes: bool,
    /// Pixels between the two images of split modes.
    pub separation_px: u32,
    /// Each eye has its own screen straight before it, so that projections are not sheared.
    pub head_mounted: bool,
    /// Split modes keep the aspect ratio of objects instead of squeezing the whole view into each half.
    pub keeps_aspect: bool,
}

impl Stereo {
    /// Creates a mode with OSG's distances: eyes 5 cm apart and 50 cm before the screen, and the world at scale 1.
    pub fn new(mode: StereoMode) -> Self {
        Self {
            mode,
            eye_separation_m: 0.05,
            screen_distance_m: 0.5,
            fusion_distance_m: 0.5,
            swaps_eyes: false,
            separation_px: 0,
            head_mounted: false,
            keeps_aspect: false,
        }
    }

    /// Returns the size of one eye's image in a target of a size.
    pub fn eye_size_px(&self, size_px: [u32; 2]) -> [u32; 2] {
        let [width, height] = size_px;
        match self.mode {
            StereoMode::HorizontalSplit => [(width.saturating_sub(self.separation_px) / 2).max(1), height],
            StereoMode::VerticalSplit => [width, (height.saturating_sub(self.separation_px) / 2).max(1)],
            _ => size_px,
        }
    }

    /// Returns the cameras of the left and the right eye, swapped if the settings say so. Each looks in the camera's
    /// direction. Its projection is sheared so that both images agree at the fusion distance (as OSG's
    /// `computeLeftEyeProjection`).
    pub fn eyes(&self, camera: &CullCamera) -> [CullCamera; 2] {
        let scale = self.fusion_distance_m / self.screen_distance_m;
        let scale = if scale.is_finite() && scale > 0.0 { scale } else { 1.0 };
        let half = 0.5 * self.eye_separation_m;
        let half = if half.is_finite() { half } else { 0.0 };
        let eye_px = self.eye_size_px(camera.viewport_px);
        let eye = |side: f64, mask: u32| {
            let offset = side * half;
            let mut eye = *camera;
            eye.viewport_px = eye_px;
            eye.settings.cull_mask &= mask;
            // The left eye moves to the left, that is, the world to the right.
            eye.eye_from_world = DAffine3::from_translation(DVec3::new(offset * scale, 0.0, 0.0)) * eye.eye_from_world;
            let mut shear = DMat4::IDENTITY;
            if !self.head_mounted {
                shear.z_axis.x = offset / self.screen_distance_m.max(1e-6);
            }
            eye.clip_from_eye = camera.clip_from_eye * shear;
            if self.keeps_aspect {
                let [w, h] = camera.viewport_px.map(f64::from);
                let [ew, eh] = eye_px.map(f64::from);
                // A narrower image shows the same height of the world, a lower one the same width.
                let squeeze = (w / h) / (ew / eh);
                let (x, y) = if squeeze > 1.0 { (squeeze, 1.0) } else { (1.0, 1.0 / squeeze) };
                eye.clip_from_eye = DMat4::from_scale(DVec3::new(x, y, 1.0)) * eye.clip_from_eye;
            }
            eye
        };
        let settings = camera.settings;
        let [left, right] = [eye(1.0, settings.cull_mask_left), eye(-1.0, settings.cull_mask_right)];
        if self.swaps_eyes { [right, left] } else { [left, right] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eyes_agree_at_the_fusion_distance() {
        let camera = CullCamera::default();
        let stereo = Stereo { fusion_distance_m: 20.0, ..Stereo::new(StereoMode::Anaglyphic) };
        let x = |eye: &CullCamera, depth_m: f64| {
            let clip =
                eye.clip_from_eye * eye.eye_from_world.transform_point3(DVec3::new(0.0, 0.0, -depth_m)).extend(1.0);
            clip.x / clip.w
        };
        let [left, right] = stereo.eyes(&camera);
        assert!((x(&left, 20.0) - x(&right, 20.0)).abs() < 1e-12);
        assert!(x(&left, 10.0) > x(&right, 10.0), "nearer things cross over");
        assert!(x(&left, 40.0) < x(&right, 40.0));
        let [left_screen, right_screen] = Stereo { head_mounted: true, ..stereo }.eyes(&camera);
        assert_eq!(
            (left_screen.clip_from_eye, right_screen.clip_from_eye),
            (camera.clip_from_eye, camera.clip_from_eye)
        );
        let [swapped, _] = Stereo { swaps_eyes: true, ..stereo }.eyes(&camera);
        assert!((x(&swapped, 10.0) - x(&right, 10.0)).abs() < 1e-12);
    }

    /// A split image has another shape than the whole; objects in it keep theirs.
    #[test]
    fn split_modes_keep_the_aspect_ratio_of_objects() {
        let camera = CullCamera { viewport_px: [400, 200], ..CullCamera::default() };
        let [whole_x, whole_y] = [camera.clip_from_eye.x_axis.x, camera.clip_from_eye.y_axis.y];
        for (mode, [x, y]) in [
            (StereoMode::HorizontalSplit, [2.0, 1.0]),
            (StereoMode::VerticalSplit, [1.0, 2.0]),
            (StereoMode::Anaglyphic, [1.0, 1.0]),
        ] {
            let [eye, _] = Stereo { keeps_aspect: true, ..Stereo::new(mode) }.eyes(&camera);
            let scale = [eye.clip_from_eye.x_axis.x / whole_x, eye.clip_from_eye.y_axis.y / whole_y];
            assert!((scale[0] - x).abs() < 1e-12 && (scale[1] - y).abs() < 1e-12, "{mode:?}: {scale:?}");
            let [squeezed, _] = Stereo::new(mode).eyes(&camera);
            assert_eq!(squeezed.clip_from_eye.x_axis.x, whole_x, "{mode:?}");
        }
    }

    #[test]
    fn names_round_trip_and_quad_buffers_are_refused() {
        for mode in StereoMode::ALL {
            assert_eq!(mode.name().to_lowercase().parse(), Ok(mode));
        }
        assert!("quad_buffer".parse::<StereoMode>().unwrap_err().contains("two back buffers"));
        assert!("sideways".parse::<StereoMode>().unwrap_err().contains("ANAGLYPHIC"));
    }
}
