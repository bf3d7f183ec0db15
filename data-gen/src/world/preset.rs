//! The presets of worlds: the parameters of their relief, climate and colours.

/// A kind of world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum WorldPreset {
    /// Continents, oceans, mountain ranges, and all climates.
    Earthlike,
    /// High eroded mountains with forests, lakes and snow.
    Alps,
    /// Dunes, plains of stones and dry mountains.
    Desert,
    /// Green islands in a shallow sea.
    Islands,
    /// Craters on plains and highlands, without air.
    Moon,
    /// Red plains with craters, canyons and dust.
    Mars,
    /// Ice sheets and glaciers between mountains.
    Ice,
    /// Plateaus of layered rock, cut by canyons.
    Canyon,
}

/// The relief of a world. Lengths and heights are in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relief {
    /// True if positions below 0 m are sea.
    pub has_sea: bool,
    /// Wavelength of the largest continents.
    pub continent_m: f64,
    /// Share of land: 0 makes half of the world land, 1 all of it.
    pub land: f32,
    /// Heights of plains far from the coast.
    pub plain_m: f32,
    /// Depth of the ocean.
    pub ocean_m: f32,
    /// Wavelength of the pattern of mountain ranges.
    pub range_m: f64,
    /// Width of the ranges, 0..1: with 1 mountains are everywhere.
    pub range_width: f32,
    /// Height of mountains.
    pub mountain_m: f32,
    /// Wavelength of the largest mountains.
    pub massif_m: f64,
    /// Depth of the largest gullies as a share of the mountains' height.
    pub gullies: f32,
    /// Height of hills on plains.
    pub hill_m: f32,
    /// Height of the layers that slopes are stepped by; 0 for none.
    pub layer_m: f32,
    pub forms: Landforms,
    pub rivers: Rivers,
}

/// Landforms that some worlds have. Heights are in metres, and 0 for none.
#[derive(Clone, Copy, Debug)]
pub(super) struct Landforms {
    /// Height of small bumps and boulders.
    pub rough_m: f32,
    /// Height of the largest dunes.
    pub dune_m: f32,
    /// Height of table mountains above the plain around them.
    pub mesa_m: f32,
    /// Thickness of the layers of mountains that make cliffs.
    pub cliff_m: f32,
    /// Depth of craters as a share of their radius.
    pub craters: f32,
    /// Depth of the lagoons behind reefs.
    pub lagoon_m: f32,
}

/// The rivers and lakes of a world, and their valleys.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rivers {
    /// Distance between rivers in metres; 0 for none.
    pub spacing_m: f64,
    /// Half the width of a river with one tributary in metres.
    pub half_m: f32,
    /// Depth of valleys below the ground of mountains in metres, and the share of it in plains.
    pub incision_m: f32,
    pub in_plains: f32,
    /// The slope of the sides of valleys.
    pub slope: f32,
    /// Radius of lakes, 0..1; 0 for none.
    pub lakes: f32,
    pub flow: Flow,
}

/// The kind of flow in the valleys of a world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flow {
    Water,
    Ice,
    /// Nothing any more.
    Dry,
}

impl Rivers {
    const NONE: Self = Self {
        spacing_m: 0.0,
        half_m: 0.0,
        incision_m: 0.0,
        in_plains: 0.0,
        slope: 0.0,
        lakes: 0.0,
        flow: Flow::Water,
    };
}

/// The climate of a world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Climate {
    /// Temperature at sea level on the equator in degrees Celsius.
    pub equator_c: f32,
    /// Temperature at sea level at the poles in degrees Celsius.
    pub pole_c: f32,
    /// Moisture that is added everywhere; moisture is about 0 in deserts and 1 in rain forests.
    pub wet: f32,
    /// False for worlds without plants, snow and water.
    pub has_life: bool,
}

/// The colours of a world, sRGB 0..255. Pairs are mixed by noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Palette {
    pub bare: [[f32; 3]; 2],
    pub sand: [[f32; 3]; 2],
    pub dry_grass: [[f32; 3]; 2],
    pub grass: [[f32; 3]; 2],
    pub forest: [[f32; 3]; 2],
    pub rock: [[f32; 3]; 2],
    pub snow: [f32; 3],
    pub shallow: [f32; 3],
    pub deep: [f32; 3],
    /// Strength of the layers' colours on slopes, 0..1.
    pub layers: f32,
}

/// All parameters of a world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameters {
    pub relief: Relief,
    pub climate: Climate,
    pub palette: Palette,
    /// Longitude and latitude in degrees around which the default place is searched.
    pub place: [f64; 2],
}

