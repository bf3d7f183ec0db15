//! Cesium ion: an endpoint per asset, which answers with the asset's address and a token for it that expires. Calls block.
//!
//! Source: the ion REST API, "Assets, endpoint". An asset that another service hosts (`externalType`) has its address in
//! `options`.

use std::sync::Arc;

use serde_json::Value;
use url::Url;

use super::{ServiceKind, ServiceSource};
use crate::fetch::http::{BlockingHttpClient, ExpiringToken};
use crate::fetch::markup::plain_text;
use crate::fetch::{Credential, HttpConfig, IoError, Limits, RootScope, shown};

/// The address of ion's API.
pub const ION_SERVER: &str = "https://api.cesium.com";

/// The maximum size of an endpoint's answer.
const MAX_ENDPOINT_BYTES: u64 = 1 << 20;
const MAX_ATTRIBUTIONS: usize = 64;

/// An asset of Cesium ion.
#[derive(Clone, PartialEq, Eq)]
pub struct IonAsset {
    /// Its number.
    pub id: u64,
    /// The user's access token. It never appears in errors, logs, cache files or debug output.
    pub token: String,
    /// [`ION_SERVER`], or a server that speaks the same protocol.
    pub server: String,
}

impl std::fmt::Debug for IonAsset {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("IonAsset").field("id", &self.id).field("server", &self.server).finish_non_exhaustive()
    }
}

impl IonAsset {
    /// Asks ion where the asset is. Blocks the calling thread. Requests with the credential that it returns renew their token
    /// when the asset's server refuses it.
    ///
    /// # Errors
    /// [`IoError::Status`] with 401 for an invalid token, [`IoError::NotFound`] for an unknown asset, and
    /// [`IoError::Unsupported`] for an asset of a kind that is not read.
    pub fn open(&self, http: &HttpConfig) -> Result<ServiceSource, IoError> {
        let path = format!("{}/v1/assets/{}/endpoint", self.server.trim_end_matches('/'), self.id);
        let bad = |e: url::ParseError| IoError::Uri { uri: shown(&path).into_owned(), reason: e.to_string() };
        let mut url = Url::parse(&path).map_err(bad)?;
        url.query_pairs_mut().append_pair("access_token", &self.token);
        let endpoint = String::from(url);
        // The answer changes with each token, and is for this user alone.
        let http = HttpConfig { cache: None, ..http.clone() };
        let limits = Limits { max_file_bytes: MAX_ENDPOINT_BYTES, ..Limits::default() };
        let client = BlockingHttpClient::new(&http, &RootScope::of(&endpoint))?;
        read_endpoint(&endpoint, &client.get(&endpoint, &limits)?.bytes)
    }
}

/// Reads the answer of an endpoint.
fn read_endpoint(endpoint: &str, answer: &[u8]) -> Result<ServiceSource, IoError> {
    Limits::default().check_json(endpoint, answer)?;
    let answer: Value = serde_json::from_slice(answer).map_err(|e| IoError::invalid(endpoint, e.to_string()))?;
    let text = |value: &Value, name: &str| value.get(name).and_then(Value::as_str).map(str::to_owned);
    let missing = |name: &str| IoError::invalid(endpoint, format!("the answer has no {name}"));
    let kind = match text(&answer, "type").ok_or_else(|| missing("type"))?.as_str() {
        "3DTILES" => ServiceKind::Tiles,
        "TERRAIN" => ServiceKind::Terrain,
        "IMAGERY" => ServiceKind::Imagery,
        other => return Err(IoError::unsupported(endpoint, format!("an asset of type {}", shortened(other)))),
    };
    let htmls = answer.get("attributions").and_then(Value::as_array).into_iter().flatten();
    let attributions: Vec<String> = htmls
        .filter_map(|attribution| text(attribution, "html"))
        .map(|html| plain_text(&html))
        .filter(|text| !text.is_empty())
        .take(MAX_ATTRIBUTIONS)
        .collect();
    if let Some(external) = text(&answer, "externalType") {
        if external != "3DTILES" {
            return Err(IoError::unsupported(endpoint, format!("an asset that {} hosts", shortened(&external))));
        }
        let options = answer.get("options").ok_or_else(|| missing("options"))?;
        let uri = text(options, "url").ok_or_else(|| missing("url"))?;
        return Ok(ServiceSource { kind, uri, credentials: Vec::new(), attributions });
    }
    let uri = text(&answer, "url").ok_or_else(|| missing("url"))?;
    let token = text(&answer, "accessToken").ok_or_else(|| missing("accessToken"))?;
    let token = ExpiringToken::new(endpoint.to_owned(), &token)?;
    let credentials = vec![Credential::expiring(&uri, Arc::new(token))?];
    let uri = if kind == ServiceKind::Terrain { layer_json(&uri)? } else { uri };
    Ok(ServiceSource { kind, uri, credentials, attributions })
}

