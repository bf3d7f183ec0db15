//! The colours of the ground: biomes by climate, rock by slope, water by depth, with variation at all scales.

use super::super::preset::{Flow, Palette, Parameters};
use super::super::relief::{Layer, smooth, wide};
use super::climate::LAPSE_C;
use super::lumps::Details;

/// The properties of the ground at each texel of a row, as separate arrays, so that the loop can be vectorised.
#[derive(Clone, Debug, Default)]
pub(crate) struct Texels {
    /// Height of the visible surface in metres.
    pub surface_m: Vec<f32>,
    /// Depth of the water in metres; below 0 on land.
    pub depth_m: Vec<f32>,
    /// Distance from the bank of the nearest river in metres.
    pub stream_m: Vec<f32>,
    /// At samples, the bends of rivers in metres along each axis; at texels, the shares of water, moraines and crevasses.
    pub marks: [Vec<f32>; 3],
    /// The tangent of the slope.
    pub slope: Vec<f32>,
    /// How far the point lies above its surroundings, as a share of their distance.
    pub open: Vec<f32>,
    pub inland: Vec<f32>,
    pub mountain: Vec<f32>,
    pub ridge: Vec<f32>,
    /// The height in metres by which layers of rock lie lower here than elsewhere.
    pub dip_m: Vec<f32>,
    pub cover: Vec<f32>,
    pub sea_level_c: Vec<f32>,
    pub moisture: Vec<f32>,
    /// Noise within about -1..1 of long and of short wavelengths.
    pub patch: Vec<f32>,
    pub grain: Vec<f32>,
}

impl Texels {
    /// The buffers in a fixed order.
    pub fn all(&mut self) -> [&mut Vec<f32>; 17] {
        let [x, y, z] = &mut self.marks;
        [
            &mut self.surface_m,
            &mut self.depth_m,
            &mut self.stream_m,
            x,
            y,
            z,
            &mut self.slope,
            &mut self.open,
            &mut self.inland,
            &mut self.mountain,
            &mut self.ridge,
            &mut self.dip_m,
            &mut self.cover,
            &mut self.sea_level_c,
            &mut self.moisture,
            &mut self.patch,
            &mut self.grain,
        ]
    }
}

/// Returns the moisture of the ground: hollows, gullies and the banks of rivers are wetter than ridges.
#[inline(always)]
pub(super) fn wetness(moisture: f32, patch: f32, open: f32, ridge: f32, stream_m: f32) -> f32 {
    moisture + 0.12 * patch - 0.1 * open.clamp(-0.3, 0.3) - 0.07 * ridge.clamp(-1.0, 1.0)
        + 0.11 * smooth(320.0, 20.0, stream_m)
}

/// Returns the share of forest. Its edges break up into groups of trees, and there are clearings.
#[inline(always)]
pub(super) fn wood(living: f32, celsius: f32, wet: f32, slope: f32, patch: f32, grain: f32) -> f32 {
    let density = living
        * smooth(0.5, 5.0, celsius + 2.0 * patch)
        * smooth(0.42, 0.66, wet + 0.25 * patch)
        * (1.0 - smooth(0.6, 0.9, slope));
    let clearing = smooth(0.42, 0.55, patch + 0.05 * grain);
    let threshold = 0.5 + 0.25 * grain.clamp(-1.2, 1.2);
    smooth(threshold - 0.2, threshold + 0.2, density * (1.0 - 0.9 * clearing)) * smooth(0.02, 0.15, density)
}

/// The channels of two colours of ice without snow, and those of the ice in crevasses.
const BARE_ICE: [[f32; 2]; 3] = [[142.0, 196.0], [182.0, 214.0], [206.0, 226.0]];
const CREVASSE: [f32; 3] = [52.0, 122.0, 168.0];
/// The channels of salt, and the shares by which conifers are darker than other trees.
const SALT: [f32; 3] = [232.0, 226.0, 214.0];
const CONIFERS: [f32; 3] = [0.22, 0.16, 0.02];

#[inline(always)]
fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

