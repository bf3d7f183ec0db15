//! Chooses the shader of a pipeline: its source and entry points. Plain values.

use super::key::{Alpha, Kind, PipelineKey, Shading};
use super::sources::{
    FIXED_HEIGHT_WGSL, FIXED_MESH_WGSL, HEIGHT_WGSL, LAYERED_SURFACE_WGSL, MESH_WGSL, SHADOWED_FIXED_HEIGHT_WGSL,
    SHADOWED_FIXED_MESH_WGSL, SHADOWED_HEIGHT_WGSL, SHADOWED_LAYERED_SURFACE_WGSL, SHADOWED_MESH_WGSL,
    SHADOWED_SURFACE_WGSL, SHADOWED_TEXTURED_HEIGHT_WGSL, SHADOWED_TEXTURED_MESH_WGSL, SPLAT_WGSL, SURFACE_WGSL,
    TEXTURED_HEIGHT_WGSL, TEXTURED_MESH_WGSL,
};

/// The vertex entry points of the renderer's own shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VertexEntry {
    Height,
    HeightCaster,
    FixedHeight,
    Mesh,
    PulledMesh,
    Square,
    MeshCaster,
    PulledMeshCaster,
    MaskedMeshCaster,
    FixedMesh,
    PulledFixedMesh,
    FixedSquare,
    Splat,
}

impl VertexEntry {
    /// Returns the name in the shader source.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Height => "vs_height",
            Self::HeightCaster => "vs_height_caster",
            Self::FixedHeight => "vs_fixed_height",
            Self::Mesh => "vs_mesh",
            Self::PulledMesh => "vs_mesh_pulled",
            Self::Square => "vs_square",
            Self::MeshCaster => "vs_mesh_caster",
            Self::PulledMeshCaster => "vs_mesh_caster_pulled",
            Self::MaskedMeshCaster => "vs_mesh_caster_masked",
            Self::FixedMesh => "vs_fixed_mesh",
            Self::PulledFixedMesh => "vs_fixed_mesh_pulled",
            Self::FixedSquare => "vs_fixed_square",
            Self::Splat => "vs_splat",
        }
    }
}

/// The fragment entry points of the renderer's own shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FragmentEntry {
    Height,
    Mesh,
    MaskedMesh,
    BlendedMesh,
    MaskedBlendedMesh,
    /// Lines and points.
    Thin,
    FixedHeight,
    FixedMesh,
    FixedThin,
    FixedHeightCaster,
    FixedMeshCaster,
    MaskedMeshCaster,
    Splat,
    Fallback,
}

impl FragmentEntry {
    /// Returns the name in the shader source.
    ///
    /// Entry points for leaves that fade draw a part of the pixels. They are separate, so that the others discard nothing
    /// and depth is tested before shading.
    pub(super) fn name(self, is_fading: bool) -> &'static str {
        match (self, is_fading) {
            (Self::Height, false) => "fs_height",
            (Self::Height, true) => "fs_height_fading",
            (Self::Mesh, false) => "fs_mesh",
            (Self::Mesh, true) => "fs_mesh_fading",
            (Self::MaskedMesh, false) => "fs_mesh_masked",
            (Self::MaskedMesh, true) => "fs_mesh_masked_fading",
            (Self::BlendedMesh, false) => "fs_mesh_blended",
            (Self::BlendedMesh, true) => "fs_mesh_blended_fading",
            (Self::MaskedBlendedMesh, false) => "fs_mesh_masked_blended",
            (Self::MaskedBlendedMesh, true) => "fs_mesh_masked_blended_fading",
            (Self::Thin, false) => "fs_thin",
            (Self::Thin, true) => "fs_thin_fading",
            (Self::FixedHeight, false) => "fs_fixed_height",
            (Self::FixedHeight, true) => "fs_fixed_height_fading",
            (Self::FixedMesh, false) => "fs_fixed_mesh",
            (Self::FixedMesh, true) => "fs_fixed_mesh_fading",
            (Self::FixedThin, false) => "fs_fixed_thin",
            (Self::FixedThin, true) => "fs_fixed_thin_fading",
            (Self::FixedHeightCaster, _) => "fs_fixed_height_caster",
            (Self::FixedMeshCaster, _) => "fs_fixed_mesh_caster",
            (Self::MaskedMeshCaster, _) => "fs_mesh_caster_masked",
            (Self::Splat, false) => "fs_splat",
            (Self::Splat, true) => "fs_splat_fading",
            (Self::Fallback, _) => "fs_fallback",
        }
    }

    /// Returns true if the shader has the override `HAS_ALPHA`.
    pub(super) fn has_alpha_override(self) -> bool {
        matches!(self, Self::Height)
    }
}

