//! The objects of osgTerrain, as VirtualPlanetBuilder writes them: tiles of heights, layers of images or of colours of heights,
//! and where they lie.
//!
//! Readers of all encodings fill them, and resolve CompositeLayers, SwitchLayers and ProxyLayers to the layer that is shown.
//! [`build`](super::super::build) makes meshes of them.

use std::sync::Arc;

use glam::{DMat4, DVec3};

use super::images::{ImageData, ImageObject, RawImage};
use super::shapes::{HeightFieldObject, ShapeObject};
use crate::math::{Ellipsoid, Geodetic, WGS84};

/// The maximum number of colour layers of a tile that are read: the texture units that are looked at.
pub(in crate::formats::osg) const MAX_COLOR_LAYERS: usize = 8;

/// The members of a Terrain, which hold for the tiles below it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats::osg) struct TerrainSettings {
    /// The share of the samples of an elevation layer that become vertices.
    pub sample_ratio: f32,
    pub vertical_scale: f64,
    pub blending: BlendingPolicy,
}

impl Default for TerrainSettings {
    fn default() -> Self {
        Self { sample_ratio: 1.0, vertical_scale: 1.0, blending: BlendingPolicy::Inherit }
    }
}

/// When the tiles of a terrain are blended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::formats::osg) enum BlendingPolicy {
    #[default]
    Inherit,
    Never,
    Always,
    WhenAlphaIsPresent,
}

impl BlendingPolicy {
    /// The names of the policies, whose places are their numbers in binary files.
    pub const NAMES: [&str; 4] =
        ["INHERIT", "DO_NOT_SET_BLENDING", "ENABLE_BLENDING", "ENABLE_BLENDING_WHEN_ALPHA_PRESENT"];

    /// Returns the policy of a number in binary files.
    pub fn of_number(number: u32) -> Self {
        match number {
            1 => Self::Never,
            2 => Self::Always,
            3 => Self::WhenAlphaIsPresent,
            _ => Self::Inherit,
        }
    }

    /// Returns the policy of a name in text files.
    pub fn of_name(name: &str) -> Self {
        Self::of_number(Self::NAMES.iter().position(|known| *known == name).unwrap_or(0) as u32)
    }
}

/// The members of a TerrainTile.
#[derive(Debug, Default)]
pub(in crate::formats::osg) struct TerrainTileObject {
    /// The locator of the tile if none of its layers has one.
    pub locator: Option<Arc<LocatorObject>>,
    pub elevation: Option<Arc<LayerObject>>,
    /// By texture unit, at most [`MAX_COLOR_LAYERS`].
    pub colors: Vec<Option<Arc<LayerObject>>>,
    pub blending: BlendingPolicy,
}

impl TerrainTileObject {
    /// Adds the layer of a texture unit. Returns false if the unit is none that is read.
    pub fn set_color(&mut self, unit: usize, layer: Arc<LayerObject>) -> bool {
        if unit >= MAX_COLOR_LAYERS {
            return false;
        }
        if self.colors.len() <= unit {
            self.colors.resize(unit + 1, None);
        }
        self.colors[unit] = Some(layer);
        true
    }

    /// Returns the number of samples of the elevation layer.
    pub fn sample_count(&self) -> usize {
        let heights = self.elevation.as_deref().and_then(LayerObject::heights);
        heights.map_or(0, |field| field.columns.saturating_mul(field.rows))
    }

    /// Returns the images of the colour layers with their texture units.
    pub fn images(&self) -> impl Iterator<Item = (usize, &LayerObject, &Arc<ImageObject>)> {
        let layers = self.colors.iter().enumerate().filter_map(|(unit, layer)| Some((unit, layer.as_deref()?)));
        layers.filter_map(|(unit, layer)| match &layer.content {
            LayerContent::Image(image) => Some((unit, layer, image)),
            LayerContent::Ramp(ramp) => Some((unit, layer, &ramp.image)),
            _ => None,
        })
    }
}

/// A layer of a tile: heights or an image.
#[derive(Clone, Debug)]
pub(in crate::formats::osg) struct LayerObject {
    pub locator: Option<Arc<LocatorObject>>,
    pub validity: Validity,
    /// OpenGL's numbers.
    pub min_filter: u32,
    pub mag_filter: u32,
    pub content: LayerContent,
}

impl Default for LayerObject {
    fn default() -> Self {
        let (min_filter, mag_filter) = (0x2703, 0x2601);
        Self { locator: None, validity: Validity::All, min_filter, mag_filter, content: LayerContent::Nothing }
    }
}

