//! [`DisplaySettings`]: what is known of the screen and of who sits before it. Read once, when a viewer is made: what it
//! decides (samples, contexts, the eyes) does not change after realize.

use super::camera::FieldOfView;
use super::viewer::ViewerConfig;
use crate::cull::{Stereo, StereoMode};

/// The screen; OSG's display types.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DisplayType {
    /// A screen on a desk.
    #[default]
    Monitor,
    /// A wall of screens.
    Powerwall,
    /// A curved screen around the audience.
    RealityCenter,
    /// A screen for each eye, that turns with the head: the eyes' projections are not sheared towards each other.
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

/// A setting that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {reason}")]
pub struct DisplaySettingError {
    /// The variable or argument.
    pub name: String,
    /// What was wrong with its value.
    pub reason: String,
}

/// What OSG's display settings hold, with its defaults.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplaySettings {
    /// The screen.
    pub display_type: DisplayType,
    /// Draw for two eyes.
    pub stereo: bool,
    /// How the eyes' pictures are put together.
    pub stereo_mode: StereoMode,
    /// Between the eyes, metres.
    pub eye_separation_m: f64,
    /// Width of the screen, metres.
    pub screen_width_m: f64,
    /// Height of the screen, metres.
    pub screen_height_m: f64,
    /// From the eyes to the screen, metres.
    pub screen_distance_m: f64,
    /// Where pictures lie side by side the left eye's is on the right.
    pub split_horizontal_swaps: bool,
    /// Pixels between pictures that lie side by side.
    pub split_horizontal_separation_px: u32,
    /// Where pictures lie one over the other the left eye's is below.
    pub split_vertical_swaps: bool,
    /// Pixels between pictures that lie one over the other.
    pub split_vertical_separation_px: u32,
    /// Split pictures keep the proportions of things.
    pub split_keeps_aspect: bool,
    /// Contexts that may be open at once: one unless it is said, as for more of them geometry is kept.
    pub max_contexts: usize,
    /// Samples a pixel; 0 and 1 are one, more are 4.
    pub samples: u32,
    /// Least bits of alpha in a context's target, which has 8.
    pub min_alpha_bits: u32,
    /// Least bits of stencil: 8 at most, and none on adapters without a stencil.
    pub min_stencil_bits: u32,
    /// Threads of their own for uploads; see [`ViewerConfig::compile_contexts`].
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
            max_contexts: 1,
            samples: 0,
            min_alpha_bits: 0,
            min_stencil_bits: 0,
            compile_contexts: false,
        }
    }
}

/// What takes the value of a variable or an argument.
type Setter = fn(&mut DisplaySettings, &str) -> Result<(), String>;

