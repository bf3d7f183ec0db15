//! [`DisplaySettings`]: the screen, the viewer's seat in front of it, stereo and the limits of graphics contexts. Read on the
//! main thread before the viewer is created.
//!
//! An application reads them once, before it creates a viewer: samples, contexts and stereo cannot change afterwards.

use crate::cull::{Stereo, StereoMode};
use crate::viewer::camera::FieldOfView;
use crate::viewer::frame::ViewerConfig;

/// The kind of screen; OSG's display types.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DisplayType {
    /// A screen on a desk.
    #[default]
    Monitor,
    /// A wall of screens.
    Powerwall,
    /// A curved screen around the audience.
    RealityCenter,
    /// A head-mounted display with a screen per eye; the projections of the eyes are not sheared towards each other.
    HeadMountedDisplay,
}

impl DisplayType {
    const ALL: [(Self, &str); 4] = [
        (Self::Monitor, "MONITOR"),
        (Self::Powerwall, "POWERWALL"),
        (Self::RealityCenter, "REALITY_CENTER"),
        (Self::HeadMountedDisplay, "HEAD_MOUNTED_DISPLAY"),
    ];
}

/// A setting with an invalid value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {reason}")]
pub struct DisplaySettingError {
    /// The environment variable or command-line argument.
    pub name: String,
    /// Why its value is invalid.
    pub reason: String,
}

/// OSG's display settings with OSG's defaults.
///
/// The 17 fields are one each per environment variable of OSG, so that both can be compared line by line.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplaySettings {
    /// The kind of screen.
    pub display_type: DisplayType,
    /// True when two images are drawn, one for each eye.
    pub stereo: bool,
    /// How the images of the two eyes are combined.
    pub stereo_mode: StereoMode,
    /// The distance between the eyes, metres.
    pub eye_separation_m: f64,
    /// The width of the screen, metres.
    pub screen_width_m: f64,
    /// The height of the screen, metres.
    pub screen_height_m: f64,
    /// The distance from the eyes to the screen, metres.
    pub screen_distance_m: f64,
    /// True when a horizontal split shows the left eye's image on the right.
    pub split_horizontal_swaps: bool,
    /// The gap between the images of a horizontal split, pixels.
    pub split_horizontal_separation_px: u32,
    /// True when a vertical split shows the left eye's image at the bottom.
    pub split_vertical_swaps: bool,
    /// The gap between the images of a vertical split, pixels.
    pub split_vertical_separation_px: u32,
    /// True when split images keep the aspect ratio of the scene.
    pub split_keeps_aspect: bool,
    /// The most graphics contexts that may be open at once.
    pub max_contexts: usize,
    /// Samples per pixel as requested: 0 and 1 give one sample, more the next of 2, 4, 8 and 16 that the adapter has.
    pub samples: u32,
    /// The minimum bits of alpha in the image of a context, 0 to 8; see [`ViewerConfig::min_alpha_bits`].
    pub min_alpha_bits: u32,
    /// The minimum bits of stencil, 0 to 8; adapters without a stencil buffer have none.
    pub min_stencil_bits: u32,
    /// True when separate threads do uploads; see [`ViewerConfig::compile_contexts`].
    pub compile_contexts: bool,
}

impl Default for DisplaySettings {
    fn default() -> Self {
        Self {
            display_type: DisplayType::Monitor,
            stereo: false,
            stereo_mode: StereoMode::Anaglyphic,
            eye_separation_m: 0.05,
            screen_width_m: 0.325,
            screen_height_m: 0.26,
            screen_distance_m: 0.5,
            split_horizontal_swaps: false,
            split_horizontal_separation_px: 0,
            split_vertical_swaps: false,
            split_vertical_separation_px: 0,
            split_keeps_aspect: true,
            max_contexts: 32,
            samples: 0,
            min_alpha_bits: 0,
            min_stencil_bits: 0,
            compile_contexts: false,
        }
    }
}

/// Parses a value and stores it; the error is the reason why the value is invalid.
type Setter = fn(&mut DisplaySettings, &str) -> Result<(), String>;

