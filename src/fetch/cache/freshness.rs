//! Whether and for how long an answer may be cached (RFC 9111). Several users and processes may share the folder, so answers
//! that are `private` are not stored. `s-maxage` is ignored: the folder does not stand between the user and the server. Plain
//! values.

use std::time::{Duration, SystemTime};

use reqwest::header::{AGE, CACHE_CONTROL, DATE, EXPIRES, HeaderMap, HeaderName, PRAGMA, VARY};

/// The longest time for which an answer counts as fresh.
const MAX_FRESH: Duration = Duration::from_secs(365 * 24 * 3600);

/// The cache directives of an answer. An answer without directives is stored and revalidated on each use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Freshness {
    /// True if the answer may be stored.
    pub store: bool,
    /// How long the answer may be used without revalidation; `None` without directives.
    pub fresh_for: Option<Duration>,
    /// An upper limit: how long the redirects that led to the answer are valid.
    pub max_fresh_for: Duration,
}

impl Freshness {
    /// Parses the headers of an answer that was received at `now`.
    pub fn of(headers: &HeaderMap, now: SystemTime) -> Self {
        let mut max_age: Option<Duration> = None;
        let (mut store, mut ask) = (true, false);
        let texts = |name: HeaderName| headers.get_all(name).into_iter().filter_map(|v| v.to_str().ok());
        for directive in texts(CACHE_CONTROL).flat_map(|text| text.split(',')) {
            let (name, value) = directive.split_once('=').unwrap_or((directive, ""));
            match name.trim().to_ascii_lowercase().as_str() {
                // With or without a list of header fields: an answer without some of its fields would help no one.
                "no-store" | "private" => store = false,
                "no-cache" => ask = true,
                "max-age" => {
                    // An invalid value means stale. Of two values the shorter applies.
                    let seconds = value.trim().trim_matches('"').parse::<u32>().unwrap_or(0);
                    let age = Duration::from_secs(seconds.into());
                    max_age = Some(max_age.map_or(age, |m| m.min(age)));
                }
                _ => {}
            }
        }
        if !headers.contains_key(CACHE_CONTROL) && texts(PRAGMA).any(|t| t.to_ascii_lowercase().contains("no-cache")) {
            ask = true;
        }
        if texts(VARY).any(|text| text.split(',').any(|name| name.trim() == "*")) {
            store = false;
        }
        let date = |name: HeaderName| texts(name).next().and_then(|text| httpdate::parse_http_date(text.trim()).ok());
        let lifetime = max_age.or_else(|| {
            headers.contains_key(EXPIRES).then_some(())?;
            // An invalid date lies in the past.
            let expires = date(EXPIRES).unwrap_or(SystemTime::UNIX_EPOCH);
            Some(expires.duration_since(date(DATE).unwrap_or(now)).unwrap_or_default())
        });
        let age = texts(AGE).next().and_then(|text| text.trim().parse::<u32>().ok()).unwrap_or(0);
        let age = Duration::from_secs(age.into());
        let fresh_for = if ask { Some(Duration::ZERO) } else { lifetime.map(|l| l.saturating_sub(age).min(MAX_FRESH)) };
        Self { store, fresh_for, max_fresh_for: MAX_FRESH }
    }

    /// Returns the freshness of an answer behind a redirect. It is fresh no longer than the redirect. A temporary redirect
    /// without directives is valid for this request only.
    pub fn behind_redirect(self, status: u16, headers: &HeaderMap, now: SystemTime) -> Self {
        let hop = Self::of(headers, now);
        let is_permanent = matches!(status, 301 | 308);
        let redirect = hop.fresh_for.unwrap_or(if is_permanent { MAX_FRESH } else { Duration::ZERO });
        let fresh_for = self.fresh_for.map(|own| own.min(redirect));
        Self { store: self.store && hop.store, fresh_for, max_fresh_for: self.max_fresh_for.min(redirect) }
    }

    /// Returns how long a cached body is fresh after this "not modified" answer: as long as before (`before_s` seconds), unless
    /// the answer has a directive.
    pub fn after_revalidation(self, before_s: u64) -> Duration {
        self.fresh_for.unwrap_or(Duration::from_secs(before_s)).min(self.max_fresh_for)
    }
}

#[cfg(test)]
mod tests {
    use reqwest::header::HeaderValue;

    use super::*;

