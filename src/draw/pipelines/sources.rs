//! The sources of the shaders, put together from their files. What begins with `SHADOWED` receives the sun's shadows,
//! or casts them.

/// Files of `shaders/` in order.
macro_rules! wgsl {
    [$($name:ident),+] => {
        concat!($(include_str!(concat!("../shaders/", stringify!($name), ".wgsl"))),+)
    };
}

pub(super) const HEIGHT_WGSL: &str = wgsl![air, frame, no_shadows, facets, height];
pub(super) const SHADOWED_HEIGHT_WGSL: &str = wgsl![air, frame, shadows, facets, height, height_shadowed];
pub(super) const MESH_WGSL: &str = wgsl![air, frame, no_shadows, facets, mesh_vertex, mesh_pull, mesh];
pub(super) const SHADOWED_MESH_WGSL: &str =
    wgsl![air, frame, shadows, facets, mesh_vertex, mesh_pull, mesh, mesh_casters];
pub(super) const FIXED_HEIGHT_WGSL: &str =
    wgsl![air, frame, no_shadows, facets, height, fixed, fixed_no_units, fixed_height];
pub(super) const SHADOWED_FIXED_HEIGHT_WGSL: &str =
    wgsl![air, frame, shadows, facets, height, fixed, fixed_no_units, fixed_height];
pub(super) const TEXTURED_HEIGHT_WGSL: &str =
    wgsl![air, frame, no_shadows, facets, height, fixed, fixed_units, fixed_height];
pub(super) const SHADOWED_TEXTURED_HEIGHT_WGSL: &str =
    wgsl![air, frame, shadows, facets, height, fixed, fixed_units, fixed_height];
pub(super) const FIXED_MESH_WGSL: &str =
    wgsl![air, frame, no_shadows, facets, mesh_vertex, mesh_pull, mesh, fixed, fixed_no_units, fixed_mesh];
pub(super) const SHADOWED_FIXED_MESH_WGSL: &str =
    wgsl![air, frame, shadows, facets, mesh_vertex, mesh_pull, mesh, fixed, fixed_no_units, fixed_mesh];
pub(super) const TEXTURED_MESH_WGSL: &str =
    wgsl![air, frame, no_shadows, facets, mesh_vertex, mesh_pull, mesh, fixed, fixed_units, fixed_mesh];
pub(super) const SHADOWED_TEXTURED_MESH_WGSL: &str =
    wgsl![air, frame, shadows, facets, mesh_vertex, mesh_pull, mesh, fixed, fixed_units, fixed_mesh];
pub(super) const FILL_WGSL: &str = wgsl![air, frame, fill];
pub(super) const SKY_WGSL: &str = wgsl![air, frame, sky];
pub(super) const WATER_WGSL: &str = wgsl![air, frame, no_shadows, sky, water];
pub(super) const SHADOWED_WATER_WGSL: &str = wgsl![air, frame, shadows, sky, water];
pub(super) const QUERY_WGSL: &str = wgsl![air, frame, query];
/// What stands before the source of a program.
pub(in crate::draw) const PROGRAM_PRELUDE: &str = wgsl![air, frame, shadows, mesh_vertex];
/// The same for height tiles.
pub(in crate::draw) const HEIGHT_PROGRAM_PRELUDE: &str = wgsl![air, frame, shadows, height, height_vertex];
/// What stands before the shaders of a drawable of the application's own
/// ([`CustomDrawable`](crate::draw::CustomDrawable)): bind group 0 with `frame`, `leaves` (by instance) and `stage`, and
/// the functions of `src/draw/shaders/frame.wgsl` and `shadows.wgsl`: `point_in_eye`, `direction_in_eye`,
/// `normal_in_eye`, `above_ground`, `light`, `sun_shadow`, `aerial`, `through_air`, `tone_mapped`.
pub const DRAWABLE_PRELUDE: &str = wgsl![air, frame, shadows];

/// The fragment shader that does the same in a part of the pixels. Apart, so that where nothing fades nothing is
/// discarded, and depth is tested before shading.
pub(super) fn fading(fragment: &'static str) -> &'static str {
    match fragment {
        "fs_height" => "fs_height_fading",
        "fs_height_shadowed" => "fs_height_shadowed_fading",
        "fs_mesh" => "fs_mesh_fading",
        "fs_mesh_masked" => "fs_mesh_masked_fading",
        "fs_mesh_blended" => "fs_mesh_blended_fading",
        "fs_mesh_masked_blended" => "fs_mesh_masked_blended_fading",
        "fs_thin" => "fs_thin_fading",
        "fs_fixed_height" => "fs_fixed_height_fading",
        "fs_fixed_mesh" => "fs_fixed_mesh_fading",
        "fs_fixed_thin" => "fs_fixed_thin_fading",
        other => other,
    }
}