/// The environment variables, the command-line arguments that do the same, and how each sets its field.
const SETTINGS: [(&str, &str, Setter); 17] = [
    ("TERRANE_DISPLAY_TYPE", "--display-type", |s, v| one_of(v, &DisplayType::ALL).map(|v| s.display_type = v)),
    ("TERRANE_STEREO_MODE", "--stereo-mode", |s, v| v.parse().map(|v| s.stereo_mode = v)),
    ("TERRANE_STEREO", "--stereo", |s, v| {
        // Naming a mode turns stereo on, as in OSG.
        match v.parse() {
            Ok(mode) => (s.stereo, s.stereo_mode) = (true, mode),
            Err(_) => s.stereo = parse_switch(v).map_err(|e| format!("{e}, nor a stereo mode"))?,
        }
        Ok(())
    }),
    ("TERRANE_EYE_SEPARATION", "--eye-separation", |s, v| parse_metres(v).map(|v| s.eye_separation_m = v)),
    ("TERRANE_SCREEN_WIDTH", "--screen-width", |s, v| parse_positive_metres(v).map(|v| s.screen_width_m = v)),
    ("TERRANE_SCREEN_HEIGHT", "--screen-height", |s, v| parse_positive_metres(v).map(|v| s.screen_height_m = v)),
    ("TERRANE_SCREEN_DISTANCE", "--screen-distance", |s, v| parse_positive_metres(v).map(|v| s.screen_distance_m = v)),
    ("TERRANE_SPLIT_STEREO_HORIZONTAL_EYE_MAPPING", "--split-horizontal-eye-mapping", |s, v| {
        one_of(v, &[(false, "LEFT_EYE_LEFT_VIEWPORT"), (true, "LEFT_EYE_RIGHT_VIEWPORT")])
            .map(|v| s.split_horizontal_swaps = v)
    }),
    ("TERRANE_SPLIT_STEREO_HORIZONTAL_SEPARATION", "--split-horizontal-separation", |s, v| {
        parse_pixels(v).map(|v| s.split_horizontal_separation_px = v)
    }),
    ("TERRANE_SPLIT_STEREO_VERTICAL_EYE_MAPPING", "--split-vertical-eye-mapping", |s, v| {
        one_of(v, &[(false, "LEFT_EYE_TOP_VIEWPORT"), (true, "LEFT_EYE_BOTTOM_VIEWPORT")])
            .map(|v| s.split_vertical_swaps = v)
    }),
    ("TERRANE_SPLIT_STEREO_VERTICAL_SEPARATION", "--split-vertical-separation", |s, v| {
        parse_pixels(v).map(|v| s.split_vertical_separation_px = v)
    }),
    ("TERRANE_SPLIT_STEREO_AUTO_ADJUST_ASPECT_RATIO", "--split-auto-adjust-aspect-ratio", |s, v| {
        parse_switch(v).map(|v| s.split_keeps_aspect = v)
    }),
    ("TERRANE_MAX_NUMBER_OF_GRAPHICS_CONTEXTS", "--max-contexts", |s, v| {
        parse_whole(v, 1..=1024).map(|v| s.max_contexts = v as usize)
    }),
    ("TERRANE_MULTI_SAMPLES", "--multi-samples", |s, v| parse_whole(v, 0..=64).map(|v| s.samples = v)),
    ("TERRANE_MINIMUM_ALPHA_BITS", "--min-alpha-bits", |s, v| parse_whole(v, 0..=8).map(|v| s.min_alpha_bits = v)),
    ("TERRANE_MINIMUM_STENCIL_BITS", "--min-stencil-bits", |s, v| {
        parse_whole(v, 0..=8).map(|v| s.min_stencil_bits = v)
    }),
    ("TERRANE_COMPILE_CONTEXTS", "--compile-contexts", |s, v| parse_switch(v).map(|v| s.compile_contexts = v)),
];

fn one_of<T: Copy>(value: &str, names: &[(T, &str)]) -> Result<T, String> {
    let found = names.iter().find(|(_, name)| name.eq_ignore_ascii_case(value));
    found.map(|(value, _)| *value).ok_or_else(|| {
        let names: Vec<_> = names.iter().map(|(_, name)| *name).collect();
        format!("`{value}` is none of {}", names.join(", "))
    })
}

