//! The states and kinds of a page's drawables, from which pipelines are prewarmed before the page is drawn. Main thread,
//! when a page has arrived.

use std::sync::Arc;

use super::geometry::{AlphaMode, AttributeLayout, Geometry, MetallicRoughness, Topology, VertexFormat};
use super::graph::Scene;
use super::id::{NONE, NodeId};
use super::pages::{BLEND, LIGHTS, Page, VIEW};
use crate::state::ResolvedState;

/// The maximum number of kinds listed for a page; pipelines of further kinds are compiled when they are drawn.
const MAX_KINDS: usize = 256;

/// A kind of drawable under a state: everything that its pipeline depends on.
#[derive(Clone, Debug)]
pub struct DrawKind {
    /// The resolved state of the state sets above.
    pub state: Arc<ResolvedState>,
    /// The topology of a mesh; `None` for height tiles and splats.
    pub topology: Option<Topology>,
    /// True for Gaussian splats.
    pub is_splats: bool,
    /// True if fragments with alpha below a cutoff are discarded.
    pub is_masked: bool,
    /// True if the material is double-sided.
    pub double_sided: bool,
    /// True if the material is drawn with the metallic-roughness model.
    pub has_surface: bool,
    /// True if that surface has a clear coat, or another reflection than a plain dielectric.
    pub is_layered: bool,
    /// True if the transform mirrors.
    pub mirrored: bool,
    /// True for a mesh of a few triangles without custom attributes.
    pub is_small: bool,
    /// The format of a mesh's vertices.
    pub vertex_format: VertexFormat,
    /// The custom attributes of a mesh's vertices.
    pub(crate) attributes: Arc<AttributeLayout>,
}

impl DrawKind {
    /// Returns true if all but the state are equal.
    fn is_like(&self, other: &Self) -> bool {
        let flags = |k: &Self| {
            let shape = (k.topology, k.is_splats, k.vertex_format);
            let surface = (k.has_surface, k.is_layered);
            (shape, surface, k.is_masked, k.double_sided, k.mirrored, k.is_small)
        };
        flags(self) == flags(other) && self.attributes == other.attributes
    }
}

impl Scene {
    /// Returns the kinds of drawables of a page that will be attached to a slot, or be a root; each once. The drawables must
    /// not have been taken.
    pub fn draw_kinds(&self, slot: Option<NodeId>, page: &Page) -> Vec<DrawKind> {
        let above = slot.map_or_else(Arc::default, |slot| self.state_above(slot));
        let world_from_page =
            slot.map_or(1.0, |slot| self.world_from_slot(slot).map_or(1.0, |map| map.matrix3.determinant()));
        let mut states = Resolving::new(page, above.clone());
        let mut met: Vec<(u32, DrawKind)> = Vec::new();
        for (drawable, of) in page.drawables().iter().zip(page.drawable_refs()) {
            let mesh = match &drawable.geometry {
                Geometry::Height(_) => None,
                Geometry::Mesh(mesh) => Some(mesh),
                Geometry::Splats(_) => None,
                // The application creates the pipelines of custom geometry.
                Geometry::Custom(_) => continue,
            };
            let linear = page.transforms().page_from_node(of.transform).matrix3;
            let kind = DrawKind {
                // The state is resolved below if the kind is new.
                state: above.clone(),
                topology: mesh.map(|mesh| mesh.topology),
                is_splats: matches!(drawable.geometry, Geometry::Splats(_)),
                is_masked: matches!(drawable.material.alpha, AlphaMode::Mask(_)),
                double_sided: drawable.material.double_sided,
                has_surface: drawable.material.surface().is_some(),
                is_layered: drawable.material.surface().is_some_and(MetallicRoughness::is_layered),
                mirrored: world_from_page * linear.determinant() < 0.0,
                is_small: mesh.is_some_and(|mesh| mesh.is_small()),
                vertex_format: drawable.vertex_format(),
                attributes: mesh.map_or_else(Arc::default, |mesh| mesh.attributes.layout().clone()),
            };
            if met.iter().rev().any(|(path, known)| *path == of.state_path && known.is_like(&kind)) {
                continue;
            }
            if met.len() >= MAX_KINDS {
                break;
            }
            met.push((of.state_path, DrawKind { state: states.at(of.state_path), ..kind }));
        }
        met.into_iter().map(|(_, kind)| kind).collect()
    }

    /// Resolves the state sets above the content of a slot, without those of cameras.
    fn state_above(&self, slot: NodeId) -> Arc<ResolvedState> {
        let mut slots = vec![slot];
        while let Some(above) = slots.last().and_then(|slot| self.slot_at(slot.page.slot)) {
            slots.push(above);
        }
        let mut state = Arc::default();
        for slot in slots.into_iter().rev() {
            let Some(page) = self.page(slot.page) else { continue };
            let tile = page.tile_of(slot.index).map(|tile| tile as u32);
            let path = tile.and_then(|tile| Some(page.tiles().state_path(tile, page.tiles().root_of(tile)?)));
            state = Resolving::new(page, state).at(path.unwrap_or(0));
        }
        state
    }
}

/// Resolves the state paths of a page on demand and caches the results.
struct Resolving<'a> {
    page: &'a Page,
    known: Vec<Option<Arc<ResolvedState>>>,
    root: Arc<ResolvedState>,
}

impl<'a> Resolving<'a> {
    fn new(page: &'a Page, root: Arc<ResolvedState>) -> Self {
        Self { page, known: vec![None; page.state_paths().len()], root }
    }

    fn at(&mut self, path: u32) -> Arc<ResolvedState> {
        // Walks up to the first path that is known, then resolves downwards.
        let mut below = Vec::new();
        let (mut at, mut state) = (path, self.root.clone());
        while at != 0 && at != NONE {
            if let Some(Some(known)) = self.known.get(at as usize) {
                state = known.clone();
                break;
            }
            let Some(link) = self.page.state_paths().get(at as usize) else { break };
            below.push((at, link.set));
            at = link.parent;
        }
        for (path, set) in below.into_iter().rev() {
            state = match self.page.state_sets().get(set as usize) {
                _ if set == BLEND => Arc::new(state.blended()),
                _ if set == VIEW => state,
                _ if set == LIGHTS => Arc::new(state.below_local_lights()),
                Some(set) => Arc::new(state.below(set)),
                None => state,
            };
            if let Some(known) = self.known.get_mut(path as usize) {
                *known = Some(state.clone());
            }
        }
        state
    }
}
