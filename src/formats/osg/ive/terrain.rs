//! osgTerrain: Terrain, TerrainTile with its layers, Locator.

use std::sync::Arc;

use super::{Kind, Reader, ids};
use crate::fetch::about_to_allocate;
use crate::formats::osg::classes::{
    CHILDREN_OF_TILES, COMPOSITES, FURTHER_LAYERS, HEIGHTS_ELSEWHERE, LAYERS_ELSEWHERE, image_of_file,
};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{Input as _, Number, Values};
use crate::formats::osg::objects::{
    ArrayObject, BlendingPolicy, ImageData, LayerContent, LayerObject, LocatorObject, NodeClass, Object, ShapeObject,
    TerrainSettings, TerrainTileObject, Validity,
};

/// The maximum number of heights in a file that are written as one value.
const MAX_EQUAL_HEIGHTS: usize = 4 << 20;
/// OpenGL's numbers of filters.
const NEAREST: u32 = 0x2600;
const LINEAR: u32 = 0x2601;

impl Reader<'_> {
    /// Reads a Terrain: a CoordinateSystemNode above tiles.
    pub(super) fn terrain(&mut self) -> Result<Object> {
        self.expect(ids::TERRAIN)?;
        let (node, children, system) = self.coordinate_system_members()?;
        let (sample_ratio, vertical_scale) = (self.float()?, self.float()?.into());
        let blending = BlendingPolicy::of_number(self.unsigned()?);
        self.technique()?;
        let settings = TerrainSettings { sample_ratio, vertical_scale, blending };
        Ok(node.with(NodeClass::Terrain(settings, system), children))
    }

    pub(super) fn terrain_tile(&mut self) -> Result<Object> {
        self.expect(ids::TERRAIN_TILE)?;
        let (node, children) = self.group_members()?;
        if !children.is_empty() {
            self.notes.add(CHILDREN_OF_TILES);
        }
        let mut tile = TerrainTileObject::default();
        if self.version >= 44 {
            tile.blending = BlendingPolicy::of_number(self.unsigned()?);
        }
        if self.version >= 26 {
            // Level, x and y.
            self.integers::<3>()?;
        }
        tile.locator = self.locator()?;
        tile.elevation = self.layer()?;
        if tile.elevation.as_ref().is_some_and(|layer| layer.heights().is_none()) {
            self.notes.add(HEIGHTS_ELSEWHERE);
        }
        for unit in 0..self.count(1)? {
            if let Some(layer) = self.layer()?
                && !tile.set_color(unit, layer)
            {
                self.notes.add(FURTHER_LAYERS);
            }
        }
        self.technique()?;
        Ok(node.with(NodeClass::TerrainTile(tile), children))
    }

    /// Reads over the number of a technique, which has no members.
    fn technique(&mut self) -> Result<()> {
        self.optional(Self::integer).map(drop)
    }

    /// Reads a locator, if there is one.
    fn locator(&mut self) -> Result<Option<Arc<LocatorObject>>> {
        let object = match self.version >= 23 {
            true => self.shared_or_none(Kind::Locator, Self::new_locator)?,
            false => self.optional(Self::new_locator)?.unwrap_or(Object::Nothing),
        };
        Ok(if let Object::Locator(locator) = object { Some(locator) } else { None })
    }

    fn new_locator(&mut self) -> Result<Object> {
        self.expect(ids::LOCATOR)?;
        self.object_members()?;
        let is_geocentric = self.unsigned()? == LocatorObject::GEOCENTRIC;
        // The format and the definition of the coordinate system.
        self.string()?;
        self.string()?;
        let mut locator = LocatorObject { is_geocentric, ..LocatorObject::default() };
        if let Some(ellipsoid) = self.optional(Self::ellipsoid)? {
            locator.ellipsoid = ellipsoid;
        }
        // Whether it is that of a file, and whether its transform is scaled by the resolution.
        self.skip(2)?;
        locator.transform = self.matrix()?;
        Ok(Object::Locator(Arc::new(locator)))
    }

    /// Reads a layer, if there is one.
    fn layer(&mut self) -> Result<Option<Arc<LayerObject>>> {
        match self.version >= 23 {
            true => Ok(layer_of(self.shared_or_none(Kind::Layer, Self::new_layer)?)),
            false => self.layer_in_place(),
        }
    }

    /// Reads a layer without a number, if there is one.
    fn layer_in_place(&mut self) -> Result<Option<Arc<LayerObject>>> {
        Ok(self.optional(|reader| reader.nested(Self::new_layer))?.and_then(layer_of))
    }

    fn new_layer(&mut self) -> Result<Object> {
        let class = self.unsigned()?;
        let layer = match class {
            ids::IMAGE_LAYER => {
                let mut layer = self.layer_members()?;
                let mode = self.byte()?;
                let image = self.image_of_mode(mode)?;
                let image = image.and_then(|image| match image.data {
                    ImageData::External => image_of_file(&image.file_name),
                    _ => Some(image),
                });
                layer.content = image.map_or(LayerContent::Nothing, LayerContent::Image);
                layer
            }
            ids::HEIGHT_FIELD_LAYER => {
                let layer = self.layer_members()?;
                LayerObject { content: self.heights()?, ..layer }
            }
            ids::COMPOSITE_LAYER => {
                let (composite, parts) = self.composite_members()?;
                self.notes.add(COMPOSITES);
                let shown = parts.iter().flatten().find(|part| !matches!(part.content, LayerContent::Nothing));
                LayerObject::shown_by(&composite, shown)
            }
            ids::SWITCH_LAYER => {
                self.expect(ids::COMPOSITE_LAYER)?;
                let (composite, parts) = self.composite_members()?;
                let active = usize::try_from(self.integer()?).ok();
                LayerObject::shown_by(&composite, active.and_then(|active| parts.get(active)?.as_ref()))
            }
            ids::PROXY_LAYER => {
                self.string()?;
                let locator = self.locator()?;
                // The levels that it is for.
                self.integers::<2>()?;
                self.notes.add(LAYERS_ELSEWHERE);
                LayerObject { locator, ..LayerObject::default() }
            }
            _ => return Err(Self::unknown("a layer", class)),
        };
        Ok(Object::Layer(Arc::new(layer)))
    }

    /// Reads the members of the classes Object and Layer.
    fn layer_members(&mut self) -> Result<LayerObject> {
        self.expect(ids::LAYER)?;
        self.object_members()?;
        let mut layer = LayerObject { locator: self.locator()?, ..LayerObject::default() };
        if self.version >= 34 {
            [layer.min_filter, layer.mag_filter] = self.integers()?;
        } else if self.version >= 23 {
            layer.mag_filter = if self.unsigned()? == 0 { NEAREST } else { LINEAR };
        }
        // The levels that it is for.
        self.integers::<2>()?;
        if self.version >= 27 {
            layer.validity = self.optional(Self::validity)?.unwrap_or(Validity::All);
        }
        Ok(layer)
    }

    /// Reads the operator that says which heights are valid.
    fn validity(&mut self) -> Result<Validity> {
        let class = self.class()?;
        if !matches!(class, ids::VALID_RANGE | ids::NO_DATA_VALUE) {
            // OSG goes on with what follows.
            return Ok(Validity::All);
        }
        self.unsigned()?;
        Ok(if class == ids::VALID_RANGE { Validity::Range(self.floats()?) } else { Validity::Without(self.float()?) })
    }

    /// Reads the members of a CompositeLayer, and its layers.
    fn composite_members(&mut self) -> Result<(LayerObject, Vec<Option<Arc<LayerObject>>>)> {
        let composite = self.layer_members()?;
        let parts = self.list(2, |reader| {
            if reader.boolean()? {
                return reader.layer_in_place();
            }
            let image = image_of_file(&reader.string()?);
            let content = image.map_or(LayerContent::Nothing, LayerContent::Image);
            Ok(Some(Arc::new(LayerObject { content, ..LayerObject::default() })))
        })?;
        Ok((composite, parts))
    }

    /// Reads the heights of a layer; nothing for those in another file.
    fn heights(&mut self) -> Result<LayerContent> {
        if !self.boolean()? {
            self.string()?;
            return Ok(LayerContent::Nothing);
        }
        if self.version >= 35 {
            let field = self.height_field(Self::packed_floats)?;
            return Ok(LayerContent::Heights(Arc::new(ShapeObject::HeightField(field))));
        }
        Ok(match self.shape()? {
            Object::Shape(shape) if matches!(*shape, ShapeObject::HeightField(_)) => LayerContent::Heights(shape),
            _ => LayerContent::Nothing,
        })
    }

    /// Reads floats that are packed into the bytes that their error allows.
    fn packed_floats(&mut self) -> Result<Arc<ArrayObject>> {
        let count = self.integer()?.max(0) as usize;
        let mut values = Values::F32(Vec::new());
        if count > 0 && self.boolean()? {
            values = self.equal_floats(count)?;
        } else if count > 0 {
            let number = match self.integer()? {
                1 => Number::U8,
                2 => Number::U16,
                _ => Number::F32,
            };
            if number == Number::F32 {
                values = self.input.numbers(number, count)?;
            } else {
                let [min, max] = self.floats::<2>()?;
                let unit = (max - min) / number.one() as f32;
                let packed = self.input.numbers(number, count)?;
                values = Values::F32((0..count).map(|i| packed.get(i) as f32 * unit + min).collect());
            }
        }
        Ok(Arc::new(ArrayObject { width: 1, values, binding: None, is_normalized: false }))
    }

    /// Returns heights that are equal. They take no bytes, so that a limit for all of a file bounds them.
    fn equal_floats(&mut self, count: usize) -> Result<Values> {
        let value = self.float()?;
        let total = self.equal_heights.saturating_add(count);
        if total > MAX_EQUAL_HEIGHTS {
            let (got, limit) = (total as u64, MAX_EQUAL_HEIGHTS as u64);
            return Err(OsgError::TooLarge { what: "equal heights of an .ive file", got, limit });
        }
        self.equal_heights = total;
        about_to_allocate(Number::F32.memory_bytes() * count as u64)?;
        Ok(Values::F32(vec![value; count]))
    }
}

fn layer_of(object: Object) -> Option<Arc<LayerObject>> {
    match object {
        Object::Layer(layer) => Some(layer),
        _ => None,
    }
}