impl LayerObject {
    /// Returns the heights; `None` for a layer without.
    pub fn heights(&self) -> Option<&HeightFieldObject> {
        match &self.content {
            LayerContent::Heights(shape) => match &**shape {
                ShapeObject::HeightField(field) => Some(field),
                _ => None,
            },
            _ => None,
        }
    }

    /// Returns the layer that a composite of layers shows, which lies where the composite says.
    pub fn shown_by(composite: &Self, part: Option<&Arc<Self>>) -> Self {
        match part {
            Some(part) => Self { locator: composite.locator.clone().or(part.locator.clone()), ..Self::clone(part) },
            None => composite.clone(),
        }
    }
}

/// The content of a layer.
#[derive(Clone, Debug)]
pub(in crate::formats::osg) enum LayerContent {
    /// Nothing that is read.
    Nothing,
    /// A HeightField, whose own origin and intervals do not count: the locator places it.
    Heights(Arc<ShapeObject>),
    Image(Arc<ImageObject>),
    /// A colour for each height.
    Ramp(Arc<RampObject>),
}

/// A TransferFunction1D: the colours of values.
#[derive(Debug)]
pub(in crate::formats::osg) struct RampObject {
    /// A row of texels from the smallest value to the largest.
    pub image: Arc<ImageObject>,
    /// The smallest and the largest value.
    range: [f64; 2],
}

impl RampObject {
    /// The texels of OSG's own images.
    const TEXELS: u16 = 1024;

    /// Takes values with colours as they are displayed, in any order; `None` if there is none. Of those of one value the last
    /// counts.
    pub fn new(colors: impl IntoIterator<Item = [f64; 5]>) -> Option<Self> {
        const GL_RGBA: u32 = 0x1908;
        const GL_UNSIGNED_BYTE: u32 = 0x1401;
        let is_finite = |color: &[f64; 5]| color.iter().all(|part| part.is_finite());
        let mut colors: Vec<[f64; 5]> = colors.into_iter().filter(is_finite).collect();
        colors.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let range = [colors.first()?[0], colors.last()?[0]];
        let texel = |at: u16| {
            let value = range[0] + (range[1] - range[0]) * f64::from(at) / f64::from(Self::TEXELS - 1);
            let above = colors.partition_point(|color| color[0] <= value);
            let below = &colors[above.saturating_sub(1)];
            let above = colors.get(above).unwrap_or(below);
            let length = above[0] - below[0];
            let share = if length > 0.0 { (value - below[0]) / length } else { 0.0 };
            [1, 2, 3, 4]
                .map(|part| ((below[part] + (above[part] - below[part]) * share).clamp(0.0, 1.0) * 255.0).round() as u8)
        };
        let raw = RawImage {
            size: [i32::from(Self::TEXELS), 1, 1],
            pixel_format: GL_RGBA,
            data_type: GL_UNSIGNED_BYTE,
            packing: 1,
            bytes: (0..Self::TEXELS).flat_map(texel).collect(),
        };
        let image = Arc::new(ImageObject { file_name: String::new(), data: ImageData::Raw(raw) });
        Some(Self { image, range })
    }

    /// Returns the position of a value in the row, 0 to 1 within its range.
    pub fn place(&self, value: f64) -> f64 {
        let [min, max] = self.range;
        if max > min && value.is_finite() { (value - min) / (max - min) } else { 0.0 }
    }
}

/// The values of a layer that are valid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats::osg) enum Validity {
    All,
    /// All but one.
    Without(f32),
    Range([f32; 2]),
}

impl Validity {
    /// Returns true for a value that is valid. Those that are not finite never are.
    pub fn holds(&self, value: f32) -> bool {
        value.is_finite()
            && match self {
                Self::All => true,
                Self::Without(invalid) => value != *invalid,
                Self::Range([min, max]) => (*min..=*max).contains(&value),
            }
    }
}

/// The members of a Locator: it maps a layer, 0 to 1 from west to east and from south to north with heights in metres, to the
/// frame of the tile.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::formats::osg) struct LocatorObject {
    /// The transform leads to longitude, latitude and height, which become earth-centred coordinates.
    pub is_geocentric: bool,
    pub ellipsoid: Ellipsoid,
    pub transform: DMat4,
}

impl Default for LocatorObject {
    fn default() -> Self {
        Self { is_geocentric: false, ellipsoid: WGS84, transform: DMat4::IDENTITY }
    }
}

