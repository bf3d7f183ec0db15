//! What a pipeline is chosen by: the kind of drawable and the pipeline part of its state, packed.
//!
//! ```text
//! bits 0-1 kind   2-3 alpha   4-5 culled faces   6 depth write   7-9 depth compare   10 clockwise front faces
//! 11-12 polygon mode   13-15 color mask   16-21 blending   22-23 air   24-27 further attributes   28-33 offset   34-39 stencil   40 fixed function   41 alpha to coverage   42-47 target   48-57 program   58-59 vertices   60 texture units   61 fading   62 receives shadows   63 casts
//! ```

use crate::scene::{Environment, Sky, Topology, VertexFormat};
use crate::state::{
    BlendEquation, BlendFunc, ColorMask, CompareFunction, CullFace, FrontFace, Mode, PolygonMode, PolygonOffset,
    ResolvedState, Stencil,
};

/// Key of a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(in crate::draw) struct PipelineKey(u64);

/// What the fragment shader does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Alpha {
    Opaque,
    Masked,
    Blended,
    MaskedBlended,
}

/// What the vertices are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Kind {
    Height,
    Triangles,
    Lines,
    Points,
}

const CLOCKWISE: u64 = 1 << 10;
/// What triangles alone have: culled faces, polygon mode, offset.
const OF_TRIANGLES: u64 = 3 << 4 | 3 << 11 | 0x3f << 28;
const AIR_SHIFT: u32 = 22;
const LAYOUT_SHIFT: u32 = 24;
const FIXED: u64 = 1 << 40;
const ALPHA_TO_COVERAGE: u64 = 1 << 41;
const PROGRAM: u64 = 0x3ff << 48;
const VERTICES_SHIFT: u32 = 58;
/// Of [`VERTICES_SHIFT`], where a [`VertexFormat`] may stand.
const PULLED: usize = 3;
const TEXTURED: u64 = 1 << 60;
const FADING: u64 = 1 << 61;
const SHADOWED: u64 = 1 << 62;
const CASTER: u64 = 1 << 63;

/// What is between things and the eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum AirKind {
    /// Whatever the frame says.
    Atmosphere,
    /// Haze at most.
    Haze,
    /// Nothing.
    Clear,
}

impl AirKind {
    pub fn of(environment: &Environment) -> Self {
        match environment.sky {
            Sky::Atmosphere => Self::Atmosphere,
            Sky::Background(_) if environment.fog.enabled => Self::Haze,
            Sky::Background(_) => Self::Clear,
        }
    }
}

/// Who shades.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Shading {
    /// Sun, sky and haze: the shaders of height tiles and meshes.
    Plain,
    /// Lights, materials, fog.
    FixedFunction,
    /// The same with textures of units.
    FixedTextured,
    /// One of the application's, by its place among them; height tiles cast their shadows without it.
    Program(u16),
    /// What cannot be shaded as it should, so that it is seen; height tiles are plain.
    Fallback,
}

/// Most programs at once.
pub(in crate::draw) const MOST_PROGRAMS: usize = 1022;
/// Most different targets.
pub(in crate::draw) const MOST_TARGETS: usize = 64;

/// The pipeline part of a resolved state, made once a frame for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::draw) struct StateKey {
    common: u64,
    /// Culled faces of single-sided and of double-sided drawables.
    culled: [u64; 2],
    blends: bool,
    /// Leaves may be drawn in a part of the pixels; those of programs are drawn wholly or not.
    pub can_fade: bool,
    /// Meshes may fetch their vertices themselves.
    pub can_pull: bool,
    /// Leaves may change places: nearer ones hide farther ones in any order.
    pub order_is_free: bool,
    /// Of a shadow map: casters' states differ in little.
    pub casts: bool,
    /// The state itself drops parts of what is drawn.
    drops: bool,
}

