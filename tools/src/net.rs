//! Arguments for sources on servers: the cache on disk, credentials, certificates and the HTTP version.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context as _, Error, Result, ensure};
use clap::Args as ClapArgs;
use terrane::fetch::services::{GOOGLE_SERVER, ION_SERVER, IonAsset, ServiceKind, ServiceSource, google_tiles};
use terrane::fetch::{AllowedHost, CacheConfig, Credential, HttpConfig, Limits, is_http};
use terrane::formats::{OverlaySource, RasterOverlay};

use crate::default_set;

// More than 12 fields: one for each option.
#[derive(Clone, Debug, Default, ClapArgs)]
pub struct NetArgs {
    /// Cache responses of servers in this folder
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Maximum size of the cache, such as 500MB or 2GiB; the folder remembers it [default: 2GiB]
    #[arg(long, value_name = "SIZE")]
    pub cache_size: Option<ByteSize>,
    /// Send no requests and use only the cache [default folder: that of `terrane cache`]
    #[arg(long)]
    pub offline: bool,
    /// Header for the source's server, such as `Authorization: Bearer ...`; never printed
    #[arg(long, value_name = "NAME: VALUE")]
    pub header: Vec<Secret>,
    /// Query parameter for the source's server, such as `key=...`; never printed
    #[arg(long, value_name = "NAME=VALUE")]
    pub query: Vec<Secret>,
    /// Host that the source may refer to although its address is private, loopback or link-local; may be repeated
    #[arg(long, value_name = "HOST[:PORT]")]
    pub allow_host: Vec<AllowedHost>,
    /// Read files of a set on disk also if symbolic links lead to them out of the set's folder
    #[arg(long)]
    pub follow_links: bool,
    /// Let a set on disk refer to files outside of its folder and to servers
    #[arg(long)]
    pub allow_outside: bool,
    /// Memory that one content may take, and its files together, such as 4GiB [default: 1.5GiB]
    #[arg(long, value_name = "SIZE")]
    pub max_content: Option<ByteSize>,
    /// Access token for `ion:ASSET_ID`; never printed [default: environment variable CESIUM_ION_TOKEN]
    #[arg(long, value_name = "TOKEN")]
    pub ion_token: Option<Secret>,
    /// Server that speaks the protocol of Cesium ion
    #[arg(long, value_name = "URL", default_value = ION_SERVER)]
    pub ion_server: String,
    /// Key for `google`; never printed [default: environment variable GOOGLE_MAPS_API_KEY]
    #[arg(long, value_name = "KEY")]
    pub google_key: Option<Secret>,
    /// Server that speaks the protocol of Google's Photorealistic 3D Tiles
    #[arg(long, value_name = "URL", default_value = GOOGLE_SERVER)]
    pub google_server: String,
    /// PEM file of a certificate authority to trust in addition to those of the system
    #[arg(long, value_name = "FILE")]
    pub ca_file: Vec<PathBuf>,
    /// Use HTTP/2 without negotiation on unencrypted connections; encrypted ones negotiate the version
    #[arg(long)]
    pub http2: bool,
}

/// A source as it is loaded.
#[derive(Debug)]
pub struct Opened {
    /// Its path or URI.
    pub source: String,
    pub http: HttpConfig,
    /// The owners that its service names.
    pub attributions: Vec<String>,
    /// Its kind in its service, if it has one.
    pub kind: Option<ServiceKind>,
}

impl NetArgs {
    /// Returns where a source is and how it is asked for. Asks the service of `ion:ASSET_ID`.
    pub fn open(&self, source: &str) -> Result<Opened> {
        let opened = self.open_any(source)?;
        let is_imagery = opened.kind == Some(ServiceKind::Imagery);
        ensure!(!is_imagery, "{source}: an asset of imagery; --overlay drapes it over terrain");
        Ok(opened)
    }

