//! Scenes in .ive that tests and fuzzed parsers read.

use super::{GEODE, Ive};

/// Writes a group with a placed geode that has materials, blending and a texture in the file of its name.
pub fn textured(mut file: Ive) -> Ive {
    file.u32(0).group("root", 2, |file| {
        file.u32s(&[1, 4]).group("", 1, |file| {
            file.u32s(&[2, GEODE]).node_with("textured", |file| {
                file.state_set(
                    0,
                    &[(0xbe2, 1), (0xb44, 3)],
                    |file| {
                        file.u32(2);
                        file.u32s(&[0, 0x102]).object("").u32s(&[0x302, 1]).u32(1);
                        file.u32s(&[1, 0x110]).object("").u32(0x1603);
                        for side in 0..4 {
                            file.raw(&[1]).f32s(&[0.25 * side as f32, 0.5, 0.0, 1.0]).f32s(&[0.0; 4]);
                        }
                        file.raw(&[0]).f32s(&[0.0, 0.0]).u32(3);
                    },
                    &[(0xde1, 1)],
                    |file| {
                        file.u32s(&[1, 2, 0x122]).texture().image(0).text("a.png").u32(1);
                    },
                );
            });
            file.u32(1).triangle(0);
        });
        file.f64s(&[0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 5.0, 6.0, 7.0, 1.0]);
        // The first geode again.
        file.u32(2);
    });
    file
}

/// Writes a PagedLOD with a geode in its file and a finer one in another.
pub fn paged(mut file: Ive, inline: bool) -> Ive {
    file.u32s(&[0, 0x21])
        .node("")
        .since(6, |file| file.text("tiles"))
        .f32s(&[9.0])
        .u32(0)
        .since(41, |file| file.raw(&[0]));
    file.u32(inline.into());
    if inline {
        file.triangle_geode(1);
    }
    file.u32(1).f32s(&[1.0, 2.0, 3.0]).u32s(&[0, 2]).f32s(&[100.0, 1e30, 0.0, 100.0]);
    file.u32(2).text(if inline { "" } else { "coarse.ive" }).text("fine.ive");
    file.since(15, |file| file.u32(2).f32s(&[0.0, 2.0]).u32(2).f32s(&[1.0, 3.0]));
    file
}

