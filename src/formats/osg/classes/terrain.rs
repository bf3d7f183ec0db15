//! The members of osgTerrain's classes.

use std::sync::Arc;

use glam::DMat4;

use super::Reader;
use super::geometry::VERSION_OF_ARRAY_OBJECTS;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::{Names, Number};
use crate::formats::osg::objects::{
    BlendingPolicy, ImageData, ImageObject, LayerContent, LayerObject, LocatorObject, NodeClass, Object, RampObject,
    ShapeObject, TerrainSettings, TerrainTileObject, Validity, ellipsoid,
};

/// The names under which layers are counted, in all encodings.
pub(in crate::formats::osg) const LAYERS_WITHOUT_COLORS: &str =
    "OpenSceneGraph class osgTerrain::ContourLayer without colours (not drawn)";
pub(in crate::formats::osg) const COMPOSITES: &str =
    "OpenSceneGraph class osgTerrain::CompositeLayer (its first layer is drawn)";
pub(in crate::formats::osg) const LAYERS_ELSEWHERE: &str =
    "OpenSceneGraph class osgTerrain::ProxyLayer of a file that is read in place (not drawn)";
pub(in crate::formats::osg) const HEIGHTS_ELSEWHERE: &str =
    "OpenSceneGraph: elevation layer of a terrain without a HeightField (drawn flat)";
pub(in crate::formats::osg) const FURTHER_LAYERS: &str = "OpenSceneGraph: colour layer of a ninth texture unit";
pub(in crate::formats::osg) const CHILDREN_OF_TILES: &str =
    "OpenSceneGraph: children of a TerrainTile, which OSG does not draw";

/// Returns the image of a file whose name may begin with the name of a set: `set:NAME:FILE`.
pub(in crate::formats::osg) fn image_of_file(name: &str) -> Option<Arc<ImageObject>> {
    let name = match name.strip_prefix("set:") {
        Some(rest) => rest.split_once(':').map_or("", |(_, file)| file),
        None => name,
    };
    let image = || Arc::new(ImageObject { file_name: name.to_owned(), data: ImageData::External });
    (!name.is_empty()).then(image)
}

