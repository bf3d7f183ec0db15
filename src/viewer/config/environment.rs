//! Arrangements from environment variables, in OSG's order of precedence:
//!
//! ```text
//! TERRANE_CONFIG_FILE   a JSON file with windows and cameras, or with several views; see `file`
//! TERRANE_WINDOW        "x y width height" in pixels, on the screen of TERRANE_SCREEN if that is set too
//! TERRANE_SCREEN        the number of a screen, counted from 0, that the window fills; "all" fills every screen
//! ```

use std::path::Path;

use super::arrangement::Arrangement;
use super::file;
use super::window_setup::{MAX_SIDE_PX, WindowSetup};
use crate::viewer::ArrangementError;

/// The environment variable that names a file with windows.
pub const CONFIG_FILE_VARIABLE: &str = "TERRANE_CONFIG_FILE";
/// The environment variable with the position and size of a window.
pub const WINDOW_VARIABLE: &str = "TERRANE_WINDOW";
/// The environment variable with the number of a screen.
pub const SCREEN_VARIABLE: &str = "TERRANE_SCREEN";

impl Arrangement {
    /// Reads the environment variables; returns `None` when none of them is set.
    pub fn from_environment() -> Result<Option<Self>, ArrangementError> {
        Self::from_variables(|name| std::env::var_os(name).map(|value| value.to_string_lossy().into_owned()))
    }

    /// Reads variables through a lookup function, in the order of precedence above. Empty values count as not set.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, ArrangementError> {
        let value_of = |name: &str| variable(name).filter(|value| !value.trim().is_empty());
        if let Some(file) = value_of(CONFIG_FILE_VARIABLE) {
            return Self::read(Path::new(file.trim())).map(Some);
        }
        let screen = value_of(SCREEN_VARIABLE).map(|value| Screen::parse(&value)).transpose()?;
        let screen_number = match screen {
            Some(Screen::Number(number)) => Some(number),
            Some(Screen::All) | None => None,
        };
        if let Some(value) = value_of(WINDOW_VARIABLE) {
            let [x, y, width, height] = parse_window(&value)?;
            let window = WindowSetup {
                position_px: Some([x, y]),
                size_px: Some([width.cast_unsigned(), height.cast_unsigned()]),
                screen: screen_number,
                ..WindowSetup::default()
            };
            return Ok(Some(Self::Windows(vec![window])));
        }
        let fill = |screen| WindowSetup { screen: Some(screen), full_screen: true, ..WindowSetup::default() };
        Ok(screen.map(|screen| match screen {
            Screen::All => Self::AllScreens,
            Screen::Number(number) => Self::Windows(vec![fill(number)]),
        }))
    }

    /// Reads a JSON file of windows, or of windows and views.
    pub fn read(file: &Path) -> Result<Self, ArrangementError> {
        file::read(file)
    }
}

/// The value of [`SCREEN_VARIABLE`].
#[derive(Clone, Copy, Debug)]
enum Screen {
    All,
    Number(usize),
}

impl Screen {
    fn parse(value: &str) -> Result<Self, ArrangementError> {
        if value.trim().eq_ignore_ascii_case("all") {
            return Ok(Self::All);
        }
        let number = value.trim().parse();
        number.map(Self::Number).map_err(|_| invalid(SCREEN_VARIABLE, value, "the number of a screen, nor `all`"))
    }
}

/// Parses "x y width height"; both sides are 1 to [`MAX_SIDE_PX`].
fn parse_window(value: &str) -> Result<[i32; 4], ArrangementError> {
    let numbers: Result<Vec<i32>, _> = value.split_whitespace().map(str::parse).collect();
    let is_side = |side: i32| (1..=MAX_SIDE_PX.cast_signed()).contains(&side);
    match numbers.map(<[i32; 4]>::try_from) {
        Ok(Ok(numbers @ [_, _, width, height])) if is_side(width) && is_side(height) => Ok(numbers),
        _ => Err(invalid(WINDOW_VARIABLE, value, "`x y width height` in pixels")),
    }
}

fn invalid(variable: &str, value: &str, expected: &str) -> ArrangementError {
    ArrangementError {
        source_name: variable.to_owned(),
        field: String::new(),
        reason: format!("`{value}` is not {expected}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::window_setup::WindowSetup;
    use super::*;

    fn read(variables: &[(&str, &str)]) -> Result<Option<Arrangement>, ArrangementError> {
        let find = |name: &str| variables.iter().find(|(of, _)| *of == name).map(|(_, value)| (*value).to_owned());
        Arrangement::from_variables(find)
    }

    #[test]
    fn variables_are_read_in_order_of_precedence() {
        assert_eq!(read(&[]), Ok(None));
        assert_eq!(read(&[("TERRANE_WINDOW", " "), ("TERRANE_SCREEN", "")]), Ok(None));
        let window = WindowSetup {
            position_px: Some([-10, 20]),
            size_px: Some([640, 480]),
            screen: Some(1),
            ..WindowSetup::default()
        };
        let both = [("TERRANE_WINDOW", "-10 20  640 480"), ("TERRANE_SCREEN", "1")];
        assert_eq!(read(&both), Ok(Some(Arrangement::Windows(vec![window]))));
        let filling = WindowSetup { screen: Some(1), full_screen: true, ..WindowSetup::default() };
        assert_eq!(read(&both[1..]), Ok(Some(Arrangement::Windows(vec![filling]))));
        assert_eq!(read(&[("TERRANE_SCREEN", "ALL")]), Ok(Some(Arrangement::AllScreens)));
        // The file takes precedence, and an unreadable file is an error rather than a fallback to the next variable.
        let with_file = [("TERRANE_CONFIG_FILE", "/no/such/file"), both[0]];
        assert_eq!(read(&with_file).unwrap_err().source_name, "/no/such/file");
        for wrong in ["1 2 3", "1 2 3 0", "1 2 3 -4", "1 2 3 4 5", "a b c d", "1 2 99999 4", "1.5 2 3 4"] {
            let error = read(&[("TERRANE_WINDOW", wrong)]).unwrap_err();
            assert!(error.to_string().starts_with("TERRANE_WINDOW: `"), "{error}");
        }
        assert!(read(&[("TERRANE_SCREEN", "-1")]).unwrap_err().to_string().contains("number of a screen"));
    }
}
