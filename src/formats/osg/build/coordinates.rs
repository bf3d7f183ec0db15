//! The sources of a texture unit's coordinates: the geometry, planes, or the eye. Decode threads.
//!
//! Coordinates that do not depend on the eye are computed while meshes are made. The fixed function computes the others for
//! each pixel.

use glam::{DMat4, DVec3, DVec4};

use crate::formats::osg::objects::TexMatObject;
use crate::state::TexGen;

const GL_EYE_LINEAR: u32 = 0x2400;
const GL_OBJECT_LINEAR: u32 = 0x2401;
const GL_SPHERE_MAP: u32 = 0x2402;
const GL_NORMAL_MAP: u32 = 0x8511;
const GL_REFLECTION_MAP: u32 = 0x8512;

/// Swaps t, which goes up, and the way down from the first row of an image.
const TURNED_OVER: DMat4 = DMat4::from_cols(DVec4::X, DVec4::NEG_Y, DVec4::Z, DVec4::new(0.0, 1.0, 0.0, 1.0));

/// The texture coordinates s, t, r and q of a unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coordinates {
    source: CoordinateSource,
    /// The matrix that moves them.
    matrix: DMat4,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum CoordinateSource {
    Geometry,
    /// Distances from four planes in the frame of the geometry: the rows.
    Object(DMat4),
    /// The same in the frame of the eye.
    Eye(DMat4),
    Sphere,
    Normal,
    Reflection,
}

/// An affine map to two texture coordinates, as bits of numbers: four columns of s and t.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct UvMap {
    /// True for a map of positions, false for one of the geometry's own coordinates.
    pub is_of_positions: bool,
    columns: [[u64; 2]; 4],
}

impl UvMap {
    /// Returns the coordinates of a position, or of the coordinates s and t with 0.
    pub fn point(&self, of: DVec3) -> [f64; 2] {
        [0, 1].map(|row| {
            let at = |column: usize| f64::from_bits(self.columns[column][row]);
            at(0) * of.x + at(1) * of.y + at(2) * of.z + at(3)
        })
    }
}

impl Coordinates {
    /// Returns those of the geometry.
    pub const GEOMETRY: Self = Self { source: CoordinateSource::Geometry, matrix: DMat4::IDENTITY };

    /// Returns the coordinates of a TexGen, the modes of whose r and q may be off, or `None` for one that is unknown.
    pub fn generated(mode: u32, planes: [[f64; 4]; 4], [has_r, has_q]: [bool; 2]) -> Option<Self> {
        let [s, t, r, q] = planes.map(DVec4::from_array);
        let r = if has_r { r } else { DVec4::ZERO };
        let q = if has_q { q } else { DVec4::W };
        let planes = DMat4::from_cols(s, t, r, q).transpose();
        let source = match mode {
            GL_OBJECT_LINEAR => CoordinateSource::Object(planes),
            GL_EYE_LINEAR => CoordinateSource::Eye(planes),
            GL_SPHERE_MAP => CoordinateSource::Sphere,
            GL_NORMAL_MAP => CoordinateSource::Normal,
            GL_REFLECTION_MAP => CoordinateSource::Reflection,
            _ => return None,
        };
        planes.is_finite().then_some(Self { source, matrix: DMat4::IDENTITY })
    }

    /// Returns the coordinates moved by a TexMat; `None` for one that is not finite.
    pub fn moved(self, by: &TexMatObject) -> Option<Self> {
        by.matrix.is_finite().then_some(Self { matrix: by.matrix, ..self })
    }

    /// Returns the coordinates, in texels of an image, as shares of its size.
    pub fn of_rectangle(self, [width, height]: [u32; 2]) -> Self {
        let scale = DMat4::from_scale(DVec3::new(1.0 / f64::from(width.max(1)), 1.0 / f64::from(height.max(1)), 1.0));
        Self { matrix: scale * self.matrix, ..self }
    }

    /// Returns the coordinates of a geometry whose r, which meshes lack, is the same everywhere.
    pub fn at_depth(self, r: f64) -> Self {
        Self { matrix: self.matrix * DMat4::from_translation(DVec3::new(0.0, 0.0, r)), ..self }
    }

    /// Returns true if the geometry must have coordinates.
    pub fn needs_uvs(&self) -> bool {
        self.source == CoordinateSource::Geometry
    }

    /// Returns how meshes make the coordinates: a map, or none for those of the geometry as they are. Returns `None` if only
    /// the fixed function can.
    pub fn of_meshes(&self) -> Option<Option<UvMap>> {
        let (is_of_positions, map) = match self.source {
            CoordinateSource::Geometry => (false, self.matrix),
            CoordinateSource::Object(planes) => (true, self.matrix * planes),
            _ => return None,
        };
        if !is_of_positions && map == DMat4::IDENTITY {
            return Some(None);
        }
        let columns = map.to_cols_array_2d().map(|[s, t, ..]| [s.to_bits(), t.to_bits()]);
        (map.row(3) == DVec4::W).then_some(Some(UvMap { is_of_positions, columns }))
    }