/// Writes nodes whose classes have members that are read over, each before a triangle that shows where it ends.
pub fn unusual_nodes(version: u32) -> Ive {
    let mut file = Ive::new(version);
    file.u32(0).group("", 16, |file| {
        let child = |id: u32| {
            move |file: &mut Ive| {
                file.triangle_geode(id);
            }
        };
        // A LightSource with a Light.
        file.u32s(&[1, 8]).group("", 1, child(101)).raw(&[1]).u32(9).object("").u32(0).f32s(&[0.0; 24]).u32(0);
        // A ClipNode with a ClipPlane.
        file.u32s(&[2, 0x26]).group("", 1, child(102)).since(37, |file| file.u32(0)).u32s(&[1, 0x1122]).object("");
        file.f64s(&[0.0, 0.0, 1.0, 5.0]).u32(0);
        // A TexGenNode with a TexGen.
        file.u32s(&[3, 0x25]).group("", 1, child(103)).u32(0).raw(&[1]).u32(0x127).object("").u32(0x2401);
        for _ in 0..16 {
            if version > 18 {
                file.f64s(&[0.0]);
            } else {
                file.since(5, |file| file.f32s(&[0.0]));
            }
        }
        // An OccluderNode with a hole, and an OcclusionQueryNode.
        file.u32s(&[4, 0x17]).group("", 1, child(104)).raw(&[1]).u32(0x19).object("");
        file.u32s(&[0x20, 1]).f32s(&[0.0; 3]).u32s(&[1, 0x20, 1]).f32s(&[0.0; 3]);
        file.u32s(&[5, 0x31]).group("", 1, child(105)).raw(&[1]).u32s(&[500, 5]).raw(&[0]);
        // A VisibilityGroup and a MultiTextureControl.
        file.u32s(&[6, 0x10_0009]).group("", 1, child(106)).triangle_geode(206).u32s(&[1, 0]);
        file.u32s(&[7, 0x100_0001]).group("", 1, child(107)).u32(2).f32s(&[0.5, 0.5]);
        // Cartoon and Scribe.
        file.u32s(&[8, 0x100_0005, 0x100_0002]).group("", 1, child(108)).raw(&[1]).u32(0).f32s(&[0.0; 5]).u32(0);
        file.u32s(&[9, 0x100_0006, 0x100_0002]).group("", 1, child(109)).raw(&[1]).u32(0).f32s(&[0.0; 5]);
        // A Sequence of two children.
        file.u32s(&[10, 0x12]).group("", 2, |file| {
            file.triangle_geode(110).triangle_geode(210);
        });
        file.since(22, |file| file.f32s(&[1.0])).u32(2).f32s(&[1.0, 1.0]).since(22, |file| file.f32s(&[0.0]));
        file.u32s(&[0, 1, u32::MAX]).f32s(&[1.0]).u32s(&[1, 0]).since(22, |file| file.u32s(&[0, 0]));
        // A MultiSwitch whose second set shows the second child.
        file.u32s(&[11, 0x10_0008]).group("", 2, |file| {
            file.triangle_geode(111).triangle_geode(211);
        });
        file.raw(&[1]).u32s(&[1, 2]).raw(&[1, 0, 0, 1]);
        // An Impostor, which is an LOD.
        file.u32s(&[12, 0x18, 0x11])
            .group("", 1, child(112))
            .since(3, |file| file.f32s(&[-1.0]))
            .u32(0)
            .f32s(&[0.0; 3]);
        file.since(3, |file| file.u32(0)).u32(1).f32s(&[0.0, 1e30, 500.0]);
        // A Camera, of which nothing is drawn, and a CameraView.
        file.u32s(&[13, 0x28]).transform(1, child(113)).f32s(&[0.0; 4]).u32(0).raw(&[0, 0]).u32(0).f64s(&[0.0; 32]);
        file.u32s(&[0, 0, 0, 0, 0, 1, 4, 0]).raw(&[0, 0]).u32s(&[0, 0]).raw(&[0]);
        file.u32s(&[14, 0x29]).transform(1, child(114)).f32s(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).f64s(&[60.0]).u32(0);
        file.f64s(&[0.0]);
        // A Geode with a text.
        file.u32s(&[15, GEODE]).node("").u32s(&[1, 15, 0x1000_0001]).drawable().text("arial").u32s(&[32, 32]);
        file.f32s(&[1.0, 1.0])
            .u32(0)
            .f32s(&[0.0; 2])
            .since(20, |file| file.f32s(&[0.0]))
            .u32(0)
            .f32s(&[0.0; 4])
            .raw(&[0]);
        file.u32(0).f32s(&[0.0; 7]).u32(1).since(41, |file| file.f32s(&[0.0; 5]));
        file.since(28, |file| file.u32(9).f32s(&[0.0; 6]).u32s(&[0, 0]).f32s(&[0.0; 16])).raw(&[1]).text("hello");
        file.triangle_geode(16);
    });
    file
}

