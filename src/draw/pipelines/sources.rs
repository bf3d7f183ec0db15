//! The sources of the shaders, concatenated from the files in `shaders/`. Sources named `SHADOWED_` receive the sun's shadows,
//! or cast them. Draw thread and pipeline thread.

/// Concatenates files of `shaders/` in their order.
macro_rules! wgsl {
    [$($folder:ident / $name:ident),+] => {
        concat!($(include_str!(concat!("../shaders/", stringify!($folder), "/", stringify!($name), ".wgsl"))),+)
    };
}

/// The source of height tiles, followed by further files.
macro_rules! height_wgsl {
    [$shadows:ident, $($folder:ident / $name:ident),+] => {
        wgsl![shared / air, shared / frame, shared / $shadows, shared / facets, heights / height, $($folder / $name),+]
    };
}

/// The source of meshes without glTF's materials, followed by further files.
macro_rules! mesh_wgsl {
    [$shadows:ident $(, $folder:ident / $name:ident)*] => {
        wgsl![
            shared / air,
            shared / frame,
            shared / $shadows,
            shared / facets,
            meshes / mesh_vertex,
            meshes / matte_fragment,
            meshes / mesh_pull,
            meshes / mesh,
            meshes / matte
            $(, $folder / $name)*
        ]
    };
}

/// The source of meshes with glTF's materials, plain or layered ones.
macro_rules! surface_wgsl {
    [$shadows:ident, $record:ident, $layers:ident] => {
        wgsl![
            shared / air,
            shared / frame,
            shared / $shadows,
            shared / facets,
            meshes / surface_vertex,
            meshes / surface_fragment,
            meshes / mesh_pull,
            meshes / mesh,
            meshes / $record,
            meshes / surface,
            meshes / $layers
        ]
    };
}

/// The source of height tiles in fixed function.
macro_rules! fixed_height_wgsl {
    [$shadows:ident, $units:ident] => {
        height_wgsl![$shadows, fixed_function / fixed, fixed_function / $units, fixed_function / fixed_height]
    };
}

/// The source of meshes in fixed function without texture units.
macro_rules! fixed_mesh_wgsl {
    [$shadows:ident] => {
        mesh_wgsl![
            $shadows,
            fixed_function / fixed,
            fixed_function / fixed_no_units,
            fixed_function / untextured_mesh,
            fixed_function / fixed_mesh
        ]
    };
}

/// The source of meshes in fixed function with texture units.
macro_rules! textured_mesh_wgsl {
    [$shadows:ident] => {
        wgsl![
            shared / air,
            shared / frame,
            shared / $shadows,
            shared / facets,
            fixed_function / textured_mesh,
            meshes / mesh_pull,
            meshes / mesh,
            meshes / matte,
            fixed_function / fixed,
            fixed_function / fixed_units,
            fixed_function / fixed_mesh
        ]
    };
}

pub(super) const HEIGHT_WGSL: &str = height_wgsl![no_shadows, heights / height_shading];
pub(super) const SHADOWED_HEIGHT_WGSL: &str = height_wgsl![shadows, heights / height_shading];
pub(super) const MESH_WGSL: &str = mesh_wgsl![no_shadows];
pub(super) const SHADOWED_MESH_WGSL: &str = mesh_wgsl![shadows, meshes / mesh_casters];
pub(super) const SURFACE_WGSL: &str = surface_wgsl![no_shadows, plain_record, plain_layers];
pub(super) const SHADOWED_SURFACE_WGSL: &str = surface_wgsl![shadows, plain_record, plain_layers];
pub(super) const LAYERED_SURFACE_WGSL: &str = surface_wgsl![no_shadows, layered_record, layers];
pub(super) const SHADOWED_LAYERED_SURFACE_WGSL: &str = surface_wgsl![shadows, layered_record, layers];
pub(super) const FIXED_HEIGHT_WGSL: &str = fixed_height_wgsl![no_shadows, fixed_no_units];
pub(super) const SHADOWED_FIXED_HEIGHT_WGSL: &str = fixed_height_wgsl![shadows, fixed_no_units];
pub(super) const TEXTURED_HEIGHT_WGSL: &str = fixed_height_wgsl![no_shadows, fixed_units];
pub(super) const SHADOWED_TEXTURED_HEIGHT_WGSL: &str = fixed_height_wgsl![shadows, fixed_units];
pub(super) const FIXED_MESH_WGSL: &str = fixed_mesh_wgsl![no_shadows];
pub(super) const SHADOWED_FIXED_MESH_WGSL: &str = fixed_mesh_wgsl![shadows];
pub(super) const TEXTURED_MESH_WGSL: &str = textured_mesh_wgsl![no_shadows];
pub(super) const SHADOWED_TEXTURED_MESH_WGSL: &str = textured_mesh_wgsl![shadows];
pub(super) const SPLAT_WGSL: &str = wgsl![shared / air, shared / frame, splats / splat];
pub(super) const FILL_WGSL: &str = wgsl![shared / air, shared / frame, passes / fill];
pub(super) const SKY_WGSL: &str = wgsl![shared / air, shared / frame, passes / sky];
pub(super) const WATER_WGSL: &str =
    wgsl![shared / air, shared / frame, shared / no_shadows, passes / sky, passes / water];
