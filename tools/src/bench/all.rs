//! `terrane bench all`: runs the benches of all layers one after the other, each in a separate process, and collects
//! their lines.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Map, Value};

/// The benches in the order of the document: title, arguments, and columns of the table in addition to those that
/// distinguish the cases.
const BENCHES: [(&str, &[&str], &[&str]); 12] = [
    ("Cull: scene to render stages", &["cull"], &["ns_per_node", "traverse_us", "sort_us", "leaves"]),
    ("Tile trees", &["tiles"], &["walk_ns_per_tile", "ns_per_tile", "tiles_visited"]),
    ("Picking", &["pick"], &["median_us", "p99_us", "build_ms"]),
    ("Submission to the noop adapter", &["submit"], &["ns_per_leaf", "draw_calls", "state_changes"]),
    ("Whole frames on the software driver", &["frame"], &["frame_p50_ms", "frame_p95_ms", "draw_p50_ms"]),
    ("Whole frames while imagery arrives", &["overlays"], OVERLAY_COLUMNS),
    ("Threading models", &["threading"], &[]),
    ("Shared content", &["share"], &["decode_tiles_per_s", "load_tiles_per_s", "load_to_decode", "gpu_mb"]),
    ("Update with resident pages", &["resident"], RESIDENT_COLUMNS),
    ("Paging from disk, mesh tiles", &["page", "--content", "mesh"], PAGE_COLUMNS),
    ("Paging from disk, height tiles", &["page", "--content", "height"], PAGE_COLUMNS),
    (
        "Paging with the path announced, one second",
        &["page", "--content", "height", "--frames", "60", "--look-ahead", "1"],
        PAGE_COLUMNS,
    ),
];

const OVERLAY_COLUMNS: &[&str] =
    &["images", "frame_p50_ms", "frame_p99_ms", "p99_to_p50", "cpu_p50_ms", "cpu_p99_ms", "cpu_p99_to_p50", "missed"];

const RESIDENT_COLUMNS: &[&str] =
    &["update_p50_us", "update_p99_us", "update_max_us", "max_to_p50", "cpu_p50_us", "cpu_max_us", "cpu_max_to_p50"];

const PAGE_COLUMNS: &[&str] =
    &["time_s", "frame_p50_ms", "frame_p99_ms", "missing_mean", "missing_longest_ms", "rss_mb"];

/// Runs all benches. `secs` is the minimum time of each case for benches with that option; `None` leaves their defaults.
pub fn run(markdown: bool, secs: Option<f64>) -> Result<()> {
    let program = std::env::current_exe().context("path of this program")?;
    let mut document = if markdown { head(secs)? } else { String::new() };
    for (number, (title, args, columns)) in BENCHES.into_iter().enumerate() {
        eprintln!("bench {} of {}: {}", number + 1, BENCHES.len(), args.join(" "));
        let mut command = Command::new(&program);
        command.arg("bench").args(args).stdout(Stdio::piped()).stderr(Stdio::null());
        if let Some(secs) = secs.filter(|_| args[0] != "page") {
            command.args(["--secs", &secs.to_string()]);
        }
        let out = command.output().with_context(|| format!("bench {}", args.join(" ")))?;
        ensure!(out.status.success(), "bench {} ended with {}", args.join(" "), out.status);
        let text = String::from_utf8(out.stdout).with_context(|| format!("output of bench {}", args[0]))?;
        if markdown {
            let rows = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect::<Vec<_>>();
            let _ =
                writeln!(document, "\n## {title}\n\n`terrane bench {}`\n\n{}", args.join(" "), table(&rows, columns));
        } else {
            std::io::stdout().write_all(text.as_bytes()).context("stdout")?;
        }
    }
    std::io::stdout().write_all(document.as_bytes()).context("stdout")
}

