//! [`SceneRegistry`]: the scenes that a pager serves, and the read scope of each. Update thread.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use super::read_scope::{ReadScope, SharedBlockFormats, TilesetAncestors};
use super::scene_set::SceneSet;
#[cfg(feature = "http")]
use crate::fetch::{HttpClient, HttpConfig};
use crate::formats::{ContentReader, IgnoredLog, OverlaySet, ReadOptions, Style, TileVolume};
use crate::math::Ellipsoid;
use crate::pager::config::PagerConfig;
use crate::scene::{NodeId, PageId, Scene, SceneNumber, SharedStateManager, SlotInfo};

/// A scene as the registry knows it.
#[derive(Debug)]
struct SceneState {
    scope: Arc<ReadScope>,
    /// The ancestors of the contents of its root pages.
    root_ancestors: TilesetAncestors,
}

impl SceneState {
    fn new(scope: ReadScope) -> Self {
        let ReadOptions { chain, set_from_content, ellipsoid, .. } = &scope.options;
        let root_ancestors =
            TilesetAncestors { chain: chain.clone(), set_from_page: *set_from_content, ellipsoid: *ellipsoid };
        Self { scope: Arc::new(scope), root_ancestors }
    }
}

/// The options that all scenes of a pager have in common.
#[derive(Debug)]
struct CommonOptions {
    limits: crate::fetch::Limits,
    build_kd_trees: bool,
    vertex_attributes: Arc<[Arc<str>]>,
    keep_features: bool,
    style: Option<Arc<Style>>,
    readers: Arc<[Arc<dyn ContentReader>]>,
    credits: Arc<[Arc<str>]>,
    overlays: Option<Arc<OverlaySet>>,
    sharing: Option<Arc<SharedStateManager>>,
    /// The properties that the contents of all scenes have and their readers leave out.
    ignored: IgnoredLog,
}

impl CommonOptions {
    /// Returns a scene's own options with the limits and the sharing of the pager.
    fn apply_to(&self, options: ReadOptions) -> ReadOptions {
        let vertex_attributes = match options.vertex_attributes.is_empty() {
            true => self.vertex_attributes.clone(),
            false => options.vertex_attributes.clone(),
        };
        let build_kd_trees = self.build_kd_trees || options.build_kd_trees;
        let sharing = self.sharing.clone();
        let ignored = self.ignored.clone();
        let keep_features = self.keep_features || options.keep_features;
        let style = options.style.or_else(|| self.style.clone());
        let readers = if options.readers.is_empty() { self.readers.clone() } else { options.readers.clone() };
        let credits = if options.credits.is_empty() { self.credits.clone() } else { options.credits.clone() };
        let overlays = options.overlays.or_else(|| self.overlays.clone());
        ReadOptions {
            limits: self.limits,
            build_kd_trees,
            vertex_attributes,
            keep_features,
            style,
            readers,
            credits,
            overlays,
            sharing,
            ignored,
            ..options
        }
    }
}

/// The scenes that a pager serves.
///
/// The pager is created with one read scope, the initial one. It belongs to the first scene that the pager is given and
/// that was not added with a separate scope.
#[derive(Debug)]
pub(in crate::pager) struct SceneRegistry {
    scenes: BTreeMap<SceneNumber, SceneState>,
    /// The state with the initial scope, until a scene claims it.
    unclaimed: Option<SceneState>,
    /// Scenes that are no longer served; they do not claim the initial scope.
    removed: BTreeSet<SceneNumber>,
    /// The scene that has claimed the initial scope.
    first: Option<SceneNumber>,
    common: CommonOptions,
    /// Shared by the scopes of all scenes.
    block_formats: Arc<SharedBlockFormats>,
    /// The client of the pager's own configuration.
    #[cfg(feature = "http")]
    client: HttpClient,
    /// The ancestors of the contents of merged pages that are tilesets.
    ancestors: HashMap<PageId, TilesetAncestors>,
}