pub(super) const SHADOWED_WATER_WGSL: &str =
    wgsl![shared / air, shared / frame, shared / shadows, passes / sky, passes / water];
pub(in crate::draw) const DISPLAY_WGSL: &str = wgsl![shared / air, shared / frame, passes / display];
pub(super) const QUERY_WGSL: &str = wgsl![shared / air, shared / frame, passes / query];
/// The prelude of programs on meshes.
pub(super) const PROGRAM_PRELUDE: &str = wgsl![shared / air, shared / frame, shared / shadows, meshes / mesh_vertex];
/// The prelude of programs on height tiles.
pub(super) const HEIGHT_PROGRAM_PRELUDE: &str =
    wgsl![shared / air, shared / frame, shared / shadows, heights / height, heights / height_vertex];
/// The prelude for the shaders of a [`CustomDrawable`](crate::draw::CustomDrawable).
///
/// It declares bind group 0 with `frame`, `leaves` (by instance) and `stage`, and the functions of
/// `frame.wgsl` and `shadows.wgsl` in `src/draw/shaders/shared`: `point_in_eye`, `direction_in_eye`, `normal_in_eye`,
/// `above_ground`, `light`, `sun_shadow`, `aerial`, `through_air`, `tone_mapped`, `displayed`.
pub const DRAWABLE_PRELUDE: &str = wgsl![shared / air, shared / frame, shared / shadows];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::uniforms::fixed::{FixedUniform, Reflection};
    use crate::draw::uniforms::frame::{FrameUniform, LeafUniform};
    use crate::draw::uniforms::stage::{StageLight, StageUniform};
    use crate::gpu::{LayeredRecord, SurfaceRecord, VertexFormat};
    use crate::scene::{SPLAT_SIGMAS, Splat, SplatHarmonics};

    fn parse(name: &str, source: &str) -> naga::Module {
        let module =
            naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(source)));
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{name}: {e:?}"));
        module
    }

    fn members(module: &naga::Module, name: &str) -> (u32, Vec<(String, u32)>) {
        let found = module.types.iter().find_map(|(_, ty)| match &ty.inner {
            naga::TypeInner::Struct { members, span } if ty.name.as_deref() == Some(name) => {
                let members = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect();
                Some((*span, members))
            }
            _ => None,
        });
        found.unwrap_or_else(|| panic!("no struct {name}"))
    }

    macro_rules! offsets {
        ($ty:ty: $($field:ident),*) => { vec![$((stringify!($field).to_string(), std::mem::offset_of!($ty, $field) as u32)),*] };
    }

    #[test]
    fn shaders_are_valid_and_their_structs_are_mirrored() {
        let all = [
            ("height", HEIGHT_WGSL),
            ("mesh", MESH_WGSL),
            ("fixed height", FIXED_HEIGHT_WGSL),
            ("fixed mesh", FIXED_MESH_WGSL),
            ("fixed height with textures", TEXTURED_HEIGHT_WGSL),
            ("fixed mesh with textures", TEXTURED_MESH_WGSL),
            ("splats", SPLAT_WGSL),
            ("sky", SKY_WGSL),
            ("water", WATER_WGSL),
            ("query", QUERY_WGSL),
            ("display", DISPLAY_WGSL),
            ("fill", FILL_WGSL),
            ("program", PROGRAM_PRELUDE),
            ("program of height tiles", HEIGHT_PROGRAM_PRELUDE),
            ("drawable", DRAWABLE_PRELUDE),
            ("shadowed height", SHADOWED_HEIGHT_WGSL),
            ("shadowed mesh", SHADOWED_MESH_WGSL),
            ("fixed height with shadows", SHADOWED_FIXED_HEIGHT_WGSL),
            ("fixed mesh with shadows", SHADOWED_FIXED_MESH_WGSL),
            ("fixed height with textures and shadows", SHADOWED_TEXTURED_HEIGHT_WGSL),
            ("fixed mesh with textures and shadows", SHADOWED_TEXTURED_MESH_WGSL),
            ("shadowed water", SHADOWED_WATER_WGSL),
            ("surface", SURFACE_WGSL),
            ("shadowed surface", SHADOWED_SURFACE_WGSL),
            ("layered surface", LAYERED_SURFACE_WGSL),
            ("shadowed layered surface", SHADOWED_LAYERED_SURFACE_WGSL),
        ];
        parse("atmosphere", crate::draw::passes::air::tables::ATMOSPHERE_WGSL);
        for (name, source) in all {
            let module = parse(name, source);
            let (span, fields) = members(&module, "Frame");
            assert_eq!(span as usize, size_of::<FrameUniform>(), "{name}");
            assert_eq!(
                fields,
                offsets!(FrameUniform: clip_from_eye, sun_direction, sun_color, ambient_color, up, horizon_color,
                    shape, ray, middle_ray, water, air, sun_top, night, shadow_x, shadow_y, shadow,
                    cascade_scales, cascade_offsets)
            );
            let (span, fields) = members(&module, "Leaf");
            assert_eq!(span as usize, size_of::<LeafUniform>(), "{name}");
            let rows = std::mem::offset_of!(LeafUniform, eye_from_drawable) as u32;
            assert_eq!(fields[..3].iter().map(|f| f.1).collect::<Vec<_>>(), [rows, rows + 16, rows + 32]);
            assert_eq!(fields[3..], offsets!(LeafUniform: color, layer, flags, alpha_cutoff, side));
            let (span, fields) = members(&module, "Stage");
            assert_eq!(span as usize, size_of::<StageUniform>(), "{name}");
            assert_eq!(fields, offsets!(StageUniform: lights, clip_planes, light_count, volume));
            let (span, fields) = members(&module, "StageLight");
            assert_eq!(span as usize, size_of::<StageLight>(), "{name}");
            assert_eq!(fields, offsets!(StageLight: position, direction, ambient, diffuse, specular, attenuation));
            if name.ends_with("surface") {
                let (span, fields) = members(&module, "SurfaceRecord");
                let mut expected = offsets!(SurfaceRecord: layers, factors, emission, occlusion_uv_bits_overlay, uv_matrices, uv_offsets);
                let mut size = size_of::<SurfaceRecord>();
                if name.contains("layered") {
                    assert_eq!(std::mem::offset_of!(LayeredRecord, plain), 0);
                    expected
                        .extend(offsets!(LayeredRecord: dielectric, coat, layer_maps, layer_matrices, layer_offsets));
                    size = size_of::<LayeredRecord>();
                }
                assert_eq!(span as usize, size, "{name}");
                assert_eq!(fields, expected, "{name}");
            }
            if name.starts_with("fixed") {
                let (span, fields) = members(&module, "Fixed");
                assert_eq!(span as usize, size_of::<FixedUniform>(), "{name}");
                assert_eq!(
                    fields,
                    offsets!(FixedUniform: front, back, fog_color, fog, model_ambient, model, flags, units, texgens,
                        bias, planes, envs, env_colors, matrices, borders, border_colors)
                );
                let (span, fields) = members(&module, "Reflection");
                assert_eq!(span as usize, size_of::<Reflection>(), "{name}");
                assert_eq!(fields, offsets!(Reflection: ambient, diffuse, specular, emission));
            }
        }
    }

    #[test]
    fn constants_are_mirrored() {
        use crate::draw::uniforms::frame::{
            BAND_OF_BACKDROP, BAND_OF_VOLUME, BAND_SHIFT, FLAG_UNLIT, FLAG_UNTEXTURED, INDEX_COUNT_SHIFT,
        };
        let header = crate::gpu::TABLE_HEADER_VECTORS;
        assert!(HEIGHT_WGSL.contains(&format!("const HEADER: u32 = {header}u;")));
        assert!(HEIGHT_WGSL.contains(&format!("n <= {}u", crate::scene::MORPH_LEVELS)));
        for (name, value) in [
            ("STAGE_LIGHTS", crate::state::LIGHTS as u32),
            ("BAND_SHIFT", BAND_SHIFT),
            ("BAND_OF_VOLUME", BAND_OF_VOLUME),
            ("BAND_OF_BACKDROP", BAND_OF_BACKDROP),
            ("FLAG_UNLIT", FLAG_UNLIT),
            ("FLAG_UNTEXTURED", FLAG_UNTEXTURED),
            ("INDEX_COUNT_SHIFT", INDEX_COUNT_SHIFT),
        ] {
            assert!(MESH_WGSL.contains(&format!("const {name}: u32 = {value}u;")), "{name}");
        }
        assert!(SURFACE_WGSL.contains(&format!("const NO_LAYER: u32 = {:#x}u;", SurfaceRecord::NO_LAYER)));
        assert_eq!(VertexFormat::Full.stride(), 7 * 4);
        assert_eq!(size_of::<Splat>(), 9 * 4);
        assert!(SPLAT_WGSL.contains(&format!("const SPLAT_SIGMAS: f32 = {SPLAT_SIGMAS:?};")));
        let [one, two, three] = [1, 2, 3].map(SplatHarmonics::words_of);
        let words = format!("select(select({three}u, {two}u, degree == 2u), {one}u, degree == 1u)");
        assert!(SPLAT_WGSL.contains(&words), "{words}");
        let linear = format!("const LINEAR_HARMONICS: u32 = {}u;", crate::gpu::LINEAR_HARMONICS);
        assert!(SPLAT_WGSL.contains(&linear), "{linear}");
    }
}
