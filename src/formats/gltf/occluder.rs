//! Occluders in glTF files: polygons that the author guarantees to be hidden by a node's mesh.
//!
//! `extras.terrane.occluder` of a node is `{"corners": [[x, y, z], …], "holes": [[[x, y, z], …], …]}`: a convex plane
//! polygon with convex holes in the node's frame, in metres and y-up. Other glTF readers ignore it.

use glam::DVec3;
use serde::Deserialize;

use crate::fetch::IoError;
use crate::scene::ConvexPlanarOccluder;

/// The maximum number of corners of a polygon, and of holes.
const MAX_COUNT: usize = 64;
/// The maximum distance of corners from the plane, relative to the size of the polygon.
const PLANE_TOLERANCE: f64 = 1e-3;

#[derive(Deserialize)]
struct Extras {
    terrane: Option<OwnExtras>,
}

#[derive(Deserialize)]
struct OwnExtras {
    occluder: Option<Shape>,
}

#[derive(Deserialize)]
struct Shape {
    corners: Vec<[f64; 3]>,
    #[serde(default)]
    holes: Vec<Vec<[f64; 3]>>,
}

/// Returns the occluder in the extras of a node.
pub(super) fn of_node(uri: &str, node: usize, extras: &str) -> Result<Option<ConvexPlanarOccluder>, IoError> {
    // Extras may be any JSON; most belong to other programs.
    if !extras.contains("\"occluder\"") || !extras.contains("\"terrane\"") || !extras.trim_start().starts_with('{') {
        return Ok(None);
    }
    let bad = |reason: String| IoError::invalid(uri, format!("glTF: extras.terrane.occluder of node {node}: {reason}"));
    let extras: Extras = serde_json::from_str(extras).map_err(|e| bad(e.to_string()))?;
    let Some(Shape { corners, holes }) = extras.terrane.and_then(|own| own.occluder) else { return Ok(None) };
    if holes.len() > MAX_COUNT {
        return Err(bad(format!("{} holes, {MAX_COUNT} at most", holes.len())));
    }
    let corners = polygon(&corners).map_err(&bad)?;
    let holes = holes.iter().map(|h| polygon(h).map_err(&bad)).collect::<Result<_, _>>()?;
    Ok(Some(ConvexPlanarOccluder { corners, holes }))
}

/// Checks that the corners form a convex plane polygon.
fn polygon(corners: &[[f64; 3]]) -> Result<Vec<DVec3>, String> {
    if !(3..=MAX_COUNT).contains(&corners.len()) {
        return Err(format!("{} corners, 3 to {MAX_COUNT} are needed", corners.len()));
    }
    let corners: Vec<DVec3> = corners.iter().map(|c| DVec3::from_array(*c)).collect();
    let count = corners.len() as f64;
    let middle = corners.iter().sum::<DVec3>() / count;
    let size_m = corners.iter().map(|c| c.distance(middle)).fold(0.0, f64::max);
    let after = |i: usize| corners[(i + 1) % corners.len()];
    let normal = (0..corners.len()).map(|i| (corners[i] - middle).cross(after(i) - middle)).sum::<DVec3>();
    let Some(normal) = normal.try_normalize().filter(|_| size_m.is_finite()) else {
        return Err("the corners span no area".to_owned());
    };
    if corners.iter().any(|c| (*c - middle).dot(normal).abs() > PLANE_TOLERANCE * size_m) {
        return Err("the corners do not lie in a plane".to_owned());
    }
    let turns_back = |i: usize| {
        let (before, next) = (after(i) - corners[i], after(i + 1) - after(i));
        before.cross(next).dot(normal) < -PLANE_TOLERANCE * before.length() * next.length()
    };
    if (0..corners.len()).any(turns_back) {
        return Err("the polygon is not convex".to_owned());
    }
    Ok(corners)
}
