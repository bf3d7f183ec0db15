//! `terrane info`: describes the content of a tile set, as text or JSON.

mod map;
mod measures;
mod services;

use std::fmt::Write as _;
use std::io::Write as _;

use anyhow::{Context as _, Result, ensure};
use serde_json::json;
use terrane::fetch::{self, printable};
use terrane::formats::{self, Info, MetadataInfo, ModelInfo, Problem, SurveyEvent, SurveyOptions, Verified};
use terrane_data_gen::Progress;

use self::map::{Map, Swatch};
use crate::args::InfoArgs;
use crate::net::Opened;
use crate::values::shown_bytes;

pub fn run(args: &InfoArgs) -> Result<()> {
    if services::is_template(&args.source) {
        return print(&services::of_template(args)?, args);
    }
    let opened = args.net.open_any(&args.source)?;
    // No one reads all of the earth.
    let inspect = if args.source == "google" { formats::inspect_root_with } else { formats::inspect_with };
    let mut info = inspect(&opened.source, &args.net.limits(), opened.http.clone())?;
    services::add_service(&mut info, &args.source, &opened);
    let mut map = args.map.as_ref().map(|file| (file, Map::new(args.map_of)));
    let surveyed = match args.verify || map.is_some() {
        true => {
            // A model may refer to any number of other files.
            let contents = if info.model.is_some() { 0 } else { info.contents };
            Some(survey(args, opened, contents, map.as_mut().map(|(_, map)| map))?)
        }
        false => None,
    };
    let map = map.map(|(file, map)| map.write(file).map(|drawn| (file, drawn))).transpose()?;
    let verified = surveyed.filter(|_| args.verify);
    if let Some(verified) = &verified {
        info.bounds.measure(&verified.levels);
    }
    let text = if args.json {
        let mut json = serde_json::to_value(&info)?;
        if let Some(verified) = &verified {
            json["verified"] = serde_json::to_value(verified)?;
        }
        if let Some((file, ([width, height], legend))) = &map {
            let colors = legend.iter().map(|Swatch { color, text }| json!({ "color": hex(*color), "text": text }));
            let colors: Vec<_> = colors.collect();
            json["map"] = json!({ "file": file, "size": [width, height], "legend": colors });
        }
        serde_json::to_string_pretty(&json)? + "\n"
    } else {
        let mut text = text(&info, verified.as_ref());
        if let Some((file, ([width, height], legend))) = &map {
            let colors = legend.iter().map(|Swatch { color, text }| format!("{text} {}", hex(*color)));
            let colors = colors.collect::<Vec<_>>().join(", ");
            let _ = writeln!(text, "map      {}, {width} x {height} pixels; colours: {colors}", file.display());
        }
        text
    };
    std::io::stdout().write_all(text.as_bytes()).context("stdout")?;
    let Verified { failed, problems, .. } = verified.unwrap_or_default();
    let shown = fetch::shown(&args.source);
    ensure!(failed == 0, "{shown}: {failed} could not be read");
    let wrong: u64 = problems.iter().map(|problem: &Problem| problem.count).sum();
    ensure!(wrong == 0, "{shown}: {wrong} problems");
    Ok(())
}

/// Prints a description of what has no tiles to read.
fn print(info: &Info, args: &InfoArgs) -> Result<()> {
    let text = if args.json { serde_json::to_string_pretty(info)? + "\n" } else { text(info, None) };
    std::io::stdout().write_all(text.as_bytes()).context("stdout")
}

fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Walks all tiles, and reads their contents with `--verify`.
fn survey(args: &InfoArgs, opened: Opened, contents: u64, mut map: Option<&mut Map>) -> Result<Verified> {
    let work = if args.verify { "verifying" } else { "listing" };
    let progress = Progress::new(work, contents, "contents");
    let options = SurveyOptions {
        reads_contents: args.verify,
        limits: args.net.limits(),
        http: opened.http,
        ..SurveyOptions::default()
    };
    let mut watch = |event: SurveyEvent<'_>| match event {
        SurveyEvent::Read(verified) => progress.set_done(verified.contents),
        SurveyEvent::Tile(tile) => map.iter_mut().for_each(|map| map.add(tile)),
    };
    Ok(formats::survey(&opened.source, &options, &mut watch)?)
}

