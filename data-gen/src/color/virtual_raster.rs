//! Virtual rasters of GDAL with imagery.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::levels::{Level, Opened};
use crate::GenError;
use crate::georeference::{Crs, Placement};
use crate::store::{BlockCache, BlockReader, PixelImage, Rect};
use crate::virtual_raster::{
    MAX_DEPTH, Piece, VirtualImage, VirtualPixels, VirtualRaster, VirtualSource, Warp, WarpedImage, WarpedPixels,
};

/// Colours with opacity.
struct Colors;

impl VirtualPixels for Colors {
    const NONE: u32 = 0;

    fn is_some(pixel: u32) -> bool {
        pixel.to_ne_bytes()[3] > 0
    }

    /// The nearest one.
    fn between(corners: [u32; 4], [east, south]: [f64; 2]) -> u32 {
        corners[usize::from(east >= 0.5) + 2 * usize::from(south >= 0.5)]
    }
}

impl WarpedPixels for Colors {
    fn values(pixel: u32) -> ([f64; 3], f64) {
        let [r, g, b, opacity] = pixel.to_ne_bytes().map(f64::from);
        ([r, g, b], opacity / 255.0)
    }

    fn pixel([r, g, b]: [f64; 3], opacity: f64) -> u32 {
        u32::from_ne_bytes([r, g, b, 255.0 * opacity].map(|value| value.round().clamp(0.0, 255.0) as u8))
    }
}

/// The colours of a file in a virtual raster that gives it a colour without data.
struct Masked {
    file: Arc<PixelImage>,
    nodata: [u8; 3],
}

impl BlockReader for Masked {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let mut pixels = self.file.reader().read(block)?;
        let [r, g, b] = self.nodata;
        pixels
            .iter_mut()
            .filter(|pixel| matches!(pixel.to_ne_bytes(), [x, y, z, _] if [x, y, z] == [r, g, b]))
            .for_each(|pixel| *pixel = Colors::NONE);
        Ok(pixels)
    }
}

/// Opens an image file; the reference system is that of a file that names none.
type OpenFile<'a> = dyn Fn(&Path, Option<Crs>) -> Result<Opened, GenError> + Sync + 'a;

/// Opens a virtual raster of GDAL, which is inside of `depth` others. Its bands are those of its files, in the same order.
/// `open_file` opens one of these.
pub(super) fn open(
    path: &Path,
    given: Option<Crs>,
    cache: &Arc<BlockCache>,
    depth: usize,
    open_file: &OpenFile<'_>,
) -> Result<Opened, GenError> {
    let bad = |reason: &str| GenError::invalid(path, format!("VRT: {reason}"));
    if depth >= MAX_DEPTH {
        return Err(bad(&format!("more than {MAX_DEPTH} virtual rasters inside of one another, or a loop of them")));
    }
    let raster = VirtualRaster::open(path, cache)?;
    if let Some(warp) = &raster.warp {
        return open_warped(path, &raster, warp, given, cache, open_file);
    }
    let placement = Placement::of_virtual(path, &raster.metadata, raster.size, given.clone(), cache)?;
    let colors: Vec<_> = raster.bands.iter().filter(|band| !band.is_alpha).take(3).collect();
    // A loop over the sources of the first band covers all bands if each has the same ones.
    let is_copy = |k: usize, source: &VirtualSource| {
        colors.iter().enumerate().all(|(band, own)| {
            own.sources.get(k).is_some_and(|other| {
                (&other.path, other.from, other.to, other.band) == (&source.path, source.from, source.to, band + 1)
                    && other.factor_and_offset == [1.0, 0.0]
            })
        })
    };
    let piece = |(k, source): (usize, &VirtualSource)| {
        if !is_copy(k, source) {
            return Err(bad(
                "its bands are not the bands of its files in their order; gdal_translate writes it as GeoTIFF",
            ));
        }
        // The file's own georeference does not matter, and it need not have one.
        let crs = given.clone().or(Some(Crs::Geographic));
        let opened = open_file(&source.path, crs)?;
        let Some(finest) = opened.levels.into_iter().next() else { return Err(bad("a source without an image")) };
        let [from, to] = source.rectangles(finest.image.grid().size, raster.size);
        let nodata: Option<Vec<u8>> = colors.iter().map(|band| byte(band.sources.get(k)?.nodata?)).collect();
        let image = without(finest.image, nodata.as_deref(), cache);
        Ok(Piece { image, from, to })
    };
    let sources = colors.first().map(|band| &band.sources).ok_or_else(|| bad("no colours"))?;
    let pieces: Result<Vec<Piece>, GenError> = sources.par_iter().enumerate().map(piece).collect();
    let (grid, image) = VirtualImage::<Colors>::new(raster.size, pieces?);
    let level = Level::finest(PixelImage::new(grid, Box::new(image), cache));
    Ok(Opened { levels: vec![level], placement: placement.unwrap_or_default() })
}