const EARTH: Parameters = Parameters {
    relief: Relief {
        has_sea: true,
        continent_m: 5_200_000.0,
        land: 0.12,
        plain_m: 420.0,
        ocean_m: 4_200.0,
        range_m: 2_600_000.0,
        range_width: 0.32,
        mountain_m: 4_200.0,
        massif_m: 38_000.0,
        gullies: 0.17,
        hill_m: 260.0,
        layer_m: 0.0,
        forms: Landforms { rough_m: 1.2, dune_m: 0.0, mesa_m: 0.0, cliff_m: 300.0, craters: 0.0, lagoon_m: 0.0 },
        rivers: Rivers {
            spacing_m: 4_000.0,
            half_m: 16.0,
            incision_m: 60.0,
            in_plains: 0.2,
            slope: 0.55,
            lakes: 0.8,
            flow: Flow::Water,
        },
    },
    climate: Climate { equator_c: 29.0, pole_c: -24.0, wet: 0.0, has_life: true },
    palette: Palette {
        bare: [[140.0, 126.0, 104.0], [166.0, 148.0, 120.0]],
        sand: [[202.0, 178.0, 132.0], [218.0, 196.0, 152.0]],
        dry_grass: [[148.0, 138.0, 86.0], [170.0, 156.0, 100.0]],
        grass: [[96.0, 116.0, 58.0], [126.0, 136.0, 76.0]],
        forest: [[42.0, 64.0, 36.0], [80.0, 98.0, 48.0]],
        rock: [[104.0, 98.0, 92.0], [142.0, 134.0, 124.0]],
        snow: [242.0, 246.0, 251.0],
        shallow: [70.0, 140.0, 150.0],
        deep: [18.0, 44.0, 82.0],
        layers: 0.12,
    },
    place: [8.0, 47.0],
};

