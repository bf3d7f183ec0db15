//! Writes a set of a world into a folder.

use std::path::Path;

use rayon::prelude::*;

use super::planet::World;
use super::tiles::WorldSet;
use crate::args::{Color, ContentKind, GenArgs};
use crate::output::{BlockFile, CompleteTile, Inputs, Journal, Kind, SUBTREE_LEVELS, TileList, Tiling, write_whole};
use crate::{GenError, Progress, Sharding, Summary, TileArgs, TileKey};

/// Returns the set that the options describe; `None` without `--world`.
pub(crate) fn world_set(args: &GenArgs, default_levels: u32) -> Option<WorldSet> {
    let preset = args.world.world?;
    let world = World::new(preset, args.seed);
    let levels = args.levels.unwrap_or(default_levels);
    let set = match args.world.center {
        _ if args.world.globe => WorldSet::globe(world, levels),
        Some(degrees) => WorldSet::square(world, degrees.map(f64::to_radians), args.size, levels),
        None => {
            let place = world.place(args.size);
            WorldSet::square(world, place, args.size, levels)
        }
    };
    let set = if args.output.is_packed() { set.with_packed_heights() } else { set };
    Some(if args.world.scatter { set.with_scatter() } else { set })
}

/// The folder of the files of tiles of a packed set, inside the folder of the run.
const LOOSE: &str = ".tiles";

/// The largest number of levels of a world in a folder. `terrane serve --procedural` makes tiles of finer ones on demand.
const MAX_LEVELS: u32 = 9;

/// Checks options that have no effect with `--world`.
pub(crate) fn check_world(args: &GenArgs) -> Result<(), String> {
    match args.world.world {
        Some(_) if args.content != ContentKind::Height => {
            Err("--world makes height tiles; other values of --content are not supported".to_owned())
        }
        Some(_) if args.color == Color::None => Err("--color none is not supported with --world".to_owned()),
        Some(_) if args.levels.is_some_and(|levels| levels > MAX_LEVELS) => Err(format!(
            "--levels above {MAX_LEVELS} are not supported with --world; `terrane serve --procedural` makes them"
        )),
        Some(_) if args.sharding != Sharding::default() => {
            Err("--plan, --shard and --merge are not supported with --world".to_owned())
        }
        Some(_) if args.tiles != TileArgs::default() => {
            Err("--mesh, --no-meshopt, --normal-maps and --texture have no effect with --world".to_owned())
        }
        Some(_) if !args.imagery.is_empty() => Err("--imagery has no effect with --world".to_owned()),
        None if args.world.center.is_some() || args.world.globe || args.world.scatter => {
            Err("--center, --globe and --scatter have no effect without --world".to_owned())
        }
        _ => Ok(()),
    }
}