    /// Returns the generator of the fixed function for meshes whose positions are relative to an origin. `own` is that of the
    /// geometry's own coordinates.
    pub fn generator(&self, own: Option<TexGen>, origin: DVec3) -> Option<TexGen> {
        let rows = |planes: DMat4| [0, 1, 2, 3].map(|row| planes.row(row).as_vec4().to_array());
        Some(match self.source {
            CoordinateSource::Geometry => return own,
            CoordinateSource::Object(planes) => TexGen::ObjectLinear(rows(planes * DMat4::from_translation(origin))),
            CoordinateSource::Eye(planes) => TexGen::EyeLinear(rows(planes)),
            CoordinateSource::Sphere => TexGen::SphereMap,
            CoordinateSource::Normal => TexGen::NormalMap,
            CoordinateSource::Reflection => TexGen::ReflectionMap,
        })
    }

    /// Returns the matrix of the fixed function, by columns; `None` if nothing moves. `are_turned_over` says that the
    /// geometry's coordinates go down from the first row already, `is_turned_over` that those of the texture must.
    pub fn fixed_matrix(&self, are_turned_over: bool, is_turned_over: bool) -> Option<[[f32; 4]; 4]> {
        // The fixed function's sphere maps go down from the first row.
        let are_turned_over = match self.source {
            CoordinateSource::Geometry => are_turned_over,
            CoordinateSource::Sphere => true,
            _ => false,
        };
        let turned = |is: bool| if is { TURNED_OVER } else { DMat4::IDENTITY };
        let matrix = turned(is_turned_over) * self.matrix * turned(are_turned_over);
        (matrix != DMat4::IDENTITY).then(|| matrix.as_mat4().to_cols_array_2d())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moved(scale: f64, by: DVec3) -> TexMatObject {
        let matrix = DMat4::from_translation(by) * DMat4::from_scale(DVec3::splat(scale));
        TexMatObject { matrix, scales_by_size: false }
    }

    #[test]
    fn what_does_not_depend_on_the_eye_is_a_map() {
        assert_eq!(Coordinates::GEOMETRY.of_meshes(), Some(None));
        let map = Coordinates::GEOMETRY.moved(&moved(2.0, DVec3::new(0.5, 0.0, 0.0))).unwrap().of_meshes();
        assert_eq!(map.unwrap().unwrap().point(DVec3::new(1.0, 3.0, 0.0)), [2.5, 6.0]);
        let planes = [[0.0, 1.0, 0.0, 4.0], [0.0, 0.0, 2.0, 0.0], [0.0; 4], [0.0, 0.0, 0.0, 1.0]];
        let object = Coordinates::generated(GL_OBJECT_LINEAR, planes, [true; 2]).unwrap();
        let map = object.of_meshes().unwrap().unwrap();
        assert_eq!((map.is_of_positions, map.point(DVec3::new(9.0, 5.0, 7.0))), (true, [9.0, 14.0]));
        let Some(TexGen::ObjectLinear(planes)) = object.generator(None, DVec3::new(0.0, 10.0, 0.0)) else { panic!() };
        assert_eq!(planes[0], [0.0, 1.0, 0.0, 14.0], "the mesh's positions are relative to its origin");
        assert!(
            Coordinates::generated(GL_SPHERE_MAP, planes.map(|p| p.map(f64::from)), [true; 2])
                .unwrap()
                .of_meshes()
                .is_none()
        );
        let projected = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0; 4], [0.0, 0.0, 1.0, 0.0]];
        let with_q = |has_q| Coordinates::generated(GL_OBJECT_LINEAR, projected, [true, has_q]).unwrap().of_meshes();
        assert!(with_q(true).is_none() && with_q(false).is_some(), "without its mode q is 1");
        assert!(Coordinates::GEOMETRY.moved(&moved(f64::NAN, DVec3::ZERO)).is_none());
    }

    #[test]
    fn matrices_turn_rows_over_once() {
        let none = Coordinates::GEOMETRY;
        assert_eq!(none.fixed_matrix(false, false), None);
        assert_eq!(none.fixed_matrix(true, true), None);
        let half_up = none.moved(&moved(1.0, DVec3::new(0.0, 0.5, 0.0))).unwrap();
        let v = |coordinates: &Coordinates, given: bool, texture: bool, v: f32| {
            let matrix = glam::Mat4::from_cols_array_2d(&coordinates.fixed_matrix(given, texture).unwrap());
            (matrix * glam::Vec4::new(0.0, v, 0.0, 1.0)).y
        };
        assert_eq!(v(&half_up, false, false, 0.25), 0.75);
        assert_eq!(v(&half_up, true, true, 0.75), 0.25, "t is 0.25, then 0.75");
        assert_eq!(v(&none, true, false, 0.25), 0.75);
        let sphere = Coordinates::generated(GL_SPHERE_MAP, [[0.0; 4]; 4], [true; 2]).unwrap();
        assert_eq!(sphere.fixed_matrix(false, true), None);
        assert_eq!(v(&sphere, false, false, 0.25), 0.75);
    }
}
