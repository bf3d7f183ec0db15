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
