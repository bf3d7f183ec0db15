//! A running `terrane serve`.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// A running `terrane serve`; ends on drop.
pub struct Server {
    child: Child,
    pub address: String,
    /// The URL, with a slash at the end.
    pub url: String,
}

impl Server {
    /// Starts the server for a folder; for none if the path is empty.
    pub fn start(folder: &Path, options: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_terrane"))
            .args(["serve", "--port", "0"])
            .args(Some(folder).filter(|folder| !folder.as_os_str().is_empty()))
            .args(options)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().rsplit(' ').next().unwrap().to_owned();
        let address = url.split("://").nth(1).unwrap().trim_end_matches('/').to_owned();
        Self { child, address, url }
    }

    /// Returns status, head and body of one request on a new connection; status 0 without an answer.
    #[allow(dead_code, reason = "some tests send requests in other ways")]
    pub fn ask(&self, method: &str, path: &str, headers: &str) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        write!(stream, "{method} {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n{headers}\r\n").unwrap();
        let mut answer = Vec::new();
        // A reset is an empty answer.
        let _ = stream.read_to_end(&mut answer);
        let Some(end) = answer.windows(4).position(|w| w == b"\r\n\r\n") else { return (0, String::new(), answer) };
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, head, answer[end + 4..].to_vec())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
