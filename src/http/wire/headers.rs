//! Request headers: `Prefer` (RFC 7240), `Idempotency-Key`, `Accept`, `Last-Event-ID`.

use super::faults::RequestFault;
use super::problem::Problem;
use axum::http::{HeaderMap, HeaderName, header};
use std::time::Duration;

/// Header of the request id: the id of the client if it has at most 128 visible ASCII characters,
/// otherwise a new one.
pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// `Prefer`.
pub(in crate::http) const PREFER: HeaderName = HeaderName::from_static("prefer");
/// `Preference-Applied`.
pub(in crate::http) const PREFERENCE_APPLIED: HeaderName = HeaderName::from_static("preference-applied");
/// `Idempotency-Key`.
pub(in crate::http) const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
/// `Idempotency-Replayed`.
pub(in crate::http) const IDEMPOTENCY_REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");
/// `Last-Event-ID`.
pub(super) const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");
/// Header with the side of a pixel of a picture, µm.
pub(in crate::http) const UM_PER_PIXEL: HeaderName = HeaderName::from_static("um-per-pixel");

/// Maximum wait of `Prefer: wait`, seconds.
const WAIT_MAX: u64 = 60;
/// Maximum length of an idempotency key, bytes.
const KEY_MAX: usize = 255;

/// Preferences that have a value, as name and value without parameters and quotes.
fn preferences(headers: &HeaderMap) -> impl Iterator<Item = (&str, &str)> {
    let all = headers.get_all(PREFER).iter().filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(','));
    all.filter_map(|preference| {
        let (name, value) = preference.split(';').next()?.split_once('=')?;
        Some((name.trim(), value.trim().trim_matches('"')))
    })
}

/// The wait that `Prefer: wait=N` requests: 1 to 60 seconds; larger values count as 60. Invalid
/// preferences are ignored, as RFC 7240 requires.
pub(in crate::http) fn wait(headers: &HeaderMap) -> Option<Duration> {
    preferences(headers).find_map(|(name, value)| {
        let digits = !value.is_empty() && value.bytes().all(|b| b.is_ascii_digit());
        let seconds =
            (name.eq_ignore_ascii_case("wait") && digits).then(|| value.parse().unwrap_or(u64::MAX).min(WAIT_MAX))?;
        (seconds > 0).then(|| Duration::from_secs(seconds))
    })
}

/// True if the client asks not to be redirected: `Prefer: redirect=no`.
pub(in crate::http) fn refuses_redirect(headers: &HeaderMap) -> bool {
    preferences(headers).any(|(name, value)| name.eq_ignore_ascii_case("redirect") && value == "no")
}

/// The idempotency key: 1 to 255 visible ASCII characters, without the quotes of a structured
/// string.
pub(in crate::http) fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let fault = |detail: &str| Err(Problem::invalid([RequestFault::header(IDEMPOTENCY_KEY.as_str(), detail)]));
    let mut values = headers.get_all(IDEMPOTENCY_KEY).iter();
    let Some(value) = values.next() else { return Ok(None) };
    if values.next().is_some() {
        return fault("must be given once");
    }
    let Ok(text) = value.to_str() else { return fault("must consist of visible ASCII characters") };
    let key = text.strip_prefix('"').and_then(|t| t.strip_suffix('"')).unwrap_or(text);
    if key.is_empty() || key.len() > KEY_MAX {
        return fault("must have 1 to 255 characters");
    }
    if !key.bytes().all(|b| b.is_ascii_graphic()) {
        return fault("must consist of visible ASCII characters");
    }
    Ok(Some(key.to_owned()))
}

