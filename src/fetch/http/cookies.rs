//! [`Cookies`]: the cookies that servers set. HTTP thread.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

use cookie_store::{CookieStore, RawCookie};
use reqwest::header::HeaderValue;
use url::Url;

/// The maximum number of servers whose cookies are kept.
const MAX_SERVERS: usize = 64;
/// The maximum number of cookies of a server.
const MAX_COOKIES: usize = 50;
/// The maximum bytes of a `Set-Cookie` header.
const MAX_COOKIE_BYTES: usize = 4096;

/// The cookies of each server while a client exists. They are sent to the server (scheme, host and port) that set them and
/// to no other, whatever domain they name. Debug output has none of them.
#[derive(Default)]
pub(super) struct Cookies(Mutex<HashMap<String, CookieStore>>);

impl fmt::Debug for Cookies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cookies").finish_non_exhaustive()
    }
}

impl Cookies {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, CookieStore>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl reqwest::cookie::CookieStore for Cookies {
    fn set_cookies(&self, headers: &mut dyn Iterator<Item = &HeaderValue>, url: &Url) {
        let mut servers = self.lock();
        let origin = url.origin().ascii_serialization();
        if servers.len() >= MAX_SERVERS && !servers.contains_key(&origin) {
            return;
        }
        let store = servers.entry(origin).or_default();
        for header in headers.filter(|header| header.len() <= MAX_COOKIE_BYTES) {
            let Some(cookie) = header.to_str().ok().and_then(|text| RawCookie::parse(text.to_owned()).ok()) else {
                continue;
            };
            if store.iter_any().count() >= MAX_COOKIES {
                store.clear();
            }
            // Fails for a cookie that the server may not set, such as one of another domain.
            let _ = store.insert_raw(&cookie, url);
        }
    }

    fn cookies(&self, url: &Url) -> Option<HeaderValue> {
        let servers = self.lock();
        let store = servers.get(&url.origin().ascii_serialization())?;
        let pairs: Vec<String> = store.get_request_values(url).map(|(name, value)| format!("{name}={value}")).collect();
        if pairs.is_empty() {
            return None;
        }
        let mut value = HeaderValue::from_str(&pairs.join("; ")).ok()?;
        value.set_sensitive(true);
        Some(value)
    }
}

#[cfg(test)]
mod tests {
    use reqwest::cookie::CookieStore as _;

    use super::*;

    fn url(text: &str) -> Url {
        Url::parse(text).unwrap()
    }

    fn set(cookies: &Cookies, at: &str, cookie: &str) {
        cookies.set_cookies(&mut [HeaderValue::from_str(cookie).unwrap()].iter(), &url(at));
    }

    fn sent(cookies: &Cookies, to: &str) -> Option<String> {
        cookies.cookies(&url(to)).map(|value| value.to_str().unwrap().to_owned())
    }

    #[test]
    fn cookies_go_to_their_own_server() {
        let cookies = Cookies::default();
        set(&cookies, "https://a.example.org/set/tileset.json", "session=1; Domain=example.org; Path=/set");
        set(&cookies, "https://a.example.org/set/tileset.json", "stranger=1; Domain=other.org");
        assert_eq!(sent(&cookies, "https://a.example.org/set/0.glb").as_deref(), Some("session=1"));
        assert!(!format!("{cookies:?}").contains("session"));
        for other in
            ["https://a.example.org/", "https://b.example.org/set/0.glb", "https://a.example.org:444/set/0.glb"]
        {
            assert_eq!(sent(&cookies, other), None, "{other}");
        }
        set(&cookies, "https://a.example.org/set/1.glb", "session=2; Path=/set");
        set(&cookies, "https://a.example.org/set/1.glb", "session=; Domain=example.org; Path=/set; Max-Age=0");
        assert_eq!(sent(&cookies, "https://a.example.org/set/0.glb").as_deref(), Some("session=2"));
    }

    #[test]
    fn hostile_servers_cannot_fill_the_memory() {
        let cookies = Cookies::default();
        for i in 0..1000 {
            set(&cookies, "http://h/", &format!("c{i}=1"));
            set(&cookies, &format!("http://h{i}/"), "c=1");
        }
        set(&cookies, "http://h/", &format!("long={}", "x".repeat(MAX_COOKIE_BYTES)));
        let servers = cookies.lock();
        assert_eq!(servers.len(), MAX_SERVERS);
        assert!(servers.values().all(|store| store.iter_any().count() <= MAX_COOKIES));
        drop(servers);
        assert!(!sent(&cookies, "http://h/").unwrap().contains("long"));
    }
}
