//! Heights of a geoid above the ellipsoid, from the grids of PROJ in the formats GTX and GeoTIFF.
//!
//! A GTX file has a header of big-endian numbers (south and west in degrees, the steps north and east in degrees as f64; rows
//! and columns as i32), then f32 heights in metres, southern row first.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use super::grid_tiff;
use crate::GenError;

/// The value of points without data.
const NODATA: f32 = -88.8888;
const HEADER_BYTES: usize = 40;
/// The folders of PROJ's grids, beside those that the environment names.
const FOLDERS: [&str; 2] = ["/usr/share/proj", "/usr/local/share/proj"];
/// The type of GeoTIFFs with heights of a geoid.
const GEOID: &str = "VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL";
/// The names of their channel.
const CHANNELS: [&str; 2] = ["geoid_undulation", "hydroid_height"];

/// The surface that heights of elevation files are measured from.
#[derive(Clone, Debug, PartialEq)]
pub enum VerticalDatum {
    /// The ellipsoid of WGS84: heights are used as they are.
    Ellipsoid,
    /// A geoid: its height above the ellipsoid is added. The name of a grid of PROJ (`egm96`, `egm2008`,
    /// `us_noaa_g2018u0.tif`), or a file, GTX or GeoTIFF.
    Geoid(PathBuf),
}

impl VerticalDatum {
    /// Reads `ellipsoid`, the name of a grid or its path.
    pub fn parse(text: &str) -> Result<Self, String> {
        Ok(if text.eq_ignore_ascii_case("ellipsoid") { Self::Ellipsoid } else { Self::Geoid(text.into()) })
    }

    /// Reads the grid; `None` for the ellipsoid.
    pub(crate) fn geoid(&self) -> Result<Option<Geoid>, GenError> {
        let Self::Geoid(path) = self else { return Ok(None) };
        let names = match path.to_str().map(str::to_ascii_lowercase).as_deref() {
            Some("egm96") => vec![Path::new("egm96_15.gtx"), Path::new("us_nga_egm96_15.tif")],
            Some("egm2008") => vec![Path::new("egm08_25.gtx"), Path::new("us_nga_egm08_25.tif")],
            _ if path.components().count() == 1 && !path.exists() => vec![path.as_path()],
            _ => return Geoid::read(path).map(Some),
        };
        let variables = ["PROJ_DATA", "PROJ_LIB"].into_iter().filter_map(std::env::var_os).map(PathBuf::from);
        let user = std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".local/share/proj"));
        let folders: Vec<PathBuf> = variables.chain(user).chain(FOLDERS.map(PathBuf::from)).collect();
        let paths = names.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
        match paths.into_iter().find(|path| path.is_file()) {
            Some(path) => Geoid::read(&path).map(Some),
            None => {
                let names: Vec<_> = names.iter().map(|name| name.display().to_string()).collect();
                let places = format!("PROJ_DATA, PROJ_LIB, ~/.local/share/proj, {}", FOLDERS.join(" or "));
                let names = names.join(" or ");
                Err(GenError::Argument(format!("--vertical-datum {}: no {names} in {places}", path.display())))
            }
        }
    }
}

impl std::fmt::Display for VerticalDatum {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Ellipsoid => write!(f, "WGS84 ellipsoid"),
            Self::Geoid(path) => write!(f, "{}", path.display()),
        }
    }
}

/// Grids of geoid heights in memory. Where they overlap, the later one is the finer one.
pub(crate) struct Geoid {
    grids: Vec<Grid>,
}

/// A grid of geoid heights.
struct Grid {
    /// Longitude and latitude of the south-western point in radians.
    origin: [f64; 2],
    /// The distance between points, east and north, in radians.
    step: [f64; 2],
    columns: usize,
    rows: usize,
    /// True if the grid reaches around the earth.
    is_global: bool,
    heights_m: Vec<f32>,
}

