//! osgTerrain in an .osg file.

use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3};

use super::Reader;
use super::fields::{Block, number_of, rotation};
use crate::formats::osg::classes::{
    CHILDREN_OF_TILES, COMPOSITES, FURTHER_LAYERS, HEIGHTS_ELSEWHERE, LAYERS_ELSEWHERE, LAYERS_WITHOUT_COLORS,
    image_of_file,
};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{GL_NAMES, Values, value_of};
use crate::formats::osg::objects::{
    ArrayObject, BlendingPolicy, HeightFieldObject, LayerContent, LayerObject, LocatorObject, NodeClass, Object,
    RampObject, ShapeObject, TerrainSettings, TerrainTileObject, ellipsoid,
};

/// Returns the system of a CoordinateSystemNode; empty with an ellipsoid, on which the positions lie then.
pub(super) fn coordinate_system(block: &Block<'_>) -> String {
    let is_geocentric = block.field("EllipsoidModel").is_some();
    if is_geocentric { String::new() } else { block.word("CoordinateSystem").to_owned() }
}

/// Returns the class of a Terrain.
pub(super) fn terrain(block: &Block<'_>) -> NodeClass {
    let settings = TerrainSettings {
        sample_ratio: block.value("SampleRatio").unwrap_or(1.0) as f32,
        vertical_scale: block.value("VerticalScale").unwrap_or(1.0),
        blending: BlendingPolicy::of_name(block.word("BlendingPolicy")),
    };
    NodeClass::Terrain(settings, coordinate_system(block))
}

/// Reads a HeightField.
pub(super) fn height_field(block: &Block<'_>) -> Result<ShapeObject> {
    let [columns, rows] = block.values("NumColumnsAndRows").unwrap_or([0.0; 2]).map(|count: f64| count as usize);
    let heights = block.list("Heights");
    if columns.checked_mul(rows).is_none_or(|count| count > heights.len()) {
        let reason = format!("a HeightField of {columns} x {rows} with {} heights", heights.len());
        return Err(OsgError::invalid(reason));
    }
    let number = |name| block.value(name).unwrap_or(0.0);
    let values = Values::F32(heights.iter().map(|height| *height as f32).collect());
    Ok(ShapeObject::HeightField(HeightFieldObject {
        columns,
        rows,
        origin: block.values("Origin").map_or(DVec3::ZERO, DVec3::from_array),
        interval: ["XInterval", "YInterval"].map(number),
        skirt_height: number("SkirtHeight"),
        rotation: if block.field("Rotation").is_some() { rotation(block, "Rotation") } else { DQuat::IDENTITY },
        heights: Arc::new(ArrayObject { width: 1, values, binding: None, is_normalized: false }),
    }))
}

impl Reader {
    /// Reads the members of a TerrainTile.
    pub(super) fn terrain_tile(&mut self, block: &Block<'_>, children: &mut Vec<Object>) -> Result<NodeClass> {
        let mut tile = TerrainTileObject {
            blending: BlendingPolicy::of_name(block.word("BlendingPolicy")),
            ..TerrainTileObject::default()
        };
        children.retain(|child| match child {
            Object::Locator(locator) => {
                tile.locator = Some(locator.clone());
                false
            }
            Object::Node(_) | Object::Drawable(_) => true,
            _ => false,
        });
        if !children.is_empty() {
            self.notes.add(CHILDREN_OF_TILES);
        }
        for field in &block.fields {
            let Some(inner) = &field.block else { continue };
            match field.word(0) {
                "ElevationLayer" => {
                    tile.elevation = self.layer_in(inner)?;
                    if tile.elevation.as_ref().is_some_and(|layer| layer.heights().is_none()) {
                        self.notes.add(HEIGHTS_ELSEWHERE);
                    }
                }
                "ColorLayer" => {
                    let unit = number_of(field.word(1)).unwrap_or(0.0) as usize;
                    if let Some(layer) = self.layer_in(inner)?
                        && !tile.set_color(unit, layer)
                    {
                        self.notes.add(FURTHER_LAYERS);
                    }
                }
                _ => {}
            }
        }
        Ok(NodeClass::TerrainTile(tile))
    }

    /// Returns the layer in a block, where a locator before it replaces its own.
    fn layer_in(&mut self, block: &Block<'_>) -> Result<Option<Arc<LayerObject>>> {
        let (mut locator, mut layer) = (None, None);
        for object in self.layers(block)? {
            match object {
                Object::Locator(found) => locator = Some(found),
                Object::Layer(found) => layer = Some(found),
                _ => {}
            }
        }
        Ok(layer.map(|layer| match locator {
            Some(locator) => Arc::new(LayerObject { locator: Some(locator), ..LayerObject::clone(&layer) }),
            None => layer,
        }))
    }

