//! Serving scenes: they are added and removed, and their roots are read. Update thread.

use std::sync::Arc;
use std::time::Duration;

use super::DatabasePager;
use crate::fetch::{self, IoError, Loaded};
#[cfg(feature = "http")]
use crate::fetch::{HttpClient, HttpConfig};
use crate::formats::{self, Content, ReadOptions};
use crate::pager::config::PagerError;
#[cfg(feature = "http")]
use crate::pager::requests::retry_policy::RetryPolicy;
use crate::pager::requests::retry_policy::RetryState;
use crate::pager::scenes::read_scope::ReadScope;
use crate::pager::upload::context::CompileContext;
use crate::scene::{Page, Scene, SceneNumber};

impl DatabasePager {
    /// Serves one more scene. `options` limits what its contents read; threads, budgets and shared contents belong to all
    /// scenes. A scene that was added before gets the new scope. Servers are asked with the pager's own HTTP configuration;
    /// see [`Self::add_scene_with_http`].
    pub fn add_scene(&mut self, scene: SceneNumber, options: ReadOptions) {
        #[cfg(feature = "http")]
        let client = self.scenes.own_client().clone();
        let scopes = self.scenes.add(
            scene,
            options,
            #[cfg(feature = "http")]
            client,
        );
        self.scope_changed(scene, scopes);
    }

    /// Serves one more scene as [`Self::add_scene`] does, with its own timeouts, certificates and credentials. No server
    /// sees those of another scene.
    ///
    /// # Errors
    /// [`PagerError::Http`] if the client cannot be created.
    #[cfg(feature = "http")]
    pub fn add_scene_with_http(
        &mut self,
        scene: SceneNumber,
        options: ReadOptions,
        http: &HttpConfig,
    ) -> Result<(), PagerError> {
        let client = match self.scenes.client_like(http) {
            Some(client) => client.clone(),
            None => {
                let client = HttpClient::new(http).map_err(PagerError::Http)?;
                if let Some(access) = self.threads.http() {
                    access.add_client(client.clone());
                }
                client
            }
        };
        let scopes = self.scenes.add(scene, options, client);
        self.scope_changed(scene, scopes);
        Ok(())
    }

    /// Continues a scene's requests in its new scope.
    fn scope_changed(&mut self, scene: SceneNumber, (new, replaced): (Arc<ReadScope>, Option<Arc<ReadScope>>)) {
        self.table.set_scope(scene, &new);
        self.scope_replaced(replaced);
    }

    /// Removes the client of a replaced scope once no scene has an equal one.
    fn scope_replaced(&self, replaced: Option<Arc<ReadScope>>) {
        #[cfg(feature = "http")]
        if let (Some(scope), Some(access)) = (&replaced, self.threads.http())
            && self.scenes.is_unused(&scope.client)
        {
            access.remove_client(&scope.client);
        }
        drop(replaced);
    }

    /// Gives the initial scope to this scene, if no scene has claimed it.
    pub(crate) fn claim(&mut self, scene: SceneNumber) {
        if let Some(scopes) = self.scenes.claim(scene) {
            self.scope_changed(scene, scopes);
        }
    }

    /// Serves a scene with the initial scope and the HTTP configuration of another pager that has served none.
    pub(crate) fn adopt(&mut self, scene: SceneNumber, other: Self) -> Result<(), PagerError> {
        let Some(options) = other.scenes.unclaimed_options() else { return Ok(()) };
        #[cfg(feature = "http")]
        self.add_scene_with_http(scene, options, &other.config.http)?;
        #[cfg(not(feature = "http"))]
        self.add_scene(scene, options);
        self.stats.bytes_read += other.stats.bytes_read;
        self.stats.bytes_http += other.stats.bytes_http;
        Ok(())
    }

