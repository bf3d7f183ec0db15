//! State sets and attributes of an .osg file.

use std::sync::Arc;

use glam::DMat4;

use super::Reader;
use super::fields::{Block, Field, number_of};
use crate::formats::osg::classes::{EQUATIONS, FOG_MODES, PLANES, TEX_GEN_MODES};
use crate::formats::osg::error::Result;
use crate::formats::osg::input::{GL_NAMES, Names, value_of};
use crate::formats::osg::objects::{
    AttributeObject, ClipPlaneObject, CombineObject, CombinePart, FogObject, ImageData, ImageObject, LightModelObject,
    LightObject, MaterialObject, Object, StateObject, TexMatObject, TextureObject, TextureTarget,
};

/// The number of texture units that a state set can have.
const MAX_UNITS: usize = 16;
/// Modes that belong to a texture unit.
const TEXTURE_MODES: [u32; 9] = [0xde0, 0xde1, 0x806f, 0x8513, 0x84f5, 0xc60, 0xc61, 0xc62, 0xc63];
/// Modes of the first versions, by the names of what they do.
const NAMED_MODES: Names = &[
    ("transparency", 0xbe2),
    ("face_culling", 0xb44),
    ("lighting", 0xb50),
    ("texturing", 0xde1),
    ("fogging", 0xb60),
    ("alpha_test", 0xbc0),
];
/// Attributes without effect here.
const OTHERS: [&str; 2] = ["ShadeModel", "LineWidth"];

impl Reader {
    pub(super) fn state_set(&mut self, block: &Block<'_>) -> Result<StateObject> {
        let mut state = StateObject { name: block.word("name").to_owned(), ..StateObject::default() };
        self.add_states(&mut state, block, None)?;
        state.hint = match block.word("rendering_hint") {
            "OPAQUE_BIN" => 1,
            "TRANSPARENT_BIN" => 2,
            word => number_of(word).unwrap_or(0.0) as i32,
        };
        // The first versions sort what is transparent.
        if block.word("transparency") == "ON" {
            state.hint = 2;
        }
        state.bin_mode = match block.word("renderBinMode") {
            "USE" | "ENCLOSE" => 1,
            "OVERRIDE" => 2,
            "PROTECTED" => 4,
            "OVERRIDE|PROTECTED" => 6,
            _ => 0,
        };
        state.bin_number = block.value("binNumber").unwrap_or(0.0) as i32;
        state.bin_name = block.word("binName").to_owned();
        state.nest_bins = true;
        Ok(state)
    }

    /// Adds the modes and attributes of a block: those of a texture unit, or of the state set itself.
    fn add_states(&mut self, state: &mut StateObject, block: &Block<'_>, unit: Option<usize>) -> Result<()> {
        for field in &block.fields {
            let inner = field.block.as_ref().zip(number_of(field.word(1)));
            if let Some((inner, number)) = inner.filter(|_| unit.is_none() && field.word(0) == "textureUnit") {
                if (number as usize) < MAX_UNITS {
                    self.add_states(state, inner, Some(number as usize))?;
                }
                continue;
            }
            if let Some((mode, flags)) = mode_of(field) {
                match unit.or(TEXTURE_MODES.contains(&mode).then_some(0)) {
                    Some(unit) => of_unit(&mut state.texture_modes, unit).push((mode, flags)),
                    None => state.modes.push((mode, flags)),
                }
                continue;
            }
            let Some(Object::Attribute(attribute)) = self.object(field)? else { continue };
            let is_of_texture = matches!(
                *attribute,
                AttributeObject::Texture(_)
                    | AttributeObject::TexEnv { .. }
                    | AttributeObject::Combine(_)
                    | AttributeObject::TexGen { .. }
                    | AttributeObject::TexMat(_)
            );
            match unit.or(is_of_texture.then_some(0)) {
                Some(unit) => of_unit(&mut state.texture_attributes, unit).push((attribute, 0)),
                None => state.attributes.push((attribute, 0)),
            }
        }
        Ok(())
    }

