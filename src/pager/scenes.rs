//! The scenes that a pager fills, and what each of them may read. Update thread; a scope goes with its jobs to the threads.

use std::sync::Arc;
use std::time::Duration;

use super::DatabasePager;
use super::config::{CompileContext, PagerConfig, PagerError};
use super::job::Above;
use super::tries::Tries;
use crate::io::{self, Content, IoError, ReadOptions};
#[cfg(feature = "http")]
use crate::io::{HttpClient, HttpConfig};
use crate::scene::{NodeId, Page, Scene, SceneNumber, SharedStateManager, SlotInfo};

/// The scenes that a [`DatabasePager`] serves, all of them at each call: a [`Scene`] alone, or several in a vector or an
/// array.
pub trait Scenes {
    /// One after the other, in any order; `None` after the last.
    fn at(&self, place: usize) -> Option<&Scene>;
    /// The same, to be changed.
    fn at_mut(&mut self, place: usize) -> Option<&mut Scene>;
}

impl Scenes for Scene {
    fn at(&self, place: usize) -> Option<&Scene> {
        (place == 0).then_some(self)
    }

    fn at_mut(&mut self, place: usize) -> Option<&mut Scene> {
        (place == 0).then_some(self)
    }
}

impl<const N: usize> Scenes for [&mut Scene; N] {
    fn at(&self, place: usize) -> Option<&Scene> {
        self.get(place).map(|scene| &**scene)
    }

    fn at_mut(&mut self, place: usize) -> Option<&mut Scene> {
        self.get_mut(place).map(|scene| &mut **scene)
    }
}

impl Scenes for Vec<&mut Scene> {
    fn at(&self, place: usize) -> Option<&Scene> {
        self.get(place).map(|scene| &**scene)
    }

    fn at_mut(&mut self, place: usize) -> Option<&mut Scene> {
        self.get_mut(place).map(|scene| &mut **scene)
    }
}

impl dyn Scenes + '_ {
    /// All of them.
    pub(super) fn all(&self) -> impl Iterator<Item = &Scene> {
        (0..).map_while(|place| self.at(place))
    }

    /// The one with a number, of few.
    pub(super) fn numbered(&self, number: SceneNumber) -> Option<&Scene> {
        self.all().find(|scene| scene.number() == number)
    }

    pub(super) fn numbered_mut(&mut self, number: SceneNumber) -> Option<&mut Scene> {
        let place = self.all().position(|scene| scene.number() == number)?;
        self.at_mut(place)
    }

    /// A content slot of one of them.
    pub(super) fn slot(&self, id: NodeId) -> Option<SlotInfo<'_>> {
        self.numbered(id.page.scene)?.slot(id)
    }

    /// See [`Scene::set_failed`].
    pub(super) fn set_failed(&mut self, slot: NodeId, failed: bool) {
        if let Some(scene) = self.numbered_mut(slot.page.scene) {
            scene.set_failed(slot, failed);
        }
    }
}

/// What the contents of a scene may read, and as whom they ask servers.
#[derive(Debug)]
pub(super) struct Scope {
    pub options: ReadOptions,
    #[cfg(feature = "http")]
    pub client: HttpClient,
}

impl Scope {
    /// Nothing is to be kept of what turned out to be no content.
    pub fn forget(&self, uri: &str) {
        #[cfg(feature = "http")]
        if io::is_remote(uri) {
            self.client.forget(uri);
        }
        #[cfg(not(feature = "http"))]
        let _ = uri;
    }
}

/// What a scene's contents are read with, under the configuration of the pager that reads them.
pub(super) fn fitted(
    options: ReadOptions,
    config: &PagerConfig,
    sharing: Option<Arc<SharedStateManager>>,
) -> ReadOptions {
    let vertex_attributes = match options.vertex_attributes.is_empty() {
        true => config.vertex_attributes.clone(),
        false => options.vertex_attributes.clone(),
    };
    let build_kd_trees = config.build_kd_trees || options.build_kd_trees;
    ReadOptions { limits: config.limits, build_kd_trees, vertex_attributes, sharing, ..options }
}

/// A scene that is served.
#[derive(Debug)]
pub(super) struct Served {
    pub scope: Arc<Scope>,
    /// What is above the contents of its roots.
    pub above_roots: Above,
}

impl Served {
    pub fn new(scope: Scope) -> Self {
        let (chain, set_from_page) = (scope.options.chain.clone(), scope.options.set_from_content);
        Self { scope: Arc::new(scope), above_roots: Above { chain, set_from_page } }
    }
}