/// The shader of a pipeline that has no program of the application.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShaderChoice {
    pub(super) label: &'static str,
    pub(super) source: &'static str,
    pub(super) vertex: VertexEntry,
    pub(super) fragment: FragmentEntry,
    /// True if the fragment shader may discard. In passes without colours, others have no fragment shader.
    pub(super) discards: bool,
}

impl ShaderChoice {
    /// Returns the shader of a key; `None` for keys with a program.
    pub(super) fn of(key: PipelineKey) -> Option<Self> {
        Some(match key.shading() {
            _ if key.is_splats() => Self {
                label: "splats",
                source: SPLAT_WGSL,
                vertex: VertexEntry::Splat,
                fragment: FragmentEntry::Splat,
                discards: true,
            },
            Shading::Program(_) => return None,
            Shading::FixedFunction => Self::fixed(key, false),
            Shading::FixedTextured => Self::fixed(key, true),
            Shading::Fallback => Self {
                label: "mesh",
                source: MESH_WGSL,
                vertex: Self::mesh_vertex(key),
                fragment: FragmentEntry::Fallback,
                discards: false,
            },
            Shading::Plain if key.is_caster() => Self::caster(key),
            Shading::Plain if key.kind() == Kind::Height => Self::height(key),
            Shading::Plain => Self::mesh(key),
        })
    }

    fn fixed(key: PipelineKey, is_textured: bool) -> Self {
        let (height, mesh) = match (is_textured, key.has_shadows()) {
            (true, false) => (TEXTURED_HEIGHT_WGSL, TEXTURED_MESH_WGSL),
            (true, true) => (SHADOWED_TEXTURED_HEIGHT_WGSL, SHADOWED_TEXTURED_MESH_WGSL),
            (false, false) => (FIXED_HEIGHT_WGSL, FIXED_MESH_WGSL),
            (false, true) => (SHADOWED_FIXED_HEIGHT_WGSL, SHADOWED_FIXED_MESH_WGSL),
        };
        let is_caster = key.is_caster();
        if key.kind() == Kind::Height {
            let fragment = if is_caster { FragmentEntry::FixedHeightCaster } else { FragmentEntry::FixedHeight };
            let vertex = VertexEntry::FixedHeight;
            return Self { label: "fixed height", source: height, vertex, fragment, discards: true };
        }
        let is_thin = matches!(key.kind(), Kind::Lines | Kind::Points);
        let is_pulled = key.is_pulled() && !is_thin;
        Self {
            label: "fixed mesh",
            source: mesh,
            vertex: match () {
                _ if key.is_square() => VertexEntry::FixedSquare,
                _ if is_pulled => VertexEntry::PulledFixedMesh,
                _ => VertexEntry::FixedMesh,
            },
            fragment: match () {
                _ if is_thin => FragmentEntry::FixedThin,
                _ if is_caster => FragmentEntry::FixedMeshCaster,
                _ => FragmentEntry::FixedMesh,
            },
            discards: true,
        }
    }

    fn mesh_vertex(key: PipelineKey) -> VertexEntry {
        match () {
            _ if key.is_square() => VertexEntry::Square,
            _ if key.is_pulled() => VertexEntry::PulledMesh,
            _ => VertexEntry::Mesh,
        }
    }

    fn caster(key: PipelineKey) -> Self {
        let is_masked = key.alpha() == Alpha::Masked;
        let (label, source, vertex) = match key.kind() {
            Kind::Height => ("shadowed height", SHADOWED_HEIGHT_WGSL, VertexEntry::HeightCaster),
            _ if is_masked => ("shadowed mesh", SHADOWED_MESH_WGSL, VertexEntry::MaskedMeshCaster),
            _ if key.is_pulled() => ("shadowed mesh", SHADOWED_MESH_WGSL, VertexEntry::PulledMeshCaster),
            _ => ("shadowed mesh", SHADOWED_MESH_WGSL, VertexEntry::MeshCaster),
        };
        Self { label, source, vertex, fragment: FragmentEntry::MaskedMeshCaster, discards: is_masked }
    }