/// Writes a TerrainTile with heights of 3 x 2 samples, packed into bytes since version 35, and three layers of colours.
pub fn terrain_tile(version: u32) -> Ive {
    let mut file = Ive::new(version);
    let has_numbers = version >= 23;
    // A marker says that an object follows: an own number, or a boolean.
    let begin = |file: &mut Ive, number: u32| {
        match has_numbers {
            true => file.u32(number),
            false => file.raw(&[1]),
        };
    };
    let locator = |file: &mut Ive| {
        file.u32(0x20_0002).object("").u32(2).text("WKT").text("").raw(&[1]).u32(0x24).object("");
        file.f64s(&[6_378_137.0, 6_356_752.3]).raw(&[0, 0]);
        file.f64s(&[20.0, 0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 100.0, 200.0, 0.0, 1.0]);
    };
    let layer = |file: &mut Ive| {
        file.u32(0x20_0003).object("");
        // The locator of the tile again.
        begin(file, 0);
        if !has_numbers {
            locator(file);
        }
        if version >= 34 {
            file.u32s(&[0x2703, 0x2601]);
        } else {
            file.since(23, |file| file.u32(1));
        }
        file.u32s(&[0, 30]).since(27, |file| file.raw(&[1]).u32(0x20_000c).f32s(&[-9999.0]));
    };
    let image = |file: &mut Ive| {
        file.u32(0x20_0004);
        layer(file);
        file.raw(&[0]).text("a.png");
    };
    file.u32s(&[0, 0x20_0001])
        .group("", 0, |_| ())
        .since(44, |file| file.u32(0))
        .since(26, |file| file.u32s(&[1, 0, 0]));
    begin(&mut file, 0);
    locator(&mut file);
    begin(&mut file, 0);
    file.u32(0x20_0005);
    layer(&mut file);
    file.raw(&[1]);
    if version >= 35 {
        file.u32s(&[3, 2]).f32s(&[100.0, 200.0, 0.0, 10.0, 10.0, 0.0, 0.0, 0.0, 1.0, 1.0]).u32(0);
        file.u32(6).raw(&[0]).u32(1).f32s(&[0.0, 51.0]).raw(&[0, 5, 10, 50, 100, 255]);
    } else {
        file.u32s(&[0, 0x2007])
            .object("")
            .u32s(&[3, 2])
            .f32s(&[100.0, 200.0, 0.0, 10.0, 10.0, 0.0, 0.0, 0.0, 1.0, 1.0]);
        file.u32s(&[0, 6]).f32s(&[0.0, 1.0, 2.0, 10.0, 20.0, 51.0]);
    }
    file.u32(3);
    begin(&mut file, 1);
    image(&mut file);
    begin(&mut file, 2);
    // A SwitchLayer of a layer and the name of a file.
    file.u32s(&[0x20_000d, 0x20_0006]);
    layer(&mut file);
    file.u32(2).raw(&[1, 1]);
    image(&mut file);
    file.raw(&[0]).text("b.png").u32(0);
    begin(&mut file, 3);
    file.u32(0x20_0007).text("c.tif");
    begin(&mut file, 0);
    if !has_numbers {
        locator(&mut file);
    }
    file.u32s(&[0, 30]).raw(&[1]).u32(0x20_0009);
    file
}

/// Three tiles of a volume with every kind of layer and property, and a triangle.
pub fn volumes(version: u32) -> Ive {
    const NONE: u32 = u32::MAX;
    let mut file = Ive::new(version);
    file.u32(0).group("", 4, |file| {
        // A locator that two layers share, and every kind of property.
        file.u32s(&[1, 0x30_0001]).group("", 1, |file| {
            file.triangle_geode(11);
        });
        file.u32s(&[0, 0x30_0002]).object("").f64s(&[0.0; 16]);
        file.u32s(&[0, 0x30_0005, 0x30_0003]).object("").u32(0);
        file.u32s(&[0, 0x30_0015, 0x30_0011]).object("").u32(6);
        file.u32s(&[1, 0x30_0016]).object("").u32s(&[1, 256, 2]).f32s(&[0.0; 10]);
        file.u32s(&[2, 0x30_0017, 3, 0x30_0018]);
        for (id, class) in [(4, 0x30_0013), (5, 0x30_001a)] {
            file.u32s(&[id, class, 0x30_0012]).object("").f32s(&[0.5]);
        }
        file.u32(1).u32(0);
        // An image in the file, and a layer of another file.
        file.u32(2).raw(&[1]).u32s(&[1, 0x30_0004, 0x30_0003]).object("").u32s(&[NONE, NONE]);
        file.raw(&[1, 1]).pixels([2, 2], &[9; 12]).raw(&[0]).text("b.ive");
        // OSG writes two markers of a technique here.
        file.raw(&[1]).u32(0x30_0009).raw(&[0]);
        file.u32s(&[2, 0x30_0001]).group("", 0, |_| ()).u32s(&[NONE, 1]).raw(&[1]).u32(0x30_001c);
        file.u32s(&[3, 0x30_0001]).group("", 0, |_| ()).u32s(&[NONE, NONE]).raw(&[0]);
        file.triangle_geode(4);
    });
    file
}
