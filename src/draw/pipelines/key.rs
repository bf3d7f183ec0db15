//! The key of a pipeline: everything that pipelines differ in, packed into 128 bits. Plain values.
//!
//! Keys are compared for each bucket and sorted by their number, which is why they are packed. High bits are the
//! expensive changes. Each property is a [`Field`]; properties with too many values for some bits are numbered by use
//! (`key_parts`, targets, programs).

pub(in crate::draw) use super::key_parts::AirKind;
use super::key_parts::{PART_BITS, PartIndices};
use crate::gpu::MAX_ATTRIBUTE_LAYOUTS;
use crate::scene::{Topology, VertexFormat};
use crate::state::{CompareFunction, CullFace, FrontFace, Mode, PolygonMode, ResolvedState};

/// The key of a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(in crate::draw) struct PipelineKey(u128);

/// The use of alpha by the fragment shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Alpha {
    Opaque,
    Masked,
    Blended,
    MaskedBlended,
}

/// The kind of drawable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Kind {
    Height,
    Triangles,
    Lines,
    Points,
}

/// A property of a key: its lowest bit and its number of bits.
#[derive(Clone, Copy)]
struct Field {
    shift: u32,
    bits: u32,
}

impl Field {
    /// Returns the field above this one.
    const fn next(self, bits: u32) -> Self {
        Self { shift: self.shift + self.bits, bits }
    }

    const fn max(self) -> usize {
        (1 << self.bits) - 1
    }

    const fn mask(self) -> u128 {
        (self.max() as u128) << self.shift
    }

    /// Returns the bits of a value; higher values than the field has are cut off.
    const fn of(self, value: usize) -> u128 {
        ((value & self.max()) as u128) << self.shift
    }

    const fn read(self, key: u128) -> usize {
        (key >> self.shift) as usize & self.max()
    }

    const fn is_set(self, key: u128) -> bool {
        key & self.mask() != 0
    }
}

const KIND: Field = Field { shift: 0, bits: 2 };
const ALPHA: Field = KIND.next(2);
/// Bit 0 for back faces, bit 1 for front faces.
const CULLED: Field = ALPHA.next(2);
const DEPTH_WRITE: Field = CULLED.next(1);
const DEPTH_COMPARE: Field = DEPTH_WRITE.next(3);
const CLOCKWISE: Field = DEPTH_COMPARE.next(1);
const POLYGON_MODE: Field = CLOCKWISE.next(2);
/// Points are drawn as squares.
const SQUARES: Field = POLYGON_MODE.next(1);
const COLOR_MASK: Field = SQUARES.next(4);
/// The index of a [`Blending`](super::key_parts::Blending).
const BLENDING: Field = COLOR_MASK.next(PART_BITS);
const AIR: Field = BLENDING.next(2);
/// The index of the layout of custom attributes.
const LAYOUT: Field = AIR.next(4);
const OFFSET: Field = LAYOUT.next(PART_BITS);
const STENCIL: Field = OFFSET.next(PART_BITS);
const SAMPLES: Field = STENCIL.next(PART_BITS);
const FIXED: Field = SAMPLES.next(1);
const ALPHA_TO_COVERAGE: Field = FIXED.next(1);
const TARGET: Field = ALPHA_TO_COVERAGE.next(12);
/// The index of a program plus 1; the largest number is the fallback.
const PROGRAM: Field = TARGET.next(12);
const LOCAL_LIGHTS: Field = PROGRAM.next(1);
const VERTICES: Field = LOCAL_LIGHTS.next(2);
/// Texture units with the fixed function, and a metallic-roughness surface without it.
const TEXTURED: Field = VERTICES.next(1);
const FADING: Field = TEXTURED.next(1);
const SHADOWED: Field = FADING.next(1);
const CASTER: Field = SHADOWED.next(1);
/// Some texture unit of the fixed function does more than multiply.
const COMBINES: Field = CASTER.next(1);
/// The surface has a clear coat, or another reflection than a plain dielectric.
const LAYERED: Field = COMBINES.next(1);
/// Points are Gaussian splats.
const SPLATS: Field = LAYERED.next(1);