/// The offer (media types, preferred first) that matches `Accept` best; `None` if none matches.
pub(in crate::http) fn accept<'a>(headers: &HeaderMap, offers: &[&'a str]) -> Option<&'a str> {
    let values = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let accepted: Vec<(String, f32)> = values.flat_map(|value| value.split(',')).filter_map(media_range).collect();
    if accepted.is_empty() {
        return offers.first().copied();
    }
    let quality = |offer: &str| {
        let family = offer.split('/').next().unwrap_or_default();
        let specificity = |range: &str| match range {
            "*/*" => Some(0),
            r if r.strip_suffix("/*") == Some(family) => Some(1),
            r if r == offer => Some(2),
            _ => None,
        };
        let matching = accepted.iter().filter_map(|(range, q)| specificity(range).map(|s| (s, *q)));
        matching.max_by_key(|(specificity, _)| *specificity).map_or(0.0, |(_, q)| q)
    };
    let acceptable = offers.iter().map(|offer| (*offer, quality(offer))).filter(|(_, q)| *q > 0.0);
    // `max_by` returns the last maximum.
    acceptable.rev().max_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(offer, _)| offer)
}

/// A media range of `Accept`, in lower case, and its weight.
fn media_range(item: &str) -> Option<(String, f32)> {
    let mut parts = item.split(';').map(str::trim);
    let range = parts.next().filter(|range| !range.is_empty())?.to_ascii_lowercase();
    let is_weight = |(name, _): &(&str, &str)| name.eq_ignore_ascii_case("q");
    let weight = parts.filter_map(|part| part.split_once('=')).find(is_weight);
    Some((range, weight.map_or(1.0, |(_, q)| q.parse().unwrap_or(0.0))))
}

/// The value of `Last-Event-ID`, if it consists of visible ASCII characters.
pub(in crate::http) fn last_event_id(headers: &HeaderMap) -> Option<&str> {
    headers.get(LAST_EVENT_ID)?.to_str().ok().map(str::trim).filter(|s| !s.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn with(name: HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_str(value).unwrap())])
    }

    #[test]
    fn waits() {
        let seconds = |v: &str| wait(&with(PREFER, v)).map(|d| d.as_secs());
        assert_eq!(seconds("wait=5"), Some(5));
        assert_eq!(seconds("respond-async, Wait=\"7\"; x=1"), Some(7));
        assert_eq!(seconds("wait=61"), Some(60));
        assert_eq!(seconds("wait=99999999999999999999999"), Some(60));
        for nonsense in ["wait=0", "wait=-1", "wait=x", "wait", "", "wait=1.5", "await=3"] {
            assert_eq!(seconds(nonsense), None, "{nonsense}");
        }
    }

    #[test]
    fn keys() {
        assert_eq!(idempotency_key(&with(IDEMPOTENCY_KEY, "a-1")).unwrap().as_deref(), Some("a-1"));
        assert_eq!(idempotency_key(&with(IDEMPOTENCY_KEY, "\"a-1\"")).unwrap().as_deref(), Some("a-1"));
        assert_eq!(idempotency_key(&HeaderMap::new()).unwrap(), None);
        for bad in ["", "\"\"", "two words", &"k".repeat(256)] {
            assert!(idempotency_key(&with(IDEMPOTENCY_KEY, bad)).is_err(), "{bad:?}");
        }
        assert!(idempotency_key(&with(IDEMPOTENCY_KEY, &"k".repeat(255))).is_ok());
    }

    #[test]
    fn accepts() {
        let offers = ["application/json", "image/svg+xml"];
        let best = |v: &str| accept(&with(header::ACCEPT, v), &offers);
        assert_eq!(accept(&HeaderMap::new(), &offers), Some("application/json"));
        assert_eq!(best("*/*"), Some("application/json"));
        assert_eq!(best("image/svg+xml"), Some("image/svg+xml"));
        assert_eq!(best("image/*, application/json;q=0.5"), Some("image/svg+xml"));
        assert_eq!(best("image/svg+xml;q=0, */*"), Some("application/json"));
        assert_eq!(best("image/svg+xml;Q=0.9, application/json;Q=0.1"), Some("image/svg+xml"));
        assert_eq!(best("application/json;q=none"), None);
        assert_eq!(best("text/html"), None);
        assert_eq!(best("image/avif,image/webp,*/*;q=0.8"), Some("application/json"));
    }
}
