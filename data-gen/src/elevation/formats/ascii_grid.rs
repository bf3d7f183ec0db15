//! ASCII grids of ESRI and GDAL: a header of names and numbers, then the samples, north row first.

use std::path::Path;

use super::super::raster::Raster;
use super::{MAX_SAMPLES, RasterOptions};
use crate::GenError;
use crate::georeference::{GeoTransform, Placement};

/// Reads an ASCII grid.
pub(super) fn read(path: &Path, options: &RasterOptions) -> Result<Raster, GenError> {
    let bytes = std::fs::read(path).map_err(GenError::file(path))?;
    let text = String::from_utf8_lossy(&bytes);
    let bad = |reason: String| GenError::invalid(path, format!("ASCII grid: {reason}"));
    let (size, transform, samples) = parse(&text, options).map_err(bad)?;
    let placement = Placement::of_unnamed(path, transform, size, options.crs.clone())?;
    Ok(Raster::new(size, samples, placement))
}

/// Parses the header and the heights in metres. The error is the reason.
fn parse(text: &str, options: &RasterOptions) -> Result<([usize; 2], GeoTransform, Vec<f32>), String> {
    let mut header: Vec<(String, f64)> = Vec::new();
    let mut words = text.split_ascii_whitespace().peekable();
    // The first word that is a number begins the samples; the header's words are names such as "ncols".
    while let Some(name) = words.next_if(|word| word.parse::<f64>().is_err()) {
        let value = words.next().ok_or_else(|| format!("no value of {name}"))?;
        let number = value.parse().map_err(|_| format!("{name} is `{value}`, not a number"))?;
        header.push((name.to_ascii_lowercase(), number));
    }
    let value = |name: &str| header.iter().find(|(other, _)| other == name).map(|(_, value)| *value);
    let needed = |name: &str| value(name).ok_or_else(|| format!("no {name} in the header"));
    let side = |name: &str| {
        let count = needed(name)?;
        let is_valid = count.fract() == 0.0 && (1.0..=MAX_SAMPLES as f64).contains(&count);
        if is_valid { Ok(count as usize) } else { Err(format!("{name} is {count}")) }
    };
    let (width, height) = (side("ncols")?, side("nrows")?);
    let count = width.checked_mul(height).filter(|count| *count <= MAX_SAMPLES);
    let count = count.ok_or_else(|| format!("{width} x {height} samples"))?;
    let cell = value("cellsize");
    let step = |name: &str| cell.or_else(|| value(name)).ok_or_else(|| "no cellsize in the header".to_owned());
    let (dx, dy) = (step("dx")?, step("dy")?);
    // Corners are those of the south-western cell; centres are half a cell inside.
    let edge = |corner: &str, center: &str, step: f64| match (value(corner), value(center)) {
        (Some(edge), _) => Ok(edge),
        (None, Some(center)) => Ok(center - 0.5 * step),
        (None, None) => Err(format!("neither {corner} nor {center} in the header")),
    };
    let (west, south) = (edge("xllcorner", "xllcenter", dx)?, edge("yllcorner", "yllcenter", dy)?);
    // The format's own value where the header names none.
    let nodata = value("nodata_value").unwrap_or(-9999.0);
    let mut samples = Vec::new();
    for word in words {
        let sample: f64 = word.parse().map_err(|_| format!("sample {} is `{word}`", samples.len() + 1))?;
        samples.push(if sample == nodata { f32::NAN } else { options.height_m(sample as f32) });
    }
    if samples.len() != count {
        return Err(format!("{} samples for {width} x {height}", samples.len()));
    }
    let origin = [west, south + dy * height as f64];
    Ok(([width, height], GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] }, samples))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_and_centres_place_the_same_grid() {
        let grid = |place: &str| format!("ncols 3\nNROWS 2\n{place}\nNODATA_value -1\n1 2 3\r\n4 -1 6.5\n");
        let options = RasterOptions::default();
        let (size, transform, samples) = parse(&grid("xllcorner 7\nyllcorner 45\ncellsize 0.5"), &options).unwrap();
        assert_eq!(
            (size, transform.origin, transform.dx, transform.dy),
            ([3, 2], [7.0, 46.0], [0.5, 0.0], [0.0, -0.5])
        );
        assert_eq!(samples[..4], [1.0, 2.0, 3.0, 4.0]);
        assert!(samples[4].is_nan() && samples[5] == 6.5);
        let (_, centred, _) = parse(&grid("xllcenter 7.25\nyllcenter 45.25\ndx 0.5\ndy 0.5"), &options).unwrap();
        assert_eq!(centred, transform);
    }

    #[test]
    fn wrong_headers_and_counts_are_refused() {
        let all = "ncols 2\nnrows 2\nxllcorner 7\nyllcorner 45\ncellsize 1\n";
        for (text, why) in [
            ("ncols 40\nnrows 40\n".to_owned(), "no cellsize"),
            (all.replace("nrows 2", "nrows -2") + "1 2 3 4", "nrows is -2"),
            (all.replace("ncols 2", "ncols 1e9").replace("nrows 2", "nrows 9") + "1", "samples"),
            (all.replace("xllcorner", "xll") + "1 2 3 4", "neither xllcorner nor xllcenter"),
            (all.to_owned() + "1 2 3", "3 samples for 2 x 2"),
            (all.to_owned() + "1 2 3 high", "sample 4 is `high`"),
            (all.replace("cellsize 1", "cellsize wide"), "cellsize is `wide`"),
        ] {
            let error = parse(&text, &RasterOptions::default()).err().unwrap();
            assert!(error.contains(why), "{error}, not {why}");
        }
    }
}