const _: () = assert!(SPLATS.shift + SPLATS.bits <= u128::BITS && MAX_ATTRIBUTE_LAYOUTS <= LAYOUT.max());

/// The properties of the fixed function alone, and [`TEXTURED`].
const FIXED_FUNCTION: u128 = FIXED.mask() | TEXTURED.mask() | COMBINES.mask();
/// The properties of triangles alone.
const TRIANGLES_ONLY: u128 = CULLED.mask() | POLYGON_MODE.mask() | OFFSET.mask();
/// The vertex format of pulled meshes, beside the numbers of [`VertexFormat`].
const PULLED: usize = 3;

/// The shader that a state is drawn with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Shading {
    /// The renderer's plain shader: sun, sky and haze.
    Plain,
    /// The fixed function: lights, materials, fog.
    FixedFunction,
    /// The fixed function with texture units.
    FixedTextured,
    /// A program of the application, by index. Height tiles cast their shadows without it.
    Program(u16),
    /// A plain magenta, so that states with an invalid program are noticed. Height tiles are drawn plain instead.
    Fallback,
}

/// The number of programs that may be in use at once.
pub(in crate::draw) const MAX_PROGRAMS: usize = PROGRAM.max() - 1;
/// The number of different targets that may be in use at once.
pub(in crate::draw) const MAX_TARGETS: usize = TARGET.max();

/// The part of keys that follows from a resolved state, made once a frame for each state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::draw) struct StateKey {
    common: u128,
    /// Culled faces of single-sided and of double-sided drawables.
    culled: [u8; 2],
    blends: bool,
    /// True if leaves may be drawn in a part of the pixels while they fade. Programs draw all pixels or none.
    pub can_fade: bool,
    /// True if small meshes may be pulled: the shader fetches their vertices.
    pub can_pull: bool,
    /// True if leaves may be drawn in any order, since nearer ones hide farther ones.
    pub order_is_free: bool,
    /// True for casters in shadow maps, whose states differ in little.
    pub casts: bool,
    /// True if the state's alpha test or clip planes drop parts of what is drawn.
    drops: bool,
    /// True if blended triangles drop fragments of alpha 0, as masked ones do.
    pub drops_invisible: bool,
}

impl StateKey {
    /// Returns the part of keys for a state. `target` is the index of the target.
    pub fn new(state: &ResolvedState, parts: PartIndices, shading: Shading, target: u16) -> Self {
        let depth = state.depth();
        let (compare, write) = depth.map_or((CompareFunction::Always, false), |d| (d.function, d.write));
        let culled = |double_sided| match state.culled_face(double_sided) {
            None => 0,
            Some(CullFace::Back) => 1,
            Some(CullFace::Front) => 2,
            Some(CullFace::FrontAndBack) => 3,
        };
        let blends = state.blends();
        let mask = state.color_mask();
        let mut common = DEPTH_WRITE.of(usize::from(write))
            | DEPTH_COMPARE.of(compare as usize)
            | POLYGON_MODE.of(state.polygon_mode() as usize)
            | COLOR_MASK.of(mask.bits() as usize)
            | BLENDING.of(parts.blending().into())
            | OFFSET.of(parts.offset().into())
            | STENCIL.of(parts.stencil().into())
            | SAMPLES.of(parts.samples().into())
            | TARGET.of(target.into());
        match shading {
            // The fixed function and programs find the number of the lights in the stage's uniform.
            Shading::Plain if state.has_local_lights() => common |= LOCAL_LIGHTS.mask(),
            Shading::Plain => {}
            Shading::FixedFunction => common |= FIXED.mask(),
            Shading::FixedTextured => {
                let combines = if state.combines_textures() { COMBINES.mask() } else { 0 };
                common |= FIXED.mask() | TEXTURED.mask() | combines;
            }
            Shading::Program(index) => common |= PROGRAM.of(usize::from(index) + 1),
            Shading::Fallback => common |= PROGRAM.mask(),
        }
        if state.mode(Mode::AlphaToCoverage) {
            common |= ALPHA_TO_COVERAGE.mask();
        }
        if state.front_face() == FrontFace::Clockwise {
            common |= CLOCKWISE.mask();
        }
        let nearer_wins = matches!(compare, CompareFunction::Less | CompareFunction::LessOrEqual);
        let is_whole = mask.is_whole() && parts.blending() == 0;
        let order_is_free = write && nearer_wins && is_whole && parts.stencil() == 0;
        let drops_invisible = state.drops_invisible();
        // Pulled meshes have no alpha cutoff.
        let can_pull = !matches!(shading, Shading::Program(_)) && !drops_invisible;
        let can_fade = !matches!(shading, Shading::Program(_) | Shading::Fallback);
        let culled = [culled(false), culled(true)];
        Self { common, culled, blends, can_fade, can_pull, order_is_free, casts: false, drops: false, drops_invisible }
    }