    fn of(headers: &[(&str, &str)]) -> (bool, Option<u64>) {
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000_000);
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append(HeaderName::from_bytes(name.as_bytes()).unwrap(), HeaderValue::from_str(value).unwrap());
        }
        let Freshness { store, fresh_for, .. } = Freshness::of(&map, now);
        (store, fresh_for.map(|d| d.as_secs()))
    }

    #[test]
    fn directives_of_servers() {
        let expires = ("Expires", "Sun, 09 Sep 2001 01:56:40 GMT");
        for (headers, expected) in [
            (&[][..], (true, None)),
            (&[("Cache-Control", "max-age=60")], (true, Some(60))),
            (&[("Cache-Control", "Public, Max-Age=\"60\", immutable")], (true, Some(60))),
            (&[("Cache-Control", "max-age=60"), ("Cache-Control", "max-age=30")], (true, Some(30))),
            (&[("Cache-Control", "max-age=60"), ("Age", "20")], (true, Some(40))),
            (&[("Cache-Control", "max-age=60"), ("Age", "90")], (true, Some(0))),
            (&[("Cache-Control", "max-age=-1")], (true, Some(0))),
            (&[("Cache-Control", "max-age=99999999999")], (true, Some(0))),
            (&[("Cache-Control", "max-age=4000000000")], (true, Some(MAX_FRESH.as_secs()))),
            (&[("Cache-Control", "no-cache, max-age=60")], (true, Some(0))),
            (&[("Cache-Control", "no-store")], (false, None)),
            (&[("Cache-Control", "Private, max-age=60")], (false, Some(60))),
            (&[("Cache-Control", "private=\"x-user, x-name\"")], (false, None)),
            (&[("Pragma", "no-cache"), expires], (true, Some(0))),
            (&[expires], (true, Some(600))),
            (&[expires, ("Date", "Sun, 09 Sep 2001 01:55:40 GMT")], (true, Some(60))),
            (&[expires, ("Cache-Control", "max-age=5")], (true, Some(5))),
            (&[("Expires", "0")], (true, Some(0))),
            (&[("Vary", "Accept-Encoding, *"), ("Cache-Control", "max-age=60")], (false, Some(60))),
            (&[("Vary", "Accept-Encoding")], (true, None)),
        ] {
            assert_eq!(of(headers), expected, "{headers:?}");
        }
    }

    #[test]
    fn redirects_limit_the_freshness_behind_them() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000_000);
        let year = Freshness { store: true, fresh_for: Some(MAX_FRESH), max_fresh_for: MAX_FRESH };
        let silent = Freshness { fresh_for: None, ..year };
        let behind = |own: Freshness, status: u16, control: &'static str| {
            let header = (!control.is_empty()).then(|| (CACHE_CONTROL, HeaderValue::from_static(control)));
            let Freshness { store, fresh_for, .. } = own.behind_redirect(status, &header.into_iter().collect(), now);
            (store, fresh_for.map(|d| d.as_secs()))
        };
        assert_eq!(behind(year, 302, ""), (true, Some(0)));
        assert_eq!(behind(year, 307, "max-age=60"), (true, Some(60)));
        assert_eq!(behind(year, 301, ""), (true, Some(MAX_FRESH.as_secs())));
        assert_eq!(behind(year, 308, "no-cache"), (true, Some(0)));
        assert_eq!(behind(year, 301, "no-store"), (false, Some(MAX_FRESH.as_secs())));
        assert_eq!(behind(silent, 302, "max-age=60"), (true, None), "revalidated each time");
        let kept_s = |own: Freshness, status: u16| {
            own.behind_redirect(status, &HeaderMap::new(), now).after_revalidation(3600).as_secs()
        };
        assert_eq!([kept_s(silent, 301), kept_s(silent, 302)], [3600, 0], "the previous freshness is limited too");
        assert_eq!(
            [silent.after_revalidation(3600), year.after_revalidation(3600)],
            [Duration::from_secs(3600), MAX_FRESH]
        );
    }

    proptest::proptest! {
        /// Any header yields a freshness within the limit.
        #[test]
        fn odd_headers(control in "[ -~]{0,60}", expires in "[ -~]{0,40}", age in "[0-9]{0,25}") {
            let (_, fresh_for) = of(&[("Cache-Control", &control), ("Expires", &expires), ("Age", &age)]);
            proptest::prop_assert!(fresh_for.is_none_or(|s| s <= MAX_FRESH.as_secs()));
        }
    }
}
