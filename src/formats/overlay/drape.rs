//! Drapes overlays over the drawables of a content. Decode threads.
//!
//! A height tile gets the composed texture instead of its imagery, which is part of the composition. A mesh gets texture coordinates from the
//! longitudes and latitudes of its vertices. Where the overlays hide everything below them, they are its base colour. Where
//! they do not, they are a separate map over the base colour ([`MetallicRoughness::overlay`]).

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::extent::Extent;
use super::grid::{GeoRectangle, near};
use super::set::OverlaySet;
use crate::fetch::{Fetched, Limits};
use crate::formats::ignored::Notes;
use crate::formats::image::{MipFilter, mips};
use crate::formats::tile::with_region;
use crate::math::{BoundingVolume, Ellipsoid};
use crate::scene::{
    AlphaMode, AttributeFormat, Drawable, Geometry, MetallicRoughness, Node, NodeKind, SecondUv, Texture, Topology,
};

/// The maximum number of vertices of a content that are draped: each gets its own copy of its mesh.
const MAX_VERTICES: usize = 4 << 20;
/// At latitudes closer to a pole than this, in radians, the longitude of a vertex has no meaning.
const POLE: f64 = 1e-7;

/// Stores the regions of tiles with their contents, so that the images of a content are those of its region and not of the
/// box around it.
pub(in crate::formats) fn note_regions(node: &mut Node) {
    if let NodeKind::PagedLod(tile) | NodeKind::MultiContentTile(tile) = &mut node.kind
        && let BoundingVolume::Region(region) = &tile.bounds
        && tile.content.is_some()
    {
        let region = [region.west, region.south, region.west + region.width(), region.north];
        tile.reader_data = with_region(tile.reader_data.take(), region);
    }
    node.children.iter_mut().for_each(note_regions);
}

/// The content that overlays are draped over.
#[derive(Clone, Copy)]
pub(in crate::formats) struct Draped {
    pub set_from_content: DAffine3,
    pub ellipsoid: Ellipsoid,
    /// True if surfaces stay as smooth as they are.
    pub keeps_reflection: bool,
}

/// Drapes the overlays over all drawables below the root node of a content. `images` were fetched for them.
pub(in crate::formats) fn drape_images(
    node: &mut Node,
    set: &OverlaySet,
    extent: &Extent,
    images: &[Fetched],
    to: Draped,
    limits: &Limits,
    notes: &Notes,
) {
    if extent.is_height {
        drape_heights(node, &mut |own| {
            let white = Texture::rgba8(1, 1, vec![vec![255; 4]]);
            let own = own.unwrap_or(&white);
            let canvas = set.compose(extent, extent.rectangle, Some(own), images, limits, notes)?;
            let (width, height, texels) = canvas.into_texels();
            Some(Arc::new(Texture::rgba8(width, height, mips(width, height, texels, MipFilter::Srgb))))
        });
        return;
    }
    let middle = middle_of(&extent.rectangle);
    let mut found = Found { places: Vec::new(), vertices: 0, ellipsoid: to.ellipsoid, middle, notes };
    found.node(node, to.set_from_content);
    let places = found.places;
    let points = places.iter().flatten().flat_map(|place| place.iter().copied());
    let Some(around) = GeoRectangle::around(middle, points) else { return };
    let area = within(around, &extent.rectangle);
    let Some(canvas) = set.compose(extent, area, None, images, limits, notes) else { return };
    if canvas.is_empty() {
        return;
    }
    let is_opaque = canvas.is_opaque();
    let (width, height, texels) = canvas.into_texels();
    let texture = Arc::new(Texture::rgba8(width, height, mips(width, height, texels, MipFilter::Srgb)));
    let mut places = places.into_iter();
    Draper { texture, area, middle, is_opaque, keeps_reflection: to.keeps_reflection, notes }.node(node, &mut places);
}

fn middle_of(rectangle: &GeoRectangle) -> f64 {
    0.5 * (rectangle.west + rectangle.east)
}

/// Returns the part of a rectangle inside another one: images were asked for there. If there is none, returns the other.
fn within(rectangle: GeoRectangle, outer: &GeoRectangle) -> GeoRectangle {
    let inner = GeoRectangle {
        west: rectangle.west.max(outer.west),
        south: rectangle.south.max(outer.south),
        east: rectangle.east.min(outer.east),
        north: rectangle.north.min(outer.north),
    };
    if inner.width() > 0.0 && inner.height() > 0.0 { inner } else { *outer }
}

/// The longitudes and latitudes of a mesh's vertices; `None` for a drawable that is left as it is.
type Places = Option<Vec<[f64; 2]>>;

/// Finds the longitudes and latitudes of the vertices of all meshes.
struct Found<'a> {
    /// In the order of the walk, one for each drawable.
    places: Vec<Places>,
    vertices: usize,
    ellipsoid: Ellipsoid,
    /// The longitude in the middle of the tile.
    middle: f64,
    notes: &'a Notes,
}

