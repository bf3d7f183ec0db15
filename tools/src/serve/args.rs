//! The options of `terrane serve`: what is served, where, and the faults that are injected.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use terrane::math::{Ellipsoid, WGS84};
use terrane_data_gen::{BodyArg, ContentKind, Tiling, World, WorldPreset};

use super::faults::Fault;
use crate::values::{amount, share};

// More than 16 fields: one for each option.
#[derive(Clone, Debug, ClapArgs)]
pub struct ServeArgs {
    /// Folder to serve; not with --procedural
    #[arg(required_unless_present = "procedural", conflicts_with = "procedural")]
    pub folder: Option<PathBuf>,
    /// Serve a planet of 22 levels from --seed instead of a folder. Its tiles are made when they are requested
    #[arg(long, value_enum, value_name = "PRESET")]
    pub procedural: Option<WorldPreset>,
    /// Body of the planet: earth, moon, mars, or radii in metres as EQUATORxPOLE or XxYxZ
    #[arg(long, conflicts_with = "folder")]
    pub body: Option<BodyArg>,
    /// Put trees and rocks on the planet
    #[arg(long, conflicts_with = "folder")]
    pub scatter: bool,
    /// Content of the planet's tiles: height or mesh
    #[arg(long, value_enum, default_value_t, conflicts_with = "folder")]
    pub content: ContentKind,
    /// Description of the planet's tile tree
    #[arg(long, value_enum, default_value_t, conflicts_with = "folder")]
    pub tiling: Tiling,
    /// Port; 0 selects a free one
    #[arg(long, default_value_t = 8080)]
    pub port: u16,
    /// Address to listen on
    #[arg(long, default_value = "127.0.0.1")]
    pub bind: String,
    /// Speak only HTTP/2; without --tls for clients that use it without negotiation
    #[arg(long)]
    pub http2: bool,
    /// Speak only HTTP/1.1; --tls alone offers both versions
    #[arg(long, conflicts_with = "http2")]
    pub http1: bool,
    /// Encrypt with a new certificate, which is written to FILE as PEM for clients to trust (--ca-file)
    #[arg(long, value_name = "FILE")]
    pub tls: Option<PathBuf>,
    /// Latency of every answer in milliseconds
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub latency_ms: f64,
    /// Maximum random addition to the latency in milliseconds
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub jitter_ms: f64,
    /// Bytes per second of each connection; 0 for no limit
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub bandwidth: f64,
    /// Share of answers with status 429, 500 or 503
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub error_rate: f64,
    /// Share of answers whose body ends early
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub truncate_rate: f64,
    /// Share of answers with changed bytes
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub corrupt_rate: f64,
    /// Share of answers that stop half way until the client closes the connection
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub stall_rate: f64,
    /// Share of answers replaced or cut half way by a reset of the connection; with HTTP/2 in half of the cases only the
    /// stream is reset
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub reset_rate: f64,
    /// Share of requests without any answer until the client closes the connection
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub silent_rate: f64,
    /// Share of answers that are a web page with status 200 instead
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub page_rate: f64,
    /// Seconds in the header `Retry-After` of failures
    #[arg(long, default_value_t = 0)]
    pub retry_after: u32,
    /// Seconds for which answers are fresh (`Cache-Control: max-age`) [default: no such header]
    #[arg(long, value_name = "SECONDS")]
    pub max_age: Option<u32>,
    /// Seed of --procedural, and of the faults, which are a function of seed, path, range and number of the request for them
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

impl ServeArgs {
    /// Returns the ellipsoid of the planet of --procedural.
    pub(super) fn ellipsoid(&self) -> Ellipsoid {
        self.body.map_or(WGS84, |body| body.0)
    }

    /// Checks combinations of arguments.
    pub fn check(&self) -> Result<(), String> {
        if self.content == ContentKind::QuantizedMesh {
            return Err("--content quantized-mesh is not supported with --procedural; height and mesh are".to_owned());
        }
        if !World::can_lie_on(&self.ellipsoid()) {
            return Err("--body: radii of worlds are 10 to 20,000 km".to_owned());
        }
        let all: f64 = self.rates().iter().map(|(rate, _)| rate).sum();
        if all <= 1.0 { Ok(()) } else { Err(format!("the rates are {all} together, more than 1")) }
    }

    /// Returns the share of answers for each fault.
    pub(super) fn rates(&self) -> [(f64, Fault); 7] {
        [
            (self.error_rate, Fault::Error),
            (self.truncate_rate, Fault::Truncated),
            (self.corrupt_rate, Fault::Corrupted),
            (self.stall_rate, Fault::Stalled),
            (self.reset_rate, Fault::Reset),
            (self.silent_rate, Fault::Silent),
            (self.page_rate, Fault::Page),
        ]
    }

    /// Returns the defaults for a folder, on a free port of the loopback address.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: Some(folder.into()),
            procedural: None,
            body: None,
            scatter: false,
            content: ContentKind::default(),
            tiling: Tiling::default(),
            port: 0,
            bind: "127.0.0.1".to_owned(),
            http2: false,
            http1: false,
            tls: None,
            latency_ms: 0.0,
            jitter_ms: 0.0,
            bandwidth: 0.0,
            error_rate: 0.0,
            truncate_rate: 0.0,
            corrupt_rate: 0.0,
            stall_rate: 0.0,
            reset_rate: 0.0,
            silent_rate: 0.0,
            page_rate: 0.0,
            retry_after: 0,
            max_age: None,
            seed: 1,
        }
    }
}
