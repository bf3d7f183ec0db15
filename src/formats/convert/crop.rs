//! [`crop`]: the part of a set over a region, with the bytes of its contents. Tiles elsewhere are taken out of the tilesets;
//! all other files stay as they are, under their names. Threads share the list of files.

use std::collections::HashMap;
use std::path::{Component, Path};
use std::sync::{Arc, Mutex, PoisonError};

use glam::DAffine3;
use serde_json::{Map, Value};

use super::contents::write_file;
use super::report::{ConvertError, ConvertOptions, Converted};
use super::run::{convert, is_wanted, reason_for_nothing};
use crate::fetch::markup::text_and_first_byte;
use crate::fetch::{IoError, Loaded, RootScope, Source, is_remote, percent_decode, resolve, root_uri_within};
use crate::formats::embedded::is_data_uri;
use crate::formats::options::ReadOptions;
use crate::formats::tileset::{body_of, is_tileset, may_be_tileset, volume_and_frame};
use crate::formats::whole_set::{read_companions, too_many};
use crate::math::{Ellipsoid, WGS84};

/// Writes the part of a set over the region, or the rectangle, of the options to an empty folder. Contents are copied byte for
/// byte; those that gzip has compressed are decompressed. Sets with implicit tiling, those of other formats than 3D Tiles, and
/// those whose files lie in several places are converted instead, as are all with [`ConvertOptions::meshopt`]. Blocking;
/// `progress` is called on this thread.
///
/// # Errors
/// As [`convert`].
pub fn crop(
    source: &str,
    out: &Path,
    options: &ConvertOptions,
    progress: &mut dyn FnMut(&Converted),
) -> Result<Converted, ConvertError> {
    let root = root_uri_within(source, options.limits.file_timeout)?;
    let plan = if options.meshopt { None } else { Plan::of(&root, options)? };
    let Some(plan) = plan else { return convert(source, out, options, progress) };
    plan.write(&root, out, options, progress)
}

/// A file that is copied.
struct File {
    uri: Arc<str>,
    name: String,
    /// The number of contents above it; `None` for a file that contents or tilesets refer to.
    level: Option<usize>,
}

/// The reason why a set is not copied.
enum Refusal {
    /// It can be converted.
    NotCopied,
    Failed(IoError),
}

impl From<IoError> for Refusal {
    fn from(error: IoError) -> Self {
        Self::Failed(error)
    }
}

/// The tilesets of a part, and the files that they refer to.
struct Plan<'a> {
    options: &'a ConvertOptions,
    from: Source,
    scope: RootScope,
    root: Arc<str>,
    /// The ellipsoid of the root.
    ellipsoid: Ellipsoid,
    /// The JSON of each tileset with its name.
    tilesets: Vec<(String, Vec<u8>)>,
    files: Vec<File>,
    /// The files by name.
    known: HashMap<String, Arc<str>>,
    report: Converted,
    visited: u64,
}

/// The contents of a tile.
#[derive(Default)]
struct Found {
    /// True if a file, or a tileset with tiles over the region, is left.
    has_content: bool,
    had_tilesets: bool,
}

/// The tileset that is read.
struct At<'a> {
    /// The URI that references are relative to.
    base: &'a str,
    depth: usize,
}

impl<'a> Plan<'a> {
    /// Reads the tilesets of a set; `None` if it has to be converted.
    fn of(root: &Arc<str>, options: &'a ConvertOptions) -> Result<Option<Self>, ConvertError> {
        let from = source_of(root, options);
        let loaded = from.load(root)?;
        if !is_tileset(root, &loaded.bytes, &options.limits) {
            return Ok(None);
        }
        let base = loaded.location.clone().unwrap_or_else(|| root.clone());
        let mut plan = Self {
            options,
            from,
            scope: RootScope::of_set(root, &options.limits),
            root: base,
            ellipsoid: body_of(root, &loaded.bytes, &options.limits).map_or(WGS84, |body| body.ellipsoid()),
            tilesets: Vec::new(),
            files: Vec::new(),
            known: HashMap::new(),
            report: Converted::default(),
            visited: 0,
        };
        match plan.tileset(root, loaded, &DAffine3::IDENTITY, 0, 0) {
            Ok(true) => Ok(Some(plan)),
            Ok(false) => {
                let uri = crate::fetch::shown(root).into_owned();
                Err(ConvertError::Nothing { uri, reason: reason_for_nothing(options).to_owned() })
            }
            Err(Refusal::NotCopied) => Ok(None),
            Err(Refusal::Failed(error)) => Err(error.into()),
        }
    }