/// Returns the address of the layer.json in a folder.
fn layer_json(folder: &str) -> Result<String, IoError> {
    let mut url =
        Url::parse(folder).map_err(|e| IoError::Uri { uri: shown(folder).into_owned(), reason: e.to_string() })?;
    if !url.path().ends_with("layer.json") {
        let path = format!("{}/layer.json", url.path().trim_end_matches('/'));
        url.set_path(&path);
    }
    Ok(url.into())
}

/// Returns the beginning of a text for an error.
fn shortened(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Reads any bytes as the answer of an endpoint. Entry point of the fuzz tests.
#[cfg(feature = "testing")]
pub fn fuzz_ion_endpoint(answer: &[u8]) {
    if let Ok(source) = read_endpoint("https://h/v1/assets/1/endpoint?access_token=secret", answer) {
        assert!(source.attributions.len() <= MAX_ATTRIBUTIONS);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Result<ServiceSource, IoError> {
        read_endpoint("https://h/v1/assets/1/endpoint?access_token=secret", json.as_bytes())
    }

    #[test]
    fn endpoints_name_address_kind_and_owners() {
        let tiles = read(
            r#"{"type":"3DTILES","url":"https://a/1/tileset.json?v=2","accessToken":"t",
                "attributions":[{"html":"<b>Survey</b> &copy;","collapsible":true},{"html":""},{}]}"#,
        );
        let tiles = tiles.unwrap();
        assert_eq!((tiles.kind, tiles.uri.as_str()), (ServiceKind::Tiles, "https://a/1/tileset.json?v=2"));
        assert_eq!((tiles.attributions, tiles.credentials.len()), (vec!["Survey ©".to_owned()], 1));
        let terrain = read(r#"{"type":"TERRAIN","url":"https://a/1/v1.2/?v=3","accessToken":"t"}"#).unwrap();
        assert_eq!((terrain.kind, terrain.uri.as_str()), (ServiceKind::Terrain, "https://a/1/v1.2/layer.json?v=3"));
        let hosted =
            read(r#"{"type":"3DTILES","externalType":"3DTILES","options":{"url":"https://g/root.json?key=k"}}"#);
        assert_eq!(hosted.unwrap().uri, "https://g/root.json?key=k");
    }

    #[test]
    fn other_answers_are_errors_without_the_token() {
        for (json, reason) in [
            ("", "EOF"),
            ("{}", "no type"),
            (r#"{"type":"GEOJSON"}"#, "type GEOJSON"),
            (r#"{"type":"3DTILES"}"#, "no url"),
            (r#"{"type":"3DTILES","url":"https://a/"}"#, "no accessToken"),
            (r#"{"type":"3DTILES","url":"https://a/","accessToken":"a\nb"}"#, "not valid in a header"),
            (r#"{"type":"3DTILES","url":"nowhere","accessToken":"a"}"#, "relative URL"),
            (r#"{"type":"IMAGERY","externalType":"BING","options":{}}"#, "BING hosts"),
        ] {
            let error = read(json).unwrap_err().to_string();
            assert!(error.contains(reason) && !error.contains("secret"), "{json}: {error}");
        }
    }
}
