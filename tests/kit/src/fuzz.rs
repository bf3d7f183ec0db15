//! Fuzzing of parsers: valid inputs are changed in a few bytes and parsed, for a given time.

use std::time::{Duration, Instant};

use terrane::math::random::{SplitMix64, mix64};

/// Returns the seconds for each parser: `FUZZ_SECS`, or 5 with `TERRANE_LONG_TESTS=1`, or 0.2.
pub fn seconds() -> f64 {
    let usual = if crate::long_tests() { 5.0 } else { 0.2 };
    std::env::var("FUZZ_SECS").ok().and_then(|s| s.parse().ok()).unwrap_or(usual)
}

/// The time for one input after which a parser counts as hanging.
const MAX_TIME: Duration = Duration::from_secs(10);

/// Random numbers (SplitMix64) from a seed.
pub struct Random(pub u64);

impl Random {
    /// Returns the next number.
    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(SplitMix64::GOLDEN_GAMMA);
        mix64(self.0)
    }

    /// Returns a number from 0, below `n`; 0 if `n` is 0.
    pub fn below(&mut self, n: usize) -> usize {
        (self.next_u64() % n.max(1) as u64) as usize
    }
}

const NUMBERS: [&str; 14] = [
    "0",
    "-0",
    "-1",
    "1e999",
    "-1e308",
    "1e-320",
    "4294967296",
    "18446744073709551615",
    "99999999999999999999999",
    "0.5",
    "null",
    "\"\"",
    "[]",
    "{}",
];
const WORDS: [u64; 12] =
    [0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x7fff_ffff_ffff_ffff, u64::MAX];

/// Returns the bytes with one to six changes, cut to at most 1 MiB. Some changes copy pieces of `other`.
pub fn changed(random: &mut Random, bytes: &[u8], other: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..1 + random.below(6) {
        change(random, &mut out, other);
    }
    out.truncate(1 << 20);
    out
}

/// Makes one random change.
fn change(random: &mut Random, out: &mut Vec<u8>, other: &[u8]) {
    let length = out.len();
    let at = random.below(length);
    match random.below(11) {
        0 | 1 if length > 0 => out[at] ^= 1 << random.below(8),
        2 if length > 0 => out[at] = random.next_u64() as u8,
        3 if length > 0 => {
            // Replaces a binary number.
            let size = [1, 2, 4, 8][random.below(4)];
            let word = WORDS[random.below(WORDS.len())].to_le_bytes();
            for (target, byte) in out[at..].iter_mut().zip(&word[..size]) {
                *target = *byte;
            }
        }
        4 if length > 0 => {
            // Replaces a decimal number.
            let is_digit = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'-');
            if let Some(start) = out[at..].iter().position(is_digit).map(|p| p + at) {
                let end = out[start..].iter().position(|b| !is_digit(b)).map_or(length, |p| p + start);
                out.splice(start..end, NUMBERS[random.below(NUMBERS.len())].bytes());
            }
        }
        5 if length > 0 => {
            let end = (at + 1 + random.below(64)).min(length);
            out.drain(at..end);
        }
        6 if length > 0 => {
            let piece = out[at..(at + 1 + random.below(200)).min(length)].to_vec();
            let to = random.below(length);
            out.splice(to..to, piece);
        }
        7 => out.truncate(at),
        8 if !other.is_empty() => {
            let from = random.below(other.len());
            let piece = other[from..(from + 1 + random.below(120)).min(other.len())].to_vec();
            out.splice(at..at, piece);
        }
        9 => {
            let bracket = [b'[', b'{', b'"', b']', b'}', b'\\', 0, 0xff][random.below(8)];
            out.splice(at..at, std::iter::repeat_n(bracket, 1 + random.below(300)));
        }
        _ => {
            let bytes: Vec<u8> = (0..1 + random.below(8)).map(|_| random.next_u64() as u8).collect();
            out.splice(at..at, bytes);
        }
    }
}

/// A parser with the checks of its result; panics if one fails.
pub type Parse = Box<dyn FnMut(&[u8])>;

/// A parser of outside data with valid inputs.
pub struct Parser {
    /// The name for messages and for `FUZZ_PARSER`.
    pub name: &'static str,
    /// Valid inputs to be changed.
    pub seeds: Vec<Vec<u8>>,
    /// Parses one input.
    pub parse: Parse,
}

impl Parser {
    /// Creates a parser.
    pub fn new(
        name: &'static str,
        seeds: impl IntoIterator<Item = impl AsRef<[u8]>>,
        parse: impl FnMut(&[u8]) + 'static,
    ) -> Self {
        Self { name, seeds: seeds.into_iter().map(|s| s.as_ref().to_vec()).collect(), parse: Box::new(parse) }
    }
}

/// Defines a test for each function that returns a [`Parser`](crate::fuzz::Parser), and `all`, which returns them all.
#[macro_export]
macro_rules! parsers {
    ($($parser:ident),* $(,)?) => {
        /// Returns all parsers of this file.
        #[allow(dead_code, reason = "called by the guided fuzzer in tests/fuzz")]
        pub fn all() -> Vec<$crate::fuzz::Parser> {
            vec![$($parser()),*]
        }

        #[cfg(test)]
        mod fuzz {
            $(#[test]
            fn $parser() {
                $crate::fuzz::run(super::$parser());
            })*
        }
    };
}

/// Parses changed seeds for [`seconds`], from the random seed `FUZZ_SEED`.
///
/// Panics with the name of a file that holds the input if the parser panics or hangs.
pub fn run(Parser { name, seeds, mut parse }: Parser) {
    let start = Instant::now();
    let until = Duration::from_secs_f64(seconds());
    let first = std::env::var("FUZZ_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1u64);
    let mut random = Random(first ^ name.bytes().fold(0, |h, b| h << 5 ^ u64::from(b)));
    for seed in &seeds {
        parse(seed);
    }
    let (mut count, mut slowest) = (0u64, Duration::ZERO);
    // Some changed inputs are kept and changed again.
    let mut kept: Vec<Vec<u8>> = Vec::new();
    while start.elapsed() < until {
        let all = seeds.len() + kept.len();
        let bytes = |index: usize| if index < seeds.len() { &seeds[index] } else { &kept[index - seeds.len()] };
        let indices = [random.below(all), random.below(all)];
        let input = changed(&mut random, bytes(indices[0]), bytes(indices[1]));
        let begin = Instant::now();
        let parsed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| parse(&input)));
        let took = begin.elapsed();
        if parsed.is_err() || took > MAX_TIME {
            let file = std::env::temp_dir().join(format!("fuzz-{name}-{count}"));
            std::fs::write(&file, &input).unwrap();
            panic!("{name}: input {count} of FUZZ_SEED={first}, kept in {}, took {took:?}", file.display());
        }
        slowest = slowest.max(took);
        count += 1;
        if random.below(50) == 0 && input.len() < 64 << 10 {
            if kept.len() < 200 {
                kept.push(input);
            } else {
                let index = random.below(kept.len());
                kept[index] = input;
            }
        }
    }
    println!("{name}: {count} inputs in {:.1} s, the slowest {slowest:?}", start.elapsed().as_secs_f64());
}
