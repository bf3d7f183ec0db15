//! Writes a set of a world into a folder.

use std::path::Path;

use rayon::prelude::*;

use super::errors::{RATIO as LEVEL_RATIO, least_error_m};
use super::form::Described;
use super::surface::World;
use super::tiles::{WorldSet, WorldTile};
use super::tileset::{Descriptions, LEVELS_PER_TILESET};
use crate::args::{ContentKind, GenArgs};
use crate::output::{
    BlockFile, Journal, Kind, ListedTile, RATIO, SUBTREE_LEVELS, TileErrors, TileList, Tiling, descendants, is_round,
    write_whole,
};
use crate::pyramid::{CELLS, Samples, Window, distance_to_finer_m};
use crate::{GenError, Progress, Shard, Summary, TileKey};

/// Returns the set that the options describe; `None` without `--world`.
pub(crate) fn world_set(args: &GenArgs, default_levels: u32) -> Option<WorldSet> {
    let preset = args.world.world?;
    let world = World::on(preset, args.seed, args.output.ellipsoid());
    // Terrain for globes counts levels from that of the whole earth.
    let own_levels = args.levels.filter(|_| args.content != ContentKind::QuantizedMesh);
    let levels = own_levels.unwrap_or(default_levels);
    let set = match args.world.center {
        _ if args.world.globe => WorldSet::globe(world, levels),
        Some(degrees) => WorldSet::square(world, degrees.map(f64::to_radians), args.size, levels),
        None => {
            let place = world.place(args.size);
            WorldSet::square(world, place, args.size, levels)
        }
    };
    let set = set.with_form_of(args);
    Some(if args.world.scatter { set.with_scatter() } else { set })
}

/// The folder of the files of tiles of a packed set, inside the folder of the run.
const LOOSE: &str = ".tiles";

/// The largest number of levels of a world in a folder. `terrane serve --procedural` makes tiles of finer ones on demand.
const MAX_LEVELS: u32 = 9;

/// Levels of the subtrees that shards make; a merge makes the coarser tiles.
const SHARD_LEVELS: u32 = 3;

/// Returns the roots of the subtrees that shards make, in order.
pub(crate) fn shard_roots(set: &WorldSet) -> Vec<TileKey> {
    let level = set.levels().saturating_sub(SHARD_LEVELS).max(1).min(set.levels().saturating_sub(1));
    descendants(TileKey::ROOT, level).collect()
}

/// Returns the number of tiles of a set at and below those of a level, for each of them.
pub(crate) fn tiles_below(set: &WorldSet, level: u32) -> u64 {
    (0..set.levels() - level).map(|level| 1 << (2 * level)).sum()
}

/// Checks options that have no effect with `--world`, or only with it.
pub(crate) fn check_world(args: &GenArgs) -> Result<(), String> {
    let world = &args.world;
    if world.world.is_none() {
        return match world.center.is_some() || world.globe || world.scatter {
            true => Err("--center, --globe and --scatter have no effect without --world".to_owned()),
            false => Ok(()),
        };
    }
    let is_terrain = args.content == ContentKind::QuantizedMesh;
    let ellipsoid = args.output.ellipsoid();
    if !World::can_lie_on(&ellipsoid) {
        return Err("--body: radii of worlds are 10 to 20,000 km".to_owned());
    }
    if !world.globe && args.size > ellipsoid.semi_major_m {
        return Err(format!("--size {} m is larger than the radius of the body", args.size));
    }
    let problem = match args.content {
        _ if !args.imagery.is_empty() => "--imagery has no effect with --world",
        ContentKind::QuantizedMesh if world.scatter => "--scatter has no effect with --content quantized-mesh",
        ContentKind::Height if args.tiles.no_meshopt => {
            "--no-meshopt has no effect with --world without --content mesh"
        }
        _ if !is_terrain && args.levels.is_some_and(|levels| levels > MAX_LEVELS) => {
            return Err(format!(
                "--levels above {MAX_LEVELS} are not supported with --world; `terrane serve --procedural` makes them"
            ));
        }
        _ => return Ok(()),
    };
    Err(problem.to_owned())
}

/// A tile whose files and those of all tiles below it are complete.
#[derive(Clone, Debug, PartialEq)]
struct MadeTile {
    /// The size of its files in bytes.
    bytes: u64,
    /// The lowest and the highest height in metres.
    range_m: [f32; 2],
    /// The error and the heights of the tile with all tiles below it.
    described: Described,
    /// A number for each coarser level: the largest distance of this tile's finest samples from the grid of the tile above it on
    /// that level, in metres.
    above_m: Vec<f64>,
}