impl Found<'_> {
    fn node(&mut self, node: &Node, set_from_parent: DAffine3) {
        let mut set_from_node = set_from_parent;
        match &node.kind {
            NodeKind::Transform(map) => set_from_node = set_from_parent * *map,
            NodeKind::Geode(drawables) => {
                for drawable in drawables {
                    let places = self.drawable(drawable, &set_from_parent);
                    self.places.push(places);
                }
            }
            _ => {}
        }
        node.children.iter().for_each(|child| self.node(child, set_from_node));
    }

    fn drawable(&mut self, drawable: &Drawable, set_from_mesh: &DAffine3) -> Places {
        let Geometry::Mesh(mesh) = &drawable.geometry else { return None };
        if mesh.topology != Topology::Triangles {
            self.notes.add("overlay: lines or points, which it does not cover");
            return None;
        }
        self.vertices = self.vertices.saturating_add(mesh.vertices.len());
        if self.vertices > MAX_VERTICES {
            self.notes.add("overlay: mesh beyond four million vertices, which it does not cover");
            return None;
        }
        let (middle, ellipsoid) = (self.middle, self.ellipsoid);
        let place = |position: [f32; 3]| {
            let at = ellipsoid.geodetic(set_from_mesh.transform_point3(DVec3::from(position.map(f64::from))));
            let is_pole = at.latitude.abs() > std::f64::consts::FRAC_PI_2 - POLE;
            [if is_pole { middle } else { near(at.longitude, middle) }, at.latitude]
        };
        Some(mesh.vertices.iter().map(|vertex| place(vertex.position)).collect())
    }
}

/// Replaces the textures of height tiles by what `compose` returns for them.
fn drape_heights(node: &mut Node, compose: &mut impl FnMut(Option<&Texture>) -> Option<Arc<Texture>>) {
    if let NodeKind::Geode(drawables) = &mut node.kind {
        for drawable in drawables {
            let Geometry::Height(tile) = &mut drawable.geometry else { continue };
            if let Some(texture) = compose(tile.texture.as_deref()) {
                Arc::make_mut(tile).texture = Some(texture);
                // The tiles of other contents differ.
                (drawable.shared.geometry, drawable.shared.texture) = (None, None);
            }
        }
    }
    node.children.iter_mut().for_each(|child| drape_heights(child, compose));
}

/// Gives meshes the composed texture.
struct Draper<'a> {
    texture: Arc<Texture>,
    /// The rectangle that the texture covers.
    area: GeoRectangle,
    middle: f64,
    is_opaque: bool,
    keeps_reflection: bool,
    notes: &'a Notes,
}

impl Draper<'_> {
    fn node(&self, node: &mut Node, places: &mut impl Iterator<Item = Places>) {
        if let NodeKind::Geode(drawables) = &mut node.kind {
            for drawable in drawables {
                if let Some(Some(places)) = places.next() {
                    self.drawable(drawable, &places);
                }
            }
        }
        node.children.iter_mut().for_each(|child| self.node(child, places));
    }

    /// Returns the texture coordinates of a longitude and a latitude. The outermost texels lie on the edges of the area.
    fn uv(&self, [longitude, latitude]: [f64; 2]) -> [f32; 2] {
        let along = |fraction: f64, texels: u32| {
            let texels = f64::from(texels);
            ((0.5 + fraction.clamp(0.0, 1.0) * (texels - 1.0)) / texels) as f32
        };
        let x = (near(longitude, self.middle) - self.area.west) / self.area.width().max(1e-12);
        let y = (self.area.north - latitude) / self.area.height().max(1e-12);
        [along(x, self.texture.width), along(y, self.texture.height)]
    }

    fn drawable(&self, drawable: &mut Drawable, places: &[[f64; 2]]) {
        let Geometry::Mesh(mesh) = &mut drawable.geometry else { return };
        let material = &mut drawable.material;
        let has_maps = material.metallic_roughness.as_ref().is_some_and(MetallicRoughness::has_maps);
        let hides_all = self.is_opaque && material.alpha == AlphaMode::Opaque && !has_maps;
        let uvs = places.iter().map(|place| self.uv(*place));
        if hides_all {
            let mesh = Arc::make_mut(mesh);
            for (vertex, uv) in mesh.vertices.iter_mut().zip(uvs) {
                (vertex.uv, vertex.color) = (uv, [255; 4]);
            }
            material.base_color = [1.0; 4];
            material.texture = Some(self.texture.clone());
            if !self.keeps_reflection {
                material.metallic_roughness = None;
            }
            drawable.shared.texture = None;
        } else {
            if mesh.attributes.get(SecondUv::ATTRIBUTE).is_some() {
                self.notes.add("overlay: mesh with second texture coordinates, which it does not cover");
                return;
            }
            let uvs: Vec<[f32; 2]> = uvs.collect();
            let count = mesh.vertices.len();
            let bytes = bytemuck::cast_slice(&uvs).into();
            let mesh = Arc::make_mut(mesh);
            if mesh.attributes.push(count, SecondUv::ATTRIBUTE, AttributeFormat::Float32x2, bytes).is_err() {
                self.notes.add("overlay: mesh with too many attributes, which it does not cover");
                return;
            }
            let surface = material.metallic_roughness.get_or_insert_default();
            surface.overlay = Some(self.texture.clone());
        }
        // The meshes of other contents differ.
        drawable.shared.geometry = None;
    }
}
