//! Writes a set of a world into a folder.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::planet::World;
use super::tiles::WorldSet;
use crate::args::{Color, ContentKind, GenArgs};
use crate::{GenError, Progress, Sharding, Summary, TileArgs, TileKey};

/// Returns the set that the options describe; `None` without `--world`.
pub(crate) fn world_set(args: &GenArgs, default_levels: u32) -> Option<WorldSet> {
    let preset = args.world.world?;
    let world = World::new(preset, args.seed);
    let levels = args.levels.unwrap_or(default_levels);
    if args.world.globe {
        return Some(WorldSet::globe(world, levels));
    }
    let center = match args.world.center {
        Some(degrees) => degrees.map(f64::to_radians),
        None => world.place(args.size),
    };
    Some(WorldSet::square(world, center, args.size, levels))
}

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
            Err("--mesh, --no-meshopt and --texture have no effect with --world".to_owned())
        }
        Some(_) if args.imagery.is_some() => Err("--imagery has no effect with --world".to_owned()),
        None if args.world.center.is_some() || args.world.globe => {
            Err("--center and --globe have no effect without --world".to_owned())
        }
        _ => Ok(()),
    }
}

/// Writes all tiles and tilesets of a set into a folder, on the threads of the current rayon pool. The caller fills in the
/// duration and the final folder of the summary.
pub(crate) fn write_world(set: &WorldSet, folder: &Path) -> Result<Summary, GenError> {
    let keys: Vec<TileKey> = (0..set.levels())
        .flat_map(|level| (0..1u32 << level).flat_map(move |x| (0..1 << level).map(move |y| TileKey { level, x, y })))
        .collect();
    for level in 0..set.levels() {
        for x in 0..1u32 << level {
            let path = folder.join(format!("{level}/{x}"));
            std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
        }
    }
    let progress = Progress::new("writing", keys.len() as u64, "tiles");
    let bytes = AtomicU64::new(0);
    let write = |name: &str, content: &[u8]| {
        let path = folder.join(name);
        bytes.fetch_add(content.len() as u64, Ordering::Relaxed);
        std::fs::write(&path, content).map_err(GenError::file(&path))
    };
    let ranges = keys.par_iter().map(|&key| {
        let tile = set.tile(key)?;
        let stem = format!("{}/{}/{}", key.level, key.x, key.y);
        write(&format!("{stem}.exr"), &tile.exr)?;
        write(&format!("{stem}.jpg"), &tile.jpeg)?;
        if let (Some(path), Some(tileset)) = (set.tileset_path(key), set.tileset(key)) {
            write(&path, tileset.as_bytes())?;
        }
        progress.advance(1);
        Ok::<_, GenError>(tile.range_m)
    });
    let both = |a: [f32; 2], b: [f32; 2]| Ok([a[0].min(b[0]), a[1].max(b[1])]);
    let [low_m, high_m] = ranges.try_reduce(|| [f32::INFINITY, f32::NEG_INFINITY], both)?;
    drop(progress);
    Ok(Summary {
        out: folder.to_path_buf(),
        tiles: keys.len() as u64,
        levels: set.levels(),
        bytes: bytes.into_inner(),
        min_height_m: low_m.into(),
        max_height_m: high_m.into(),
        filled_samples: 0,
        cut_samples: 0,
        notes: Vec::new(),
        level_errors_m: set.level_errors_m().to_vec(),
        seconds: 0.0,
    })
}
