//! Effects of osgFX, and light points of osgSim.

use super::{Reader, ids};
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
}