impl StateKey {
    /// `target` is the index of what is drawn into.
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
            | u64::from(parts.blend & 63) << 16
            | u64::from(parts.offset & 63) << 28
            | u64::from(parts.stencil & 63) << 34
            | u64::from(target & 63) << 42;
        match shading {
            Shading::Plain => {}
            Shading::FixedFunction => common |= FIXED,
            Shading::FixedTextured => common |= FIXED | TEXTURED,
            Shading::Program(place) => common |= (u64::from(place) + 1) << 48 & PROGRAM,
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
        let order_is_free = write && nearer_wins && is_whole && parts.stencil == 0;
        let can_pull = !matches!(shading, Shading::Program(_));
        let can_fade = !matches!(shading, Shading::Program(_) | Shading::Fallback);
        let culled = [culled(false), culled(true)];
        Self { common, culled, blends, can_fade, can_pull, order_is_free, casts: false, drops: false }
    }

    /// The same for leaves that are drawn in a part of the pixels.
    pub fn fading(self) -> Self {
        Self { common: if self.can_fade { self.common | FADING } else { self.common }, ..self }
    }

    /// The same in some air; programs ask the frame themselves.
    pub fn in_air(self, air: AirKind) -> Self {
        let air = if self.common & PROGRAM == 0 { (air as u64) << AIR_SHIFT } else { 0 };
        Self { common: self.common | air, ..self }
    }

    /// The same where the sun's shadows fall.
    pub fn shadowed(self) -> Self {
        Self { common: self.common | SHADOWED, ..self }
    }

    /// What casts shadows under a state: both sides, whatever the state's order. `drops` is whether the state has an
    /// alpha test or clip planes.
    pub fn caster(state: &ResolvedState, shading: Shading, drops: bool, target: u8) -> Self {
        let mut key = Self::new(state, PartIndices::default(), shading, target);
        let kept = 3 << 11 | FIXED | TEXTURED | PROGRAM | 63 << 42;
        key.common = key.common & kept | CASTER | 1 << 6 | (CompareFunction::LessOrEqual as u64) << 7;
        Self { culled: [0, 0], blends: false, can_fade: false, order_is_free: true, casts: true, drops, ..key }
    }
}

impl PipelineKey {
    /// Height tiles: as of a double-sided material. `mirrored` is whether the transform mirrors; the frame of a tile
    /// is left-handed, so that its own does.
    pub fn height(state: &StateKey, mirrored: bool) -> Self {
        if state.casts {
            let fixed = if state.drops { 0 } else { FIXED | TEXTURED };
            return Self(state.common & !PROGRAM & !fixed);
        }
        let alpha = if state.blends { 2 << 2 } else { 0 };
        let front = if mirrored { 0 } else { CLOCKWISE };
        // What cannot be shaded as it should is plain.
        let fallback = if state.common & PROGRAM == PROGRAM { PROGRAM } else { 0 };
        Self(((state.common & !fallback) | state.culled[1] | alpha) ^ front)
    }