impl Reader<'_> {
    /// Reads the members of a class of osgTerrain; `None` if the class is none.
    pub(super) fn terrain_of(&mut self, class: &str) -> Result<Option<Object>> {
        if class == "osg::EllipsoidModel" {
            self.object_members()?;
            let [equator_m, polar_m] =
                [self.double_member("RadiusEquator", 0.0)?, self.double_member("RadiusPolar", 0.0)?];
            return Ok(Some(Object::Ellipsoid(Box::new(ellipsoid(equator_m, polar_m)))));
        }
        if class == "osg::TransferFunction1D" {
            return self.transfer_function().map(Some);
        }
        Ok(Some(match class.strip_prefix("osgTerrain::") {
            Some("Terrain") => self.terrain()?,
            Some("TerrainTile") => self.terrain_tile()?,
            Some("Locator") => self.locator()?,
            Some("HeightFieldLayer") => {
                let (mut layer, _) = self.layer_members()?;
                if let Object::Shape(shape) = self.object_member("HeightField")?
                    && matches!(*shape, ShapeObject::HeightField(_))
                {
                    layer.content = LayerContent::Heights(shape);
                }
                Object::Layer(Arc::new(layer))
            }
            Some("ImageLayer") => self.image_layer()?,
            Some("CompositeLayer") => self.composite_layer(false)?,
            Some("SwitchLayer") => self.composite_layer(true)?,
            Some("ContourLayer") => {
                let (mut layer, _) = self.layer_members()?;
                match self.object_member("TransferFunction")? {
                    Object::Ramp(ramp) => layer.content = LayerContent::Ramp(ramp),
                    _ => self.notes.add(LAYERS_WITHOUT_COLORS),
                }
                Object::Layer(Arc::new(layer))
            }
            Some("ProxyLayer") => {
                let (layer, _) = self.layer_members()?;
                let implementation = self.layer_member("Implementation")?;
                if implementation.is_none() {
                    self.notes.add(LAYERS_ELSEWHERE);
                }
                Object::Layer(Arc::new(LayerObject::shown_by(&layer, implementation.as_ref())))
            }
            Some("GeometryTechnique") => {
                self.object_members()?;
                self.float_member("FilterBias", 0.0)?;
                self.float_member("FilterWidth", 0.1)?;
                if self.marked_member("FilterMatrix")? {
                    self.block(|reader| reader.input.numbers(Number::F32, 9))?;
                }
                Object::Nothing
            }
            _ => return Ok(None),
        }))
    }

    /// Reads a TransferFunction1D, a map in versions since 112.
    fn transfer_function(&mut self) -> Result<Object> {
        self.object_members()?;
        let is_map = self.version >= VERSION_OF_ARRAY_OBJECTS;
        let follows = if is_map { self.member("ColorMap")? } else { self.marked_member("ColorMap")? };
        if !follows {
            return Ok(Object::Nothing);
        }
        let entry = |reader: &mut Self| {
            let value = f64::from(reader.float()?);
            let [r, g, b, a] = if is_map { reader.floats()?.map(f64::from) } else { reader.doubles()? };
            Ok([value, r, g, b, a])
        };
        let colors = if is_map && !self.input.is_text() {
            let count = self.count()?;
            (0..count).map(|_| entry(self)).collect::<Result<Vec<_>>>()?
        } else {
            self.list_unless_empty(entry)?
        };
        Ok(RampObject::new(colors).map_or(Object::Nothing, |ramp| Object::Ramp(Arc::new(ramp))))
    }

    fn terrain(&mut self) -> Result<Object> {
        let (node, children, system) = self.coordinate_system_members()?;
        let sample_ratio = self.float_member("SampleRatio", 1.0)?;
        let vertical_scale = self.float_member("VerticalScale", 1.0)?.into();
        let settings = TerrainSettings { sample_ratio, vertical_scale, blending: self.blending_policy()? };
        Ok(node.with(NodeClass::Terrain(settings, system), children))
    }

    fn terrain_tile(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        if !children.is_empty() {
            self.notes.add(CHILDREN_OF_TILES);
        }
        if self.marked_member("TileID")? {
            self.input.numbers(Number::I32, 3)?;
        }
        self.object_member("TerrainTechnique")?;
        let locator = self.locator_member()?;
        let elevation = self.layer_member("ElevationLayer")?;
        if elevation.as_ref().is_some_and(|layer| layer.heights().is_none()) {
            self.notes.add(HEIGHTS_ELSEWHERE);
        }
        let mut tile = TerrainTileObject { locator, elevation, ..TerrainTileObject::default() };
        if self.marked_member("ColorLayers")? {
            for (unit, layer) in self.list(Self::color_layer)? {
                if let Object::Layer(layer) = layer
                    && !tile.set_color(unit as usize, layer)
                {
                    self.notes.add(FURTHER_LAYERS);
                }
            }
        }
        self.boolean_member("RequiresNormals", true)?;
        self.boolean_member("TreatBoundariesToValidDataAsDefaultValue", false)?;
        tile.blending = self.blending_policy()?;
        Ok(node.with(NodeClass::TerrainTile(tile), children))
    }

    fn color_layer(&mut self) -> Result<(u32, Object)> {
        self.input.keyword("Layer")?;
        Ok((self.unsigned()?, self.object()?))
    }

    fn blending_policy(&mut self) -> Result<BlendingPolicy> {
        const POLICIES: Names = &[
            (BlendingPolicy::NAMES[0], 0),
            (BlendingPolicy::NAMES[1], 1),
            (BlendingPolicy::NAMES[2], 2),
            (BlendingPolicy::NAMES[3], 3),
        ];
        self.named_member("BlendingPolicy", POLICIES, 0).map(BlendingPolicy::of_number)
    }

    fn locator(&mut self) -> Result<Object> {
        const TYPES: Names =
            &[(LocatorObject::TYPES[0], 0), (LocatorObject::TYPES[1], 1), (LocatorObject::TYPES[2], 2)];
        self.object_members()?;
        let is_geocentric = self.named_member("CoordinateSystemType", TYPES, 2)? == LocatorObject::GEOCENTRIC;
        self.string_member("Format")?;
        self.string_member("CoordinateSystem")?;
        let mut locator = LocatorObject { is_geocentric, ..LocatorObject::default() };
        if let Object::Ellipsoid(ellipsoid) = self.object_member("EllipsoidModel")? {
            locator.ellipsoid = *ellipsoid;
        }
        locator.transform = if self.member("Transform")? { self.matrix()? } else { DMat4::IDENTITY };
        self.boolean_member("DefinedInFile", false)?;
        self.boolean_member("TransformScaledByResolution", false)?;
        Ok(Object::Locator(Arc::new(locator)))
    }

    fn locator_member(&mut self) -> Result<Option<Arc<LocatorObject>>> {
        Ok(match self.object_member("Locator")? {
            Object::Locator(locator) => Some(locator),
            _ => None,
        })
    }

    fn layer_member(&mut self, name: &str) -> Result<Option<Arc<LayerObject>>> {
        Ok(match self.object_member(name)? {
            Object::Layer(layer) => Some(layer),
            _ => None,
        })
    }

    /// Reads the members of the class Layer, and returns them with the name of the layer's file.
    fn layer_members(&mut self) -> Result<(LayerObject, String)> {
        self.object_members()?;
        let file_name = self.string_member("FileName")?;
        let mut layer = LayerObject { locator: self.locator_member()?, ..LayerObject::default() };
        self.unsigned_member("MinLevel", 0)?;
        self.unsigned_member("MaxLevel", 0)?;
        if self.marked_member("ValidDataOperator")? {
            layer.validity = match self.unsigned()? {
                1 => Validity::Without(self.float()?),
                2 => Validity::Range(self.floats()?),
                _ => Validity::All,
            };
        }
        self.floats_member("DefaultValue", [0.0; 4])?;
        layer.min_filter = self.gl_member("MinFilter", layer.min_filter)?;
        layer.mag_filter = self.gl_member("MagFilter", layer.mag_filter)?;
        Ok((layer, file_name))
    }

    fn image_layer(&mut self) -> Result<Object> {
        let (mut layer, file_name) = self.layer_members()?;
        let mut image = None;
        if self.marked_member("Image")? {
            // The first versions say in text that there is an image.
            let is_there = !self.input.is_text() || !self.input.matches("FALSE")?;
            if self.input.is_text() && is_there {
                self.input.matches("TRUE")?;
            }
            if is_there {
                image = self.in_braces(Self::image)?;
            }
        }
        if let Some(image) = image.or_else(|| image_of_file(&file_name)) {
            layer.content = LayerContent::Image(image);
        }
        Ok(Object::Layer(Arc::new(layer)))
    }

    /// Reads a CompositeLayer or a SwitchLayer as the layer that it shows.
    fn composite_layer(&mut self, is_switch: bool) -> Result<Object> {
        let (layer, _) = self.layer_members()?;
        let mut parts = Vec::new();
        if self.marked_member("Layers")? {
            parts = self.list(|reader| {
                if reader.input.word()? == "File" {
                    let image = image_of_file(&reader.input.quoted()?);
                    let content = image.map_or(LayerContent::Nothing, LayerContent::Image);
                    return Ok(Some(Arc::new(LayerObject { content, ..LayerObject::default() })));
                }
                Ok(match reader.object()? {
                    Object::Layer(layer) => Some(layer),
                    _ => None,
                })
            })?;
        }
        let shown = if is_switch {
            usize::try_from(self.integer_member("ActiveLayer", -1)?).ok().and_then(|active| parts.get(active)?.as_ref())
        } else {
            self.notes.add(COMPOSITES);
            parts.iter().flatten().find(|part| !matches!(part.content, LayerContent::Nothing))
        };
        Ok(Object::Layer(Arc::new(LayerObject::shown_by(&layer, shown))))
    }
}
