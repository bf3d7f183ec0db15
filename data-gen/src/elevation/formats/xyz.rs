//! Text files with a point in each line, `x y z`, that are a grid: elevation models of many surveys, in any order of the points.

use std::io::{BufRead, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Opened, RasterOptions};
use crate::GenError;
use crate::georeference::{GeoTransform, Placement};
use crate::store::{BlockCache, FileState, WholeReader, whole};

/// The longest line in bytes.
const MAX_LINE: u64 = 400;
/// The largest number of cells, which are in memory while the file is decoded: 512 MiB.
const MAX_CELLS: f64 = (1u32 << 27) as f64;
/// A file has at least one point for this many cells of its grid.
const CELLS_PER_POINT: f64 = 64.0;
/// The largest distance of a point from its cell's middle, in cells.
const TOLERANCE: f64 = 0.05;

/// The grid that the points of a file lie on.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Grid {
    west: f64,
    north: f64,
    step: [f64; 2],
    size: [usize; 2],
}

/// A file of points.
struct Points {
    path: PathBuf,
    options: RasterOptions,
    grid: Grid,
    state: FileState,
}

/// The bytes at a file's start that tell whether it has points.
const START_BYTES: u64 = 2048;

/// Returns true for the extension of such files, and for text whose first lines are points, after one of names at most.
pub(crate) fn is_xyz(path: &Path) -> Result<bool, GenError> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("xyz")) {
        return Ok(true);
    }
    let mut start = Vec::new();
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    file.take(START_BYTES).read_to_end(&mut start).map_err(GenError::file(path))?;
    let Ok(text) = std::str::from_utf8(&start) else { return Ok(false) };
    let mut lines: Vec<&str> = text.lines().collect();
    // The last one may be cut off.
    if start.len() as u64 == START_BYTES {
        lines.pop();
    }
    let mut lines = lines.into_iter().filter(|line| !line.trim().is_empty()).peekable();
    lines.next_if(|line| point(line).is_none());
    let found: Vec<bool> = lines.take(3).map(|line| point(line).is_some()).collect();
    Ok(found.len() == 3 && found.iter().all(|is_point| *is_point))
}

/// Returns the point of a line. Numbers may have a decimal comma where blanks or semicolons are between them.
fn point(line: &str) -> Option<[f64; 3]> {
    let line = line.trim_start_matches('\u{feff}');
    let words = |between: fn(char) -> bool| {
        line.split(between).map(|word| word.trim_matches([',', '"'])).filter(|word| !word.is_empty())
    };
    let apart: Vec<&str> = words(|c| c.is_whitespace() || c == ';').take(3).collect();
    let number = |word: &str| word.parse().or_else(|_| word.replacen(',', ".", 1).parse()).ok();
    let found = match apart[..] {
        [x, y, z] => [number(x), number(y), number(z)],
        _ => {
            let mut numbers = words(|c| c == ',' || c == ';' || c.is_whitespace()).map(|word| word.parse().ok());
            [numbers.next()?, numbers.next()?, numbers.next()?]
        }
    };
    let [Some(x), Some(y), Some(z)] = found else { return None };
    let is_finite = |n: &f64| n.is_finite();
    [x, y].iter().all(is_finite).then_some([x, y, z])
}

/// Opens a file and reads its points once, to find the grid.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let state = FileState::of(path)?;
    let mut found = Found::default();
    each_point(path, |[x, y, _]| {
        found.add(x, y);
        Ok(())
    })?;
    let grid = found.grid().map_err(|reason| bad(path, reason))?;
    let [dx, dy] = grid.step;
    let origin = [grid.west - 0.5 * dx, grid.north + 0.5 * dy];
    let transform = GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] };
    let placement = Placement::of_unnamed(path, transform, grid.size, options.crs.clone(), cache)?;
    let points = Points { path: path.to_owned(), options: options.clone(), grid, state };
    let (blocks, reader) = whole(Box::new(points), grid.size, cache);
    Ok(Opened { grid: blocks, reader, placement })
}

fn bad(path: &Path, reason: impl std::fmt::Display) -> GenError {
    GenError::invalid(path, format!("points: {reason}"))
}

/// Calls with each point of a file. A first line of names is passed over.
fn each_point(path: &Path, mut call: impl FnMut([f64; 3]) -> Result<(), String>) -> Result<(), GenError> {
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let mut text = BufReader::with_capacity(1 << 16, file);
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let read = (&mut text).take(MAX_LINE).read_until(b'\n', &mut line).map_err(GenError::file(path))?;
        if read == 0 {
            return Ok(());
        }
        let text = String::from_utf8_lossy(&line);
        match point(&text) {
            Some(point) => call(point).map_err(|reason| bad(path, format!("line {number}: {reason}")))?,
            None if number == 1 || text.trim().is_empty() => {}
            None => return Err(bad(path, format!("line {number} is not `x y z`"))),
        }
    }
    Ok(())
}

/// The bounds of points, and the smallest distances of one from the next.
struct Found {
    low: [f64; 2],
    high: [f64; 2],
    step: [f64; 2],
    last: Option<[f64; 2]>,
    count: usize,
}

impl Default for Found {
    fn default() -> Self {
        let infinite = [f64::INFINITY; 2];
        Self { low: infinite, high: infinite.map(|n| -n), step: infinite, last: None, count: 0 }
    }
}

impl Found {
    fn add(&mut self, x: f64, y: f64) {
        let at = [x, y];
        for axis in 0..2 {
            self.low[axis] = self.low[axis].min(at[axis]);
            self.high[axis] = self.high[axis].max(at[axis]);
            let step = self.last.map_or(0.0, |last| (at[axis] - last[axis]).abs());
            // Smaller distances are of numbers that are rounded.
            if step > 1e-9 * at[axis].abs().max(1.0) {
                self.step[axis] = self.step[axis].min(step);
            }
        }
        self.last = Some(at);
        self.count += 1;
    }

    /// The error is the reason.
    fn grid(&self) -> Result<Grid, String> {
        if self.step.iter().any(|step| !step.is_finite()) {
            return Err("fewer than 2 x 2 points".to_owned());
        }
        let sides = [0, 1].map(|axis| ((self.high[axis] - self.low[axis]) / self.step[axis]).round() + 1.0);
        let cells = sides[0] * sides[1];
        if cells > MAX_CELLS || cells > CELLS_PER_POINT * self.count as f64 {
            let [width, height] = sides;
            return Err(format!(
                "{} points are not a grid of {width} x {height} cells; gdal_grid makes one",
                self.count
            ));
        }
        // The rounding of coordinates is spread over all cells.
        let step = [0, 1].map(|axis| (self.high[axis] - self.low[axis]) / (sides[axis] - 1.0));
        Ok(Grid { west: self.low[0], north: self.high[1], step, size: sides.map(|side| side as usize) })
    }
}

impl WholeReader for Points {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        self.state.check(&self.path)?;
        let Grid { west, north, step, size: [width, height] } = self.grid;
        let mut heights = vec![f32::NAN.to_bits(); width * height];
        each_point(&self.path, |[x, y, z]| {
            let at = [(x - west) / step[0], (north - y) / step[1]];
            let [column, row] = at.map(|c| c.round().max(0.0) as usize);
            if at.iter().any(|c| (c - c.round()).abs() > TOLERANCE) || column >= width || row >= height {
                return Err(format!("{x}, {y} is beside the grid of the other points"));
            }
            heights[row * width + column] = self.options.height_m(z as f32).to_bits();
            Ok(())
        })?;
        call(&heights)
    }

    fn path(&self) -> &Path {
        &self.path
    }
}
