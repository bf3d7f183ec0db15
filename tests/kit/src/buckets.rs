//! A server that acts like S3: objects are written, also in parts, and read, listed and removed.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::sync::{Arc, Mutex, PoisonError};

use crate::server::{Reply, Request, Server};

/// An object, with what its writer said about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// The content.
    pub body: Vec<u8>,
    /// The header `Content-Type`.
    pub content_type: String,
    /// The header `Content-Encoding`.
    pub encoding: Option<String>,
}

/// A running store of buckets.
pub struct Buckets {
    /// The server, at `/bucket/key`.
    pub server: Server,
    objects: Objects,
}

/// The objects by `/bucket/key`. The parts of a file that is being written are objects with their number after the key.
type Objects = Arc<Mutex<BTreeMap<String, Object>>>;

impl Buckets {
    /// Starts a store. Requests for which `fault` has a reply get that one.
    pub fn start(fault: impl Fn(&Request) -> Option<Reply> + Send + Sync + 'static) -> Self {
        let objects = Objects::default();
        let held = objects.clone();
        let server = Server::start(move |request| {
            fault(request).unwrap_or_else(|| answer(request, &mut held.lock().unwrap_or_else(PoisonError::into_inner)))
        });
        Self { server, objects }
    }

    /// Returns all objects by `/bucket/key`.
    pub fn objects(&self) -> BTreeMap<String, Object> {
        self.objects.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the environment of a program that uses the store.
    pub fn environment(&self) -> [(&'static str, String); 5] {
        [
            ("AWS_ENDPOINT", self.server.url.clone()),
            ("AWS_ALLOW_HTTP", "true".to_owned()),
            ("AWS_ACCESS_KEY_ID", "AKIATEST".to_owned()),
            ("AWS_SECRET_ACCESS_KEY", "a-key-nobody-may-see".to_owned()),
            ("AWS_REGION", "eu-test-1".to_owned()),
        ]
    }
}

fn answer(request: &Request, objects: &mut BTreeMap<String, Object>) -> Reply {
    let query = request.target.split_once('?').map_or("", |(_, query)| query);
    let parameters: BTreeMap<String, String> = query
        .split('&')
        .map(|pair| pair.split_once('=').unwrap_or((pair, "")))
        .map(|(name, value)| (name.to_owned(), value.replace("%2F", "/")))
        .collect();
    let path = request.path().to_owned();
    let missing = || Reply::new(404, "<Error><Code>NoSuchKey</Code></Error>");
    match &*request.method {
        "PUT" => {
            let number = parameters.get("partNumber").and_then(|number| number.parse::<u32>().ok());
            let key = number.map_or(path.clone(), |number| format!("{path}?{number:05}"));
            let header = |name| request.header(name).map(str::to_owned);
            let object = Object {
                body: request.body.clone(),
                content_type: header("content-type").unwrap_or_default(),
                encoding: header("content-encoding"),
            };
            objects.insert(key, object);
            Reply::ok("").with("ETag", "\"1\"")
        }
        "POST" if parameters.contains_key("uploads") => {
            let header = |name| request.header(name).map(str::to_owned);
            let (content_type, encoding) = (header("content-type").unwrap_or_default(), header("content-encoding"));
            objects.insert(format!("{path}?00000"), Object { body: Vec::new(), content_type, encoding });
            let result = "InitiateMultipartUploadResult";
            Reply::ok(format!("<{result}><Bucket>b</Bucket><Key>k</Key><UploadId>7</UploadId></{result}>"))
        }
        "POST" if parameters.contains_key("uploadId") => {
            let parts = format!("{path}?");
            let names: Vec<String> = objects.keys().filter(|key| key.starts_with(&parts)).cloned().collect();
            let mut whole: Option<Object> = None;
            for part in names.iter().filter_map(|name| objects.remove(name)) {
                match &mut whole {
                    Some(whole) => whole.body.extend(part.body),
                    None => whole = Some(part),
                }
            }
            let Some(whole) = whole else { return missing() };
            objects.insert(path, whole);
            let result = "CompleteMultipartUploadResult";
            Reply::ok(format!("<{result}><ETag>\"1\"</ETag></{result}>"))
        }
        "DELETE" if parameters.contains_key("uploadId") => {
            let parts = format!("{path}?");
            objects.retain(|key, _| !key.starts_with(&parts));
            Reply::new(204, "")
        }
        "DELETE" => {
            objects.remove(&path);
            Reply::new(204, "")
        }
        "GET" if parameters.contains_key("list-type") => {
            let prefix = parameters.get("prefix").map_or("", String::as_str);
            list(&format!("{}/", path.trim_end_matches('/')), prefix, objects)
        }
        method => {
            let Some(object) = objects.get(&path) else { return missing() };
            let body = if method == "HEAD" { Vec::new() } else { object.body.clone() };
            Reply::ok(body).with("ETag", "\"1\"").with("Last-Modified", "Sun, 09 Sep 2001 01:46:40 GMT").ranged(request)
        }
    }
}

/// Lists the objects and folders directly below a prefix.
fn list(bucket: &str, prefix: &str, objects: &BTreeMap<String, Object>) -> Reply {
    let (mut folders, mut text) = (BTreeSet::new(), String::from("<ListBucketResult><IsTruncated>false</IsTruncated>"));
    for (key, object) in objects {
        let Some(name) = key.strip_prefix(bucket).filter(|key| key.starts_with(prefix)) else { continue };
        let rest = &name[prefix.len()..];
        match rest.split_once('/') {
            Some((folder, _)) => drop(folders.insert(format!("{prefix}{folder}/"))),
            None => {
                let size = object.body.len();
                let _ = write!(
                    text,
                    "<Contents><Key>{name}</Key><Size>{size}</Size><ETag>\"1\"</ETag>\
                     <LastModified>2001-09-09T01:46:40.000Z</LastModified></Contents>"
                );
            }
        }
    }
    for folder in folders {
        let _ = write!(text, "<CommonPrefixes><Prefix>{folder}</Prefix></CommonPrefixes>");
    }
    Reply::ok(text + "</ListBucketResult>")
}
