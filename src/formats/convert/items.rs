//! [`Splitter`]: divides the nodes of a content into what it draws and the tiles below it. Any thread.
//!
//! Files of OpenSceneGraph mix geometry and paged nodes, and have levels of detail without files. 3D Tiles has one tree of
//! tiles: geometry beside a tile becomes a tile beside it, and a LOD a chain of tiles.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::formats::ignored::Notes;
use crate::formats::tile::ALWAYS_REFINED_M;
use crate::formats::writers::Leaf;
use crate::math::{BoundingSphere, BoundingVolume};
use crate::scene::{Drawable, Node, NodeKind, PagedLod, ProxyNode, RangeMode, ReaderData, Refine};
use crate::state::{Attribute, StateSet, SurfaceMaterial};

/// Ranges end here or above for what is shown from anywhere on the earth and around it. OSG's tools write 1e10 and more.
const ENDLESS: f64 = 1e9;
/// Ranges begin here or below for what is shown however near the eye is, metres.
const NEAREST_M: f64 = 1e-3;

/// A tile of the source whose content is not converted yet.
#[derive(Debug)]
pub(super) struct Item {
    /// The name of its files without a file extension, relative to the output.
    pub name: String,
    pub content: ItemContent,
    /// Maps the frame of the item to that of the set.
    pub set_from_item: DAffine3,
    /// The declared volume in the item's frame; `None` if it is unknown.
    pub bounds: Option<BoundingVolume>,
    pub request_volume: Option<BoundingVolume>,
    pub refine: Refine,
    pub refinement: Refinement,
    pub children: Vec<Item>,
}

/// The content of an item.
#[derive(Debug)]
pub(super) enum ItemContent {
    Nothing,
    /// Drawables that were in the content above, in the item's frame.
    Inline(Vec<Leaf>),
    File {
        uri: Arc<str>,
        reader_data: Option<ReaderData>,
        item_from_content: DAffine3,
    },
}

/// When an item is refined. Lengths are metres of the item's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Refinement {
    /// By the error in pixels.
    Error { error_m: f64 },
    /// If the eye is nearer to a point.
    Nearer { center: DVec3, distance_m: f64 },
    /// From anywhere.
    Always,
}

/// The parts of a content.
#[derive(Debug, Default)]
pub(super) struct Split {
    /// The drawables of the content itself, in its own frame.
    pub leaves: Vec<Leaf>,
    pub items: Vec<Item>,
}

/// The place of a node.
#[derive(Clone, Copy)]
struct Place {
    set_from_model: DAffine3,
    model_from_node: DAffine3,
    /// The material of the state sets above.
    surface: Option<SurfaceMaterial>,
    /// The colour factor of the state sets above.
    color: [f32; 4],
}

/// Divides the nodes of contents.
pub(super) struct Splitter<'a> {
    /// The number of pixels that one metre covers at a distance of one metre, for ranges in pixels.
    pub px_per_radian: f64,
    pub notes: &'a Notes,
}

