//! The values of arguments: types that are parsed from text, and parsers with valid ranges.

use std::str::FromStr;

use terrane::viewer::ViewFrom;
pub use terrane_data_gen::BodyArg;

/// The longest side of a frame, a texture size that every adapter has.
const MAX_SIDE_PX: u32 = 8192;

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub [u32; 2]);

impl Default for Size {
    fn default() -> Self {
        Self([1280, 720])
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
        match sides {
            Some(size) if size.iter().all(|side| (1..=MAX_SIDE_PX).contains(side)) => Ok(Self(size)),
            Some([w, h]) if w.max(h) > MAX_SIDE_PX => {
                Err(format!("{} px, the limit is {MAX_SIDE_PX} px a side", w.max(h)))
            }
            Some(_) => Err("a side of 0 px, the minimum is 1 px".to_owned()),
            None => Err("expected WIDTHxHEIGHT, such as 1280x720".to_owned()),
        }
    }
}

/// Returns a number of bytes for people, such as `12.3 MiB`.
pub fn shown_bytes(bytes: u64) -> String {
    match bytes {
        0..1024 => format!("{bytes} B"),
        1024..0x10_0000 => format!("{:.1} KiB", bytes as f64 / 1024.0),
        _ => format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20)),
    }
}

/// A number above zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Positive(pub f64);

impl FromStr for Positive {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() && value > 0.0 => Ok(Self(value)),
            _ => Err("expected a number above zero".to_owned()),
        }
    }
}

/// A number that is not below zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotNegative(pub f64);

impl Default for NotNegative {
    /// Returns the default of `--lod-fade`.
    fn default() -> Self {
        Self(0.25)
    }
}

impl FromStr for NotNegative {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() && value >= 0.0 => Ok(Self(value)),
            _ => Err("expected a number that is not below zero".to_owned()),
        }
    }
}

/// The longest time to measure a case, in seconds.
const MAX_SECS: f64 = 3600.0;

/// Parses a number of at least 0.
pub fn not_negative(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|n: &f64| n.is_finite() && *n >= 0.0);
    number.ok_or_else(|| "expected a number of at least 0".to_owned())
}

/// Parses a share, 0 to 1.
pub fn share(text: &str) -> Result<f64, String> {
    not_negative(text).ok().filter(|n| *n <= 1.0).ok_or_else(|| "expected a number from 0 to 1".to_owned())
}

/// Parses milliseconds or bytes per second: 0, or a number from 0.001 to 1e12.
pub fn amount(text: &str) -> Result<f64, String> {
    let number = not_negative(text).ok().filter(|n| *n == 0.0 || (1e-3..=1e12).contains(n));
    number.ok_or_else(|| "expected 0 or a number from 0.001 to 1e12".to_owned())
}

/// Parses a duration in minutes.
pub fn minutes(text: &str) -> Result<f64, String> {
    let number = not_negative(text).ok().filter(|n| *n > 0.0 && *n <= 1e6);
    number.ok_or_else(|| "expected a number above 0, up to 1000000".to_owned())
}

/// Parses the time to measure a case, in seconds.
pub fn secs(text: &str) -> Result<f64, String> {
    let secs = not_negative(text).ok().filter(|n| *n <= MAX_SECS);
    secs.ok_or_else(|| format!("expected a number of seconds from 0 to {MAX_SECS}"))
}

/// Parses frames per second; 0 for no limit.
pub fn pace(text: &str) -> Result<f64, String> {
    let pace = not_negative(text).ok().filter(|n| *n == 0.0 || (0.01..=100_000.0).contains(n));
    pace.ok_or_else(|| "expected 0 or a number from 0.01 to 100000".to_owned())
}

/// Parses a finite number.
pub fn finite(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|n: &f32| n.is_finite()).ok_or_else(|| "expected a number".to_owned())
}

/// Parses the number of samples per pixel.
pub fn samples(text: &str) -> Result<u32, String> {
    text.parse().ok().filter(|n| matches!(n, 1 | 2 | 4 | 8 | 16)).ok_or_else(|| "expected 1, 2, 4, 8 or 16".to_owned())
}

/// The first camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View(pub ViewFrom);

impl FromStr for View {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some([heading, pitch, range_m])
                if heading.is_finite() && (-90.0..=90.0).contains(pitch) && range_m.is_finite() && *range_m > 0.0 =>
            {
                let (heading, pitch) = (heading.to_radians(), pitch.to_radians());
                Ok(Self(ViewFrom { heading, pitch, range_m: Some(*range_m) }))
            }
            _ => Err("expected HEADING_DEG,PITCH_DEG,RANGE_M with a pitch of -90 to 90 and a range above zero".into()),
        }
    }
}

/// The position of the sun in radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunFrom {
    /// The angle clockwise from north.
    pub azimuth: f64,
    /// The angle above the horizon.
    pub height: f64,
}

impl FromStr for SunFrom {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let angles: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        match angles.as_deref() {
            Some(&[azimuth, height]) if azimuth.is_finite() && (-90.0..=90.0).contains(&height) => {
                Ok(Self { azimuth: azimuth.to_radians(), height: height.to_radians() })
            }
            _ => Err(format!("`{text}` is not AZIMUTH,HEIGHT in degrees, the height -90 to 90")),
        }
    }
}

/// A colour as six hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rgb(pub [u8; 3]);

impl FromStr for Rgb {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.trim_start_matches('#');
        match u32::from_str_radix(digits, 16) {
            Ok(value) if digits.len() == 6 && !digits.starts_with('+') => {
                let [_, r, g, b] = value.to_be_bytes();
                Ok(Self([r, g, b]))
            }
            _ => Err("expected six hexadecimal digits, such as 1a334d".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrane::math::{MARS, MOON};

    #[test]
    fn values_are_parsed() {
        assert_eq!("640x360".parse(), Ok(Size([640, 360])));
        for bad in ["", "640", "0x5", "9999x5", "axb", "-1x5"] {
            assert!(bad.parse::<Size>().is_err(), "{bad}");
        }
        assert_eq!("FF8000".parse(), Ok(Rgb([255, 128, 0])));
        for bad in ["", "fff", "gggggg", "+12345"] {
            assert!(bad.parse::<Rgb>().is_err(), "{bad}");
        }
        let View(view) = "90,-35,1000".parse().unwrap();
        assert!((view.heading.to_degrees() - 90.0).abs() < 1e-9 && view.range_m == Some(1000.0));
        for bad in ["", "1,2", "0,-95,10", "0,0,0", "0,0,nan"] {
            assert!(bad.parse::<View>().is_err(), "{bad}");
        }
        let SunFrom { azimuth, height } = "180, 30".parse().unwrap();
        assert!((azimuth.to_degrees() - 180.0).abs() < 1e-9 && (height.to_degrees() - 30.0).abs() < 1e-9);
        for bad in ["", "180", "180,x,30", "180,30,", "180,30,high", "nan,30", "180,91"] {
            assert!(bad.parse::<SunFrom>().is_err(), "{bad}");
        }
        for (text, body) in
            [("Moon", MOON), ("mars", MARS), ("1737400, 1737400", MOON), ("3396190,3396190,3376200", MARS)]
        {
            assert_eq!(text.parse(), Ok(BodyArg(body)), "{text}");
        }
        for bad in ["", "pluto", "1737400", "1,1", "nan,nan,nan", "1e6,1e6,1e3", "1e6,1e6,1e6,1e6"] {
            assert!(bad.parse::<BodyArg>().is_err(), "{bad}");
        }
    }
}
