//! Sources of services that ask for a key.

use std::process::{Command, Output};

use kit::server::{Reply, Server};

fn terrane(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
    command.env_remove("CESIUM_ION_TOKEN").env_remove("GOOGLE_MAPS_API_KEY");
    command.args(args).output().unwrap()
}

#[test]
fn sets_of_services_are_opened_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let args = terrane_data_gen::GenArgs { levels: Some(2), ..terrane_data_gen::GenArgs::new(folder.path()) };
    terrane_data_gen::run(&args).unwrap();
    let root = folder.path().to_owned();
    let server = Server::start(move |request| {
        let host = request.header("host").unwrap();
        let file = match request.path() {
            "/v1/assets/5/endpoint" => {
                return Reply::ok(format!(
                    r#"{{"type":"3DTILES","url":"http://{host}/set/tileset.json","accessToken":"t","attributions":[]}}"#
                ));
            }
            "/v1/3dtiles/root.json" if request.target.contains("key=k") => "tileset.json",
            path if path.starts_with("/v1/3dtiles/") && request.target.contains("key=k") => &path[12..],
            path if request.header("authorization") == Some("Bearer t") => path.trim_start_matches("/set/"),
            _ => return Reply::new(401, ""),
        };
        std::fs::read(root.join(file)).map_or(Reply::new(404, ""), Reply::ok)
    });
    for source in [
        &["ion:5", "--ion-token", "secret", "--ion-server", &server.url][..],
        &["google", "--google-key", "k", "--google-server", &server.url],
    ] {
        let out = terrane(&[&["info", "--verify"], source].concat());
        let text = String::from_utf8_lossy(&out.stdout);
        assert!(out.status.success() && text.contains("tiles"), "{text}{}", String::from_utf8_lossy(&out.stderr));
    }
    let out = terrane(&["info", "google", "--google-key", "k", "--google-server", &server.url]);
    let text = String::from_utf8_lossy(&out.stdout);
    for part in ["service  Google, Photorealistic 3D Tiles", "GOOGLE_MAPS_API_KEY", "credit   Google"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    for (args, reason) in [
        (&["info", "ion:5"][..], "--ion-token"),
        (&["info", "ion:x", "--ion-token", "secret"], "not the number of an asset"),
        (&["info", "google"], "--google-key"),
        (&["info", "ion:6", "--ion-token", "secret", "--ion-server", &server.url], "401"),
    ] {
        let out = terrane(args);
        let error = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(!out.status.success() && error.contains(reason) && !error.contains("secret"), "{args:?}: {error}");
    }
}

/// An asset of imagery as an overlay: its tile map and its images are asked for with the token of the asset.
#[test]
fn imagery_of_ion_is_draped_over_terrain() {
    if kit::skip::no_adapter() {
        return;
    }
    let mut png = std::io::Cursor::new(Vec::new());
    let red = image::RgbImage::from_pixel(256, 256, image::Rgb([255, 0, 0]));
    red.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let png = png.into_inner();
    let server = Server::start(move |request| {
        let host = request.header("host").unwrap();
        let is_allowed = request.header("authorization") == Some("Bearer t");
        match request.path() {
            "/v1/assets/9/endpoint" => Reply::ok(format!(
                r#"{{"type":"IMAGERY","url":"http://{host}/9/?v=1","accessToken":"t","attributions":[{{"html":"A"}}]}}"#
            )),
            "/9/tilemapresource.xml" if is_allowed => Reply::ok(
                r#"<TileMap version="1.0.0"><SRS>EPSG:3857</SRS>
                <BoundingBox minx="-20037508.34" miny="-20037508.34" maxx="20037508.34" maxy="20037508.34"/>
                <Origin x="-20037508.34" y="-20037508.34"/><TileFormat width="256" height="256" extension="png"/>
                <TileSets profile="global-mercator"><TileSet href="0" units-per-pixel="156543.0339" order="0"/>
                <TileSet href="1" units-per-pixel="78271.51696" order="1"/></TileSets></TileMap>"#,
            ),
            path if is_allowed && path.ends_with(".png") => Reply::ok(png.clone()),
            _ => Reply::new(401, ""),
        }
    });
    let out = terrane(&["info", "ion:9", "--ion-token", "secret", "--ion-server", &server.url]);
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(said.contains("Cesium ion, asset 9: imagery") && said.contains("credit   A"), "{said}{out:?}");
    assert!(!said.contains("secret"), "{said}");
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("view.png");
    let out = terrane(
        &[
            &["fly", "globe", "--offscreen", "--settle", "--size", "160x120", "--screenshot", image.to_str().unwrap()]
                [..],
            &["--overlay", "ion:9", "--ion-token", "secret", "--ion-server", &server.url],
        ]
        .concat(),
    );
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(server.seen().iter().any(|request| request.path().ends_with(".png")), "{:?}", server.seen());
    let image = image::open(&image).unwrap().into_rgb8();
    let is_red = |pixel: &&image::Rgb<u8>| pixel.0[0] > 40 && pixel.0[0] / 2 > pixel.0[1].max(pixel.0[2]);
    let reds = image.pixels().filter(is_red).count();
    assert!(reds > 500, "{reds} red pixels");
}
