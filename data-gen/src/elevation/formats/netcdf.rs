//! netCDF with elevation, of the classic formats and of netCDF-4: GEBCO, ETOPO, grids of GMT, and what GDAL writes. A variable
//! with heights has two axes, whose coordinates are variables of their names (the CF conventions).

use std::path::{Path, PathBuf};
use std::sync::Arc;

use netcdf_reader::masked::MaskParams;
use netcdf_reader::unpack::{SignParams, UnpackParams};
use netcdf_reader::{FileStorage, NcFile, NcFormat, NcOpenOptions, NcSliceInfo, NcSliceInfoElem, NcType, NcVariable};

use super::super::context::SourceContext;
use super::{MAX_SAMPLES, Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::{GeoTransform, Metadata, Placement, named_unit_m};
use crate::store::{BlockGrid, BlockReader, FileState, Rect, WholeReader, whole};

/// The largest number of coordinates of an axis, which are read at once.
const MAX_SIDE: u64 = 1 << 22;
/// The largest number of samples in a block.
const MAX_BLOCK: usize = 1 << 20;
/// The side of blocks that hold several small chunks.
const SIDE: usize = 256;
/// The most rows of a block of a file without chunks.
const MAX_ROWS: usize = 64;
/// The largest chunk in bytes, and the bytes of decoded chunks that a file keeps.
const MAX_CHUNK_BYTES: usize = 256 << 20;
const CHUNK_CACHE_BYTES: usize = 16 << 20;
/// The largest distance of a coordinate from an evenly spaced one, in cells.
const TOLERANCE: f64 = 0.05;
/// The values of samples that were never written, in files that name no other.
const FILL_I16: f64 = -32767.0;
const FILL_I8: f64 = -127.0;

/// The variable with heights.
#[derive(Clone)]
struct Heights {
    name: String,
    /// The number of axes before those of the grid. Each has one coordinate, such as a single time.
    before: usize,
    size: [usize; 2],
    /// The value of samples that were never written.
    fill: Option<f64>,
    /// Metres for each unit; negative for depths.
    unit_m: f64,
    transform: GeoTransform,
    /// The reference system, if the file names one.
    system: Option<String>,
    /// True if coordinates are metres.
    is_projected: bool,
}

/// A file, which is opened again if too many others were opened since.
struct NetCdf {
    path: PathBuf,
    number: u64,
    heights: Heights,
    /// The rows of the steps in which a file is read that cannot be read by blocks.
    step: usize,
    options: RasterOptions,
    state: FileState,
    context: Arc<SourceContext>,
}

/// Opens a file and finds the variable with heights.
pub(super) fn open(path: &Path, options: &RasterOptions, context: &Arc<SourceContext>) -> Result<Opened, GenError> {
    let bad = |reason: String| bad(path, &reason);
    let state = FileState::of(path)?;
    let number = context.netcdfs.new_file();
    let file = context.netcdfs.file(number, || open_file(path))?;
    let heights = Heights::find(&file, options.channel.as_deref()).map_err(bad)?;
    if heights.is_projected && heights.system.is_none() && options.crs.is_none() {
        return Err(bad("coordinates in metres, and no reference system; --epsg CODE names it".to_owned()));
    }
    let metadata = match &heights.system {
        Some(text) => Metadata::of_system(path, text),
        None => Metadata::beside(path, &context.cache)?,
    };
    let (size, transform) = (heights.size, heights.transform);
    let placement = Placement::of_header(path, transform, size, options.crs.clone(), &metadata, &context.cache)?;
    let chunk = chunk_of(path, &file, &heights).map_err(bad)?;
    let reader = NetCdf {
        path: path.to_owned(),
        number,
        heights,
        step: chunk.map_or(1, |[_, rows]| rows),
        options: options.clone(),
        state,
        context: Arc::clone(context),
    };
    let block = match chunk {
        None => [size[0], (MAX_BLOCK / size[0]).clamp(1, MAX_ROWS)],
        // Large chunks would be decoded once for each of their blocks.
        Some([width, height]) if width.saturating_mul(height) > MAX_BLOCK => {
            let (grid, reader) = whole(Box::new(reader), size, &context.cache);
            return Ok(Opened { grid, reader, placement });
        }
        Some([width, height]) => {
            let several = |side: usize, other: usize| side * (SIDE / side.max(1)).clamp(1, MAX_BLOCK / (side * other));
            let width = several(width, height);
            [width, several(height, width)]
        }
    };
    Ok(Opened { grid: BlockGrid::new(size, block), reader: Box::new(reader), placement })
}

fn bad(path: &Path, reason: &dyn std::fmt::Display) -> GenError {
    GenError::invalid(path, format!("netCDF: {reason}"))
}

/// Opens a file without mapping it into memory, since another program may cut it off.
fn open_file(path: &Path) -> Result<NcFile, GenError> {
    let storage = FileStorage::open(path).map_err(|e| bad(path, &e))?;
    let options = NcOpenOptions {
        chunk_cache_bytes: CHUNK_CACHE_BYTES,
        max_chunk_bytes: MAX_CHUNK_BYTES,
        ..NcOpenOptions::default()
    };
    NcFile::from_storage_with_options(Arc::new(storage), options).map_err(|e| bad(path, &e))
}

/// Returns the width and height of the chunks of a variable; `None` for one without chunks. The error is the reason.
fn chunk_of(path: &Path, file: &NcFile, heights: &Heights) -> Result<Option<[usize; 2]>, String> {
    if !matches!(file.format(), NcFormat::Nc4 | NcFormat::Nc4Classic) {
        return Ok(None);
    }
    let storage = FileStorage::open(path).map_err(|e| e.to_string())?;
    let file = hdf5_reader::Hdf5File::from_storage(Arc::new(storage)).map_err(|e| e.to_string())?;
    let chunks = file.dataset(&heights.name).map_err(|e| e.to_string())?.chunks();
    let at = |axis: usize| chunks.as_ref()?.get(heights.before + axis).map(|side| *side as usize);
    // In the order of the file: rows first.
    Ok(at(0).zip(at(1)).map(|(rows, columns)| [columns.clamp(1, heights.size[0]), rows.clamp(1, heights.size[1])]))
}

impl Heights {
    /// Finds the variable of a name, or the only one with heights. The error is the reason.
    fn find(file: &NcFile, name: Option<&str>) -> Result<Self, String> {
        let all = file.variables().map_err(|e| e.to_string())?;
        if let Some(name) = name {
            let variable = file.variable(name).map_err(|_| {
                let names: Vec<&str> = all.iter().map(NcVariable::name).collect();
                format!("no variable `{name}`; it has {}", names.join(", "))
            })?;
            return Self::of(file, variable, name);
        }
        let grids: Vec<&NcVariable> = all.iter().filter(|variable| is_grid(file, variable)).collect();
        match grids[..] {
            [variable] => Self::of(file, variable, variable.name()),
            [] => Err("no variable with a grid of heights, whose two axes have coordinates".to_owned()),
            _ => {
                let names: Vec<&str> = grids.iter().map(|variable| variable.name()).collect();
                Err(format!("{} variables with grids, --channel NAME chooses one: {}", grids.len(), names.join(", ")))
            }
        }
    }

    fn of(file: &NcFile, variable: &NcVariable, name: &str) -> Result<Self, String> {
        if !is_number(variable.dtype()) {
            return Err(format!("`{name}` has no numbers"));
        }
        let [before @ .., rows, columns] = variable.dimensions() else {
            return Err(format!("`{name}` has {} axes; a grid has two", variable.ndim()));
        };
        if let Some(axis) = before.iter().find(|axis| axis.size != 1) {
            return Err(format!("`{name}` has {} grids along `{}`; elevation has one", axis.size, axis.name));
        }
        let axis = |name: &str| Axis::read(file, name);
        let (down, across) = (axis(&rows.name)?, axis(&columns.name)?);
        let count = rows.size.checked_mul(columns.size);
        if count.is_none_or(|count| count > MAX_SAMPLES as u64) {
            return Err(format!("{} x {} samples", columns.size, rows.size));
        }
        let system = system_of(file, variable);
        let in_km = |axis: &Axis| axis.unit == "km" && !system.as_ref().is_some_and(|text| text.contains("kilomet"));
        let scale = if in_km(&across) { 1000.0 } else { 1.0 };
        // Some programs write columns first.
        let (x, y) = if across.is_north && !down.is_north { (1, 0) } else { (0, 1) };
        let along = |axis: &Axis, to: usize| {
            let mut step = [0.0; 2];
            step[to] = axis.step * scale;
            step
        };
        let (dx, dy) = (along(&across, x), along(&down, y));
        let mut origin = [0.0; 2];
        origin[x] = across.first * scale - 0.5 * dx[x];
        origin[y] = down.first * scale - 0.5 * dy[y];
        let text = |name: &str| variable.attribute(name).and_then(|attribute| attribute.value.as_string());
        let unit = text("units").unwrap_or_default();
        let unit = unit.trim_matches(|c: char| c.is_whitespace() || c == '\0');
        let unit_m = match named_unit_m(unit) {
            Some(metres) => metres,
            // A number without a unit.
            None if unit == "1" => 1.0,
            None => return Err(format!("`{name}` is in units of `{}`", unit.escape_debug())),
        };
        let is_depth = text("positive").is_some_and(|direction| direction.eq_ignore_ascii_case("down"));
        let has_fill = variable.attribute("_FillValue").is_some();
        let fill = match variable.dtype() {
            NcType::Short => Some(FILL_I16),
            NcType::Byte => Some(FILL_I8),
            _ => None,
        };
        Ok(Self {
            name: name.to_owned(),
            before: before.len(),
            size: [columns.size as usize, rows.size as usize],
            fill: fill.filter(|_| !has_fill),
            unit_m: if is_depth { -unit_m } else { unit_m },
            transform: GeoTransform { origin, dx, dy },
            system,
            is_projected: named_unit_m(&across.unit).is_some() && !across.unit.is_empty(),
        })
    }
}

fn is_number(kind: &NcType) -> bool {
    kind.is_primitive() && !matches!(kind, NcType::Char | NcType::String)
}

/// Returns true if a variable has numbers on a grid whose two axes have coordinates, and one value along each other axis.
fn is_grid(file: &NcFile, variable: &NcVariable) -> bool {
    let has_coordinates = |name: &str| file.coordinate_variable(name).is_ok_and(|found| is_number(found.dtype()));
    match variable.dimensions() {
        [before @ .., rows, columns] => {
            is_number(variable.dtype())
                && before.iter().all(|axis| axis.size == 1)
                && [rows, columns].into_iter().all(|axis| has_coordinates(&axis.name))
        }
        _ => false,
    }
}

/// Returns the reference system that the variable of a grid's `grid_mapping` names.
fn system_of(file: &NcFile, variable: &NcVariable) -> Option<String> {
    let mapping = variable.attribute("grid_mapping")?.value.as_string()?;
    // The long form has the names of coordinates after a colon.
    let mapping = mapping.split([':', ' ']).next()?;
    let mapping = file.variable(mapping).ok()?;
    let names = ["crs_wkt", "spatial_ref", "proj4", "proj4text", "proj4_params"];
    let texts = names.iter().filter_map(|name| mapping.attribute(name)?.value.as_string());
    texts.map(|text| text.trim_end_matches('\0').trim().to_owned()).find(|text| !text.is_empty())
}

/// The coordinates of an axis.
struct Axis {
    /// The first coordinate, and the distance from one to the next.
    first: f64,
    step: f64,
    unit: String,
    /// True for latitudes and northings.
    is_north: bool,
}

impl Axis {
    /// Reads the coordinates of a dimension. The error is the reason.
    fn read(file: &NcFile, name: &str) -> Result<Self, String> {
        let missing = || format!("the axis `{name}` has no coordinates");
        let variable =
            file.coordinate_variable(name).ok().filter(|found| is_number(found.dtype())).ok_or_else(missing)?;
        let count = variable.num_elements().map_err(|e| e.to_string())?;
        if !(2..=MAX_SIDE).contains(&count) {
            return Err(format!("{count} places along `{name}`"));
        }
        let found = file.read_variable_unpacked(name).map_err(|e| e.to_string())?;
        let at: Vec<f64> = found.into_iter().collect();
        let (Some(first), Some(last)) = (at.first().copied(), at.last().copied()) else { return Err(missing()) };
        let step = (last - first) / (count - 1) as f64;
        let is_even = |(k, at): (usize, &f64)| (at - (first + step * k as f64)).abs() <= TOLERANCE * step.abs();
        if !(step.is_finite() && step != 0.0 && at.len() as u64 == count && at.iter().enumerate().all(is_even)) {
            return Err(format!("the coordinates of `{name}` are not evenly spaced; gdalwarp converts the file"));
        }
        let text = |name: &str| variable.attribute(name).and_then(|attribute| attribute.value.as_string());
        let unit = text("units").unwrap_or_default().trim_matches(['\0', ' ']).to_owned();
        let is_y = |text: Option<String>, starts: &[&str]| {
            text.is_some_and(|text| starts.iter().any(|start| text.to_ascii_lowercase().starts_with(start)))
        };
        let is_north = is_y(Some(unit.clone()), &["degrees_north", "degree_north"])
            || is_y(text("axis"), &["y"])
            || is_y(text("standard_name"), &["latitude", "projection_y", "grid_latitude"])
            || is_y(Some(name.to_owned()), &["lat", "y", "north"]);
        let unit = if ["kilometre", "kilometer", "kilometers", "kilometres"].contains(&&*unit) {
            "km".to_owned()
        } else {
            unit
        };
        Ok(Self { first, step, unit, is_north })
    }
}

impl NetCdf {
    /// Reads the samples of a rectangle, as heights in metres.
    fn samples(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        self.state.check(&self.path)?;
        let file = self.context.netcdfs.file(self.number, || open_file(&self.path))?;
        let slice = |start: usize, count: usize| NcSliceInfoElem::Slice {
            start: start as u64,
            end: (start + count) as u64,
            step: 1,
        };
        let mut selections = vec![slice(0, 1); self.heights.before];
        selections.extend([slice(block.row, block.height), slice(block.column, block.width)]);
        let bad_nc = |e: netcdf_reader::Error| bad(&self.path, &e);
        let variable = file.variable(&self.heights.name).map_err(bad_nc)?;
        let found = file.read_variable_slice_as_f64(&self.heights.name, &NcSliceInfo { selections });
        let mut found = found.map_err(bad_nc)?;
        if found.len() != block.pixels() {
            return Err(bad(&self.path, &format!("{} samples for {} x {}", found.len(), block.width, block.height)));
        }
        // The values as they are stored tell what is unknown.
        let is_unknown = |sample: f64| {
            let known = [self.heights.fill, self.options.nodata, Some(f64::from(i16::MIN))];
            known.iter().flatten().any(|unknown| sample == *unknown)
        };
        if let Some(sign) = SignParams::from_variable(variable) {
            sign.apply(&mut found);
        }
        found.mapv_inplace(|sample| if is_unknown(sample) { f64::NAN } else { sample });
        if let Some(mask) = MaskParams::from_variable(variable) {
            mask.apply(&mut found);
        }
        if let Some(units) = UnpackParams::from_variable(variable) {
            units.apply(&mut found);
        }
        let height_m = |value: f64| self.options.scaled_m((value * self.heights.unit_m) as f32);
        Ok(height_bits(found.into_iter().map(height_m).collect()))
    }
}

impl BlockReader for NetCdf {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        self.samples(block)
    }
}

impl WholeReader for NetCdf {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let [width, height] = self.heights.size;
        for row in (0..height).step_by(self.step) {
            call(&self.samples(Rect { column: 0, row, width, height: self.step.min(height - row) })?)?;
        }
        Ok(())
    }

    fn path(&self) -> &Path {
        &self.path
    }
}