impl LocatorObject {
    /// The names of the types of coordinate systems, whose places are their numbers in binary files.
    pub const TYPES: [&str; 3] = ["GEOCENTRIC", "GEOGRAPHIC", "PROJECTED"];
    /// The number of the only type whose coordinates are not those of the transform.
    pub const GEOCENTRIC: u32 = 0;

    /// Returns a point of the tile's frame for one of the layer.
    pub fn model(&self, local: DVec3) -> DVec3 {
        let point = self.transform.project_point3(local);
        if !self.is_geocentric {
            return point;
        }
        self.ellipsoid.ecef(&Geodetic { longitude: point.x, latitude: point.y, height_m: point.z })
    }

    /// Returns the point of the layer for one of the tile's frame; `None` if the transform cannot be turned round.
    pub fn local(&self, model: DVec3) -> Option<DVec3> {
        let determinant = self.transform.determinant();
        if determinant == 0.0 || !determinant.is_finite() {
            return None;
        }
        let point = if self.is_geocentric {
            let Geodetic { longitude, latitude, height_m } = self.ellipsoid.geodetic(model);
            DVec3::new(longitude, latitude, height_m)
        } else {
            model
        };
        Some(self.transform.inverse().project_point3(point)).filter(|local| local.is_finite())
    }

    /// Returns true if the axes of the layer are turned over, so that its cells have the other winding.
    pub fn turns_over(&self) -> bool {
        self.transform.x_axis.x * self.transform.y_axis.y < 0.0
    }
}

/// Returns an ellipsoid of two radii in metres; WGS84 for radii that are none.
pub(in crate::formats::osg) fn ellipsoid(equator_m: f64, polar_m: f64) -> Ellipsoid {
    let is_valid = equator_m.is_finite() && polar_m.is_finite() && polar_m > 0.0 && equator_m >= polar_m;
    if is_valid { Ellipsoid { semi_major_m: equator_m, semi_minor_m: polar_m } } else { WGS84 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn locators_place_layers_and_find_them_again() {
        let extents =
            DMat4::from_cols_array(&[0.2, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.8, 0.0, 1.0]);
        let flat = LocatorObject { transform: extents, ..LocatorObject::default() };
        assert!(flat.model(DVec3::new(1.0, 0.5, 7.0)).abs_diff_eq(DVec3::new(0.7, 0.85, 7.0), 1e-12));
        let earth = LocatorObject { is_geocentric: true, ..flat.clone() };
        let at = DVec3::new(0.25, 0.75, 1200.0);
        let model = earth.model(at);
        let geodetic = WGS84.geodetic(model);
        assert!((geodetic.longitude - 0.55).abs() < 1e-12 && (geodetic.latitude - 0.875).abs() < 1e-12);
        assert!((geodetic.height_m - 1200.0).abs() < 1e-6);
        assert!(earth.local(model).unwrap().abs_diff_eq(at, 1e-6));
        let flattened = LocatorObject { transform: DMat4::ZERO, ..flat };
        assert_eq!(flattened.local(DVec3::ONE), None);
    }

    #[test]
    fn ramps_interpolate_between_their_colors() {
        let ramp = RampObject::new([[300.0, 0.0, 0.0, 1.0, 1.0], [100.0, 1.0, 0.0, 0.0, 0.5], [f64::NAN; 5]]).unwrap();
        let ImageData::Raw(raw) = &ramp.image.data else { panic!("texels") };
        assert_eq!((&raw.bytes[..4], &raw.bytes[4092..]), (&[255, 0, 0, 128][..], &[0, 0, 255, 255][..]));
        assert!((i32::from(raw.bytes[2048]) - 127).abs() <= 1, "half of the way");
        assert_eq!([100.0, 250.0, 300.0, f64::NAN].map(|value| ramp.place(value)), [0.0, 0.75, 1.0, 0.0]);
        assert_eq!(RampObject::new([[5.0, 0.0, 1.0, 0.0, 1.0]]).unwrap().place(7.0), 0.0);
        assert!(RampObject::new([]).is_none());
    }

    #[test]
    fn validity_leaves_out_values() {
        assert!(Validity::All.holds(-9999.0) && !Validity::All.holds(f32::NAN));
        assert!(!Validity::Without(-9999.0).holds(-9999.0) && Validity::Without(-9999.0).holds(0.0));
        assert!(Validity::Range([0.0, 5.0]).holds(5.0) && !Validity::Range([0.0, 5.0]).holds(5.5));
        assert_eq!(ellipsoid(f64::NAN, 1.0), WGS84);
        assert_eq!(ellipsoid(2.0, 1.0).semi_minor_m, 1.0);
    }
}