/// Opens a virtual raster that resamples a file, whose bands are its own in the same order.
fn open_warped(
    path: &Path,
    raster: &VirtualRaster,
    warp: &Warp,
    given: Option<Crs>,
    cache: &Arc<BlockCache>,
    open_file: &OpenFile<'_>,
) -> Result<Opened, GenError> {
    let bad = |reason: &str| GenError::invalid(path, format!("VRT: {reason}"));
    let to = Placement::of_virtual(path, &raster.metadata, raster.size, given.clone(), cache)?;
    let to = to.ok_or_else(|| bad("no georeference"))?;
    let count = raster.bands.iter().filter(|band| !band.is_alpha).count().min(3);
    let of_band =
        |number: usize| warp.bands.iter().find(|(own, ..)| *own == number).map(|(_, band, nodata)| (*band, *nodata));
    let bands: Option<Vec<_>> = (1..=count).map(of_band).collect();
    let bands =
        bands.filter(|bands| !bands.is_empty() && bands.iter().zip(1..).all(|((own, _), number)| *own == number));
    let bands = bands.ok_or_else(|| {
        bad("its bands are not those of its file in their order; gdal_translate writes it as GeoTIFF")
    })?;
    // The file's own georeference does not matter, and it need not have one.
    let opened = open_file(&warp.path, given.clone().or(Some(Crs::Geographic)))?;
    let Some(finest) = opened.levels.into_iter().next() else { return Err(bad("a source without an image")) };
    let nodata: Option<Vec<u8>> = bands.iter().map(|(_, nodata)| byte((*nodata)?)).collect();
    let image = without(finest.image, nodata.as_deref(), cache);
    let from = warp.placement(path, &to, image.grid().size, given, cache)?;
    let (grid, image) = WarpedImage::<Colors>::new(image, raster.size, [from, to.clone()], warp.resampling);
    Ok(Opened { levels: vec![Level::finest(PixelImage::new(grid, Box::new(image), cache))], placement: to })
}

/// Returns the image of a file without the pixels of a colour: one number of grey, or three.
fn without(file: Arc<PixelImage>, nodata: Option<&[u8]>, cache: &Arc<BlockCache>) -> Arc<PixelImage> {
    match nodata {
        Some([grey]) => masked(file, [*grey; 3], cache),
        Some([r, g, b]) => masked(file, [*r, *g, *b], cache),
        _ => file,
    }
}

fn masked(file: Arc<PixelImage>, nodata: [u8; 3], cache: &Arc<BlockCache>) -> Arc<PixelImage> {
    Arc::new(PixelImage::new(file.grid(), Box::new(Masked { file, nodata }), cache))
}