    /// Returns the key for leaves that are drawn in a part of the pixels.
    pub fn fading(self) -> Self {
        Self { common: if self.can_fade { self.common | FADING.mask() } else { self.common }, ..self }
    }

    /// Returns the key for some air. Programs read the frame's uniforms instead.
    pub fn in_air(self, air: AirKind) -> Self {
        let air = if PROGRAM.is_set(self.common) { 0 } else { AIR.of(air as usize) };
        Self { common: self.common | air, ..self }
    }

    /// Returns the key for views with the sun's shadows.
    pub fn shadowed(self) -> Self {
        Self { common: self.common | SHADOWED.mask(), ..self }
    }

    /// Returns the key for casters under a state: both faces are drawn, in any order. `drops` means that the state has an
    /// alpha test or clip planes.
    pub fn caster(state: &ResolvedState, shading: Shading, drops: bool, target: u16) -> Self {
        let mut key = Self::new(state, PartIndices::default(), shading, target);
        let kept =
            [POLYGON_MODE, FIXED, TEXTURED, COMBINES, PROGRAM, TARGET].iter().fold(0, |all, field| all | field.mask());
        let depth = DEPTH_WRITE.mask() | DEPTH_COMPARE.of(CompareFunction::LessOrEqual as usize);
        key.common = key.common & kept | CASTER.mask() | depth;
        Self { culled: [0, 0], blends: false, can_fade: false, order_is_free: true, casts: true, drops, ..key }
    }
}

impl PipelineKey {
    /// Returns the key for height tiles, which count as double-sided. `mirrored` means that the transform mirrors; a tile's
    /// own frame is left-handed, which mirrors once more.
    pub fn height(state: &StateKey, mirrored: bool) -> Self {
        if state.casts {
            let fixed = if state.drops { 0 } else { FIXED_FUNCTION };
            return Self(state.common & !PROGRAM.mask() & !fixed);
        }
        let alpha = if state.blends { Alpha::Blended } else { Alpha::Opaque };
        let front = if mirrored { 0 } else { CLOCKWISE.mask() };
        // A height tile with an invalid program is plain.
        let fallback = if PROGRAM.read(state.common) == PROGRAM.max() { PROGRAM.mask() } else { 0 };
        let culled = CULLED.of(state.culled[1].into());
        Self(((state.common & !fallback) | culled | ALPHA.of(alpha as usize)) ^ front)
    }

    /// Returns the key for meshes, lines and points.
    pub fn mesh(state: &StateKey, topology: Topology, is_masked: bool, double_sided: bool, mirrored: bool) -> Self {
        if state.casts {
            let alpha = if is_masked { Alpha::Masked } else { Alpha::Opaque };
            let fixed = if state.drops || is_masked { 0 } else { FIXED_FUNCTION };
            return Self(state.common & !fixed | ALPHA.of(alpha as usize) | KIND.of(Kind::Triangles as usize));
        }
        let (kind, common) = match topology {
            Topology::Triangles => {
                let culled = state.culled[usize::from(double_sided)];
                (Kind::Triangles, state.common | CULLED.of(culled.into()))
            }
            Topology::Lines => (Kind::Lines, state.common & !TRIANGLES_ONLY),
            Topology::Points => (Kind::Points, state.common & !TRIANGLES_ONLY),
            Topology::Squares => (Kind::Points, state.common & !TRIANGLES_ONLY | SQUARES.mask()),
        };
        let is_masked = (is_masked || state.drops_invisible) && kind == Kind::Triangles;
        let alpha = match (state.blends, is_masked) {
            (true, true) => Alpha::MaskedBlended,
            (true, false) => Alpha::Blended,
            (false, true) => Alpha::Masked,
            (false, false) => Alpha::Opaque,
        };
        let front = if mirrored && kind == Kind::Triangles { CLOCKWISE.mask() } else { 0 };
        Self((common | KIND.of(kind as usize) | ALPHA.of(alpha as usize)) ^ front)
    }

