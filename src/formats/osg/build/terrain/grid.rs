//! [`Grid`]: the samples of a tile of osgTerrain in the tile's frame, and the triangles between them, as OSG's
//! GeometryTechnique makes them.

use glam::DVec3;

use crate::formats::osg::objects::{
    HeightFieldObject, LayerObject, LocatorObject, TerrainSettings, TerrainTileObject, Validity,
};
use crate::math::{Aabb, BoundingSphere};

/// The columns and rows of a tile without heights.
const FLAT_SIDE: usize = 20;
/// A tile keeps this many columns and rows whatever the sample ratio.
const MIN_SIDE: usize = 16;

/// The samples of a tile.
pub(super) struct Grid<'a> {
    pub columns: usize,
    pub rows: usize,
    /// Maps the samples, 0 to 1 with heights, to the frame of the tile.
    pub locator: &'a LocatorObject,
    /// Heights with the values that are valid.
    heights: Option<(&'a HeightFieldObject, Validity)>,
    vertical_scale: f64,
}

/// A vertex of a tile: a sample, or a point of a skirt below one.
#[derive(Clone, Copy)]
pub(super) struct GridVertex {
    /// The sample in the layer: 0 to 1, with the height in metres.
    pub local: DVec3,
    /// The position in the frame of the tile.
    pub position: DVec3,
    pub normal: DVec3,
    /// The direction away from the ground.
    up: DVec3,
}

/// The vertices of a tile and its triangles.
pub(super) struct GridMesh {
    pub vertices: Vec<GridVertex>,
    pub indices: Vec<i32>,
}

impl<'a> Grid<'a> {
    /// Returns the samples of a tile; `None` if none of its layers says where it lies, or if it has no cell.
    pub fn new(tile: &'a TerrainTileObject, settings: &TerrainSettings) -> Option<Self> {
        let heights = tile.elevation.as_deref().and_then(|layer| Some((layer.heights()?, layer.validity)));
        let of_layer = |layer: Option<&'a LayerObject>| layer.and_then(|layer| layer.locator.as_deref());
        let first_color = tile.colors.first().and_then(Option::as_deref);
        let locator = of_layer(tile.elevation.as_deref()).or(of_layer(first_color)).or(tile.locator.as_deref())?;
        let [mut columns, mut rows] = heights.map_or([FLAT_SIDE; 2], |(field, _)| [field.columns, field.rows]);
        let share = settings.sample_ratio.sqrt();
        if share != 1.0 && share.is_finite() && columns > MIN_SIDE && rows > MIN_SIDE {
            [columns, rows] = [columns, rows].map(|side| ((side as f32 * share) as usize).max(MIN_SIDE));
        }
        let vertical_scale = settings.vertical_scale;
        (columns > 1 && rows > 1).then_some(Self { columns, rows, locator, heights, vertical_scale })
    }

    /// Returns the number of vertices with those of the skirt.
    pub fn vertex_count(&self) -> usize {
        let skirt =
            if self.skirt_height() == 0.0 { 0 } else { self.columns.saturating_add(self.rows).saturating_mul(2) };
        self.columns.saturating_mul(self.rows).saturating_add(skirt)
    }

    /// Returns the length of the skirt in metres.
    fn skirt_height(&self) -> f64 {
        self.heights.map_or(0.0, |(field, _)| field.skirt_height)
    }

    /// Returns a sphere around the samples of the elevation layer with the skirt.
    pub fn sphere(&self) -> BoundingSphere {
        let skirt = self.skirt_height().abs();
        let places = (0..self.rows).flat_map(|row| (0..self.columns).map(move |column| (column, row)));
        let points = places.filter_map(|(column, row)| Some(self.locator.model(self.sample(column, row)?)));
        let bounds = Aabb::from_points(points.filter(|point| point.is_finite()));
        if bounds.is_empty() {
            return BoundingSphere::EMPTY;
        }
        let BoundingSphere { center, radius_m } = bounds.bounding_sphere();
        BoundingSphere::new(center, radius_m + if skirt.is_finite() { skirt } else { 0.0 })
    }

    /// Returns a sample in the layer; `None` if it is not valid.
    fn sample(&self, column: usize, row: usize) -> Option<DVec3> {
        let [x, y] = [(column, self.columns), (row, self.rows)].map(|(at, count)| at as f64 / (count - 1) as f64);
        let height = match self.heights {
            None => 0.0,
            Some((field, validity)) if (field.columns, field.rows) == (self.columns, self.rows) => {
                value(field, validity, column, row)?
            }
            Some((field, validity)) => interpolated(field, validity, x, y)?,
        };
        Some(DVec3::new(x, y, height * self.vertical_scale))
    }

