//! `terrane info`: what a tile set holds, as text or JSON. Reads every tileset, but no tile's content.

use std::collections::BTreeSet;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use serde::Serialize;
use terrane::io::{self, Content, Limits, ReadOptions};
use terrane::math::BoundingVolume;
use terrane::scene::{Node, NodeKind};
use terrane::viewer::SetBounds;

use crate::args::InfoArgs;

/// Tilesets read; a set that names more is cut off and says so.
const MAX_TILESETS: usize = 10_000;

/// The JSON document.
#[derive(Serialize)]
struct Info {
    /// "3D Tiles", with "height" where the contents are heights on a shared grid.
    format: String,
    version: String,
    tiles: u64,
    contents: u64,
    levels: Vec<Level>,
    /// Bytes of the tilesets and of the contents that are local files.
    bytes: u64,
    extensions: BTreeSet<String>,
    bounds: Bounds,
    errors: Vec<Failure>,
}

#[derive(Clone, Default, Serialize)]
struct Level {
    level: u32,
    tiles: u64,
    contents: u64,
    bytes: u64,
}

#[derive(Serialize)]
struct Bounds {
    center: [f64; 3],
    radius_m: f64,
    /// West, south, east, north in degrees, lowest and highest height in metres.
    region_degrees: Option<[f64; 6]>,
    georeferenced: bool,
}

#[derive(Serialize)]
struct Failure {
    uri: String,
    reason: String,
}

/// What a tileset.json says about itself.
#[derive(Default, serde::Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Header {
    asset: Asset,
    extensions_used: Vec<String>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct Asset {
    version: String,
    extras: serde_json::Value,
}

pub fn run(args: &InfoArgs) -> Result<()> {
    let info = gather(&args.source)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&info)?);
    } else {
        print!("{}", text(&info));
    }
    Ok(())
}

struct Walk {
    options: ReadOptions,
    info: Info,
    /// External tilesets still to read, with the level of the tile that names them.
    todo: Vec<(Arc<str>, ReadOptions, u32)>,
}

fn gather(source: &str) -> Result<Info> {
    let uri = io::root_uri(source)?;
    let options = ReadOptions::for_root(&uri, Limits::default());
    let info = Info {
        format: "3D Tiles".to_owned(),
        version: String::new(),
        tiles: 0,
        contents: 0,
        levels: Vec::new(),
        bytes: 0,
        extensions: BTreeSet::new(),
        bounds: Bounds { center: [0.0; 3], radius_m: 0.0, region_degrees: None, georeferenced: false },
        errors: Vec::new(),
    };
    let mut walk = Walk { options: options.clone(), info, todo: Vec::new() };
    // The root must be readable; what it names need not.
    let root = walk.tileset(&uri, &options, 0)?;
    if let Some(volume) = root {
        let bounds = SetBounds::new(volume.bounding_sphere(), Some(volume));
        walk.info.bounds = Bounds {
            center: bounds.sphere.center.to_array(),
            radius_m: bounds.sphere.radius_m,
            region_degrees: match volume {
                BoundingVolume::Region(r) => {
                    let [west, south, east, north] = [r.west, r.south, r.east, r.north].map(f64::to_degrees);
                    Some([west, south, east, north, r.min_height_m, r.max_height_m])
                }
                _ => None,
            },
            georeferenced: bounds.frame.georeferenced,
        };
    }
    let mut read = 1;
    while let Some((uri, options, level)) = walk.todo.pop() {
        if read >= MAX_TILESETS {
            walk.fail(&uri, format!("not read: more than {MAX_TILESETS} tilesets"));
            break;
        }
        read += 1;
        if let Err(error) = walk.tileset(&uri, &options, level) {
            walk.fail(&uri, format!("{error:#}"));
        }
    }
    Ok(walk.info)
}

impl Walk {
    fn fail(&mut self, uri: &str, reason: String) {
        self.info.errors.push(Failure { uri: uri.to_owned(), reason });
    }