    /// Returns the key for Gaussian splats. They have one shader and write no depth, whatever the state.
    pub fn splats(state: &StateKey) -> Self {
        let dropped = [PROGRAM, LOCAL_LIGHTS, SHADOWED, DEPTH_WRITE].iter().fold(0, |all, field| all | field.mask());
        let common = state.common & !(dropped | FIXED_FUNCTION | TRIANGLES_ONLY);
        Self(common | KIND.of(Kind::Points as usize) | SPLATS.mask() | ALPHA.of(Alpha::Blended as usize))
    }

    /// Returns true for Gaussian splats.
    pub fn is_splats(self) -> bool {
        SPLATS.is_set(self.0)
    }

    pub fn kind(self) -> Kind {
        [Kind::Height, Kind::Triangles, Kind::Lines, Kind::Points][KIND.read(self.0)]
    }

    pub fn alpha(self) -> Alpha {
        [Alpha::Opaque, Alpha::Masked, Alpha::Blended, Alpha::MaskedBlended][ALPHA.read(self.0)]
    }

    /// Returns the culled faces: bit 0 for back faces, bit 1 for front faces.
    pub fn culled(self) -> usize {
        CULLED.read(self.0)
    }

    pub fn writes_depth(self) -> bool {
        DEPTH_WRITE.is_set(self.0)
    }

    pub fn depth_compare(self) -> CompareFunction {
        use CompareFunction::{Always, Equal, Greater, GreaterOrEqual, Less, LessOrEqual, Never, NotEqual};
        [Never, Less, Equal, LessOrEqual, Greater, NotEqual, GreaterOrEqual, Always][DEPTH_COMPARE.read(self.0)]
    }

    pub fn is_clockwise(self) -> bool {
        CLOCKWISE.is_set(self.0)
    }

    /// Returns true if the key has one of some parts.
    pub fn has_any(self, parts: PartIndices) -> bool {
        let pairs = [
            (parts.offset(), self.offset()),
            (parts.stencil(), self.stencil()),
            (parts.blending(), self.blending()),
            (parts.samples(), self.samples()),
        ];
        pairs.iter().any(|(part, own)| *part != 0 && part == own)
    }

    /// Returns true if points are drawn as squares.
    pub fn is_square(self) -> bool {
        SQUARES.is_set(self.0)
    }

    /// Returns the polygon mode of triangles.
    pub fn polygon_mode(self) -> PolygonMode {
        [PolygonMode::Fill, PolygonMode::Line, PolygonMode::Point, PolygonMode::Fill][POLYGON_MODE.read(self.0)]
    }

    /// Returns the written components: red, green, blue and alpha in bits 0 to 3.
    pub fn color_mask(self) -> u8 {
        COLOR_MASK.read(self.0) as u8
    }

    /// Returns the index of what attachments blend and mask; 0 if they blend nothing and all have the same mask.
    pub fn blending(self) -> u16 {
        BLENDING.read(self.0) as u16
    }

    /// Returns true if alpha is blended.
    pub fn is_blended(self) -> bool {
        matches!(self.alpha(), Alpha::Blended | Alpha::MaskedBlended)
    }

    pub fn air(self) -> AirKind {
        [AirKind::Atmosphere, AirKind::Haze, AirKind::Clear, AirKind::Atmosphere][AIR.read(self.0)]
    }

    pub fn offset(self) -> u16 {
        OFFSET.read(self.0) as u16
    }

    pub fn stencil(self) -> u16 {
        STENCIL.read(self.0) as u16
    }