impl Splitter<'_> {
    /// Divides a content. Its items have names below `name`.
    pub fn split(&self, node: Node, set_from_model: DAffine3, name: &str, first: usize) -> Split {
        let mut split = Split::default();
        let place = Place { set_from_model, model_from_node: DAffine3::IDENTITY, surface: None, color: [1.0; 4] };
        self.add(node, place, &mut split);
        name_items(&mut split.items, name, first);
        split
    }

    fn add(&self, node: Node, above: Place, split: &mut Split) {
        if node.mask == 0 {
            self.notes.add("nodes that no camera sees");
            return;
        }
        if node.metadata.is_some() {
            self.notes.add("metadata of tiles and contents");
        }
        let mut place = above;
        if let Some(set) = &node.state_set {
            self.apply(set, &mut place);
        }
        let Node { kind, children, .. } = node;
        match kind {
            NodeKind::Group => {}
            NodeKind::Transform(map) => place.model_from_node *= map,
            NodeKind::Geode(drawables) => {
                drawables.into_iter().for_each(|drawable| self.add_drawable(drawable, DVec3::ZERO, place, split));
            }
            NodeKind::Billboard(billboard) => {
                self.notes.add("billboards (they do not turn)");
                for (position, drawable) in billboard.drawables {
                    self.add_drawable(drawable, position, place, split);
                }
            }
            NodeKind::PagedLod(tile) => return self.add_tile(*tile, children, place, split),
            NodeKind::ProxyNode(proxy) => self.add_proxy(*proxy, place, split),
            NodeKind::Switch(shown) => {
                for (child, shown) in children.into_iter().zip(shown.into_iter().chain(std::iter::repeat(false))) {
                    match shown {
                        true => self.add(child, place, split),
                        false => self.notes.add("children that a Switch hides"),
                    }
                }
                return;
            }
            NodeKind::Lod { center, ranges_m } => {
                let levels = ranges_m.into_iter().zip(children).collect();
                return self.add_lod(levels, |range| (center, range), place, split);
            }
            NodeKind::LodByPixelSize { center, radius_m, ranges_px } => {
                // A sphere of a diameter in pixels is nearer than one distance and farther than another.
                let distance_m = |size_px: f64| 2.0 * radius_m * self.px_per_radian / size_px.max(f64::MIN_POSITIVE);
                let levels = ranges_px.into_iter().zip(children).collect();
                let by_distance = |[min, max]: [f64; 2]| (center, [distance_m(max), distance_m(min)]);
                return self.add_lod(levels, by_distance, place, split);
            }
            // An empty tile above the contents of one tile.
            NodeKind::MultiContentTile(_) => {}
            NodeKind::AbsoluteTransform(_) | NodeKind::Projection(_) => {
                self.notes.add("nodes that move with the eye");
                return;
            }
            NodeKind::Camera(_) => {
                self.notes.add("cameras in the graph");
                return;
            }
            NodeKind::LightSource(_) | NodeKind::LocalLights(_) => self.notes.add("lights"),
            NodeKind::ClipNode(_) => self.notes.add("clip planes"),
            NodeKind::TexGenNode(_) => self.notes.add("generated texture coordinates"),
            NodeKind::ClearNode(_) => self.notes.add("ClearNode"),
            NodeKind::OccluderNode(_) => self.notes.add("OccluderNode"),
            NodeKind::OcclusionQueryNode(_) => self.notes.add("OcclusionQueryNode"),
        }
        children.into_iter().for_each(|child| self.add(child, place, split));
    }

    /// Takes from a state set what a material of glTF can hold.
    fn apply(&self, set: &StateSet, place: &mut Place) {
        if let Some(color) = set.color {
            place.color = std::array::from_fn(|i| place.color[i] * color[i]);
        }
        for (attribute, _) in &set.attributes {
            match attribute {
                Attribute::SurfaceMaterial(surface) => place.surface = Some(*surface),
                Attribute::SurfaceMaterials { front, .. } => {
                    self.notes.add("state: material of back faces");
                    place.surface = Some(*front);
                }
                // The materials of drawables have them.
                Attribute::CullFace(_) | Attribute::BlendFunc(_) | Attribute::AlphaFunc(_) => {}
                Attribute::Texture(..) | Attribute::TexEnv(..) | Attribute::TexGen(..) | Attribute::TexMat(..) => {
                    self.notes.add("state: texture units");
                }
                Attribute::Program(_) | Attribute::Custom(_) => self.notes.add("state: programs"),
                Attribute::Light(_) | Attribute::LightModel(_) | Attribute::Fog(_) => {
                    self.notes.add("state: lights and fog");
                }
                _ => self.notes.add("state: depth, stencil, colour mask and other attributes"),
            }
        }
    }

    fn add_drawable(&self, drawable: Drawable, position: DVec3, place: Place, split: &mut Split) {
        let mut place = place;
        if let Some(set) = &drawable.state_set {
            self.apply(set, &mut place);
        }
        let map = place.model_from_node * DAffine3::from_translation(position);
        let Some(mut leaf) = Leaf::new(map, drawable) else {
            return self.notes.add("geometry that an application draws");
        };
        if leaf.shape.is_empty() {
            return;
        }
        let mut factor = place.color;
        if let Some(surface) = place.surface {
            factor = std::array::from_fn(|i| factor[i] * surface.diffuse[i]);
            if surface.emission != [0.0; 3] && !leaf.material.unlit {
                leaf.material.metallic_roughness.get_or_insert_default().emissive = surface.emission;
            }
            if surface.specular != [0.0; 3] {
                self.notes.add("state: highlights of materials");
            }
        }
        let base = &mut leaf.material.base_color;
        *base = std::array::from_fn(|i| base[i] * factor[i]);
        split.leaves.push(leaf);
    }

    fn add_tile(&self, tile: PagedLod, children: Vec<Node>, place: Place, split: &mut Split) {
        let PagedLod { bounds, range_mode, refine, content, content_transform, reader_data, request_volume, .. } = tile;
        let content = match content {
            Some(uri) => ItemContent::File { uri, reader_data, item_from_content: content_transform },
            None => ItemContent::Nothing,
        };
        let set_from_item = place.set_from_model * place.model_from_node;
        let below = self.part(Node::group(children), place);
        split.items.push(Item {
            name: String::new(),
            content,
            set_from_item,
            bounds: Some(bounds).filter(|bounds| bounds.bounding_sphere().radius_m.is_finite()),
            request_volume,
            refine,
            refinement: self.refinement(range_mode),
            children: below.into_items(set_from_item),
        });
    }

    fn refinement(&self, mode: RangeMode) -> Refinement {
        match mode {
            RangeMode::ScreenSpaceError { geometric_error_m } if geometric_error_m >= ALWAYS_REFINED_M => {
                Refinement::Always
            }
            RangeMode::ScreenSpaceError { geometric_error_m } => Refinement::Error { error_m: geometric_error_m },
            RangeMode::Distance { range_m, .. } if range_m <= 0.0 => Refinement::Error { error_m: 0.0 },
            RangeMode::Distance { range_m, .. } if range_m >= ENDLESS => Refinement::Always,
            RangeMode::Distance { center, range_m } => Refinement::Nearer { center, distance_m: range_m },
            RangeMode::PixelSize { size_px, .. } if size_px >= ENDLESS => Refinement::Error { error_m: 0.0 },
            RangeMode::PixelSize { center, radius_m, size_px } if size_px > 0.0 => {
                Refinement::Nearer { center, distance_m: 2.0 * radius_m * self.px_per_radian / size_px }
            }
            RangeMode::PixelSize { .. } => Refinement::Always,
        }
    }

    fn add_proxy(&self, proxy: ProxyNode, place: Place, split: &mut Split) {
        let ProxyNode { uri, bounds, content_transform, .. } = proxy;
        split.items.push(Item {
            name: String::new(),
            content: ItemContent::File { uri, reader_data: None, item_from_content: content_transform },
            set_from_item: place.set_from_model * place.model_from_node,
            bounds: Some(BoundingVolume::Sphere(bounds)).filter(|_| is_known(&bounds)),
            request_volume: None,
            refine: Refine::Replace,
            refinement: Refinement::Error { error_m: 0.0 },
            children: Vec::new(),
        });
    }

    /// Divides what is below a node into parts in the frame of that node.
    fn part(&self, node: Node, place: Place) -> Split {
        let mut part = Split::default();
        let set_from_model = place.set_from_model * place.model_from_node;
        self.add(node, Place { set_from_model, model_from_node: DAffine3::IDENTITY, ..place }, &mut part);
        part
    }

    /// Adds levels of detail: each is replaced by the next finer one. `by_distance` returns the centre and the distances of a
    /// range.
    fn add_lod(
        &self,
        levels: Vec<([f64; 2], Node)>,
        by_distance: impl Fn([f64; 2]) -> (DVec3, [f64; 2]),
        place: Place,
        split: &mut Split,
    ) {
        let set_from_item = place.set_from_model * place.model_from_node;
        let levels = levels.into_iter().filter(|(range, _)| range[0] < range[1]);
        let mut levels: Vec<_> = levels.map(|(range, node)| (by_distance(range), node)).collect();
        // The finest first.
        levels.sort_by(|((_, a), _), ((_, b), _)| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let Some(((_, [nearest, _]), _)) = levels.first() else { return };
        if *nearest > NEAREST_M || levels.last().is_some_and(|((_, range), _)| range[1] < ENDLESS) {
            self.notes.add("levels of detail that nothing replaces nearby or far away");
        }
        // Children with the same range are one level.
        let mut merged: Vec<(DVec3, [f64; 2], Split)> = Vec::new();
        for ((center, range), node) in levels {
            let part = self.part(node, place);
            match merged.last_mut().filter(|(_, known, _)| *known == range) {
                Some((.., known)) => {
                    known.leaves.extend(part.leaves);
                    known.items.extend(part.items);
                }
                None => merged.push((center, range, part)),
            }
        }
        let mut below: Vec<Item> = Vec::new();
        let mut finer: Option<[f64; 2]> = None;
        for (center, range, part) in merged {
            below = match finer {
                None => part.into_items(set_from_item),
                Some(finer) => {
                    if !is_close(finer[1], range[0]) {
                        self.notes.add("levels of detail whose ranges overlap or leave a gap");
                    }
                    if !part.items.is_empty() {
                        self.notes.add("files in a level of detail that a finer one replaces");
                    }
                    vec![Item {
                        content: ItemContent::Inline(part.leaves),
                        refinement: Refinement::Nearer { center, distance_m: finer[1] },
                        children: below,
                        ..Item::empty(set_from_item)
                    }]
                }
            };
            finer = Some(range);
        }
        split.items.extend(below);
    }
}