impl ListedTile for MadeTile {
    fn text(&self) -> String {
        let Described { geometric_error_m, heights_m: [low_m, high_m] } = self.described;
        let [lowest, highest] = self.range_m.map(f32::to_bits);
        let numbers = [geometric_error_m, low_m, high_m].into_iter().chain(self.above_m.iter().copied());
        let numbers: String = numbers.map(|number| format!(" {:x}", number.to_bits())).collect();
        format!("{} {lowest:x} {highest:x}{numbers}", self.bytes)
    }

    fn parse(text: &str) -> Option<Self> {
        let mut words = text.split(' ');
        let bytes = words.next()?.parse().ok()?;
        let mut height = || Some(f32::from_bits(u32::from_str_radix(words.next()?, 16).ok()?));
        let range_m = [height()?, height()?];
        let numbers: Option<Vec<f64>> =
            words.map(|word| Some(f64::from_bits(u64::from_str_radix(word, 16).ok()?))).collect();
        let numbers = numbers?;
        let [geometric_error_m, low_m, high_m, above_m @ ..] = numbers.as_slice() else { return None };
        let described = Described { geometric_error_m: *geometric_error_m, heights_m: [*low_m, *high_m] };
        Some(Self { bytes, range_m, described, above_m: above_m.to_vec() })
    }
}

/// Makes the tiles of a set. Threads share it.
struct Run<'a> {
    set: &'a WorldSet,
    /// The folder of the files of tiles.
    folder: &'a Path,
    list: TileList<MadeTile>,
    progress: Progress,
}

impl Run<'_> {
    /// Makes the tiles at and below the roots in `part`, all of one level, that lie in a tile. `above` are the tiles that
    /// contain it.
    fn make_part(&self, key: TileKey, above: &[(TileKey, &[f32])], part: &[TileKey]) -> Result<(), GenError> {
        let Some(level) = part.first().map(|root| root.level) else { return Ok(()) };
        if key.level == level {
            return self.make(key, above).map(drop);
        }
        // The tile belongs to no shard, but the tiles below are measured against it.
        let heights_m = self.set.samples_m(key);
        let mut path = above.to_vec();
        path.push((key, &heights_m));
        key.children().par_iter().try_for_each(|child| {
            let up = level - child.level;
            let is_below = |root: &&TileKey| [root.x >> up, root.y >> up] == [child.x, child.y];
            self.make_part(*child, &path, &part.iter().filter(is_below).copied().collect::<Vec<_>>())
        })
    }

    /// Makes a tile and all tiles below it, unless an earlier run has. `above` are the tiles that contain it, the root first,
    /// with their heights.
    fn make(&self, key: TileKey, above: &[(TileKey, &[f32])]) -> Result<MadeTile, GenError> {
        if let Some(complete) = self.list.get(key) {
            self.progress.advance(tiles_below(self.set, key.level));
            return Ok(complete);
        }
        let tile = self.set.tile(key)?;
        let column = self.folder.join(format!("{}/{}", key.level, key.x));
        std::fs::create_dir_all(&column).map_err(GenError::file(&column))?;
        let stem = column.join(key.y.to_string());
        let written =
            tile.files.iter().map(|(extension, content)| write_whole(&stem.with_extension(extension), content));
        let bytes = written.sum::<Result<u64, GenError>>()?;
        self.progress.advance(1);
        let mut path = above.to_vec();
        path.push((key, &tile.heights_m));
        let below: Vec<MadeTile> = match key.level + 1 < self.set.levels() {
            true => key.children().par_iter().map(|child| self.make(*child, &path)).collect::<Result<_, _>>()?,
            false => Vec::new(),
        };
        let (described, above_m) = self.describe(key, &tile, above, &below);
        let made = MadeTile { bytes, range_m: tile.range_m, described, above_m };
        self.list.add(key, &made)?;
        Ok(made)
    }

    /// Returns the description of a tile, and [`MadeTile::above_m`].
    fn describe(
        &self,
        key: TileKey,
        tile: &WorldTile,
        above: &[(TileKey, &[f32])],
        below: &[MadeTile],
    ) -> (Described, Vec<f64>) {
        let set = self.set;
        let [mut low_m, mut high_m] = tile.range_m.map(f64::from);
        let mut above_m = vec![0.0; above.len()];
        let mut own_m = 0.0f64;
        for child in below {
            above_m.iter_mut().zip(&child.above_m).for_each(|(most, own)| *most = own.max(*most));
            own_m = own_m.max(child.above_m.get(key.level as usize).copied().unwrap_or(0.0));
        }
        if below.is_empty() {
            let samples = own_samples(key, &tile.heights_m);
            for ((coarser, heights_m), most) in above.iter().zip(&mut above_m) {
                let height_m = |i: i64, j: i64| heights_m[(j + 1) as usize * (CELLS + 3) + (i + 1) as usize];
                *most = distance_to_finer_m(
                    &set.world().ellipsoid,
                    &set.extent(TileKey::ROOT),
                    *coarser,
                    height_m,
                    key,
                    &samples,
                );
            }
        }
        high_m += set.tallest_m(key.level);
        // The finest level is off from the world itself, too.
        let finest_m = set.level_errors_m().last().copied().unwrap_or(0.0);
        let error_m = (own_m + finest_m).max(least_error_m(set, key.level));
        let mut described = set.described(key, [low_m, high_m], error_m, tile.measures);
        [low_m, high_m] = described.heights_m;
        let ratio = if set.has_meshes() { 1.0 } else { RATIO };
        for Described { geometric_error_m, heights_m: [low, high] } in below.iter().map(|child| child.described) {
            described.geometric_error_m = described.geometric_error_m.max(ratio * geometric_error_m);
            (low_m, high_m) = (low_m.min(low), high_m.max(high));
        }
        described.heights_m = [low_m, high_m];
        (described, above_m)
    }
}

