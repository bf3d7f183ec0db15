//! The key of a pipeline: everything that pipelines differ in, packed into 64 bits. Plain values.
//!
//! Keys are compared for each bucket and sorted by their number, which is why they are packed. High bits are the
//! expensive changes.
//!
//! | bits | property | bits | property |
//! |---|---|---|---|
//! | 0-1 | kind of drawable | 34-39 | stencil test, by index |
//! | 2-3 | alpha | 40 | fixed function |
//! | 4-5 | culled faces | 41 | alpha to coverage |
//! | 6 | depth write | 42-47 | target, by index |
//! | 7-9 | depth compare | 48-56 | program, by index plus 1 |
//! | 10 | clockwise front faces | 57 | local lights |
//! | 11-12 | polygon mode; squares for points | 58-59 | vertex format |
//! | 13-15 | colour mask | 60 | texture units, or a surface |
//! | 16-21 | blending, by index | 61 | fading |
//! | 22-23 | air | 62 | receives shadows |
//! | 24-27 | custom attributes, by index | 63 | casts shadows |
//! | 28-33 | polygon offset, by index | | |
//!
//! Bit 60 means texture units with the fixed function, and a metallic-roughness surface without it.

use super::key_parts::PartIndices;
use crate::scene::{Environment, Sky, Topology, VertexFormat};
use crate::state::{ColorMask, CompareFunction, CullFace, FrontFace, Mode, PolygonMode, ResolvedState};

/// The key of a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(in crate::draw) struct PipelineKey(u64);

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

const CLOCKWISE: u64 = 1 << 10;
/// The properties of triangles alone: culled faces, polygon mode, polygon offset.
const TRIANGLES_ONLY: u64 = 3 << 4 | 3 << 11 | 0x3f << 28;
/// Points are drawn as squares. The bit is that of the polygon mode, which points do not have.
const SQUARES: u64 = 1 << 11;
const AIR_SHIFT: u32 = 22;
const LAYOUT_SHIFT: u32 = 24;
const FIXED: u64 = 1 << 40;
const ALPHA_TO_COVERAGE: u64 = 1 << 41;
const PROGRAM: u64 = 0x1ff << 48;
const LOCAL_LIGHTS: u64 = 1 << 57;
const VERTICES_SHIFT: u32 = 58;
/// The vertex format of pulled meshes, beside the numbers of [`VertexFormat`].
const PULLED: usize = 3;
const TEXTURED: u64 = 1 << 60;
const FADING: u64 = 1 << 61;
const SHADOWED: u64 = 1 << 62;
const CASTER: u64 = 1 << 63;

/// The air between the eye and what it sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum AirKind {
    /// An atmosphere, which the frame's uniforms describe.
    Atmosphere,
    /// Haze, but no atmosphere.
    Haze,
    /// Neither.
    Clear,
}

impl AirKind {
    /// Returns the kind of air of an environment.
    pub fn of(environment: &Environment) -> Self {
        match environment.sky {
            Sky::Atmosphere => Self::Atmosphere,
            Sky::Background(_) if environment.fog.enabled => Self::Haze,
            Sky::Background(_) => Self::Clear,
        }
    }
}

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
pub(in crate::draw) const MAX_PROGRAMS: usize = 510;
/// The number of different targets.
pub(in crate::draw) const MAX_TARGETS: usize = 64;

/// The part of keys that follows from a resolved state, made once a frame for each state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::draw) struct StateKey {
    common: u64,
    /// Culled faces of single-sided and of double-sided drawables.
    culled: [u64; 2],
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
}

impl StateKey {
    /// Returns the part of keys for a state. `target` is the index of the target.
    pub fn new(state: &ResolvedState, parts: PartIndices, shading: Shading, target: u8) -> Self {
        let depth = state.depth();
        let (compare, write) = depth.map_or((CompareFunction::Always, false), |d| (d.function, d.write));
        let culled = |double_sided| match state.culled_face(double_sided) {
            None => 0,
            Some(CullFace::Back) => 1 << 4,
            Some(CullFace::Front) => 2 << 4,
            Some(CullFace::FrontAndBack) => 3 << 4,
        };
        let blends = state.blends();
        let ColorMask(mask) = state.color_mask();
        let mut common = u64::from(write) << 6
            | (compare as u64) << 7
            | (state.polygon_mode() as u64) << 11
            | (0..3).map(|i| u64::from(mask[i]) << (13 + i)).sum::<u64>()
            | u64::from(parts.blend() & 63) << 16
            | u64::from(parts.offset() & 63) << 28
            | u64::from(parts.stencil() & 63) << 34
            | u64::from(target & 63) << 42;
        match shading {
            // The fixed function and programs find the number of the lights in the stage's uniform.
            Shading::Plain if state.has_local_lights() => common |= LOCAL_LIGHTS,
            Shading::Plain => {}
            Shading::FixedFunction => common |= FIXED,
            Shading::FixedTextured => common |= FIXED | TEXTURED,
            Shading::Program(index) => common |= (u64::from(index) + 1) << 48 & PROGRAM,
            Shading::Fallback => common |= PROGRAM,
        }
        if state.mode(Mode::AlphaToCoverage) {
            common |= ALPHA_TO_COVERAGE;
        }
        if state.front_face() == FrontFace::Clockwise {
            common |= CLOCKWISE;
        }
        let nearer_wins = matches!(compare, CompareFunction::Less | CompareFunction::LessOrEqual);
        let is_whole = mask == [true; 3] && !blends;
        let order_is_free = write && nearer_wins && is_whole && parts.stencil() == 0;
        let can_pull = !matches!(shading, Shading::Program(_));
        let can_fade = !matches!(shading, Shading::Program(_) | Shading::Fallback);
        let culled = [culled(false), culled(true)];
        Self { common, culled, blends, can_fade, can_pull, order_is_free, casts: false, drops: false }
    }