    /// Returns the vertices and triangles.
    pub fn mesh(&self) -> GridMesh {
        let mut vertices = Vec::with_capacity(self.vertex_count());
        let mut numbers: Vec<Option<u32>> = Vec::with_capacity(self.columns * self.rows);
        for row in 0..self.rows {
            for column in 0..self.columns {
                let vertex = self.sample(column, row).and_then(|local| {
                    let position = self.locator.model(local);
                    let up = (self.locator.model(local + DVec3::Z) - position).normalize_or_zero();
                    position.is_finite().then_some(GridVertex { local, position, normal: up, up })
                });
                numbers.push(vertex.is_some().then_some(vertices.len() as u32));
                vertices.extend(vertex);
            }
        }
        let at = |column: usize, row: usize| numbers[row * self.columns + column];
        for row in 0..self.rows {
            for column in 0..self.columns {
                let Some(number) = at(column, row) else { continue };
                let place = |column: Option<usize>, row: Option<usize>| {
                    let number = at(column.filter(|at| *at < self.columns)?, row.filter(|at| *at < self.rows)?)?;
                    Some(vertices[number as usize].position)
                };
                let along = |before: Option<DVec3>, after: Option<DVec3>| {
                    let here = vertices[number as usize].position;
                    after.unwrap_or(here) - before.unwrap_or(here)
                };
                let east = along(place(column.checked_sub(1), Some(row)), place(Some(column + 1), Some(row)));
                let north = along(place(Some(column), row.checked_sub(1)), place(Some(column), Some(row + 1)));
                if let Some(normal) = east.cross(north).try_normalize() {
                    vertices[number as usize].normal = normal;
                }
            }
        }
        let mut indices = self.triangles(&vertices, at);
        self.add_skirt(&mut vertices, &mut indices, at);
        GridMesh { vertices, indices }
    }

    /// Returns the triangles of the cells. The diagonal lies between the corners whose normals differ least.
    fn triangles(&self, vertices: &[GridVertex], at: impl Fn(usize, usize) -> Option<u32>) -> Vec<i32> {
        let mut indices = Vec::with_capacity(6 * (self.columns - 1) * (self.rows - 1));
        let alike = |a: u32, b: u32| vertices[a as usize].normal.dot(vertices[b as usize].normal);
        let turns_over = self.locator.turns_over();
        for row in 0..self.rows - 1 {
            for column in 0..self.columns - 1 {
                // Counter-clockwise seen from above.
                let mut corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(x, y)| at(column + x, row + y));
                if turns_over {
                    corners.reverse();
                }
                match corners {
                    [Some(a), Some(b), Some(c), Some(d)] => {
                        let triangles = if alike(a, c) > alike(b, d) { [a, b, c, a, c, d] } else { [a, b, d, b, c, d] };
                        indices.extend(triangles.map(|number| number as i32));
                    }
                    _ if corners.iter().flatten().count() == 3 => {
                        indices.extend(corners.iter().flatten().map(|number| *number as i32));
                    }
                    _ => {}
                }
            }
        }
        indices
    }

    /// Adds a skirt, which hides the gaps to neighbours of other levels.
    fn add_skirt(
        &self,
        vertices: &mut Vec<GridVertex>,
        indices: &mut Vec<i32>,
        at: impl Fn(usize, usize) -> Option<u32>,
    ) {
        let height = self.skirt_height();
        if height == 0.0 || !height.is_finite() {
            return;
        }
        // Counter-clockwise seen from above, so that the skirt faces outwards.
        let (east, north) = (self.columns - 1, self.rows - 1);
        let edges = (0..east).map(|column| (column, 0)).chain((0..north).map(|row| (east, row)));
        let edges = edges.chain((1..=east).rev().map(|column| (column, north)));
        let ring: Vec<(usize, usize)> = edges.chain((1..=north).rev().map(|row| (0, row))).collect();
        let lower: Vec<Option<[i32; 2]>> = ring
            .iter()
            .map(|(column, row)| {
                let number = at(*column, *row)?;
                let vertex = vertices[number as usize];
                vertices.push(GridVertex { position: vertex.position - vertex.up * height, ..vertex });
                Some([number as i32, vertices.len() as i32 - 1])
            })
            .collect();
        for (k, pair) in lower.iter().enumerate() {
            if let (Some([a, below_a]), Some([b, below_b])) = (*pair, lower[(k + 1) % lower.len()]) {
                let faces = [a, below_a, below_b, a, below_b, b];
                match self.locator.turns_over() {
                    true => indices.extend(faces.iter().rev()),
                    false => indices.extend(faces),
                }
            }
        }
    }
}

/// Returns a height; `None` if it is not valid.
fn value(field: &HeightFieldObject, validity: Validity, column: usize, row: usize) -> Option<f64> {
    let is_inside = column < field.columns && row < field.rows;
    let height = is_inside.then(|| field.heights.get(row * field.columns + column, 0))?;
    validity.holds(height as f32).then_some(height)
}

/// Returns the height between the valid ones of the four samples around a place, 0 to 1; `None` if none is valid.
fn interpolated(field: &HeightFieldObject, validity: Validity, x: f64, y: f64) -> Option<f64> {
    let [x, y] = [x * (field.columns.max(1) - 1) as f64, y * (field.rows.max(1) - 1) as f64];
    let (column, row) = (x as usize, y as usize);
    let [right, up] = [x - column as f64, y - row as f64];
    let corners = [
        (column, row, (1.0 - right) * (1.0 - up)),
        (column + 1, row, right * (1.0 - up)),
        (column + 1, row + 1, right * up),
        (column, row + 1, (1.0 - right) * up),
    ];
    let (mut sum, mut weights) = (0.0, 0.0);
    for (column, row, weight) in corners {
        if let Some(height) = value(field, validity, column, row).filter(|_| weight > 0.0) {
            sum += height * weight;
            weights += weight;
        }
    }
    (weights > 0.0).then_some(sum / weights)
}