/// Returns the samples of a tile without those next to it, on the lattice of its level.
fn own_samples(key: TileKey, heights_m: &[f32]) -> Samples {
    let first = [key.x, key.y].map(|c| i64::from(c) * CELLS as i64);
    let rows = heights_m.chunks(CELLS + 3).skip(1).take(CELLS + 1);
    let values = rows.flat_map(|row| &row[1..=CELLS + 1]).copied().collect();
    Samples { window: Window { first, last: first.map(|c| c + CELLS as i64) }, values }
}

/// Writes all tiles and tilesets of a set into a folder, on the threads of the current rayon pool; of a shard only the tiles at
/// and below its roots. A tile is not made again if a killed run or a shard had completed it and all tiles below it. The caller
/// fills in the duration and the final folder of the summary.
pub(crate) fn write_world(
    set: &WorldSet,
    tiling: Tiling,
    folder: &Path,
    shard: Option<Shard>,
) -> Result<Summary, GenError> {
    let is_packed = set.is_packed();
    // Tilesets lie in the folder of the set, and so do tiles that are not packed.
    let loose = if is_packed { folder.join(LOOSE) } else { folder.to_path_buf() };
    // Threads that make tiles would wait for the errors, and one of them would measure these.
    set.level_errors_m();
    let roots = shard_roots(set);
    let whole = [TileKey::ROOT];
    let part = shard.map_or(whole.as_slice(), |shard| shard.part_of(&roots));
    let tiles = part.iter().map(|root| tiles_below(set, root.level)).sum();
    let journal = Journal::new(folder);
    let progress = Progress::new("writing", tiles, "tiles");
    Run { set, folder: &loose, list: journal.tiles(shard)?, progress }.make_part(TileKey::ROOT, &[], part)?;
    // The list of what was made now and before.
    let list: TileList<MadeTile> = journal.tiles(shard)?;
    let (mut bytes, mut range_m) = (0, [f32::INFINITY, f32::NEG_INFINITY]);
    for (_, tile) in list.all() {
        bytes += tile.bytes;
        range_m = [range_m[0].min(tile.range_m[0]), range_m[1].max(tile.range_m[1])];
    }
    let level_errors_m = measured_errors_m(set, &list);
    if shard.is_none() {
        bytes += write_tilesets(set, &list, &level_errors_m, tiling, folder)?;
        if is_packed {
            pack(set, &list, &loose, folder)?;
        }
    }
    Ok(Summary {
        out: folder.to_path_buf(),
        tiles,
        levels: set.levels(),
        bytes,
        min_height_m: range_m[0].into(),
        max_height_m: range_m[1].into(),
        filled_samples: 0,
        cut_samples: 0,
        notes: Vec::new(),
        level_errors_m,
        seconds: 0.0,
    })
}

/// Returns the errors of levels in metres, root first: those of their tiles, and a little more than that of the next level.
fn measured_errors_m(set: &WorldSet, list: &TileList<MadeTile>) -> Vec<f64> {
    let mut errors_m = vec![0.0f64; set.levels() as usize];
    for (key, tile) in list.all() {
        let error_m = &mut errors_m[key.level as usize];
        *error_m = error_m.max(tile.described.geometric_error_m);
    }
    for level in (0..errors_m.len().saturating_sub(1)).rev() {
        errors_m[level] = errors_m[level].max(LEVEL_RATIO * errors_m[level + 1]);
    }
    errors_m
}

