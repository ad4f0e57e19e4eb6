//! The `Host` header of a request. HTTP/1.1 requires exactly one with a valid value (RFC 9112,
//! section 3.2).

use super::problem::{Kind, Problem};
use axum::http::{HeaderMap, Version, header};
use std::net::Ipv6Addr;

/// Refuses a request without a `Host` header, with several, or with an invalid one. HTTP/1.0 does
/// not require the header.
pub(in crate::http) fn check(version: Version, headers: &HeaderMap) -> Result<(), Problem> {
    let refuse = |detail| Err(Problem::new(Kind::BadRequest, detail));
    let mut hosts = headers.get_all(header::HOST).iter();
    match (hosts.next(), hosts.next()) {
        (None, _) if version < Version::HTTP_11 => Ok(()),
        (None, _) => refuse("The request has no Host header. HTTP/1.1 requires one."),
        (Some(_), Some(_)) => refuse("The request has more than one Host header."),
        (Some(host), None) if host.to_str().is_ok_and(is_valid) => Ok(()),
        (Some(_), None) => refuse("The Host header is not a host with an optional port."),
    }
}

/// True for `uri-host [":" port]` (RFC 3986, section 3.2.2).
fn is_valid(text: &str) -> bool {
    let (is_host, port) = match text.strip_prefix('[') {
        Some(rest) => rest.split_once(']').map_or((false, ""), |(literal, port)| (is_ip_literal(literal), port)),
        None => {
            let (host, port) = text.split_at(text.find(':').unwrap_or(text.len()));
            (is_name(host), port)
        }
    };
    is_host && (port.is_empty() || port.strip_prefix(':').is_some_and(is_port))
}

/// True for the text between brackets: an IPv6 address, or an address of a future version.
fn is_ip_literal(text: &str) -> bool {
    let is_future = |rest: &str| {
        rest.split_once('.').is_some_and(|(version, address)| {
            !version.is_empty()
                && version.bytes().all(|b| b.is_ascii_hexdigit())
                && !address.is_empty()
                && address.bytes().all(|b| is_plain(b) || b == b':')
        })
    };
    text.parse::<Ipv6Addr>().is_ok() || text.strip_prefix(['v', 'V']).is_some_and(is_future)
}

fn is_name(host: &str) -> bool {
    let is_escape = |rest: &str| rest.as_bytes().get(..2).is_some_and(|hex| hex.iter().all(u8::is_ascii_hexdigit));
    !host.is_empty() && host.bytes().all(|b| is_plain(b) || b == b'%') && host.split('%').skip(1).all(is_escape)
}

/// True for `unreserved` and `sub-delims`.
fn is_plain(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || b"-._~!$&'()*+,;=".contains(&byte)
}

fn is_port(text: &str) -> bool {
    text.is_empty() || text.bytes().all(|b| b.is_ascii_digit()) && text.parse::<u16>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn check_hosts(version: Version, hosts: &[&'static str]) -> bool {
        let mut headers = HeaderMap::new();
        for host in hosts {
            headers.append(header::HOST, HeaderValue::from_static(host));
        }
        check(version, &headers).is_ok()
    }

    #[test]
    fn exactly_one_valid_host_is_required() {
        for host in ["a", "example.org:8080", "127.0.0.1:1", "[::1]:80", "[::1]", "[v1.a:b]", "h:", "a%20b", "a_b"] {
            assert!(check_hosts(Version::HTTP_11, &[host]), "{host}");
            assert!(!check_hosts(Version::HTTP_11, &[host, host]), "{host} twice");
        }
        for host in [
            "", ":80", "a b", "a/b", "a:b", "a:65536", "a:-1", "u@a", "[::1", "[a", "[x]", "[]", "[::1]x", "a%2",
            "a,b c", "http://a",
        ] {
            assert!(!check_hosts(Version::HTTP_11, &[host]), "{host}");
        }
        assert!(!check_hosts(Version::HTTP_11, &[]));
        assert!(check_hosts(Version::HTTP_10, &[]));
        assert!(!check_hosts(Version::HTTP_10, &["a", "a"]));
    }
}