impl Geoid {
    /// Reads a GTX or a GeoTIFF file.
    pub fn read(path: &Path) -> Result<Self, GenError> {
        GenError::if_not_regular(path)?;
        let bytes = std::fs::read(path).map_err(GenError::file(path))?;
        if !grid_tiff::is_tiff(&bytes) {
            let grid = Grid::decode(&bytes);
            let grid = grid.map_err(|reason| GenError::invalid(path, format!("GTX grid: {reason}")))?;
            return Ok(Self { grids: vec![grid] });
        }
        drop(bytes);
        let (mut grids, mut channel) = (Vec::new(), 0);
        for image in grid_tiff::open(path, GEOID)? {
            match image.channel(&CHANNELS) {
                Some(named) => channel = named,
                // A further image may have other values.
                None if image.has_names() && !grids.is_empty() => continue,
                None if image.has_names() || channel >= image.channels() => {
                    return Err(GenError::invalid(path, format!("no channel {}", CHANNELS.join(" or "))));
                }
                None => {}
            }
            let heights_m = image.values(channel, 1.0)?;
            let ([columns, rows], step) = (image.size, image.step.map(f64::to_radians));
            grids.push(Grid {
                origin: image.south_west.map(f64::to_radians),
                step,
                columns,
                rows,
                is_global: step[0] * columns as f64 > TAU - 0.5 * step[0],
                heights_m,
            });
        }
        Ok(Self { grids })
    }

    /// Returns the height of the geoid above the ellipsoid in metres at a longitude and latitude in radians, interpolated
    /// between four points. `None` outside of the grids and beside points without data.
    pub fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64> {
        self.grids.iter().rev().find_map(|grid| grid.height_m(longitude, latitude))
    }
}

impl Grid {
    fn decode(bytes: &[u8]) -> Result<Self, String> {
        let (header, data) = bytes.split_at_checked(HEADER_BYTES).ok_or("shorter than its header")?;
        let (numbers, counts) = header.split_at(32);
        let [south, west, dy, dx] = [0, 1, 2, 3].map(|k| f64::from_be_bytes(numbers.as_chunks().0[k]).to_radians());
        let [rows, columns] = [0, 1].map(|k| i32::from_be_bytes(counts.as_chunks().0[k]));
        let is_valid = south.abs() < 1.6 && west.abs() <= TAU && dx > 0.0 && dy > 0.0 && rows > 1 && columns > 1;
        if !is_valid {
            return Err("the header has no valid corner, steps and counts".to_owned());
        }
        let (rows, columns) = (rows as usize, columns as usize);
        if data.len() / 4 != rows.saturating_mul(columns) {
            return Err(format!("{} bytes for {columns} x {rows} heights", data.len()));
        }
        let heights_m = data.as_chunks().0.iter().map(|b| f32::from_be_bytes(*b)).collect();
        let is_global = dx * columns as f64 > TAU - 0.5 * dx;
        Ok(Self { origin: [west, south], step: [dx, dy], columns, rows, is_global, heights_m })
    }

