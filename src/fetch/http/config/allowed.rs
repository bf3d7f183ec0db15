//! [`AllowedHost`]: a host that requests may go to whatever its address is. Any thread.

use std::net::Ipv6Addr;
use std::str::FromStr;

use url::Url;

use crate::fetch::IoError;

/// Returns the host of an http(s) URL without the dot that may end a name; in brackets if it is an IPv6 address.
pub(in crate::fetch::http) fn host_of(url: &Url) -> &str {
    url.host_str().unwrap_or_default().trim_end_matches('.')
}

/// A host that tile sets may reach although its address is not public; see
/// [`HttpConfig::allowed_hosts`](crate::fetch::HttpConfig::allowed_hosts).
///
/// It is parsed from `HOST` or `HOST:PORT`, such as `tiles.intranet`, `10.0.0.5:8080` or `[fd00::5]:8080`. Without a port it
/// means all ports. It is compared with the host as a URL names it: a name does not allow the address behind it, nor an
/// address the names that lead to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AllowedHost {
    /// Has the form that [`host_of`] returns.
    host: String,
    port: Option<u16>,
}

impl AllowedHost {
    /// Returns true if this is the host of a URL.
    pub(in crate::fetch::http) fn matches(&self, url: &Url) -> bool {
        host_of(url) == self.host && self.port.is_none_or(|port| url.port_or_known_default() == Some(port))
    }
}

impl FromStr for AllowedHost {
    type Err = IoError;

    fn from_str(text: &str) -> Result<Self, IoError> {
        let bad = || IoError::Uri {
            uri: text.to_owned(),
            reason: "is not a host, expected HOST or HOST:PORT, such as tiles.intranet:8080".to_owned(),
        };
        if text.is_empty()
            || text.contains(|c: char| matches!(c, '/' | '\\' | '?' | '#' | '@' | '*') || c.is_whitespace())
        {
            return Err(bad());
        }
        let host = match text.parse::<Ipv6Addr>() {
            Ok(_) => format!("[{text}]"),
            Err(_) => text.to_owned(),
        };
        // A URL omits the default port of its scheme; that of the other scheme is then missing in one of the two only.
        let parse = |scheme: &str| Url::parse(&format!("{scheme}://{host}")).map_err(|_| bad());
        let (http, https) = (parse("http")?, parse("https")?);
        Ok(Self { host: host_of(&http).to_owned(), port: http.port().or(https.port()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_match_by_name_and_port() {
        let matches =
            |allowed: &str, url: &str| allowed.parse::<AllowedHost>().unwrap().matches(&Url::parse(url).unwrap());
        for (allowed, url) in [
            ("Tiles.Intranet", "http://tiles.intranet/x"),
            ("tiles.intranet", "https://tiles.intranet.:8443/x"),
            ("tiles.intranet:80", "http://tiles.intranet/x"),
            ("tiles.intranet:443", "https://tiles.intranet/x"),
            ("10.0.0.5:8080", "http://0xa.5:8080/"),
            ("::1", "http://[0::1]:9/"),
            ("[fd00::5]:8080", "http://[fd00::5]:8080/"),
            ("bücher.example", "http://xn--bcher-kva.example/"),
        ] {
            assert!(matches(allowed, url), "{allowed} {url}");
        }
        for (allowed, url) in [
            ("tiles.intranet", "http://a.tiles.intranet/"),
            ("tiles.intranet", "http://tiles.intranet@other/"),
            ("tiles.intranet:80", "https://tiles.intranet/"),
            ("10.0.0.5:8080", "http://10.0.0.5/"),
            ("10.0.0.5", "http://10.0.0.50/"),
        ] {
            assert!(!matches(allowed, url), "{allowed} {url}");
        }
    }

    #[test]
    fn other_texts_are_refused() {
        for text in ["", "http://h/", "h/x", "me@h", "h:x", "h:99999", "a b", "[::1", "*:80"] {
            assert!(text.parse::<AllowedHost>().is_err(), "{text}");
        }
    }
}