impl SceneRegistry {
    /// Creates a registry with the initial scope that `options` describes.
    pub fn new(
        config: &PagerConfig,
        options: ReadOptions,
        sharing: Option<Arc<SharedStateManager>>,
        #[cfg(feature = "http")] client: HttpClient,
    ) -> Self {
        let common = CommonOptions {
            limits: config.limits,
            build_kd_trees: config.build_kd_trees,
            vertex_attributes: config.vertex_attributes.clone(),
            keep_features: config.keep_features,
            style: config.style.clone(),
            readers: config.content_readers.clone(),
            credits: config.credits.clone(),
            overlays: config.overlays.clone(),
            sharing,
            ignored: options.ignored.clone(),
        };
        let block_formats = Arc::<SharedBlockFormats>::default();
        let scope = ReadScope::new(
            common.apply_to(options),
            block_formats.clone(),
            #[cfg(feature = "http")]
            &client,
        );
        Self {
            scenes: BTreeMap::new(),
            unclaimed: Some(SceneState::new(scope)),
            removed: BTreeSet::new(),
            first: None,
            common,
            block_formats,
            #[cfg(feature = "http")]
            client,
            ancestors: HashMap::new(),
        }
    }

    /// Returns the manager of shared contents; `None` if nothing is shared.
    pub fn sharing(&self) -> Option<&Arc<SharedStateManager>> {
        self.common.sharing.as_ref()
    }

    /// Returns the compressed formats that contents are decoded to.
    pub fn block_formats(&self) -> &SharedBlockFormats {
        &self.block_formats
    }

    /// Returns the list of what contents ask for and their readers leave out.
    pub fn ignored(&self) -> &IgnoredLog {
        &self.common.ignored
    }

    /// Returns the client of the pager's own configuration.
    #[cfg(feature = "http")]
    pub fn own_client(&self) -> &HttpClient {
        &self.client
    }

    /// Returns the client of the initial scope or of a scene that is configured like `http`.
    #[cfg(feature = "http")]
    pub fn client_like(&self, http: &HttpConfig) -> Option<&HttpClient> {
        self.clients().find(|client| client.config() == http)
    }

    #[cfg(feature = "http")]
    fn clients(&self) -> impl Iterator<Item = &HttpClient> {
        let scenes = self.scenes.values().chain(&self.unclaimed);
        std::iter::once(&self.client).chain(scenes.map(|state| &state.scope.client))
    }

