//! Virtual displays (Xvfb) for the tests that open windows.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};

use crate::skip::skipped_unless_required;

/// A virtual display. The server ends on drop.
pub struct Display {
    xvfb: Child,
    /// The value for the variable `DISPLAY`.
    pub name: String,
}

impl Display {
    /// Starts a server; returns `None`, and skips the test, if Xvfb is not installed.
    pub fn start([width, height]: [u32; 2]) -> Option<Self> {
        let screen = format!("{width}x{height}x24");
        // Without -noreset the server resets after its last client, and drops a client that connects meanwhile.
        let xvfb = Command::new("Xvfb")
            .args(["-noreset", "-displayfd", "1", "-screen", "0", &screen, "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let mut xvfb = match xvfb {
            Ok(xvfb) => xvfb,
            Err(error) => {
                skipped_unless_required(format!("no Xvfb: {error}"));
                return None;
            }
        };
        let mut line = String::new();
        BufReader::new(xvfb.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Some(Self { xvfb, name: format!(":{}", line.trim()) })
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.xvfb.kill();
        let _ = self.xvfb.wait();
    }
}