    /// Returns the layers of a block and its other objects in order. Layers may be files.
    fn layers(&mut self, block: &Block<'_>) -> Result<Vec<Object>> {
        let mut objects = Vec::new();
        for field in &block.fields {
            if matches!(field.word(0), "ProxyLayer" | "ProxyFile") {
                self.notes.add(LAYERS_ELSEWHERE);
                objects.push(Object::Layer(Arc::default()));
            } else if field.word(0) == "file" && field.block.is_none() {
                let content = image_of_file(field.word(1)).map_or(LayerContent::Nothing, LayerContent::Image);
                objects.push(Object::Layer(Arc::new(LayerObject { content, ..LayerObject::default() })));
            } else {
                objects.extend(self.object(field)?);
            }
        }
        Ok(objects)
    }

    /// Reads a Locator or a layer; `None` for other classes. `class` is without its namespace.
    pub(super) fn terrain_object(&mut self, class: &str, block: &Block<'_>) -> Result<Option<Object>> {
        Ok(Some(match class {
            "Locator" => Object::Locator(Arc::new(locator(block))),
            "EllipsoidModel" => {
                let [equator_m, polar_m] =
                    ["RadiusEquator", "RadiusPolar"].map(|name| block.value(name).unwrap_or(0.0));
                Object::Ellipsoid(Box::new(ellipsoid(equator_m, polar_m)))
            }
            "TransferFunction1D" => {
                let colors = RampObject::new(block.list("Colours").as_chunks::<5>().0.iter().copied());
                colors.map_or(Object::Nothing, |ramp| Object::Ramp(Arc::new(ramp)))
            }
            "HeightFieldLayer" | "ImageLayer" | "ContourLayer" | "CompositeLayer" | "SwitchLayer" => {
                Object::Layer(Arc::new(self.layer(class, block)?))
            }
            "GeometryTechnique" => Object::Nothing,
            _ => return Ok(None),
        }))
    }

    fn layer(&mut self, class: &str, block: &Block<'_>) -> Result<LayerObject> {
        let filter = |name: &str, default| match block.word(name) {
            "ANISOTROPIC" => 0x2601,
            word => value_of(GL_NAMES, word).unwrap_or(default),
        };
        let mut layer = LayerObject::default();
        layer.min_filter = filter("MinFilter", layer.min_filter);
        layer.mag_filter = filter("MagFilter", filter("Filter", layer.mag_filter));
        let is_composite = matches!(class, "CompositeLayer" | "SwitchLayer");
        let parts = if is_composite { self.layers(block)? } else { self.objects(block)? };
        // The locator of a composite stands behind its layers, that of a layer of it before that layer.
        let (mut before, mut layers) = (None, Vec::new());
        for part in parts {
            match part {
                Object::Locator(locator) => before = Some(locator),
                Object::Shape(shape) if matches!(*shape, ShapeObject::HeightField(_)) => {
                    layer.content = LayerContent::Heights(shape);
                }
                Object::Ramp(ramp) => layer.content = LayerContent::Ramp(ramp),
                Object::Layer(part) => layers.push(match before.take() {
                    Some(locator) => Arc::new(LayerObject { locator: Some(locator), ..LayerObject::clone(&part) }),
                    None => part,
                }),
                _ => {}
            }
        }
        layer.locator = before;
        match class {
            "ImageLayer" => {
                if let Some(image) = image_of_file(block.word("file")) {
                    layer.content = LayerContent::Image(image);
                }
            }
            "ContourLayer" if matches!(layer.content, LayerContent::Nothing) => self.notes.add(LAYERS_WITHOUT_COLORS),
            "CompositeLayer" => {
                self.notes.add(COMPOSITES);
                let shown = layers.iter().find(|part| !matches!(part.content, LayerContent::Nothing));
                return Ok(LayerObject::shown_by(&layer, shown));
            }
            "SwitchLayer" => {
                let active = block.value("ActiveLayer").filter(|active| *active >= 0.0);
                return Ok(LayerObject::shown_by(&layer, active.and_then(|active| layers.get(active as usize))));
            }
            _ => {}
        }
        Ok(layer)
    }
}

fn locator(block: &Block<'_>) -> LocatorObject {
    let numbers: Option<[f64; 16]> = block.list("Transform").try_into().ok();
    let extents = block.values("Extents").map(|[west, south, east, north]| {
        let scale = DMat4::from_scale(DVec3::new(east - west, north - south, 1.0));
        DMat4::from_translation(DVec3::new(west, south, 0.0)) * scale
    });
    LocatorObject {
        is_geocentric: block.word("CoordinateSystemType") == LocatorObject::TYPES[LocatorObject::GEOCENTRIC as usize],
        transform: extents.or(numbers.map(|rows| DMat4::from_cols_array(&rows))).unwrap_or(DMat4::IDENTITY),
        ..LocatorObject::default()
    }
}
