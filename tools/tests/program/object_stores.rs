//! A set in an object store. Keys and address come from the environment.

use std::process::{Command, Output};

use kit::server::{Reply, Server};

const SECRET: &str = "a-key-nobody-may-see";

const SET: &str = r#"{"asset":{"version":"1.1"},"geometricError":9,"root":{"refine":"ADD","geometricError":1,
    "boundingVolume":{"sphere":[0,0,0,9]},"content":{"uri":"tile.glb"}}}"#;

fn info(url: &str, source: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
    command.args(["info", "--json", source]).env("AWS_ENDPOINT", url).env("AWS_ALLOW_HTTP", "true");
    command.env("AWS_ACCESS_KEY_ID", "AKIATEST").env("AWS_SECRET_ACCESS_KEY", SECRET).env("AWS_REGION", "eu-test-1");
    command.output().unwrap()
}

#[test]
fn keys_are_taken_from_the_environment() {
    let server = Server::start(|r| match r.path() {
        "/tiles/set/tileset.json" => Reply::ok(SET).with("ETag", "\"1\""),
        _ => Reply::new(404, ""),
    });
    let output = info(&server.url, "s3://tiles/set/");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let info: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&info["tiles"], &info["contents"]), (&1.into(), &1.into()), "{text}");
    let signed = server.seen()[0].header("authorization").unwrap().to_owned();
    assert!(signed.contains("Credential=AKIATEST/") && signed.contains("/eu-test-1/s3/"), "{signed}");

    let output = self::info(&server.url, "s3://tiles/none/tileset.json");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("s3://tiles/none/tileset.json: not found") && !said.contains(SECRET), "{said}");
}