impl Parameters {
    /// Computes the sRGB colours, 0..255, of a row of texels of a size in metres.
    pub(crate) fn color(&self, texels: &Texels, details: &Details, texel_m: f32, out: &mut [Vec<f32>; 3]) {
        let n = texels.surface_m.len();
        for channel in out.iter_mut() {
            channel.clear();
            channel.resize(n, 0.0);
        }
        let (palette, conditions) = (&self.palette, self.conditions(texel_m));
        let [red, green, blue] = out;
        let (red, green, blue) = (&mut red[..n], &mut green[..n], &mut blue[..n]);
        let surface_m = &texels.surface_m[..n];
        let depth_m = &texels.depth_m[..n];
        let stream_m = &texels.stream_m[..n];
        let [streams, moraines, crevasses] = [0, 1, 2].map(|k| &texels.marks[k][..n]);
        let slope = &texels.slope[..n];
        let open = &texels.open[..n];
        let inland = &texels.inland[..n];
        let ridge = &texels.ridge[..n];
        let dip_m = &texels.dip_m[..n];
        let cover = &texels.cover[..n];
        let sea_level_c = &texels.sea_level_c[..n];
        let moisture = &texels.moisture[..n];
        let patch = &texels.patch[..n];
        let grain = &texels.grain[..n];
        let [domes, tones, ripples] = [&details.dome, &details.tone, &details.ripple].map(|field| &field[..n]);
        wide(
            #[inline(always)]
            move || {
                for k in 0..n {
                    let texel = Texel {
                        surface_m: surface_m[k],
                        depth_m: depth_m[k],
                        stream_m: stream_m[k],
                        marks: [streams[k], moraines[k], crevasses[k]],
                        slope: slope[k],
                        open: open[k],
                        inland: inland[k],
                        ridge: ridge[k],
                        dip_m: dip_m[k],
                        cover: cover[k],
                        sea_level_c: sea_level_c[k],
                        moisture: moisture[k],
                        patch: patch[k],
                        grain: grain[k],
                        details: [domes[k], tones[k], ripples[k]],
                    };
                    let shares = conditions.shares(&texel);
                    red[k] = shares.channel(palette, 0);
                    green[k] = shares.channel(palette, 1);
                    blue[k] = shares.channel(palette, 2);
                }
            },
        );
    }

    fn conditions(&self, texel_m: f32) -> Conditions {
        let share = |is_there: bool| if is_there { 1.0f32 } else { 0.0 };
        let living = share(self.climate.has_life);
        Conditions {
            close: smooth(3.0, 0.3, texel_m),
            living,
            coasts: share(self.relief.has_sea),
            glaciers: share(self.relief.rivers.flow == Flow::Ice),
            dry: living * share(self.relief.rivers.flow == Flow::Dry),
            // Without life there is snow only at the poles, of carbon dioxide.
            freezing_c: if self.climate.has_life { 0.0 } else { -98.0 },
            per_layer: 1.0 / self.relief.strata_m(),
            layers: self.palette.layers,
        }
    }
}

/// The conditions that hold for all texels of a row. The shares are 0 or 1.
#[derive(Clone, Copy)]
struct Conditions {
    /// How far single stones and tufts are seen: in small texels. Larger ones average them.
    close: f32,
    living: f32,
    coasts: f32,
    glaciers: f32,
    /// Rivers and lakes that are dry.
    dry: f32,
    freezing_c: f32,
    /// The number of layers of rock in a metre.
    per_layer: f32,
    /// The contrast of layers of rock.
    layers: f32,
}

/// The properties of the ground at one texel; see [`Texels`] and [`Details`].
#[derive(Clone, Copy)]
struct Texel {
    surface_m: f32,
    depth_m: f32,
    stream_m: f32,
    /// The shares of water, moraines and crevasses.
    marks: [f32; 3],
    slope: f32,
    open: f32,
    inland: f32,
    ridge: f32,
    dip_m: f32,
    cover: f32,
    sea_level_c: f32,
    moisture: f32,
    patch: f32,
    grain: f32,
    /// Dome, tone and ripple.
    details: [f32; 3],
}

/// The plants of a texel, as shares.
#[derive(Clone, Copy)]
struct Growth {
    green: f32,
    lush: f32,
    wood: f32,
    stand: f32,
    conifer: f32,
}

