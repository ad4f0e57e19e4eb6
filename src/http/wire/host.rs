//! The `Host` header of a request (RFC 9112, section 3.2): HTTP/1.1 requires exactly one, with a valid value.

use super::problem::{Kind, Problem};
use axum::http::{HeaderMap, Version, header};
use std::net::Ipv6Addr;

/// Refuses a request without a `Host` header, with several, or with an invalid one. HTTP/1.0 needs none.
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

/// Whether a text is `uri-host [":" port]` (RFC 3986, section 3.2.2).
fn is_valid(text: &str) -> bool {
    let (host, port) = match text.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((literal, port)) if is_address(literal) => ("", port),
        Some(_) => return false,
        None => text.split_at(text.find(':').unwrap_or(text.len())),
    };
    let in_brackets = text.starts_with('[');
    (in_brackets || is_name(host)) && (port.is_empty() || port.strip_prefix(':').is_some_and(is_port))
}

fn is_address(literal: &str) -> bool {
    let future = |rest: &str| {
        rest.split_once('.').is_some_and(|(version, address)| {
            let hex = |b: u8| b.is_ascii_hexdigit();
            !version.is_empty()
                && version.bytes().all(hex)
                && !address.is_empty()
                && address.bytes().all(|b| is_plain(b) || b == b':')
        })
    };
    literal.parse::<Ipv6Addr>().is_ok() || literal.strip_prefix(['v', 'V']).is_some_and(future)
}

fn is_name(host: &str) -> bool {
    let mut rest = host.bytes();
    while let Some(byte) = rest.next() {
        let valid = match byte {
            b'%' => (0..2).all(|_| rest.next().is_some_and(|b| b.is_ascii_hexdigit())),
            _ => is_plain(byte),
        };
        if !valid {
            return false;
        }
    }
    !host.is_empty()
}

/// `unreserved` and `sub-delims`.
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
            "", ":80", "a b", "a/b", "a:b", "a:65536", "a:-1", "u@a", "[::1", "[x]", "[]", "[::1]x", "a%2", "a,b c",
            "http://a",
        ] {
            assert!(!check_hosts(Version::HTTP_11, &[host]), "{host}");
        }
        assert!(!check_hosts(Version::HTTP_11, &[]));
        assert!(check_hosts(Version::HTTP_10, &[]));
        assert!(!check_hosts(Version::HTTP_10, &["a", "a"]));
    }
}