    /// Returns the index of the sample mask; 0 without one.
    pub fn samples(self) -> u16 {
        SAMPLES.read(self.0) as u16
    }

    pub fn target(self) -> u16 {
        TARGET.read(self.0) as u16
    }

    pub fn has_alpha_to_coverage(self) -> bool {
        ALPHA_TO_COVERAGE.is_set(self.0)
    }

    pub fn shading(self) -> Shading {
        match PROGRAM.read(self.0) {
            0 if FIXED.is_set(self.0) && TEXTURED.is_set(self.0) => Shading::FixedTextured,
            0 if FIXED.is_set(self.0) => Shading::FixedFunction,
            0 => Shading::Plain,
            last if last == PROGRAM.max() => Shading::Fallback,
            program => Shading::Program(program as u16 - 1),
        }
    }

    /// Returns the key for pulled meshes. Programs do not pull; their vertices come from vertex buffers.
    pub fn pulled(self) -> Self {
        Self(self.0 | VERTICES.of(PULLED))
    }

    /// Returns the key for meshes with a vertex format.
    pub fn with_vertices(self, format: VertexFormat) -> Self {
        Self(self.0 | VERTICES.of(format as usize))
    }

    /// Returns the key for a metallic-roughness surface. Programs, the fixed function, shadow maps, lines and points draw
    /// without it. `is_layered` means that it has layers beyond the plain model.
    pub fn with_surface(self, is_layered: bool) -> Self {
        let other_shader = FIXED.mask() | PROGRAM.mask() | CASTER.mask();
        let is_plain = self.0 & other_shader == 0 && self.kind() == Kind::Triangles;
        let layers = LAYERED.of(is_layered.into());
        Self(if is_plain { self.0 | TEXTURED.mask() | layers } else { self.0 })
    }

    /// Returns true if the bind group of the block is that of a set of surfaces.
    pub fn has_surface(self) -> bool {
        TEXTURED.is_set(self.0) && !FIXED.is_set(self.0)
    }

    /// Returns true if the bind group of the block is that of a set of layered surfaces.
    pub fn has_layered_surface(self) -> bool {
        LAYERED.is_set(self.0) && self.has_surface()
    }

    /// Returns true if local lights shine on the leaves.
    pub fn has_local_lights(self) -> bool {
        LOCAL_LIGHTS.is_set(self.0)
    }

    /// Returns true if some texture unit of the fixed function does more than multiply.
    pub fn combines_textures(self) -> bool {
        COMBINES.is_set(self.0)
    }

    /// Returns the key for full vertices with custom attributes, by index of their layout from 1 on.
    pub fn with_layout(self, index: u32) -> Self {
        Self(self.0 | LAYOUT.of(index as usize))
    }

    /// Returns the index of the layout of custom attributes; 0 without any.
    pub fn layout(self) -> u32 {
        LAYOUT.read(self.0) as u32
    }

    /// Returns the vertex format; `None` for pulled meshes.
    pub fn vertices(self) -> Option<VertexFormat> {
        use VertexFormat::{Full, Packed, Quantized};
        [Some(Full), Some(Packed), Some(Quantized), None][VERTICES.read(self.0)]
    }

    /// Returns true if all vertices share the one colour of the pool.
    pub fn is_white(self) -> bool {
        matches!(self.vertices(), Some(VertexFormat::Packed | VertexFormat::Quantized))
    }

    /// Returns true if the shader is one with shadow maps: it receives shadows or casts them.
    pub fn has_shadows(self) -> bool {
        SHADOWED.is_set(self.0) || CASTER.is_set(self.0)
    }

    /// Returns true for casters, which draw depth alone.
    pub fn is_caster(self) -> bool {
        CASTER.is_set(self.0)
    }

    pub fn is_pulled(self) -> bool {
        VERTICES.read(self.0) == PULLED
    }

    pub fn is_fading(self) -> bool {
        FADING.is_set(self.0)
    }

    /// Returns the number by which keys are sorted.
    pub fn order(self) -> u128 {
        self.0
    }