/// The ground on which nothing grows, as shares.
#[derive(Clone, Copy)]
struct Bare {
    sandy: f32,
    maria: f32,
    beach: f32,
    stony: f32,
    desert: f32,
    steep: f32,
    scree: f32,
    strata: f32,
}

/// The water of a texel and what water leaves, as shares.
#[derive(Clone, Copy)]
struct Waters {
    water: f32,
    gravel: f32,
    salt: f32,
    foam: f32,
    shallow: f32,
    deep: f32,
    frozen: f32,
}

/// The steps from a texel to its colour. Inlined, so that the loop over texels can be vectorised.
impl Conditions {
    #[inline(always)]
    fn shares(&self, texel: &Texel) -> Shares {
        let Texel { patch, grain, .. } = *texel;
        let celsius = texel.sea_level_c - LAPSE_C * texel.surface_m.max(0.0);
        let wet = wetness(texel.moisture, patch, texel.open, texel.ridge, texel.stream_m);
        let warm = smooth(-2.0, 5.0, celsius + 1.5 * patch);
        let growth = self.growth(texel, celsius, wet, warm);
        let bare = self.bare(texel, celsius, wet, warm);
        let (snow, ice) = self.snow_and_ice(texel, celsius);
        let waters = self.waters(texel);
        let Growth { green, lush, wood, stand, conifer } = growth;
        let Bare { sandy, maria, beach, stony, desert, steep, scree, strata } = bare;
        let Waters { water, gravel, salt, foam, shallow, deep, frozen } = waters;
        let [_, moraine, crevasse] = texel.marks;
        let fine = 0.5 + 0.4 * patch + (0.35 + 0.35 * self.close) * grain + 0.16 * texel.details[1];
        // Pebbles between grass, and many where nothing grows; none on sand, in woods and under snow.
        let pebble = self.close
            * smooth(0.5, 0.75, grain - 0.3 * patch)
            * (1.0 - 0.85 * green)
            * (1.0 - wood)
            * (1.0 - sandy)
            * (1.0 - snow);
        Shares {
            variation: [(0.5 + 0.5 * patch).clamp(0.0, 1.0), fine.clamp(0.0, 1.0)],
            ground: (maria + desert).min(1.0),
            stony,
            scree: scree * (1.0 - 0.8 * wood),
            gravel,
            salt,
            foam,
            stand,
            conifer,
            crest: 0.12 * texel.ridge.clamp(-1.0, 1.0),
            green,
            lush,
            pebble,
            wood,
            beach,
            sandy: sandy * (1.0 - ice),
            strata,
            steep,
            ice,
            moraine: moraine * (1.0 - 0.6 * snow),
            crevasse,
            snow,
            shade: self.shade(texel, &growth, &bare, &waters, [snow, ice]),
            water,
            shallow,
            deep,
            frozen,
        }
    }

    #[inline(always)]
    fn growth(&self, texel: &Texel, celsius: f32, wet: f32, warm: f32) -> Growth {
        let Texel { slope, patch, grain, .. } = *texel;
        let lush = smooth(0.35, 0.75, wet);
        // Tufts: some grass is dry.
        let tuft = self.close * smooth(0.1, 0.7, -grain - 0.2 * patch);
        Growth {
            green: self.living * warm * smooth(0.22, 0.42, wet),
            lush: lush * (1.0 - 0.55 * tuft),
            wood: wood(self.living, celsius, wet, slope, patch, grain),
            // Stands of trees of one age and kind; conifers where it is cold.
            stand: smooth(-0.3, 0.3, patch + 0.25 * grain),
            conifer: self.living * smooth(9.0, 4.0, celsius + patch),
        }
    }