    /// Returns the numbers of the scenes that are served, in order.
    pub fn scenes(&self) -> impl ExactSizeIterator<Item = SceneNumber> + '_ {
        self.scenes.numbers()
    }

    /// Stops serving a scene: detaches its pages and forgets its requests and its scope. Call this before the scene is
    /// dropped.
    pub fn remove_scene(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        self.clear(scene, contexts);
        let number = scene.number();
        self.forced.forget_scene(number);
        self.merge_order.forget_scene(number);
        let scope = self.scenes.remove(number);
        self.scope_replaced(scope);
    }

    /// Reads a root tileset, or a single content, in the initial scope. Blocks the calling thread.
    pub fn read_root(&mut self, uri: &Arc<str>) -> Result<Page, IoError> {
        let page = self.read_in(self.scenes.initial_scope(), uri)?;
        self.scenes.note_root(None, uri, page.ellipsoid());
        Ok(page)
    }

    /// Reads a root tileset, or a single content, in the scope of a scene that was added. Blocks the calling thread.
    pub fn read_root_of(&mut self, scene: SceneNumber, uri: &Arc<str>) -> Result<Page, IoError> {
        let page = self.read_in(self.scenes.scope(scene), uri)?;
        self.scenes.note_root(Some(scene), uri, page.ellipsoid());
        Ok(page)
    }

    fn read_in(&mut self, scope: Option<Arc<ReadScope>>, uri: &Arc<str>) -> Result<Page, IoError> {
        let not_served = || IoError::Uri { uri: uri.to_string(), reason: "its scene is not served".to_owned() };
        let scope = scope.ok_or_else(not_served)?;
        let mut retries = RetryState::default();
        loop {
            let Loaded { bytes, location, .. } = self.fetch(&scope, uri, uri)?;
            self.stats.bytes_read += bytes.len() as u64;
            let mut companions = Vec::new();
            // A root belongs to the application and shares nothing.
            let options = ReadOptions { sharing: None, base: location, ..scope.options.clone() };
            // It may be a single model with external buffers and images.
            for _ in 0..formats::MAX_DEPENDENCY_ROUNDS {
                let dependencies = formats::dependencies(uri, &bytes, None, &companions, &options);
                if dependencies.is_empty() {
                    break;
                }
                for dependency in dependencies {
                    let fetched = self.fetch(&scope, uri, &dependency).map(|loaded| loaded.bytes);
                    companions.push((dependency, fetched));
                }
            }
            let content = Content { uri: uri.clone(), bytes, reader_data: None, companions };
            let error = match formats::decode(content, &options) {
                Ok(page) => return Ok(page),
                Err(error) => error,
            };
            scope.forget_no_content(&error);
            match self.root_backoff(&mut retries, &error) {
                Some(backoff) => std::thread::sleep(backoff),
                None => return Err(error),
            }
        }
    }

    /// Returns the back-off before a root is read again whose bytes were invalid: as many attempts and the same back-off as
    /// the HTTP client has for a request without an answer.
    fn root_backoff(&self, _retries: &mut RetryState, _error: &IoError) -> Option<Duration> {
        #[cfg(feature = "http")]
        {
            let http = &self.config.http;
            let max_attempts = Some(http.max_retries.saturating_add(1));
            let policy = RetryPolicy { first_backoff: http.retry_backoff, max_attempts };
            _retries.fail(_error, policy).map(|backoff| backoff.min(http.max_wait))
        }
        #[cfg(not(feature = "http"))]
        None
    }

    /// Reads a root, or a file that it refers to.
    fn fetch(&mut self, scope: &ReadScope, root: &str, uri: &str) -> Result<Loaded, IoError> {
        #[cfg(feature = "http")]
        if let Some(http) = self.threads.http().filter(|_| fetch::is_remote(uri)) {
            let body = http.get(scope.client_of(uri), uri, &self.config.limits)?;
            self.stats.bytes_http += body.network_bytes;
            return Ok(body.into());
        }
        #[cfg(not(feature = "http"))]
        let _ = scope;
        fetch::Source::new(self.config.limits, root).load(uri)
    }
}

#[cfg(all(test, feature = "http"))]
mod tests {
    use super::*;
    use crate::fetch::Limits;
    use crate::pager::PagerConfig;

    /// Regression: clients were kept until the pager ended, with their connections and caches.
    #[test]
    fn client_is_removed_with_the_last_scene_that_uses_it() {
        let options = || ReadOptions::for_root("http://h/tileset.json", Limits::default());
        let mut pager = DatabasePager::new(PagerConfig::default(), options()).unwrap();
        let clients = |pager: &DatabasePager| pager.threads.http().unwrap().client_count();
        let own = PagerConfig::default().http;
        let other = HttpConfig { max_retries: own.max_retries + 1, ..own.clone() };
        let mut scenes: Vec<Scene> = (0..3).map(|_| Scene::new()).collect();
        for (scene, http) in scenes.iter().zip([&other, &other, &own]) {
            pager.add_scene_with_http(scene.number(), options(), http).unwrap();
        }
        assert_eq!(clients(&pager), 2, "equal configurations share a client");
        // The last scene gets another client, and the first one again.
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
        assert_eq!(left.collect::<Vec<_>>(), [2, 1, 1], "the pager's own client stays");
    }
}
