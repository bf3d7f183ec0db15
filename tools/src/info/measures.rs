//! The tables of `terrane info --verify`: measures by level, and what is wrong.

use std::fmt::Write as _;

use terrane::formats::{LevelMeasures, Problem, Spread, Verified};

/// Returns the tables as text; empty if no tile was measured.
pub fn text(verified: &Verified) -> String {
    let mut out = String::new();
    let Verified { levels, problems, edges_left_out, .. } = verified;
    // Tiles whose content is another tileset have a level of their own, without anything to measure.
    let levels: Vec<&LevelMeasures> = levels.iter().filter(|level| level.tiles > 0).collect();
    if !levels.is_empty() {
        out.push_str(&contents(&levels));
        out.push_str(&errors(&levels));
    }
    // Writing to a String cannot fail.
    if *edges_left_out > 0 {
        let _ = writeln!(out, "edges    {edges_left_out} were not compared: too many others waited for a neighbour");
    }
    for Problem { kind, count, uri, detail } in problems {
        let tiles = if *count == 1 { "tile" } else { "tiles" };
        let _ = writeln!(out, "problem  {kind}: {count} {tiles}, first {uri}: {detail}");
    }
    out
}

fn contents(levels: &[&LevelMeasures]) -> String {
    let mut rows = vec![row(["level", "tiles", "bytes", "triangles", "heights m", "textures"])];
    for level in levels {
        let spread = |spread: Spread| format!("{} / {} / {}", spread.min, spread.median, spread.max);
        let textures = level.textures.iter().map(|(name, count)| format!("{count} {name}"));
        rows.push([
            level.level.to_string(),
            level.tiles.to_string(),
            spread(level.bytes),
            level.triangles.map_or_else(none, spread),
            level.heights_m.map_or_else(none, range),
            textures.collect::<Vec<_>>().join(", "),
        ]);
    }
    "measured, bytes and triangles as smallest / median / largest\n".to_owned() + &table(&rows)
}

fn errors(levels: &[&LevelMeasures]) -> String {
    let head = ["level", "declared m", "to next m", "to finest m", "edges", "same level m", "to coarser m", "skirts m"];
    let mut rows = vec![row(head)];
    for level in levels {
        let one = |value: Option<f64>| value.map_or_else(none, metres);
        rows.push([
            level.level.to_string(),
            level.geometric_error_m.map_or_else(none, range),
            one(level.error_to_next_m),
            one(level.error_to_finest_m),
            level.edges.to_string(),
            one(level.edge_m),
            one(level.edge_to_coarser_m),
            level.skirt_m.map_or_else(none, range),
        ]);
    }
    "errors, and differences of heights on common edges\n".to_owned() + &table(&rows)
}

fn row<const N: usize>(cells: [&str; N]) -> [String; N] {
    cells.map(str::to_owned)
}

fn none() -> String {
    "-".to_owned()
}

fn range([low, high]: [f64; 2]) -> String {
    if metres(low) == metres(high) { metres(low) } else { format!("{} to {}", metres(low), metres(high)) }
}

fn metres(value: f64) -> String {
    let digits = if value.abs() < 10.0 { 3 } else { 1 };
    let text = format!("{value:.digits$}");
    // A rounded negative number is no zero with a sign.
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') { "0".to_owned() } else { text }
}

/// Returns rows with columns of equal width, right-aligned but for the last one if it is a list.
fn table<const N: usize>(rows: &[[String; N]]) -> String {
    let mut widths = [0; N];
    for row in rows {
        widths.iter_mut().zip(row).for_each(|(width, cell)| *width = (*width).max(cell.chars().count()));
    }
    let mut out = String::new();
    for row in rows {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:>width$}"));
        let line = cells.collect::<Vec<_>>().join("  ");
        out.push_str(line.trim_end());
        out.push('\n');
    }
    out
}