    /// Like [`Self::open`], also for an asset of imagery: its document.
    pub fn open_any(&self, source: &str) -> Result<Opened> {
        let mut http = self.http(source)?;
        let Some(found) = self.service(source, &http)? else {
            return Ok(Opened { source: source.to_owned(), http, attributions: Vec::new(), kind: None });
        };
        http.credentials.extend(found.credentials);
        let source = match found.kind {
            ServiceKind::Imagery => in_folder(&found.uri, "tilemapresource.xml"),
            ServiceKind::Tiles | ServiceKind::Terrain => found.uri,
        };
        Ok(Opened { source, http, attributions: found.attributions, kind: Some(found.kind) })
    }

    /// Adds the credentials for an overlay `ion:ASSET_ID`. Returns the overlay as it is loaded.
    pub fn open_overlay(&self, overlay: &RasterOverlay, http: &mut HttpConfig) -> Result<RasterOverlay> {
        let mut overlay = overlay.clone();
        let Some(found) = self.service(overlay.address(), http)? else { return Ok(overlay) };
        ensure!(found.kind == ServiceKind::Imagery, "--overlay {}: an asset without imagery", overlay.address());
        http.credentials.extend(found.credentials);
        overlay.source = OverlaySource::Tms { document: in_folder(&found.uri, "tilemapresource.xml") };
        overlay.credit = overlay.credit.or_else(|| Some(found.attributions.join(", ").into()));
        Ok(overlay)
    }

    /// Asks a service where its data is; `None` for a source that is none of a service.
    fn service(&self, source: &str, http: &HttpConfig) -> Result<Option<ServiceSource>> {
        if source == "google" {
            let key = secret(self.google_key.as_ref(), "GOOGLE_MAPS_API_KEY");
            let key = key.context("google: needs --google-key or GOOGLE_MAPS_API_KEY")?;
            return Ok(Some(google_tiles(&self.google_server, &key)?));
        }
        let Some(id) = source.strip_prefix("ion:") else { return Ok(None) };
        let id = id.parse().with_context(|| format!("{source}: not the number of an asset of Cesium ion"))?;
        let token = secret(self.ion_token.as_ref(), "CESIUM_ION_TOKEN");
        let token = token.with_context(|| format!("{source}: needs --ion-token or CESIUM_ION_TOKEN"))?;
        Ok(Some(IonAsset { id, token, server: self.ion_server.clone() }.open(http)?))
    }

    /// Checks the credentials for a source. The error is without their text.
    pub fn check(&self, source: &str) -> Result<(), String> {
        if self.header.iter().any(|Secret(text)| !text.contains(':')) {
            return Err("--header needs NAME: VALUE, such as `Authorization: Bearer ...`".to_owned());
        }
        if self.query.iter().any(|Secret(text)| !text.contains('=')) {
            return Err("--query needs NAME=VALUE, such as `key=...`".to_owned());
        }
        match is_http(source) || self.header.is_empty() && self.query.is_empty() {
            true => Ok(()),
            false => Err("--header and --query need an http(s) URL as the source".to_owned()),
        }
    }

    /// Returns the HTTP configuration for a source.
    pub fn http(&self, source: &str) -> Result<HttpConfig> {
        self.check(source).map_err(Error::msg)?;
        let mut credentials = Vec::new();
        for (name, value) in self.header.iter().filter_map(|Secret(text)| text.split_once(':')) {
            credentials.push(Credential::header(source, name.trim(), value.trim())?);
        }
        for (name, value) in self.query.iter().filter_map(|Secret(text)| text.split_once('=')) {
            credentials.push(Credential::query(source, name, value)?);
        }
        Ok(HttpConfig {
            http2_only: self.http2,
            root_certificates: self.ca_file.clone(),
            credentials,
            allowed_hosts: self.allow_host.clone(),
            cache: self.cache()?,
            ..HttpConfig::default()
        })
    }

    /// Returns the limits for data from the source.
    pub fn limits(&self) -> Limits {
        let mut limits =
            Limits { follow_links: self.follow_links, allow_outside: self.allow_outside, ..Limits::default() };
        if let Some(ByteSize(bytes)) = self.max_content {
            limits.max_content_bytes = bytes;
        }
        limits
    }