    /// Returns the key for leaves that are drawn in a part of the pixels.
    pub fn fading(self) -> Self {
        Self { common: if self.can_fade { self.common | FADING } else { self.common }, ..self }
    }

    /// Returns the key for some air. Programs read the frame's uniforms instead.
    pub fn in_air(self, air: AirKind) -> Self {
        let air = if self.common & PROGRAM == 0 { (air as u64) << AIR_SHIFT } else { 0 };
        Self { common: self.common | air, ..self }
    }

    /// Returns the key for views with the sun's shadows.
    pub fn shadowed(self) -> Self {
        Self { common: self.common | SHADOWED, ..self }
    }

    /// Returns the key for casters under a state: both faces are drawn, in any order. `drops` means that the state has an
    /// alpha test or clip planes.
    pub fn caster(state: &ResolvedState, shading: Shading, drops: bool, target: u8) -> Self {
        let mut key = Self::new(state, PartIndices::default(), shading, target);
        let kept = 3 << 11 | FIXED | TEXTURED | PROGRAM | 63 << 42;
        key.common = key.common & kept | CASTER | 1 << 6 | (CompareFunction::LessOrEqual as u64) << 7;
        Self { culled: [0, 0], blends: false, can_fade: false, order_is_free: true, casts: true, drops, ..key }
    }
}

impl PipelineKey {
    /// Returns the key for height tiles, which count as double-sided. `mirrored` means that the transform mirrors; a tile's
    /// own frame is left-handed, which mirrors once more.
    pub fn height(state: &StateKey, mirrored: bool) -> Self {
        if state.casts {
            let fixed = if state.drops { 0 } else { FIXED | TEXTURED };
            return Self(state.common & !PROGRAM & !fixed);
        }
        let alpha = if state.blends { 2 << 2 } else { 0 };
        let front = if mirrored { 0 } else { CLOCKWISE };
        // A height tile with an invalid program is plain.
        let fallback = if state.common & PROGRAM == PROGRAM { PROGRAM } else { 0 };
        Self(((state.common & !fallback) | state.culled[1] | alpha) ^ front)
    }

    /// Returns the key for meshes, lines and points.
    pub fn mesh(state: &StateKey, topology: Topology, is_masked: bool, double_sided: bool, mirrored: bool) -> Self {
        if state.casts {
            let masked = if is_masked { 1 << 2 } else { 0 };
            let fixed = if state.drops || is_masked { 0 } else { FIXED | TEXTURED };
            return Self(state.common & !fixed | masked | 1);
        }
        let kind = match topology {
            Topology::Triangles => 1,
            Topology::Lines => 2,
            Topology::Points | Topology::Squares => 3,
        };
        let alpha = match () {
            _ if state.blends && is_masked && kind == 1 => 3 << 2,
            _ if state.blends => 2 << 2,
            _ if is_masked && kind == 1 => 1 << 2,
            _ => 0,
        };
        let common = match topology {
            Topology::Triangles => state.common | state.culled[usize::from(double_sided)],
            Topology::Lines | Topology::Points => state.common & !TRIANGLES_ONLY,
            Topology::Squares => state.common & !TRIANGLES_ONLY | SQUARES,
        };
        let front = if mirrored && kind == 1 { CLOCKWISE } else { 0 };
        Self((common | kind | alpha) ^ front)
    }

    pub fn kind(self) -> Kind {
        [Kind::Height, Kind::Triangles, Kind::Lines, Kind::Points][self.field(0, 2)]
    }

    pub fn alpha(self) -> Alpha {
        [Alpha::Opaque, Alpha::Masked, Alpha::Blended, Alpha::MaskedBlended][self.field(2, 2)]
    }

    /// Returns the culled faces: bit 0 for back faces, bit 1 for front faces.
    pub fn culled(self) -> usize {
        self.field(4, 2)
    }