/// Returns the title with the command, machine, date and commit of the measurement.
fn head(secs: Option<f64>) -> Result<String> {
    let secs = secs.map_or_else(String::new, |secs| format!(" --secs {secs}"));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let seconds = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).context("clock")?.as_secs();
    let commit = match git(&["rev-parse", "--short=10", "HEAD"]) {
        Some(commit) if git(&["status", "--porcelain"]).is_none() => commit,
        Some(commit) => format!("{commit} with local changes"),
        None => "unknown".to_owned(),
    };
    Ok(format!(
        "# Benchmarks\n\nWritten by `terrane bench all --markdown{secs} > docs/benchmarks.md`; do not edit.\n\n\
         - Machine: {}, {cores} cores, {}\n- Date: {}\n- Commit: {commit}\n- Version: {}\n\n\
         Figures of different machines or days do not compare. The header of a column names its unit; \"-\" means that the case \
         has no such figure.\n",
        processor(),
        std::env::consts::OS,
        date(seconds),
        env!("CARGO_PKG_VERSION")
    ))
}

/// Returns the trimmed output of a git command in the working folder, `None` if it fails or prints nothing.
fn git(args: &[&str]) -> Option<String> {
    let out = Command::new("git").args(args).stderr(Stdio::null()).output().ok()?;
    let text = String::from_utf8(out.stdout).ok()?.trim().to_owned();
    (out.status.success() && !text.is_empty()).then_some(text)
}

/// Returns the name of the processor, or the architecture if the system does not name it.
fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

/// Returns the UTC date of a Unix time as YYYY-MM-DD. The algorithm is by Howard Hinnant, "chrono-Compatible Low-Level Date
/// Algorithms".
fn date(unix_s: u64) -> String {
    let days = unix_s / 86_400 + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Returns a table with one row per case. The first columns are the members that distinguish the rows: text, and numbers
/// that are settings. Then follow `columns`, or all numbers if `columns` is empty.
fn table(rows: &[Map<String, Value>], columns: &[&str]) -> String {
    let mut texts: BTreeMap<&str, Vec<&Value>> = BTreeMap::new();
    for (name, value) in rows.iter().flatten() {
        texts.entry(name).or_default().push(value);
    }
    let is_setting = |name: &str| matches!(name, "n" | "statesets" | "levels" | "drawables" | "tiles" | "triangles");
    let varies = |values: &[&Value]| values.iter().any(|value| value != &values[0]) || values.len() < rows.len();
    let cases = texts.iter().filter(|(name, values)| {
        let is_case = values.iter().all(|value| value.is_string()) || is_setting(name);
        is_case && varies(values) && !columns.contains(name)
    });
    let mut names: Vec<&str> = cases.map(|(name, _)| *name).collect();
    if columns.is_empty() {
        names.extend(texts.iter().filter(|(name, v)| v[0].is_number() && !is_setting(name)).map(|(name, _)| *name));
    } else {
        names.extend(columns.iter().filter(|column| texts.contains_key(*column)));
    }
    let mut out = format!("| {} |\n|{}\n", names.join(" | "), "---|".repeat(names.len()));
    for row in rows {
        let cell = |name: &&str| match row.get(*name) {
            Some(Value::String(text)) => text.clone(),
            Some(value) if !value.is_null() => value.to_string(),
            _ => "-".to_owned(),
        };
        let _ = writeln!(out, "| {} |", names.iter().map(cell).collect::<Vec<_>>().join(" | "));
    }
    out
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn dates_are_civil_dates() {
        assert_eq!([0, 951_782_400, 1_790_726_400].map(date), ["1970-01-01", "2000-02-29", "2026-09-30"]);
    }

    #[test]
    fn table_starts_with_the_members_that_distinguish_rows() {
        let rows: Vec<Map<String, Value>> = [
            json!({ "bench": "x", "view": "all", "n": 10, "ns": 1.5, "noise": 7 }),
            json!({ "bench": "x", "view": "side", "n": 20 }),
        ]
        .into_iter()
        .filter_map(|row| row.as_object().cloned())
        .collect();
        assert_eq!(table(&rows, &["ns"]), "| n | view | ns |\n|---|---|---|\n| 10 | all | 1.5 |\n| 20 | side | - |\n");
    }
}