    /// Returns the numbers of the scenes that are served, in order.
    pub fn numbers(&self) -> impl ExactSizeIterator<Item = SceneNumber> + '_ {
        self.scenes.keys().copied()
    }

    /// Returns true if more than one scene is served.
    pub fn has_several(&self) -> bool {
        self.scenes.len() > 1
    }

    /// Serves a scene with separate options. Returns its scope, and the replaced one if the scene was served before.
    pub fn add(
        &mut self,
        scene: SceneNumber,
        options: ReadOptions,
        #[cfg(feature = "http")] client: HttpClient,
    ) -> (Arc<ReadScope>, Option<Arc<ReadScope>>) {
        let scope = ReadScope::new(
            self.common.apply_to(options),
            self.block_formats.clone(),
            #[cfg(feature = "http")]
            &client,
        );
        self.serve(scene, SceneState::new(scope))
    }

    fn serve(&mut self, scene: SceneNumber, state: SceneState) -> (Arc<ReadScope>, Option<Arc<ReadScope>>) {
        self.removed.remove(&scene);
        let scope = state.scope.clone();
        let replaced = self.scenes.insert(scene, state);
        (scope, replaced.map(|state| state.scope))
    }

    /// Gives the initial scope to a scene, if no other has claimed it. Returns the scope, and the replaced one if the scene
    /// was served before.
    pub fn claim(&mut self, scene: SceneNumber) -> Option<(Arc<ReadScope>, Option<Arc<ReadScope>>)> {
        let state = self.unclaimed.take()?;
        self.first = Some(scene);
        Some(self.serve(scene, state))
    }

    /// Returns the scene that should claim the initial scope: the first that was neither added nor removed.
    pub fn claimant(&self, scenes: &dyn SceneSet) -> Option<SceneNumber> {
        self.unclaimed.as_ref()?;
        let is_new = |number: &SceneNumber| !self.scenes.contains_key(number) && !self.removed.contains(number);
        scenes.all().map(Scene::number).find(is_new)
    }

    /// Returns the options of the initial scope, with the root's chain and ellipsoid, if no scene has claimed it.
    pub fn unclaimed_options(&self) -> Option<ReadOptions> {
        let SceneState { scope, root_ancestors } = self.unclaimed.as_ref()?;
        let TilesetAncestors { chain, ellipsoid, .. } = root_ancestors.clone();
        Some(ReadOptions { chain, ellipsoid, ..scope.options.clone() })
    }

    /// Stops serving a scene; returns its scope.
    pub fn remove(&mut self, scene: SceneNumber) -> Option<Arc<ReadScope>> {
        self.removed.insert(scene);
        self.scenes.remove(&scene).map(|state| state.scope)
    }

    /// Replaces the overlays of a scene for what is loaded from now on. Returns false if the scene is not served.
    pub fn set_overlays(&mut self, scene: SceneNumber, overlays: Option<Arc<OverlaySet>>) -> bool {
        let Some(state) = self.scenes.get_mut(&scene) else { return false };
        let scope = ReadScope::new(
            ReadOptions { overlays, ..state.scope.options.clone() },
            self.block_formats.clone(),
            #[cfg(feature = "http")]
            &state.scope.client,
        );
        state.scope = Arc::new(scope);
        true
    }

    /// Returns true if neither the pager nor a scene has a client configured like this one.
    #[cfg(feature = "http")]
    pub fn is_unused(&self, client: &HttpClient) -> bool {
        self.client_like(client.config()).is_none()
    }

    /// Returns the scope of a scene.
    pub fn scope(&self, scene: SceneNumber) -> Option<Arc<ReadScope>> {
        self.scenes.get(&scene).map(|state| state.scope.clone())
    }

    /// Returns the initial scope, claimed or not.
    pub fn initial_scope(&self) -> Option<Arc<ReadScope>> {
        let state = self.unclaimed.as_ref().or_else(|| self.scenes.get(&self.first?));
        state.map(|state| state.scope.clone())
    }

    /// Notes that `uri`, which lies on an ellipsoid, was read as the root of a scene, or of the initial scope if `scene` is
    /// `None`.
    pub fn note_root(&mut self, scene: Option<SceneNumber>, uri: &Arc<str>, ellipsoid: Ellipsoid) {
        let first = self.first;
        let state = match scene {
            Some(scene) => self.scenes.get_mut(&scene),
            None => self.unclaimed.as_mut().or_else(|| self.scenes.get_mut(&first?)),
        };
        if let Some(state) = state {
            state.root_ancestors.chain = state.scope.options.below(uri).chain;
            state.root_ancestors.ellipsoid = ellipsoid;
        }
    }

    /// Returns the ancestors and the scope for loading a slot's content; `None` if its scene is not served.
    pub fn origin(&self, slot: &SlotInfo<'_>) -> Option<(TilesetAncestors, Arc<ReadScope>)> {
        let state = self.scenes.get(&slot.page.scene)?;
        let mut ancestors = self.ancestors.get(&slot.page).unwrap_or(&state.root_ancestors).clone();
        if !ancestors.chain.is_empty() {
            ancestors.set_from_page *= slot.content_transform;
        }
        Some((ancestors, state.scope.clone()))
    }

    /// Returns the volume of a slot's tile in the frame of the whole set, if its scene has overlays.
    pub fn tile_volume(&self, scenes: &dyn SceneSet, slot: NodeId, scope: &ReadScope) -> Option<TileVolume> {
        scope.options.overlays.as_ref()?;
        let state = self.scenes.get(&slot.page.scene)?;
        let TilesetAncestors { chain, set_from_page, .. } =
            self.ancestors.get(&slot.page).unwrap_or(&state.root_ancestors);
        // The position on the earth of contents outside of a tileset is not known.
        if chain.is_empty() {
            return None;
        }
        let (in_page, geometric_error_m) = scenes.numbered(slot.page.scene)?.slot_volume(slot)?;
        Some(TileVolume { bounds: in_page.transformed(set_from_page), geometric_error_m })
    }

    /// Notes that a merged page is a tileset, whose contents have these ancestors.
    pub fn add_tileset(&mut self, id: PageId, ancestors: TilesetAncestors) {
        self.ancestors.insert(id, ancestors);
    }

    /// Forgets a page that left its scene; returns true if it was a tileset.
    pub fn forget_page(&mut self, id: PageId) -> bool {
        self.ancestors.remove(&id).is_some()
    }
}