/// Returns a whole number of 0..=255.
fn byte(number: f64) -> Option<u8> {
    ((0.0..=255.0).contains(&number) && number.fract() == 0.0).then_some(number as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Cursor;

    /// Returns a virtual raster that `gdalwarp -dstalpha -srcnodata "0 0 0"` wrote, of a file in UTM.
    fn warped(resampling: &str) -> String {
        let band = |number: usize, kind: &str| {
            format!(
                r#"<VRTRasterBand dataType="Byte" band="{number}" subClass="VRTWarpedRasterBand">
                <ColorInterp>{kind}</ColorInterp></VRTRasterBand>"#
            )
        };
        let bands: String =
            ["Red", "Green", "Blue", "Alpha"].iter().zip(1..).map(|(kind, number)| band(number, kind)).collect();
        let mapping = |number: usize| {
            format!(r#"<BandMapping src="{number}" dst="{number}"><SrcNoDataReal>0</SrcNoDataReal></BandMapping>"#)
        };
        let mappings: String = (1..=3).map(mapping).collect();
        format!(
            r#"<VRTDataset rasterXSize="14" rasterYSize="11" subClass="VRTWarpedDataset"><SRS>EPSG:4326</SRS>
            <GeoTransform>9.0002, 3.071428571429026e-04, 0, 46.9533, 0, -2.3636363636373144e-04</GeoTransform>{bands}
            <GDALWarpOptions><ResampleAlg>{resampling}</ResampleAlg><Option name="INIT_DEST">0</Option>
            <Option name="UNIFIED_SRC_NODATA">YES</Option><SourceDataset relativeToVRT="1">a.png</SourceDataset>
            <Transformer><ApproxTransformer><MaxError>0.125</MaxError><BaseTransformer><GenImgProjTransformer>
            <SrcGeoTransform>500000,30,0,5200000,0,-30</SrcGeoTransform><ReprojectTransformer><ReprojectionTransformer>
            <SourceSRS>EPSG:32632</SourceSRS></ReprojectionTransformer></ReprojectTransformer></GenImgProjTransformer>
            </BaseTransformer></ApproxTransformer></Transformer><BandList>{mappings}</BandList>
            <DstAlphaBand>4</DstAlphaBand></GDALWarpOptions></VRTDataset>"#
        )
    }

    fn open_png(path: &Path, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
        let open_file = |path: &Path, given| crate::color::files::open(path, given, cache);
        open(path, None, cache, 0, &open_file)
    }

    #[test]
    fn warped_colours_are_those_that_gdal_reads() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Arc::new(BlockCache::new(1 << 20));
        let color = |x: u32, y: u32| match (x, y) {
            (7, 4) => [0; 3],
            _ => [20 * x + 5, 25 * y + 3, 7 * x * y % 256].map(|c| c as u8),
        };
        let image = image::RgbImage::from_fn(12, 10, |x, y| image::Rgb(color(x, y)));
        image.save(folder.path().join("a.png")).unwrap();
        let path = folder.path().join("a.vrt");
        let places = [(0, 0), (3, 2), (6, 5), (10, 8), (7, 4)];
        for (resampling, colors) in [
            ("NearestNeighbour", [[5, 28, 0], [65, 78, 63], [105, 128, 175], [165, 203, 192], [125, 103, 168]]),
            ("Bilinear", [[13, 23, 2], [60, 66, 49], [106, 132, 183], [169, 198, 191], [122, 110, 176]]),
            ("Cubic", [[13, 23, 2], [60, 66, 49], [106, 132, 183], [169, 198, 196], [122, 110, 176]]),
        ] {
            std::fs::write(&path, warped(resampling)).unwrap();
            let Opened { levels, placement } = open_png(&path, &cache).unwrap();
            let corner = placement.longitude_latitude(0.0, 0.0).map(f64::to_degrees);
            assert!((corner[0] - 9.0002).abs() < 1e-9 && (corner[1] - 46.9533).abs() < 1e-9, "{corner:?}");
            let mut cursor = Cursor::new(&levels[0].image);
            for ((x, y), [r, g, b]) in places.into_iter().zip(colors) {
                let found = cursor.pixel(x, y).unwrap().to_ne_bytes();
                let is_near = found.iter().zip([r, g, b, 255]).all(|(a, b)| a.abs_diff(b) <= 1);
                assert!(is_near, "{resampling}: {found:?}, not {:?}, at {x}, {y}", [r, g, b]);
            }
            for (x, y) in [(8, 4), (9, 4), (13, 10)] {
                assert_eq!(cursor.pixel(x, y).unwrap(), Colors::NONE, "{resampling}: {x}, {y} has no data");
            }
        }
        let swapped = warped("Bilinear").replace(r#"src="1" dst="1""#, r#"src="3" dst="1""#);
        std::fs::write(&path, swapped).unwrap();
        let error = open_png(&path, &cache).err().unwrap().to_string();
        assert!(error.contains("its bands are not those of its file in their order"), "{error}");
    }
}