    /// Returns the configuration of the cache, `None` if no option asks for one.
    fn cache(&self) -> Result<Option<CacheConfig>> {
        if self.cache.is_none() && self.cache_size.is_none() && !self.offline {
            return Ok(None);
        }
        let mut config = CacheConfig::new(folder(self.cache.clone())?);
        config.max_bytes = self.cache_size.map(|ByteSize(bytes)| bytes);
        config.offline = self.offline;
        Ok(Some(config))
    }
}

/// Returns the URL of a file in a folder, whose query it inherits.
fn in_folder(folder: &str, file: &str) -> String {
    let (path, query) = folder.split_once('?').map_or((folder, None), |(path, query)| (path, Some(query)));
    let query = query.map_or(String::new(), |query| format!("?{query}"));
    format!("{}/{file}{query}", path.trim_end_matches('/'))
}

/// Returns a secret of the command line, or of the environment.
fn secret(given: Option<&Secret>, variable: &str) -> Option<String> {
    given.map(|Secret(text)| text.clone()).or_else(|| std::env::var(variable).ok()).filter(|text| !text.is_empty())
}

/// Returns the folder of the cache: the given one, or the default in the user's cache folder.
pub fn folder(given: Option<PathBuf>) -> Result<PathBuf> {
    match given {
        Some(folder) => Ok(folder),
        None => {
            let user = default_set::cache_folder().context("no cache folder: set XDG_CACHE_HOME or HOME")?;
            Ok(user.join("terrane").join("http"))
        }
    }
}

/// A text that is left out of debug output.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

impl FromStr for Secret {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(Self(text.to_owned()))
    }
}

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("...")
    }
}

/// A number of bytes, written such as 500MB or 2GiB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ByteSize(pub u64);

impl FromStr for ByteSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
        let (number, unit) = text.split_at(end);
        let factor: f64 = match unit.trim().to_ascii_lowercase().as_str() {
            "" | "b" => 1.0,
            "kb" => 1e3,
            "mb" => 1e6,
            "gb" => 1e9,
            "tb" => 1e12,
            "kib" | "k" => 1024.0,
            "mib" | "m" => 1_048_576.0,
            "gib" | "g" => 1_073_741_824.0,
            "tib" | "t" => 1_099_511_627_776.0,
            _ => return Err("expected a size, such as 500MB or 2GiB".to_owned()),
        };
        match number.parse::<f64>() {
            Ok(n) if n * factor >= 1.0 && n * factor < 1e18 => Ok(Self((n * factor) as u64)),
            _ => Err("expected a size, such as 500MB or 2GiB".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_with_units_are_parsed() {
        for (text, bytes) in [("1", 1), ("500MB", 500_000_000), ("2GiB", 2 << 30), ("1.5 kib", 1536), ("64k", 65536)] {
            assert_eq!(text.parse(), Ok(ByteSize(bytes)), "{text}");
        }
        for bad in ["", "0", "-1", "GB", "1 parsec", "1e99", "1.2.3MB"] {
            assert!(bad.parse::<ByteSize>().is_err(), "{bad}");
        }
    }

    #[test]
    fn credentials_are_for_servers_and_never_printed() {
        let args = NetArgs { header: vec![Secret("X-Key: hidden".to_owned())], ..NetArgs::default() };
        let config = args.http("https://h/tileset.json").unwrap();
        assert_eq!(config.credentials.len(), 1);
        assert!(!format!("{args:?} {config:?}").contains("hidden"));
        let error = args.http("/data/set").unwrap_err();
        assert!(!format!("{error:#}").contains("hidden"));
        let odd = NetArgs { header: vec![Secret("hidden".to_owned())], ..NetArgs::default() };
        assert!(!format!("{:#}", odd.http("https://h/").unwrap_err()).contains("hidden"));
    }
}