/// Variables, the arguments that say the same, and what they set.
const SETTINGS: [(&str, &str, Setter); 17] = [
    ("TERRANE_DISPLAY_TYPE", "--display-type", |s, v| one_of(v, &DisplayType::ALL).map(|v| s.display_type = v)),
    ("TERRANE_STEREO_MODE", "--stereo-mode", |s, v| v.parse().map(|v| s.stereo_mode = v)),
    ("TERRANE_STEREO", "--stereo", |s, v| {
        // As in OSG, a mode turns stereo on.
        match v.parse() {
            Ok(mode) => (s.stereo, s.stereo_mode) = (true, mode),
            Err(_) => s.stereo = on(v).map_err(|e| format!("{e}, nor a stereo mode"))?,
        }
        Ok(())
    }),
    ("TERRANE_EYE_SEPARATION", "--eye-separation", |s, v| metres(v).map(|v| s.eye_separation_m = v)),
    ("TERRANE_SCREEN_WIDTH", "--screen-width", |s, v| positive(v).map(|v| s.screen_width_m = v)),
    ("TERRANE_SCREEN_HEIGHT", "--screen-height", |s, v| positive(v).map(|v| s.screen_height_m = v)),
    ("TERRANE_SCREEN_DISTANCE", "--screen-distance", |s, v| positive(v).map(|v| s.screen_distance_m = v)),
    ("TERRANE_SPLIT_STEREO_HORIZONTAL_EYE_MAPPING", "--split-horizontal-eye-mapping", |s, v| {
        one_of(v, &[(false, "LEFT_EYE_LEFT_VIEWPORT"), (true, "LEFT_EYE_RIGHT_VIEWPORT")])
            .map(|v| s.split_horizontal_swaps = v)
    }),
    ("TERRANE_SPLIT_STEREO_HORIZONTAL_SEPARATION", "--split-horizontal-separation", |s, v| {
        pixels(v).map(|v| s.split_horizontal_separation_px = v)
    }),
    ("TERRANE_SPLIT_STEREO_VERTICAL_EYE_MAPPING", "--split-vertical-eye-mapping", |s, v| {
        one_of(v, &[(false, "LEFT_EYE_TOP_VIEWPORT"), (true, "LEFT_EYE_BOTTOM_VIEWPORT")])
            .map(|v| s.split_vertical_swaps = v)
    }),
    ("TERRANE_SPLIT_STEREO_VERTICAL_SEPARATION", "--split-vertical-separation", |s, v| {
        pixels(v).map(|v| s.split_vertical_separation_px = v)
    }),
    ("TERRANE_SPLIT_STEREO_AUTO_ADJUST_ASPECT_RATIO", "--split-auto-adjust-aspect-ratio", |s, v| {
        on(v).map(|v| s.split_keeps_aspect = v)
    }),
    ("TERRANE_MAX_NUMBER_OF_GRAPHICS_CONTEXTS", "--max-contexts", |s, v| {
        whole(v, 1..=1024).map(|v| s.max_contexts = v as usize)
    }),
    ("TERRANE_MULTI_SAMPLES", "--multi-samples", |s, v| whole(v, 0..=64).map(|v| s.samples = v)),
    ("TERRANE_MINIMUM_ALPHA_BITS", "--min-alpha-bits", |s, v| whole(v, 0..=8).map(|v| s.min_alpha_bits = v)),
    ("TERRANE_MINIMUM_STENCIL_BITS", "--min-stencil-bits", |s, v| whole(v, 0..=8).map(|v| s.min_stencil_bits = v)),
    ("TERRANE_COMPILE_CONTEXTS", "--compile-contexts", |s, v| on(v).map(|v| s.compile_contexts = v)),
];

fn one_of<T: Copy>(value: &str, names: &[(T, &str)]) -> Result<T, String> {
    let found = names.iter().find(|(_, name)| name.eq_ignore_ascii_case(value));
    found.map(|(of, _)| *of).ok_or_else(|| {
        let names: Vec<_> = names.iter().map(|(_, name)| *name).collect();
        format!("`{value}` is none of {}", names.join(", "))
    })
}

fn on(value: &str) -> Result<bool, String> {
    one_of(value, &[(true, "ON"), (false, "OFF"), (true, "TRUE"), (false, "FALSE")])
}

fn metres(value: &str) -> Result<f64, String> {
    let number = value.parse().ok().filter(|v: &f64| v.is_finite() && v.abs() <= 1e6);
    number.ok_or_else(|| format!("`{value}` is no length in metres"))
}

fn positive(value: &str) -> Result<f64, String> {
    metres(value)?.gt(&1e-6).then(|| metres(value)).ok_or_else(|| format!("`{value}` is no length above 0"))?
}

fn whole(value: &str, range: std::ops::RangeInclusive<u32>) -> Result<u32, String> {
    let number = value.parse().ok().filter(|v| range.contains(v));
    number.ok_or_else(|| format!("`{value}` is no whole number from {} to {}", range.start(), range.end()))
}

fn pixels(value: &str) -> Result<u32, String> {
    whole(value, 0..=16_384)
}

