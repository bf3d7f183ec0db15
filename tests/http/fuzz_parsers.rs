//! Fuzzed parsers of what servers answer, headers and bodies, of the files of the cache, and of packed sets. They are run like those of
//! `tests/formats/fuzz_parsers.rs`, by tests and by `tools/fuzz`.

use kit::fuzz::Parser;
use terrane::fetch::services::fuzz_ion_endpoint;
use terrane::fetch::{Limits, fuzz_cache_entry, fuzz_encoding, fuzz_headers, fuzz_packed};

fn http_headers() -> Parser {
    let seeds = [
        "max-age=60, must-revalidate",
        "no-store, private=\"x\", s-maxage=9",
        "Sun, 06 Nov 1994 08:49:37 GMT",
        "120",
        "bytes 0-99/1000",
        "gzip, br",
        "*",
    ];
    Parser::new("http-headers", seeds, |bytes| {
        fuzz_headers(&String::from_utf8_lossy(bytes));
    })
}

fn ion_endpoints() -> Parser {
    let seeds = [
        r#"{"type":"3DTILES","url":"https://a/t.json","accessToken":"t","attributions":[{"html":"<b>A</b>"}]}"#,
        r#"{"type":"TERRAIN","externalType":"3DTILES","options":{"url":"https://b/"}}"#,
    ];
    Parser::new("ion-endpoint", seeds, fuzz_ion_endpoint)
}

fn encodings() -> Parser {
    let text = br#"{"asset":{"version":"1.1"},"root":{}}"#.as_slice();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut gzip, text).unwrap();
    // A brotli stream with one uncompressed block, and a zstd frame with one raw block.
    let brotli = [&[0x21, 0x14, 0x00, 0x04][..], b"hello", &[0x03]].concat();
    let zstd = [&[0x28, 0xb5, 0x2f, 0xfd, 0x20, 0x05, 0x29, 0x00, 0x00][..], b"hello"].concat();
    let limits = Limits { max_file_bytes: 1 << 16, ..Limits::default() };
    Parser::new("encodings", [gzip.finish().unwrap(), brotli, zstd, text.to_vec()], move |bytes| {
        for encoding in ["gzip", "br", "zstd", "zstd, gzip", "identity"] {
            fuzz_encoding(encoding, bytes, &limits);
        }
        fuzz_encoding(&String::from_utf8_lossy(&bytes[..bytes.len().min(40)]), bytes, &limits);
    })
}

fn cache_entries() -> Parser {
    let seed = r#"{"uri":"http://h/a","blob":"2d711642b726b04401627ca9fbac32f5c8530fb1903cc4db02258717921a4881","size":1,"encoding":"gzip","etag":"\"1\"","last_modified":null,"checked_s":1000,"fresh_for_s":60}"#;
    Parser::new("cache-entry", [seed], fuzz_cache_entry)
}

fn packed_set() -> Parser {
    // A set of two files without bytes.
    let index: Vec<u8> = [0u64, 9].iter().flat_map(|key| [*key, 144, 0, 0, 0]).flat_map(u64::to_le_bytes).collect();
    let table = [&[0; 8][..], &crc32fast::hash(&index).to_le_bytes(), &[0; 4]].concat();
    let mut bytes = b"TERRPACK".to_vec();
    [1u32, 512].iter().for_each(|field| bytes.extend(field.to_le_bytes()));
    [2u64, 64, 80].iter().for_each(|field| bytes.extend(field.to_le_bytes()));
    bytes.extend(crc32fast::hash(&table).to_le_bytes());
    bytes.resize(60, 0);
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    bytes.extend(table);
    bytes.extend(index);
    Parser::new("packed-set", [bytes], |bytes| {
        fuzz_packed(bytes, &Limits::default());
        // Most changes are those of bytes that have checksums: these are made right.
        let mut bytes = bytes.to_vec();
        if bytes.len() >= 80 {
            let table = crc32fast::hash(&bytes[64..80]).to_le_bytes();
            bytes[40..44].copy_from_slice(&table);
            let header = crc32fast::hash(&bytes[..60]).to_le_bytes();
            bytes[60..64].copy_from_slice(&header);
            fuzz_packed(&bytes, &Limits::default());
        }
    })
}

kit::parsers! {
    http_headers,
    ion_endpoints,
    encodings,
    cache_entries,
    packed_set,
}
