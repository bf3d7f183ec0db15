//! `terrane merge`: copies sets into one folder, under a root that refers to all of them.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args as ClapArgs;
use glam::DVec3;
use serde_json::{Value, json};
use terrane::fetch::{self, Limits};
use terrane::formats::{self, Body};
use terrane::math::{BoundingSphere, WGS84};
use terrane_data_gen::Progress;

use super::copying::copy_folder;
use super::out::Output;
use crate::values::shown_bytes;

/// The root is refined until the whole appears smaller than a pixel.
const ROOT_DIAMETERS: f64 = 16.0;

#[derive(Clone, Debug, ClapArgs)]
pub struct MergeArgs {
    /// Folder of the new set
    pub out: PathBuf,
    /// Folders of 3D Tiles sets, or their tileset.json; `terrane convert` makes them of other formats
    #[arg(required = true)]
    pub sources: Vec<PathBuf>,
    /// Replace the tile set in OUT
    #[arg(long)]
    pub overwrite: bool,
}

/// A set to be copied.
struct Part {
    folder: PathBuf,
    /// The name of the root in its folder.
    root: String,
    sphere: BoundingSphere,
    region: Option<[f64; 6]>,
    geometric_error: f64,
    /// `None` for a set that declares none, which is on the earth.
    body: Option<Body>,
}

pub fn merge(args: &MergeArgs) -> Result<()> {
    let output = Output::new(&args.out, args.overwrite)?;
    let limits = Limits::default();
    let parts = args.sources.iter().map(|source| Part::read(source, &limits)).collect::<Result<Vec<_>>>()?;
    check_bodies(&args.sources, &parts)?;
    output.check_sources(&args.sources)?;
    let progress = Progress::new("copying", 0, "files");
    let mut bytes = 0;
    output.write(|out| {
        for (number, part) in parts.iter().enumerate() {
            bytes += copy_folder(&part.folder, &out.join(number.to_string()), limits.file_timeout, &progress)?;
        }
        let root = out.join("tileset.json");
        std::fs::write(&root, tileset(&parts).to_string()).with_context(|| format!("{}", root.display()))
    })?;
    drop(progress);
    let line = format!("merged {} sets, {}: {}\n", parts.len(), shown_bytes(bytes), args.out.display());
    std::io::stdout().write_all(line.as_bytes()).context("stdout")
}

impl Part {
    fn read(source: &Path, limits: &Limits) -> Result<Self> {
        let shown = source.display().to_string();
        let path = source.to_str().with_context(|| format!("{shown}: the path is not UTF-8"))?;
        let uri = fetch::root_uri(path)?;
        // The reader names the field that is invalid.
        let info = formats::inspect(&uri, limits)?;
        let bytes = fetch::read_file(&uri, limits)?;
        let root = Path::new(&*uri);
        let json: Value = serde_json::from_slice(&bytes).unwrap_or_default();
        let folder = root.parent().unwrap_or(Path::new(".")).to_path_buf();
        let is_set = json.get("root").is_some() && folder.is_dir();
        ensure!(is_set, "{shown}: no 3D Tiles set in a folder; `terrane convert` makes one of it");
        let name = root.file_name().and_then(|name| name.to_str()).context("a file without a name")?;
        let sphere = BoundingSphere::new(DVec3::from_array(info.bounds.center), info.bounds.radius_m);
        let region = info.bounds.region.as_deref().and_then(|region| region.try_into().ok());
        let error_of = |value: &Value| value["geometricError"].as_f64();
        let geometric_error = error_of(&json).or_else(|| error_of(&json["root"])).unwrap_or(0.0);
        Ok(Self { folder, root: name.to_owned(), sphere, region, geometric_error, body: info.body })
    }

    fn volume(&self) -> Value {
        match self.region {
            Some(region) => json!({ "region": region }),
            None => sphere_json(&self.sphere),
        }
    }
}

/// Fails for sets of different bodies, which have no common coordinate system.
fn check_bodies(sources: &[PathBuf], parts: &[Part]) -> Result<()> {
    let ellipsoid = |part: &Part| part.body.as_ref().map_or(WGS84, Body::ellipsoid);
    let named = |part: &Part| part.body.as_ref().map_or("the earth".to_owned(), Body::to_string);
    let (Some(first), Some(first_source)) = (parts.first(), sources.first()) else { return Ok(()) };
    for (part, source) in parts.iter().zip(sources) {
        if ellipsoid(part) != ellipsoid(first) {
            let [a, b] = [first_source, source].map(|path| path.display());
            bail!("{a} and {b} are sets of different bodies: {} and {}", named(first), named(part));
        }
    }
    Ok(())
}

/// Returns the root over all parts.
fn tileset(parts: &[Part]) -> Value {
    let sphere = parts.iter().fold(BoundingSphere::EMPTY, |all, part| all.union(&part.sphere));
    let largest = parts.iter().map(|part| part.geometric_error).fold(0.0, f64::max);
    let error = (ROOT_DIAMETERS * 2.0 * sphere.radius_m).max(largest);
    let child = |(number, part): (usize, &Part)| {
        json!({
            "boundingVolume": part.volume(), "geometricError": part.geometric_error,
            "content": { "uri": format!("{number}/{}", part.root) },
        })
    };
    let children: Vec<Value> = parts.iter().enumerate().map(child).collect();
    let mut tileset = json!({
        "asset": { "version": "1.1", "generator": "terrane" },
        "geometricError": error,
        "root": {
            "boundingVolume": sphere_json(&sphere), "geometricError": error, "refine": "ADD", "children": children,
        },
    });
    if let Some(body) = parts.iter().find_map(|part| part.body.as_ref()) {
        body.declare_in(&mut tileset);
    }
    tileset
}

fn sphere_json(sphere: &BoundingSphere) -> Value {
    let [x, y, z] = sphere.center.to_array();
    json!({ "sphere": [x, y, z, sphere.radius_m] })
}