impl DatabasePager {
    /// Serves one more scene: what `options` lets its contents read is its own, threads, budgets and what is shared are
    /// all scenes'. One that was added before gets another scope. Servers are talked to as the pager's own configuration
    /// says; see [`Self::add_scene_with_http`].
    pub fn add_scene(&mut self, scene: SceneNumber, options: ReadOptions) {
        let scope = Scope {
            options: self.fit(options),
            #[cfg(feature = "http")]
            client: self.client.clone(),
        };
        self.serve(scene, Served::new(scope));
    }

    /// As [`Self::add_scene`], with timeouts, certificates and credentials of its own: those of other scenes are not
    /// shown to any server for it, nor its own for them.
    #[cfg(feature = "http")]
    pub fn add_scene_with_http(
        &mut self,
        scene: SceneNumber,
        options: ReadOptions,
        http: &HttpConfig,
    ) -> Result<(), PagerError> {
        let known = std::iter::once(&self.client).chain(self.served.values().map(|served| &served.scope.client));
        let client = match known.into_iter().find(|client| client.config() == http) {
            Some(client) => client.clone(),
            None => {
                let client = HttpClient::new(http).map_err(PagerError::Http)?;
                self.threads.list.lock().clients.push(client.clone());
                client
            }
        };
        let scope = Scope { options: self.fit(options), client };
        self.serve(scene, Served::new(scope));
        Ok(())
    }

    /// Limits are the pager's, and so is what is shared.
    fn fit(&self, options: ReadOptions) -> ReadOptions {
        fitted(options, &self.config, self.sharing.clone())
    }

    fn serve(&mut self, scene: SceneNumber, served: Served) {
        self.removed.remove(&scene);
        // What was asked for before goes on in the new scope.
        for entry in self.entries.values_mut().filter(|entry| entry.job.slot.page.scene == scene) {
            entry.job.scope = served.scope.clone();
        }
        let _replaced = self.served.insert(scene, served);
        #[cfg(feature = "http")]
        if let Some(replaced) = _replaced {
            self.let_go(&replaced.scope.client);
        }
        self.is_listed = false;
    }

    /// The scope that the pager was made with is this scene's.
    pub(crate) fn claim(&mut self, scene: SceneNumber) {
        if let Some(first) = self.unclaimed.take() {
            self.first = Some(scene);
            self.serve(scene, first);
        }
    }

    /// Serves a scene as another pager, which has served none, would have: with the scope that it was made with.
    pub(crate) fn adopt(&mut self, scene: SceneNumber, other: Self) -> Result<(), PagerError> {
        let Some(Served { scope, above_roots }) = &other.unclaimed else { return Ok(()) };
        let options = ReadOptions { chain: above_roots.chain.clone(), ..scope.options.clone() };
        #[cfg(feature = "http")]
        self.add_scene_with_http(scene, options, &other.config.http)?;
        #[cfg(not(feature = "http"))]
        self.add_scene(scene, options);
        self.stats.bytes_read += other.stats.bytes_read;
        self.stats.bytes_http += other.stats.bytes_http;
        Ok(())
    }