    pub fn writes_depth(self) -> bool {
        self.field(6, 1) == 1
    }

    pub fn depth_compare(self) -> CompareFunction {
        use CompareFunction::{Always, Equal, Greater, GreaterOrEqual, Less, LessOrEqual, Never, NotEqual};
        [Never, Less, Equal, LessOrEqual, Greater, NotEqual, GreaterOrEqual, Always][self.field(7, 3)]
    }

    pub fn is_clockwise(self) -> bool {
        self.0 & CLOCKWISE != 0
    }

    /// Returns true if the key has one of some parts.
    pub fn has_any(self, parts: PartIndices) -> bool {
        let pairs = [(parts.offset(), self.offset()), (parts.stencil(), self.stencil()), (parts.blend(), self.blend())];
        pairs.iter().any(|(part, own)| *part != 0 && part == own)
    }

    /// Returns true if points are drawn as squares.
    pub fn is_square(self) -> bool {
        self.kind() == Kind::Points && self.0 & SQUARES != 0
    }

    /// Returns the polygon mode of triangles.
    pub fn polygon_mode(self) -> PolygonMode {
        if self.is_square() {
            return PolygonMode::Fill;
        }
        [PolygonMode::Fill, PolygonMode::Line, PolygonMode::Point, PolygonMode::Fill][self.field(11, 2)]
    }

    /// Returns the written colours: red, green and blue in bits 0 to 2.
    pub fn color_mask(self) -> usize {
        self.field(13, 3)
    }

    /// Returns the index of blend function and equation; 0 without blending.
    pub fn blend(self) -> u8 {
        self.field(16, 6) as u8
    }

    pub fn air(self) -> AirKind {
        [AirKind::Atmosphere, AirKind::Haze, AirKind::Clear, AirKind::Atmosphere][self.field(AIR_SHIFT, 2)]
    }

    pub fn offset(self) -> u8 {
        self.field(28, 6) as u8
    }

    pub fn stencil(self) -> u8 {
        self.field(34, 6) as u8
    }

    pub fn target(self) -> usize {
        self.field(42, 6)
    }

    pub fn has_alpha_to_coverage(self) -> bool {
        self.0 & ALPHA_TO_COVERAGE != 0
    }

    pub fn shading(self) -> Shading {
        match self.field(48, 9) {
            0 if self.0 & FIXED != 0 && self.0 & TEXTURED != 0 => Shading::FixedTextured,
            0 if self.0 & FIXED != 0 => Shading::FixedFunction,
            0 => Shading::Plain,
            0x1ff => Shading::Fallback,
            program => Shading::Program(program as u16 - 1),
        }
    }

    /// Returns the key for pulled meshes. Programs do not pull; their vertices come from vertex buffers.
    pub fn pulled(self) -> Self {
        Self(self.0 | (PULLED as u64) << VERTICES_SHIFT)
    }

    /// Returns the key for meshes with a vertex format.
    pub fn with_vertices(self, format: VertexFormat) -> Self {
        Self(self.0 | (format as u64) << VERTICES_SHIFT)
    }

    /// Returns the key for a metallic-roughness surface. Programs, the fixed function, shadow maps, lines and points draw
    /// without it.
    pub fn with_surface(self) -> Self {
        let is_plain = self.0 & (FIXED | PROGRAM | CASTER) == 0 && self.kind() == Kind::Triangles;
        Self(if is_plain { self.0 | TEXTURED } else { self.0 })
    }

    /// Returns true if the bind group of the block is that of a set of surfaces.
    pub fn has_surface(self) -> bool {
        self.0 & (FIXED | TEXTURED) == TEXTURED
    }

    /// Returns true if local lights shine on the leaves.
    pub fn has_local_lights(self) -> bool {
        self.0 & LOCAL_LIGHTS != 0
    }

    /// Returns the key for full vertices with custom attributes, by index of their layout from 1 on.
    pub fn with_layout(self, index: u32) -> Self {
        Self(self.0 | u64::from(index & 15) << LAYOUT_SHIFT)
    }

    /// Returns the index of the layout of custom attributes; 0 without any.
    pub fn layout(self) -> u32 {
        self.field(LAYOUT_SHIFT, 4) as u32
    }

    /// Returns the vertex format; `None` for pulled meshes.
    pub fn vertices(self) -> Option<VertexFormat> {
        use VertexFormat::{Full, Packed, Quantized};
        [Some(Full), Some(Packed), Some(Quantized), None][self.field(VERTICES_SHIFT, 2)]
    }

    /// Returns true if all vertices share the one colour of the pool.
    pub fn is_white(self) -> bool {
        matches!(self.vertices(), Some(VertexFormat::Packed | VertexFormat::Quantized))
    }