    #[inline(always)]
    fn bare(&self, texel: &Texel, celsius: f32, wet: f32, warm: f32) -> Bare {
        let Texel { surface_m: h, slope, patch, grain, .. } = *texel;
        // Wind has carried the sand away from plains of dark stones.
        let stony = self.dry * smooth(-0.3, 0.1, patch + 0.15 * grain) * (1.0 - smooth(0.1, 0.3, slope));
        // Stones that fell from cliffs, at the angle of repose, in hollows and gullies.
        let hollow = smooth(0.05, -0.08, texel.open + 0.25 * texel.ridge + 0.04 * grain);
        // Beds of a fifth of a layer vary in it.
        let height = (h + texel.dip_m) * self.per_layer + 0.03 * patch;
        let bed = 0.6 * Layer::at(height).tone + 0.4 * Layer::at(5.0 * height + 0.08 * grain).tone;
        Bare {
            sandy: texel.cover * smooth(-15.0, -5.0, celsius).max(1.0 - self.living),
            maria: (1.0 - self.living) * smooth(0.05, -0.25, texel.inland + 0.05 * patch),
            beach: self.living
                * (1.0 - smooth(2.5, 5.5, h + 2.0 * patch + grain))
                * smooth(-1.0, 4.0, celsius)
                * (1.0 - smooth(0.2, 0.4, slope))
                * self.coasts,
            stony,
            desert: self.living
                * (1.0 - smooth(0.12, 0.3, wet))
                * (1.0 - smooth(0.08, 0.3, slope))
                * warm
                * (1.0 - stony),
            steep: smooth(0.48, 0.85, slope + 0.10 * grain + 0.06 * patch),
            scree: smooth(0.36, 0.5, slope + 0.05 * grain) * (1.0 - smooth(0.68, 0.9, slope)) * hollow,
            strata: 0.6 * self.layers * bed * smooth(0.25, 0.6, slope),
        }
    }

    #[inline(always)]
    fn snow_and_ice(&self, texel: &Texel, celsius: f32) -> (f32, f32) {
        let Texel { slope, patch, grain, .. } = *texel;
        let snow =
            smooth(0.0, -3.5, celsius - self.freezing_c + 3.0 * patch + 1.2 * grain + 6.0 * smooth(0.5, 1.0, slope))
                * (1.0 - smooth(0.45, 0.85, slope));
        let ice = texel.cover * self.glaciers;
        // Wind and melting bare the ice of low glaciers; rocks stand out of snow.
        let bare_ice = ice * smooth(-25.0, -15.0, celsius + 5.0 * patch + grain);
        (snow * (1.0 - bare_ice) * (1.0 - self.glaciers * smooth(0.30, 0.55, slope + 0.1 * grain)), ice)
    }

    #[inline(always)]
    fn waters(&self, texel: &Texel) -> Waters {
        let Texel { surface_m: h, depth_m, patch, grain, .. } = *texel;
        let [stream, ..] = texel.marks;
        let depth = depth_m.max(14.0 * stream);
        let filled = smooth(-0.15, 0.15, depth_m) * self.living;
        let water = filled.max(stream * self.living) * (1.0 - self.dry);
        let is_sea = if h.abs() < 0.05 { self.coasts } else { 0.0 };
        Waters {
            water,
            // Dry rivers leave gravel, and dry lakes salt.
            gravel: self.dry * stream.max(0.8 * smooth(30.0, 0.0, texel.stream_m + 12.0 * grain)),
            salt: self.dry * filled * smooth(-0.3, 1.5, depth_m + 0.8 * grain + patch),
            // Waves break on reefs and beaches.
            foam: is_sea * smooth(1.4, 0.3, depth) * smooth(-0.2, 0.6, grain) * filled,
            shallow: 1.0 / (1.0 + depth / 14.0),
            deep: 1.0 / (1.0 + depth / 900.0),
            frozen: smooth(-8.0, -12.0, texel.sea_level_c + 2.0 * patch + grain) * water,
        }
    }