fn text(info: &Info, verified: Option<&Verified>) -> String {
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(out, "{}", printable(format!("format   {} {}", info.format, info.version).trim_end()));
    match &info.model {
        Some(model) => {
            let ModelInfo { nodes, drawables, vertices, triangles, images, image_bytes, paged_files, .. } = model;
            let _ = writeln!(
                out,
                "model    {nodes} nodes, {drawables} drawables, {vertices} vertices, {triangles} triangles"
            );
            if model.splats > 0 {
                let _ = writeln!(out, "splats   {}, harmonics of degree {}", model.splats, model.splat_harmonics);
            }
            let _ = writeln!(out, "images   {images}, {} decoded", shown_bytes(*image_bytes));
            if *paged_files > 0 {
                let _ = writeln!(out, "paged    {paged_files} other files");
            }
        }
        None => {
            let _ = writeln!(out, "tiles    {}, {} contents", info.tiles, info.contents);
        }
    }
    if info.subtrees > 0 {
        let _ = writeln!(out, "implicit {} subtrees", info.subtrees);
    }
    let _ = writeln!(out, "size     {}", shown_bytes(info.bytes));
    if let Some(body) = &info.body {
        let _ = writeln!(out, "body     {body}");
    }
    let [x, y, z] = info.bounds.center;
    let _ = writeln!(out, "bounds   {:.1} m around {x:.1}, {y:.1}, {z:.1}", info.bounds.radius_m);
    if let Some([west, south, east, north, heights @ ..]) = info.bounds.region.as_deref() {
        let [west, south, east, north] = [west, south, east, north].map(|angle| angle.to_degrees());
        let heights = if let [low, high] = heights { format!(", {low:.1} to {high:.1} m") } else { String::new() };
        let _ = writeln!(out, "         {south:.5} to {north:.5} N, {west:.5} to {east:.5} E{heights}");
    }
    if !info.extensions.is_empty() {
        let names: Vec<&str> = info.extensions.iter().map(String::as_str).collect();
        let _ = writeln!(out, "uses     {}", names.join(", "));
    }
    for (name, detail) in &info.details {
        let _ = writeln!(out, "{name:<8} {detail}");
    }
    if let Some(attribution) = &info.attribution {
        let _ = writeln!(out, "credit   {attribution}");
    }
    if let Some(metadata) = &info.metadata {
        out.push_str(&metadata_text(metadata));
    }
    if info.tiles_with_metadata > 0 {
        let _ = writeln!(out, "metadata {} tiles have metadata", info.tiles_with_metadata);
    }
    for l in &info.levels {
        let (level, size) = (l.level, shown_bytes(l.bytes));
        let _ = writeln!(out, "level {level:<2} {:>8} tiles {:>8} contents {size:>13}", l.tiles, l.contents);
    }
    if let Some(Verified { contents, bytes, failed, .. }) = verified {
        let _ = writeln!(out, "verified {contents} contents, {}, {failed} failures", shown_bytes(*bytes));
    }
    verified.into_iter().for_each(|verified| out.push_str(&measures::text(verified)));
    // The verification counts what the tilesets ask for, too.
    for (kind, count) in verified.map_or(&info.ignored, |verified| &verified.ignored) {
        let _ = writeln!(out, "ignored  {kind}: {count}");
    }
    // Missing files are found both by the inspection and by the verification, but printed once.
    let broken = verified.iter().flat_map(|verified| &verified.errors);
    let broken = broken.filter(|e| !info.errors.iter().any(|known| known.uri == e.uri));
    for e in info.errors.iter().chain(broken) {
        let _ = writeln!(out, "error    {}: {}", e.uri, e.reason);
    }
    if let more @ 1.. = info.failed - info.errors.len() as u64 {
        let _ = writeln!(out, "         and {more} more");
    }
    out
}

/// The maximum number of groups that are listed.
const MAX_GROUPS: usize = 20;

/// Returns a line for the classes of a tileset, for its own metadata and for each group.
fn metadata_text(metadata: &MetadataInfo) -> String {
    let mut out = String::new();
    let classes = metadata.class_names();
    if !classes.is_empty() {
        let _ = writeln!(out, "metadata classes {}", printable(&classes.join(", ")));
    }
    let entities = metadata.tileset.iter().map(|tileset| ("tileset".to_owned(), tileset));
    let groups = metadata.groups().into_iter().map(|(name, group)| (format!("group {name}"), group));
    for (name, entity) in entities.chain(groups.take(MAX_GROUPS)) {
        let class = entity.get("class").and_then(|class| class.as_str()).unwrap_or("none");
        let mut line = format!("metadata {name}, class {class}");
        let properties = entity.get("properties").and_then(|properties| properties.as_object());
        for (name, value) in properties.into_iter().flatten() {
            let _ = write!(line, ", {name} = {value}");
        }
        let _ = writeln!(out, "{}", printable(&line));
    }
    if let more @ 1.. = metadata.group_count().saturating_sub(MAX_GROUPS) {
        let _ = writeln!(out, "metadata and {more} more groups");
    }
    out
}