impl WorldPreset {
    /// All presets.
    pub const ALL: [Self; 8] =
        [Self::Earthlike, Self::Alps, Self::Desert, Self::Islands, Self::Moon, Self::Mars, Self::Ice, Self::Canyon];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Earthlike => "earthlike",
            Self::Alps => "alps",
            Self::Desert => "desert",
            Self::Islands => "islands",
            Self::Moon => "moon",
            Self::Mars => "mars",
            Self::Ice => "ice",
            Self::Canyon => "canyon",
        }
    }

    pub(super) fn parameters(self) -> Parameters {
        let Parameters { relief, climate, palette, .. } = EARTH;
        match self {
            Self::Earthlike => EARTH,
            Self::Alps => Parameters {
                relief: Relief {
                    land: 0.55,
                    range_width: 0.85,
                    mountain_m: 3_800.0,
                    massif_m: 26_000.0,
                    gullies: 0.19,
                    rivers: Rivers { spacing_m: 3_000.0, incision_m: 90.0, lakes: 0.9, ..relief.rivers },
                    ..relief
                },
                climate: Climate { equator_c: 22.0, pole_c: -10.0, wet: 0.08, ..climate },
                palette,
                place: [8.0, 47.0],
            },
            Self::Desert => Parameters {
                relief: Relief {
                    has_sea: false,
                    land: 0.7,
                    range_width: 0.22,
                    mountain_m: 1_700.0,
                    massif_m: 22_000.0,
                    hill_m: 90.0,
                    forms: Landforms { dune_m: 120.0, mesa_m: 190.0, cliff_m: 220.0, ..relief.forms },
                    rivers: Rivers {
                        spacing_m: 7_000.0,
                        half_m: 38.0,
                        incision_m: 45.0,
                        in_plains: 0.4,
                        slope: 0.25,
                        lakes: 0.9,
                        flow: Flow::Dry,
                    },
                    ..relief
                },
                climate: Climate { equator_c: 38.0, pole_c: 8.0, wet: -0.6, ..climate },
                palette: Palette {
                    sand: [[206.0, 150.0, 92.0], [224.0, 174.0, 114.0]],
                    bare: [[150.0, 112.0, 80.0], [176.0, 134.0, 96.0]],
                    rock: [[124.0, 84.0, 62.0], [158.0, 112.0, 82.0]],
                    layers: 0.3,
                    ..palette
                },
                place: [8.0, 24.0],
            },
            Self::Islands => Parameters {
                relief: Relief {
                    continent_m: 420_000.0,
                    land: -0.16,
                    plain_m: 160.0,
                    ocean_m: 1_400.0,
                    range_m: 240_000.0,
                    range_width: 0.55,
                    mountain_m: 1_900.0,
                    massif_m: 17_000.0,
                    gullies: 0.2,
                    hill_m: 120.0,
                    forms: Landforms { lagoon_m: 11.0, cliff_m: 0.0, ..relief.forms },
                    rivers: Rivers { spacing_m: 2_400.0, half_m: 12.0, incision_m: 40.0, ..relief.rivers },
                    ..relief
                },
                climate: Climate { equator_c: 29.0, pole_c: 14.0, wet: 0.16, ..climate },
                palette: Palette {
                    shallow: [88.0, 190.0, 184.0],
                    deep: [16.0, 66.0, 110.0],
                    grass: [[92.0, 124.0, 54.0], [118.0, 146.0, 70.0]],
                    forest: [[34.0, 70.0, 34.0], [82.0, 114.0, 48.0]],
                    sand: [[226.0, 210.0, 172.0], [238.0, 224.0, 190.0]],
                    ..palette
                },
                place: [8.0, 12.0],
            },
            Self::Moon => Parameters {
                relief: Relief {
                    has_sea: false,
                    land: 0.2,
                    plain_m: 900.0,
                    ocean_m: 1_500.0,
                    range_width: 0.0,
                    mountain_m: 0.0,
                    hill_m: 160.0,
                    forms: Landforms { rough_m: 0.8, craters: 1.0, ..relief.forms },
                    rivers: Rivers::NONE,
                    ..relief
                },
                climate: Climate { equator_c: 0.0, pole_c: 0.0, wet: 0.0, has_life: false },
                palette: Palette {
                    bare: [[112.0, 110.0, 108.0], [150.0, 147.0, 142.0]],
                    sand: [[78.0, 78.0, 80.0], [96.0, 95.0, 96.0]],
                    rock: [[140.0, 138.0, 134.0], [172.0, 169.0, 164.0]],
                    layers: 0.0,
                    ..palette
                },
                place: [8.0, 30.0],
            },
            Self::Mars => Parameters {
                relief: Relief {
                    has_sea: false,
                    land: 0.3,
                    plain_m: 1_200.0,
                    ocean_m: 2_500.0,
                    range_width: 0.2,
                    mountain_m: 3_000.0,
                    massif_m: 34_000.0,
                    hill_m: 200.0,
                    layer_m: 150.0,
                    forms: Landforms { dune_m: 25.0, craters: 0.75, cliff_m: 0.0, ..relief.forms },
                    rivers: Rivers {
                        spacing_m: 11_000.0,
                        half_m: 90.0,
                        incision_m: 750.0,
                        in_plains: 0.6,
                        slope: 0.6,
                        lakes: 0.0,
                        flow: Flow::Dry,
                    },
                    ..relief
                },
                climate: Climate { equator_c: -20.0, pole_c: -120.0, wet: 0.0, has_life: false },
                palette: Palette {
                    bare: [[152.0, 92.0, 60.0], [184.0, 118.0, 78.0]],
                    sand: [[110.0, 74.0, 58.0], [132.0, 88.0, 66.0]],
                    rock: [[126.0, 74.0, 52.0], [170.0, 110.0, 76.0]],
                    layers: 0.35,
                    ..palette
                },
                place: [8.0, 8.0],
            },
            Self::Ice => Parameters {
                relief: Relief {
                    land: 0.45,
                    range_width: 0.9,
                    mountain_m: 4_400.0,
                    massif_m: 24_000.0,
                    hill_m: 140.0,
                    rivers: Rivers {
                        spacing_m: 5_500.0,
                        half_m: 260.0,
                        incision_m: 260.0,
                        in_plains: 0.5,
                        slope: 1.0,
                        lakes: 0.0,
                        flow: Flow::Ice,
                    },
                    ..relief
                },
                climate: Climate { equator_c: 4.0, pole_c: -30.0, wet: 0.3, ..climate },
                palette: Palette {
                    bare: [[88.0, 86.0, 85.0], [122.0, 117.0, 111.0]],
                    rock: [[78.0, 76.0, 76.0], [124.0, 118.0, 112.0]],
                    shallow: [92.0, 152.0, 170.0],
                    deep: [22.0, 58.0, 88.0],
                    ..palette
                },
                place: [8.0, 60.0],
            },
            Self::Canyon => Parameters {
                relief: Relief {
                    has_sea: false,
                    land: 0.8,
                    plain_m: 1_900.0,
                    range_width: 0.12,
                    mountain_m: 1_600.0,
                    hill_m: 180.0,
                    layer_m: 130.0,
                    rivers: Rivers {
                        spacing_m: 4_500.0,
                        half_m: 14.0,
                        incision_m: 900.0,
                        in_plains: 1.0,
                        slope: 0.9,
                        lakes: 0.0,
                        flow: Flow::Water,
                    },
                    ..relief
                },
                climate: Climate { equator_c: 30.0, pole_c: 6.0, wet: -0.28, ..climate },
                palette: Palette {
                    bare: [[176.0, 120.0, 84.0], [196.0, 144.0, 104.0]],
                    sand: [[196.0, 146.0, 104.0], [212.0, 166.0, 124.0]],
                    rock: [[150.0, 88.0, 60.0], [198.0, 140.0, 100.0]],
                    dry_grass: [[150.0, 128.0, 88.0], [172.0, 146.0, 102.0]],
                    grass: [[112.0, 112.0, 70.0], [136.0, 128.0, 84.0]],
                    layers: 0.8,
                    ..palette
                },
                place: [8.0, 36.0],
            },
        }
    }
}