/// Writes all tiles and tilesets of a set into a folder, on the threads of the current rayon pool. Tiles that a killed run has
/// completed are not made again. The caller fills in the duration and the final folder of the summary.
pub(crate) fn write_world(set: &WorldSet, tiling: Tiling, folder: &Path) -> Result<Summary, GenError> {
    let keys: Vec<TileKey> = (0..set.levels())
        .flat_map(|level| (0..1u32 << level).flat_map(move |x| (0..1 << level).map(move |y| TileKey { level, x, y })))
        .collect();
    let is_packed = set.heights_extension() == "heights";
    // Tilesets lie in the folder of the set, and so do tiles that are not packed.
    let loose = if is_packed { folder.join(LOOSE) } else { folder.to_path_buf() };
    for folder in [folder, &loose] {
        for (level, x) in (0..set.levels()).flat_map(|level| (0..1u32 << level).map(move |x| (level, x))) {
            let path = folder.join(format!("{level}/{x}"));
            std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
        }
    }
    let mut tileset_bytes = 0;
    if tiling == Tiling::Implicit {
        for (level, x) in (0..set.levels()).flat_map(|level| (0..1u32 << level).map(move |x| (level, x))) {
            if level.is_multiple_of(SUBTREE_LEVELS) {
                let path = folder.join(format!("subtrees/{level}/{x}"));
                std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
            }
        }
        tileset_bytes = write_whole(&folder.join("tileset.json"), set.implicit_tileset().as_bytes())?;
    }
    let progress = Progress::new("writing", keys.len() as u64, "tiles");
    let journal = Journal::new(folder);
    let list = journal.tiles(None)?;
    let write = |name: &str, content: &[u8]| write_whole(&folder.join(name), content);
    let make = |key: TileKey| {
        let tile = set.tile(key)?;
        let stem = loose.join(format!("{}/{}/{}", key.level, key.x, key.y));
        let write_tile = |extension: &str, content: &[u8]| write_whole(&stem.with_extension(extension), content);
        let mut bytes = write_tile(set.heights_extension(), &tile.heights)? + write_tile("jpg", &tile.jpeg)?;
        if let Some(scatter) = &tile.scatter {
            bytes += write_tile("glb", scatter)?;
        }
        match tiling {
            Tiling::Explicit => {
                if let (Some(path), Some(tileset)) = (set.tileset_path(key), set.tileset(key)) {
                    bytes += write(&path, tileset.as_bytes())?;
                }
            }
            Tiling::Implicit => {
                if let Some((name, subtree)) = set.subtree(key) {
                    bytes += write(&name, &subtree)?;
                }
            }
        }
        let (range_m, inputs) = (tile.range_m, Inputs::Data);
        let complete = CompleteTile { bytes, range_m, data_m: range_m, own_m: range_m, voids: 0, inputs };
        list.add(key, &complete)?;
        Ok::<_, GenError>(complete)
    };
    let tiles = keys.par_iter().map(|&key| {
        let complete = list.get(key).map_or_else(|| make(key), Ok)?;
        progress.advance(1);
        Ok::<_, GenError>(complete)
    });
    let tiles = tiles.map(|tile| tile.map(|tile| (tile.bytes, tile.range_m)));
    let none = || (0, [f32::INFINITY, f32::NEG_INFINITY]);
    let both = |a: (u64, [f32; 2]), b: (u64, [f32; 2])| Ok((a.0 + b.0, [a.1[0].min(b.1[0]), a.1[1].max(b.1[1])]));
    let (bytes, [low_m, high_m]) = tiles.try_reduce(none, both)?;
    drop(progress);
    drop(list);
    if is_packed {
        pack(set, &journal.tiles(None)?, &loose, folder)?;
    }
    journal.remove()?;
    Ok(Summary {
        out: folder.to_path_buf(),
        tiles: keys.len() as u64,
        levels: set.levels(),
        bytes: bytes + tileset_bytes,
        min_height_m: low_m.into(),
        max_height_m: high_m.into(),
        filled_samples: 0,
        cut_samples: 0,
        notes: Vec::new(),
        level_errors_m: set.level_errors_m().to_vec(),
        seconds: 0.0,
    })
}

/// Puts the files of all tiles into the file of one block, level by level.
fn pack(set: &WorldSet, list: &TileList, loose: &Path, folder: &Path) -> Result<(), GenError> {
    let mut block = BlockFile::create(folder, TileKey::ROOT)?;
    for level in 0..set.levels() {
        let side = 1u32 << level;
        let mut keys: Vec<TileKey> = (0..side).flat_map(|x| (0..side).map(move |y| TileKey { level, x, y })).collect();
        keys.sort_by_key(|key| key.morton());
        let files = [(Kind::Heights, "heights"), (Kind::Glb, "glb"), (Kind::Jpeg, "jpg")];
        for key in keys {
            let stem = loose.join(format!("{level}/{}/{}", key.x, key.y));
            for (kind, extension) in files.into_iter().filter(|(kind, _)| *kind != Kind::Glb || set.has_scatter(level))
            {
                let path = stem.with_extension(extension);
                block.add(key, kind, &std::fs::read(&path).map_err(GenError::file(&path))?)?;
            }
        }
    }
    let errors_m = set.level_errors_m();
    block.finish(|key| {
        let range_m = list.get(key).map_or([0.0; 2], |tile| tile.range_m);
        (errors_m.get(key.level as usize).copied().unwrap_or(0.0), range_m)
    })
}
