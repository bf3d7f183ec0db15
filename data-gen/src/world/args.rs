//! The options of `terrane gen` about worlds.

use super::preset::WorldPreset;

/// Selects a world, and a place on it.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct WorldArgs {
    /// Make a piece of a planet from --seed, or the whole planet with --globe
    #[arg(long, value_enum, value_name = "PRESET", conflicts_with_all = ["dem", "imagery"])]
    pub world: Option<WorldPreset>,
    /// Longitude and latitude of the middle of the terrain in degrees; by default a place with much relief
    #[arg(long, value_name = "LON,LAT", requires = "world", allow_hyphen_values = true, value_parser = center)]
    pub center: Option<[f64; 2]>,
    /// Make the whole planet
    #[arg(long, requires = "world", conflicts_with_all = ["center", "size"])]
    pub globe: bool,
    /// Put trees and rocks on the levels whose cells are at most 60 m high
    #[arg(long, requires = "world")]
    pub scatter: bool,
}

fn center(text: &str) -> Result<[f64; 2], String> {
    let numbers: Vec<f64> = text.split(',').map_while(|number| number.trim().parse().ok()).collect();
    match numbers[..] {
        [longitude, latitude] if longitude.abs() <= 180.0 && latitude.abs() <= 90.0 => Ok([longitude, latitude]),
        _ => Err("expected a longitude and a latitude in degrees, such as 8.5,47".to_owned()),
    }
}