    /// Reads one tileset and counts what it holds; the volume of its root tile.
    fn tileset(&mut self, uri: &Arc<str>, options: &ReadOptions, level: u32) -> Result<Option<BoundingVolume>> {
        let bytes = read(uri, &self.options.limits)?;
        self.info.bytes += bytes.len() as u64;
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
        if let Ok(header) = serde_json::from_slice::<Header>(text) {
            if level == 0 {
                self.info.version = header.asset.version;
                if header.asset.extras.pointer("/terrane/content").is_some_and(|c| c == "height") {
                    self.info.format = "3D Tiles, height".to_owned();
                }
            }
            self.info.extensions.extend(header.extensions_used);
        }
        let content = Content { uri: Arc::clone(uri), bytes, reader_data: None, companions: Vec::new() };
        let node = io::decode_node(content, options)?;
        let below = options.below(uri);
        let volume = first_volume(&node);
        self.count(&node, &below, level);
        Ok(volume)
    }

    fn count(&mut self, node: &Node, below: &ReadOptions, level: u32) {
        let mut next = level;
        match &node.kind {
            NodeKind::PagedLod(tile) => {
                next += 1;
                self.info.tiles += 1;
                self.level(level).tiles += 1;
                if let Some(uri) = &tile.content {
                    let companions = io::companions(uri, tile.reader_data.as_ref());
                    let bytes = self.size_of(uri) + companions.iter().map(|c| self.size_of(c)).sum::<u64>();
                    self.info.contents += 1;
                    self.info.bytes += bytes;
                    let level = self.level(level);
                    level.contents += 1;
                    level.bytes += bytes;
                }
            }
            NodeKind::ProxyNode(proxy) => self.todo.push((Arc::clone(&proxy.uri), below.clone(), level)),
            _ => {}
        }
        for child in &node.children {
            self.count(child, below, next);
        }
    }

    fn level(&mut self, level: u32) -> &mut Level {
        let index = level as usize;
        while self.info.levels.len() <= index {
            let level = self.info.levels.len() as u32;
            self.info.levels.push(Level { level, ..Level::default() });
        }
        &mut self.info.levels[index]
    }

    /// Size of a local file; what is missing is an error, what is remote counts nothing.
    fn size_of(&mut self, uri: &str) -> u64 {
        if io::is_http(uri) {
            return 0;
        }
        match std::fs::metadata(uri) {
            Ok(data) => data.len(),
            Err(error) => {
                self.fail(uri, error.to_string());
                0
            }
        }
    }
}

fn first_volume(node: &Node) -> Option<BoundingVolume> {
    match &node.kind {
        NodeKind::PagedLod(tile) => Some(tile.bounds),
        _ => node.children.iter().find_map(first_volume),
    }
}

fn read(uri: &str, limits: &Limits) -> Result<Vec<u8>> {
    if !io::is_http(uri) {
        return Ok(io::read_file(uri, limits)?);
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("async runtime")?;
    let client = io::HttpClient::new(&io::HttpConfig::default())?;
    Ok(runtime.block_on(client.get(uri, limits))?)
}

fn text(info: &Info) -> String {
    use std::fmt::Write as _;
    let mebibytes = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(out, "format   {} {}", info.format, info.version);
    let _ = writeln!(out, "tiles    {}, {} with content", info.tiles, info.contents);
    let _ = writeln!(out, "size     {:.1} MiB", mebibytes(info.bytes));
    let b = &info.bounds;
    let [x, y, z] = b.center;
    let _ = writeln!(out, "bounds   {:.1} m around {x:.1}, {y:.1}, {z:.1}", b.radius_m);
    if let Some([west, south, east, north, low, high]) = b.region_degrees {
        let _ = writeln!(out, "         {south:.5} to {north:.5} N, {west:.5} to {east:.5} E, {low:.1} to {high:.1} m");
    }
    if !info.extensions.is_empty() {
        let names: Vec<&str> = info.extensions.iter().map(String::as_str).collect();
        let _ = writeln!(out, "uses     {}", names.join(", "));
    }
    for l in &info.levels {
        let (level, size) = (l.level, mebibytes(l.bytes));
        let _ = writeln!(out, "level {level:<2} {:>8} tiles {:>8} contents {size:>9.1} MiB", l.tiles, l.contents);
    }
    for e in &info.errors {
        let _ = writeln!(out, "error    {}: {}", e.uri, e.reason);
    }
    out
}
