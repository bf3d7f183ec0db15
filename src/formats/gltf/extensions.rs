//! The glTF extensions that this reader knows.

/// Extensions that are read. Their readers note what they leave out.
const SUPPORTED: &[&str] = &[
    "CESIUM_RTC",
    "CESIUM_primitive_outline",
    "EXT_mesh_gpu_instancing",
    "EXT_mesh_primitive_restart",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_gaussian_splatting",
    "KHR_gaussian_splatting_compression_spz",
    "KHR_gaussian_splatting_compression_spz_2",
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_spz_compression",
    "KHR_spz_gaussian_splats_compression",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "MSFT_texture_dds",
    "WEB3D_quantized_attributes",
];

/// Extensions without which a glTF is still drawn sensibly, so that it is not refused if it requires them; so are all that
/// refine materials. They are noted.
const DISPENSABLE: &[&str] = &[
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "EXT_texture_avif",
    "FB_ngon_encoding",
    "KHR_animation_pointer",
    "KHR_interactivity",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_techniques_webgl",
    "KHR_xmp_json_ld",
    "MSFT_lod",
];

/// Extensions that are read if features are kept, and need no note otherwise: the application did not ask for them.
const FEATURES: &[&str] = &["EXT_instance_features", "EXT_mesh_features", "EXT_structural_metadata"];

/// Returns true if the extension is read in full, or needs no note.
pub(super) fn is_supported(name: &str) -> bool {
    SUPPORTED.contains(&name) || FEATURES.contains(&name)
}

/// Returns true if a glTF may require the extension.
pub(super) fn may_be_required(name: &str) -> bool {
    is_supported(name) || DISPENSABLE.contains(&name) || name.starts_with("KHR_materials_")
}
