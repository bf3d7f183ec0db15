//! Prints where the time of the tiles of worlds goes, on one thread: milliseconds per tile of each step, for tiles with 65 x 65 heights
//! and images of 256 x 256 pixels.
//!
//! `cargo bench -p terrane-data-gen --bench worlds [PRESET...]`

use std::io::Write as _;
use std::time::{Duration, Instant};

use terrane_data_gen::{GenError, TileKey, TileStep, World, WorldPreset, WorldSet};

const STEPS: [(TileStep, &str); 6] = [
    (TileStep::Drainage, "drainage"),
    (TileStep::Heights, "heights"),
    (TileStep::Colors, "colours"),
    (TileStep::Image, "image"),
    (TileStep::HeightFile, "height file"),
    (TileStep::Scatter, "scatter"),
];
/// The tiles that are measured of each set.
const TILES: u32 = 64;

/// Returns the time of each step for the tiles of one level of a set.
fn measure(set: &WorldSet, level: u32) -> Result<[Duration; STEPS.len()], GenError> {
    let mut times = [Duration::ZERO; STEPS.len()];
    let side = (1u32 << level).min(8);
    let first = (1u32 << level) / 2 - side / 2;
    for tile in 0..TILES {
        let [x, y] = [tile % side, tile / side % side].map(|k| first + k);
        let mut last = Instant::now();
        let made = set.tile_in_steps(TileKey { level, x, y }, &mut |step| {
            let now = Instant::now();
            for ((of, _), time) in STEPS.iter().zip(&mut times) {
                if *of == step {
                    *time += now - last;
                }
            }
            last = now;
        });
        std::hint::black_box(made?);
    }
    Ok(times)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let names: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    let mut out = std::io::stdout().lock();
    write!(out, "{:<18}{:>10}", "ms per tile", "sum")?;
    for (_, name) in STEPS {
        write!(out, "{name:>13}")?;
    }
    writeln!(out, "{:>12}", "tiles/s")?;
    for preset in WorldPreset::ALL {
        if !names.is_empty() && !names.iter().any(|name| name == preset.name()) {
            continue;
        }
        let center = World::new(preset, 1).place(40_000.0);
        // Cells of 39 m, of 2.4 m with trees and rocks, and of a whole planet: 10 km and 2.4 m.
        let square = |size_m| WorldSet::square(World::new(preset, 1), center, size_m, 5);
        let planet = WorldSet::globe(World::new(preset, 1), 22);
        let sets = [
            ("39 m", square(40_000.0), 4),
            ("2.4 m + scatter", square(2_500.0).with_scatter(), 4),
            ("globe, level 5", planet, 5),
        ];
        for (name, set, level) in sets {
            let times = measure(&set, level)?.map(|time| time.as_secs_f64() * 1e3 / f64::from(TILES));
            let sum: f64 = times.iter().sum();
            write!(
                out,
                "{:<18}{sum:>10.2}",
                format!("{} {name}", preset.name().split_at(5.min(preset.name().len())).0)
            )?;
            for time in times {
                write!(out, "{time:>13.3}")?;
            }
            writeln!(out, "{:>12.0}", 1e3 / sum)?;
        }
    }
    Ok(())
}
