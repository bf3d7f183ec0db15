//! The `terrane` command.

mod bench;

fn main() {
    let seconds = std::env::args().nth(3).and_then(|s| s.parse().ok()).unwrap_or(1.0);
    bench::cull::run(seconds);
}