    /// Reads an attribute; `None` if the class is none that is read.
    pub(super) fn attribute(&mut self, class: &str, block: &Block<'_>) -> Option<AttributeObject> {
        let gl = |name: &str, default: u32| value_of(GL_NAMES, block.word(name)).unwrap_or(default);
        Some(match class {
            "Material" => AttributeObject::Material(material(block)),
            "Texture1D" => AttributeObject::Texture(texture(block, TextureTarget::D1)),
            "Texture2D" | "Texture" => AttributeObject::Texture(texture(block, TextureTarget::D2)),
            "TextureRectangle" => AttributeObject::Texture(texture(block, TextureTarget::Rectangle)),
            "Texture3D" => AttributeObject::Texture(texture(block, TextureTarget::D3)),
            "TextureCubeMap" => AttributeObject::Texture(texture(block, TextureTarget::Cube)),
            "TexEnv" => {
                const MODES: Names =
                    &[("DECAL", 0x2101), ("MODULATE", 0x2100), ("BLEND", 0xbe2), ("REPLACE", 0x1e01), ("ADD", 0x104)];
                let mode = value_of(MODES, block.word("mode")).unwrap_or(0x2100);
                AttributeObject::TexEnv { mode, color: color(block, "color") }
            }
            "TexEnvCombine" => {
                let part = |mut part: CombinePart, kind: &str| {
                    part.function = gl(&format!("combine_{kind}"), part.function);
                    for i in 0..3 {
                        part.sources[i] = gl(&format!("source{i}_{kind}"), part.sources[i]);
                        part.operands[i] = gl(&format!("operand{i}_{kind}"), part.operands[i]);
                    }
                    part.scale = block.value(&format!("scale_{kind}")).map_or(part.scale, |scale| scale as f32);
                    part
                };
                let CombineObject { color: of_color, alpha, .. } = CombineObject::default();
                let constant = color(block, "constantColor");
                AttributeObject::Combine(CombineObject {
                    color: part(of_color, "RGB"),
                    alpha: part(alpha, "Alpha"),
                    constant,
                })
            }
            "TexGen" => {
                let names = ["plane_s", "plane_t", "plane_r", "plane_q"];
                let mut planes = PLANES;
                for (plane, name) in planes.iter_mut().zip(names) {
                    *plane = block.values(name).unwrap_or(*plane);
                }
                AttributeObject::TexGen { mode: value_of(TEX_GEN_MODES, block.word("mode")).unwrap_or(0x2401), planes }
            }
            "TexMat" => {
                // The numbers stand in the TexMat itself, as lines behind its other fields.
                let lines = block.fields.iter().filter(|field| number_of(field.word(0)).is_some());
                let lines = lines.flat_map(|field| &field.words).filter_map(|word| number_of(word));
                let numbers: Vec<f64> = block.numbers.iter().copied().chain(lines).collect();
                let numbers: Option<[f64; 16]> = numbers.try_into().ok();
                let matrix = numbers.map_or(DMat4::IDENTITY, |numbers| DMat4::from_cols_array(&numbers));
                let scales_by_size = block.word("scaleByTextureRectangleSize") == "TRUE";
                AttributeObject::TexMat(TexMatObject { matrix, scales_by_size })
            }
            "BlendFunc" => {
                let (source, destination) = (gl("source", 0x302), gl("destination", 0x303));
                let alpha = [gl("sourceAlpha", source), gl("destinationAlpha", destination)];
                AttributeObject::BlendFunc([source, destination, alpha[0], alpha[1]])
            }
            "AlphaFunc" => {
                let reference = block.value("referenceValue").unwrap_or(1.0) as f32;
                AttributeObject::AlphaFunc { function: gl("comparisonFunc", 0x207), reference }
            }
            "CullFace" => AttributeObject::CullFace(match block.word("mode") {
                "FRONT" => 0x404,
                "FRONT_AND_BACK" => 0x408,
                _ => 0x405,
            }),
            "FrontFace" => AttributeObject::FrontFace(if block.word("mode") == "CLOCKWISE" { 0x900 } else { 0x901 }),
            "Depth" => {
                let range = block.values("range").unwrap_or([0.0, 1.0]);
                AttributeObject::Depth { function: gl("function", 0x201), range, write: block.is_true("writeMask") }
            }
            "PolygonOffset" => {
                let number = |name| block.value(name).unwrap_or(0.0) as f32;
                AttributeObject::PolygonOffset { factor: number("factor"), units: number("units") }
            }
            "Point" => {
                let attenuation = block.values("distance_attenuation").unwrap_or([1.0, 0.0, 0.0]);
                let size_px = block.value("size").unwrap_or(1.0) as f32;
                AttributeObject::of_point(size_px, attenuation.map(|part| part as f32))
            }
            "ColorMask" => {
                let names = ["redMask", "greenMask", "blueMask", "alphaMask"];
                AttributeObject::ColorMask(names.map(|name| block.is_true(name)))
            }
            _ if let Some(attribute) = lighting(class, block) => attribute,
            _ => AttributeObject::Other(OTHERS.iter().find(|other| **other == class)?),
        })
    }
}