fn parse_switch(value: &str) -> Result<bool, String> {
    one_of(value, &[(true, "ON"), (false, "OFF"), (true, "TRUE"), (false, "FALSE")])
}

fn parse_metres(value: &str) -> Result<f64, String> {
    let number = value.parse().ok().filter(|v: &f64| v.is_finite() && v.abs() <= 1e6);
    number.ok_or_else(|| format!("`{value}` is not a length in metres"))
}

fn parse_positive_metres(value: &str) -> Result<f64, String> {
    let length_m = parse_metres(value)?;
    if length_m > 1e-6 { Ok(length_m) } else { Err(format!("`{value}` is not a length above 0")) }
}

fn parse_whole(value: &str, range: std::ops::RangeInclusive<u32>) -> Result<u32, String> {
    let number = value.parse().ok().filter(|v| range.contains(v));
    number.ok_or_else(|| format!("`{value}` is not a whole number from {} to {}", range.start(), range.end()))
}

fn parse_pixels(value: &str) -> Result<u32, String> {
    parse_whole(value, 0..=16_384)
}

impl DisplaySettings {
    /// Returns the defaults, overridden by environment variables. Their names are OSG's with the prefix `TERRANE_`, such as
    /// `TERRANE_STEREO_MODE`.
    pub fn from_environment() -> Result<Self, DisplaySettingError> {
        let mut settings = Self::default();
        settings.read_variables(|name| std::env::var_os(name).map(|value| value.to_string_lossy().into_owned()))?;
        Ok(settings)
    }

    /// Overrides settings from variables, through a lookup function. Missing and empty variables change nothing.
    pub fn read_variables(&mut self, variable: impl Fn(&str) -> Option<String>) -> Result<(), DisplaySettingError> {
        for (name, _, set) in SETTINGS {
            let Some(value) = variable(name).filter(|value| !value.trim().is_empty()) else { continue };
            set(self, value.trim()).map_err(|reason| DisplaySettingError { name: name.to_owned(), reason })?;
        }
        Ok(())
    }

    /// Overrides settings from command-line arguments, and removes those arguments and their values from the list.
    ///
    /// Both `--screen-distance 2` and `--screen-distance=2` are accepted.
    pub fn read_command_line(&mut self, arguments: &mut Vec<String>) -> Result<(), DisplaySettingError> {
        let mut index = 0;
        while let Some(argument) = arguments.get(index) {
            let (name, inline_value) = match argument.split_once('=') {
                Some((name, value)) => (name.to_owned(), Some(value.to_owned())),
                None => (argument.clone(), None),
            };
            let Some((_, _, set)) = SETTINGS.iter().find(|(_, argument, _)| **argument == *name) else {
                index += 1;
                continue;
            };
            let count = if inline_value.is_some() { 1 } else { 2 };
            let value = inline_value.or_else(|| arguments.get(index + 1).cloned());
            let result = value.ok_or_else(|| "a value is missing".to_owned()).and_then(|v| set(self, v.trim()));
            result.map_err(|reason| DisplaySettingError { name, reason })?;
            arguments.drain(index..index + count);
        }
        Ok(())
    }

    /// Returns the stereo parameters; `None` when stereo is off.
    pub fn eyes(&self) -> Option<Stereo> {
        let (swaps_eyes, separation_px) = match self.stereo_mode {
            StereoMode::HorizontalSplit => (self.split_horizontal_swaps, self.split_horizontal_separation_px),
            StereoMode::VerticalSplit => (self.split_vertical_swaps, self.split_vertical_separation_px),
            _ => (false, 0),
        };
        self.stereo.then(|| Stereo {
            eye_separation_m: self.eye_separation_m,
            screen_distance_m: self.screen_distance_m,
            fusion_distance_m: self.screen_distance_m,
            swaps_eyes,
            keeps_aspect: self.split_keeps_aspect,
            separation_px,
            head_mounted: self.display_type == DisplayType::HeadMountedDisplay,
            ..Stereo::new(self.stereo_mode)
        })
    }

