//! JPEG 2000 with elevation. The header is read when a file is opened; a thread of the run decodes the image as a whole.

use std::path::Path;
use std::sync::Arc;

use super::{Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::Metadata;
use crate::jpeg2000::{Component, Jpeg2000};
use crate::store::{BlockCache, WholeReader, whole};

/// The largest number of samples of all components, which are decoded at once: about those of a tile of Sentinel-2.
const MAX_SAMPLES: u64 = 1 << 27;
/// The most bits of a sample: heights are 32-bit floats.
const MAX_BITS: u8 = 24;

/// A file whose component has heights.
struct Heights {
    file: Jpeg2000,
    channel: usize,
    component: Component,
    options: RasterOptions,
    /// The factor and the offset that convert samples to metres.
    units: [f64; 2],
}

/// Opens a file and reads its boxes.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let file = Jpeg2000::open(path, MAX_SAMPLES)?;
    let channel = channel(&file.header.components, options.channel.as_deref()).map_err(|reason| file.bad(&reason))?;
    let component = file.header.components[channel];
    if component.bits > MAX_BITS || component.spacing != [1, 1] {
        let (bits, [wider, higher]) = (component.bits, component.spacing);
        let reason = format!("samples of {bits} bits, one in {wider} x {higher} pixels, which is not supported");
        return Err(file.bad(&reason));
    }
    let metadata = Metadata::beside(path, cache)?;
    let units = metadata.factor_and_offset_m(channel + 1).map_err(|reason| file.bad(&reason))?;
    let nodata = options.nodata.or(metadata.nodata_of(channel + 1));
    let placement = file.placement(options.crs.clone(), &metadata, cache)?;
    let placement = placement.ok_or_else(|| file.bad(&"no georeference: neither GeoJP2, GMLJP2, nor a world file"))?;
    let options = RasterOptions { nodata, ..options.clone() };
    let size = file.header.size;
    let (grid, reader) = whole(Box::new(Heights { file, channel, component, options, units }), size, cache);
    Ok(Opened { grid, reader, placement })
}

/// Returns the index of the component with heights. The error is the reason.
fn channel(components: &[Component], name: Option<&str>) -> Result<usize, String> {
    let count = components.len();
    match name {
        None if count == 1 => Ok(0),
        None => Err(format!("{count} components; elevation has one channel, --channel N chooses it")),
        Some(name) => {
            let number = name.parse().ok().filter(|n| (1..=count).contains(n));
            number
                .map(|number: usize| number - 1)
                .ok_or_else(|| format!("--channel {name}: the file has components 1 to {count}"))
        }
    }
}

impl WholeReader for Heights {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let Self { file, channel, component, options, units: [factor, offset] } = self;
        let count = file.header.components.len();
        let samples = file.decode(false, |decoded, _| match decoded.components() {
            found if found.len() == count => Ok(found[*channel].samples().to_vec()),
            found => Err(file.bad(&format!("{} components, not {count} as in the header", found.len()))),
        })?;
        // The decoder shifts signed samples as if they were not.
        let shift = if component.is_signed { (1u32 << (component.bits - 1)) as f32 } else { 0.0 };
        for row in samples.chunks_exact(file.header.size[0]) {
            let height_m = |sample: &f32| {
                let sample = (sample - shift).round();
                let is_unknown = options.nodata.is_some_and(|nodata| nodata as f32 == sample);
                let height_m = (f64::from(sample) * factor + offset) as f32;
                if is_unknown { f32::NAN } else { options.scaled_m(height_m) }
            };
            call(&height_bits(row.iter().map(height_m).collect()))?;
        }
        Ok(())
    }

    fn path(&self) -> &Path {
        self.file.path()
    }
}
