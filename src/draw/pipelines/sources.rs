//! The sources of the shaders, put together from their files. What begins with `SHADOWED` receives the sun's shadows,
//! or casts them.

pub(super) const HEIGHT_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/no_shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/height.wgsl")
);
pub(super) const SHADOWED_HEIGHT_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/height.wgsl"),
    include_str!("../shaders/height_shadowed.wgsl")
);
pub(super) const MESH_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/no_shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/mesh_vertex.wgsl"),
    include_str!("../shaders/mesh_pull.wgsl"),
    include_str!("../shaders/mesh.wgsl")
);
pub(super) const SHADOWED_MESH_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/mesh_vertex.wgsl"),
    include_str!("../shaders/mesh_pull.wgsl"),
    include_str!("../shaders/mesh.wgsl"),
    include_str!("../shaders/mesh_casters.wgsl")
);
pub(super) const FIXED_HEIGHT_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/no_shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/height.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_no_units.wgsl"),
    include_str!("../shaders/fixed_height.wgsl")
);
pub(super) const SHADOWED_FIXED_HEIGHT_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/height.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_no_units.wgsl"),
    include_str!("../shaders/fixed_height.wgsl")
);
pub(super) const TEXTURED_HEIGHT_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/no_shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/height.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_units.wgsl"),
    include_str!("../shaders/fixed_height.wgsl")
);
pub(super) const SHADOWED_TEXTURED_HEIGHT_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/height.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_units.wgsl"),
    include_str!("../shaders/fixed_height.wgsl")
);
pub(super) const FIXED_MESH_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/no_shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/mesh_vertex.wgsl"),
    include_str!("../shaders/mesh_pull.wgsl"),
    include_str!("../shaders/mesh.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_no_units.wgsl"),
    include_str!("../shaders/fixed_mesh.wgsl")
);
pub(super) const SHADOWED_FIXED_MESH_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/mesh_vertex.wgsl"),
    include_str!("../shaders/mesh_pull.wgsl"),
    include_str!("../shaders/mesh.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_no_units.wgsl"),
    include_str!("../shaders/fixed_mesh.wgsl")
);
pub(super) const TEXTURED_MESH_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/no_shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/mesh_vertex.wgsl"),
    include_str!("../shaders/mesh_pull.wgsl"),
    include_str!("../shaders/mesh.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_units.wgsl"),
    include_str!("../shaders/fixed_mesh.wgsl")
);
pub(super) const SHADOWED_TEXTURED_MESH_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/facets.wgsl"),
    include_str!("../shaders/mesh_vertex.wgsl"),
    include_str!("../shaders/mesh_pull.wgsl"),
    include_str!("../shaders/mesh.wgsl"),
    include_str!("../shaders/fixed.wgsl"),
    include_str!("../shaders/fixed_units.wgsl"),
    include_str!("../shaders/fixed_mesh.wgsl")
);
pub(super) const FILL_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/fill.wgsl")
);
pub(super) const SKY_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/sky.wgsl")
);
pub(super) const WATER_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/no_shadows.wgsl"),
    include_str!("../shaders/sky.wgsl"),
    include_str!("../shaders/water.wgsl")
);
pub(super) const SHADOWED_WATER_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/sky.wgsl"),
    include_str!("../shaders/water.wgsl")
);
pub(super) const QUERY_WGSL: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/query.wgsl")
);
/// What stands before the source of a program.
pub(in crate::draw) const PROGRAM_PRELUDE: &str = concat!(
    include_str!("../shaders/air.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/shadows.wgsl"),
    include_str!("../shaders/mesh_vertex.wgsl")
);
