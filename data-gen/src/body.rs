//! The body that a set is on: the option `--body`, and the extension 3DTILES_ellipsoid of tilesets.

use std::str::FromStr;

use serde_json::Value;
use terrane::formats::Body;
use terrane::math::{Ellipsoid, MARS, MOON, WGS84};

/// The ellipsoid of a body, by its name or its radii in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyArg(pub Ellipsoid);

/// Bodies with names, on the command line and in tilesets.
const NAMED: [(&str, Ellipsoid); 3] = [("Earth", WGS84), ("Moon", MOON), ("Mars", MARS)];
/// Radii that differ by at most this are the same, metres.
const SAME_M: f64 = 0.5;

impl FromStr for BodyArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some((_, named)) = NAMED.iter().find(|(name, _)| name.eq_ignore_ascii_case(text)) {
            return Ok(Self(*named));
        }
        let radii: Option<Vec<f64>> = text.split([',', 'x']).map(|part| part.trim().parse().ok()).collect();
        let radii_m = match radii.as_deref() {
            Some(&[x, y, z]) => [x, y, z],
            Some(&[equator, pole]) => [equator, equator, pole],
            _ => return Err("expected earth, moon, mars, or radii in metres such as 1737400x1737400".to_owned()),
        };
        Ellipsoid::from_radii_m(radii_m).map(Self).map_err(|error| error.to_string())
    }
}

/// Returns true for ellipsoids whose radii differ by at most half a metre.
pub(crate) fn is_same(a: &Ellipsoid, b: &Ellipsoid) -> bool {
    (a.radii_m() - b.radii_m()).abs().max_element() <= SAME_M
}

/// Adds the extension 3DTILES_ellipsoid to a tileset on another ellipsoid than WGS84.
pub(crate) fn declare(ellipsoid: &Ellipsoid, tileset: &mut Value) {
    let named = NAMED.iter().find(|(_, named)| is_same(named, ellipsoid));
    // An ellipsoid has valid radii.
    if let Ok(body) = Body::new(named.map(|(name, _)| (*name).to_owned()), ellipsoid.radii_m().to_array()) {
        body.declare_in(tileset);
    }
}