/// Writes the tilesets, or the tileset of implicit tiling and its subtree files. Returns their bytes.
fn write_tilesets(
    set: &WorldSet,
    list: &TileList<MadeTile>,
    level_errors_m: &[f64],
    tiling: Tiling,
    folder: &Path,
) -> Result<u64, GenError> {
    let of = |key: TileKey| list.get(key).map_or_else(|| set.expected(key), |tile| tile.described);
    let error_m = |key: TileKey| Ok(list.get(key).map_or(0.0, |tile| tile.described.geometric_error_m));
    let is_round = is_round(&set.extent(TileKey::ROOT));
    let errors = (!set.has_meshes()).then_some(TileErrors { error_m: &error_m as &_, first_level: 0, is_round });
    let described = Descriptions { of: &of, level_errors_m, errors };
    let write = |name: &str, content: &[u8]| {
        let path = folder.join(name);
        path.parent().map_or(Ok(()), |parent| std::fs::create_dir_all(parent).map_err(GenError::file(parent)))?;
        write_whole(&path, content)
    };
    let roots = |levels: u32| -> Vec<TileKey> {
        let levels = (0..set.levels()).filter(|level| level.is_multiple_of(levels));
        levels.flat_map(|level| descendants(TileKey::ROOT, level)).collect()
    };
    let (roots, first) = match tiling {
        Tiling::Explicit => (roots(LEVELS_PER_TILESET), 0),
        Tiling::Implicit => {
            (roots(SUBTREE_LEVELS), write("tileset.json", set.implicit_tileset_by(&described).as_bytes())?)
        }
    };
    let written = roots.par_iter().map(|key| {
        let file = match tiling {
            Tiling::Explicit => set.tileset_path(*key).zip(set.tileset_by(*key, &described).map(String::into_bytes)),
            Tiling::Implicit => set.subtree_by(*key, &described),
        };
        file.map_or(Ok(0), |(name, content)| write(&name, &content))
    });
    Ok(first + written.sum::<Result<u64, GenError>>()?)
}

/// Puts the files of all tiles into the file of one block, level by level.
fn pack(set: &WorldSet, list: &TileList<MadeTile>, loose: &Path, folder: &Path) -> Result<(), GenError> {
    let mut block = BlockFile::create(folder, TileKey::ROOT)?;
    for level in 0..set.levels() {
        // The files of a tile in the order of their kinds.
        let mut files: Vec<(Kind, &str)> =
            set.extensions(level).filter_map(|e| Some((Kind::of_extension(e)?, e))).collect();
        files.sort_by_key(|(kind, _)| *kind as u8);
        for key in descendants(TileKey::ROOT, level) {
            let stem = loose.join(format!("{level}/{}/{}", key.x, key.y));
            for (kind, extension) in &files {
                let path = stem.with_extension(extension);
                block.add(key, *kind, &std::fs::read(&path).map_err(GenError::file(&path))?)?;
            }
        }
    }
    block.finish(|key| {
        let none = || (0.0, [0.0; 2]);
        list.get(key).map_or_else(none, |tile| (tile.described.geometric_error_m, tile.range_m))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Color, WorldPreset};

    /// A subtree that a killed run has completed stays, and is measured as in a separate run.
    #[test]
    fn meshes_below_complete_tiles_are_not_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let args = GenArgs { content: ContentKind::Mesh, color: Color::None, ..GenArgs::new("") };
        let set = WorldSet::square(World::new(WorldPreset::Moon, 1), [0.3, 0.5], 20_000.0, 2).with_form_of(&args);
        let [whole, continued] = ["whole", "continued"].map(|name| folder.path().join(name));
        let wanted = write_world(&set, Tiling::Explicit, &whole, None).unwrap();
        let journal = Journal::new(&continued);
        let (list, progress) = (journal.tiles(None).unwrap(), Progress::new("writing", 5, "tiles"));
        let run = Run { set: &set, folder: &continued, list, progress };
        let root = set.tile(TileKey::ROOT).unwrap();
        run.make(TileKey { level: 1, x: 1, y: 0 }, &[(TileKey::ROOT, &root.heights_m)]).unwrap();
        drop(run);
        // The content shows whether the file is written again.
        std::fs::write(continued.join("1/1/0.glb"), "complete").unwrap();
        let made = write_world(&set, Tiling::Explicit, &continued, None).unwrap();
        assert_eq!(Summary { out: wanted.out.clone(), ..made }, wanted);
        let read = |set: &Path, name: &str| std::fs::read(set.join(name)).unwrap();
        assert_eq!(read(&continued, "1/1/0.glb"), b"complete");
        for name in ["tileset.json", "0/0/0.glb", "1/0/1.glb"] {
            assert!(read(&continued, name) == read(&whole, name), "{name}");
        }
    }

    #[test]
    fn lines_of_complete_tiles_are_read_back() {
        let described = Described { geometric_error_m: 0.3, heights_m: [-1e3 / 7.0, 9.5] };
        for above_m in [Vec::new(), vec![1.5, 0.1]] {
            let tile = MadeTile { bytes: 77, range_m: [-0.1, 8.5], described, above_m };
            assert_eq!(MadeTile::parse(&tile.text()), Some(tile));
        }
        assert!(MadeTile::parse("77 0").is_none() && MadeTile::parse("77 0 0 0 0").is_none());
    }
}
