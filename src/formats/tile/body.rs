//! [`Body`]: the planet or moon that a tile set is on, by the extension 3DTILES_ellipsoid. Plain values.

use serde::Serialize;
use serde_json::{Value, json};

use crate::fetch::printable;
use crate::math::{Ellipsoid, RadiiError, WGS84};

/// The extension with the ellipsoid of a set.
pub(in crate::formats) const ELLIPSOID: &str = "3DTILES_ellipsoid";
/// Radii that differ from those of WGS84 by at most this are WGS84, metres.
const SAME_M: f64 = 1e-3;

/// The body that a tile set names by the extension 3DTILES_ellipsoid.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Body {
    /// A name such as `Moon`, or a URI.
    name: Option<String>,
    /// Along x, y and z.
    radii_m: [f64; 3],
    #[serde(skip)]
    ellipsoid: Ellipsoid,
}

impl Body {
    /// Returns a body with a name and radii along x, y and z in metres.
    ///
    /// # Errors
    /// As [`Ellipsoid::from_radii_m`].
    pub fn new(name: Option<String>, radii_m: [f64; 3]) -> Result<Self, RadiiError> {
        let ellipsoid = Ellipsoid::from_radii_m(radii_m)?;
        let is_wgs84 = (ellipsoid.radii_m() - WGS84.radii_m()).abs().max_element() <= SAME_M;
        Ok(Self { name, radii_m, ellipsoid: if is_wgs84 { WGS84 } else { ellipsoid } })
    }

    /// Returns the ellipsoid on which tiles of the set lie.
    pub fn ellipsoid(&self) -> Ellipsoid {
        self.ellipsoid
    }

    /// Returns true if the equatorial radii differ. The ellipsoid has their mean.
    pub fn is_triaxial(&self) -> bool {
        Ellipsoid::is_triaxial(self.radii_m)
    }

    /// Adds the extension to the JSON of a tileset that has no extensions yet. A set on WGS84 needs none.
    pub fn declare_in(&self, tileset: &mut Value) {
        if self.ellipsoid == WGS84 {
            return;
        }
        let mut extension = json!({ "radii": self.radii_m });
        if let Some(name) = &self.name {
            extension["body"] = json!(name);
        }
        tileset["extensionsUsed"] = json!([ELLIPSOID]);
        tileset["extensions"] = json!({ ELLIPSOID: extension });
    }
}

impl std::fmt::Display for Body {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.radii_m;
        let name = self.name.as_deref().unwrap_or("without a name");
        write!(f, "{}, radii {x} {y} {z} m", printable(name))
    }
}