    /// Like [`Geoid::height_m`].
    fn height_m(&self, longitude: f64, latitude: f64) -> Option<f64> {
        let mut east = (longitude - self.origin[0]).rem_euclid(TAU);
        if !self.is_global && east > TAU - 1e-9 {
            east = 0.0;
        }
        let (x, y) = (east / self.step[0], (latitude - self.origin[1]) / self.step[1]);
        let (last_x, last_y) = ((self.columns - 1) as f64, (self.rows - 1) as f64);
        if (!self.is_global && x > last_x + 1e-6) || !(-1e-6..=last_y + 1e-6).contains(&y) {
            return None;
        }
        let y = y.clamp(0.0, last_y);
        let (i, j) = (x as usize, (y as usize).min(self.rows - 2));
        let (u, v) = (x - i as f64, y - j as f64);
        let at = |di: usize, dj: usize| {
            let column = if self.is_global { (i + di) % self.columns } else { (i + di).min(self.columns - 1) };
            let height_m = *self.heights_m.get((j + dj) * self.columns + column)?;
            ((height_m - NODATA).abs() > 1e-3 && height_m.is_finite()).then_some(f64::from(height_m))
        };
        let (south, north) = ((at(0, 0)?, at(1, 0)?), (at(0, 1)?, at(1, 1)?));
        let [south, north] = [south, north].map(|(a, b)| a + u * (b - a));
        Some(south + v * (north - south))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a grid whose heights are `10 + longitude + 2 * latitude`, in degrees from its corner.
    fn grid([south, west]: [f64; 2], step: f64, [rows, columns]: [i32; 2]) -> Vec<u8> {
        let mut bytes: Vec<u8> = [south, west, step, step].iter().flat_map(|n| n.to_be_bytes()).collect();
        bytes.extend([rows, columns].iter().flat_map(|n| n.to_be_bytes()));
        for k in 0..rows * columns {
            let (x, y) = (f64::from(k % columns) * step, f64::from(k / columns) * step);
            bytes.extend(((10.0 + x + 2.0 * y) as f32).to_be_bytes());
        }
        bytes
    }

    #[test]
    fn heights_are_interpolated_and_end_at_the_edges() {
        let geoid = Grid::decode(&grid([40.0, 5.0], 0.5, [5, 9])).unwrap();
        let at = |longitude: f64, latitude: f64| geoid.height_m(longitude.to_radians(), latitude.to_radians());
        for (x, y) in [(0.0, 0.0), (4.0, 2.0), (1.25, 0.75), (3.9, 1.1)] {
            let found = at(5.0 + x, 40.0 + y).unwrap();
            assert!((found - (10.0 + x + 2.0 * y)).abs() < 1e-6, "{x} {y}: {found}");
            assert_eq!(at(365.0 + x, 40.0 + y).map(|h| (h - found).abs() < 1e-6), Some(true));
        }
        assert_eq!([at(4.9, 41.0), at(9.1, 41.0), at(6.0, 39.9), at(6.0, 42.1)], [None; 4]);
        let mut holes = grid([40.0, 5.0], 0.5, [5, 9]);
        holes[HEADER_BYTES..HEADER_BYTES + 4].copy_from_slice(&NODATA.to_be_bytes());
        let geoid = Grid::decode(&holes).unwrap();
        assert_eq!(geoid.height_m(5.1f64.to_radians(), 40.1f64.to_radians()), None);
    }

    #[test]
    fn global_grids_have_no_ends() {
        let geoid = Grid::decode(&grid([-90.0, -180.0], 10.0, [19, 36])).unwrap();
        let at = |longitude: f64| geoid.height_m(longitude.to_radians(), 0.0).unwrap();
        // Halfway between the last column and the first.
        assert!((at(175.0) - 0.5 * (at(170.0) + at(-180.0))).abs() < 1e-6);
        assert!((at(180.0) - at(-180.0)).abs() < 1e-6 && (at(-185.0) - at(175.0)).abs() < 1e-6);
    }

    #[test]
    fn broken_grids_are_refused() {
        let good = grid([40.0, 5.0], 0.5, [5, 9]);
        for length in 0..good.len() {
            assert!(Grid::decode(&good[..length]).is_err(), "{length}");
        }
        for [rows, columns] in [[0, 9], [-5, 9], [i32::MAX, i32::MAX]] {
            let mut bytes = good.clone();
            bytes[32..36].copy_from_slice(&rows.to_be_bytes());
            bytes[36..40].copy_from_slice(&columns.to_be_bytes());
            assert!(Grid::decode(&bytes).is_err());
        }
        let mut bytes = good;
        bytes[0..8].copy_from_slice(&f64::NAN.to_be_bytes());
        assert!(Grid::decode(&bytes).is_err());
    }
}
