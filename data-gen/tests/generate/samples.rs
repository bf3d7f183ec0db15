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
        let found = raster.range_m();
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
            imagery: name.contains("rainier").then(|| imagery.clone()),
            levels: Some(2),
            ..GenArgs::new(out.path().join(name))
        };
        let summary = run(&args).unwrap();
        let [low, high] = raster.range_m().map(f64::from);
        assert_eq!(summary.tiles, 5, "{name}");
        assert!(summary.min_height_m >= low - 0.01 && summary.max_height_m <= high + 0.01, "{name}: {summary}");
        assert!(summary.max_height_m - summary.min_height_m > 0.4 * (high - low), "{name}: {summary}");
        let found = region(&tileset(&args.out)["root"]);
        for (found, wanted) in found.iter().zip(raster.bounds()) {
            assert!((found - wanted).abs() < 1e-9, "{name}");
        }
    }
}
