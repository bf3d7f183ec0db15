//! What an answer says about keeping it (RFC 9111). This is a private cache: `s-maxage` and `private` are not for it.

use std::time::{Duration, SystemTime};

use reqwest::header::{AGE, CACHE_CONTROL, DATE, EXPIRES, HeaderMap, HeaderName, PRAGMA, VARY};

/// Nothing is taken as fresh for longer.
const LONGEST: Duration = Duration::from_secs(365 * 24 * 3600);

/// Whether to keep an answer, and for how long it is taken without asking again. An answer that says nothing is kept
/// and asked for each time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Freshness {
    pub store: bool,
    /// `None` where the answer says nothing about it.
    pub fresh_for: Option<Duration>,
    /// No longer than this: the way to the answer holds for so long.
    pub most: Duration,
}

impl Freshness {
    pub fn of(headers: &HeaderMap, now: SystemTime) -> Self {
        let mut max_age: Option<Duration> = None;
        let (mut store, mut ask) = (true, false);
        let texts = |name: HeaderName| headers.get_all(name).into_iter().filter_map(|v| v.to_str().ok());
        for directive in texts(CACHE_CONTROL).flat_map(|text| text.split(',')) {
            let (name, value) = directive.split_once('=').unwrap_or((directive, ""));
            match name.trim().to_ascii_lowercase().as_str() {
                "no-store" => store = false,
                "no-cache" => ask = true,
                "max-age" => {
                    // What cannot be read is stale; of two the shorter holds.
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
            // What is no date is past.
            let expires = date(EXPIRES).unwrap_or(SystemTime::UNIX_EPOCH);
            Some(expires.duration_since(date(DATE).unwrap_or(now)).unwrap_or_default())
        });
        let age = texts(AGE).next().and_then(|text| text.trim().parse::<u32>().ok()).unwrap_or(0);
        let age = Duration::from_secs(age.into());
        let fresh_for = if ask { Some(Duration::ZERO) } else { lifetime.map(|l| l.saturating_sub(age).min(LONGEST)) };
        Self { store, fresh_for, most: LONGEST }
    }

    /// That of an answer behind a redirect: it holds no longer than the way to it does. A redirect that says nothing of
    /// itself holds for this time only, unless it is a permanent one.
    pub fn behind(self, status: u16, headers: &HeaderMap, now: SystemTime) -> Self {
        let hop = Self::of(headers, now);
        let is_permanent = matches!(status, 301 | 308);
        let way = hop.fresh_for.unwrap_or(if is_permanent { LONGEST } else { Duration::ZERO });
        let fresh_for = self.fresh_for.map(|own| own.min(way));
        Self { store: self.store && hop.store, fresh_for, most: self.most.min(way) }
    }

    /// For how long what is kept holds from now on, of which this answer says that it does: as before where it says
    /// nothing else.
    pub fn of_kept(self, before_s: u64) -> Duration {
        self.fresh_for.unwrap_or(Duration::from_secs(before_s)).min(self.most)
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
    fn what_servers_say() {
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
            (&[("Cache-Control", "max-age=4000000000")], (true, Some(LONGEST.as_secs()))),
            (&[("Cache-Control", "no-cache, max-age=60")], (true, Some(0))),
            (&[("Cache-Control", "no-store")], (false, None)),
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
    fn redirects_bound_what_is_behind_them() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000_000);
        let year = Freshness { store: true, fresh_for: Some(LONGEST), most: LONGEST };
        let silent = Freshness { fresh_for: None, ..year };
        let behind = |own: Freshness, status: u16, control: &'static str| {
            let told = (!control.is_empty()).then(|| (CACHE_CONTROL, HeaderValue::from_static(control)));
            let Freshness { store, fresh_for, .. } = own.behind(status, &told.into_iter().collect(), now);
            (store, fresh_for.map(|d| d.as_secs()))
        };
        assert_eq!(behind(year, 302, ""), (true, Some(0)));
        assert_eq!(behind(year, 307, "max-age=60"), (true, Some(60)));
        assert_eq!(behind(year, 301, ""), (true, Some(LONGEST.as_secs())));
        assert_eq!(behind(year, 308, "no-cache"), (true, Some(0)));
        assert_eq!(behind(year, 301, "no-store"), (false, Some(LONGEST.as_secs())));
        assert_eq!(behind(silent, 302, "max-age=60"), (true, None), "asked about each time");
        let kept_s = |own: Freshness, status: u16| own.behind(status, &HeaderMap::new(), now).of_kept(3600).as_secs();
        assert_eq!([kept_s(silent, 301), kept_s(silent, 302)], [3600, 0], "what was said before is bounded too");
        assert_eq!([silent.of_kept(3600), year.of_kept(3600)], [Duration::from_secs(3600), LONGEST]);
    }

    proptest::proptest! {
        /// Whatever servers say, it is understood in some way.
        #[test]
        fn odd_headers(control in "[ -~]{0,60}", expires in "[ -~]{0,40}", age in "[0-9]{0,25}") {
            let (_, fresh_for) = of(&[("Cache-Control", &control), ("Expires", &expires), ("Age", &age)]);
            proptest::prop_assert!(fresh_for.is_none_or(|s| s <= LONGEST.as_secs()));
        }
    }
}