    /// Meshes, lines and points.
    pub fn mesh(state: &StateKey, topology: Topology, is_masked: bool, double_sided: bool, mirrored: bool) -> Self {
        if state.casts {
            let masked = if is_masked { 1 << 2 } else { 0 };
            let fixed = if state.drops || is_masked { 0 } else { FIXED | TEXTURED };
            return Self(state.common & !fixed | masked | 1);
        }
        let kind = match topology {
            Topology::Triangles => 1,
            Topology::Lines => 2,
            Topology::Points => 3,
        };
        let alpha = match () {
            _ if state.blends && is_masked && kind == 1 => 3 << 2,
            _ if state.blends => 2 << 2,
            _ if is_masked && kind == 1 => 1 << 2,
            _ => 0,
        };
        let common = if kind == 1 {
            state.common | state.culled[usize::from(double_sided)]
        } else {
            state.common & !OF_TRIANGLES
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

    /// Bit 0: back faces, bit 1: front faces.
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

    pub fn polygon_mode(self) -> PolygonMode {
        [PolygonMode::Fill, PolygonMode::Line, PolygonMode::Point, PolygonMode::Fill][self.field(11, 2)]
    }

    /// Red, green, blue in bits 0 to 2.
    pub fn color_mask(self) -> usize {
        self.field(13, 3)
    }

    /// Index of function and equation; 0 where blending is off.
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
        match self.field(48, 10) {
            0 if self.0 & TEXTURED != 0 => Shading::FixedTextured,
            0 if self.0 & FIXED != 0 => Shading::FixedFunction,
            0 => Shading::Plain,
            0x3ff => Shading::Fallback,
            place => Shading::Program(place as u16 - 1),
        }
    }

    /// The same for meshes that fetch their vertices themselves. Not for programs, which are given theirs.
    pub fn pulled(self) -> Self {
        Self(self.0 | (PULLED as u64) << VERTICES_SHIFT)
    }

    /// The same for meshes whose vertices lie so.
    pub fn with_vertices(self, format: VertexFormat) -> Self {
        Self(self.0 | (format as u64) << VERTICES_SHIFT)
    }

    /// The same for meshes whose vertices have further attributes, full ones then: the place of their layout.
    pub fn with_layout(self, place: u32) -> Self {
        Self(self.0 | u64::from(place & 15) << LAYOUT_SHIFT)
    }

    /// The place of the layout of further attributes; 0 where there are none.
    pub fn layout(self) -> u32 {
        self.field(LAYOUT_SHIFT, 4) as u32
    }

    /// `None` for those that fetch them themselves.
    pub fn vertices(self) -> Option<VertexFormat> {
        use VertexFormat::{Full, Packed, Quantized};
        [Some(Full), Some(Packed), Some(Quantized), None][self.field(VERTICES_SHIFT, 2)]
    }

    /// All vertices have the one color of the pool.
    pub fn is_white(self) -> bool {
        matches!(self.vertices(), Some(VertexFormat::Packed | VertexFormat::Quantized))
    }

    /// The sun's shadows fall on it.
    pub fn has_shadows(self) -> bool {
        self.0 & (SHADOWED | CASTER) != 0
    }

    /// It casts shadows: depth alone.
    pub fn is_caster(self) -> bool {
        self.0 & CASTER != 0
    }

    pub fn is_pulled(self) -> bool {
        self.field(VERTICES_SHIFT, 2) == PULLED
    }

    pub fn is_fading(self) -> bool {
        self.0 & FADING != 0
    }

    /// A number in the order of the keys.
    pub fn order(self) -> u64 {
        self.0
    }

    /// The same, shaded so that a fault is seen.
    pub fn fallback(self) -> Self {
        let plain = self.0 & !(PROGRAM | FIXED | TEXTURED | FADING);
        Self(if self.kind() == Kind::Height { plain } else { plain | PROGRAM })
    }

    fn field(self, shift: u32, bits: u32) -> usize {
        (self.0 >> shift) as usize & ((1 << bits) - 1)
    }
}

/// So many different parts of a kind have room in a key's 6 bits.
const MOST_PARTS: usize = 63;

/// Parts of states that are met, each kept once, with the frame in which it was last met; 0 is none.
#[derive(Debug)]
pub(in crate::draw) struct Interned<T>(Vec<(T, u32)>);

impl<T> Default for Interned<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T: Copy + PartialEq> Interned<T> {
    /// The index of a value in a frame, and whether another value had it, that was met neither in this frame nor in the
    /// last. Beyond 63 different ones, which is said, the last is used for all further.
    pub fn index_of(&mut self, value: Option<T>, frame: u32, what: &str, errors: &mut Vec<String>) -> (u8, bool) {
        let Some(value) = value else { return (0, false) };
        let index = |place: usize| place as u8 + 1;
        if let Some(place) = self.0.iter().position(|(of, _)| *of == value) {
            self.0[place].1 = frame;
            return (index(place), false);
        }
        if self.0.len() < MOST_PARTS {
            self.0.push((value, frame));
            return (index(self.0.len() - 1), false);
        }
        let age = |used: u32| frame.wrapping_sub(used);
        let oldest = self.0.iter_mut().enumerate().max_by_key(|(_, (_, used))| age(*used));
        if let Some((place, entry)) = oldest.filter(|(_, (_, used))| age(*used) > 1) {
            *entry = (value, frame);
            return (index(place), true);
        }
        errors.push(format!(
            "more than {MOST_PARTS} different {what} at once; further ones are drawn as the last of them"
        ));
        (index(self.0.len() - 1), false)
    }

