//! Parts of a set that are made by several processes or machines: the options, the plan, and the folders of shards.
//!
//! A shard has every block of the finest layer of its part. Its folder lies beside OUT and has a manifest with a hash of each
//! file. When all shards are there, their files are moved into one folder, in which the run then finds the blocks complete.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use terrane::math::random::fnv1a;

use crate::GenError;
use crate::output::write_whole;
use crate::pyramid::TileKey;

/// The manifest in a shard's folder.
pub(crate) const MANIFEST: &str = "shard.json";

/// The part of a set to make.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct Sharding {
    /// Print a plan of N shards as JSON, and make nothing
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SHARDS)))]
    pub plan: Option<u32>,
    /// Make one of N shards, I from 1 to N, beside OUT; --merge makes the set of them
    #[arg(long, value_name = "I/N", conflicts_with_all = ["plan", "merge"])]
    pub shard: Option<Shard>,
    /// Make the set of the shards beside OUT
    #[arg(long, conflicts_with = "plan")]
    pub merge: bool,
}

const MAX_SHARDS: u32 = 100_000;

/// The number of a shard, from 1, and the number of shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    number: u32,
    count: u32,
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
        match parts {
            Some((number, count)) if 1 <= number && number <= count && count <= MAX_SHARDS => {
                Ok(Self { number, count })
            }
            _ => Err(format!("expected I/N, with I from 1 to N and N at most {MAX_SHARDS}")),
        }
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

impl Shard {
    /// Returns the shard's part of blocks: all shards together have each block once, in order.
    pub fn part_of<'a>(&self, blocks: &'a [TileKey]) -> &'a [TileKey] {
        let end = |number: u32| (blocks.len() as u64 * u64::from(number) / u64::from(self.count)) as usize;
        &blocks[end(self.number - 1)..end(self.number)]
    }

    /// Returns the folder of the shard beside the folder of the set.
    pub fn folder(&self, out: &Path) -> PathBuf {
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        out.with_file_name(format!("{name}.shard-{}-of-{}", self.number, self.count))
    }

    /// Returns the shard that a folder beside a set is by its name; `None` for other folders.
    pub fn of_folder(set: &str, folder: &str) -> Option<Self> {
        let numbers = folder.strip_prefix(set)?.strip_prefix(".shard-")?;
        numbers.replacen("-of-", "/", 1).parse().ok()
    }

    /// Returns the shards whose folders lie beside the folder of a set, in order.
    fn beside(out: &Path) -> Result<Vec<Self>, GenError> {
        let name = out.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let parent = out.parent().unwrap_or(Path::new("."));
        let mut found = Vec::new();
        for entry in std::fs::read_dir(parent).map_err(GenError::file(parent))? {
            let entry = entry.map_err(GenError::file(parent))?.file_name().to_string_lossy().into_owned();
            found.extend(Self::of_folder(&name, &entry));
        }
        found.sort();
        Ok(found)
    }
}

/// Returns the plan of the shards of a set as JSON. `blocks` are the roots of the finest layer's blocks, `tiles` the number of
/// tiles of each at most. Those that are `complete` are marked.
pub(crate) fn plan(
    count: u32,
    fingerprint: u64,
    levels: u32,
    blocks: &[TileKey],
    tiles: u64,
    complete: &[Shard],
) -> String {
    let shards: Vec<Value> = (1..=count)
        .map(|number| {
            let shard = Shard { number, count };
            let part = shard.part_of(blocks);
            let roots: Vec<String> = part.iter().map(|root| format!("{}/{}/{}", root.level, root.x, root.y)).collect();
            let is_made = complete.contains(&shard);
            let tiles = tiles * part.len() as u64;
            json!({ "shard": shard.to_string(), "complete": is_made, "tilesAtMost": tiles, "subtrees": roots })
        })
        .collect();
    let plan = json!({ "fingerprint": format!("{fingerprint:016x}"), "levels": levels, "shards": shards });
    format!("{plan:#}")
}

/// Returns the shards of a plan whose folders beside OUT are complete and were made with the fingerprint.
pub(crate) fn complete(out: &Path, count: u32, fingerprint: u64) -> Vec<Shard> {
    let all = (1..=count).map(|number| Shard { number, count });
    all.filter(|shard| is_made(&shard.folder(out), fingerprint)).collect()
}

/// Writes the manifest of a shard: its files with their size and hash.
pub(crate) fn write_manifest(folder: &Path, shard: Shard, fingerprint: u64) -> Result<(), GenError> {
    let mut names = Vec::new();
    list(folder, "", &mut names)?;
    names.sort();
    let mut files = Vec::with_capacity(names.len());
    for name in names {
        let bytes = std::fs::read(folder.join(&name)).map_err(GenError::file(folder.join(&name)))?;
        files.push(json!([name, bytes.len(), format!("{:016x}", fnv1a(&bytes))]));
    }
    let fingerprint = format!("{fingerprint:016x}");
    let manifest =
        json!({ "shard": shard.to_string(), "fingerprint": fingerprint, "hash": "FNV-1a 64", "files": files });
    write_whole(&folder.join(MANIFEST), manifest.to_string().as_bytes()).map(|_| ())
}

/// Adds the names of the files below a folder, relative to the set's folder. The marker of the run is not part of the set.
fn list(folder: &Path, prefix: &str, names: &mut Vec<String>) -> Result<(), GenError> {
    for entry in std::fs::read_dir(folder).map_err(GenError::file(folder))? {
        let entry = entry.map_err(GenError::file(folder))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.path().is_dir() {
            list(&entry.path(), &format!("{prefix}{name}/"), names)?;
        } else if !(prefix.is_empty() && (name == crate::output::MARKER || name == MANIFEST)) {
            names.push(format!("{prefix}{name}"));
        }
    }
    Ok(())
}