    /// Returns true if the shader is one with shadow maps: it receives shadows or casts them.
    pub fn has_shadows(self) -> bool {
        self.0 & (SHADOWED | CASTER) != 0
    }

    /// Returns true for casters, which draw depth alone.
    pub fn is_caster(self) -> bool {
        self.0 & CASTER != 0
    }

    pub fn is_pulled(self) -> bool {
        self.field(VERTICES_SHIFT, 2) == PULLED
    }

    pub fn is_fading(self) -> bool {
        self.0 & FADING != 0
    }

    /// Returns the number by which keys are sorted.
    pub fn order(self) -> u64 {
        self.0
    }

    /// Returns the key of the pipeline that stands in if this one cannot be created.
    pub fn fallback(self) -> Self {
        let units = if self.has_surface() { 0 } else { TEXTURED };
        let plain = self.0 & !(PROGRAM | FIXED | LOCAL_LIGHTS | units | FADING);
        Self(if self.kind() == Kind::Height { plain } else { plain | PROGRAM })
    }

    fn field(self, shift: u32, bits: u32) -> usize {
        (self.0 >> shift) as usize & ((1 << bits) - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, BlendEquation, BlendFunc, Depth, StateSet, StateValue};

    #[test]
    fn keys_return_the_properties_they_were_made_of() {
        let set = StateSet::default()
            .with(Attribute::BlendFunc(BlendFunc::ADD))
            .with(Attribute::BlendEquation(BlendEquation::Max))
            .with(Attribute::Depth(Depth { function: CompareFunction::NotEqual, write: false, ..Depth::default() }))
            .with(Attribute::CullFace(CullFace::Front))
            .with(Attribute::FrontFace(FrontFace::Clockwise))
            .with(Attribute::PolygonMode(PolygonMode::Point))
            .with(Attribute::ColorMask(ColorMask([true, false, true])));
        let parts = PartIndices::new(50, 60, 40);
        let state = StateKey::new(&ResolvedState::default().below(&set), parts, Shading::Program(500), 33);
        let key = PipelineKey::mesh(&state, Topology::Triangles, false, false, false);
        assert_eq!((key.kind(), key.alpha(), key.culled()), (Kind::Triangles, Alpha::Blended, 2));
        let alpha = |topology, is_masked| PipelineKey::mesh(&state, topology, is_masked, false, false).alpha();
        assert_eq!(alpha(Topology::Triangles, true), Alpha::MaskedBlended);
        assert_eq!(alpha(Topology::Lines, true), Alpha::Blended);
        assert_eq!((key.writes_depth(), key.depth_compare()), (false, CompareFunction::NotEqual));
        assert_eq!((key.is_clockwise(), key.polygon_mode(), key.color_mask()), (true, PolygonMode::Point, 0b101));
        assert_eq!((key.blend(), key.offset()), (40, 50));
        assert_eq!((key.stencil(), key.target(), key.shading()), (60, 33, Shading::Program(500)));
        assert_eq!(key.fallback().shading(), Shading::Fallback);
        assert!(!state.can_fade && state.fading() == state);
        let height = PipelineKey::height(&state, false);
        assert_eq!((height.shading(), height.fallback().shading()), (Shading::Program(500), Shading::Plain));
        let broken = StateKey::new(&ResolvedState::default(), parts, Shading::Fallback, 33);
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
        assert!(!key.with_surface().has_surface(), "programs draw without surfaces");
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
        let surface = PipelineKey::mesh(&state, Topology::Triangles, false, false, false).with_surface();
        assert_eq!((surface.has_surface(), surface.shading()), (true, Shading::Plain));
        assert_eq!((surface.fallback().has_surface(), surface.fallback().shading()), (true, Shading::Fallback));
        assert!(!PipelineKey::mesh(&state, Topology::Lines, false, false, false).with_surface().has_surface());
        let near_lights = ResolvedState::default().below_local_lights();
        for (shading, is_lit) in [(Shading::Plain, true), (Shading::FixedFunction, false), (Shading::Program(0), false)]
        {
            let state = StateKey::new(&near_lights, PartIndices::default(), shading, 0);
            let key = PipelineKey::mesh(&state, Topology::Triangles, false, false, false).with_surface();
            assert_eq!((key.has_local_lights(), key.shading()), (is_lit, shading));
            assert!(!key.fallback().has_local_lights());
            let caster = StateKey::caster(&near_lights, shading, false, 0);
            assert!(!PipelineKey::mesh(&caster, Topology::Triangles, false, false, false).has_local_lights());
        }
        let fading = PipelineKey::height(&state.fading(), true);
        assert!(fading.is_fading() && fading.shading() == Shading::Plain);
        let key = PipelineKey::height(&state, true);
        assert!(!key.is_fading());
        assert_eq!((key.kind(), key.culled(), key.blend(), key.color_mask()), (Kind::Height, 0, 0, 7));
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