    /// Adds a tileset. Returns false if nothing of it is over the region.
    fn tileset(
        &mut self,
        uri: &Arc<str>,
        loaded: Loaded,
        set_from_parent: &DAffine3,
        level: usize,
        depth: usize,
    ) -> Result<bool, Refusal> {
        let limits = &self.options.limits;
        if depth > limits.max_external_depth {
            return Err(IoError::invalid(uri, "external tilesets are nested too deep").into());
        }
        let base = loaded.location.clone().unwrap_or_else(|| uri.clone());
        // The root has this name in every set.
        let name = if depth == 0 { "tileset.json".to_owned() } else { self.name(&base)? };
        // A tileset in several places would have other tiles in each.
        if self.known.insert(name.clone(), base.clone()).is_some() {
            return Err(Refusal::NotCopied);
        }
        let (text, _) = text_and_first_byte(&loaded.bytes);
        limits.check_json(uri, text)?;
        let mut json: Value = serde_json::from_slice(text).map_err(|e| IoError::invalid(uri, format!("JSON: {e}")))?;
        let mut tile = json["root"].take();
        if !self.tile(&mut tile, set_from_parent, level, &At { base: &base, depth })? {
            self.known.remove(&name);
            return Ok(false);
        }
        json["root"] = tile;
        self.companions(uri, &loaded.bytes)?;
        self.tilesets.push((name, json.to_string().into_bytes()));
        Ok(true)
    }

    /// Takes the tiles that are not over the region out of a tile. Returns false if nothing is left of it.
    fn tile(
        &mut self,
        tile: &mut Value,
        set_from_parent: &DAffine3,
        level: usize,
        at: &At<'_>,
    ) -> Result<bool, Refusal> {
        self.visited += 1;
        let limit = self.options.limits.max_elements as u64;
        if self.visited > limit {
            return Err(too_many(&self.root, limit).into());
        }
        if tile.get("implicitTiling").is_some() || tile.pointer("/extensions/3DTILES_implicit_tiling").is_some() {
            return Err(Refusal::NotCopied);
        }
        // Readers leave out a tile with an invalid volume, those of the new set too.
        let Ok((volume, set_from_tile)) = volume_and_frame(at.base, tile, set_from_parent, self.ellipsoid) else {
            return Ok(true);
        };
        if !is_wanted(self.options, &volume, &DAffine3::IDENTITY, &self.ellipsoid) {
            return Ok(false);
        }
        let imagery = tile.pointer("/extras/terrane/imagery").and_then(Value::as_str).map(str::to_owned);
        if let Some(uri) = imagery.map(|imagery| self.resolved(&imagery, at)).transpose()?.flatten() {
            self.add(uri, None)?;
        }
        let Some(tile) = tile.as_object_mut() else { return Ok(true) };
        let mut found = Found::default();
        self.contents(tile, &set_from_tile, level, at, &mut found)?;
        let extensions = tile.get_mut("extensions").and_then(Value::as_object_mut);
        if let Some(several) = extensions.and_then(|all| all.get_mut("3DTILES_multiple_contents")?.as_object_mut()) {
            self.contents(several, &set_from_tile, level, at, &mut found)?;
        }
        let level_below = level + usize::from(found.has_content);
        let children = match tile.remove("children") {
            Some(Value::Array(children)) => children,
            _ => Vec::new(),
        };
        let had_parts = found.had_tilesets || !children.is_empty();
        let mut kept = Vec::new();
        for mut child in children {
            if self.tile(&mut child, &set_from_tile, level_below, at)? {
                kept.push(child);
            }
        }
        let has_children = !kept.is_empty();
        if has_children {
            tile.insert("children".to_owned(), kept.into());
        }
        // A tile without anything may say from where something else is seen.
        Ok(found.has_content || has_children || !had_parts)
    }