/// The manifest of a shard: its fingerprint and files.
pub(crate) struct Manifest {
    fingerprint: String,
    /// The name of each file, its size in bytes and its hash.
    files: Vec<(String, u64, String)>,
}

impl Manifest {
    pub fn read(folder: &Path) -> Result<Self, GenError> {
        let path = folder.join(MANIFEST);
        let bytes = std::fs::read(&path).map_err(GenError::file(&path))?;
        Self::parse(&path, &bytes)
    }

    /// Reads the JSON of the manifest at a path.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, GenError> {
        let parse = || {
            let json: Value = serde_json::from_slice(bytes).ok()?;
            let files = json["files"].as_array()?.iter().map(|file| {
                let name = file[0].as_str()?;
                // Names lead nowhere else.
                let is_plain = Path::new(name).components().all(|part| matches!(part, std::path::Component::Normal(_)));
                is_plain.then_some((name.to_owned(), file[1].as_u64()?, file[2].as_str()?.to_owned()))
            });
            Some(Self { fingerprint: json["fingerprint"].as_str()?.to_owned(), files: files.collect::<Option<_>>()? })
        };
        parse().ok_or_else(|| GenError::invalid(path, "is no manifest of a shard"))
    }

    /// Returns true if the shard was made with a fingerprint.
    pub fn is_of(&self, fingerprint: u64) -> bool {
        self.fingerprint == format!("{fingerprint:016x}")
    }

    /// Returns the names of the files.
    #[cfg(feature = "object-store")]
    pub fn names(self) -> Vec<String> {
        self.files.into_iter().map(|(name, ..)| name).collect()
    }
}

/// Returns true if the folder of a shard is complete and was made with the fingerprint.
pub(crate) fn is_made(folder: &Path, fingerprint: u64) -> bool {
    Manifest::read(folder).is_ok_and(|manifest| manifest.is_of(fingerprint))
}

/// Returns the folders of shards whose files a merge has moved into a complete set.
pub(crate) fn left_over(out: &Path, fingerprint: u64) -> Result<Vec<PathBuf>, GenError> {
    let is_left = |folder: &PathBuf| is_made(folder, fingerprint) || !folder.join(MANIFEST).exists();
    Ok(Shard::beside(out)?.into_iter().map(|shard| shard.folder(out)).filter(is_left).collect())
}

/// Moves the files of all shards into the folder of a set. Fails, and names the shards, if some are missing, were made with other
/// options or sources, or have lost or changed files. Returns the folders of the shards, whose files are gone.
pub(crate) fn gather(out: &Path, fingerprint: u64, folder: &Path) -> Result<Vec<PathBuf>, GenError> {
    let problem = |reason: String| GenError::Shards { out: out.to_path_buf(), reason };
    let found = Shard::beside(out)?;
    let Some(count) = found.first().map(|shard| shard.count) else {
        return Err(problem("there are no shards beside it; --shard I/N makes them".to_owned()));
    };
    if found.iter().any(|shard| shard.count != count) {
        return Err(problem(
            "there are shards of several plans beside it; remove those that are not wanted".to_owned(),
        ));
    }
    let bad: Vec<String> = (1..=count)
        .map(|number| Shard { number, count })
        .filter(|shard| !is_made(&shard.folder(out), fingerprint))
        .map(|shard| shard.to_string())
        .collect();
    if !bad.is_empty() {
        return Err(problem(format!(
            "shards are missing, not complete, or of other options or sources: {}; make them with --shard",
            bad.join(", ")
        )));
    }
    let mut damaged = Vec::new();
    for shard in &found {
        let from = shard.folder(out);
        for (name, size, hash) in Manifest::read(&from)?.files {
            let (from, to) = (from.join(&name), folder.join(&name));
            // A merge that was killed has moved some already.
            let at = if to.is_file() { &to } else { &from };
            let is_right = std::fs::read(at)
                .is_ok_and(|bytes| bytes.len() as u64 == size && format!("{:016x}", fnv1a(&bytes)) == hash);
            if !is_right {
                damaged.push(format!("{name} of {shard}"));
            } else if at == &from {
                if let Some(folder) = to.parent() {
                    std::fs::create_dir_all(folder).map_err(GenError::file(folder))?;
                }
                std::fs::rename(&from, &to).map_err(GenError::file(&to))?;
            }
        }
    }
    if !damaged.is_empty() {
        let first: Vec<String> = damaged.iter().take(10).cloned().collect();
        return Err(problem(format!("{} files are missing or changed, such as {}", damaged.len(), first.join(", "))));
    }
    Ok(found.iter().map(|shard| shard.folder(out)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: the folders of shards stayed if a merge was killed when the set was in place.
    #[test]
    fn shards_of_a_complete_set_are_left_over_unless_they_are_of_other_options() {
        let parent = tempfile::tempdir().unwrap();
        let out = parent.path().join("set");
        let shard = |text: &str| text.parse::<Shard>().unwrap().folder(&out);
        for (text, fingerprint) in [("1/4", 7), ("2/4", 8), ("3/4", 7)] {
            std::fs::create_dir_all(shard(text).join("3/1")).unwrap();
            write_manifest(&shard(text), text.parse().unwrap(), fingerprint).unwrap();
        }
        // The removal of a folder was killed when its manifest was gone.
        std::fs::remove_file(shard("3/4").join(MANIFEST)).unwrap();
        assert_eq!(left_over(&out, 7).unwrap(), [shard("1/4"), shard("3/4")]);
    }
}