    /// Returns the angle under which the viewer sees the screen, so that objects appear at their real size; `None` while the
    /// size and the distance of the screen are the defaults.
    ///
    /// By OSG's rule the screen's height decides on the vertical angle, and the horizontal one follows the shape of the
    /// image. OSG then has no use for the width. Here the width decides on the horizontal angle where the height is the
    /// default.
    pub fn field_of_view(&self) -> Option<FieldOfView> {
        let Self { screen_width_m: width_m, screen_height_m: height_m, screen_distance_m: distance_m, .. } = *self;
        let angle = |side_m: f64| 2.0 * (0.5 * side_m).atan2(distance_m);
        let usual = Self::default();
        if height_m == usual.screen_height_m && width_m != usual.screen_width_m {
            return Some(FieldOfView::Horizontal(angle(width_m)));
        }
        let is_usual = height_m == usual.screen_height_m && distance_m == usual.screen_distance_m;
        (!is_usual).then(|| FieldOfView::Vertical(angle(height_m)))
    }

    /// Copies samples, contexts, stereo, the bits of targets and the field of view into a viewer's configuration.
    pub fn configure(&self, config: &mut ViewerConfig) {
        config.field_of_view = self.field_of_view().unwrap_or(config.field_of_view);
        config.min_alpha_bits = self.min_alpha_bits;
        config.samples = self.samples.clamp(1, 16);
        config.max_contexts = self.max_contexts;
        config.stereo = self.eyes();
        config.min_stencil_bits = self.min_stencil_bits;
        config.compile_contexts = self.compile_contexts;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(variables: &[(&str, &str)]) -> Result<DisplaySettings, DisplaySettingError> {
        let mut settings = DisplaySettings::default();
        let find =
            |name: &str| variables.iter().find(|(variable, _)| *variable == name).map(|(_, value)| (*value).to_owned());
        settings.read_variables(find).map(|()| settings)
    }

    #[test]
    fn variables_set_every_field() {
        let all = [
            ("TERRANE_DISPLAY_TYPE", "head_mounted_display"),
            ("TERRANE_STEREO_MODE", "VERTICAL_SPLIT"),
            ("TERRANE_STEREO", "ON"),
            ("TERRANE_EYE_SEPARATION", "0.06"),
            ("TERRANE_SCREEN_WIDTH", "4"),
            ("TERRANE_SCREEN_HEIGHT", " 3 "),
            ("TERRANE_SCREEN_DISTANCE", "1.5"),
            ("TERRANE_SPLIT_STEREO_HORIZONTAL_EYE_MAPPING", "LEFT_EYE_RIGHT_VIEWPORT"),
            ("TERRANE_SPLIT_STEREO_HORIZONTAL_SEPARATION", "10"),
            ("TERRANE_SPLIT_STEREO_VERTICAL_EYE_MAPPING", "LEFT_EYE_BOTTOM_VIEWPORT"),
            ("TERRANE_SPLIT_STEREO_VERTICAL_SEPARATION", "20"),
            ("TERRANE_SPLIT_STEREO_AUTO_ADJUST_ASPECT_RATIO", "OFF"),
            ("TERRANE_MAX_NUMBER_OF_GRAPHICS_CONTEXTS", "3"),
            ("TERRANE_MULTI_SAMPLES", "4"),
            ("TERRANE_MINIMUM_ALPHA_BITS", "8"),
            ("TERRANE_MINIMUM_STENCIL_BITS", "1"),
            ("TERRANE_COMPILE_CONTEXTS", "on"),
        ];
        assert_eq!(all.map(|(name, _)| name), SETTINGS.map(|(name, ..)| name));
        let settings = read(&all).unwrap();
        let expected = DisplaySettings {
            display_type: DisplayType::HeadMountedDisplay,
            stereo: true,
            stereo_mode: StereoMode::VerticalSplit,
            eye_separation_m: 0.06,
            screen_width_m: 4.0,
            screen_height_m: 3.0,
            screen_distance_m: 1.5,
            split_horizontal_swaps: true,
            split_horizontal_separation_px: 10,
            split_vertical_swaps: true,
            split_vertical_separation_px: 20,
            split_keeps_aspect: false,
            max_contexts: 3,
            samples: 4,
            min_alpha_bits: 8,
            min_stencil_bits: 1,
            compile_contexts: true,
        };
        assert_eq!(settings, expected);
        let eyes = settings.eyes().unwrap();
        assert!(eyes.swaps_eyes && eyes.head_mounted && eyes.separation_px == 20);
        assert_eq!(settings.field_of_view(), Some(FieldOfView::Vertical(2.0 * 1.0f64.atan())));
        let mut config = ViewerConfig::default();
        settings.configure(&mut config);
        assert_eq!((config.samples, config.max_contexts, config.compile_contexts), (4, 3, true));
        assert_eq!((config.min_alpha_bits, config.min_stencil_bits, config.stereo), (8, 1, Some(eyes)));
        assert_eq!(config.field_of_view, FieldOfView::Vertical(2.0 * 1.0f64.atan()));
        assert_eq!(read(&[("TERRANE_STEREO", "")]).unwrap(), DisplaySettings::default());
    }

    #[test]
    fn screen_decides_on_the_field_of_view_unless_it_is_the_default() {
        let of = |variables: &[(&str, &str)]| read(variables).unwrap().field_of_view();
        let angle = |half_m: f64, distance_m: f64| 2.0 * (half_m / distance_m).atan();
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[("TERRANE_SCREEN_DISTANCE", "1")]), Some(FieldOfView::Vertical(angle(0.13, 1.0))));
        assert_eq!(of(&[("TERRANE_SCREEN_HEIGHT", "1")]), Some(FieldOfView::Vertical(angle(0.5, 0.5))));
        let both = [("TERRANE_SCREEN_HEIGHT", "1"), ("TERRANE_SCREEN_WIDTH", "4")];
        assert_eq!(of(&both), Some(FieldOfView::Vertical(angle(0.5, 0.5))), "the image's shape decides on the width");
        let wide = [("TERRANE_SCREEN_WIDTH", "4"), ("TERRANE_SCREEN_DISTANCE", "2")];
        assert_eq!(of(&wide), Some(FieldOfView::Horizontal(angle(2.0, 2.0))));
        let mut config = ViewerConfig::default();
        DisplaySettings::default().configure(&mut config);
        assert_eq!(config.field_of_view, ViewerConfig::default().field_of_view);
    }

    #[test]
    fn command_line_arguments_set_fields_and_other_arguments_stay() {
        let line = ["fly", "--stereo", "CHECKERBOARD", "set", "--screen-distance=2", "--max-contexts", "5", "--frames"];
        let mut line = line.map(str::to_owned).to_vec();
        let mut settings = DisplaySettings::default();
        settings.read_command_line(&mut line).unwrap();
        assert_eq!(line, ["fly", "set", "--frames"]);
        assert!(settings.stereo && settings.stereo_mode == StereoMode::Checkerboard);
        assert_eq!((settings.screen_distance_m, settings.max_contexts), (2.0, 5));
        let mut without_value = vec!["--eye-separation".to_owned()];
        assert!(settings.read_command_line(&mut without_value).unwrap_err().reason.contains("missing"));
    }

    #[test]
    fn invalid_values_are_errors_that_name_the_variable() {
        for (name, value, reason) in [
            ("TERRANE_DISPLAY_TYPE", "CAVE", "REALITY_CENTER"),
            ("TERRANE_STEREO", "perhaps", "nor a stereo mode"),
            ("TERRANE_STEREO_MODE", "QUAD_BUFFER", "two back buffers"),
            ("TERRANE_EYE_SEPARATION", "NaN", "metres"),
            ("TERRANE_SCREEN_WIDTH", "-1", "above 0"),
            ("TERRANE_SCREEN_DISTANCE", "0", "above 0"),
            ("TERRANE_MAX_NUMBER_OF_GRAPHICS_CONTEXTS", "0", "from 1 to"),
            ("TERRANE_MULTI_SAMPLES", "4.5", "whole number"),
            ("TERRANE_MINIMUM_STENCIL_BITS", "16", "from 0 to 8"),
            ("TERRANE_COMPILE_CONTEXTS", "2", "none of ON"),
        ] {
            let error = read(&[(name, value)]).unwrap_err();
            assert!(error.name == name && error.to_string().contains(reason), "{error}");
        }
    }
}