    /// Adds the contents of a tile. Tilesets without a tile over the region are taken out.
    fn contents(
        &mut self,
        tile: &mut Map<String, Value>,
        set_from_tile: &DAffine3,
        level: usize,
        at: &At<'_>,
        found: &mut Found,
    ) -> Result<(), Refusal> {
        for property in ["content", "contents"] {
            let kept = match tile.remove(property) {
                None | Some(Value::Null) => continue,
                Some(Value::Array(list)) => {
                    let mut kept = Vec::new();
                    for content in list {
                        if self.content(&content, set_from_tile, level, at, found)? {
                            kept.push(content);
                        }
                    }
                    (!kept.is_empty()).then_some(Value::Array(kept))
                }
                Some(one) => self.content(&one, set_from_tile, level, at, found)?.then_some(one),
            };
            if let Some(kept) = kept {
                tile.insert(property.to_owned(), kept);
            }
        }
        Ok(())
    }

    /// Adds a content. Returns false for a tileset without a tile over the region.
    fn content(
        &mut self,
        content: &Value,
        set_from_tile: &DAffine3,
        level: usize,
        at: &At<'_>,
        found: &mut Found,
    ) -> Result<bool, Refusal> {
        let reference = ["uri", "url"].iter().find_map(|name| content.get(name)?.as_str());
        let uri = reference.map(|reference| self.resolved(reference, at)).transpose()?.flatten();
        if let Some(uri) = &uri
            && may_be_tileset(uri)
        {
            match self.from.load(uri) {
                Ok(loaded) if is_tileset(uri, &loaded.bytes, &self.options.limits) => {
                    found.had_tilesets = true;
                    let is_kept = match self.tileset(uri, loaded, set_from_tile, level, at.depth + 1) {
                        Err(Refusal::Failed(error)) => {
                            self.report.fail(&error);
                            true
                        }
                        read => read?,
                    };
                    found.has_content |= is_kept;
                    return Ok(is_kept);
                }
                // Reading it again would fail again.
                Err(error) => {
                    self.report.fail(&error);
                    found.has_content = true;
                    return Ok(true);
                }
                Ok(_) => {}
            }
        }
        uri.map_or(Ok(()), |uri| self.add(uri, Some(level)))?;
        found.has_content = true;
        Ok(true)
    }

    /// Returns the URI of a reference; `None` for data in the tileset itself, and for what no reader may read.
    fn resolved(&self, reference: &str, at: &At<'_>) -> Result<Option<Arc<str>>, Refusal> {
        if is_data_uri(reference) {
            return Ok(None);
        }
        let path = reference.split(['?', '#']).next().unwrap_or_default();
        let is_elsewhere = reference.starts_with('/') || is_remote(reference) || reference.contains("://");
        if is_elsewhere || path.to_ascii_lowercase().ends_with(".3tz") {
            return Err(Refusal::NotCopied);
        }
        Ok(resolve(at.base, reference, &self.scope).ok())
    }

    /// Returns the name of a file relative to the folder of the set.
    fn name(&self, uri: &str) -> Result<String, Refusal> {
        name_below(&self.root, uri).ok_or(Refusal::NotCopied)
    }

    /// Adds a file, unless it is known.
    fn add(&mut self, uri: Arc<str>, level: Option<usize>) -> Result<(), Refusal> {
        let name = self.name(&uri)?;
        match self.known.insert(name.clone(), uri.clone()) {
            None => self.files.push(File { uri, name, level }),
            // Another query has other bytes.
            Some(other) if other != uri => return Err(Refusal::NotCopied),
            Some(_) => {}
        }
        Ok(())
    }

    /// Adds the files that a tileset refers to.
    fn companions(&mut self, uri: &Arc<str>, bytes: &[u8]) -> Result<(), Refusal> {
        let mut options = ReadOptions::for_root(&self.root, self.options.limits);
        let files = read_companions(&self.from, uri, bytes, None, &mut options, &mut 0);
        files.into_iter().try_for_each(|(uri, _)| self.add(uri, None))
    }

