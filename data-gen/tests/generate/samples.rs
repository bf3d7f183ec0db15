//! Reads real elevation files beside the repository. Without them the tests are skipped with a message.

use std::path::PathBuf;

use crate::files::{region, tileset};
use kit::skip::skipped;
use terrane_data_gen::{GenArgs, Raster, run};

fn samples() -> Option<PathBuf> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/samples/dem");
    if !folder.is_dir() {
        skipped(format!("no sample elevation files at {}", folder.display()));
        return None;
    }
    Some(folder)
}

/// An elevation file with its known properties.
struct Truth {
    name: &'static str,
    size: [usize; 2],
    /// The lowest and the highest sample according to GDAL.
    range_m: [f32; 2],
    /// A point inside the file, longitude and latitude in degrees.
    inside: [f64; 2],
}

const fn truth(name: &'static str, size: [usize; 2], range_m: [f32; 2], inside: [f64; 2]) -> Truth {
    Truth { name, size, range_m, inside }
}

const TRUTHS: [Truth; 7] = [
    truth("N42E001.hgt", [1201, 1201], [349.0, 3100.0], [1.5, 42.5]),
    truth("mt_rainier_90m.tif", [1201, 1201], [263.0, 4371.0], [-121.76, 46.85]),
    truth("jacksboro_srtm_int16_deflate_pred2.tif", [403, 344], [236.0, 1076.0], [-84.2, 36.6]),
    truth("sf_elev_float32_3857.tif", [512, 512], [0.4, 114.9], [-122.42, 37.80]),
    truth("kilauea_utm5n_30m_int16_lzw.tif", [857, 793], [0.0, 1505.0], [-155.25, 19.4]),
    truth("pysheds_dem_int16_tiled16.tif", [367, 359], [147.0, 298.0], [-97.3, 32.8]),
    truth("fuji_terrain_rgb_mapbox.png", [512, 512], [0.0, 3800.0], [8.05, 46.95]),
];

#[test]
fn rasters_have_the_properties_that_gdal_reports() {
    let Some(folder) = samples() else { return };
    for Truth { name, size, range_m, inside: [longitude, latitude] } in TRUTHS {
        let raster = Raster::read(&folder.join(name)).unwrap();
        assert_eq!(raster.size(), size, "{name}");
        let found = raster.range_m().unwrap();
        if name.ends_with("png") {
            assert!(found[0] >= range_m[0] && found[1] <= range_m[1], "{name}: {found:?}");
        } else {
            assert!((0..2).all(|k| (found[k] - range_m[k]).abs() < 0.1), "{name}: {found:?}");
        }
        let b = raster.bounds().map(f64::to_degrees);
        assert!(b[0] < longitude && longitude < b[2] && b[1] < latitude && latitude < b[3], "{name}: {b:?}");
    }
}

#[test]
fn each_sample_file_becomes_a_set_with_its_heights() {
    let Some(folder) = samples() else { return };
    let out = tempfile::tempdir().unwrap();
    let imagery = folder.join("imagery_world_rgb.tif");
    let exr = ["terrain3d_mountain1_Y_float.exr", "terrain3d_terrain1_rgba_half.exr"];
    for name in TRUTHS.iter().map(|t| t.name).chain(exr) {
        let path = folder.join(name);
        let raster = Raster::read(&path).unwrap();
        let args = GenArgs {
            dem: vec![path],
            imagery: name.contains("rainier").then(|| imagery.clone()).into_iter().collect(),
            levels: Some(2),
            ..GenArgs::new(out.path().join(name))
        };
        let summary = run(&args).unwrap();
        let [low, high] = raster.range_m().unwrap().map(f64::from);
        assert_eq!(summary.tiles, 5, "{name}");
        assert!(summary.min_height_m >= low - 0.01 && summary.max_height_m <= high + 0.01, "{name}: {summary}");
        assert!(summary.max_height_m - summary.min_height_m > 0.4 * (high - low), "{name}: {summary}");
        let found = region(&tileset(&args.out)["root"]);
        for (found, wanted) in found.iter().zip(raster.bounds()) {
            assert!((found - wanted).abs() < 1e-9, "{name}");
        }
    }
}

/// Runs inputs that once failed, each with the result that its README asks for.
#[test]
fn inputs_that_failed_are_right() {
    let Some(folder) = samples().map(|folder| folder.join("../cases")) else { return };
    let out = tempfile::tempdir().unwrap();
    let args = |name: &str, dem: &str| GenArgs {
        dem: vec![folder.join(name).join(dem)],
        ..GenArgs::new(out.path().join(name))
    };
    let globe = args("dem-globe-0-360", "globe.tif");
    run(&globe).unwrap();
    let found = region(&tileset(&globe.out)["root"]);
    assert!((found[2] - found[0] - std::f64::consts::TAU).abs() < 1e-6, "{found:?}");
    run(&args("dem-sparse-tiles", "sparse.tif")).unwrap();
    let island = run(&args("dem-void-is-invented", "island.tif")).unwrap();
    assert!(island.cut_samples > 10_000 && island.filled_samples == 0, "{island}");
    let tall = run(&args("heights-over-12-km", "decimetres.tif")).unwrap();
    assert!(tall.max_height_m > 12_000.0 && tall.cut_samples == 0 && !tall.notes.is_empty(), "{tall}");
    let with_image = |name: &str, image: &str| {
        let args = args(name, "dem.tif");
        let args = GenArgs { imagery: vec![folder.join(name).join(image)], overwrite: true, ..args };
        let levels = run(&args).unwrap().levels;
        (levels, image::open(args.out.join("0/0/0.jpg")).unwrap().into_rgb8())
    };
    assert_eq!(with_image("imagery-finer-than-dem", "ortho.tif").0, 5);
    let [(_, ycbcr), (_, rgb)] = ["ortho.tif", "same_rgb.tif"].map(|image| with_image("imagery-jpeg-ycbcr", image));
    // The middles of checks of 32 pixels.
    for (x, y) in [(48, 48), (208, 48), (48, 208), (208, 208)] {
        let (a, b) = (ycbcr.get_pixel(x, y).0, rgb.get_pixel(x, y).0);
        assert!((0..3).all(|c| a[c].abs_diff(b[c]) < 20), "{x} {y}: {a:?} and {b:?}");
    }
    let (_, collar) = with_image("imagery-nodata", "ortho.tif");
    // The collar is in the west; the south-east of the image has dark checks.
    let west = collar.enumerate_pixels().filter(|(x, ..)| *x < 70);
    let black = west.filter(|(.., pixel)| pixel.0.iter().all(|c| *c < 12)).count();
    assert_eq!(black, 0, "of 70 x 256 pixels");
}
