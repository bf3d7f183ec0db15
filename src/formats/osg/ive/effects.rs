//! Effects of osgFX, light points of osgSim, and tiles of osgVolume with their layers, locators and properties, which are read over.
//! Decode threads.

use super::{Kind, Reader, ids};
use crate::formats::osg::classes::light_points;
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{NodeClass, NodeMembers, Object};

impl Reader<'_> {
    /// Reads an effect behind its number, without what it adds to its children.
    pub(super) fn effect(&mut self, mut class: u32) -> Result<(NodeMembers, Vec<Object>)> {
        self.expect(ids::EFFECT)?;
        let members = self.group_members()?;
        // Whether it is enabled, and its technique.
        self.boolean()?;
        self.integer()?;
        match class {
            // SpecularHighlights is written under the number of AnisotropicLighting, so that the class alone does not tell
            // them apart. Only an image begins with one of these numbers.
            ids::ANISOTROPIC_LIGHTING if self.version < 29 || self.begins_image()? => {
                self.image()?;
                self.integer()?;
            }
            ids::ANISOTROPIC_LIGHTING | ids::SPECULAR_HIGHLIGHTS => {
                class = ids::SPECULAR_HIGHLIGHTS;
                self.integers::<2>()?;
                self.floats::<5>()?;
            }
            ids::BUMP_MAPPING => {
                self.integers::<3>()?;
                self.attribute_in_place()?;
                self.attribute_in_place()?;
            }
            ids::CARTOON => {
                self.floats::<5>()?;
                self.integer()?;
            }
            // Scribe: the colour and the width of its lines.
            _ => drop(self.floats::<5>()?),
        }
        self.note_children(class);
        Ok(members)
    }

    fn begins_image(&mut self) -> Result<bool> {
        Ok(matches!(self.class()?, ids::IMAGE | ids::IMAGE_SEQUENCE))
    }

    /// Reads a LightPointNode as points.
    pub(super) fn light_points(&mut self) -> Result<Object> {
        self.expect(ids::LIGHT_POINT_NODE)?;
        let node = self.node_members()?;
        // The sizes in pixels, and the distance.
        self.floats::<3>()?;
        if self.version >= 24 {
            self.boolean()?;
        }
        let points: Vec<_> = self.list(4, Self::light_point)?.into_iter().flatten().collect();
        let drawables = if points.is_empty() { Vec::new() } else { vec![light_points(points)] };
        Ok(node.with(NodeClass::Group, drawables))
    }

    /// Reads the position and the colour of a LightPoint; `None` for one that is off.
    fn light_point(&mut self) -> Result<Option<([f32; 3], [f32; 4])>> {
        self.expect(ids::LIGHT_POINT)?;
        let (is_on, position, color) = (self.boolean()?, self.floats()?, self.floats()?);
        // Intensity and radius.
        self.floats::<2>()?;
        self.optional(Self::sector)?;
        self.optional(Self::blink_sequence)?;
        // How it is blended.
        self.integer()?;
        Ok(is_on.then_some((position, color)))
    }

    /// Reads over a sector, in which a light point is seen.
    fn sector(&mut self) -> Result<()> {
        let class = self.unsigned()?;
        let floats = match class {
            ids::AZIM_ELEVATION_SECTOR => 6,
            ids::ELEVATION_SECTOR | ids::AZIM_SECTOR => 3,
            ids::CONE_SECTOR => 5,
            ids::DIRECTIONAL_SECTOR => 7,
            _ => return Err(Self::unknown("a sector", class)),
        };
        self.skip(floats * 4)
    }

    fn blink_sequence(&mut self) -> Result<()> {
        const PULSE_BYTES: usize = 8 + 4 * 4;
        self.expect(ids::BLINK_SEQUENCE)?;
        self.object_members()?;
        let pulses = self.count(PULSE_BYTES)?;
        self.skip(pulses * PULSE_BYTES)?;
        // The shift of its phase, and the base time of its group.
        self.doubles::<2>().map(drop)
    }

    /// Reads a VolumeTile as a group of its children.
    pub(super) fn volume_tile(&mut self) -> Result<Object> {
        self.expect(ids::VOLUME_TILE)?;
        let (node, children) = self.group_members()?;
        self.volume_locator()?;
        self.volume_layer()?;
        if self.optional(Self::unsigned)? == Some(ids::VOLUME_RAY_TRACED_TECHNIQUE) {
            // OSG's writer adds that there is no other technique, which OSG's reader does not expect.
            self.boolean()?;
        }
        self.note_class(ids::VOLUME_TILE);
        Ok(node.with(NodeClass::Group, children))
    }

    fn volume_locator(&mut self) -> Result<()> {
        self.read_over(Kind::VolumeLocator, |reader| {
            reader.expect(ids::VOLUME_LOCATOR)?;
            reader.object_members()?;
            reader.matrix().map(drop)
        })
    }

    fn volume_layer(&mut self) -> Result<()> {
        self.read_over(Kind::VolumeLayer, |reader| {
            let class = reader.unsigned()?;
            reader.expect(ids::VOLUME_LAYER)?;
            reader.object_members()?;
            reader.volume_locator()?;
            reader.volume_property()?;
            match class {
                ids::VOLUME_IMAGE_LAYER => {
                    let mode = reader.byte()?;
                    reader.image_of_mode(mode).map(drop)
                }
                ids::VOLUME_COMPOSITE_LAYER => {
                    for _ in 0..reader.count(2)? {
                        match reader.boolean()? {
                            true => reader.volume_layer()?,
                            false => drop(reader.string()?),
                        }
                    }
                    Ok(())
                }
                class => Err(Self::unknown("a layer", class)),
            }
        })
    }

    fn volume_property(&mut self) -> Result<()> {
        self.read_over(Kind::VolumeProperty, |reader| match reader.unsigned()? {
            ids::VOLUME_COMPOSITE_PROPERTY => reader.members_of_composite_property(),
            ids::VOLUME_SWITCH_PROPERTY => {
                reader.expect(ids::VOLUME_COMPOSITE_PROPERTY)?;
                reader.members_of_composite_property()?;
                // The active property.
                reader.unsigned().map(drop)
            }
            ids::VOLUME_TRANSFER_FUNCTION_PROPERTY => {
                const VALUE_AND_COLOR_BYTES: usize = 5 * 4;
                reader.object_members()?;
                if reader.unsigned()? == 1 {
                    // The number of cells of its image.
                    reader.unsigned()?;
                    let colors = reader.count(VALUE_AND_COLOR_BYTES)?;
                    reader.skip(colors * VALUE_AND_COLOR_BYTES)?;
                }
                Ok(())
            }
            ids::VOLUME_MAXIMUM_INTENSITY_PROPERTY | ids::VOLUME_LIGHTING_PROPERTY => Ok(()),
            ids::VOLUME_ISO_SURFACE_PROPERTY
            | ids::VOLUME_ALPHA_FUNC_PROPERTY
            | ids::VOLUME_SAMPLE_DENSITY_PROPERTY
            | ids::VOLUME_TRANSPARENCY_PROPERTY => {
                reader.expect(ids::VOLUME_SCALAR_PROPERTY)?;
                reader.object_members()?;
                reader.float().map(drop)
            }
            class => Err(Self::unknown("a property", class)),
        })
    }

    fn members_of_composite_property(&mut self) -> Result<()> {
        self.object_members()?;
        for _ in 0..self.count(4)? {
            self.volume_property()?;
        }
        Ok(())
    }

    /// Reads over an object of a kind, if there is one that was not read before.
    fn read_over(&mut self, kind: Kind, read: impl FnOnce(&mut Self) -> Result<()>) -> Result<()> {
        self.shared_or_none(kind, |reader| read(reader).map(|()| Object::Nothing)).map(drop)
    }
}