    /// Writes the files and the tilesets, the root last.
    fn write(
        self,
        root: &Arc<str>,
        out: &Path,
        options: &ConvertOptions,
        progress: &mut dyn FnMut(&Converted),
    ) -> Result<Converted, ConvertError> {
        let Self { root: base, tilesets, files, known, report, .. } = self;
        let shared = Copying { base, out, options, known, files: Mutex::new(files), report: Mutex::new(report) };
        let threads = options.threads.or_else(|| std::thread::available_parallelism().ok().map(usize::from));
        std::thread::scope(|scope| {
            let mut workers = Vec::new();
            for number in 1..threads.unwrap_or(1).max(1) {
                let worker = std::thread::Builder::new().name(format!("crop {number}"));
                let worker = worker.spawn_scoped(scope, || shared.copy(root, &mut |_| ()));
                workers.push(worker.map_err(ConvertError::Thread)?);
            }
            let own = shared.copy(root, progress);
            let all = workers
                .into_iter()
                .map(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            all.fold(own, Result::and)
        })?;
        let mut report = shared.report.into_inner().unwrap_or_else(PoisonError::into_inner);
        for (name, text) in tilesets {
            write_file(&out.join(&name), &text)?;
            report.files += 1;
            report.bytes += text.len() as u64;
        }
        progress(&report);
        Ok(report)
    }
}

/// The files that are left to copy. Threads take from it.
struct Copying<'a> {
    base: Arc<str>,
    out: &'a Path,
    options: &'a ConvertOptions,
    /// The files that tilesets refer to, by name.
    known: HashMap<String, Arc<str>>,
    files: Mutex<Vec<File>>,
    report: Mutex<Converted>,
}

impl Copying<'_> {
    fn copy(&self, root: &Arc<str>, progress: &mut dyn FnMut(&Converted)) -> Result<(), ConvertError> {
        let from = source_of(root, self.options);
        loop {
            let next = self.files.lock().unwrap_or_else(PoisonError::into_inner).pop();
            let Some(file) = next else { return Ok(()) };
            let copied = match self.copy_one(&from, &file) {
                Ok(copied) => Ok(copied),
                Err(ConvertError::Source(error)) => Err(error),
                Err(error) => {
                    self.files.lock().unwrap_or_else(PoisonError::into_inner).clear();
                    return Err(error);
                }
            };
            let mut report = self.report.lock().unwrap_or_else(PoisonError::into_inner);
            match copied {
                Ok((files, bytes)) => {
                    report.files += files;
                    report.copied += files;
                    report.bytes += bytes;
                    if let Some(level) = file.level {
                        report.source.add_content(level);
                        report.written.add_content(level);
                    }
                }
                Err(error) => report.fail(&error),
            }
            let shown = report.clone();
            drop(report);
            progress(&shown);
        }
    }

    /// Copies a file, and those that it refers to. Returns their number and their bytes.
    fn copy_one(&self, from: &Source, file: &File) -> Result<(u64, u64), ConvertError> {
        let Loaded { bytes, location, .. } = from.load(&file.uri)?;
        write_file(&self.out.join(&file.name), &bytes)?;
        let (mut count, mut total) = (1, bytes.len() as u64);
        if file.level.is_none() {
            return Ok((count, total));
        }
        let mut options = ReadOptions { base: location, ..ReadOptions::for_root(&self.base, self.options.limits) };
        for (uri, read) in read_companions(from, &file.uri, &bytes, None, &mut options, &mut 0) {
            let outside = || IoError::unsupported(&uri, "a file of a tile outside of the folder of its set");
            let name = name_below(&self.base, &uri).ok_or_else(outside)?;
            if !self.known.contains_key(&name) {
                let bytes = read?;
                write_file(&self.out.join(&name), &bytes)?;
                count += 1;
                total += bytes.len() as u64;
            }
        }
        Ok((count, total))
    }
}

fn source_of(root: &str, options: &ConvertOptions) -> Source {
    let from = Source::new(options.limits, root);
    #[cfg(feature = "http")]
    let from = from.with_http(options.http.clone());
    from
}

/// Returns the name of a file relative to the folder of a set's root; `None` if it lies elsewhere.
fn name_below(root: &str, uri: &str) -> Option<String> {
    let end = |uri: &str| uri.find(['?', '#']).filter(|_| is_remote(uri)).unwrap_or(uri.len());
    let (root, path) = (&root[..end(root)], &uri[..end(uri)]);
    let folder = root.rfind('/').map_or("", |end| &root[..=end]);
    let name = path.strip_prefix(folder)?;
    let name = if is_remote(uri) { percent_decode(name)? } else { name.to_owned() };
    let is_plain = Path::new(&name).components().all(|part| matches!(part, Component::Normal(_)));
    (is_plain && !name.is_empty()).then_some(name)
}