    fn height(key: PipelineKey) -> Self {
        let (label, source) =
            if key.has_shadows() { ("shadowed height", SHADOWED_HEIGHT_WGSL) } else { ("height", HEIGHT_WGSL) };
        let (vertex, fragment) = (VertexEntry::Height, FragmentEntry::Height);
        Self { label, source, vertex, fragment, discards: key.is_fading() }
    }

    fn mesh(key: PipelineKey) -> Self {
        let (label, source) = match (key.has_surface(), key.has_shadows()) {
            (false, false) => ("mesh", MESH_WGSL),
            (false, true) => ("shadowed mesh", SHADOWED_MESH_WGSL),
            (true, false) if key.has_layered_surface() => ("layered surface", LAYERED_SURFACE_WGSL),
            (true, true) if key.has_layered_surface() => ("shadowed layered surface", SHADOWED_LAYERED_SURFACE_WGSL),
            (true, false) => ("surface", SURFACE_WGSL),
            (true, true) => ("shadowed surface", SHADOWED_SURFACE_WGSL),
        };
        let covers_by_alpha = key.has_alpha_to_coverage();
        Self {
            label,
            source,
            vertex: Self::mesh_vertex(key),
            fragment: match (key.kind(), key.alpha()) {
                (Kind::Lines | Kind::Points, _) => FragmentEntry::Thin,
                (_, Alpha::Masked) if !covers_by_alpha => FragmentEntry::MaskedMesh,
                (_, Alpha::Masked | Alpha::MaskedBlended) => FragmentEntry::MaskedBlendedMesh,
                (_, Alpha::Opaque) if !covers_by_alpha => FragmentEntry::Mesh,
                _ => FragmentEntry::BlendedMesh,
            },
            discards: matches!(key.alpha(), Alpha::Masked | Alpha::MaskedBlended) || key.is_fading(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::draw::pipelines::key::StateKey;
    use crate::draw::pipelines::key_parts::PartIndices;
    use crate::scene::Topology;
    use crate::state::{Mode, ResolvedState, StateSet, StateValue};

    /// Returns the keys of all drawables under some states, lit and in shadow maps.
    fn keys() -> Vec<PipelineKey> {
        let plain = ResolvedState::default();
        let modes = [Mode::Blend, Mode::AlphaToCoverage];
        let sets = modes.map(|mode| StateSet::default().with_mode(mode, StateValue::ON));
        let states = [plain.clone(), plain.below(&sets[0]), plain.below(&sets[1])];
        let mut keys = Vec::new();
        for state in &states {
            for shading in [Shading::Plain, Shading::FixedFunction, Shading::FixedTextured, Shading::Fallback] {
                let key = StateKey::new(state, PartIndices::default(), shading, 0);
                let casters = [false, true].map(|drops| StateKey::caster(state, shading, drops, 0));
                for state in [key, key.fading(), key.shadowed(), key.fading().shadowed()].into_iter().chain(casters) {
                    keys.extend([PipelineKey::height(&state, false), PipelineKey::splats(&state)]);
                    for topology in [Topology::Triangles, Topology::Lines, Topology::Points, Topology::Squares] {
                        for is_masked in [false, true] {
                            let key = PipelineKey::mesh(&state, topology, is_masked, false, false);
                            keys.extend([key, key.with_surface(false), key.with_surface(true)]);
                            if topology == Topology::Triangles && !is_masked {
                                keys.extend([
                                    key.pulled(),
                                    key.with_surface(false).pulled(),
                                    key.with_surface(true).pulled(),
                                ]);
                            }
                        }
                    }
                }
            }
        }
        keys
    }

    #[test]
    fn every_key_has_entry_points_in_its_source() {
        let mut modules: HashMap<&'static str, naga::Module> = HashMap::new();
        for key in keys() {
            let choice = ShaderChoice::of(key).unwrap();
            let module =
                modules.entry(choice.source).or_insert_with(|| naga::front::wgsl::parse_str(choice.source).unwrap());
            let has = |name: &str| module.entry_points.iter().any(|entry| entry.name == name);
            assert!(has(choice.vertex.name()), "{choice:?}");
            // Without discards a caster has no fragment shader.
            let has_fragment = choice.discards || !key.is_caster();
            assert!(!has_fragment || has(choice.fragment.name(key.is_fading())), "{choice:?}");
        }
    }
}