impl DisplaySettings {
    /// The defaults with what the environment says: `TERRANE_DISPLAY_TYPE`, `TERRANE_STEREO_MODE`, `TERRANE_STEREO` and
    /// so on, the reference's names with another beginning.
    pub fn from_environment() -> Result<Self, DisplaySettingError> {
        let mut settings = Self::default();
        settings.read_variables(|name| std::env::var_os(name).map(|value| value.to_string_lossy().into_owned()))?;
        Ok(settings)
    }

    /// Takes what variables say; those that are not set or empty change nothing.
    pub fn read_variables(&mut self, variable: impl Fn(&str) -> Option<String>) -> Result<(), DisplaySettingError> {
        for (name, _, set) in SETTINGS {
            let Some(value) = variable(name).filter(|value| !value.trim().is_empty()) else { continue };
            set(self, value.trim()).map_err(|reason| DisplaySettingError { name: name.to_owned(), reason })?;
        }
        Ok(())
    }

    /// Takes the display's arguments, each with its value, out of a command line and leaves the rest.
    pub fn read_command_line(&mut self, arguments: &mut Vec<String>) -> Result<(), DisplaySettingError> {
        let mut place = 0;
        while let Some(argument) = arguments.get(place) {
            let (name, inside) = match argument.split_once('=') {
                Some((name, value)) => (name.to_owned(), Some(value.to_owned())),
                None => (argument.clone(), None),
            };
            let Some((_, _, set)) = SETTINGS.iter().find(|(_, of, _)| **of == *name) else {
                place += 1;
                continue;
            };
            let count = if inside.is_some() { 1 } else { 2 };
            let value = inside.or_else(|| arguments.get(place + 1).cloned());
            let set_to = value.ok_or_else(|| "a value is missing".to_owned()).and_then(|v| set(self, v.trim()));
            set_to.map_err(|reason| DisplaySettingError { name, reason })?;
            arguments.drain(place..place + count);
        }
        Ok(())
    }

    /// The eyes, where there are two.
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

    /// The angle of view under which the screen's longer side is seen: things appear in their own size.
    pub fn field_of_view(&self) -> FieldOfView {
        let longer_m = self.screen_width_m.max(self.screen_height_m);
        FieldOfView::LongerSide(2.0 * (0.5 * longer_m).atan2(self.screen_distance_m))
    }

    /// Puts what a viewer is made by into its configuration; the angle of view is the application's to take.
    pub fn configure(&self, config: &mut ViewerConfig) {
        config.samples = if self.samples > 1 { 4 } else { 1 };
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
        let find = |name: &str| variables.iter().find(|(of, _)| *of == name).map(|(_, value)| (*value).to_owned());
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
        assert_eq!(settings.field_of_view(), FieldOfView::LongerSide(2.0 * (2.0f64 / 1.5).atan()));
        assert_eq!(read(&[("TERRANE_STEREO", "")]).unwrap(), DisplaySettings::default());
    }

    #[test]
    fn a_command_line_says_the_same_and_keeps_the_rest() {
        let line = ["fly", "--stereo", "CHECKERBOARD", "set", "--screen-distance=2", "--max-contexts", "5", "--frames"];
        let mut line = line.map(str::to_owned).to_vec();
        let mut settings = DisplaySettings::default();
        settings.read_command_line(&mut line).unwrap();
        assert_eq!(line, ["fly", "set", "--frames"]);
        assert!(settings.stereo && settings.stereo_mode == StereoMode::Checkerboard);
        assert_eq!((settings.screen_distance_m, settings.max_contexts), (2.0, 5));
        let mut cut = vec!["--eye-separation".to_owned()];
        assert!(settings.read_command_line(&mut cut).unwrap_err().reason.contains("missing"));
    }

    #[test]
    fn what_cannot_be_is_one_error() {
        for (name, value, says) in [
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
            assert!(error.name == name && error.to_string().contains(says), "{error}");
        }
    }
}
