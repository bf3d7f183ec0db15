//! `terrane info` of what a service has: the templates of map servers, assets of Cesium ion, Google's tiles.

use anyhow::{Result, bail};
use terrane::fetch::services::ServiceKind;
use terrane::fetch::shown;
use terrane::formats::{BoundsInfo, GeoRectangle, Info, OverlaySource, RasterOverlay, Tiling};
use terrane::math::WGS84;

use crate::args::InfoArgs;
use crate::net::Opened;
use crate::overlays::OverlayArg;

/// Returns true for the address of images with placeholders.
pub fn is_template(source: &str) -> bool {
    source.contains('{') && !std::path::Path::new(source).exists()
}

/// Describes a template. Nothing is requested.
pub fn of_template(args: &InfoArgs) -> Result<Info> {
    let source = &args.source;
    let overlay = match source.parse() {
        Ok(OverlayArg(overlay)) => overlay,
        Err(reason) => bail!("{}: {reason}", shown(source)),
    };
    if args.verify || args.map.is_some() {
        bail!("{}: a template names no tiles that could be read", shown(source));
    }
    Ok(describe(&overlay))
}

fn describe(overlay: &RasterOverlay) -> Info {
    let mut info = Info { format: "raster overlay (template)".to_owned(), ..Info::default() };
    let RasterOverlay { source, tiling, min_level, max_level, tile_px, rectangle, credit, .. } = overlay;
    let mut detail = |name: &str, text: String| info.details.insert(name.to_owned(), text);
    let projection = match tiling {
        Tiling::WebMercator => "Web Mercator (EPSG:3857)",
        Tiling::Geographic => "geographic (EPSG:4326)",
    };
    detail("tiling", projection.to_owned());
    detail("levels", format!("{min_level} to {max_level}, as far as the template says; levels=MIN-MAX sets others"));
    detail("images", format!("{tile_px} x {tile_px} pixels"));
    detail("address", shown(overlay.address()).into_owned());
    if let OverlaySource::Template { subdomains, .. } = source
        && !subdomains.is_empty()
    {
        detail("hosts", subdomains.join(", "));
    }
    if credit.is_none() {
        detail("terms", "a template names no owner; credit=TEXT does".to_owned());
    }
    let region = rectangle.as_ref().map(|GeoRectangle { west, south, east, north }| vec![*west, *south, *east, *north]);
    info.bounds = BoundsInfo { center: [0.0; 3], radius_m: WGS84.semi_major_m, region };
    info.attribution = credit.as_deref().map(str::to_owned);
    info
}

/// Adds what a service says, and which key it asks for. Keys are not printed.
pub fn add_service(info: &mut Info, source: &str, opened: &Opened) {
    let Some(kind) = opened.kind else { return };
    let (name, key) = match source {
        "google" => ("Google, Photorealistic 3D Tiles".to_owned(), "--google-key or GOOGLE_MAPS_API_KEY"),
        _ => (format!("Cesium ion, asset {}", source.trim_start_matches("ion:")), "--ion-token or CESIUM_ION_TOKEN"),
    };
    let kind = match kind {
        ServiceKind::Tiles => "3D Tiles",
        ServiceKind::Terrain => "terrain",
        ServiceKind::Imagery => "imagery, for --overlay",
    };
    info.details.insert("service".to_owned(), format!("{name}: {kind}"));
    info.details.insert("key".to_owned(), format!("given by {key}; each request needs it"));
    let own = info.attribution.take();
    let credits: Vec<String> = opened.attributions.iter().cloned().chain(own).collect();
    info.attribution = (!credits.is_empty()).then(|| credits.join("; "));
}