    /// Numbers of the scenes that are served, in order.
    pub fn scenes(&self) -> impl ExactSizeIterator<Item = SceneNumber> + '_ {
        self.served.keys().copied()
    }

    /// Serves a scene no more: takes its pages out and forgets its requests and its scope. To be called before the scene
    /// is dropped.
    pub fn remove_scene(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        self.clear(scene, contexts);
        let number = scene.number();
        self.asked.retain(|slot| slot.page.scene != number);
        self.turns.forget(number);
        self.merge_turns.forget(number);
        self.removed.insert(number);
        let _served = self.served.remove(&number);
        #[cfg(feature = "http")]
        if let Some(served) = _served {
            self.let_go(&served.scope.client);
        }
    }

    /// Keeps a client no longer than the last scene that asks as it does.
    #[cfg(feature = "http")]
    fn let_go(&mut self, client: &HttpClient) {
        let others = std::iter::once(&self.client).chain(self.served.values().map(|served| &served.scope.client));
        let unclaimed = self.unclaimed.iter().map(|served| &served.scope.client);
        let is_asked_with = |of: &HttpClient| of.config() == client.config();
        if !others.chain(unclaimed).any(is_asked_with) {
            self.threads.list.lock().clients.retain(|of| !is_asked_with(of));
            if let Some(door) = &self.threads.door {
                door.keep_what_came(client);
            }
        }
    }

    /// The first scene that was not added has the scope that the pager was made with.
    pub(super) fn claim_first(&mut self, scenes: &dyn Scenes) {
        if self.unclaimed.is_some()
            && let Some(first) = scenes
                .all()
                .map(Scene::number)
                .find(|number| !self.served.contains_key(number) && !self.removed.contains(number))
        {
            self.claim(first);
        }
    }

    /// Reads a root tileset (or a single content) on the calling thread, in the scope that the pager was made with.
    pub fn read_root(&mut self, uri: &Arc<str>) -> Result<Page, IoError> {
        let served = self.unclaimed.as_ref().or_else(|| self.served.get(&self.first?));
        let scope = served.map(|served| served.scope.clone());
        let page = self.read_in(scope.as_ref(), uri)?;
        let first = self.first;
        if let Some(served) = self.unclaimed.as_mut().or_else(|| self.served.get_mut(&first?)) {
            served.above_roots.chain = served.scope.options.below(uri).chain;
        }
        Ok(page)
    }

    /// The same in the scope of a scene that was added.
    pub fn read_root_of(&mut self, scene: SceneNumber, uri: &Arc<str>) -> Result<Page, IoError> {
        let scope = self.served.get(&scene).map(|served| served.scope.clone());
        let page = self.read_in(scope.as_ref(), uri)?;
        if let Some(served) = self.served.get_mut(&scene) {
            served.above_roots.chain = served.scope.options.below(uri).chain;
        }
        Ok(page)
    }

    fn read_in(&mut self, scope: Option<&Arc<Scope>>, uri: &Arc<str>) -> Result<Page, IoError> {
        let unserved = || IoError::Uri { uri: uri.to_string(), reason: "its scene is not served".to_owned() };
        let scope = scope.ok_or_else(unserved)?;
        let mut tries = Tries::default();
        loop {
            let bytes = self.fetch(scope, uri)?;
            self.stats.bytes_read += bytes.len() as u64;
            let content = Content { uri: uri.clone(), bytes, reader_data: None, companions: Vec::new() };
            // A root is the application's.
            let error = match io::decode(content, &ReadOptions { sharing: None, ..scope.options.clone() }) {
                Ok(page) => return Ok(page),
                Err(error) => error,
            };
            if error.is_no_content() {
                // An error page, say: no cache keeps it.
                scope.forget(uri);
            }
            match self.wait_for_root(&mut tries, &error) {
                Some(wait) => std::thread::sleep(wait),
                None => return Err(error),
            }
        }
    }

    /// How long to wait before a root is asked for once more whose bytes were not what they should be: with as many tries
    /// and such waits as an answer that does not come.
    fn wait_for_root(&self, _tries: &mut Tries, _error: &IoError) -> Option<Duration> {
        #[cfg(feature = "http")]
        {
            let http = &self.config.http;
            let most = http.max_retries.saturating_add(1);
            _tries.fail(_error, http.retry_backoff, Some(most)).map(|wait| wait.min(http.max_wait))
        }
        #[cfg(not(feature = "http"))]
        None
    }

    fn fetch(&mut self, scope: &Scope, uri: &str) -> Result<Vec<u8>, IoError> {
        #[cfg(feature = "http")]
        if let Some(door) = self.threads.door.as_ref().filter(|_| io::is_remote(uri)) {
            let body = door.get(&scope.client, uri, &self.config.limits)?;
            self.stats.bytes_http += body.network_bytes;
            return Ok(body.bytes);
        }
        #[cfg(not(feature = "http"))]
        let _ = scope;
        io::Source::new(self.config.limits).read(uri)
    }
}

#[cfg(all(test, feature = "http"))]
mod tests {
    use super::*;
    use crate::io::Limits;
    use crate::pager::PagerConfig;

    /// They were kept until the pager ended, with their connections and caches.
    #[test]
    fn clients_go_with_the_last_scene_that_asks_with_them() {
        let options = || ReadOptions::for_root("http://h/tileset.json", Limits::default());
        let mut pager = DatabasePager::new(PagerConfig::default(), options()).unwrap();
        let clients = |pager: &DatabasePager| pager.threads.list.lock().clients.len();
        let own = PagerConfig::default().http;
        let other = HttpConfig { max_retries: own.max_retries + 1, ..own.clone() };
        let mut scenes: Vec<Scene> = (0..3).map(|_| Scene::new()).collect();
        for (scene, http) in scenes.iter().zip([&other, &other, &own]) {
            pager.add_scene_with_http(scene.number(), options(), http).unwrap();
        }
        assert_eq!(clients(&pager), 2, "equal ones are one");
        // Added once more with another one, and back.
        let last = scenes[2].number();
        let third = HttpConfig { max_retries: own.max_retries + 2, ..own.clone() };
        for (http, count) in [(&third, 3), (&own, 2)] {
            pager.add_scene_with_http(last, options(), http).unwrap();
            assert_eq!(clients(&pager), count);
        }
        let left = scenes.iter_mut().map(|scene| {
            pager.remove_scene(scene, &mut []);
            clients(&pager)
        });
        assert_eq!(left.collect::<Vec<_>>(), [2, 1, 1], "the pager's own stays");
    }
}