/// Returns a light, a clip plane, fog or a further attribute of pixels; `None` for other classes.
fn lighting(class: &str, block: &Block<'_>) -> Option<AttributeObject> {
    let number = |name: &str, default: f64| block.value(name).unwrap_or(default) as f32;
    Some(match class {
        "Light" => AttributeObject::Light(LightObject {
            number: block.value("light_num").unwrap_or(0.0) as i32,
            ambient: color(block, "ambient"),
            diffuse: color(block, "diffuse"),
            specular: color(block, "specular"),
            position: block.values("position").unwrap_or([0.0, 0.0, 1.0, 0.0]),
            direction: block.values("direction").unwrap_or([0.0, 0.0, -1.0]),
            attenuation: [
                number("constant_attenuation", 1.0),
                number("linear_attenuation", 0.0),
                number("quadratic_attenuation", 0.0),
            ],
            spot_exponent: number("spot_exponent", 0.0),
            spot_cutoff_deg: number("spot_cutoff", 180.0),
        }),
        "LightModel" => AttributeObject::LightModel(LightModelObject {
            ambient: color(block, "ambientIntensity"),
            has_separate_specular: block.word("colorControl") == "SEPARATE_SPECULAR_COLOR",
            local_viewer: block.word("localViewer") == "TRUE",
            two_sided: block.word("twoSided") == "TRUE",
        }),
        "Fog" => AttributeObject::Fog(FogObject {
            mode: value_of(FOG_MODES, block.word("mode")).unwrap_or(0x2601),
            start: number("start", 0.0),
            end: number("end", 1.0),
            density: number("density", 1.0),
            color: color(block, "color"),
        }),
        "ClipPlane" => AttributeObject::ClipPlane(ClipPlaneObject {
            number: block.value("clipPlaneNum").unwrap_or(0.0) as u32,
            plane: block.values("plane").unwrap_or([0.0; 4]),
        }),
        "PolygonMode" => {
            let is_of_front = |field: &&Field<'_>| field.word(0) == "mode" && field.word(1) != "BACK";
            let field = block.fields.iter().find(is_of_front);
            AttributeObject::PolygonMode(field.and_then(|field| value_of(GL_NAMES, field.word(2))).unwrap_or(0x1b02))
        }
        "BlendColor" => AttributeObject::BlendColor(color(block, "constantColor")),
        "BlendEquation" => {
            let equation = |name: &str| value_of(EQUATIONS, block.word(name));
            let both = equation("equation").unwrap_or(0x8006);
            let [of_color, of_alpha] = ["equationRGB", "equationAlpha"].map(|name| equation(name).unwrap_or(both));
            AttributeObject::BlendEquation([of_color, of_alpha])
        }
        _ => return None,
    })
}

/// Returns the list of a unit.
fn of_unit<T>(units: &mut Vec<Vec<T>>, unit: usize) -> &mut Vec<T> {
    if units.len() <= unit {
        units.resize_with(unit + 1, Vec::new);
    }
    &mut units[unit]
}

/// Returns the mode of a field with its flags; `None` if it is none.
fn mode_of(field: &Field<'_>) -> Option<(u32, u32)> {
    const FLAGS: Names = &[("OFF", 0), ("ON", 1), ("OVERRIDE", 2), ("PROTECTED", 4), ("INHERIT", 8)];
    let name = field.word(0);
    let mode = value_of(GL_NAMES, name).filter(|_| name.starts_with("GL_"));
    let mode = mode.or(value_of(NAMED_MODES, name)).or(number_of(name).map(|mode| mode as u32))?;
    let flags = field.word(1).split(['|', '_']).map(|flag| value_of(FLAGS, flag)).sum::<Option<u32>>()?;
    Some((mode, flags))
}