impl Item {
    fn empty(set_from_item: DAffine3) -> Self {
        Self {
            name: String::new(),
            content: ItemContent::Nothing,
            set_from_item,
            bounds: None,
            request_volume: None,
            refine: Refine::Replace,
            refinement: Refinement::Error { error_m: 0.0 },
            children: Vec::new(),
        }
    }

    /// Returns an item that is the file with an URI.
    pub fn root(uri: Arc<str>) -> Self {
        let content = ItemContent::File { uri, reader_data: None, item_from_content: DAffine3::IDENTITY };
        Self { name: "0".to_owned(), content, ..Self::empty(DAffine3::IDENTITY) }
    }
}

impl Split {
    /// Returns all parts as items. `set_from_model` is the frame of the leaves.
    pub fn into_items(self, set_from_model: DAffine3) -> Vec<Item> {
        let Self { leaves, items } = self;
        let own =
            (!leaves.is_empty()).then(|| Item { content: ItemContent::Inline(leaves), ..Item::empty(set_from_model) });
        own.into_iter().chain(items).collect()
    }
}

/// Names items by their number, those below by the name of the item above and their number.
fn name_items(items: &mut [Item], above: &str, first: usize) {
    for (number, item) in (first..).zip(items) {
        item.name = format!("{above}/{number}");
        name_items(&mut item.children, &item.name, 0);
    }
}

fn is_known(sphere: &BoundingSphere) -> bool {
    sphere.radius_m.is_finite() && sphere.radius_m >= 0.0
}

fn is_close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-3 * a.abs().max(b.abs())
}
