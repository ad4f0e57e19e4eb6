//! Checks of a service without keys. They prevent pages of other sites from using the service
//! through the browser of a user who can reach it. A service with keys needs no such checks,
//! because browsers do not add API keys by themselves.

use crate::http::wire::cors::Origin;
use crate::http::wire::problem::{Kind, Problem};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, Method, Uri, header};
use std::net::IpAddr;

/// Host and port that the request is addressed to.
fn authority(uri: &Uri, headers: &HeaderMap) -> Option<Authority> {
    let host = || headers.get(header::HOST)?.to_str().ok()?.parse().ok();
    uri.authority().cloned().or_else(host)
}

/// Refuses a request that is not addressed to a loopback name.
///
/// This prevents DNS rebinding: a page whose own name resolves to a loopback address has the same
/// origin for the browser, but its name is not a loopback name.
pub(super) fn check_loopback(uri: &Uri, headers: &HeaderMap) -> Result<(), Problem> {
    if authority(uri, headers).is_some_and(|authority| is_loopback(authority.host())) {
        return Ok(());
    }
    let detail = "The service has no keys, so it answers to localhost, 127.0.0.1 and [::1] only. `oviduct keys add` makes a key.";
    Err(Problem::new(Kind::UnknownHost, detail))
}

fn is_loopback(host: &str) -> bool {
    let bare = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(host);
    match bare.parse::<IpAddr>() {
        Ok(address) => address.is_loopback(),
        Err(_) => {
            let name = bare.to_ascii_lowercase();
            name == "localhost" || name.ends_with(".localhost")
        }
    }
}

/// Refuses a request of a page of another origin that changes something, unless `allowed` contains
/// the origin. Reading needs no check, because the browser does not show the response to the page.
pub(super) fn check_same(method: &Method, uri: &Uri, headers: &HeaderMap, allowed: &[Origin]) -> Result<(), Problem> {
    if method.is_safe() {
        return Ok(());
    }
    let Some(origin) = headers.get(header::ORIGIN) else { return Ok(()) };
    if allowed.iter().any(|allowed| allowed.allows(origin)) {
        return Ok(());
    }
    let origin = origin.to_str().unwrap_or_default();
    let own = authority(uri, headers);
    let theirs = origin.split_once("://").and_then(|(_, rest)| rest.parse::<Authority>().ok());
    let same = |own: Authority, theirs: Authority| own.as_str().eq_ignore_ascii_case(theirs.as_str());
    if own.zip(theirs).is_some_and(|(own, theirs)| same(own, theirs)) {
        return Ok(());
    }
    let detail =
        "The service has no keys, so pages of other origins may not change anything. `oviduct keys add` makes a key.";
    Err(Problem::new(Kind::ForbiddenOrigin, detail))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    #[test]
    fn loopback_names_are_known() {
        for host in ["localhost", "LOCALHOST", "a.localhost", "127.0.0.1", "127.8.9.1", "[::1]"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in ["example.org", "localhost.example.org", "10.0.0.1", "[::2]", "0.0.0.0", "127.0.0.1.nip.io", ""] {
            assert!(!is_loopback(host), "{host}");
        }
    }

    #[test]
    fn only_pages_of_the_same_origin_may_change_something() {
        let check = |method: &Method, origin: Option<&'static str>| {
            let mut headers = HeaderMap::from_iter([(header::HOST, HeaderValue::from_static("localhost:8080"))]);
            headers.extend(origin.map(|origin| (header::ORIGIN, HeaderValue::from_static(origin))));
            let allowed = ["https://lab.example".parse().expect("an origin")];
            check_same(method, &Uri::from_static("/models"), &headers, &allowed).is_ok()
        };
        assert!(check(&Method::POST, None) && check(&Method::POST, Some("http://localhost:8080")));
        assert!(check(&Method::POST, Some("https://lab.example")));
        for other in ["http://evil.example", "http://localhost:3000", "http://localhost", "null", "", "localhost:8080"]
        {
            assert!(!check(&Method::POST, Some(other)) && !check(&Method::DELETE, Some(other)), "{other}");
            assert!(check(&Method::GET, Some(other)), "{other}");
        }
    }
}