fn material(block: &Block<'_>) -> MaterialObject {
    const COLOR_MODES: Names = &[
        ("AMBIENT", 0x1200),
        ("DIFFUSE", 0x1201),
        ("SPECULAR", 0x1202),
        ("EMISSION", 0x1600),
        ("AMBIENT_AND_DIFFUSE", 0x1602),
    ];
    /// The value of OFF is OSG's own.
    const OFF: u32 = 0x1603;
    /// Front and back of a value that fields set for one or both.
    fn sides<const N: usize>(block: &Block<'_>, name: &str, default: [f32; N]) -> [[f32; N]; 2] {
        let mut sides = [default; 2];
        for field in block.fields.iter().filter(|field| field.word(0) == name) {
            let (from, of) = match field.word(1) {
                "FRONT" => (2, 0..1),
                "BACK" => (2, 1..2),
                _ => (1, 0..2),
            };
            for side in &mut sides[of] {
                for (i, part) in side.iter_mut().enumerate() {
                    // The alpha of a colour may be left out.
                    *part =
                        number_of(field.word(from + i)).map_or(if i == 3 { 1.0 } else { *part }, |value| value as f32);
                }
            }
        }
        sides
    }
    let mut colors = [
        sides(block, "ambientColor", [0.2, 0.2, 0.2, 1.0]),
        sides(block, "diffuseColor", [0.8, 0.8, 0.8, 1.0]),
        sides(block, "specularColor", [0.0, 0.0, 0.0, 1.0]),
        sides(block, "emissionColor", [0.0, 0.0, 0.0, 1.0]),
    ];
    if block.field("emissiveColor").is_some() {
        colors[3] = sides(block, "emissiveColor", [0.0, 0.0, 0.0, 1.0]);
    }
    if let Some(transparency) = block.value("transparency") {
        colors.iter_mut().flatten().for_each(|color| color[3] = 1.0 - transparency as f32);
    }
    let [ambient, diffuse, specular, emission] = colors;
    let color_mode = value_of(COLOR_MODES, block.word("ColorMode")).unwrap_or(OFF);
    let shininess = sides(block, "shininess", [0.0]).map(|[value]| value);
    MaterialObject { color_mode, ambient, diffuse, specular, emission, shininess }
}

/// Returns the colour behind a name; black without alpha without it.
fn color(block: &Block<'_>, name: &str) -> [f32; 4] {
    block.values(name).unwrap_or([0.0; 4]).map(|part| part as f32)
}

fn texture(block: &Block<'_>, target: TextureTarget) -> TextureObject {
    const FACES: [&str; 6] = ["POSITIVE_X", "NEGATIVE_X", "POSITIVE_Y", "NEGATIVE_Y", "POSITIVE_Z", "NEGATIVE_Z"];
    let gl = |name: &str, default: u32| value_of(GL_NAMES, block.word(name)).unwrap_or(default);
    let image = |file_name: &str| {
        let file_name = file_name.to_owned();
        (!file_name.is_empty()).then(|| Arc::new(ImageObject { file_name, data: ImageData::External }))
    };
    let face = |name: &str| block.fields.iter().find(|field| field.word(0) == "image" && field.word(1) == name);
    let images = match target {
        TextureTarget::Cube => FACES.iter().map(|name| image(face(name)?.word(2))).collect(),
        _ => vec![image(block.word("file")).or_else(|| image(&first_of_sequence(block)?))],
    };
    TextureObject {
        target,
        wrap: ["wrap_s", "wrap_t"].map(|name| gl(name, 0x2900)),
        min_filter: gl("min_filter", 0x2703),
        mag_filter: gl("mag_filter", 0x2601),
        border_color: color(block, "borderColor"),
        images,
    }
}

/// Returns the name of the first image of an ImageSequence.
fn first_of_sequence(block: &Block<'_>) -> Option<String> {
    let sequence = block.field("ImageSequence")?.block.as_ref()?;
    let names = sequence.field("FileNames")?.block.as_ref()?;
    names.fields.first()?.words.first().map(|word| word.to_string())
}
