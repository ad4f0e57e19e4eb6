//! Entity tags and conditional requests (RFC 9110, sections 8.8.3 and 13).

use super::problem::{Kind, Problem};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// A strong entity tag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::http) struct ETag(String);

impl ETag {
    /// A tag with this content. The content must be printable ASCII without quotes.
    pub(in crate::http) fn strong(content: impl std::fmt::Display) -> Self {
        Self(format!("\"{content}\""))
    }

    /// The tag as the value of a header.
    pub(in crate::http) fn header(&self) -> Result<HeaderValue, Problem> {
        HeaderValue::from_str(&self.0).map_err(|_| Problem::new(Kind::Internal, "The entity tag could not be written."))
    }

    /// True if `If-None-Match` contains this tag (weak comparison) or is `*`.
    pub(in crate::http) fn matches_none(&self, headers: &HeaderMap) -> bool {
        headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|v| v.to_str().ok()).any(|list| {
            list.split(',').map(str::trim).any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == self.0)
        })
    }

    /// True if `If-Range` permits a range: the header is absent or contains this tag (strong
    /// comparison).
    pub(in crate::http) fn matches_range(&self, headers: &HeaderMap) -> bool {
        headers.get(header::IF_RANGE).is_none_or(|v| v.as_bytes() == self.0.as_bytes())
    }

    /// Response 304 with this tag, and with the `Cache-Control` of the full response.
    pub(in crate::http) fn not_modified(&self, cache: HeaderValue) -> Result<Response, Problem> {
        Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, self.header()?), (header::CACHE_CONTROL, cache)]).into_response())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: header::HeaderName, value: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_static(value))])
    }

    #[test]
    fn if_none_match_takes_lists_weak_tags_and_a_star() {
        let tag = ETag::strong(14);
        for yes in ["\"14\"", "W/\"14\"", "\"1\", \"14\"", "*"] {
            assert!(tag.matches_none(&with(header::IF_NONE_MATCH, yes)), "{yes}");
        }
        for no in ["\"1\"", "14", "", "\"1\",\"4\""] {
            assert!(!tag.matches_none(&with(header::IF_NONE_MATCH, no)), "{no}");
        }
        assert!(!tag.matches_none(&HeaderMap::new()));
    }

    #[test]
    fn if_range_is_compared_strongly() {
        let tag = ETag::strong("ab");
        assert!(tag.matches_range(&HeaderMap::new()));
        assert!(tag.matches_range(&with(header::IF_RANGE, "\"ab\"")));
        for no in ["W/\"ab\"", "\"cd\"", "Wed, 21 Oct 2015 07:28:00 GMT"] {
            assert!(!tag.matches_range(&with(header::IF_RANGE, no)), "{no}");
        }
    }
}