    /// Returns the key of the same drawables under another target, air and sun. `is_lit_anew` means that a light replaces the
    /// sun, for states that have no other shader.
    pub fn in_view(self, target: u16, air: AirKind, is_shadowed: bool, is_lit_anew: bool) -> Self {
        let has_program = PROGRAM.is_set(self.0);
        let replaced = TARGET.mask() | SHADOWED.mask() | if has_program { 0 } else { AIR.mask() };
        let air = if has_program { 0 } else { AIR.of(air as usize) };
        let shadowed = if is_shadowed && !self.is_splats() { SHADOWED.mask() } else { 0 };
        let key = self.0 & !replaced | TARGET.of(target.into()) | air | shadowed;
        let is_fixed = is_lit_anew && self.shading() == Shading::Plain && !self.is_splats();
        let surface = TEXTURED.mask() | LAYERED.mask() | LOCAL_LIGHTS.mask();
        Self(if is_fixed { key & !surface | FIXED.mask() } else { key })
    }

    /// Returns the key of the same opaque or masked drawables in shadow maps; `None` for others, and for states whose own
    /// shader may drop parts.
    pub fn in_shadow_map(self, target: u16) -> Option<Self> {
        let casts = matches!(self.kind(), Kind::Height | Kind::Triangles) && !self.is_blended() && !self.is_caster();
        let kept = KIND.mask() | ALPHA.mask() | POLYGON_MODE.mask() | VERTICES.mask() | LAYOUT.mask();
        let depth = DEPTH_WRITE.mask() | DEPTH_COMPARE.of(CompareFunction::LessOrEqual as usize);
        let key = self.0 & kept | TARGET.of(target.into()) | CASTER.mask() | depth;
        (casts && self.shading() == Shading::Plain).then_some(Self(key))
    }

