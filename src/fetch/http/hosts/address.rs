//! Which addresses belong to the public internet, after the registries of IANA for special-purpose addresses. Any thread.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use url::{Host, Url};

use crate::fetch::http::config::host_of;

/// Returns the kind of an address that is not public, such as `loopback`; `None` for a public one. An IPv4 address inside an
/// IPv6 address (mapped, 6to4, NAT64) counts as itself.
pub(super) fn local_kind(address: IpAddr) -> Option<&'static str> {
    match address {
        IpAddr::V4(address) => local_kind_v4(address),
        IpAddr::V6(address) => local_kind_v6(address),
    }
}

fn local_kind_v4(address: Ipv4Addr) -> Option<&'static str> {
    Some(match address.octets() {
        [0, ..] => "unspecified",
        [127, ..] => "loopback",
        [10, ..] | [172, 16..=31, ..] | [192, 168, ..] => "private",
        [169, 254, ..] => "link-local",
        [100, 64..=127, ..] => "shared",
        [192, 0, 2, _] | [198, 51, 100, _] | [203, 0, 113, _] => "documentation",
        [198, 18..=19, ..] => "benchmarking",
        [224..=239, ..] => "multicast",
        [255, 255, 255, 255] => "broadcast",
        // Protocol assignments, relays of 6to4, and the former class E.
        [192, 0, 0, _] | [192, 88, 99, _] | [240..=255, ..] => "reserved",
        _ => return None,
    })
}

fn local_kind_v6(address: Ipv6Addr) -> Option<&'static str> {
    if let Some(inner) = address.to_ipv4_mapped() {
        return local_kind_v4(inner);
    }
    let v4 = |high: u16, low: u16| {
        let ([a, b], [c, d]) = (high.to_be_bytes(), low.to_be_bytes());
        local_kind_v4(Ipv4Addr::new(a, b, c, d))
    };
    Some(match address.segments() {
        [0, 0, 0, 0, 0, 0, 0, 0] => "unspecified",
        [0, 0, 0, 0, 0, 0, 0, 1] => "loopback",
        [0xfc00..=0xfdff, ..] => "private",
        [0xfe80..=0xfebf, ..] => "link-local",
        [0xff00..=0xffff, ..] => "multicast",
        [0x2001, 0xdb8, ..] | [0x3fff, 0..=0xfff, ..] => "documentation",
        // NAT64 and 6to4.
        [0x64, 0xff9b, 0, 0, 0, 0, high, low] | [0x2002, high, low, ..] => return v4(high, low),
        // Protocol assignments, Teredo among them.
        [0x2001, 0..=0x1ff, ..] => "reserved",
        // Global unicast.
        [0x2000..=0x3fff, ..] => return None,
        _ => "reserved",
    })
}

/// Returns the address that the host of a URL is written as, in whatever spelling; `None` for a name that must be resolved.
/// The name `localhost` and those below it always mean this machine (RFC 6761).
pub(super) fn written_address(url: &Url) -> Option<IpAddr> {
    match url.host()? {
        Host::Ipv4(address) => Some(address.into()),
        Host::Ipv6(address) => Some(address.into()),
        Host::Domain(_) => {
            let name = host_of(url);
            let is_this_machine = name == "localhost" || name.ends_with(".localhost");
            is_this_machine.then_some(Ipv4Addr::LOCALHOST.into())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_public_or_of_a_kind() {
        for (kind, addresses) in [
            ("unspecified", &["0.0.0.0", "0.1.2.3", "::", "::ffff:0.0.0.0"][..]),
            (
                "loopback",
                &["127.0.0.1", "127.255.255.254", "::1", "::ffff:127.0.0.1", "64:ff9b::7f00:1", "2002:7f00:1::"],
            ),
            ("private", &["10.0.0.1", "172.16.0.1", "172.31.255.255", "192.168.0.1", "::ffff:10.0.0.1"]),
            ("private", &["fc00::1", "fdff:ffff::1", "64:ff9b::a00:1", "2002:c0a8:101::1"]),
            ("link-local", &["169.254.169.254", "fe80::1", "febf::1", "::ffff:169.254.169.254", "64:ff9b::a9fe:a9fe"]),
            ("shared", &["100.64.0.1", "100.127.255.255"]),
            ("documentation", &["192.0.2.1", "198.51.100.1", "203.0.113.1", "2001:db8::1", "3fff::1"]),
            ("benchmarking", &["198.18.0.1", "198.19.255.255"]),
            ("multicast", &["224.0.0.1", "239.255.255.255", "ff02::1"]),
            ("broadcast", &["255.255.255.255"]),
            ("reserved", &["192.0.0.1", "192.88.99.1", "240.0.0.1", "255.255.255.254"]),
            ("reserved", &["::7f00:1", "2001::1", "2001:20::1", "64:ff9b:1::a00:1", "100::1", "fec0::1", "5f00::1"]),
        ] {
            for address in addresses {
                assert_eq!(local_kind(address.parse().unwrap()), Some(kind), "{address}");
            }
        }
        for public in [
            "1.1.1.1",
            "9.255.255.255",
            "11.0.0.0",
            "100.63.255.255",
            "100.128.0.0",
            "126.255.255.255",
            "128.0.0.1",
            "169.253.255.255",
            "172.15.255.255",
            "172.32.0.0",
            "192.167.255.255",
            "192.169.0.0",
            "198.17.255.255",
            "198.20.0.0",
            "223.255.255.255",
            "2606:4700::1111",
            "2001:200::1",
            "2a00::1",
            "3ffe::1",
            "::ffff:8.8.8.8",
            "64:ff9b::808:808",
            "2002:808:808::1",
        ] {
            assert_eq!(local_kind(public.parse().unwrap()), None, "{public}");
        }
    }

    #[test]
    fn addresses_are_read_in_every_spelling() {
        let of = |url: &str| written_address(&Url::parse(url).unwrap()).map(|address| address.to_string());
        for spelling in
            ["127.0.0.1", "127.1", "2130706433", "0x7f.1", "0177.0.0.1", "0x7f000001", "127.0.0.1.", "１２７.0.0.1"]
        {
            assert_eq!(of(&format!("http://{spelling}:8080/x")).as_deref(), Some("127.0.0.1"), "{spelling}");
        }
        assert_eq!(of("http://[::ffff:127.0.0.1]/").as_deref(), Some("::ffff:127.0.0.1"));
        for name in ["localhost", "LOCALHOST.", "a.localhost", "me@localhost:80"] {
            assert_eq!(of(&format!("https://{name}/")).as_deref(), Some("127.0.0.1"), "{name}");
        }
        assert_eq!((of("http://a.example/"), of("http://localhost.example/")), (None, None));
    }
}