    /// Returns the factor of brightness.
    #[inline(always)]
    fn shade(&self, texel: &Texel, growth: &Growth, bare: &Bare, waters: &Waters, [snow, ice]: [f32; 2]) -> f32 {
        let wood = growth.wood;
        let Bare { sandy, beach, stony, desert, steep, scree, .. } = *bare;
        let Waters { water, gravel, salt, .. } = *waters;
        let [dome, tone, ripple] = texel.details;
        let shade = 1.0 + 0.5 * (texel.open / (0.3 + texel.open.abs())) + 0.08 * texel.ridge.clamp(-1.0, 1.0);
        let rough = (0.045 + 0.09 * steep + 0.08 * scree + 0.07 * wood)
            * (1.0 + 1.2 * self.close)
            * (1.0 - 0.7 * snow)
            * (1.0 - water);
        // Crowns and tufts stand high, stones on sand low.
        let lumps = (0.1 + 0.12 * wood + 0.06 * scree.max(gravel).max(stony).max(steep))
            * (1.0 - 0.85 * sandy.max(beach).max(salt))
            * (1.0 - 0.8 * snow.max(ice))
            * (1.0 - water);
        let rippled = 0.1 * sandy.max(0.6 * desert).max(0.5 * beach) * (1.0 - snow.max(water));
        let near = 1.0 + lumps * (0.8 * dome + 0.7 * tone) + rippled * ripple;
        mix(shade.clamp(0.6, 1.25), 1.0, water.max(salt)) * (1.0 + rough * texel.grain) * near
    }
}

/// The shares of the covers of a texel, each laid over those before it. More than 16 fields: one for each cover.
#[derive(Clone, Copy)]
struct Shares {
    /// Two mixtures of noise that vary the colours.
    variation: [f32; 2],
    ground: f32,
    stony: f32,
    scree: f32,
    gravel: f32,
    salt: f32,
    foam: f32,
    stand: f32,
    conifer: f32,
    crest: f32,
    green: f32,
    lush: f32,
    pebble: f32,
    wood: f32,
    beach: f32,
    sandy: f32,
    strata: f32,
    steep: f32,
    ice: f32,
    moraine: f32,
    crevasse: f32,
    snow: f32,
    shade: f32,
    water: f32,
    shallow: f32,
    deep: f32,
    frozen: f32,
}

impl Shares {
    /// Returns a channel of the colour. Inlined, so that the loop over texels can be vectorised.
    #[inline(always)]
    fn channel(&self, p: &Palette, c: usize) -> f32 {
        let pair = |p: &[[f32; 3]; 2], t: f32| mix(p[0][c], p[1][c], t);
        let [broad, fine] = self.variation;
        let mut color = mix(pair(&p.bare, fine) * (1.0 - 0.12 * self.stony), pair(&p.sand, broad), self.ground);
        color =
            mix(color, mix(pair(&p.dry_grass, fine), pair(&p.grass, 0.5 * (fine + self.stand)), self.lush), self.green);
        let trees = pair(&p.forest, 0.65 * self.stand + 0.35 * fine) * (1.0 - CONIFERS[c] * self.conifer);
        color = mix(color, mix(p.rock[1][c], p.bare[1][c], 0.5) * 1.08, 0.7 * self.pebble);
        color = mix(color, trees, self.wood);
        color = mix(color, pair(&p.sand, fine), self.beach);
        color = mix(color, pair(&p.sand, broad) * (1.0 + self.crest), self.sandy);
        let rock = pair(&p.rock, fine) * (1.0 + 0.9 * self.strata);
        color = mix(color * (1.0 + 0.5 * self.strata), rock, self.steep);
        color = mix(color, mix(p.rock[1][c], p.bare[0][c], 0.4) * 1.04, 0.8 * self.scree);
        color = mix(color, p.sand[1][c] * 0.97 + 4.0, 0.75 * self.gravel);
        color = mix(color, SALT[c] * (0.93 + 0.07 * broad), 0.9 * self.salt);
        color = mix(color, mix(BARE_ICE[c][0], BARE_ICE[c][1], broad), self.ice);
        color = mix(color, p.snow[c], self.snow);
        color = mix(color, pair(&p.rock, fine) * 0.8, self.moraine);
        color = mix(color, CREVASSE[c], self.crevasse) * self.shade;
        let floor = mix(p.shallow[c], p.sand[1][c] * 0.8, 0.45 * self.shallow * self.shallow);
        let sea = mix(p.deep[c] * (0.65 + 0.35 * self.deep), floor, self.shallow);
        color = mix(color, mix(sea, 236.0, 0.6 * self.foam), self.water);
        mix(color, p.snow[c] * 0.95, self.frozen).clamp(0.0, 255.0)
    }
}