    /// Returns the key of the pipeline that stands in if this one cannot be created.
    pub fn fallback(self) -> Self {
        let units = if self.has_surface() { 0 } else { TEXTURED.mask() };
        let others = [PROGRAM, FIXED, LOCAL_LIGHTS, FADING].iter().fold(units, |all, field| all | field.mask());
        let plain = self.0 & !others;
        Self(if self.kind() == Kind::Height { plain } else { plain | PROGRAM.mask() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, BlendEquation, BlendFunc, ColorMask, Depth, StateSet, StateValue};

    #[test]
    fn keys_return_the_properties_they_were_made_of() {
        let set = StateSet::default()
            .with(Attribute::BlendFunc(BlendFunc::ADD))
            .with(Attribute::BlendEquation(BlendEquation::Max))
            .with(Attribute::Depth(Depth { function: CompareFunction::NotEqual, write: false, ..Depth::default() }))
            .with(Attribute::CullFace(CullFace::Front))
            .with(Attribute::FrontFace(FrontFace::Clockwise))
            .with(Attribute::PolygonMode(PolygonMode::Point))
            .with(Attribute::ColorMask(ColorMask([true, false, true, true])));
        let parts = PartIndices::new(50, 60, 999, 1023);
        let state = StateKey::new(&ResolvedState::default().below(&set), parts, Shading::Program(4000), 3000);
        let key = PipelineKey::mesh(&state, Topology::Triangles, false, false, false);
        assert_eq!((key.kind(), key.alpha(), key.culled()), (Kind::Triangles, Alpha::Blended, 2));
        let alpha = |topology, is_masked| PipelineKey::mesh(&state, topology, is_masked, false, false).alpha();
        assert_eq!(alpha(Topology::Triangles, true), Alpha::MaskedBlended);
        assert_eq!(alpha(Topology::Lines, true), Alpha::Blended);
        assert_eq!((key.writes_depth(), key.depth_compare()), (false, CompareFunction::NotEqual));
        assert_eq!((key.is_clockwise(), key.polygon_mode(), key.color_mask()), (true, PolygonMode::Point, 0b1101));
        assert_eq!((key.blending(), key.offset(), key.samples()), (999, 50, 1023));
        assert_eq!((key.stencil(), key.target(), key.shading()), (60, 3000, Shading::Program(4000)));
        assert_eq!(key.fallback().shading(), Shading::Fallback);
        assert!(!state.can_fade && state.fading() == state);
        let height = PipelineKey::height(&state, false);
        assert_eq!((height.shading(), height.fallback().shading()), (Shading::Program(4000), Shading::Plain));
        let broken = StateKey::new(&ResolvedState::default(), parts, Shading::Fallback, 3000);
        assert_eq!(PipelineKey::height(&broken, false).shading(), Shading::Plain);
        assert!(!state.order_is_free);
        for format in [VertexFormat::Full, VertexFormat::Packed, VertexFormat::Quantized] {
            let formatted = key.with_vertices(format);
            assert_eq!((formatted.vertices(), formatted.is_pulled()), (Some(format), false));
            assert_eq!(formatted.is_white(), format != VertexFormat::Full);
        }
        for index in [1, 15] {
            let custom = key.with_layout(index);
            assert_eq!((custom.layout(), custom.vertices()), (index, Some(VertexFormat::Full)));
            assert_eq!((custom.fallback().layout(), custom.offset(), custom.air()), (index, 50, key.air()));
        }
        assert_eq!(key.layout(), 0);
        assert!(!key.with_surface(true).has_surface(), "programs draw without surfaces");
        assert!(key.pulled().is_pulled() && key.pulled().vertices().is_none() && !key.pulled().is_white());
        let mirrored = PipelineKey::mesh(&state, Topology::Triangles, false, true, true);
        assert_eq!((mirrored.is_clockwise(), mirrored.culled()), (false, 0));
        let line = PipelineKey::mesh(&state, Topology::Lines, true, false, true);
        assert_eq!(
            (line.kind(), line.culled(), line.offset(), line.polygon_mode()),
            (Kind::Lines, 0, 0, PolygonMode::Fill)
        );
    }

    #[test]
    fn default_states_have_plain_keys() {
        let state = StateKey::new(&ResolvedState::default(), PartIndices::default(), Shading::Plain, 0);
        assert!(state.order_is_free);
        let surface = PipelineKey::mesh(&state, Topology::Triangles, false, false, false).with_surface(false);
        assert_eq!((surface.has_surface(), surface.shading()), (true, Shading::Plain));
        assert_eq!((surface.fallback().has_surface(), surface.fallback().shading()), (true, Shading::Fallback));
        assert!(!surface.has_layered_surface() && surface.with_surface(true).fallback().has_layered_surface());
        assert!(!PipelineKey::mesh(&state, Topology::Lines, false, false, false).with_surface(true).has_surface());
        let near_lights = ResolvedState::default().below_local_lights();
        for (shading, is_lit) in [(Shading::Plain, true), (Shading::FixedFunction, false), (Shading::Program(0), false)]
        {
            let state = StateKey::new(&near_lights, PartIndices::default(), shading, 0);
            let key = PipelineKey::mesh(&state, Topology::Triangles, false, false, false).with_surface(false);
            assert_eq!((key.has_local_lights(), key.shading()), (is_lit, shading));
            assert!(!key.fallback().has_local_lights());
            let caster = StateKey::caster(&near_lights, shading, false, 0);
            assert!(!PipelineKey::mesh(&caster, Topology::Triangles, false, false, false).has_local_lights());
        }
        let fading = PipelineKey::height(&state.fading(), true);
        assert!(fading.is_fading() && fading.shading() == Shading::Plain);
        let key = PipelineKey::height(&state, true);
        assert!(!key.is_fading());
        assert_eq!((key.kind(), key.culled(), key.blending(), key.color_mask()), (Kind::Height, 0, 0, 15));
        assert_eq!((key.depth_compare(), key.writes_depth()), (CompareFunction::Less, true));
        let off = StateSet::default().with_mode(Mode::DepthTest, StateValue::OFF);
        let state =
            StateKey::new(&ResolvedState::default().below(&off), PartIndices::default(), Shading::FixedFunction, 0);
        let key = PipelineKey::height(&state, false);
        assert_eq!(
            (key.depth_compare(), key.writes_depth(), key.is_clockwise()),
            (CompareFunction::Always, false, true)
        );
    }
}