    pub fn get(&self, index: u8) -> Option<T> {
        usize::from(index).checked_sub(1).and_then(|i| self.0.get(i)).map(|(value, _)| *value)
    }
}

/// The parts of a state's pipeline that have too many values for bits of their own.
#[derive(Debug, Default)]
pub(in crate::draw) struct Parts {
    pub offsets: Interned<PolygonOffset>,
    /// References apart.
    pub stencils: Interned<Stencil>,
    pub blends: Interned<(BlendFunc, BlendEquation)>,
}

/// Indices of a state's parts in [`Parts`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::draw) struct PartIndices {
    offset: u8,
    stencil: u8,
    blend: u8,
}

impl PartIndices {
    /// One of them is a part of the key.
    pub fn meets(self, key: PipelineKey) -> bool {
        let pairs = [(self.offset, key.offset()), (self.stencil, key.stencil()), (self.blend, key.blend())];
        pairs.iter().any(|(own, of)| *own != 0 && own == of)
    }
}

impl Parts {
    /// Those of a state in a frame, and those of them that meant other values before. What there is no room for goes to
    /// `errors`.
    pub fn of(&mut self, state: &ResolvedState, frame: u32, errors: &mut Vec<String>) -> (PartIndices, PartIndices) {
        let usable = |o: &PolygonOffset| o.factor.is_finite() && o.units.is_finite() && *o != PolygonOffset::default();
        let blend = state.blends().then(|| (state.blend_func(), state.blend_equation()));
        let stencil = state.stencil().map(|s| Stencil { reference: 0, ..s });
        let offset = state.polygon_offset().filter(usable);
        let offset = self.offsets.index_of(offset, frame, "polygon offsets", errors);
        let stencil = self.stencils.index_of(stencil, frame, "stencils", errors);
        let blend = self.blends.index_of(blend, frame, "blend functions and equations", errors);
        let changed = |(index, is_changed): (u8, bool)| if is_changed { index } else { 0 };
        (
            PartIndices { offset: offset.0, stencil: stencil.0, blend: blend.0 },
            PartIndices { offset: changed(offset), stencil: changed(stencil), blend: changed(blend) },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, BlendFactor, Depth, StateSet, StateValue};

    #[test]
    fn what_is_packed_comes_out() {
        let set = StateSet::default()
            .with(Attribute::BlendFunc(BlendFunc::ADD))
            .with(Attribute::BlendEquation(BlendEquation::Max))
            .with(Attribute::Depth(Depth { function: CompareFunction::NotEqual, write: false, ..Depth::default() }))
            .with(Attribute::CullFace(CullFace::Front))
            .with(Attribute::FrontFace(FrontFace::Clockwise))
            .with(Attribute::PolygonMode(PolygonMode::Point))
            .with(Attribute::ColorMask(ColorMask([true, false, true])));
        let parts = PartIndices { offset: 50, stencil: 60, blend: 40 };
        let state = StateKey::new(&ResolvedState::default().below(&set), parts, Shading::Program(1000), 33);
        let key = PipelineKey::mesh(&state, Topology::Triangles, false, false, false);
        assert_eq!((key.kind(), key.alpha(), key.culled()), (Kind::Triangles, Alpha::Blended, 2));
        let alpha = |topology, is_masked| PipelineKey::mesh(&state, topology, is_masked, false, false).alpha();
        assert_eq!(alpha(Topology::Triangles, true), Alpha::MaskedBlended);
        assert_eq!(alpha(Topology::Lines, true), Alpha::Blended);
        assert_eq!((key.writes_depth(), key.depth_compare()), (false, CompareFunction::NotEqual));
        assert_eq!((key.is_clockwise(), key.polygon_mode(), key.color_mask()), (true, PolygonMode::Point, 0b101));
        assert_eq!((key.blend(), key.offset()), (40, 50));
        assert_eq!((key.stencil(), key.target(), key.shading()), (60, 33, Shading::Program(1000)));
        assert_eq!(key.fallback().shading(), Shading::Fallback);
        assert!(!state.can_fade && state.fading() == state);
        let height = PipelineKey::height(&state, false);
        assert_eq!((height.shading(), height.fallback().shading()), (Shading::Program(1000), Shading::Plain));
        let broken = StateKey::new(&ResolvedState::default(), parts, Shading::Fallback, 33);
        assert_eq!(PipelineKey::height(&broken, false).shading(), Shading::Plain);
        assert!(!state.order_is_free);
        for format in [VertexFormat::Full, VertexFormat::Packed, VertexFormat::Quantized] {
            let of_format = key.with_vertices(format);
            assert_eq!((of_format.vertices(), of_format.is_pulled()), (Some(format), false));
            assert_eq!(of_format.is_white(), format != VertexFormat::Full);
        }
        for place in [1, 15] {
            let further = key.with_layout(place);
            assert_eq!((further.layout(), further.vertices()), (place, Some(VertexFormat::Full)));
            assert_eq!((further.fallback().layout(), further.offset(), further.air()), (place, 50, key.air()));
        }
        assert_eq!(key.layout(), 0);
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
    fn the_defaults_are_plain() {
        let state = StateKey::new(&ResolvedState::default(), PartIndices::default(), Shading::Plain, 0);
        assert!(state.order_is_free);
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

    #[test]
    fn parts_are_kept_once() {
        let (mut parts, mut errors) = (Parts::default(), Vec::new());
        let offset = |factor, units| {
            let set = StateSet::default().with(Attribute::PolygonOffset(PolygonOffset { factor, units }));
            ResolvedState::default().below(&set)
        };
        let indices = [ResolvedState::default(), offset(1.0, 2.0), offset(1.0, 2.0), offset(f32::NAN, 0.0)];
        let mut index_in = |frame: u32, state: &ResolvedState| {
            let (of, changed) = parts.of(state, frame, &mut errors);
            assert!(changed == PartIndices::default() || changed.offset == of.offset);
            (of.offset, changed.offset != 0, errors.len())
        };
        assert_eq!(indices.map(|state| index_in(0, &state).0), [0, 1, 1, 0]);
        // As many as there are places at once, and no more.
        for i in 1..100u8 {
            let full = usize::from(i.saturating_sub(62));
            assert_eq!(index_in(1, &offset(0.0, f32::from(i))), (u8::min(i + 1, 63), false, full));
        }
        let errors_so_far = 100 - 63;
        assert_eq!(index_in(2, &offset(0.0, 5.0)), (6, false, errors_so_far));
        // That of the first frame is the oldest; in the frame after, all but one are old.
        assert_eq!(index_in(2, &offset(7.0, 1.0)), (1, true, errors_so_far));
        assert_eq!(index_in(2, &offset(7.0, 2.0)), (63, false, errors_so_far + 1));
        for i in 0..60 {
            assert_eq!(index_in(3 + i, &offset(8.0, 1.0 + i as f32)).2, errors_so_far + 1);
        }
        assert_eq!(parts.offsets.get(1).map(|o| o.factor), Some(7.0));
        assert_eq!((parts.offsets.get(0), parts.offsets.get(64)), (None, None));
        assert!(errors[0].contains("polygon offsets"));
        let blend = |func| {
            let set = StateSet::default().with(Attribute::BlendFunc(func)).with_mode(Mode::Blend, StateValue::ON);
            ResolvedState::default().below(&set)
        };
        let apart = BlendFunc::ALPHA.with_alpha(BlendFactor::One, BlendFactor::Zero);
        let states = [BlendFunc::ALPHA, apart, BlendFunc::ALPHA].map(blend);
        assert_eq!(states.map(|state| parts.of(&state, 0, &mut errors).0.blend), [1, 2, 1]);
        assert_eq!(parts.blends.get(2), Some((apart, BlendEquation::Add)));
    }
}
